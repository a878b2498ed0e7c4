//! From TOML text and `--set` overrides to a checked [`Config`], with errors that name file,
//! line, key and what was expected.

use std::path::{Path, PathBuf};

use serde::Deserialize;
use toml::de::DeTable;

use super::{Config, Invalid};

/// A configuration that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error("{}: cannot be read: {source}", file.display())]
    Unreadable {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The text is not TOML.
    #[error("{origin}: not valid TOML: {message}")]
    Syntax {
        /// File and line.
        origin: Origin,
        /// What the parser says.
        message: String,
    },
    /// An override is not of the form `key=value`.
    #[error("--set {argument}: expected key=value, for instance run.seed=7")]
    Override {
        /// The argument.
        argument: String,
    },
    /// A key is unknown, or its value of the wrong type or outside its range.
    #[error("{origin}: key `{key}`: {problem}")]
    Key {
        /// File and line, or the override.
        origin: Origin,
        /// Dotted path of the key.
        key: String,
        /// What was found and what was expected.
        problem: String,
    },
}

/// Where a value came from.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Origin {
    /// A line of a file, counted from 1.
    File {
        /// The file.
        file: PathBuf,
        /// The line.
        line: usize,
    },
    /// A `--set` or another option of the command line.
    CommandLine,
    /// The built-in default.
    Default,
}

impl std::fmt::Display for Origin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::File { file, line } => write!(f, "{}:{line}", file.display()),
            Self::CommandLine => f.write_str("command line"),
            Self::Default => f.write_str("default"),
        }
    }
}

/// Reads a configuration: the defaults, then `file`, then `overrides` (`key=value`, the value in
/// TOML; what does not parse is taken as a string).
///
/// # Errors
/// The file cannot be read, is not TOML, or has an unknown or wrong key.
pub fn load(file: Option<&Path>, overrides: &[String]) -> Result<Config, ConfigError> {
    let (text, name) = match file {
        None => (String::new(), PathBuf::new()),
        Some(file) => {
            let text = std::fs::read_to_string(file).map_err(|source| ConfigError::Unreadable {
                file: file.to_owned(),
                source,
            })?;
            (text, file.to_owned())
        }
    };
    parse(&text, &name, overrides)
}

/// As [`load`], from text; `name` is what errors call the file.
///
/// # Errors
/// The text is not TOML, or has an unknown or wrong key.
pub fn parse(text: &str, name: &Path, overrides: &[String]) -> Result<Config, ConfigError> {
    let mut table: toml::Table = text.parse().map_err(|e: toml::de::Error| {
        let line = e.span().map_or(1, |span| line_of(text, span.start));
        ConfigError::Syntax {
            origin: Origin::File {
                file: name.to_owned(),
                line,
            },
            message: e.message().to_owned(),
        }
    })?;
    let mut overridden = Vec::new();
    for argument in overrides {
        overridden.push(apply_override(&mut table, argument)?);
    }
    let origin = |key: &str| {
        if overridden
            .iter()
            .any(|o| o == key || o.starts_with(&format!("{key}.")))
        {
            Origin::CommandLine
        } else {
            line_of_key(text, key).map_or(Origin::Default, |line| Origin::File {
                file: name.to_owned(),
                line,
            })
        }
    };
    let config: Config =
        serde_path_to_error::deserialize(toml::Value::Table(table)).map_err(|e| {
            let key = e.path().to_string();
            let problem = with_suggestion(&key, e.inner().message());
            ConfigError::Key {
                origin: origin(&key),
                key,
                problem,
            }
        })?;
    config
        .validate()
        .map_err(|Invalid { key, problem }| ConfigError::Key {
            origin: origin(&key),
            key,
            problem,
        })?;
    Ok(if config.run.dry_run_air {
        config.in_air()
    } else {
        config
    })
}

fn line_of(text: &str, offset: usize) -> usize {
    text.as_bytes()
        .iter()
        .take(offset)
        .filter(|b| **b == b'\n')
        .count()
        + 1
}

/// Line of the deepest table or key on the dotted path that the text has.
fn line_of_key(text: &str, key: &str) -> Option<usize> {
    let document = DeTable::parse(text).ok()?;
    let mut table = document.get_ref();
    let mut line = None;
    for part in key.split('.') {
        let name = part.split('[').next().unwrap_or(part);
        let Some((found, value)) = table.iter().find(|(k, _)| k.get_ref() == name) else {
            break;
        };
        line = Some(line_of(text, found.span().start));
        match value.get_ref().as_table() {
            Some(inner) => table = inner,
            None => break,
        }
    }
    line
}

/// Puts one `key=value` into the table; returns the key.
fn apply_override(table: &mut toml::Table, argument: &str) -> Result<String, ConfigError> {
    #[derive(Deserialize)]
    struct Holder {
        x: toml::Value,
    }
    let malformed = || ConfigError::Override {
        argument: argument.to_owned(),
    };
    let (key, value) = argument.split_once('=').ok_or_else(malformed)?;
    let (key, value) = (key.trim(), value.trim());
    if key.is_empty() || key.split('.').any(str::is_empty) {
        return Err(malformed());
    }
    if value
        .parse::<i128>()
        .is_ok_and(|n| i64::try_from(n).is_err())
    {
        return Err(ConfigError::Key {
            origin: Origin::CommandLine,
            key: key.to_owned(),
            problem: format!(
                "expected an integer from {} to {}, found {value}",
                i64::MIN,
                i64::MAX
            ),
        });
    }
    let value = toml::from_str::<Holder>(&format!("x = {value}"))
        .map_or_else(|_| toml::Value::String(value.to_owned()), |holder| holder.x);
    let mut parts = key.split('.').peekable();
    let mut at = table;
    while let Some(part) = parts.next() {
        if parts.peek().is_none() {
            at.insert(part.to_owned(), value);
            break;
        }
        let entry = at
            .entry(part.to_owned())
            .or_insert_with(|| toml::Value::Table(toml::Table::new()));
        let toml::Value::Table(inner) = entry else {
            return Err(malformed());
        };
        at = inner;
    }
    Ok(key.to_owned())
}

/// Adds the nearest known key to serde's message about an unknown one.
fn with_suggestion(key: &str, message: &str) -> String {
    if !message.starts_with("unknown field") && !message.starts_with("unknown variant") {
        return message.to_owned();
    }
    let mut quoted = message.split('`').skip(1).step_by(2);
    let Some(wrong) = quoted.next().or_else(|| key.rsplit('.').next()) else {
        return message.to_owned();
    };
    let nearest = quoted
        .map(|known| (strsim::damerau_levenshtein(wrong, known), known))
        .min()
        .filter(|(distance, known)| *distance <= known.len().max(3) / 2);
    match nearest {
        Some((_, known)) => format!("{message}; did you mean `{known}`?"),
        None => message.to_owned(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn error(text: &str, overrides: &[&str]) -> String {
        let overrides: Vec<String> = overrides.iter().map(|s| (*s).to_owned()).collect();
        parse(text, Path::new("lab.toml"), &overrides)
            .unwrap_err()
            .to_string()
    }

    #[test]
    fn unknown_key_names_line_and_suggests() {
        let message = error("[run]\nseed = 3\n\n[needle]\nlenght_mm = 126\n", &[]);
        assert!(
            message.starts_with("lab.toml:5: key `needle.lenght_mm`: unknown field"),
            "{message}"
        );
        assert!(message.ends_with("did you mean `length_mm`?"), "{message}");
    }

    #[test]
    fn wrong_unit_is_an_unknown_key() {
        let message = error("[needle]\nlength_m = 0.126\n", &[]);
        assert!(
            message.contains("lab.toml:2") && message.contains("`length_mm`"),
            "{message}"
        );
    }

    #[test]
    fn values_out_of_range_name_the_expectation() {
        for bad in ["nan", "inf", "-3", "0"] {
            let message = error(&format!("\n[needle]\nlength_mm = {bad}\n"), &[]);
            assert!(
                message.starts_with("lab.toml:3: key `needle.length_mm`"),
                "{message}"
            );
            assert!(message.contains("expected"), "{message}");
        }
        let message = error("[needle]\nlength_mm = \"long\"\n", &[]);
        assert!(
            message.contains("lab.toml:2") && message.contains("invalid type"),
            "{message}"
        );
    }

    #[test]
    fn overrides_win_and_are_named_in_errors() {
        let config = parse(
            "[run]\nseed = 3\n",
            Path::new("lab.toml"),
            &["run.seed=9".into()],
        )
        .unwrap();
        assert_eq!(config.run.seed, 9);
        let message = error("", &["run.sede=9"]);
        assert!(
            message.starts_with("command line: key `run.sede`"),
            "{message}"
        );
        let message = error("", &["run.seed"]);
        assert!(message.contains("expected key=value"), "{message}");
    }

    #[test]
    fn syntax_error_names_the_line() {
        let message = error("[run]\nseed = = 3\n", &[]);
        assert!(
            message.starts_with("lab.toml:2: not valid TOML"),
            "{message}"
        );
    }
}

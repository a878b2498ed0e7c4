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
    /// A key of an override leads through a value, or is none.
    #[error("argument `set`: key `{key}`: expected a dotted key, for instance run.seed")]
    Path {
        /// The key.
        key: String,
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

/// A TOML string, so that a name like `1` stays a name.
pub fn quoted(value: &str) -> String {
    toml::Value::String(value.to_owned()).to_string()
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
    /// An override of a program that calls.
    Argument,
    /// The tables that a program gives.
    Table,
    /// The built-in default.
    Default,
}

impl std::fmt::Display for Origin {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::File { file, line } => write!(f, "{}:{line}", file.display()),
            Self::CommandLine => f.write_str("command line"),
            Self::Argument => f.write_str("argument `set`"),
            Self::Table => f.write_str("argument `config`"),
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
        Some(file) => (read(file)?, file.to_owned()),
    };
    parse(&text, &name, overrides)
}

/// As [`load`], from text; `name` is what errors call the file.
///
/// # Errors
/// The text is not TOML, or has an unknown or wrong key.
pub fn parse(text: &str, name: &Path, overrides: &[String]) -> Result<Config, ConfigError> {
    let mut table = table_of(text, name)?;
    let mut overridden = Vec::new();
    for argument in overrides {
        overridden.push(apply_override(&mut table, argument)?);
    }
    let origin = |key: &str| {
        if is_under(overridden.iter().map(String::as_str), key) {
            Origin::CommandLine
        } else {
            line_of_key(text, key).map_or(Origin::Default, |line| Origin::File {
                file: name.to_owned(),
                line,
            })
        }
    };
    checked(table, origin)
}

/// What a configuration starts from, beside the defaults.
#[derive(Clone, Debug)]
pub enum Base<'a> {
    /// The defaults alone.
    Default,
    /// A file.
    File(&'a Path),
    /// Tables and keys as a file has them.
    Table(toml::Table),
}

/// A configuration for a program that calls: the defaults, then `base`, then `set`, values by
/// dotted keys.
///
/// # Errors
/// As [`load`].
pub fn assemble(base: Base<'_>, set: &[(String, toml::Value)]) -> Result<Config, ConfigError> {
    let (mut table, text, name) = match base {
        Base::Default => (toml::Table::new(), String::new(), None),
        Base::Table(table) => (table, String::new(), None),
        Base::File(file) => {
            let text = read(file)?;
            (table_of(&text, file)?, text, Some(file))
        }
    };
    let given = table.clone();
    for (key, value) in set {
        insert(&mut table, key, value.clone())
            .ok_or_else(|| ConfigError::Path { key: key.clone() })?;
    }
    let origin = |key: &str| {
        if is_under(set.iter().map(|(key, _)| key.as_str()), key) {
            return Origin::Argument;
        }
        match name {
            Some(file) => line_of_key(&text, key).map_or(Origin::Default, |line| Origin::File {
                file: file.to_owned(),
                line,
            }),
            None if key
                .split('.')
                .next()
                .is_some_and(|first| given.contains_key(first)) =>
            {
                Origin::Table
            }
            None => Origin::Default,
        }
    };
    checked(table, origin)
}

/// Whether one of `keys` is `key` or lies in its table.
fn is_under<'a>(mut keys: impl Iterator<Item = &'a str>, key: &str) -> bool {
    keys.any(|k| {
        k == key
            || k.strip_prefix(key)
                .is_some_and(|rest| rest.starts_with('.'))
    })
}

fn checked(table: toml::Table, origin: impl Fn(&str) -> Origin) -> Result<Config, ConfigError> {
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

fn read(file: &Path) -> Result<String, ConfigError> {
    std::fs::read_to_string(file).map_err(|source| ConfigError::Unreadable {
        file: file.to_owned(),
        source,
    })
}

fn table_of(text: &str, name: &Path) -> Result<toml::Table, ConfigError> {
    text.parse().map_err(|e: toml::de::Error| {
        let line = e.span().map_or(1, |span| line_of(text, span.start));
        ConfigError::Syntax {
            origin: Origin::File {
                file: name.to_owned(),
                line,
            },
            message: e.message().to_owned(),
        }
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
    insert(table, key, value).ok_or_else(malformed)?;
    Ok(key.to_owned())
}

/// Puts a value into the table at a dotted key; nothing where the key leads through a value.
fn insert(table: &mut toml::Table, key: &str, value: toml::Value) -> Option<()> {
    let (tables, last) = match key.rsplit_once('.') {
        Some((tables, last)) => (tables.split('.').collect(), last),
        None => (Vec::new(), key),
    };
    if last.is_empty() || tables.iter().any(|part| part.is_empty()) {
        return None;
    }
    let mut at = table;
    for part in tables {
        at = at
            .entry(part.to_owned())
            .or_insert_with(|| toml::Value::Table(toml::Table::new()))
            .as_table_mut()?;
    }
    at.insert(last.to_owned(), value);
    Some(())
}

/// Adds the nearest known key to serde's message about an unknown one.
pub(crate) fn with_suggestion(key: &str, message: &str) -> String {
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
    fn tables_and_their_overrides_are_named_in_errors() {
        let table: toml::Table = "[run]\nseed = 3\n".parse().unwrap();
        let assembled = |set: &[(&str, toml::Value)]| {
            let set: Vec<_> = set
                .iter()
                .map(|(k, v)| ((*k).to_owned(), v.clone()))
                .collect();
            assemble(Base::Table(table.clone()), &set)
        };
        assert_eq!(assembled(&[]).unwrap().run.seed, 3);
        assert_eq!(assembled(&[("run.seed", 9.into())]).unwrap().run.seed, 9);
        let message = assembled(&[("run.sede", 9.into())])
            .unwrap_err()
            .to_string();
        assert!(
            message.starts_with("argument `set`: key `run.sede`") && message.contains("`seed`?"),
            "{message}"
        );
        for bad in ["", "run.", ".seed", "run.seed.x"] {
            let message = assembled(&[(bad, 9.into())]).unwrap_err().to_string();
            assert!(
                message.contains("expected a dotted key"),
                "{bad}: {message}"
            );
        }
        let wrong: toml::Table = "[needle]\nlenght_mm = 126\n".parse().unwrap();
        let message = assemble(Base::Table(wrong), &[]).unwrap_err().to_string();
        assert!(
            message.starts_with("argument `config`: key `needle.lenght_mm`"),
            "{message}"
        );
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

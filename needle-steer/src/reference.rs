//! The reference of the configuration as a page, from the commented defaults and the phantom's
//! presets: `docs/CONFIG.md`, which a test holds against this.

use std::fmt::Write;

use phantom::Settings;
use phantom::camera::CameraSettings;
use toml::{Table, Value};

use crate::config::DEFAULT_TOML;

/// Presets whose values stand beside the phantom's keys.
const PRESETS: [&str; 6] = [
    "ideal",
    "paper",
    "harsh",
    "gel-guide",
    "ex-vivo-guide",
    "kinked",
];

const INTRODUCTION: &str = "# Configuration

TOML; every key is optional, unknown keys are refused with the nearest one that exists. A unit stands at
the end of a key's name. `needle-steer config default` prints this as a file with comments, `--set
section.key=value` changes a single key, `needle-steer check FILE` checks a file.

This page is made by `needle-steer config reference`; a test holds it against the code. *Assumed* marks
values that no source gives.
";

/// The whole page, Markdown.
pub fn page() -> String {
    let mut page = INTRODUCTION.to_owned();
    for section in sections(DEFAULT_TOML) {
        if ["phantom", "cameras.simulated"].contains(&section.name.as_str()) {
            continue;
        }
        let _ = write!(page, "\n## `[{}]`", section.name);
        if !section.comment.is_empty() {
            let _ = write!(page, ": {}", section.comment);
        }
        page.push_str("\n\n| key | default | meaning |\n|---|---|---|\n");
        for key in &section.keys {
            let _ = writeln!(
                page,
                "| `{}` | `{}` | {} |",
                key.name, key.value, key.comment
            );
        }
    }
    page.push_str(
        "\n## `[cameras.simulated]`: changes to the simulated cameras that go with the preset\n\n\
         [PHANTOM_CAMERAS.md](PHANTOM_CAMERAS.md) says how the images are made.\n\n",
    );
    let cameras = PRESETS.map(|name| CameraSettings::preset(name).map(Table::try_from));
    let cameras = cameras.into_iter().flatten().flatten();
    presets(
        &mut page,
        &cameras.collect::<Vec<_>>(),
        CameraSettings::meaning,
    );
    page.push_str(
        "\n## `[phantom]`: changes to the preset\n\nThe simulated needle is that of `[needle]` where \
         `[phantom.needle]` does not say otherwise; a run\nprints how they differ. \
         `paper-compliant` is `paper` on the second family of tip laws.\n\
         [PHANTOM.md](PHANTOM.md) says what all this does.\n\n",
    );
    let phantoms = PRESETS.map(|name| Settings::preset(name).map(Table::try_from));
    let phantoms = phantoms.into_iter().flatten().flatten();
    presets(&mut page, &phantoms.collect::<Vec<_>>(), Settings::meaning);
    page
}

struct Section {
    name: String,
    comment: String,
    keys: Vec<Key>,
}

struct Key {
    name: String,
    value: String,
    comment: String,
}

/// Sections, keys and comments of a commented file: a comment stands behind its key or in the
/// lines above it.
fn sections(text: &str) -> Vec<Section> {
    let mut sections: Vec<Section> = Vec::new();
    let mut above: Vec<&str> = Vec::new();
    for line in text.lines() {
        let (code, comment) = line.split_once('#').map_or((line, ""), |(a, b)| (a, b));
        let (code, comment) = (code.trim(), comment.trim());
        if let Some(name) = code.strip_prefix('[').and_then(|c| c.strip_suffix(']')) {
            sections.push(Section {
                name: name.to_owned(),
                comment: comment.to_owned(),
                keys: Vec::new(),
            });
            above.clear();
        } else if let Some((name, value)) = code.split_once('=') {
            above.extend((!comment.is_empty()).then_some(comment));
            if let Some(section) = sections.last_mut() {
                section.keys.push(Key {
                    name: name.trim().to_owned(),
                    value: value.trim().to_owned(),
                    comment: above.join(" ").replace('|', "\\|"),
                });
            }
            above.clear();
        } else if comment.is_empty() {
            above.clear();
        } else {
            above.push(comment);
        }
    }
    sections
}

/// A table of keys, what they mean, and their values in presets.
fn presets(page: &mut String, presets: &[Table], meaning: fn(&str) -> Option<&'static str>) {
    page.push_str("| key | meaning |");
    for name in PRESETS {
        let _ = write!(page, " `{name}` |");
    }
    page.push_str("\n|---|---|");
    page.push_str(&"---|".repeat(PRESETS.len()));
    page.push('\n');
    for key in presets.first().map(keys).unwrap_or_default() {
        let meaning = meaning(&key).unwrap_or_default();
        let meaning = meaning.replace('\n', " ").replace('|', "\\|");
        let _ = write!(page, "| `{key}` | {meaning} |");
        for preset in presets {
            let value = match key.split_once('.') {
                Some((table, key)) => preset.get(table).and_then(|table| table.get(key)),
                None => preset.get(&key),
            };
            let _ = write!(
                page,
                " {} |",
                value.map_or_else(String::new, Value::to_string)
            );
        }
        page.push('\n');
    }
}

/// All keys, those of tables as `table.key`.
fn keys(table: &Table) -> Vec<String> {
    let of = |(name, value): (&String, &Value)| match value {
        Value::Table(inner) => inner.keys().map(|key| format!("{name}.{key}")).collect(),
        _ => vec![name.clone()],
    };
    table.iter().flat_map(of).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    type Meaning = fn(&str) -> Option<&'static str>;

    #[test]
    fn comments_go_with_their_keys() {
        let found = sections("# file\n\n[a] # about a\nx = 1 # one\n# two\n# lines\ny = \"z\"\n");
        assert_eq!(found[0].comment, "about a");
        let key = |k: usize| {
            let key = &found[0].keys[k];
            (key.name.as_str(), key.value.as_str(), key.comment.as_str())
        };
        assert_eq!(key(0), ("x", "1", "one"));
        assert_eq!(key(1), ("y", "\"z\"", "two lines"));
    }

    #[test]
    fn the_page_in_the_docs_is_current() {
        let file = concat!(env!("CARGO_MANIFEST_DIR"), "/../docs/CONFIG.md");
        let written = std::fs::read_to_string(file).unwrap();
        assert!(
            written == page(),
            "docs/CONFIG.md is old: needle-steer config reference > docs/CONFIG.md"
        );
    }

    #[test]
    fn every_key_of_the_defaults_has_a_meaning() {
        let mut count = 0;
        for section in sections(DEFAULT_TOML) {
            for key in section.keys {
                count += 1;
                assert!(!key.comment.is_empty(), "{}.{}", section.name, key.name);
            }
        }
        assert!(count > 80, "{count}");
        let tables: [(_, Meaning); 2] = [
            (Table::try_from(Settings::default()), Settings::meaning),
            (
                Table::try_from(CameraSettings::default()),
                CameraSettings::meaning,
            ),
        ];
        for (table, meaning) in tables {
            for key in keys(&table.unwrap()) {
                assert!(meaning(&key).is_some(), "{key}");
            }
        }
    }
}

//! The laws, selected by name.

mod base_only;
mod bevel_steering;
mod broyden;
mod guard;
mod hybrid;
mod none;
mod paper;
mod tip_only;

use crate::settings::{LawSettings, PaperSettings};
use crate::view::Law;
pub use guard::guarded;

/// Names of all laws.
pub const LAW_NAMES: [&str; 7] = [
    "none",
    "tip-only",
    "base-only",
    "paper",
    "paper-verbatim",
    "broyden",
    "hybrid",
];

/// Why there is no such law.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum LawError {
    /// No law has this name.
    #[error("unknown law `{name}`{}; known: {}", hint(suggestion.as_ref()), LAW_NAMES.join(", "))]
    UnknownLaw {
        /// The name asked for.
        name: String,
        /// The nearest known name, if one is near.
        suggestion: Option<&'static str>,
    },
    /// A setting is outside its range.
    #[error("{key} = {value}: expected {expected}")]
    BadSetting {
        /// The setting's key.
        key: &'static str,
        /// Its value.
        value: f64,
        /// What is expected.
        expected: &'static str,
    },
}

fn hint(suggestion: Option<&&'static str>) -> String {
    suggestion.map_or_else(String::new, |s| format!(", did you mean `{s}`?"))
}

/// The law of that name, guarded: see [`Law`]'s contract.
///
/// # Errors
/// An unknown name, with the nearest known one; a setting outside its range.
pub fn law_by_name(name: &str, settings: &LawSettings) -> Result<Box<dyn Law>, LawError> {
    settings.validate()?;
    let paper = &settings.paper;
    let verbatim = PaperSettings {
        omega_z_max_deg_s: paper.omega_z_max_deg_s,
        stretch_gain_per_s: paper.stretch_gain_per_s,
        stretch_task: paper.stretch_task,
        cycle_length_mm: paper.cycle_length_mm,
        natural_curvature_per_m: paper.natural_curvature_per_m,
        ..PaperSettings::verbatim()
    };
    let law: Box<dyn Law> = match name {
        "none" => Box::new(none::Straight),
        "tip-only" => Box::new(tip_only::TipOnly::new(paper)),
        "base-only" => Box::new(base_only::BaseOnly::new(paper)),
        "paper" => Box::new(paper::Paper::new("paper", paper)),
        "paper-verbatim" => Box::new(paper::Paper::new("paper-verbatim", &verbatim)),
        "broyden" => Box::new(broyden::Broyden::new(&settings.broyden)),
        "hybrid" => Box::new(hybrid::Hybrid::new(&settings.hybrid)),
        _ => {
            return Err(LawError::UnknownLaw {
                name: name.to_owned(),
                suggestion: nearest(name),
            });
        }
    };
    Ok(guarded(law))
}

/// The known name within three edits, if there is one.
fn nearest(name: &str) -> Option<&'static str> {
    LAW_NAMES
        .into_iter()
        .map(|known| (edits(name, known), known))
        .min_by_key(|(distance, _)| *distance)
        .filter(|(distance, _)| *distance <= 3)
        .map(|(_, known)| known)
}

/// Levenshtein distance.
fn edits(a: &str, b: &str) -> usize {
    let b: Vec<char> = b.chars().collect();
    let mut row: Vec<usize> = (0..=b.len()).collect();
    for (i, ca) in a.chars().enumerate() {
        let mut diagonal = row[0];
        row[0] = i + 1;
        for (j, cb) in b.iter().enumerate() {
            let substituted = diagonal + usize::from(ca != *cb);
            diagonal = row[j + 1];
            row[j + 1] = substituted.min(row[j] + 1).min(diagonal + 1);
        }
    }
    row[b.len()]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_name_gives_its_law_and_others_a_suggestion() {
        for name in LAW_NAMES {
            assert_eq!(
                law_by_name(name, &LawSettings::default()).unwrap().name(),
                name
            );
        }
        let error = law_by_name("hybird", &LawSettings::default())
            .err()
            .unwrap();
        assert!(
            error.to_string().contains("did you mean `hybrid`?"),
            "{error}"
        );
        let error = law_by_name("something else", &LawSettings::default())
            .err()
            .unwrap();
        assert!(!error.to_string().contains("did you mean"), "{error}");
    }
}

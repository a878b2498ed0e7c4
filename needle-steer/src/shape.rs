//! The equilibrium of the needle model for a given state, from JSON: what `shape` prints.

use needle_model::{Case, CaseShape};
use serde::Deserialize;

/// A case that cannot be read or has no equilibrium: place and problem.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct ShapeError(String);

/// One case as the reference data hold it; what they expect is not read.
#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct CaseFile {
    #[serde(default, rename = "name")]
    _name: serde::de::IgnoredAny,
    #[serde(default, rename = "inserting")]
    _inserting: serde::de::IgnoredAny,
    #[serde(default, rename = "expected")]
    _expected: serde::de::IgnoredAny,
    needle: NeedleEntry,
    world_from_base: [[f64; 4]; 4],
    tip_force_n: f64,
    tip_moment_nm: f64,
    springs: Vec<SpringEntry>,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct NeedleEntry {
    length_m: f64,
    outer_diameter_m: f64,
    inner_diameter_m: f64,
    young_modulus_pa: f64,
}

#[derive(Deserialize)]
#[serde(deny_unknown_fields)]
struct SpringEntry {
    rest_m: [f64; 3],
    stiffness_n_per_m: f64,
}

/// Solves the case that `text` (JSON) states.
///
/// # Errors
/// The place in the text and what is wrong there, or why there is no equilibrium.
pub fn solve(text: &str) -> Result<CaseShape, ShapeError> {
    let reader = &mut serde_json::Deserializer::from_str(text);
    let case: CaseFile = serde_path_to_error::deserialize(&mut *reader).map_err(|e| {
        let (place, problem) = (e.path().to_string(), e.inner());
        // At the top there is no key to name.
        if place == "." {
            ShapeError(format!("not the JSON of a case: {problem}"))
        } else {
            ShapeError(format!("{place}: {problem}"))
        }
    })?;
    reader
        .end()
        .map_err(|e| ShapeError(format!("after the case: {e}")))?;
    Case::from(case)
        .solve()
        .map_err(|e| ShapeError(e.to_string()))
}

impl From<CaseFile> for Case {
    fn from(file: CaseFile) -> Self {
        Self {
            length_m: file.needle.length_m,
            outer_diameter_m: file.needle.outer_diameter_m,
            inner_diameter_m: file.needle.inner_diameter_m,
            young_modulus_pa: file.needle.young_modulus_pa,
            world_from_base: file.world_from_base,
            tip_force_n: file.tip_force_n,
            tip_moment_nm: file.tip_moment_nm,
            springs: file
                .springs
                .iter()
                .map(|s| (s.rest_m, s.stiffness_n_per_m))
                .collect(),
        }
    }
}

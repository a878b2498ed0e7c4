//! `shape`: the equilibrium of the needle model for a given state.

use std::path::PathBuf;
use std::process::ExitCode;

use clap::Args;
use needle_model::{Case, CaseShape};
use serde::{Deserialize, Serialize};

use super::{Usage, print_json};

/// Equilibrium of the needle model for a given state, as JSON.
#[derive(Debug, Args)]
pub(super) struct ShapeArgs {
    /// The state (JSON): needle, base pose, tip load, springs.
    case: PathBuf,
}

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

#[derive(Serialize)]
struct ShapeOutput<'a> {
    tip_m: [f64; 3],
    tip_direction: [f64; 3],
    spring_points_m: &'a [[f64; 3]],
    shape: &'a [[f64; 4]],
    j_tip_base: [[f64; 6]; 6],
    iterations: usize,
    residual: f64,
}

pub(super) fn shape(args: &ShapeArgs) -> anyhow::Result<ExitCode> {
    let file = args.case.display();
    let text = std::fs::read_to_string(&args.case)
        .map_err(|e| Usage(format!("{file}: cannot be read: {e}")))?;
    let reader = &mut serde_json::Deserializer::from_str(&text);
    let case: CaseFile = serde_path_to_error::deserialize(&mut *reader)
        .map_err(|e| Usage(format!("{file}: {}: {}", e.path(), e.inner())))?;
    reader
        .end()
        .map_err(|e| Usage(format!("{file}: after the case: {e}")))?;
    let solved = Case::from(case)
        .solve()
        .map_err(|e| Usage(format!("{file}: {e}")))?;
    let CaseShape {
        tip_m,
        tip_direction,
        j_tip_base,
        iterations,
        residual,
        ..
    } = solved;
    print_json(&ShapeOutput {
        tip_m,
        tip_direction,
        spring_points_m: &solved.spring_points_m,
        shape: &solved.shape,
        j_tip_base,
        iterations,
        residual,
    })?;
    Ok(ExitCode::SUCCESS)
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

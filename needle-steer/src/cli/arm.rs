//! `fk` and `ik`: kinematics of any arm with a URDF.

use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context;
use clap::Args;
use hal::Joints;
use nalgebra::{Isometry3, Matrix3, Matrix4, Rotation3, UnitQuaternion, Vector3};
use robots::kinematics::{Chain, Section, Turns};
use serde::Serialize;

use super::{Usage, print_json};

/// The arm.
#[derive(Debug, Args)]
pub(super) struct ArmArgs {
    /// URDF file.
    #[arg(long)]
    urdf: PathBuf,
    /// Link at the end of the chain.
    #[arg(long)]
    tip: String,
    /// Link at which the chain begins; by default the URDF's root.
    #[arg(long)]
    base: Option<String>,
    /// Hold a joint of the chain still: NAME=VALUE, the value in rad, or m of a prismatic joint.
    #[arg(long, value_name = "NAME=VALUE", allow_hyphen_values = true)]
    hold: Vec<String>,
    /// Take prismatic joints and any number of joints up to seven: guides, stages, arms on rails.
    /// Positions of prismatic joints are in metres.
    #[arg(long)]
    mechanism: bool,
}

impl ArmArgs {
    fn chain(&self) -> anyhow::Result<Chain> {
        let file = self.urdf.display();
        let bytes =
            std::fs::read(&self.urdf).map_err(|e| Usage(format!("{file}: cannot be read: {e}")))?;
        let mut section = if self.mechanism {
            Section::mechanism(&self.tip)
        } else {
            Section::arm(&self.tip)
        };
        if let Some(base) = &self.base {
            section = section.from(base);
        }
        for text in &self.hold {
            let value = text
                .rsplit_once('=')
                .and_then(|(name, value)| Some((name, value.trim().parse::<f64>().ok()?)));
            let Some((name, value)) = value else {
                let problem = format!("--hold={text}: expected NAME=VALUE");
                return Err(Usage(problem).into());
            };
            section = section.holding(name.trim(), value);
        }
        let chain = Chain::from_section(&bytes, &section);
        Ok(chain.map_err(|e| Usage(e.in_file(&self.urdf)))?)
    }
}

/// Forward kinematics: pose and Jacobian of the tip.
#[derive(Debug, Args)]
pub(super) struct FkArgs {
    #[command(flatten)]
    arm: ArmArgs,
    /// Joint positions [rad], comma-separated; once for each pose.
    #[arg(long, required = true, allow_hyphen_values = true)]
    joints: Vec<String>,
    /// Accepted for symmetry; the output is always JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct FkItem {
    transform: [[f64; 4]; 4],
    jacobian: Vec<Vec<f64>>,
}

pub(super) fn fk(args: &FkArgs) -> anyhow::Result<ExitCode> {
    let chain = args.arm.chain()?;
    let mut items = Vec::with_capacity(args.joints.len());
    for text in &args.joints {
        let q = numbers(text, chain.len(), "--joints")?;
        let q = Joints::from_slice(&q).context("--joints")?;
        let (pose, jacobian) = chain.forward_jacobian(&q);
        items.push(FkItem {
            transform: rows(&pose.to_homogeneous()),
            jacobian: (0..6)
                .map(|i| (0..chain.len()).map(|j| jacobian[(i, j)]).collect())
                .collect(),
        });
    }
    print_json(&items)?;
    Ok(ExitCode::SUCCESS)
}

/// Inverse kinematics: every joint vector inside the limits that reaches a pose.
#[derive(Debug, Args)]
pub(super) struct IkArgs {
    #[command(flatten)]
    arm: ArmArgs,
    /// Pose of the tip in the base: homogeneous 4x4 matrix, 16 numbers row by row,
    /// comma-separated, metres; once for each pose.
    #[arg(long, required = true, allow_hyphen_values = true)]
    pose: Vec<String>,
    /// Also solutions that differ by full turns of a joint.
    #[arg(long)]
    all_turns: bool,
    /// Accepted for symmetry; the output is always JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct IkItem {
    solutions: Vec<Joints>,
    /// Whether these are all; if not, none does not mean out of reach.
    exhaustive: bool,
}

pub(super) fn ik(args: &IkArgs) -> anyhow::Result<ExitCode> {
    let chain = args.arm.chain()?;
    let turns = if args.all_turns {
        Turns::All
    } else {
        Turns::One
    };
    let mut items = Vec::with_capacity(args.pose.len());
    for text in &args.pose {
        items.push(IkItem {
            solutions: chain.inverse(&pose(text)?, turns),
            exhaustive: chain.is_exhaustive(),
        });
    }
    print_json(&items)?;
    Ok(ExitCode::SUCCESS)
}

/// Distance beyond which no arm with its rail reaches \[m\].
const FARTHEST: f64 = 20.0;
/// Deviation from a rotation that is taken for rounding of the text.
const ORTHONORMAL: f64 = 1e-6;

fn pose(text: &str) -> Result<Isometry3<f64>, Usage> {
    let m = Matrix4::from_row_slice(&numbers(text, 16, "--pose")?);
    let rotation: Matrix3<f64> = m.fixed_view::<3, 3>(0, 0).into_owned();
    let off = (rotation * rotation.transpose() - Matrix3::identity())
        .abs()
        .max();
    let bottom = (m[(3, 0)], m[(3, 1)], m[(3, 2)], m[(3, 3)]);
    let determinant = rotation.determinant();
    let away = m.fixed_view::<3, 1>(0, 3).norm();
    let problem = if off > ORTHONORMAL || bottom != (0.0, 0.0, 0.0, 1.0) {
        format!("not a homogeneous transform: rotation off by {off:.1e}, last row {bottom:?}")
    } else if determinant < 0.0 {
        "a mirrored pose: its determinant is -1, that of a rotation is +1; one axis has the wrong sign, or two \
         are exchanged"
            .to_owned()
    } else if away > FARTHEST {
        format!("{away:.1} m from the base: are these millimetres? The last column is in metres")
    } else {
        String::new()
    };
    if !problem.is_empty() {
        return Err(Usage(format!("--pose={text}: {problem}")));
    }
    let rotation = Rotation3::from_matrix_unchecked(rotation);
    // The text may be rounded: the rotation next to it.
    let rotation = UnitQuaternion::from_rotation_matrix(&rotation).into_inner();
    Ok(Isometry3::from_parts(
        Vector3::new(m[(0, 3)], m[(1, 3)], m[(2, 3)]).into(),
        UnitQuaternion::new_normalize(rotation),
    ))
}

/// Exactly `count` finite numbers, separated by commas or white space.
pub(super) fn numbers(text: &str, count: usize, option: &str) -> Result<Vec<f64>, Usage> {
    let values: Result<Vec<f64>, Usage> = text
        .split(|c: char| c == ',' || c.is_whitespace())
        .filter(|part| !part.is_empty())
        .map(|part| match part.parse::<f64>() {
            Ok(value) if value.is_finite() => Ok(value),
            _ => Err(Usage(format!(
                "{option}={text}: `{part}` is not a finite number"
            ))),
        })
        .collect();
    let values = values?;
    if values.len() == count {
        Ok(values)
    } else {
        Err(Usage(format!(
            "{option}={text}: expected {count} numbers, found {}",
            values.len()
        )))
    }
}

pub(super) fn rows(m: &Matrix4<f64>) -> [[f64; 4]; 4] {
    core::array::from_fn(|i| core::array::from_fn(|j| m[(i, j)]))
}

//! Predictions of recorded steps held against what was measured.

use nalgebra::{Matrix2x3, Vector2, Vector3};
use serde::Serialize;

use super::fit::IdentifyError;
use super::recording::Recording;
use super::response::{Change, Response, measured};
use super::steps::{LeftOut, Row, Steps, advance, counts};
use crate::config::Config;

/// Predictions against measurements, over the steps with 3 to 8 mm of advance and a motion of the
/// support of at least 0.3 mm.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Validation {
    /// Number of steps times two axes.
    pub changes: usize,
    /// Changes of the tip's axis.
    pub axis: AxisScore,
    /// Changes of the tip's position across the insertion.
    pub tip: TipScore,
    /// Parts of recordings that do not count.
    pub left_out: Vec<LeftOut>,
    /// Each file by itself.
    pub files: Vec<FileScore>,
    /// Predicted and measured changes of every counted step, for the page.
    #[serde(skip)]
    pub curves: Curves,
}

/// Predicted and measured changes, two numbers a step.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Curves {
    /// Of the axis \[mrad\]: predicted, measured.
    pub axis_mrad: Vec<(f64, f64)>,
    /// Of the position \[mm\]: predicted, measured.
    pub tip_mm: Vec<(f64, f64)>,
}

/// How well changes of the axis are predicted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct AxisScore {
    /// Root mean square of the measured changes less their mean per axis \[mrad\].
    pub rms_mrad: f64,
    /// Root mean square left after the prediction with the configuration's drift \[mrad\].
    pub unexplained_mrad: f64,
    /// 1 - unexplained^2 / rms^2.
    pub r2: f64,
    /// Slope of measured over predicted changes.
    pub slope: f64,
}

/// How well changes of the position are predicted, as root mean squares \[mm\].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct TipScore {
    /// Of the model.
    pub rms_mm: f64,
    /// Of "stays as it was".
    pub persistence_mm: f64,
    /// Of a straight line: the tip goes on along the axis that was measured at the beginning of the step,
    /// by as much as it advances; the support does nothing.
    pub straight_mm: f64,
    /// Of a Jacobian of support and advance that is learnt online (Broyden), from nothing.
    pub broyden_mm: f64,
}

/// One file's scores.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct FileScore {
    /// The file.
    pub file: String,
    /// Number of steps times two axes.
    pub changes: usize,
    /// The axis.
    pub axis: AxisScore,
    /// The position.
    pub tip: TipScore,
}

/// One counted step.
#[derive(Clone, Copy, Debug)]
struct Step {
    seen: Change,
    predicted: Change,
    straight: Vector2<f64>,
    broyden: Vector2<f64>,
}

/// Holds recordings against the configuration's needle.
///
/// # Errors
/// The configuration's dimensions make no needle, or no step counts.
pub fn validate(recordings: &[Recording], config: &Config) -> Result<Validation, IdentifyError> {
    let mut all = Vec::new();
    let (mut files, mut left_out) = (Vec::new(), Vec::new());
    for recording in recordings {
        let steps = Steps::of(recording);
        if !steps.has_axis {
            return Err(IdentifyError::NoAxis {
                name: recording.name.clone(),
            });
        }
        let gap = steps.rows.first().map_or(0.0, |row| row.place.gap);
        let response = Response::of(config, gap).map_err(|source| IdentifyError::Needle {
            name: recording.name.clone(),
            source,
        })?;
        let counted = counted(&steps, &response);
        let (axis, tip) = score(&counted);
        files.push(FileScore {
            file: recording.name.clone(),
            changes: 2 * counted.len(),
            axis,
            tip,
        });
        left_out.extend(steps.left_out);
        all.extend(counted);
    }
    if all.is_empty() {
        return Err(IdentifyError::NoSteps);
    }
    let (axis, tip) = score(&all);
    Ok(Validation {
        changes: 2 * all.len(),
        axis,
        tip,
        left_out,
        files,
        curves: curves(&all),
    })
}

fn curves(steps: &[Step]) -> Curves {
    let mut curves = Curves::default();
    for step in steps {
        for k in 0..2 {
            let (said, seen) = (&step.predicted, &step.seen);
            curves
                .axis_mrad
                .push((said.axis[k] * 1e3, seen.axis[k] * 1e3));
            curves.tip_mm.push((said.tip[k] * 1e3, seen.tip[k] * 1e3));
        }
    }
    curves
}

fn counted(steps: &Steps, response: &Response) -> Vec<Step> {
    let predicted = response.predict(steps);
    let seen = measured(steps);
    let mut broyden = Broyden::default();
    let mut found = Vec::new();
    for ((rows, predicted), seen) in steps.rows.windows(2).zip(predicted).zip(seen) {
        let step = Step {
            seen,
            predicted,
            straight: rows[0].slope * advance(&rows[0], &rows[1]),
            broyden: broyden.predict(&rows[0], &rows[1]),
        };
        broyden.learn(&rows[0], &rows[1], seen.tip);
        if counts(&rows[0], &rows[1]) {
            found.push(step);
        }
    }
    found
}

/// Jacobian of the tip's lateral position by the support's and by the advance, learnt step by step.
#[derive(Debug, Default)]
struct Broyden {
    jacobian: Matrix2x3<f64>,
}

impl Broyden {
    fn motion(before: &Row, after: &Row) -> Vector3<f64> {
        let moved = after.place.support - before.place.support;
        Vector3::new(moved.x, moved.y, advance(before, after))
    }

    fn predict(&self, before: &Row, after: &Row) -> Vector2<f64> {
        self.jacobian * Self::motion(before, after)
    }

    fn learn(&mut self, before: &Row, after: &Row, change: Vector2<f64>) {
        let motion = Self::motion(before, after);
        let square = motion.norm_squared();
        if square > 0.0 {
            self.jacobian += (change - self.jacobian * motion) * motion.transpose() / square;
        }
    }
}

fn score(steps: &[Step]) -> (AxisScore, TipScore) {
    if steps.is_empty() {
        return (AxisScore::default(), TipScore::default());
    }
    let n = steps.len() as f64;
    let mean = |of: fn(&Step) -> Vector2<f64>| steps.iter().map(of).sum::<Vector2<f64>>() / n;
    let (seen, said) = (mean(|s| s.seen.axis), mean(|s| s.predicted.axis));
    let rms = |of: &dyn Fn(&Step) -> Vector2<f64>| {
        let square: f64 = steps.iter().map(|s| of(s).norm_squared()).sum();
        (square / (2.0 * n)).sqrt()
    };
    let spread = rms(&|s| s.seen.axis - seen);
    let left = rms(&|s| s.seen.axis - s.predicted.axis);
    let square: f64 = steps
        .iter()
        .map(|s| (s.predicted.axis - said).norm_squared())
        .sum();
    let product: f64 = steps
        .iter()
        .map(|s| (s.predicted.axis - said).dot(&(s.seen.axis - seen)))
        .sum();
    let axis = AxisScore {
        rms_mrad: spread * 1e3,
        unexplained_mrad: left * 1e3,
        r2: 1.0 - (left / spread).powi(2),
        slope: product / square,
    };
    let tip = TipScore {
        rms_mm: rms(&|s| s.seen.tip - s.predicted.tip) * 1e3,
        persistence_mm: rms(&|s| s.seen.tip) * 1e3,
        straight_mm: rms(&|s| s.seen.tip - s.straight) * 1e3,
        broyden_mm: rms(&|s| s.seen.tip - s.broyden) * 1e3,
    };
    (axis, tip)
}

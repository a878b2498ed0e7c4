//! How the tip answers to a step: the beam on its bed, drifts learnt before, and what the first
//! millimetres do otherwise.

use nalgebra::Vector2;

use super::bed::Bed;
use super::steps::{Steps, advance};
use crate::config::Config;
use crate::springs;

/// Share of the model's elastic motion that the tip shows, and what is taken from it and from the
/// way along the axis at the surface, fading with depth over `FADE`: there the tip is held better
/// than the bed says. Fitted on five conditions of Bernardes et al. 2022 (docs/REAL_NEEDLES.md).
const ELASTIC: f64 = 0.8;
const ELASTIC_AT_SURFACE: f64 = -2.0;
const ALONG_AT_SURFACE: f64 = -3.0;
const FADE: f64 = 15e-3;
/// Share of the last step's error of the tip that the next step repeats; same source.
const REPEATED: f64 = 0.2;

/// A needle in its tissue as its tip sensor shows it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Response {
    pub(super) bed: Bed,
    /// Change of the measured slope that no motion explains: bevel and sensor \[rad/m\].
    pub(super) axis_drift: Vector2<f64>,
    /// The same of the measured position \[m/m\].
    pub(super) tip_drift: Vector2<f64>,
}

/// Change over one step.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Change {
    /// Of the slope.
    pub(super) axis: Vector2<f64>,
    /// Of the position across the insertion \[m\].
    pub(super) tip: Vector2<f64>,
}

impl Response {
    /// As the configuration says, for a recording whose support is at `gap` first.
    pub(super) fn of(config: &Config, gap: f64) -> Result<Self, needle_model::NeedleError> {
        let needle = &config.needle;
        let wave_length = match config.estimator.wave_length_mm {
            given if given > 0.0 => given * 1e-3,
            _ => {
                let bending = springs::needle(config)?.bending_stiffness();
                (4.0 * bending / config.estimator.stiffness_n_m2).powf(0.25)
            }
        };
        Ok(Self {
            bed: Bed {
                wave_length,
                farther: match needle.guide_gap_mm {
                    given if given > 0.0 => given * 1e-3 - gap,
                    _ => 0.0,
                },
                setback: needle.sensor_setback_mm * 1e-3,
            },
            axis_drift: Vector2::from(needle.axis_drift_rad_per_m),
            tip_drift: Vector2::from(needle.tip_drift_mm_per_m) * 1e-3,
        })
    }

    /// Predicted change at each row but the first, from what was measured at the rows before and
    /// from the step's own motion of the support and advance.
    pub(super) fn predict(&self, steps: &Steps) -> Vec<Change> {
        let answers = self.bed.follow(&steps.places());
        let mut error = Vector2::zeros();
        let mut changes = Vec::with_capacity(answers.len());
        let pairs = steps.rows.windows(2).zip(answers.windows(2));
        for (k, (rows, answers)) in pairs.enumerate() {
            let way = advance(&rows[0], &rows[1]);
            let slope = if steps.has_axis {
                rows[0].slope
            } else {
                answers[0].slope
            };
            let moved = answers[1].moved_position;
            let along = (slope + answers[1].moved_slope) * way;
            let fade = (-(rows[1].place.depth / FADE).powi(2)).exp();
            let tip = moved * (ELASTIC + ELASTIC_AT_SURFACE * fade)
                + along * (1.0 + ALONG_AT_SURFACE * fade)
                + self.tip_drift * way
                + error * REPEATED;
            changes.push(Change {
                axis: answers[1].slope - answers[0].slope + self.axis_drift * way,
                tip,
            });
            // The touch of the surface is no error of the model.
            if k > 0 {
                error = rows[1].tip - rows[0].tip - tip;
            }
        }
        changes
    }
}

/// Measured change at each row but the first.
pub(super) fn measured(steps: &Steps) -> Vec<Change> {
    let change = |rows: &[super::steps::Row]| Change {
        axis: rows[1].slope - rows[0].slope,
        tip: rows[1].tip - rows[0].tip,
    };
    steps.rows.windows(2).map(change).collect()
}

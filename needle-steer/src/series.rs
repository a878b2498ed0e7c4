//! The time series of a run: one row a law step, as CSV.

use std::io::Write;

use hal::telemetry::{Limit, SteeringMode, Telemetry};
use nalgebra::Vector3;

use crate::monitor::Advance;

/// One law step in the units of plots and tables.
#[derive(Clone, Debug, PartialEq)]
pub struct Row {
    /// Time \[s\].
    pub t_s: f64,
    /// Needle in the tissue \[mm\].
    pub depth_mm: f64,
    /// Measured distance of the target from the tip axis \[mm\].
    pub lateral_error_mm: f64,
    /// The true one; NaN without truth.
    pub true_lateral_error_mm: f64,
    /// Predicted miss at the target \[mm\].
    pub predicted_miss_mm: f64,
    /// Base displacement from its start, in World \[mm\].
    pub base_mm: Vector3<f64>,
    /// Motion of the base along the needle's axis, integrated from its start \[mm\].
    pub advance_mm: f64,
    /// Tilt of the base from its start \[deg\].
    pub tilt_deg: f64,
    /// Last joint \[deg\].
    pub roll_deg: f64,
    /// Stiffness K_T \[N/m2\].
    pub stiffness: f64,
    /// Mean tissue displacement of the model \[mm\].
    pub mean_stretch_mm: f64,
    /// The true mean; NaN without truth.
    pub true_mean_stretch_mm: f64,
    /// How the law steers.
    pub mode: SteeringMode,
    /// Duty cycle.
    pub duty_cycle: f64,
    /// Limits that acted.
    pub limits: Vec<Limit>,
}

/// Makes the rows of a run from its steps, in order.
#[derive(Clone, Debug, Default)]
pub struct Series {
    first: Option<Telemetry>,
    advance: Advance,
}

impl Series {
    /// The row of the next step.
    pub fn row(&mut self, telemetry: &Telemetry) -> Row {
        self.advance
            .push(telemetry.stamp, telemetry.world_from_base.isometry());
        let first = self.first.get_or_insert_with(|| telemetry.clone());
        Row::new(telemetry, first, self.advance.total())
    }
}

/// Names of the columns of the CSV, in the order of [`Row::cells`].
pub const COLUMNS: [&str; 17] = [
    "t_s",
    "depth_mm",
    "lateral_error_mm",
    "true_lateral_error_mm",
    "predicted_miss_mm",
    "base_x_mm",
    "base_y_mm",
    "base_z_mm",
    "tilt_deg",
    "roll_deg",
    "stiffness_n_per_m2",
    "mean_stretch_mm",
    "true_mean_stretch_mm",
    "mode",
    "duty_cycle",
    "limits",
    "advance_mm",
];

/// One field of a row.
#[derive(Clone, Debug, PartialEq)]
pub enum Cell {
    /// A number; not finite where it is not known.
    Number(f64),
    /// Words.
    Words(String),
}

impl Row {
    fn new(telemetry: &Telemetry, start: &Telemetry, advance: f64) -> Self {
        let origin = |t: &Telemetry| t.world_from_base.origin().coords();
        let axis = |t: &Telemetry| t.world_from_base.rotate(&Vector3::z());
        let truth = telemetry.truth.as_ref();
        Self {
            t_s: telemetry.stamp.as_secs(),
            depth_mm: telemetry.depth * 1e3,
            lateral_error_mm: telemetry.lateral_error * 1e3,
            true_lateral_error_mm: truth.map_or(f64::NAN, |t| t.lateral_error * 1e3),
            predicted_miss_mm: telemetry.law.predicted_miss.norm() * 1e3,
            base_mm: (origin(telemetry) - origin(start)) * 1e3,
            advance_mm: advance * 1e3,
            tilt_deg: axis(telemetry).angle(&axis(start)).to_degrees(),
            roll_deg: telemetry
                .joints
                .last()
                .copied()
                .unwrap_or(f64::NAN)
                .to_degrees(),
            stiffness: telemetry.model.stiffness,
            mean_stretch_mm: telemetry.model.mean_stretch * 1e3,
            true_mean_stretch_mm: truth.map_or(f64::NAN, |t| t.mean_stretch * 1e3),
            mode: telemetry.law.mode,
            duty_cycle: telemetry.law.duty_cycle,
            limits: telemetry.law.limits.clone(),
        }
    }

    /// The fields in the order of [`COLUMNS`].
    pub fn cells(&self) -> [Cell; COLUMNS.len()] {
        let limits: Vec<String> = self.limits.iter().map(|l| format!("{l:?}")).collect();
        [
            Cell::Number(self.t_s),
            Cell::Number(self.depth_mm),
            Cell::Number(self.lateral_error_mm),
            Cell::Number(self.true_lateral_error_mm),
            Cell::Number(self.predicted_miss_mm),
            Cell::Number(self.base_mm.x),
            Cell::Number(self.base_mm.y),
            Cell::Number(self.base_mm.z),
            Cell::Number(self.tilt_deg),
            Cell::Number(self.roll_deg),
            Cell::Number(self.stiffness),
            Cell::Number(self.mean_stretch_mm),
            Cell::Number(self.true_mean_stretch_mm),
            Cell::Words(format!("{:?}", self.mode)),
            Cell::Number(self.duty_cycle),
            Cell::Words(limits.join(" ")),
            Cell::Number(self.advance_mm),
        ]
    }
}

/// Writes all rows as CSV; a number that is not known stands as an empty field.
///
/// # Errors
/// The writer fails.
pub fn write_csv(rows: &[Row], mut writer: impl Write) -> std::io::Result<()> {
    writeln!(writer, "{}", COLUMNS.join(","))?;
    for row in rows {
        for (k, cell) in row.cells().iter().enumerate() {
            if k > 0 {
                writer.write_all(b",")?;
            }
            match cell {
                Cell::Number(number) if number.is_finite() => write!(writer, "{number}")?,
                Cell::Number(_) => {}
                Cell::Words(words) => writer.write_all(words.as_bytes())?,
            }
        }
        writer.write_all(b"\n")?;
    }
    writer.flush()
}

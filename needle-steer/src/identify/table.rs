//! Recordings from CSV: base poses and what was seen of the needle, in World.

use std::collections::HashMap;
use std::path::Path;

use hal::Stamp;
use nalgebra::{Isometry3, Point3, Quaternion, Translation3, Unit, UnitQuaternion, Vector3};

use super::recording::{Recording, RecordingError, Seen};
use crate::config::Config;

/// Columns that every row needs: time \[s\], pose of the needle's base, tip O \[m\].
pub const NEEDED: [&str; 11] = [
    "t_s", "base_x_m", "base_y_m", "base_z_m", "base_qx", "base_qy", "base_qz", "base_qw",
    "tip_x_m", "tip_y_m", "tip_z_m",
];
/// Columns that may stand beside them: tip axis, standard deviation of tip and points \[m\],
/// points of the shaft as `x y z;x y z;...` \[m\].
pub const OPTIONAL: [&str; 5] = ["axis_x", "axis_y", "axis_z", "sigma_m", "points_m"];
/// Standard deviation of a point where the file gives none \[m\].
const SIGMA: f64 = 0.25e-3;

impl Recording {
    /// Reads a CSV file; needle and entry come from `config`.
    ///
    /// # Errors
    /// See [`RecordingError`].
    pub fn from_csv(file: &Path, config: &Config) -> Result<Self, RecordingError> {
        let failed = |source| RecordingError::Csv {
            file: file.to_owned(),
            source,
        };
        let mut reader = csv::ReaderBuilder::new()
            .trim(csv::Trim::All)
            .from_path(file)
            .map_err(failed)?;
        let columns: HashMap<String, usize> = reader
            .headers()
            .map_err(failed)?
            .iter()
            .enumerate()
            .map(|(k, name)| (name.to_owned(), k))
            .collect();
        let missing: Vec<&str> = NEEDED
            .into_iter()
            .filter(|name| !columns.contains_key(*name))
            .collect();
        if !missing.is_empty() {
            return Err(RecordingError::Columns {
                file: file.to_owned(),
                missing: missing.join(", "),
            });
        }
        let mut seen: Vec<Seen> = Vec::new();
        for record in reader.records() {
            let record = record.map_err(failed)?;
            let line = record.position().map_or(0, csv::Position::line);
            let row = Fields {
                columns: &columns,
                record: &record,
            };
            let value = |problem| RecordingError::Value {
                file: file.to_owned(),
                line,
                problem,
            };
            let one = row.seen().map_err(value)?;
            if seen.last().is_some_and(|last| last.stamp >= one.stamp) {
                return Err(value(
                    "t_s: expected a later time than in the line before".into(),
                ));
            }
            seen.push(one);
        }
        if seen.is_empty() {
            return Err(RecordingError::Empty {
                file: file.to_owned(),
            });
        }
        Ok(Self {
            name: file.display().to_string(),
            config: config.clone(),
            seen,
        })
    }
}

/// One row.
struct Fields<'a> {
    columns: &'a HashMap<String, usize>,
    record: &'a csv::StringRecord,
}

impl Fields<'_> {
    fn text(&self, name: &str) -> Option<&str> {
        let text = self.record.get(*self.columns.get(name)?)?;
        (!text.is_empty()).then_some(text)
    }

    fn number(&self, name: &str) -> Result<f64, String> {
        let text = self.text(name).unwrap_or_default();
        finite(text).ok_or_else(|| format!("{name}: expected a finite number, found `{text}`"))
    }

    fn vector(&self, names: [&str; 3]) -> Result<Vector3<f64>, String> {
        let [x, y, z] = names;
        Ok(Vector3::new(
            self.number(x)?,
            self.number(y)?,
            self.number(z)?,
        ))
    }

    fn seen(&self) -> Result<Seen, String> {
        let time = self.number("t_s")?;
        if !(0.0..1e9).contains(&time) {
            return Err(format!(
                "t_s: expected a time from 0 to 1e9 s, found {time}"
            ));
        }
        let quaternion = Quaternion::new(
            self.number("base_qw")?,
            self.number("base_qx")?,
            self.number("base_qy")?,
            self.number("base_qz")?,
        );
        if (quaternion.norm() - 1.0).abs() > 1e-3 {
            return Err(format!(
                "base_qx to base_qw: expected a unit quaternion, found one of length {}",
                quaternion.norm()
            ));
        }
        let world_from_base = Isometry3::from_parts(
            Translation3::from(self.vector(["base_x_m", "base_y_m", "base_z_m"])?),
            UnitQuaternion::from_quaternion(quaternion),
        );
        let sigma = match self.text("sigma_m") {
            None => SIGMA,
            Some(text) => finite(text)
                .filter(|s| *s > 0.0)
                .ok_or_else(|| format!("sigma_m: expected a number above 0, found `{text}`"))?,
        };
        let (direction, direction_sigma) = if self.text("axis_x").is_some() {
            let axis = self.vector(["axis_x", "axis_y", "axis_z"])?;
            let axis = Unit::try_new(axis, 1e-6).ok_or("axis_x to axis_z: expected a direction")?;
            (axis, 0.3_f64.to_radians())
        } else {
            (world_from_base.rotation * Vector3::z_axis(), f64::INFINITY)
        };
        Ok(Seen {
            stamp: Stamp::from_secs(time),
            world_from_base,
            tip: self.vector(["tip_x_m", "tip_y_m", "tip_z_m"])?.into(),
            tip_sigma: sigma,
            direction,
            direction_sigma,
            shaft: match self.text("points_m") {
                None => Vec::new(),
                Some(text) => points(text, sigma)?,
            },
        })
    }
}

fn finite(text: &str) -> Option<f64> {
    text.parse::<f64>().ok().filter(|x| x.is_finite())
}

fn points(text: &str, sigma: f64) -> Result<Vec<(Point3<f64>, f64)>, String> {
    text.split(';')
        .map(|point| {
            let numbers: Option<Vec<f64>> = point.split_whitespace().map(finite).collect();
            match numbers.as_deref() {
                Some(&[x, y, z]) => Ok((Point3::new(x, y, z), sigma)),
                _ => Err(format!("points_m: expected `x y z;x y z`, found `{point}`")),
            }
        })
        .collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(name: &str, text: &str) -> Result<Recording, RecordingError> {
        let file = std::env::temp_dir().join(format!("needle-{name}-{}.csv", std::process::id()));
        std::fs::write(&file, text).unwrap();
        let read = Recording::from_csv(&file, &Config::default());
        std::fs::remove_file(&file).unwrap();
        read
    }

    const HEAD: &str = "t_s,base_x_m,base_y_m,base_z_m,base_qx,base_qy,base_qz,base_qw,tip_x_m,\
        tip_y_m,tip_z_m,points_m";

    #[test]
    fn rows_are_read_and_what_is_wrong_is_named() {
        let good = format!("{HEAD}\n0,0.4,0,0.376,1,0,0,0,0.4,0,0.25,0.4 0 0.26;0.4 0 0.27\n");
        let read_back = read("good", &good).unwrap();
        assert_eq!(read_back.seen[0].shaft.len(), 2);
        let axis = read_back.seen[0].world_from_base.rotation * Vector3::z();
        assert!((axis + Vector3::z()).norm() < 1e-12);
        let cases = [
            (
                good.replace("tip_z_m,", ""),
                "the columns tip_z_m are missing",
            ),
            (
                good.replace("0.376", "nan"),
                ":2: base_z_m: expected a finite number",
            ),
            (good.replace("1,0,0,0,", "1,1,0,0,"), "unit quaternion"),
            (
                good.replace("0.4 0 0.27", "0.4 0"),
                "expected `x y z;x y z`",
            ),
            (format!("{HEAD}\n"), "no measurement"),
            (format!("{good}0,1,2\n"), "found record with 3 fields"),
        ];
        for (k, (text, expected)) in cases.iter().enumerate() {
            let message = read(&format!("bad{k}"), text).unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}

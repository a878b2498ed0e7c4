//! Where two recorded runs part: configuration, measurements, commands, outcome.

use std::path::{Path, PathBuf};

use hal::telemetry::Telemetry;
use hal::{ArmState, SensedShape};
use rosbridge::log::{LogReader, ReadError, Record};
use serde::Serialize;

use crate::replay::same_bits;

/// A log that cannot be compared.
#[derive(Debug, thiserror::Error)]
#[error("{}", file.display())]
pub struct DiffError {
    /// The log.
    pub file: PathBuf,
    /// Why.
    pub source: ReadError,
}

/// A key of the configuration that differs.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ChangedKey {
    /// Dotted path.
    pub key: String,
    /// Value in the first log; null where it is missing.
    pub first: Option<String>,
    /// Value in the second.
    pub second: Option<String>,
}

/// A moment at which two runs part.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Moment {
    /// Number of the step.
    pub step: u64,
    /// Time in the first run \[s\].
    pub time_s: f64,
    /// Needle in the tissue in the first run \[mm\].
    pub depth_mm: f64,
}

/// What differs between two runs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunDiff {
    /// Keys of the configuration that differ.
    pub config: Vec<ChangedKey>,
    /// Versions that wrote the logs.
    pub versions: [String; 2],
    /// Steps of each run.
    pub steps: [u64; 2],
    /// The first step that read something else: from here on the world differs.
    pub measurements: Option<Moment>,
    /// The first step whose joint rates differ: from here on the decisions differ.
    pub commands: Option<Moment>,
    /// Largest distance between the two bases at equal steps \[mm\].
    pub largest_base_distance_mm: f64,
    /// Largest distance between the two estimated tips at equal steps \[mm\].
    pub largest_tip_distance_mm: f64,
    /// Results (`summary.json`) where the logs have them.
    pub results: [Option<serde_json::Value>; 2],
}

impl RunDiff {
    /// Whether both runs read and did the same, bit by bit.
    pub const fn is_same(&self) -> bool {
        self.measurements.is_none() && self.commands.is_none() && self.steps[0] == self.steps[1]
    }
}

/// Compares two logs.
///
/// # Errors
/// One cannot be read, or is damaged inside.
pub fn diff(first: &Path, second: &Path) -> Result<RunDiff, DiffError> {
    let mut runs = [Course::open(first)?, Course::open(second)?];
    let mut diff = RunDiff {
        config: changed_keys(&runs[0].log.run().config, &runs[1].log.run().config),
        versions: [runs[0].version(), runs[1].version()],
        steps: [0, 0],
        measurements: None,
        commands: None,
        largest_base_distance_mm: 0.0,
        largest_tip_distance_mm: 0.0,
        results: [None, None],
    };
    loop {
        let [a, b] = &mut runs;
        let (a, b) = (a.step()?, b.step()?);
        diff.steps[0] += u64::from(a.is_some());
        diff.steps[1] += u64::from(b.is_some());
        match (a, b) {
            (None, None) => break,
            (Some(a), Some(b)) => diff.compare(&a, &b),
            _ => {}
        }
    }
    diff.results = runs.map(|run| run.result);
    Ok(diff)
}

impl RunDiff {
    fn compare(&mut self, a: &Step, b: &Step) {
        let moment = Moment {
            step: a.telemetry.step,
            time_s: a.telemetry.stamp.as_secs(),
            depth_mm: a.telemetry.depth * 1e3,
        };
        if self.measurements.is_none() && !a.same_inputs(b) {
            self.measurements = Some(moment);
        }
        if self.commands.is_none() && !same_bits(&a.telemetry.joint_rates, &b.telemetry.joint_rates)
        {
            self.commands = Some(moment);
        }
        let (a, b) = (&a.telemetry, &b.telemetry);
        let base = a.world_from_base.origin().coords() - b.world_from_base.origin().coords();
        let tip = a.world_from_tip.origin().coords() - b.world_from_tip.origin().coords();
        self.largest_base_distance_mm = self.largest_base_distance_mm.max(base.norm() * 1e3);
        self.largest_tip_distance_mm = self.largest_tip_distance_mm.max(tip.norm() * 1e3);
    }
}

/// A step with what it read.
struct Step {
    arm: Option<ArmState>,
    shape: Option<SensedShape>,
    telemetry: Box<Telemetry>,
}

impl Step {
    fn same_inputs(&self, other: &Self) -> bool {
        let arm = match (&self.arm, &other.arm) {
            (Some(a), Some(b)) => a.stamp == b.stamp && same_bits(&a.positions, &b.positions),
            (a, b) => a.is_none() && b.is_none(),
        };
        arm && self.shape == other.shape
            && self.telemetry.stamp == other.telemetry.stamp
            && self.telemetry.phase == other.telemetry.phase
            && self.telemetry.target == other.telemetry.target
    }
}

/// The steps of a log.
struct Course {
    file: PathBuf,
    log: LogReader<std::io::BufReader<std::fs::File>>,
    result: Option<serde_json::Value>,
}

impl Course {
    fn open(file: &Path) -> Result<Self, DiffError> {
        let log = LogReader::open(file).map_err(|source| DiffError {
            file: file.to_owned(),
            source,
        })?;
        Ok(Self {
            file: file.to_owned(),
            log,
            result: None,
        })
    }

    fn version(&self) -> String {
        let version = self.log.run().versions.get("needle-steer");
        version.cloned().unwrap_or_else(|| "unknown".into())
    }

    fn step(&mut self) -> Result<Option<Step>, DiffError> {
        let (mut arm, mut shape) = (None, None);
        for record in self.log.by_ref() {
            let record = record.map_err(|source| DiffError {
                file: self.file.clone(),
                source,
            })?;
            match record {
                Record::Arm(state) => arm = Some(state),
                Record::Shape(seen) => shape = Some(seen),
                Record::Document { name, text } if name == "summary.json" => {
                    self.result = serde_json::from_str(&text).ok();
                }
                Record::Step(telemetry) => {
                    return Ok(Some(Step {
                        arm,
                        shape,
                        telemetry,
                    }));
                }
                _ => {}
            }
        }
        Ok(None)
    }
}

fn changed_keys(first: &str, second: &str) -> Vec<ChangedKey> {
    let table = |text: &str| text.parse::<toml::Table>().unwrap_or_default();
    let mut changed = Vec::new();
    collect("", &table(first), &table(second), &mut changed);
    changed
}

fn collect(prefix: &str, a: &toml::Table, b: &toml::Table, changed: &mut Vec<ChangedKey>) {
    let keys: std::collections::BTreeSet<&String> = a.keys().chain(b.keys()).collect();
    for key in keys {
        let path = if prefix.is_empty() {
            key.clone()
        } else {
            format!("{prefix}.{key}")
        };
        match (a.get(key), b.get(key)) {
            (Some(toml::Value::Table(a)), Some(toml::Value::Table(b))) => {
                collect(&path, a, b, changed);
            }
            (a, b) if a != b => changed.push(ChangedKey {
                key: path,
                first: a.map(ToString::to_string),
                second: b.map(ToString::to_string),
            }),
            _ => {}
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn changed_keys_are_named_with_both_values() {
        let keys = changed_keys(
            "[run]\nseed = 1\nlaw = \"paper\"\n",
            "[run]\nseed = 2\nlaw = \"paper\"\n[phantom.tip]\nx = 1\n",
        );
        let names: Vec<&str> = keys.iter().map(|k| k.key.as_str()).collect();
        assert_eq!(names, ["phantom", "run.seed"]);
        assert_eq!(keys[1].first.as_deref(), Some("1"));
        assert_eq!(keys[1].second.as_deref(), Some("2"));
    }
}

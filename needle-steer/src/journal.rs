//! The log of a run: what each step read, what it decided and what went out, as MCAP.

use std::collections::BTreeMap;
use std::fs::File;
use std::path::Path;
use std::time::Duration;

use anyhow::Context;
use hal::telemetry::{Phase, Telemetry};
use hal::{ArmState, Position, RateCommand, SensedMarker, SensedShape, Stamp, StereoFrame};
use rosbridge::log::{Level, Log, Overflow, Record, RunInfo, Scenery, WriteError};

use vision::track::Tracked;

use crate::config::Config;
use crate::cycle::Bearings;
use crate::outcome::Summary;
use crate::rig;
use crate::ros::{camera_models, frames};
use crate::run::Observer;

/// Writes a run's log as it goes. A failing disk never disturbs the run: the first error is kept
/// and answered by [`Journal::finish`].
#[derive(Debug)]
pub struct Journal {
    log: Log,
    error: Option<WriteError>,
    phase: Phase,
    newest_image: Option<Stamp>,
}

impl Journal {
    /// A new log at `place`.
    ///
    /// # Errors
    /// The file cannot be made, or the configuration not be written as TOML.
    pub fn create(place: &Path, config: &Config, bearings: &Bearings) -> anyhow::Result<Self> {
        let file = File::create(place).with_context(|| place.display().to_string())?;
        Self::new(file, place, config, bearings, Overflow::Wait, None)
    }

    /// A log in an empty `file`, which errors call `place`; the run's time was zero at `began` since the
    /// epoch.
    ///
    /// # Errors
    /// The file cannot be written, or the configuration not be written as TOML.
    pub fn new(
        file: File,
        place: &Path,
        config: &Config,
        bearings: &Bearings,
        overflow: Overflow,
        began: Option<Duration>,
    ) -> anyhow::Result<Self> {
        Self::labelled(file, place, config, bearings, (overflow, began), None)
    }

    /// A new log of a withdrawal at `place`; `insertion` is the log of the insertion before it.
    ///
    /// # Errors
    /// As [`Journal::create`].
    pub fn of_withdrawal(
        place: &Path,
        config: &Config,
        bearings: &Bearings,
        insertion: Option<&Path>,
        began: Duration,
    ) -> anyhow::Result<Self> {
        let name = insertion.map_or_else(String::new, |log| log.display().to_string());
        let file = File::create(place).with_context(|| place.display().to_string())?;
        // Simulated time waits for the disk; a real arm does not.
        let overflow = if config.is_real() {
            Overflow::Drop
        } else {
            Overflow::Wait
        };
        let timing = (overflow, Some(began));
        Self::labelled(file, place, config, bearings, timing, Some(name))
    }

    fn labelled(
        file: File,
        place: &Path,
        config: &Config,
        bearings: &Bearings,
        (overflow, began): (Overflow, Option<Duration>),
        withdrawal_of: Option<String>,
    ) -> anyhow::Result<Self> {
        let label = |key: &str, value: &str| (key.to_owned(), value.to_owned());
        let withdrawal_of = withdrawal_of.map(|name| (WITHDRAWAL_OF.to_owned(), name));
        let info = RunInfo {
            config: toml::to_string(config)?,
            seed: config.run.seed,
            versions: BTreeMap::from([label("needle-steer", crate::VERSION)]),
            labels: [
                label("law", &config.run.law),
                label("phantom", &config.run.phantom),
            ]
            .into_iter()
            .chain(withdrawal_of)
            .collect(),
            began,
            joint_names: bearings.chain.names().to_vec(),
            world_from_left_camera: bearings.world_from_left_camera,
        };
        let scenery = Scenery {
            robot: rig::description(config),
            frames: Some(frames(bearings)),
            cameras: bearings.cameras.as_ref().map(camera_models),
        };
        let mut journal = Self {
            log: Log::new(file, place, &info, scenery, overflow)?,
            error: None,
            phase: Phase::Idle,
            newest_image: None,
        };
        if let Some(cameras) = &bearings.cameras {
            journal.write(Record::Document {
                name: CALIBRATION.into(),
                text: serde_json::to_string(cameras)?,
            });
        }
        Ok(journal)
    }

    /// Why the log can no longer be written, if so.
    pub fn error(&self) -> Option<&WriteError> {
        self.error.as_ref()
    }

    fn write(&mut self, record: impl Into<Record>) {
        if self.error.is_none() {
            self.error = self.log.write(record).err();
        }
    }

    /// How the run ended, as a note and as the document `summary.json`.
    pub fn result(&mut self, stamp: Stamp, summary: &Summary) {
        let success = summary.ended.is_success();
        self.conclude(stamp, success, &summary.ended.to_string(), summary);
    }

    /// As [`Journal::result`], for any verdict and its figures.
    pub fn conclude(
        &mut self,
        stamp: Stamp,
        success: bool,
        verdict: &str,
        summary: &impl serde::Serialize,
    ) {
        let level = if success { Level::Info } else { Level::Error };
        self.write(Record::Note {
            stamp,
            level,
            text: verdict.to_owned(),
        });
        if let Ok(text) = serde_json::to_string(summary) {
            self.write(Record::Document {
                name: "summary.json".into(),
                text,
            });
        }
    }

    /// Completes the file.
    ///
    /// # Errors
    /// The first record that could not be written, records that a slow disk made no room for, or
    /// the end of the file.
    pub fn finish(self) -> Result<(), WriteError> {
        match self.error {
            Some(error) => Err(error),
            None => match self.log.finish()?.dropped {
                0 => Ok(()),
                records => Err(WriteError::Dropped { records }),
            },
        }
    }
}

/// Label of a withdrawal's log: the log of the insertion before it, empty where there is none.
pub const WITHDRAWAL_OF: &str = "withdrawal of";
/// Name of the document that holds the calibration of the cameras.
pub const CALIBRATION: &str = "calibration.json";
/// One pair of images in so many seconds is kept: to look at, not to track again.
const IMAGES_EVERY: f64 = 10.0;

/// Word with which the note of a marker begins.
const MARKER: &str = "marker";

/// A marker's measurement as a note: nanoseconds, position and deviation in metres. Debug output
/// of a float is the shortest text that reads back as the same bits.
fn marker_note(marker: &SensedMarker) -> String {
    let p = marker.position.point();
    let (x, y, z, sigma) = (p.x, p.y, p.z, marker.sigma);
    format!(
        "{MARKER} {} {x:?} {y:?} {z:?} {sigma:?}",
        marker.stamp.as_nanos()
    )
}

/// The marker that a note tells of, if it does.
pub fn marker_of(note: &str) -> Option<SensedMarker> {
    let mut words = note.strip_prefix(MARKER)?.split_whitespace();
    let stamp = Stamp::from_nanos(words.next()?.parse().ok()?);
    let mut number = || words.next()?.parse::<f64>().ok();
    Some(SensedMarker {
        stamp,
        position: Position::new(nalgebra::Point3::new(number()?, number()?, number()?)),
        sigma: number()?,
    })
}

impl Observer for Journal {
    fn marker(&mut self, marker: &SensedMarker) {
        self.write(Record::Note {
            stamp: marker.stamp,
            level: Level::Info,
            text: marker_note(marker),
        });
    }

    fn start(&mut self, arm: &ArmState) {
        self.write(*arm);
    }

    fn images(&mut self, pair: &StereoFrame, _: &Tracked) {
        let stamp = pair.left.stamp;
        let is_due = |last: Stamp| stamp.secs_since(last) >= IMAGES_EVERY;
        if self.newest_image.is_none_or(is_due) {
            self.newest_image = Some(stamp);
            self.write(pair.clone());
        }
    }

    fn inputs(&mut self, arm: &ArmState, shape: Option<&SensedShape>) {
        self.write(*arm);
        if let Some(shape) = shape {
            self.write(shape.clone());
        }
    }

    fn step(&mut self, telemetry: &Telemetry) {
        if telemetry.phase != self.phase {
            self.phase = telemetry.phase;
            self.write(Record::Note {
                stamp: telemetry.stamp,
                level: Level::Info,
                text: format!("phase: {:?}", telemetry.phase),
            });
        }
        for event in telemetry.truth.iter().flat_map(|truth| &truth.events) {
            self.write(Record::Note {
                stamp: telemetry.stamp,
                level: if event.spoils() {
                    Level::Warning
                } else {
                    Level::Info
                },
                text: format!("truth: {}", event.name()),
            });
        }
        self.write(telemetry.clone());
    }

    fn command(&mut self, command: &RateCommand) {
        self.write(*command);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_marker_survives_its_note_bit_by_bit() {
        let marker = SensedMarker {
            stamp: Stamp::from_nanos(123_456_789_012),
            position: Position::new(nalgebra::Point3::new(0.1 + 0.2, -0.0, 1e-300)),
            sigma: 0.05e-3,
        };
        let read = marker_of(&marker_note(&marker)).unwrap();
        assert_eq!(read, marker);
        assert!(read.position.point().y.is_sign_negative());
        assert!(marker_of("phase: Steering").is_none() && marker_of("marker 1 2").is_none());
    }
}

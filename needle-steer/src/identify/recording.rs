//! What an insertion shows of a needle: base poses and what was seen of the needle then.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use hal::frame::{LeftCamera, World};
use hal::telemetry::Telemetry;
use hal::{ArmState, SensedShape, Stamp, Transform};
use nalgebra::{Isometry3, Point3, Unit, Vector3};
use rosbridge::log::{FileKind, LogReader, ReadError, Record};

use super::table::TableError;
use crate::config::{self, Config, ConfigError};
use crate::cycle::{Bearings, base_pose};
use crate::guide::Guide;
use crate::odometry::Odometry;
use crate::rig::{self, RigBuildError};

/// A recording that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum RecordingError {
    /// The log.
    #[error("{}", file.display())]
    Log {
        /// The file.
        file: PathBuf,
        /// Why.
        source: ReadError,
    },
    /// The log's configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The log's arm.
    #[error(transparent)]
    Rig(#[from] RigBuildError),
    /// The table.
    #[error(transparent)]
    Table(#[from] TableError),
    /// Nothing to learn from.
    #[error("{}: no measurement of the needle", file.display())]
    Empty {
        /// The file.
        file: PathBuf,
    },
}

/// The needle as seen at one instant, everything in World.
#[derive(Clone, Debug, PartialEq)]
pub struct Seen {
    /// Exposure.
    pub stamp: Stamp,
    /// Pose of the needle's support then: of its base, or of the exit of a guide.
    pub world_from_support: Isometry3<f64>,
    /// The tip O \[m\].
    pub tip: Point3<f64>,
    /// Its standard deviation per axis \[m\].
    pub tip_sigma: f64,
    /// Tip axis.
    pub direction: Unit<Vector3<f64>>,
    /// Its standard deviation per axis \[rad\]; infinite where it was not seen.
    pub direction_sigma: f64,
    /// Points of the shaft and their standard deviations \[m\].
    pub shaft: Vec<(Point3<f64>, f64)>,
    /// Length of needle pushed through the guide \[m\], where it was measured.
    pub inserted: Option<f64>,
    /// Turn of the needle about its axis \[rad\], where it was measured.
    pub roll: Option<f64>,
}

/// What holds the needle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Support {
    /// Its base is clamped and moves with the arm.
    Base,
    /// It slides through a guide that holds its direction.
    Guide,
}

/// One insertion.
#[derive(Clone, Debug, PartialEq)]
pub struct Recording {
    /// Where it comes from.
    pub name: String,
    /// Needle and entry as the controller knew them.
    pub config: Config,
    /// What holds the needle.
    pub support: Support,
    /// In order of time.
    pub seen: Vec<Seen>,
}

impl Recording {
    /// Reads a recording of any form: the log of a run, or a table with needle and entry from
    /// `config`. The file's first bytes say which it is, not its name.
    ///
    /// # Errors
    /// See [`RecordingError`].
    pub fn read(file: &Path, config: &Config) -> Result<Self, RecordingError> {
        let mut head = Vec::new();
        let opened = std::fs::File::open(file);
        let is_text = opened
            .and_then(|f| f.take(16).read_to_end(&mut head))
            .is_ok()
            && FileKind::of(&head) == FileKind::Text;
        let named_log = file.extension().is_some_and(|e| e == "mcap");
        if is_text && !named_log {
            Self::from_csv(file, config)
        } else {
            Self::from_log(file)
        }
    }

    /// Reads the log of a run.
    ///
    /// # Errors
    /// See [`RecordingError`].
    pub fn from_log(file: &Path) -> Result<Self, RecordingError> {
        let failed = |source| RecordingError::Log {
            file: file.to_owned(),
            source,
        };
        let mut log = LogReader::open(file).map_err(failed)?;
        let config = config::parse(&log.run().config, file, &[])?;
        let bearings = rig::bearings(&config, log.run().world_from_left_camera)?;
        let mut recorder = Recorder::new(&config, bearings);
        for record in log.by_ref() {
            match record.map_err(failed)? {
                Record::Arm(arm) => recorder.arm(&arm),
                Record::Shape(shape) => recorder.shape(&shape),
                _ => {}
            }
        }
        recorder.finish(&file.display().to_string())
    }
}

/// Makes a recording of a run while it goes on.
#[derive(Debug)]
pub struct Recorder {
    config: Config,
    bearings: Bearings,
    /// The guide through which the needle slides, where it does.
    guide: Option<Guide>,
    odometry: Odometry,
    seen: Vec<Seen>,
}

/// Poses kept: more than any sensor's latency.
const POSES: usize = 256;

impl Recorder {
    /// A recorder of a run on `config`.
    pub fn new(config: &Config, bearings: Bearings) -> Self {
        Self {
            config: config.clone(),
            guide: Guide::of(config),
            bearings,
            odometry: Odometry::new(POSES),
            seen: Vec::new(),
        }
    }

    fn arm(&mut self, arm: &ArmState) {
        self.odometry
            .push(arm.stamp, base_pose(&self.bearings, arm));
    }

    fn shape(&mut self, shape: &SensedShape) {
        let Some(world_from_base) = self.odometry.at(shape.stamp) else {
            return;
        };
        let world_from_support = self.guide.map_or(world_from_base, |guide| {
            guide.at(&world_from_base).world_from_exit
        });
        let seen = in_world(
            shape,
            &world_from_support,
            &self.bearings.world_from_left_camera,
        );
        // Tracked curves may be logged twice where no new image came.
        if self.seen.last().is_none_or(|last| last.stamp < seen.stamp) {
            self.seen.push(seen);
        }
    }

    /// The recording, called `name`.
    ///
    /// # Errors
    /// The needle was never seen.
    pub fn finish(self, name: &str) -> Result<Recording, RecordingError> {
        if self.seen.is_empty() {
            return Err(RecordingError::Empty { file: name.into() });
        }
        Ok(Recording {
            name: name.to_owned(),
            config: self.config,
            support: if self.guide.is_some() {
                Support::Guide
            } else {
                Support::Base
            },
            seen: self.seen,
        })
    }
}

impl crate::run::Observer for Recorder {
    fn step(&mut self, _: &Telemetry) {}

    fn inputs(&mut self, arm: &ArmState, shape: Option<&SensedShape>) {
        self.arm(arm);
        if let Some(shape) = shape {
            self.shape(shape);
        }
    }
}

fn in_world(
    shape: &SensedShape,
    world_from_support: &Isometry3<f64>,
    world_from_camera: &Transform<World, LeftCamera>,
) -> Seen {
    Seen {
        stamp: shape.stamp,
        world_from_support: *world_from_support,
        tip: *(*world_from_camera * shape.tip.position).point(),
        tip_sigma: (shape.tip.covariance.trace() / 3.0).sqrt(),
        direction: world_from_camera.rotate_direction(&shape.tip.direction),
        direction_sigma: shape.tip.direction_sigma,
        shaft: shape
            .points
            .iter()
            .map(|p| (*(*world_from_camera * p.position).point(), p.sigma))
            .collect(),
        inserted: None,
        roll: None,
    }
}

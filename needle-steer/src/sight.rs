//! From a stereo pair to the needle's shape: the tracker, told what the encoders know.

use hal::frame::{LeftCamera, World};
use hal::telemetry::Tracking;
use hal::{SensedShape, StereoFrame, Transform};
use nalgebra::{Isometry3, Point3, Unit, Vector3};
use vision::StereoRig;
use vision::track::{Appearance, Context, FrameError, StereoTracker, TrackSettingsError, Tracked};

use crate::bearings::Bearings;
use crate::config::Config;

/// Depth from which the needle can be seen in the tissue; above, the surface mirrors \[m\].
const VISIBLE: f64 = 2.5e-3;

/// The tracker and what it needs to remember of the arm.
#[derive(Debug)]
pub struct Sight {
    tracker: StereoTracker,
    left_from_world: Transform<LeftCamera, World>,
    entry: Point3<f64>,
    inward: Unit<Vector3<f64>>,
    last_base: Option<Isometry3<f64>>,
    guess: Vec<Point3<f64>>,
    found: bool,
    refused: Option<FrameError>,
}

/// How the cameras see the needle of a configuration.
pub fn appearance(config: &Config) -> Appearance {
    let diameter = config.needle.outer_diameter_mm * 1e-3;
    Appearance {
        diameter,
        bevel_length: diameter / config.needle.bevel_deg.to_radians().tan(),
    }
}

impl Sight {
    /// A tracker for the needle of `config` in the images of `rig`.
    ///
    /// # Errors
    /// The tracker refuses its settings.
    pub fn new(
        config: &Config,
        rig: &StereoRig,
        left_from_world: Transform<LeftCamera, World>,
    ) -> Result<Self, TrackSettingsError> {
        Ok(Self {
            tracker: StereoTracker::new(rig, appearance(config), &config.tracking)?,
            left_from_world,
            entry: config.entry(),
            inward: config.inward(),
            last_base: None,
            guess: Vec::with_capacity(256),
            found: false,
            refused: None,
        })
    }

    /// The tracker of a run, where its cameras are known.
    ///
    /// # Errors
    /// See [`Self::new`].
    pub fn of(config: &Config, bearings: &Bearings) -> Result<Option<Self>, TrackSettingsError> {
        let left_from_world = bearings.world_from_left_camera.inverse();
        let new = |rig| Self::new(config, rig, left_from_world);
        bearings.cameras.as_ref().map(new).transpose()
    }

    /// Tracks the needle in `pair`, taken with the base at `world_from_base`; `model` is the
    /// needle as last modelled, in World, base first.
    ///
    /// # Errors
    /// The pair cannot be this rig's or shows nothing.
    pub fn look(
        &mut self,
        pair: &StereoFrame,
        world_from_base: &Isometry3<f64>,
        model: &[Vector3<f64>],
    ) -> Result<&Tracked, FrameError> {
        let left_from_world = *self.left_from_world.isometry();
        let base_motion = self.last_base.map(|last| {
            left_from_world * (world_from_base * last.inverse()) * left_from_world.inverse()
        });
        let insertion = self.last_base.map(|last| {
            let moved = world_from_base.translation.vector - last.translation.vector;
            moved.dot(&(world_from_base.rotation * Vector3::z()))
        });
        self.last_base = Some(*world_from_base);
        self.guess_from(model);
        let bevel = left_from_world * (world_from_base.rotation * -Vector3::y());
        let answer = self.tracker.track(
            pair,
            &Context {
                base_motion,
                insertion,
                bevel: Some(bevel),
                guess: Some(&self.guess),
            },
        );
        self.found = matches!(&answer, Ok(tracked) if tracked.status == Tracking::Tracked);
        self.refused = answer.as_ref().err().copied();
        answer
    }

    /// The visible part of the modelled needle, in the stereo frame.
    fn guess_from(&mut self, model: &[Vector3<f64>]) {
        let left_from_world = self.left_from_world.isometry();
        let depth = |p: &Vector3<f64>| (Point3::from(*p) - self.entry).dot(&self.inward);
        self.guess.clear();
        for pair in model.windows(2) {
            let [above, below] = pair else { continue };
            let (from, to) = (depth(above), depth(below));
            if to <= VISIBLE {
                continue;
            }
            if from <= VISIBLE {
                let share = (VISIBLE - from) / (to - from);
                let first = above + (below - above) * share;
                self.guess.push(left_from_world * Point3::from(first));
            }
            self.guess.push(left_from_world * Point3::from(*below));
        }
    }

    /// The shape found in the newest pair, if it was found.
    pub fn shape(&self) -> Option<&SensedShape> {
        self.found.then_some(&self.tracker.tracked().shape)
    }

    /// What the tracker made of the newest pair.
    pub const fn tracked(&self) -> &Tracked {
        self.tracker.tracked()
    }

    /// Why the newest pair was refused.
    pub const fn refused(&self) -> Option<&FrameError> {
        self.refused.as_ref()
    }
}

//! From a stereo pair to the needle's shape: the tracker, told what the encoders know.

use hal::frame::{LeftCamera, World};
use hal::telemetry::Tracking;
use hal::{SensedShape, StereoFrame, Transform};
use nalgebra::{Isometry3, Point3, Unit, Vector3};
use vision::StereoRig;
use vision::track::{
    Appearance, Context, Flaw, FrameError, Loss, StereoTracker, TrackSettingsError, Tracked,
};

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
    bevel_length: f64,
    last_base: Option<Isometry3<f64>>,
    guess: Vec<Point3<f64>>,
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
        let needle = appearance(config);
        Ok(Self {
            tracker: StereoTracker::new(rig, needle, &config.tracking)?,
            bevel_length: needle.bevel_length,
            left_from_world,
            entry: config.entry(),
            inward: config.inward(),
            last_base: None,
            guess: Vec::with_capacity(256),
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
        // The bevel comes into sight before the tip does: no background any more.
        if let (true, Some(tip)) = (self.guess.is_empty(), model.last())
            && depth(tip) + self.bevel_length > VISIBLE
        {
            self.guess.push(left_from_world * Point3::from(*tip));
        }
    }

    /// The shape found in the newest pair, if it was found.
    pub fn shape(&self) -> Option<&SensedShape> {
        let found = self.refused.is_none() && self.tracked().status == Tracking::Tracked;
        found.then_some(&self.tracked().shape)
    }

    /// What the tracker made of the newest pair.
    pub const fn tracked(&self) -> &Tracked {
        self.tracker.tracked()
    }

    /// Why the needle was not found in the newest pair, if it was not.
    pub fn problem(&self) -> Option<String> {
        let lost = || {
            let loss = self.tracked().loss.unwrap_or(Loss::NotFound);
            (self.tracked().status != Tracking::Tracked).then(|| problem(&loss))
        };
        self.refused.map(|error| error.to_string()).or_else(lost)
    }
}

/// A loss in words.
pub fn problem(loss: &Loss) -> String {
    let side = |image: usize| if image == 0 { "left" } else { "right" };
    let flaw = |side: &str, flaw: &Flaw, place: &str| match flaw {
        Flaw::Shaft { agree, of } => format!(
            "the {side} image shows too little of a shaft {place}: {agree} of {of} normals agree"
        ),
        Flaw::Tip => format!("the {side} image shows no tip {place}"),
        Flaw::Short => format!("the {side} image shows too short a piece of a needle {place}"),
    };
    match loss {
        Loss::NotFound => "no needle found".to_owned(),
        Loss::NoBand { image } => format!(
            "no needle found: the {} image shows no band that stands out from its surroundings",
            side(*image)
        ),
        Loss::NoMatch { bands } => format!(
            "no needle found: of {} bands in the left image and {} in the right no two meet in space",
            bands[0], bands[1]
        ),
        Loss::Faint { share } => format!(
            "no needle found: the bands most like one stand out by only {:.0} % of what their surroundings allow",
            100.0 * share
        ),
        Loss::Start { image, flaw: wrong } => format!(
            "no needle found: {}",
            flaw(side(*image), wrong, "along the band most like one")
        ),
        Loss::Left(wrong) => flaw("left", wrong, "near the prediction"),
        Loss::Right(wrong) => flaw("right", wrong, "near the prediction"),
        Loss::Disagreement { px } => format!("the images disagree about the tip by {px:.1} px"),
        Loss::NoCurve => "the images' curves make no needle in space".to_owned(),
    }
}

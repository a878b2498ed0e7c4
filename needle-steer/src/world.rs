//! The simulated world: an arm's true joints move the phantom, the phantom's sensors look at it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use hal::frame::{ArmBase, LeftCamera, NeedleBase, World};
use hal::telemetry::{TruthEvent, TruthReport};
use hal::{
    Error, FibreSensor, Joints, MarkerSensor, Position, SensedMarker, SensedShape, ShapeSensor,
    Stamp, StereoCamera, StereoFrame, Transform, WavelengthShifts,
};
use nalgebra::Vector3;
use phantom::{Bench, Event};
use robots::kinematics::Chain;

use crate::distortion::DistortionMap;
use crate::fbg::{self, FibreShape};
use crate::score::{GroundTruth, Score, Scoring, TrueFigures};

/// What moves in the world: an arm whose true joints can be read at any time.
pub trait Body: Send {
    /// Moves the arm on to `stamp` and answers its true joints.
    fn advance_to(&mut self, stamp: Stamp) -> Joints;
}

impl Body for robots::sim::SimulatedArm {
    fn advance_to(&mut self, stamp: Stamp) -> Joints {
        Self::advance_to(self, stamp);
        self.true_joints()
    }
}

impl Body for robots::viper::lockstep::Lockstep {
    fn advance_to(&mut self, stamp: Stamp) -> Joints {
        Self::advance_to(self, stamp);
        self.emulator().true_joints()
    }
}

struct Inner {
    body: Box<dyn Body>,
    chain: Chain,
    world_from_arm_base: Transform<World, ArmBase>,
    bench: Bench,
    stereo_from_world: Transform<LeftCamera, World>,
    score: Option<Score>,
    /// The score of the tip as a sensor with a lasting error shows it, without noise.
    apparent: Option<Score>,
    /// Map by which measurements of that sensor are corrected.
    map: Option<Arc<DistortionMap>>,
    /// How fibres in the needle show its shape, and what they add to the tip's place at an exposure.
    fibres: Option<Arc<FibreShape>>,
    shown: Option<(Stamp, Vector3<f64>)>,
    /// Exposure whose events were taken last.
    newest: Stamp,
    /// Events since the last report.
    events: Vec<TruthEvent>,
}

/// A handle on the world; clones share it.
#[derive(Clone)]
pub struct SimulatedWorld(Arc<Mutex<Inner>>);

impl SimulatedWorld {
    /// A world in which `body` carries the needle of `bench`; the frame of its sensors'
    /// measurements truly lies at `stereo_from_world`.
    pub fn new(
        body: Box<dyn Body>,
        chain: Chain,
        world_from_arm_base: Transform<World, ArmBase>,
        bench: Bench,
        stereo_from_world: Transform<LeftCamera, World>,
    ) -> Self {
        Self(Arc::new(Mutex::new(Inner {
            body,
            chain,
            world_from_arm_base,
            bench,
            stereo_from_world,
            score: None,
            apparent: None,
            map: None,
            fibres: None,
            shown: None,
            newest: Stamp::ZERO,
            events: Vec::new(),
        })))
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Measurements of an electromagnetic tip are corrected by `map`; what that leaves is its bias.
    pub fn correct_by(&self, map: Arc<DistortionMap>) {
        self.lock().map = Some(map);
    }

    /// Fibres in the needle are read by `shape`.
    pub fn show_by(&self, shape: Arc<FibreShape>) {
        self.lock().fibres = Some(shape);
    }

    /// Moves everything on to `stamp`.
    pub fn advance_to(&self, stamp: Stamp) {
        let inner = &mut *self.lock();
        let joints = inner.body.advance_to(stamp);
        let base: Transform<ArmBase, NeedleBase> = Transform::assume(inner.chain.forward(&joints));
        let base = inner.world_from_arm_base * base;
        inner.bench.advance_to(stamp, &base);
        inner.note_events();
        inner.note_shown(&base);
        let (marker, bias) = (inner.bench.marker(), inner.tip_bias());
        let truth = inner.bench.truth();
        let scores = [
            (&mut inner.score, Some(Vector3::zeros())),
            (&mut inner.apparent, bias),
        ];
        for (score, bias) in scores {
            let (Some(score), Some(bias)) = (score, bias) else {
                continue;
            };
            if let Some(marker) = marker {
                score.follow(marker);
            }
            score.observe(
                truth.stamp,
                [&(truth.tip() + bias), &truth.direction()],
                [truth.max_stretch, truth.mean_stretch],
            );
        }
    }

    /// Needle and tissue in truth.
    fn truth(&self) -> TruthReport {
        self.lock().truth()
    }

    /// The fast sensor of this world.
    pub fn shape_sensor(&self) -> impl ShapeSensor + use<> {
        WorldSensor(self.clone())
    }

    /// What reads the fibres of this world's needle.
    pub fn fibre_sensor(&self) -> impl FibreSensor + use<> {
        WorldSensor(self.clone())
    }

    /// What sees the marker of this world.
    pub fn marker_sensor(&self) -> impl MarkerSensor + use<> {
        WorldSensor(self.clone())
    }

    /// The cameras of this world.
    pub fn cameras(&self) -> impl StereoCamera + use<> {
        WorldSensor(self.clone())
    }
}

impl Inner {
    /// What fibres add to the tip's place at an exposure, with the base where encoders have it.
    fn note_shown(&mut self, base: &Transform<World, NeedleBase>) {
        let truth = self.bench.truth();
        if self.shown.is_some_and(|(stamp, _)| stamp == truth.stamp) {
            return;
        }
        let shown = self.fibres.as_ref().zip(self.bench.fibre_shifts());
        let shown = shown.and_then(|(shape, shifts)| fbg::shown(shape, &shifts, base.isometry()));
        self.shown = shown.map(|tip| (truth.stamp, tip.coords - truth.tip()));
    }

    /// What the sensor adds to the tip's place now, by its field less what a map takes off, or by all that
    /// fibres hang on \[m\]; nothing with another sensor.
    fn tip_bias(&self) -> Option<Vector3<f64>> {
        if let Some((_, bias)) = self.shown {
            return Some(bias);
        }
        let bias = self.bench.tip_bias()?;
        let measured = self.bench.truth().tip() + bias;
        let known = |map: &Arc<DistortionMap>| map.of_place(&measured.into());
        Some(bias - self.map.as_ref().map_or_else(Vector3::zeros, known))
    }

    fn note_events(&mut self) {
        let truth = self.bench.truth();
        if truth.stamp == self.newest {
            return;
        }
        self.newest = truth.stamp;
        for event in truth.events.iter().map(kind) {
            if !self.events.contains(&event) {
                self.events.push(event);
            }
        }
    }

    fn truth(&self) -> TruthReport {
        let truth = self.bench.truth();
        TruthReport {
            stamp: truth.stamp,
            shape: truth.needle.centreline.iter().step_by(4).copied().collect(),
            tip: truth.tip(),
            direction: truth.direction(),
            max_stretch: truth.max_stretch,
            mean_stretch: truth.mean_stretch,
            path_length: length(&truth.cut_path),
            tissue_shift: self.bench.tissue_shift(&truth.tip()),
            entry_force: truth.entry_force.norm(),
            ..TruthReport::default()
        }
    }
}

impl GroundTruth for SimulatedWorld {
    fn pre_insertion(&self) -> f64 {
        self.lock().bench.draw().pre_insertion
    }

    fn newest(&self) -> TruthReport {
        self.truth()
    }

    fn true_tip(&self) -> Vector3<f64> {
        self.lock().bench.truth().tip()
    }

    fn marker(&self) -> Option<Vector3<f64>> {
        self.lock().bench.marker()
    }

    fn stereo_from_world(&self) -> Transform<LeftCamera, World> {
        self.lock().stereo_from_world
    }
}

impl Scoring for SimulatedWorld {
    fn attach_marker(&self, place: &Vector3<f64>) {
        self.lock().bench.attach_marker(place);
    }

    fn watch(&self, target: Vector3<f64>) {
        let mut inner = self.lock();
        inner.score = Some(Score::new(target));
        inner.apparent = inner.tip_bias().map(|_| Score::new(target));
    }

    fn report(&self) -> TruthReport {
        let mut inner = self.lock();
        let events = core::mem::take(&mut inner.events);
        let truth = TruthReport {
            events,
            ..inner.truth()
        };
        Score::complete(inner.score.as_ref(), truth)
    }

    fn figures(&self) -> Option<TrueFigures> {
        let inner = self.lock();
        let truth = inner.bench.truth();
        let (tip, axis) = (truth.tip(), truth.direction());
        let apparent = inner.apparent.zip(inner.tip_bias());
        Some(TrueFigures {
            lateral_less_bias: apparent
                .map(|(score, bias)| score.figures(&(tip + bias), &axis).lateral),
            ..inner.score?.figures(&tip, &axis)
        })
    }
}

impl core::fmt::Debug for SimulatedWorld {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_tuple("SimulatedWorld")
            .field(&self.lock().bench)
            .finish()
    }
}

struct WorldSensor(SimulatedWorld);

impl ShapeSensor for WorldSensor {
    fn poll(&mut self) -> Result<Option<SensedShape>, Error> {
        ShapeSensor::poll(&mut self.0.lock().bench)
    }
}

impl FibreSensor for WorldSensor {
    fn poll(&mut self) -> Result<Option<WavelengthShifts>, Error> {
        FibreSensor::poll(&mut self.0.lock().bench)
    }
}

impl MarkerSensor for WorldSensor {
    fn poll(&mut self) -> Result<Option<SensedMarker>, Error> {
        Ok(self.0.lock().bench.poll_marker().map(|seen| SensedMarker {
            stamp: seen.stamp,
            position: seen.position,
            sigma: seen.sigma,
        }))
    }
}

impl StereoCamera for WorldSensor {
    fn poll(&mut self) -> Result<Option<StereoFrame>, Error> {
        StereoCamera::poll(&mut self.0.lock().bench)
    }
}

/// Length of a polyline \[m\].
fn length(points: &[Vector3<f64>]) -> f64 {
    points
        .windows(2)
        .map(|ends| (ends[1] - ends[0]).norm())
        .sum()
}

/// The kind of an event of the phantom.
pub const fn kind(event: &Event) -> TruthEvent {
    match event {
        Event::Buckling => TruthEvent::Buckling,
        Event::Yielding { .. } => TruthEvent::Yielding,
        Event::Tearing { .. } => TruthEvent::Tearing,
        Event::PulledOut => TruthEvent::PulledOut,
        Event::Entered { .. } => TruthEvent::Entered,
        Event::Unconverged { .. } => TruthEvent::Unconverged,
        Event::Refused => TruthEvent::Refused,
    }
}

/// A target as the protocol places it, from the true tip and the holder's nominal pose:
/// `depth` ahead on the holder's z, `offset` aside at `angle` from the bevel direction (-y),
/// right-handed about z. World \[m\].
pub fn place_target(
    true_tip: &Vector3<f64>,
    world_from_holder: &Transform<World, NeedleBase>,
    depth: f64,
    offset: f64,
    angle: f64,
) -> Vector3<f64> {
    let aside = Vector3::new(angle.sin(), -angle.cos(), 0.0) * offset;
    true_tip + world_from_holder.rotate(&(aside + Vector3::z() * depth))
}

/// The same point in the stereo frame.
pub fn in_stereo_frame(
    target: &Vector3<f64>,
    left_from_world: &Transform<LeftCamera, World>,
) -> Position<LeftCamera> {
    *left_from_world * Position::new((*target).into())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn offsets_turn_right_handed_from_the_bevel_direction() {
        let holder: Transform<World, NeedleBase> = Transform::identity();
        let place =
            |angle: f64| place_target(&Vector3::zeros(), &holder, 0.08, 0.01, angle.to_radians());
        assert!((place(0.0) - Vector3::new(0.0, -0.01, 0.08)).norm() < 1e-15);
        // A quarter turn about +z takes -y to +x.
        assert!((place(90.0) - Vector3::new(0.01, 0.0, 0.08)).norm() < 1e-15);
    }
}

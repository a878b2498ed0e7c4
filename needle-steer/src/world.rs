//! The simulated world: an arm's true joints move the phantom, the phantom's sensors look at it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use hal::frame::{ArmBase, LeftCamera, NeedleBase, World};
use hal::telemetry::TruthReport;
use hal::{
    Error, Joints, Position, SensedShape, ShapeSensor, Stamp, StereoCamera, StereoFrame, Transform,
};
use nalgebra::Vector3;
use phantom::Bench;
use phantom::experiment::Passing;
use robots::kinematics::Chain;

use crate::cycle::SeenMarker;

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
}

/// Hidden figures of a run, from the moment its target was set.
#[derive(Clone, Copy, Debug)]
struct Score {
    target: Vector3<f64>,
    passing: Passing,
    passed: Option<f64>,
    max_stretch: f64,
    sum_stretch: f64,
    states: f64,
    last: Option<Stamp>,
}

/// Final figures of a run in truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TrueFigures {
    /// Distance of the target from the tip axis when O's plane passed it, or at the end \[m\].
    pub lateral: f64,
    /// Target ahead of O at the end \[m\].
    pub axial: f64,
    /// Largest tissue displacement \[m\].
    pub max_stretch: f64,
    /// Tissue displacement, averaged over needle and time \[m\].
    pub mean_stretch: f64,
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
        })))
    }

    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Moves everything on to `stamp`.
    pub fn advance_to(&self, stamp: Stamp) {
        let inner = &mut *self.lock();
        let joints = inner.body.advance_to(stamp);
        let base: Transform<ArmBase, NeedleBase> = Transform::assume(inner.chain.forward(&joints));
        inner
            .bench
            .advance_to(stamp, &(inner.world_from_arm_base * base));
        if let Some(score) = &mut inner.score {
            score.observe(&inner.bench);
        }
    }

    /// Straight pre-insertion that this run's protocol asks for \[m\].
    pub fn pre_insertion(&self) -> f64 {
        self.lock().bench.draw().pre_insertion
    }

    /// Tip O in truth, World \[m\].
    pub fn true_tip(&self) -> Vector3<f64> {
        self.lock().bench.truth().tip()
    }

    /// Marks the tissue that is at `place` now (World \[m\]).
    pub fn attach_marker(&self, place: &Vector3<f64>) {
        self.lock().bench.attach_marker(place);
    }

    /// Where the marker is in truth, World \[m\]; nothing where none is attached.
    pub fn marker(&self) -> Option<Vector3<f64>> {
        self.lock().bench.marker()
    }

    /// The marker as the sensor delivers it, if there is something new.
    pub fn poll_marker(&self) -> Option<SeenMarker> {
        let seen = self.lock().bench.poll_marker()?;
        Some(SeenMarker {
            stamp: seen.stamp,
            position: seen.position,
            sigma: seen.sigma,
        })
    }

    /// Starts to keep the score against a true target in World \[m\].
    pub fn watch(&self, target: Vector3<f64>) {
        self.lock().score = Some(Score {
            target,
            passing: Passing::new(target),
            passed: None,
            max_stretch: 0.0,
            sum_stretch: 0.0,
            states: 0.0,
            last: None,
        });
    }

    /// The truth for telemetry.
    pub fn report(&self) -> TruthReport {
        let inner = self.lock();
        let truth = inner.bench.truth();
        let target = inner
            .score
            .map_or_else(|| Vector3::from_element(f64::NAN), |s| s.target);
        let miss = truth.miss(&target);
        TruthReport {
            shape: truth.needle.centreline.iter().step_by(4).copied().collect(),
            tip: truth.tip(),
            direction: truth.direction(),
            target,
            lateral_error: miss.lateral,
            axial_distance: miss.axial,
            max_stretch: truth.max_stretch,
            mean_stretch: truth.mean_stretch,
        }
    }

    /// The figures of the run so far; nothing before a target was set.
    pub fn figures(&self) -> Option<TrueFigures> {
        let inner = self.lock();
        let score = inner.score?;
        let miss = inner.bench.truth().miss(&score.target);
        Some(TrueFigures {
            lateral: score.passed.unwrap_or(miss.lateral),
            axial: miss.axial,
            max_stretch: score.max_stretch,
            mean_stretch: score.sum_stretch / score.states.max(1.0),
        })
    }

    /// Where the frame of the sensors' measurements truly lies; a registration may think
    /// otherwise.
    pub fn stereo_from_world(&self) -> Transform<LeftCamera, World> {
        self.lock().stereo_from_world
    }

    /// The fast sensor of this world.
    pub fn shape_sensor(&self) -> impl ShapeSensor + use<> {
        WorldSensor(self.clone())
    }

    /// The cameras of this world.
    pub fn cameras(&self) -> impl StereoCamera + use<> {
        WorldSensor(self.clone())
    }
}

impl core::fmt::Debug for SimulatedWorld {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_tuple("SimulatedWorld")
            .field(&self.lock().bench)
            .finish()
    }
}

impl Score {
    fn observe(&mut self, bench: &Bench) {
        let truth = bench.truth();
        if self.last == Some(truth.stamp) {
            return;
        }
        self.last = Some(truth.stamp);
        if let Some(marker) = bench.marker() {
            self.target = marker;
            self.passing.follow(marker);
        }
        self.passed = self.passing.observe(truth);
        self.max_stretch = self.max_stretch.max(truth.max_stretch);
        self.sum_stretch += truth.mean_stretch;
        self.states += 1.0;
    }
}

struct WorldSensor(SimulatedWorld);

impl ShapeSensor for WorldSensor {
    fn poll(&mut self) -> Result<Option<SensedShape>, Error> {
        ShapeSensor::poll(&mut self.0.lock().bench)
    }
}

impl StereoCamera for WorldSensor {
    fn poll(&mut self) -> Result<Option<StereoFrame>, Error> {
        StereoCamera::poll(&mut self.0.lock().bench)
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

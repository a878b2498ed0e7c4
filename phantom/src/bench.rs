//! The laboratory bench: a plant, the robot's flaws and the sensors, moved by one clock.

use hal::frame::{LeftCamera, NeedleBase, World};
use hal::{
    FibreSensor, SensedShape, ShapeSensor, Stamp, StereoCamera, StereoFrame, Transform,
    WavelengthShifts,
};
use nalgebra::{Isometry3, UnitQuaternion, Vector3};

use crate::camera::StereoRig;
use crate::continuum::ContinuumPlant;
use crate::draw::Draw;
use crate::fbg::{FibreArea, Gratings};
use crate::marker::{MarkerSensor, SensedMarker};
use crate::needle::RodPlant;
use crate::plant::Plant;
use crate::robot::Robot;
use crate::sensor::FastSensor;
use crate::settings::{Settings, SettingsError, is_pose, placed};
use crate::truth::Truth;

/// Longest time between two calls of [`Bench::advance_to`] \[s\]: an hour is 108 000 exposures.
const LONGEST_WAIT: f64 = 3600.0;

/// Where things stand on the bench at the start.
#[derive(Clone, Copy, Debug)]
pub struct Setup {
    /// Phantom frame: origin at the nominal entry on the gel's surface, z into the gel.
    pub world_from_phantom: Isometry3<f64>,
    /// Nominal pose of the needle's base at time zero.
    pub world_from_base: Transform<World, NeedleBase>,
    /// The true stereo frame, in which the fast sensor reports.
    pub left_from_world: Transform<LeftCamera, World>,
    /// Which run of the population.
    pub seed: u64,
}

/// A plant with robot flaws and sensors.
///
/// The plant is stepped at exposures only (30 Hz by default), with the base's pose
/// interpolated between the calls of [`Bench::advance_to`]; [`Bench::truth`] is the state at
/// the last exposure, as its stamp says.
pub struct Bench {
    plant: Box<dyn Plant>,
    robot: Robot,
    sensor: FastSensor,
    cameras: Option<StereoRig>,
    fibres: Option<Gratings>,
    /// Where the marker is while the tissue is at rest, in World \[m\].
    marker: Option<Vector3<f64>>,
    marker_sensor: MarkerSensor,
    draw: Draw,
    now: Stamp,
    nominal: Transform<World, NeedleBase>,
    refused: bool,
}

impl core::fmt::Debug for Bench {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Bench")
            .field("now", &self.now)
            .field("truth", self.plant.truth())
            .finish_non_exhaustive()
    }
}

impl Bench {
    /// A bench over the rod in tissue.
    ///
    /// # Errors
    /// A setting outside its range, or a place that is no pose.
    pub fn new(settings: &Settings, setup: &Setup) -> Result<Self, SettingsError> {
        Self::with_plant(settings, setup, |world_from_base| {
            let plant = RodPlant::new(
                settings,
                &setup.world_from_phantom,
                world_from_base,
                setup.seed,
            )?;
            Ok(Box::new(plant))
        })
    }

    /// A bench over the needle in a half-space.
    ///
    /// # Errors
    /// As [`Bench::new`], and what [`ContinuumPlant::new`] refuses.
    pub fn continuum(settings: &Settings, setup: &Setup) -> Result<Self, SettingsError> {
        Self::with_plant(settings, setup, |world_from_base| {
            let place = &setup.world_from_phantom;
            let plant = ContinuumPlant::new(settings, place, world_from_base, setup.seed)?;
            Ok(Box::new(plant))
        })
    }

    /// A bench over any plant, built by `plant` for the true pose of the needle's base at the
    /// start. Robot and sensors are those of `settings` and the seed.
    ///
    /// # Errors
    /// A setting outside its range, a place that is no pose, or the plant's own.
    pub fn with_plant<E: From<SettingsError>>(
        settings: &Settings,
        setup: &Setup,
        plant: impl FnOnce(&Transform<World, NeedleBase>) -> Result<Box<dyn Plant>, E>,
    ) -> Result<Self, E> {
        settings.validate()?;
        placed("world_from_phantom", &setup.world_from_phantom)?;
        placed("world_from_base", setup.world_from_base.isometry())?;
        placed("left_from_world", setup.left_from_world.isometry())?;
        let draw = Draw::new(settings, setup.seed);
        let robot = Robot::new(settings, &draw, &setup.world_from_base, setup.seed);
        let mut bench = Self {
            plant: plant(&robot.true_pose())?,
            robot,
            sensor: FastSensor::new(&settings.sensor, &setup.left_from_world, setup.seed),
            cameras: None,
            fibres: None,
            marker: None,
            marker_sensor: MarkerSensor::new(&settings.sensor, &setup.left_from_world, setup.seed),
            draw,
            now: Stamp::ZERO,
            nominal: setup.world_from_base,
            refused: false,
        };
        bench.expose();
        Ok(bench)
    }

    /// Adds cameras, which take their first pair now.
    #[must_use]
    pub fn with_cameras(mut self, cameras: StereoRig) -> Self {
        self.cameras = Some(cameras);
        self.expose();
        self
    }

    /// Puts the electromagnetic sensor in the place of the fast one; it measures now.
    #[must_use]
    pub fn with_em(mut self, settings: &Settings, setup: &Setup) -> Self {
        self.sensor = FastSensor::em(&settings.em, &setup.left_from_world, setup.seed);
        self.expose();
        self
    }

    /// Puts fibres into the needle, their active areas from its base to its tip as a calibration has
    /// them; they are read now.
    #[must_use]
    pub fn with_fibres(mut self, settings: &Settings, areas: &[FibreArea], seed: u64) -> Self {
        let gratings = Gratings::new(&settings.fbg, areas, self.draw.azimuth, seed);
        self.fibres = Some(gratings);
        self.expose();
        self
    }

    /// The shifts that an interrogator without noise reads now \[nm\]; nothing without fibres.
    pub fn fibre_shifts(&self) -> Option<Vec<f64>> {
        let base = self.robot.true_pose();
        let fibres = self.fibres.as_ref()?;
        Some(fibres.without_noise(&self.truth().needle, base.isometry()))
    }

    /// What the field of an electromagnetic sensor adds to the tip's place now, World \[m\]; nothing
    /// with another sensor.
    pub fn tip_bias(&self) -> Option<Vector3<f64>> {
        self.sensor.bias_at(&self.truth().tip())
    }

    /// The cameras, where there are any.
    pub const fn cameras(&self) -> Option<&StereoRig> {
        self.cameras.as_ref()
    }

    /// The cameras, for views of a board or of the empty gel.
    pub const fn cameras_mut(&mut self) -> Option<&mut StereoRig> {
        self.cameras.as_mut()
    }

    /// What chance gave this run, such as the length of its straight pre-insertion.
    pub const fn draw(&self) -> &Draw {
        &self.draw
    }

    /// The hidden truth at the last exposure.
    pub fn truth(&self) -> &Truth {
        self.plant.truth()
    }

    /// Makes a marker of the tissue that is at `place` in World \[m\] at the last exposure; it
    /// replaces the one before. It is seen from the next exposure on. A place that is not finite
    /// is nowhere: there is no marker then.
    pub fn attach_marker(&mut self, place: &Vector3<f64>) {
        let finite = place.iter().all(|x| x.is_finite());
        self.marker = finite.then(|| self.plant.rest_of(place));
    }

    /// True place of the marker in World \[m\] at the last exposure, where there is one.
    pub fn marker(&self) -> Option<Vector3<f64>> {
        self.marker.map(|rest| self.plant.tissue_at(&rest))
    }

    /// How far the tissue that is at `place` at the last exposure is from where it rests, World
    /// \[m\].
    pub fn tissue_shift(&self, place: &Vector3<f64>) -> Vector3<f64> {
        place - self.plant.rest_of(place)
    }

    /// The newest measurement of the marker that has arrived and was not yet returned.
    pub fn poll_marker(&mut self) -> Option<SensedMarker> {
        self.marker_sensor.poll(self.now)
    }

    /// Whether the last call of [`Bench::advance_to`] was refused. A base that leaps too far for
    /// the plant is not: the plant tells of it, by [`Event::Refused`](crate::Event::Refused).
    pub const fn refused(&self) -> bool {
        self.refused
    }

    /// The bench's clock.
    pub const fn now(&self) -> Stamp {
        self.now
    }

    /// Moves the bench to `now`, the nominal base reaching `world_from_base` (by the arm's true
    /// joints) there on a straight screw. A time that runs backwards or is an hour ahead, and a
    /// invalid pose, change nothing: see [`Bench::refused`]. `events` of the truth are
    /// those of the last exposure.
    pub fn advance_to(&mut self, now: Stamp, world_from_base: &Transform<World, NeedleBase>) {
        let wait = now.secs_since(self.now);
        self.refused =
            !((0.0..=LONGEST_WAIT).contains(&wait) && is_pose(world_from_base.isometry()));
        if self.refused {
            return;
        }
        let start = self.now;
        let from = *self.nominal.isometry();
        let to = world_from_base.isometry();
        let screw = (from.rotation.inverse() * to.rotation).scaled_axis();
        let span = now.secs_since(start);
        let at = |stamp: Stamp| -> Transform<World, NeedleBase> {
            if stamp >= now {
                return *world_from_base;
            }
            let share = stamp.secs_since(start) / span;
            let vector = from.translation.vector;
            Transform::assume(Isometry3::from_parts(
                vector.lerp(&to.translation.vector, share).into(),
                from.rotation * UnitQuaternion::from_scaled_axis(screw * share),
            ))
        };
        let mut reached = start;
        loop {
            let due = self.next_exposure();
            if due > now {
                break;
            }
            self.robot.follow(&at(due), due.secs_since(reached));
            reached = due;
            self.robot.yield_to(&self.plant.truth().base_wrench);
            self.plant.advance(&self.robot.true_pose(), due);
            self.now = due;
            self.expose();
        }
        self.robot.follow(world_from_base, now.secs_since(reached));
        self.nominal = *world_from_base;
        self.now = now;
        if let Some(cameras) = &mut self.cameras {
            cameras.advance_to(now);
        }
    }

    fn next_exposure(&self) -> Stamp {
        let sensor = self.sensor.next_exposure();
        let cameras = self.cameras.as_ref().map(StereoRig::next_exposure);
        let fibres = self.fibres.as_ref().map(Gratings::next_exposure);
        [cameras, fibres]
            .into_iter()
            .flatten()
            .fold(sensor, Stamp::min)
    }

    /// Every sensor that is due at the present time looks at the needle.
    fn expose(&mut self) {
        let view = &self.plant.truth().needle;
        let marker = self.marker.map(|rest| self.plant.tissue_at(&rest));
        while self.sensor.next_exposure() <= self.now {
            if let Some(place) = &marker {
                let (stamp, sequence) = (self.sensor.next_exposure(), self.sensor.sequence());
                self.marker_sensor.expose(place, stamp, sequence);
            }
            self.sensor.expose(view);
        }
        if let Some(cameras) = &mut self.cameras {
            while cameras.next_exposure() <= self.now {
                cameras.expose(view);
            }
        }
        if let Some(fibres) = &mut self.fibres {
            let base = self.robot.true_pose();
            while fibres.next_exposure() <= self.now {
                fibres.expose(view, base.isometry());
            }
        }
    }
}

impl ShapeSensor for Bench {
    fn poll(&mut self) -> Result<Option<SensedShape>, hal::Error> {
        Ok(self.sensor.poll(self.now))
    }
}

impl FibreSensor for Bench {
    fn poll(&mut self) -> Result<Option<WavelengthShifts>, hal::Error> {
        Ok(self
            .fibres
            .as_mut()
            .and_then(|fibres| fibres.poll(self.now)))
    }
}

impl StereoCamera for Bench {
    fn poll(&mut self) -> Result<Option<StereoFrame>, hal::Error> {
        match &mut self.cameras {
            Some(cameras) => cameras.poll(),
            None => Ok(None),
        }
    }
}

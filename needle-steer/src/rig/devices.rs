//! What a run moves, sees and waits with: simulated, or over ROS.

use std::sync::Arc;
use std::time::Duration;

use hal::frame::{ArmBase, LeftCamera, NeedleBase, World};
use hal::{Arm, Clock, Transform};
use nalgebra::Isometry3;
use phantom::camera::StereoRig;
use phantom::{Bench, Draw, Hand, Plant, Setup};
use robots::kinematics::Chain;
use robots::sim::{SimSettings, SimulatedArm};
use robots::viper::{self, Emulator, emulator::EmulatorConfig};

use super::{Eyes, MarkerEyes, RigBuildError};
use crate::clock::{LockstepClock, PacedClock, WallClock, WallTime};
use crate::config::{Backend, Config, PlantKind, SensorKind, ViperDialect};
use crate::distortion::DistortionMap;
use crate::fbg::Fibres;
use crate::hand::{ByHand, HandBody};
use crate::host;
use crate::remote::igtl::Tracker;
use crate::ros::Link;
use crate::score::Scoring;
use crate::twin::TwinPlant;
use crate::world::{Body, SimulatedWorld};

/// Ticks of the simulated world.
pub(super) const TICK: Duration = Duration::from_millis(4);

/// Makes a plant for the true pose of the needle's base at the start.
pub type PlantMaker =
    Box<dyn FnOnce(&Transform<World, NeedleBase>) -> Result<Box<dyn Plant>, RigBuildError> + Send>;

/// Where things stand.
pub(super) struct Place {
    pub(super) chain: Chain,
    pub(super) world_from_arm_base: Transform<World, ArmBase>,
    pub(super) start: Isometry3<f64>,
    pub(super) joints: hal::Joints,
    /// Cameras as they truly are; where only shapes are sensed, their frame.
    pub(super) stereo: StereoRig,
    /// World in the stereo frame, as registered.
    pub(super) left_from_world: Transform<LeftCamera, World>,
    /// Map of an electromagnetic field.
    pub(super) map: Option<Arc<DistortionMap>>,
    /// The needle in its guide, where a hand pushes it.
    pub(super) by_hand: Option<ByHand>,
    /// Fibres in the needle, where they see it.
    pub(super) fibres: Option<Fibres>,
}

/// What a run moves, sees and waits with.
pub(super) struct Devices {
    pub(super) clock: Box<dyn Clock>,
    pub(super) arm: Box<dyn Arm>,
    pub(super) eyes: Eyes,
    pub(super) marker: MarkerEyes,
    pub(super) tracker: Option<Tracker>,
    pub(super) world: Option<Box<dyn Scoring>>,
    pub(super) simulated_arm: Option<SimulatedArm>,
    pub(super) emulator: Option<Emulator>,
}

/// How the time of a simulated world passes.
#[derive(Clone, Debug)]
pub enum Pace {
    /// As fast as it goes.
    Free,
    /// With the wall clock, or slower on a slow machine: the same run.
    Paced(WallTime),
    /// With the wall clock, whatever else waits.
    Wall(WallTime),
}

impl Pace {
    /// The wall-clock time that it keeps, or may keep from now on.
    fn time(&self) -> WallTime {
        match self {
            Self::Free => WallTime::start(),
            Self::Paced(time) | Self::Wall(time) => time.clone(),
        }
    }
}

impl Place {
    pub(super) fn simulated(
        self,
        config: &Config,
        pace: Pace,
        plant: Option<PlantMaker>,
    ) -> Result<Devices, RigBuildError> {
        let settings = config.phantom_settings()?;
        let stereo_from_world = *self.stereo.stereo_from_world();
        let setup = Setup {
            world_from_phantom: config.world_from_entry(),
            world_from_base: Transform::assume(self.start),
            left_from_world: stereo_from_world,
            seed: config.run.seed,
        };
        let bench = match (plant, config.run.plant) {
            (Some(plant), _) => Bench::with_plant(&settings, &setup, plant)?,
            (None, PlantKind::Phantom) => Bench::new(&settings, &setup)?,
            (None, PlantKind::Continuum) => Bench::continuum(&settings, &setup)?,
            (None, PlantKind::Springs) => Bench::with_plant(&settings, &setup, |true_base| {
                twin(config, &settings, true_base)
            })?,
        };
        let images = config.run.sensor == SensorKind::Images;
        let bench = match config.run.sensor {
            SensorKind::Images => bench.with_cameras(self.stereo),
            SensorKind::Em if !config.tracker.is_used() => bench.with_em(&settings, &setup),
            SensorKind::Shape | SensorKind::Em | SensorKind::Fbg => bench,
        };
        let bench = match &self.fibres {
            Some(fibres) => {
                let areas = fibres.shape().calibration().simulated();
                bench.with_fibres(&settings, &areas, config.run.seed)
            }
            None => bench,
        };
        let ArmParts {
            arm,
            body,
            time,
            simulated_arm,
            emulator,
        } = ArmParts::of(config, &self.chain, &self.joints)?;
        let pace = time.map_or(pace, Pace::Wall);
        // Another process measures on the wall clock.
        let pace = if config.tracker.is_used() {
            Pace::Wall(pace.time())
        } else {
            pace
        };
        let tracked = tracked(config, pace.time(), &self.left_from_world)?;
        let tracker = tracked.as_ref().map(|(tracker, _)| tracker.clone());
        let body = match self.by_hand {
            Some(by) => {
                let hand = Hand::new(&settings.hand, config.run.seed);
                Box::new(HandBody::new(body, by, hand))
            }
            None => body,
        };
        let world = SimulatedWorld::new(
            body,
            self.chain,
            self.world_from_arm_base,
            bench,
            stereo_from_world,
        );
        if let Some(map) = self.map {
            world.correct_by(map);
        }
        if let Some(fibres) = &self.fibres {
            world.show_by(Arc::clone(fibres.shape()));
        }
        let moved = world.clone();
        let advance = move |now| moved.advance_to(now);
        let clock: Box<dyn Clock> = match pace {
            Pace::Free => Box::new(LockstepClock::new(TICK, advance)),
            Pace::Paced(wall) => Box::new(PacedClock::new(LockstepClock::new(TICK, advance), wall)),
            Pace::Wall(wall) => Box::new(WallClock::driving(wall, TICK, advance)),
        };
        Ok(Devices {
            clock,
            arm,
            eyes: match (tracked, &self.fibres) {
                (Some((_, eyes)), _) => eyes,
                (None, Some(fibres)) => {
                    let sensor = Box::new(world.fibre_sensor());
                    Eyes::Shape(fibres.eyes(sensor, &self.left_from_world))
                }
                (None, None) if images => Eyes::Cameras(Box::new(world.cameras())),
                (None, None) => Eyes::Shape(Box::new(world.shape_sensor())),
            },
            marker: MarkerEyes::new(Box::new(world.marker_sensor())),
            tracker,
            world: Some(Box::new(world)),
            simulated_arm,
            emulator,
        })
    }

    /// The controller at the configured host, its needle seen by cameras behind ROS topics.
    pub(super) fn real(
        &self,
        config: &Config,
        link: Option<&Link>,
    ) -> Result<Devices, RigBuildError> {
        let missing = |missing| RigBuildError::NoSensor {
            host: config.viper.host.clone(),
            missing,
        };
        if config.viper.dialect == ViperDialect::Adept2018 {
            return Err(RigBuildError::PositioningOnly);
        }
        if config.run.sensor == SensorKind::Images && config.cameras.calibration.is_empty() {
            return Err(missing("cameras.calibration and cameras.registration"));
        }
        let time = link.map_or_else(WallTime::start, Link::time);
        let (tracker, eyes) = match (tracked(config, time.clone(), &self.left_from_world)?, link) {
            (Some((tracker, eyes)), _) => (Some(tracker), eyes),
            (None, Some(link)) => (None, link.eyes(config)?),
            (None, None) => {
                let what = "cameras or a tracker: over ROS (ros.publish = true), or a tracker over \
                            OpenIGTLink (tracker.source)";
                return Err(missing(what));
            }
        };
        let marker = link.map_or_else(|| Ok(MarkerEyes::default()), |link| link.marker(config))?;
        let (arm, _) = host::connect(config, &self.chain, Some(&self.joints), time.clone())?;
        Ok(Devices {
            clock: Box::new(WallClock::since(time)),
            arm: Box::new(arm),
            eyes,
            marker,
            tracker,
            world: None,
            simulated_arm: None,
            emulator: None,
        })
    }

    /// The controller at the configured host, wherever its arm stands.
    pub(super) fn arm_only(
        &self,
        config: &Config,
        time: WallTime,
    ) -> Result<Devices, RigBuildError> {
        let (arm, _) = host::connect(config, &self.chain, None, time.clone())?;
        Ok(Devices {
            clock: Box::new(WallClock::since(time)),
            arm: Box::new(arm),
            eyes: Eyes::none(),
            marker: MarkerEyes::default(),
            tracker: None,
            world: None,
            simulated_arm: None,
            emulator: None,
        })
    }

    pub(super) fn over_ros(&self, config: &Config, link: &Link) -> Result<Devices, RigBuildError> {
        let parts = link.devices(config, &self.chain)?;
        let (tracker, eyes) = match tracked(config, link.time(), &self.left_from_world)? {
            Some((tracker, eyes)) => (Some(tracker), eyes),
            None => (None, parts.eyes),
        };
        Ok(Devices {
            clock: parts.clock,
            arm: parts.arm,
            eyes,
            marker: link.marker(config)?,
            tracker,
            world: parts.truth.map(|truth| Box::new(truth) as Box<dyn Scoring>),
            simulated_arm: None,
            emulator: None,
        })
    }
}

/// The tracker that `config` asks for, and what sees the needle through it.
fn tracked(
    config: &Config,
    time: WallTime,
    left_from_world: &Transform<LeftCamera, World>,
) -> Result<Option<(Tracker, Eyes)>, RigBuildError> {
    if !config.tracker.is_used() {
        return Ok(None);
    }
    let (tracker, sensor) = Tracker::open(config, time, left_from_world)?;
    Ok(Some((tracker, Eyes::Shape(Box::new(sensor)))))
}

/// The controller's own model in the phantom's place.
fn twin(
    config: &Config,
    settings: &phantom::Settings,
    world_from_base: &Transform<World, NeedleBase>,
) -> Result<Box<dyn Plant>, RigBuildError> {
    let draw = Draw::new(settings, config.run.seed);
    let nominal = settings.tip.cut_angle_deg.to_radians();
    Ok(Box::new(TwinPlant::new(
        config,
        &draw,
        nominal,
        world_from_base,
    )?))
}

/// An arm and what moves in the simulated world with it.
struct ArmParts {
    arm: Box<dyn Arm>,
    body: Box<dyn Body>,
    /// The wall's time, where that counts.
    time: Option<WallTime>,
    simulated_arm: Option<SimulatedArm>,
    emulator: Option<Emulator>,
}

impl ArmParts {
    fn of(config: &Config, chain: &Chain, joints: &hal::Joints) -> Result<Self, RigBuildError> {
        match config.run.backend {
            Backend::Sim => {
                let arm = SimulatedArm::new(chain, joints, SimSettings::default())?;
                Ok(Self {
                    simulated_arm: Some(arm.clone()),
                    ..Self::new(arm.driver(), arm)
                })
            }
            Backend::Viper => {
                if config.viper.dialect == ViperDialect::Adept2018 && !config.is_dry() {
                    return Err(RigBuildError::PositioningOnly);
                }
                if !config.viper.emulate {
                    let time = WallTime::start();
                    // Checks alone show where the arm is, wherever it stands.
                    let start = config.run.dry_run_air.then_some(joints);
                    let (arm, body) = host::connect(config, chain, start, time.clone())?;
                    return Ok(Self {
                        time: Some(time),
                        ..Self::new(arm, body)
                    });
                }
                let settings = host::settings(config);
                let dialect = settings.dialect;
                let core = viper::driver::Core::new(settings)?;
                let emulator = Emulator::new(EmulatorConfig::viper(dialect, *joints));
                let handle = emulator.clone();
                let (arm, lockstep) = viper::lockstep::Lockstep::over_tcp(core, emulator)?;
                Ok(Self {
                    emulator: Some(handle),
                    ..Self::new(arm, lockstep)
                })
            }
            Backend::Ros => Err(RigBuildError::NoNode),
        }
    }

    fn new(arm: impl Arm + 'static, body: impl Body + 'static) -> Self {
        Self {
            arm: Box::new(arm),
            body: Box::new(body),
            time: None,
            simulated_arm: None,
            emulator: None,
        }
    }
}

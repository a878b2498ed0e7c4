//! From a configuration to devices: clock, arm, sensor, and the world behind them.

use std::path::PathBuf;
use std::time::Duration;

use hal::frame::{ArmBase, LeftCamera, NeedleBase, World};
use hal::guarded::{Guard, Guarded, Limiter, LimiterError, SpeedCaps};
use hal::{
    Arm, Clock, Recorded, SensedShape, ShapeSensor, Stamp, StereoCamera, StereoFrame, Transform,
};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use phantom::camera::{CameraSettings, RigError, StereoRig};
use phantom::{Bench, Draw, Plant, SettingsError, bench::Setup};
use robots::arms;
use robots::kinematics::{Chain, Turns, UrdfError};
use robots::sim::{SimError, SimSettings, SimulatedArm};
use robots::viper::{self, Emulator, emulator::EmulatorConfig};

use crate::cameras;
use crate::clock::{LockstepClock, WallClock, WallTime};
use crate::config::{Backend, Config, PlantKind, SensorKind, ViperDialect};
use crate::cycle::Bearings;
use crate::host::{self, HostError};
use crate::springs::SpringsError;
use crate::twin::TwinPlant;
use crate::world::{Body, SimulatedWorld};

/// Ticks of the simulated world.
const TICK: Duration = Duration::from_millis(4);
/// Distance that guarded joints keep from their limits \[rad\].
const JOINT_MARGIN: f64 = 8.727e-3;
/// Longest wait for an arm's first report.
const CONNECT: Duration = Duration::from_secs(2);
/// Events kept for the fault report.
const EVENTS: usize = 256;

/// A configuration that makes no rig.
#[derive(Debug, thiserror::Error)]
pub enum RigBuildError {
    /// The URDF file cannot be read.
    #[error("{}: cannot be read: {source}", file.display())]
    UrdfFile {
        /// The file.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// The URDF gives no chain.
    #[error("URDF: {0}")]
    Urdf(#[from] UrdfError),
    /// The arm cannot hold the needle at its start.
    #[error("the arm cannot reach the start pose of the needle's base at {position_mm:?} mm")]
    StartUnreachable {
        /// The start \[mm\].
        position_mm: [f64; 3],
    },
    /// The phantom's settings.
    #[error("phantom: {0}")]
    Phantom(#[from] SettingsError),
    /// The cameras' settings.
    #[error("cameras: {0}")]
    Cameras(#[from] RigError),
    /// The simulated arm's settings.
    #[error("simulated arm: {0}")]
    Sim(#[from] SimError),
    /// The Viper driver's settings.
    #[error("Viper driver: {0}")]
    Viper(#[from] viper::driver::SetupError),
    /// The Viper driver's or the emulated controller's threads and sockets.
    #[error("Viper driver: {0}")]
    ViperStart(#[from] viper::tcp::StartError),
    /// The real controller.
    #[error(transparent)]
    Host(#[from] HostError),
    /// Nothing sees the needle on a real arm.
    #[error(
        "viper.emulate = false: an insertion on the controller at {host} needs cameras, and run.sensor = \"shape\" is the phantom's; only dry runs go without"
    )]
    NoSensor {
        /// Host of the controller.
        host: String,
    },
    /// A controller's program that cannot insert.
    #[error(
        "viper.dialect = \"adept2018\": segments of that program cannot be stopped, so it inserts no needle"
    )]
    PositioningOnly,
    /// The guard's limits.
    #[error("guard: {0}")]
    Guard(#[from] LimiterError),
    /// The controller's model as the plant.
    #[error("plant: {0}")]
    Twin(#[from] SpringsError),
    /// A device.
    #[error(transparent)]
    Device(#[from] hal::Error),
}

/// What sees the needle.
pub enum Eyes {
    /// A sensor of needle shapes.
    Shape(Box<dyn ShapeSensor>),
    /// A stereo camera, in whose images the needle is tracked.
    Cameras(Box<dyn StereoCamera>),
}

/// What the eyes saw since they were last asked.
#[derive(Clone, Debug, Default)]
pub enum Sighting {
    /// Nothing new.
    #[default]
    Nothing,
    /// The needle's shape.
    Shape(SensedShape),
    /// A pair of images.
    Pair(StereoFrame),
}

impl Sighting {
    /// Whether there is nothing new.
    pub const fn is_none(&self) -> bool {
        matches!(self, Self::Nothing)
    }

    /// The needle's shape, from a sensor of shapes.
    pub const fn shape(&self) -> Option<&SensedShape> {
        match self {
            Self::Shape(shape) => Some(shape),
            _ => None,
        }
    }

    /// The pair of images.
    pub const fn pair(&self) -> Option<&StereoFrame> {
        match self {
            Self::Pair(pair) => Some(pair),
            _ => None,
        }
    }

    /// When it was seen.
    pub fn stamp(&self) -> Option<Stamp> {
        match self {
            Self::Nothing => None,
            Self::Shape(shape) => Some(shape.stamp),
            Self::Pair(pair) => Some(pair.left.stamp),
        }
    }
}

impl Eyes {
    /// The newest sight.
    ///
    /// # Errors
    /// The sensor is gone.
    pub fn poll(&mut self) -> Result<Sighting, hal::Error> {
        Ok(match self {
            Self::Shape(sensor) => sensor.poll()?.map_or(Sighting::Nothing, Sighting::Shape),
            Self::Cameras(cameras) => cameras.poll()?.map_or(Sighting::Nothing, Sighting::Pair),
        })
    }
}

impl core::fmt::Debug for Eyes {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.write_str(match self {
            Self::Shape(_) => "Shape",
            Self::Cameras(_) => "Cameras",
        })
    }
}

/// The devices of one run.
pub struct Rig {
    /// The run's clock.
    pub clock: Box<dyn Clock>,
    /// The arm, guarded and recorded.
    pub arm: Recorded<Guarded<Box<dyn Arm>>>,
    /// What sees the needle.
    pub eyes: Eyes,
    /// Geometry as calibration and registration know it.
    pub bearings: Bearings,
    /// The simulated world, where there is one.
    pub world: Option<SimulatedWorld>,
    /// The simulated arm, where there is one, for faults.
    pub simulated_arm: Option<SimulatedArm>,
}

impl Rig {
    /// Builds what `config` asks for.
    ///
    /// # Errors
    /// See [`RigBuildError`].
    pub fn new(config: &Config) -> Result<Self, RigBuildError> {
        let chain = chain(config)?;
        let world_from_arm_base = arm_place(config);
        let (start, joints) = start_pose(config, &chain, &world_from_arm_base)?;

        let settings =
            phantom::Settings::preset(&config.run.phantom)?.overridden(config.phantom.clone())?;
        let world_from_entry = config.world_from_entry();
        let images = config.run.sensor == SensorKind::Images;
        let camera_settings = if images {
            cameras::settings(config)?
        } else {
            CameraSettings::ideal()
        };
        let stereo = StereoRig::new(&camera_settings, &world_from_entry, config.run.seed)?;
        let stereo_from_world = *stereo.stereo_from_world();
        let registered = stereo.given().left_from_world;
        let calibrated = images.then(|| cameras::calibrated(stereo.given()));
        let setup = Setup {
            world_from_phantom: world_from_entry,
            world_from_base: Transform::assume(start),
            left_from_world: stereo_from_world,
            seed: config.run.seed,
        };
        let bench = match config.run.plant {
            PlantKind::Phantom => Bench::new(&settings, &setup)?,
            PlantKind::Model => Bench::with_plant(&settings, &setup, |true_base| {
                twin(config, &settings, true_base)
            })?,
        };
        let bench = if images {
            bench.with_cameras(stereo)
        } else {
            bench
        };

        let (driver, body, time, simulated_arm) = arm(config, &chain, &joints)?;
        let period = driver.description().period;
        let world = SimulatedWorld::new(
            body,
            chain.clone(),
            world_from_arm_base,
            bench,
            stereo_from_world,
        );
        let moved = world.clone();
        let limiter = Limiter::new(chain.limits(), JOINT_MARGIN, period * 3)?;
        let guard =
            Guard::new(limiter).with_tool(Box::new(chain.clone()), None, SpeedCaps::INSERTING);
        let mut rig = Self {
            clock: match time {
                None => Box::new(LockstepClock::new(TICK, move |now| moved.advance_to(now))),
                Some(time) => Box::new(
                    WallClock::since(time).and_driving(TICK, move |now| moved.advance_to(now)),
                ),
            },
            arm: Recorded::new(Guarded::new(driver, guard)?, EVENTS),
            eyes: if images {
                Eyes::Cameras(Box::new(world.cameras()))
            } else {
                Eyes::Shape(Box::new(world.shape_sensor()))
            },
            bearings: Bearings {
                chain,
                world_from_arm_base,
                world_from_left_camera: registered.inverse(),
                cameras: calibrated,
            },
            world: Some(world),
            simulated_arm,
        };
        rig.await_feedback()?;
        Ok(rig)
    }

    /// Waits until the arm reports; a simulated one does at once.
    fn await_feedback(&mut self) -> Result<(), RigBuildError> {
        let deadline = self.clock.now() + CONNECT;
        loop {
            match self.arm.state() {
                Ok(_) => return Ok(()),
                Err(error) if self.clock.now() >= deadline => return Err(error.into()),
                Err(_) => {
                    let next = self.clock.now() + TICK;
                    self.clock.wait_until(next);
                }
            }
        }
    }

    /// The stereo frame as registered.
    pub fn left_from_world(&self) -> Transform<LeftCamera, World> {
        self.bearings.world_from_left_camera.inverse()
    }
}

impl core::fmt::Debug for Rig {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Rig")
            .field("bearings", &self.bearings)
            .finish_non_exhaustive()
    }
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

/// An arm's driver, what moves in the simulated world, the wall's time where that counts, and the
/// simulated arm if it is one.
type ArmParts = (
    Box<dyn Arm>,
    Box<dyn Body>,
    Option<WallTime>,
    Option<SimulatedArm>,
);

fn arm(config: &Config, chain: &Chain, joints: &hal::Joints) -> Result<ArmParts, RigBuildError> {
    match config.run.backend {
        Backend::Sim => {
            let arm = SimulatedArm::new(chain, joints, SimSettings::default())?;
            Ok((
                Box::new(arm.driver()),
                Box::new(arm.clone()),
                None,
                Some(arm),
            ))
        }
        Backend::Viper => {
            let is_dry = config.run.dry_run || config.run.dry_run_air;
            if !config.viper.emulate && !is_dry {
                return Err(RigBuildError::NoSensor {
                    host: config.viper.host.clone(),
                });
            }
            if config.viper.dialect == ViperDialect::Adept2018 && !is_dry {
                return Err(RigBuildError::PositioningOnly);
            }
            if !config.viper.emulate {
                let time = WallTime::start();
                // Checks alone show where the arm is, wherever it stands.
                let start = config.run.dry_run_air.then_some(joints);
                let (arm, body) = host::connect(config, chain, start, time)?;
                return Ok((Box::new(arm), Box::new(body), Some(time), None));
            }
            let settings = host::settings(config);
            let dialect = settings.dialect;
            let core = viper::driver::Core::new(settings)?;
            let emulator = Emulator::new(EmulatorConfig::viper(dialect, *joints));
            let (arm, lockstep) = viper::lockstep::Lockstep::over_tcp(core, emulator)?;
            Ok((Box::new(arm), Box::new(lockstep), None, None))
        }
    }
}

/// The arm's chain to the needle's base.
///
/// # Errors
/// The URDF file cannot be read or gives no chain.
pub fn chain(config: &Config) -> Result<Chain, RigBuildError> {
    let link = if config.arm.tip_link.is_empty() {
        arms::NEEDLE_BASE
    } else {
        config.arm.tip_link.as_str()
    };
    if config.arm.urdf.is_empty() {
        return Ok(Chain::from_urdf(arms::VIPER_S650, link)?);
    }
    let file = PathBuf::from(&config.arm.urdf);
    let xml = std::fs::read_to_string(&file)
        .map_err(|source| RigBuildError::UrdfFile { file, source })?;
    Ok(Chain::from_urdf(&xml, link)?)
}

/// Where things stand for a controller on `config`, with the stereo frame as registered.
///
/// # Errors
/// As [`chain`].
pub fn bearings(
    config: &Config,
    world_from_left_camera: Transform<World, LeftCamera>,
) -> Result<Bearings, RigBuildError> {
    Ok(Bearings {
        chain: chain(config)?,
        world_from_arm_base: arm_place(config),
        world_from_left_camera,
        cameras: None,
    })
}

fn arm_place(config: &Config) -> Transform<World, ArmBase> {
    let [x, y, z] = config.arm.base_mm.map(|v| v * 1e-3);
    let [roll, pitch, yaw] = config.arm.base_rpy_deg.map(f64::to_radians);
    Transform::assume(Isometry3::from_parts(
        Translation3::new(x, y, z),
        UnitQuaternion::from_euler_angles(roll, pitch, yaw),
    ))
}

/// Start pose of the needle's base and the joints for it. The needle's roll is free: it is chosen
/// so that the last joint starts at zero, with all of its travel in both senses.
fn start_pose(
    config: &Config,
    chain: &Chain,
    world_from_arm_base: &Transform<World, ArmBase>,
) -> Result<(Isometry3<f64>, hal::Joints), RigBuildError> {
    let start = config.world_from_start_base();
    let p = start.translation.vector * 1e3;
    let unreachable = || RigBuildError::StartUnreachable {
        position_mm: [p.x, p.y, p.z],
    };
    let reach = |pose: &Isometry3<f64>| {
        start_joints(chain, &(world_from_arm_base.isometry().inverse() * pose))
    };
    let mut joints = reach(&start).ok_or_else(unreachable)?;
    let roll = joints.last().copied().unwrap_or(0.0);
    let turned = start * UnitQuaternion::from_axis_angle(&Vector3::z_axis(), -roll);
    if let Some(last) = joints.last_mut() {
        *last = 0.0;
    }
    // An arm whose last joint does not turn about the needle keeps the first pose.
    let reached = world_from_arm_base.isometry() * chain.forward(&joints);
    if (reached.to_homogeneous() - turned.to_homogeneous())
        .abs()
        .max()
        < 1e-6
    {
        return Ok((turned, joints));
    }
    Ok((start, reach(&start).ok_or_else(unreachable)?))
}

/// The branch with most room: far from singularities and from the ends of the joints, its last
/// joint turned least, so that the needle can spin in both senses.
fn start_joints(chain: &Chain, base_from_tip: &Isometry3<f64>) -> Option<hal::Joints> {
    /// Reach over which the Jacobian's rows are compared \[m\].
    const LENGTH: f64 = 0.1;
    /// Room beyond which more is no better \[rad\].
    const ENOUGH: f64 = 1.0;
    let merit = |q: &hal::Joints| {
        let room = |(q, limit): (&f64, &hal::JointLimit)| (q - limit.lower).min(limit.upper - q);
        let least = q
            .iter()
            .zip(chain.limits())
            .map(room)
            .fold(ENOUGH, f64::min);
        let turned = q.last().map_or(0.0, |last| last.abs());
        chain.dexterity(q, LENGTH) + least - 0.1 * turned
    };
    chain
        .inverse(base_from_tip, Turns::One)
        .into_iter()
        .max_by(|a, b| merit(a).total_cmp(&merit(b)))
}

//! From a configuration to devices: clock, arm, sensor, and the world behind them.

mod at_start;
mod device;
mod devices;
mod eyes;
mod fit;
mod marker;
mod start;
mod suggest;
mod tool;

use std::path::PathBuf;
use std::time::Duration;

use hal::frame::{LeftCamera, World};
use hal::guarded::{Guard, Guarded, Limiter, LimiterError, SpeedCaps};
use hal::telemetry::Limit;
use hal::{Arm, ArmMode, Clock, Recorded, Transform};
use nalgebra::Vector3;
use phantom::SettingsError;
use phantom::camera::{CameraSettings, RigError, StereoRig};
use robots::sim::{SimError, SimulatedArm};
use robots::viper;

use crate::cameras;
use crate::clock::WallTime;
use crate::config::{Backend, Config, SensorKind, TrackerSource};
use crate::cycle::Bearings;
use crate::distortion::MapError;
use crate::fbg::{FibreError, Fibres};
use crate::guide::{Guide, GuideMisfit};
use crate::hand::{HandFed, Slide};
use crate::host::HostError;
use crate::remote::igtl::{Tracker, TrackerError};
use crate::ros::Link;
use crate::score::Scoring;
use crate::springs::SpringsError;
pub use at_start::NotAtStart;
pub use device::abilities;
use devices::{Devices, Place, TICK};
pub use devices::{Pace, PlantMaker};
pub use eyes::{Eyes, Sighting};
pub use fit::{Course, Demand, Misfit, check_chain, follow};
pub use marker::MarkerEyes;
pub(crate) use start::tool;
pub use start::{Start, arm_place, assumed_speeds, bearings, chain, check_arm, description, start};
use start::{by_hand, field, kept};
pub use suggest::{Place as Suggestion, placed, suggest};
pub(crate) use tool::PlacedTool;
use tool::check_start;

/// Longest wait for an arm's first report.
const CONNECT: Duration = Duration::from_secs(2);
/// Longest wait for an arm to come to rest.
const REST: Duration = Duration::from_secs(1);
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
    /// The URDF gives no chain; file, place and remedy.
    #[error("{0}")]
    Urdf(String),
    /// The arm cannot hold the needle at its start.
    #[error(
        "the arm cannot reach the start pose of the needle's base at {position_mm:?} mm{}",
        fit::PLACE
    )]
    StartUnreachable {
        /// The start \[mm\].
        position_mm: [f64; 3],
    },
    /// The arm cannot carry out the insertion.
    #[error(transparent)]
    Misfit(#[from] Misfit),
    /// The arm of this URDF cannot carry out any insertion.
    #[error("{}: {misfit}", file.display())]
    Arm {
        /// The file.
        file: PathBuf,
        /// Why.
        misfit: Box<Misfit>,
    },
    /// The needle cannot go through its guide.
    #[error(transparent)]
    Guide(#[from] GuideMisfit),
    /// The start lies outside of the box that the needle's base may use.
    #[error(
        "the needle's base would start at {position_mm:?} mm, outside of its box from {min_mm:?} to \
         {max_mm:?} mm (supervisor.workspace_min_mm, workspace_max_mm)"
    )]
    OutsideWorkspace {
        /// The start in World \[mm\].
        position_mm: [f64; 3],
        /// Lowest coordinates of the box \[mm\].
        min_mm: [f64; 3],
        /// Highest coordinates \[mm\].
        max_mm: [f64; 3],
    },
    /// The phantom's settings.
    #[error("phantom: {0}")]
    Phantom(#[from] SettingsError),
    /// The cameras' settings.
    #[error("cameras: {0}")]
    Cameras(#[from] RigError),
    /// The cameras cannot tell how far away the needle is.
    #[error(
        "the needle's axis and both cameras lie in one plane, but for {opening_deg:.1} degrees (at least \
         {:.1}): no pair of images says how far away it is; turn the pair of cameras about its view, \
         so that the needle runs across the line that joins them",
        cameras::LEAST_OPENING.to_degrees()
    )]
    NeedleAlongBaseline {
        /// Angle between the planes through the needle \[deg\].
        opening_deg: f64,
    },
    /// Calibration or registration of the cameras.
    #[error("cameras: {0}")]
    Calibration(#[from] vision::files::FileError),
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
        "viper.emulate = false: an insertion on the controller at {host} needs {missing}; only dry runs go without"
    )]
    NoSensor {
        /// Host of the controller.
        host: String,
        /// What is missing.
        missing: &'static str,
    },
    /// A controller's program that cannot insert.
    #[error(
        "viper.dialect = \"adept2018\": segments of that program cannot be stopped, so it inserts no needle"
    )]
    PositioningOnly,
    /// The back end `ros` outside of a run.
    #[error("the back end ros needs a ROS node: it works with `needle-steer run`")]
    NoNode,
    /// ROS.
    #[error("ROS: {0}")]
    Ros(#[from] rosbridge::NodeError),
    /// The arm behind ROS topics.
    #[error("arm over ROS: {0}")]
    RosArm(#[from] rosbridge::arm::RosArmError),
    /// The arm stands elsewhere.
    #[error(transparent)]
    NotAtStart(#[from] Box<NotAtStart>),
    /// The guard's limits.
    #[error("guard: {0}")]
    Guard(#[from] LimiterError),
    /// A plant of one's own.
    #[error("plant: {0}")]
    OwnPlant(String),
    /// The controller's model as the plant.
    #[error("plant: {0}")]
    Twin(#[from] SpringsError),
    /// The target is a marker that nothing sees.
    #[error(
        "target.kind = \"marker\": no marker is seen; over ROS its places come on the topic `marker` \
         (geometry_msgs/PointStamped in left_camera_optical_frame)"
    )]
    NoMarker,
    /// The cameras show no pairs of images.
    #[error("no pairs of images: {problem}")]
    NoImages {
        /// What keeps them from coming.
        problem: String,
    },
    /// The sensor of the tip measures nothing.
    #[error("the needle's tip is not measured: {problem}")]
    NoTip {
        /// What keeps measurements from coming.
        problem: String,
    },
    /// A hand has nothing to push.
    #[error(
        "insertion.by = \"hand\": no joint of the URDF slides along the needle; give it a prismatic one, which \
         stands for the needle in its guide and is not driven"
    )]
    NoSlide,
    /// The map of an electromagnetic field.
    #[error("em.map: {0}")]
    Map(#[from] MapError),
    /// The fibres' calibration.
    #[error("fbg.calibration: {0}")]
    Fibres(#[from] FibreError),
    /// The tracker of the tip.
    #[error("tracker: {0}")]
    Tracker(#[from] TrackerError),
    /// A device.
    #[error(transparent)]
    Device(#[from] hal::Error),
}

/// The same configuration where nobody looks at the needle: cameras and their files count no more.
pub fn blind(config: &Config) -> Config {
    let mut config = config.clone();
    config.run.sensor = SensorKind::Shape;
    config.tracker.source = TrackerSource::None;
    config.cameras.calibration.clear();
    config.cameras.second_calibration.clear();
    config.cameras.registration.clear();
    config
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
    /// What sees the marker that the tissue carries.
    pub marker: MarkerEyes,
    /// Where a tracker's measurements of the tip arrive, where it is the sensor.
    pub tracker: Option<Tracker>,
    /// The laboratory that knows the truth, where there is one: for protocol and score.
    pub world: Option<Box<dyn Scoring>>,
    /// The simulated arm, where there is one, for faults.
    pub simulated_arm: Option<SimulatedArm>,
    /// The Viper's emulated controller, where there is one, for faults.
    pub emulator: Option<viper::Emulator>,
    /// Joints at the start pose of the configuration.
    pub home: hal::Joints,
    /// What the straight insertion from there leaves the arm.
    pub course: Course,
    /// The needle in its guide, where a hand pushes it.
    pub slide: Option<Slide>,
    /// Number of the last command.
    sequence: u64,
}

impl Rig {
    /// Builds what `config` asks for.
    ///
    /// # Errors
    /// See [`RigBuildError`].
    pub fn new(config: &Config) -> Result<Self, RigBuildError> {
        Self::build(config, None)
    }

    /// Builds what `config` asks for, on the time of a ROS node if there is one and, for the back
    /// end `ros`, over its topics.
    ///
    /// # Errors
    /// See [`RigBuildError`].
    pub fn build(config: &Config, link: Option<&Link>) -> Result<Self, RigBuildError> {
        match (config.run.backend, link) {
            (Backend::Ros, Some(link)) => Self::assemble(config, |lab| lab.over_ros(config, link)),
            (Backend::Ros, None) => Err(RigBuildError::NoNode),
            (Backend::Viper, link) if !config.viper.emulate && !config.is_dry() => {
                Self::assemble(config, |lab| lab.real(config, link))
            }
            (_, link) => {
                let pace = link.map_or(Pace::Free, Link::pace);
                Self::simulated(config, pace)
            }
        }
    }

    /// Builds the arm that `config` asks for, a real one at its controller or one over ROS, and
    /// nothing that sees the needle. It may stand anywhere.
    ///
    /// # Errors
    /// See [`RigBuildError`].
    pub fn arm_only(config: &Config, link: Option<&Link>) -> Result<Self, RigBuildError> {
        let config = &blind(config);
        match (config.run.backend, link) {
            (Backend::Ros, Some(link)) => Self::assemble(config, |lab| lab.over_ros(config, link)),
            (Backend::Ros, None) => Err(RigBuildError::NoNode),
            (Backend::Viper | Backend::Sim, link) => {
                let time = link.map_or_else(WallTime::start, Link::time);
                Self::assemble(config, |lab| lab.arm_only(config, time))
            }
        }
    }

    /// Builds a simulated world that `config` asks for, its time at `pace`.
    ///
    /// # Errors
    /// See [`RigBuildError`].
    pub fn simulated(config: &Config, pace: Pace) -> Result<Self, RigBuildError> {
        Self::assemble(config, |lab| lab.simulated(config, pace, None))
    }

    /// Builds a simulated world around a plant of one's own, which `plant` makes for the true pose
    /// of the needle's base at the start. Robot flaws, sensors and cameras are those of `config`.
    ///
    /// # Errors
    /// See [`RigBuildError`].
    pub fn with_plant(config: &Config, plant: PlantMaker) -> Result<Self, RigBuildError> {
        Self::assemble(config, |lab| lab.simulated(config, Pace::Free, Some(plant)))
    }

    fn assemble(
        config: &Config,
        devices: impl FnOnce(Place) -> Result<Devices, RigBuildError>,
    ) -> Result<Self, RigBuildError> {
        let chain = chain(config)?;
        let world_from_arm_base = arm_place(config);
        let Start {
            world_from_base: start,
            joints,
            course,
        } = start(config, &chain, &world_from_arm_base)?;
        check_start(config, &start.translation.vector.into())?;
        if let Some(guide) = Guide::of(config) {
            guide.check(config)?;
        }
        let images = config.run.sensor == SensorKind::Images;
        let camera_settings = if images {
            cameras::settings(config)?
        } else {
            CameraSettings::ideal()
        };
        let seed = config.run.seed;
        let stereo = StereoRig::new(&camera_settings, &config.world_from_entry(), seed)?;
        let given = stereo.given();
        let (calibrated, world_from_left_camera) = cameras::measured(config)?.map_or_else(
            || {
                let world_from_left_camera = given.left_from_world.inverse();
                (cameras::calibrated(given), world_from_left_camera)
            },
            |measured| (measured.rig, measured.world_from_left_camera),
        );
        if images {
            let entry = config.world_from_entry();
            let (point, axis) = (entry.translation.vector.into(), entry * Vector3::z());
            let opening = cameras::opening(&calibrated, &world_from_left_camera, &point, &axis);
            if opening < cameras::LEAST_OPENING {
                return Err(RigBuildError::NeedleAlongBaseline {
                    opening_deg: opening.to_degrees(),
                });
            }
        }
        let (tip_sensor, map) = field(config)?;
        let by_hand = by_hand(config, &chain, &joints)?;
        let fibred = config.run.sensor == SensorKind::Fbg;
        let fibres = fibred.then(|| Fibres::new(config)).transpose()?;
        let devices = devices(Place {
            map: map.clone(),
            by_hand: by_hand.clone(),
            fibres: fibres.clone(),
            chain: chain.clone(),
            world_from_arm_base,
            start,
            joints,
            stereo,
            left_from_world: world_from_left_camera.inverse(),
        })?;
        let period = devices.arm.description().period;
        let limiter = Limiter::new(&kept(&chain), 0.0, period * 3)?;
        let tool = PlacedTool::new(&chain, world_from_arm_base.isometry());
        let guard = Guard::new(limiter).with_tool(tool, config.workspace(), SpeedCaps::INSERTING);
        let left_from_world = world_from_left_camera.inverse();
        let mut eyes = devices.eyes.corrected(map, &left_from_world);
        let mut arm = devices.arm;
        if let Some(fibres) = &fibres {
            arm = fibres.on(arm, chain.clone(), world_from_arm_base);
        }
        if let Some(by) = &by_hand {
            let tip = start * nalgebra::Point3::new(0.0, 0.0, config.needle.length_mm * 1e-3);
            let from = (tip, config.inward());
            eyes = eyes.telling_advance(by.slide.clone(), from, &left_from_world);
            arm = Box::new(HandFed::new(arm, by.clone()));
        }
        let mut rig = Self {
            clock: devices.clock,
            arm: Recorded::new(Guarded::new(arm, guard)?, EVENTS),
            eyes,
            slide: by_hand.map(|by| by.slide),
            bearings: Bearings {
                chain,
                world_from_arm_base,
                world_from_left_camera,
                cameras: images.then_some(calibrated),
                tip_sensor,
            },
            marker: devices.marker,
            tracker: devices.tracker,
            world: devices.world,
            simulated_arm: devices.simulated_arm,
            emulator: devices.emulator,
            home: joints,
            course,
            sequence: 0,
        };
        rig.await_feedback()?;
        Ok(rig)
    }

    /// The number of the next command; commands of one rig count on.
    pub fn next_sequence(&mut self) -> u64 {
        self.sequence += 1;
        self.sequence
    }

    /// Checks that the arm stands where an insertion starts.
    ///
    /// # Errors
    /// It stands elsewhere, with the figures.
    pub fn check_start(&self, state: &hal::ArmState) -> Result<(), RigBuildError> {
        NotAtStart::check(&self.bearings.chain, &state.positions, &self.home)?;
        Ok(())
    }

    /// Counts on from a command that was given before.
    pub const fn advance_sequence(&mut self, sequence: u64) {
        self.sequence = sequence;
    }

    /// Enables the arm, unless motion by hand has left it so.
    ///
    /// # Errors
    /// The arm does not report, or cannot be enabled.
    pub fn enable(&mut self) -> Result<(), hal::Error> {
        match self.arm.state()?.mode {
            ArmMode::Enabled | ArmMode::Moving | ArmMode::Stopping => Ok(()),
            _ => self.arm.enable(),
        }
    }

    /// Whether the guard kept the newest command from leading out of the workspace box.
    pub(crate) fn is_at_box(&self) -> bool {
        self.arm.inner().acted().contains(&Limit::Workspace)
    }

    /// Stops the arm and waits until it is at rest.
    ///
    /// # Errors
    /// The stop could not be delivered.
    pub fn come_to_rest(&mut self) -> Result<(), hal::Error> {
        let stopped = self.arm.stop();
        let patience = self.clock.now() + REST;
        let period = self.arm.description().period;
        while self.clock.now() < patience {
            match self.arm.state().map(|state| state.mode) {
                Ok(ArmMode::Moving | ArmMode::Stopping) => {
                    let next = self.clock.now() + period;
                    self.clock.wait_until(next);
                }
                _ => break,
            }
        }
        stopped
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

//! The configuration of a run. Every key is optional; units stand in the keys' names.
//!
//! The commented defaults are in `default.toml`, which a test holds against [`Config::default`].

mod check;
mod em;
mod fbg;
mod igtl;
mod insertion;
mod live;
mod load;
mod metres;
mod needle;
mod phantom;
mod ros;
mod supervisor;
mod tracker;

use std::collections::BTreeMap;

use hal::guarded::Workspace;
use nalgebra::{Isometry3, Matrix3, Point3, Rotation3, Unit, Vector3};
use serde::{Deserialize, Serialize};

pub(crate) use check::in_other_unit;
pub use em::Em;
pub use fbg::{Fbg, LocationsFrom};
pub use igtl::{Igtl, IgtlCoordinates, IgtlVersion, UnknownVersion};
pub use insertion::{Insertion, InsertionBy};
pub use live::Live;
pub(crate) use load::with_suggestion;
pub use load::{Base, ConfigError, Origin, assemble, load, parse, quoted};
pub use needle::{Needle, NeedleSupport};
pub use ros::{Ros, RosClock, RosImages};
pub use supervisor::Supervisor;
pub use tracker::{Tracker, TrackerSource};

/// The commented default configuration, as `needle-steer config default` prints it.
pub const DEFAULT_TOML: &str = include_str!("default.toml");

/// Largest seed of a run: integers in TOML have a sign.
pub const LARGEST_SEED: u64 = i64::MAX as u64;

/// A value outside its range.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Invalid {
    /// Dotted path of the key.
    pub key: String,
    /// What was found and what was expected.
    pub problem: String,
}

/// Everything a run needs to know.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// What to run.
    pub run: Run,
    /// Where to go.
    pub target: Target,
    /// The needle as the controller knows it.
    pub needle: Needle,
    /// Who pushes the needle.
    pub insertion: Insertion,
    /// The tissue as the controller assumes it at the start.
    pub tissue: Tissue,
    /// Bounds beyond which the supervisor stops the arm.
    pub supervisor: Supervisor,
    /// The arm.
    pub arm: Arm,
    /// The Viper's controller, for the back end `viper`.
    pub viper: Viper,
    /// ROS: telemetry, services, and the back end `ros`.
    pub ros: Ros,
    /// OpenIGTLink: what is shown, and what is asked.
    pub igtl: Igtl,
    /// A tracker over OpenIGTLink, for the sensor `em`.
    pub tracker: Tracker,
    /// The electromagnetic tip, for the sensor `em`.
    pub em: Em,
    /// Fibre Bragg gratings, for the sensor `fbg`.
    pub fbg: Fbg,
    /// The live view: what is shown, and what is asked.
    pub live: Live,
    /// Limits that every law keeps.
    pub limits: hybrid_control::Limits,
    /// The estimator of path, bevel, disturbance and stiffness.
    pub estimator: hybrid_control::EstimatorSettings,
    /// Motion of the tissue, where the target is a marker.
    pub motion: hybrid_control::MotionSettings,
    /// The laws.
    pub law: hybrid_control::LawSettings,
    /// The cameras, for the sensor `images`.
    pub cameras: Cameras,
    /// The tracker.
    pub tracking: vision::track::TrackSettings,
    /// Changes to the phantom's preset: tables and keys as the preset has them.
    pub phantom: toml::Table,
}

impl Config {
    /// The same configuration with nothing but the arm: the controller's own model stands for
    /// needle and tissue, the fast sensor for cameras.
    pub(crate) fn in_air(mut self) -> Self {
        self.run.plant = PlantKind::Springs;
        self.run.sensor = SensorKind::Shape;
        self.run.phantom = "ideal".into();
        self.tracker.source = TrackerSource::None;
        // An estimator believes no measurement that claims to be exact.
        let noise = [("noise_mm", 0.02), ("direction_noise_deg", 0.1)];
        let sensor = noise.map(|(key, value)| (key.to_owned(), value.into()));
        let sensor = toml::Table::from_iter(sensor);
        self.phantom = toml::Table::from_iter([("sensor".to_owned(), sensor.into())]);
        self
    }

    /// Whether an arm moves that waits for nobody: a real one, or one behind ROS on the wall clock.
    pub fn is_real(&self) -> bool {
        match self.run.backend {
            Backend::Sim => false,
            Backend::Viper => !self.viper.emulate,
            Backend::Ros => self.ros.clock == RosClock::Wall,
        }
    }

    /// Whether nothing is inserted into anything.
    pub const fn is_dry(&self) -> bool {
        self.run.dry_run || self.run.dry_run_air
    }

    /// The box that the needle's base may use, in World \[m\]; nothing where none is set.
    pub fn workspace(&self) -> Option<Workspace> {
        let s = &self.supervisor;
        let mut corners = s.workspace_min_mm.iter().chain(&s.workspace_max_mm);
        let set = corners.any(|x| x.abs() < FARTHEST_MM);
        set.then(|| Workspace {
            lower: (Vector3::from(s.workspace_min_mm) * 1e-3).into(),
            upper: (Vector3::from(s.workspace_max_mm) * 1e-3).into(),
        })
    }

    /// Nominal entry point in World \[m\].
    pub fn entry(&self) -> Point3<f64> {
        Point3::from(Vector3::from(self.tissue.entry_mm) * 1e-3)
    }

    /// Direction into the tissue, in World.
    pub fn inward(&self) -> Unit<Vector3<f64>> {
        Unit::new_normalize(Vector3::from(self.tissue.inward))
    }

    /// Pose at the nominal entry: z into the tissue, x as near to World's x as can be.
    pub fn world_from_entry(&self) -> Isometry3<f64> {
        let z = self.inward().into_inner();
        let towards = if z.x.abs() < 0.9 {
            Vector3::x()
        } else {
            Vector3::y()
        };
        let x = (towards - z * z.dot(&towards)).normalize();
        let rotation =
            Rotation3::from_matrix_unchecked(Matrix3::from_columns(&[x, z.cross(&x), z]));
        Isometry3::from_parts(self.entry().coords.into(), rotation.into())
    }

    /// Start pose of the needle's base: straight in front of the entry, tip on the surface.
    pub fn world_from_start_base(&self) -> Isometry3<f64> {
        self.world_from_entry() * Isometry3::translation(0.0, 0.0, -self.needle.length_mm * 1e-3)
    }
}

/// Which arm executes the commands.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Backend {
    /// The URDF kinematic simulator with the phantom.
    #[default]
    Sim,
    /// The Viper S650's socket driver: its emulated controller with the phantom, or a real one.
    Viper,
    /// Any arm behind ROS topics, the needle's shape from a topic.
    Ros,
}

/// What stands for the patient in simulation.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum PlantKind {
    /// The phantom: other physics than the controller's model.
    #[default]
    Phantom,
    /// The controller's own springs model, with the phantom's robot flaws and sensors; `model` is
    /// its former name.
    #[serde(alias = "model")]
    Springs,
    /// A bevel that cuts by a balance of forces in an elastic half-space.
    Continuum,
}

/// What closes the loop.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum SensorKind {
    /// The needle tracked in stereo images.
    #[default]
    Images,
    /// Needle shapes from the phantom's fast sensor.
    Shape,
    /// The tip alone, from an electromagnetic sensor in it: place and axis, no point of the shaft.
    Em,
    /// Fibre Bragg gratings in the needle: its shape from the base on, by how it bends.
    Fbg,
}

/// What to run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Run {
    /// Name of the steering law.
    pub law: String,
    /// Which arm executes the commands.
    pub backend: Backend,
    /// What closes the loop.
    pub sensor: SensorKind,
    /// Preset of the phantom.
    pub phantom: String,
    /// What stands for the patient in simulation.
    pub plant: PlantKind,
    /// Seed of everything random.
    pub seed: u64,
    /// Nominal speed along the needle \[mm/s\].
    pub insertion_speed_mm_s: f64,
    /// Longest duration of a run \[s\].
    pub max_duration_s: f64,
    /// Refuse a target that the predictive model says is out of reach.
    pub check_reach: bool,
    /// Move nothing: configuration, reachability and limits are checked only.
    pub dry_run: bool,
    /// Move the arm in air: the controller's own model stands for needle, tissue and sensor.
    pub dry_run_air: bool,
}

impl Default for Run {
    fn default() -> Self {
        Self {
            law: "hybrid".into(),
            backend: Backend::Sim,
            sensor: SensorKind::Images,
            phantom: "paper".into(),
            plant: PlantKind::Phantom,
            seed: 1,
            insertion_speed_mm_s: 1.0,
            max_duration_s: 600.0,
            check_reach: true,
            dry_run: false,
            dry_run_air: false,
        }
    }
}

/// How the target is given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum TargetKind {
    /// On the holder's nominal axis through the tip, `depth_mm` ahead.
    Aligned,
    /// As `aligned`, then shifted across the axis by `offset_mm` at `angle_deg`.
    #[default]
    Shifted,
    /// At `position_mm` in the stereo frame.
    Stereo,
    /// At `position_mm` in World.
    World,
    /// As `shifted` from where the straight start is expected to end, then carried by the tissue:
    /// a marker whose motion is measured and fed forward.
    Marker,
}

/// Where to go. Depth and offset count from the tip at the end of the straight pre-insertion.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Target {
    /// How the target is given.
    pub kind: TargetKind,
    /// Distance ahead of the tip \[mm\].
    pub depth_mm: f64,
    /// Distance across the axis \[mm\].
    pub offset_mm: f64,
    /// Direction of the offset from the bevel direction, right-handed about the needle's z \[deg\].
    pub angle_deg: f64,
    /// Target \[mm\]: for `kind = "stereo"` in the left camera's optical frame, for `"world"` in World.
    pub position_mm: [f64; 3],
    /// Measured distance from the tip axis within which a passed target counts as hit \[mm\].
    pub goal_mm: f64,
}

impl Target {
    /// `position_mm` in metres.
    pub fn point(&self) -> Point3<f64> {
        self.position_mm.map(|v| v * 1e-3).into()
    }
}

impl Default for Target {
    fn default() -> Self {
        Self {
            kind: TargetKind::Shifted,
            depth_mm: 80.0,
            offset_mm: 10.0,
            angle_deg: 135.0,
            position_mm: [0.0; 3],
            goal_mm: 0.5,
        }
    }
}

/// The tissue as the controller assumes it at the start.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Tissue {
    /// Distance between springs \[mm\].
    pub spring_spacing_mm: f64,
    /// Entry point on the surface, in World \[mm\].
    pub entry_mm: [f64; 3],
    /// Direction into the tissue, in World.
    pub inward: [f64; 3],
}

impl Default for Tissue {
    fn default() -> Self {
        Self {
            spring_spacing_mm: 2.5,
            entry_mm: [400.0, 0.0, 250.0],
            inward: [0.0, 0.0, -1.0],
        }
    }
}

/// Farthest place of anything from World's origin, along each axis \[mm\].
pub(crate) const FARTHEST_MM: f64 = 5000.0;

/// Program of the Viper's controller.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum ViperDialect {
    /// The project's own program: timed points, watchdog, braking stop.
    #[default]
    Steer,
    /// The public program of 2018: positioning only, refused for insertions.
    Adept2018,
}

/// The Viper's controller.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Viper {
    /// Start an emulated controller on the loopback interface, its arm holding the phantom's
    /// needle; otherwise connect to `host`.
    pub emulate: bool,
    /// Host name or address of the controller.
    pub host: String,
    /// What the controller speaks.
    pub dialect: ViperDialect,
    /// Port for points and stops; 0: the program's own.
    pub motion_port: u16,
    /// Port of the feedback; 0: the program's own.
    pub state_port: u16,
}

impl Default for Viper {
    fn default() -> Self {
        Self {
            emulate: true,
            host: "127.0.0.1".into(),
            dialect: ViperDialect::Steer,
            motion_port: 0,
            state_port: 0,
        }
    }
}

/// The cameras.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Cameras {
    /// Stereo calibration (`stereo.yml` of `calibrate stereo`, or another program's file) of the
    /// cameras; empty for simulated ones, whose calibration comes with them.
    pub calibration: String,
    /// Its second file where it comes in two: the right camera's, or the extrinsics.
    pub second_calibration: String,
    /// Unit of the calibration's lengths \[mm\]; 0 for metres, checked for plausibility.
    pub unit_mm: f64,
    /// Their registration to the arm (of `calibrate register`); goes with the calibration.
    pub registration: String,
    /// Width of the simulated images: 640 (x 480) or 1280 (x 960) \[px\].
    pub width_px: usize,
    /// Changes to the simulated cameras that go with the phantom's preset.
    pub simulated: toml::Table,
}

impl Default for Cameras {
    fn default() -> Self {
        Self {
            calibration: String::new(),
            second_calibration: String::new(),
            unit_mm: 0.0,
            registration: String::new(),
            width_px: 640,
            simulated: toml::Table::new(),
        }
    }
}

/// The arm.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Arm {
    /// URDF file; empty for the built-in Viper S650.
    pub urdf: String,
    /// Link that carries the needle: origin at the needle's base, z along the needle.
    pub tip_link: String,
    /// Where the needle's base lies in the tip link \[mm\].
    pub tip_mm: [f64; 3],
    /// How the needle is turned in the tip link: roll, pitch, yaw \[deg\].
    pub tip_rpy_deg: [f64; 3],
    /// Link at which the arm's chain begins; empty for the URDF's root.
    pub base_link: String,
    /// Take prismatic joints and any number of joints up to seven: stages, insertion-and-spin devices.
    pub mechanism: bool,
    /// Prismatic joints of the chain that are held still, and where \[mm\].
    pub held_joints_mm: BTreeMap<String, f64>,
    /// Turning joints of the chain that are held still, and where \[deg\].
    pub held_joints_deg: BTreeMap<String, f64>,
    /// Highest speed of the joints for which the URDF gives none \[deg/s\]; 0: not known.
    pub joint_speed_deg_s: f64,
    /// Place of the arm's base in World \[mm\].
    pub base_mm: [f64; 3],
    /// Orientation of the arm's base in World: roll, pitch, yaw \[deg\].
    pub base_rpy_deg: [f64; 3],
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::path::Path;

    #[test]
    fn default_file_and_code_agree() {
        let parsed = parse(DEFAULT_TOML, Path::new("default.toml"), &[]).unwrap();
        assert_eq!(parsed, Config::default());
        let keys: toml::Table = DEFAULT_TOML.parse().unwrap();
        let code = toml::Table::try_from(Config::default()).unwrap();
        for (section, values) in &code {
            for key in values.as_table().unwrap().keys() {
                assert!(
                    keys[section].get(key).is_some(),
                    "{section}.{key} is not in default.toml"
                );
            }
        }
    }
}

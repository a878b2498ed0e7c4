//! The one snapshot of a run that ROS, logs and reports show.

use nalgebra::{Vector2, Vector3};
use serde::{Deserialize, Serialize};

use crate::arm::ArmMode;
use crate::frame::{LeftCamera, NeedleBase, NeedleTip, World};
use crate::shape::SensedTip;
use crate::{Joints, Position, Stamp, Transform, Twist};

/// What the run is doing.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Phase {
    /// Waiting for a start.
    #[default]
    Idle,
    /// Straight insertion before steering starts.
    PreInsertion,
    /// Steering towards the target.
    Steering,
    /// Holding still on request.
    Paused,
    /// Withdrawing along the path.
    Retracting,
    /// Ended with a verdict.
    Ended,
    /// Stopped by a fault.
    Faulted,
}

/// How the law steers at this moment.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum SteeringMode {
    /// No steering: insertion only.
    #[default]
    Straight,
    /// Base manipulation and bevel orientation.
    Manipulation,
    /// Duty cycle, spinning phase.
    DutyCycleSpin,
    /// Duty cycle, translation phase.
    DutyCycleInsert,
    /// Turning the bevel.
    BevelTurn,
    /// Bevel held.
    BevelHold,
    /// No insertion: a measurement or a plan is missing.
    Hold,
}

/// Confidence in the needle's measurement.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Tracking {
    /// Nothing seen yet.
    #[default]
    None,
    /// Measured in the newest image.
    Tracked,
    /// Carried on by prediction.
    Predicted,
    /// Lost.
    Lost,
}

/// A limit that slowed or bent a command.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum Limit {
    /// Position of a joint (from 0).
    JointPosition(u8),
    /// Speed of a joint.
    JointVelocity(u8),
    /// Acceleration of a joint.
    JointAcceleration(u8),
    /// Jerk of a joint.
    JointJerk(u8),
    /// Workspace box of the tool.
    Workspace,
    /// Speed along the needle.
    InsertionSpeed,
    /// Speed of the base across the needle.
    LateralSpeed,
    /// Turning speed of the base.
    TiltSpeed,
    /// Spinning speed of the needle.
    SpinSpeed,
    /// Near a kinematic singularity.
    Singularity,
    /// Lateral force at the entry point.
    EntryForce,
    /// Tissue stretch at the entry point.
    EntryStretch,
    /// Tissue stretch along the needle.
    TissueStretch,
    /// Remote centre at the entry point.
    RemoteCentre,
    /// Curvature that the bevel can give.
    BevelCurvature,
    /// Remaining turns of the last joint.
    RemainingTurns,
}

/// What the law decided and why.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct LawReport {
    /// How it steers.
    pub mode: SteeringMode,
    /// Angle between the tip axis and the desired tip velocity \[rad\], eq. (22).
    pub heading_error: f64,
    /// Angle between the bevel and its desired orientation \[rad\], eq. (14).
    pub bevel_error: f64,
    /// Duty cycle in force, 0 (insertion only) to 1 (spinning only); NaN where none is.
    pub duty_cycle: f64,
    /// Predicted miss at the target's depth, across the tip axis \[m\]; NaN where not predicted.
    pub predicted_miss: Vector2<f64>,
    /// Shortfall of what is still reachable \[m\]; positive means out of reach, NaN unknown.
    pub shortfall: f64,
    /// Authority of a pivot of the base about the entry over the miss \[m/rad\]; NaN unknown.
    pub base_authority: f64,
    /// Authority of the bevel at full curvature over the miss \[m\]; NaN unknown.
    pub bevel_authority: f64,
    /// Limits that acted in the law and behind it, in no order.
    pub limits: Vec<Limit>,
}

/// State of the model and its parameters.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ModelReport {
    /// Shape of the model's needle in World, base to tip \[m\].
    pub shape: Vec<Vector3<f64>>,
    /// Where the shaft presses on the tissue: points on the needle, in World \[m\].
    pub spring_points: Vec<Vector3<f64>>,
    /// Rest points of the tissue, in World \[m\].
    pub rest_points: Vec<Vector3<f64>>,
    /// Predicted path from the tip to the target's depth, in World \[m\].
    pub predicted_path: Vec<Vector3<f64>>,
    /// Tissue stiffness per length \[N/m2\].
    pub stiffness: f64,
    /// Its standard deviation, relative; NaN where not estimated.
    pub stiffness_sigma: f64,
    /// Mean tissue displacement \[m\], eq. (16).
    pub mean_stretch: f64,
    /// Largest tissue displacement \[m\].
    pub max_stretch: f64,
    /// Tissue displacement at the entry point \[m\].
    pub entry_stretch: f64,
    /// Lateral force at the entry point \[N\].
    pub entry_force: f64,
    /// Iterations of the equilibrium.
    pub iterations: u32,
    /// Residual of the equilibrium, relative.
    pub residual: f64,
    /// Root mean square distance of the measured shaft from the model's \[m\]; NaN unknown. Not part
    /// of the messages of ROS and logs.
    #[serde(default)]
    pub shaft_off: f64,
    /// Largest distance of the measured shaft from where the measured tip went, in tissue at rest: what
    /// it stretches the tissue by \[m\]; NaN unknown. Not part of the messages of ROS and logs.
    #[serde(default)]
    pub path_off: f64,
}

/// Something that ends the regular course of an insertion in a simulated world.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TruthEvent {
    /// The shaft gave way.
    Buckling,
    /// The shaft is bent beyond its yield stress.
    Yielding,
    /// The tissue tore.
    Tearing,
    /// The cutting edge left the tissue.
    PulledOut,
    /// The cutting edge entered the tissue.
    Entered,
    /// No equilibrium was found: the state is out of balance.
    Unconverged,
    /// A pose of the base could not be simulated.
    Refused,
}

impl TruthEvent {
    /// Its name, as JSON has it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Buckling => "buckling",
            Self::Yielding => "yielding",
            Self::Tearing => "tearing",
            Self::PulledOut => "pulled_out",
            Self::Entered => "entered",
            Self::Unconverged => "unconverged",
            Self::Refused => "refused",
        }
    }

    /// Whether what comes after it says little of the law: needle or tissue are damaged, or the
    /// world is out of balance.
    pub const fn spoils(self) -> bool {
        !matches!(self, Self::PulledOut | Self::Entered)
    }
}

/// Hidden truth of a simulated world; never read by a law.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct TruthReport {
    /// When it was so.
    pub stamp: Stamp,
    /// Shape of the needle in World, base to tip \[m\].
    pub shape: Vec<Vector3<f64>>,
    /// Tip O in World \[m\].
    pub tip: Vector3<f64>,
    /// Tip axis in World.
    pub direction: Vector3<f64>,
    /// Target in World \[m\].
    pub target: Vector3<f64>,
    /// Distance of the target from the tip axis \[m\].
    pub lateral_error: f64,
    /// Target ahead of O along the tip axis \[m\].
    pub axial_distance: f64,
    /// Largest tissue displacement \[m\].
    pub max_stretch: f64,
    /// Mean tissue displacement \[m\].
    pub mean_stretch: f64,
    /// Length of the cut path, from the entry to the deepest cut \[m\]; 0 before the entry. Like all
    /// that follows it is not part of the messages of ROS and logs.
    #[serde(default)]
    pub path_length: f64,
    /// How far the tissue at the tip is from where it rests, in World \[m\].
    #[serde(default)]
    pub tissue_shift: Vector3<f64>,
    /// Lateral force on the shaft at the entry \[N\].
    #[serde(default)]
    pub entry_force: f64,
    /// What happened since the report before; notes tell of it in logs.
    #[serde(default)]
    pub events: Vec<TruthEvent>,
}

/// Everything there is to show about one step of a run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Telemetry {
    /// Number of the step, from 0.
    pub step: u64,
    /// When the step was computed.
    pub stamp: Stamp,
    /// When the newest image was taken.
    pub image_stamp: Option<Stamp>,
    /// What the run is doing.
    pub phase: Phase,
    /// Confidence in the measurement.
    pub tracking: Tracking,
    /// State of the arm's driver.
    pub arm_mode: ArmMode,
    /// Joint positions \[rad\].
    pub joints: Joints,
    /// Joint rates commanded \[rad/s\].
    pub joint_rates: Joints,
    /// Pose of the needle's base by odometry.
    pub world_from_base: Transform<World, NeedleBase>,
    /// Pose of the model's tip.
    pub world_from_tip: Transform<World, NeedleTip>,
    /// Base twist commanded by the law, in World.
    pub base_twist: Twist,
    /// The measured tip.
    pub measured_tip: Option<SensedTip>,
    /// The target in the stereo frame \[m\].
    pub target: Position<LeftCamera>,
    /// Measured distance of the target from the tip axis \[m\]; NaN before the first measurement.
    pub lateral_error: f64,
    /// Measured distance of the target ahead of the tip along its axis \[m\].
    pub axial_distance: f64,
    /// Length of needle in the tissue \[m\].
    pub depth: f64,
    /// The law's decision.
    pub law: LawReport,
    /// The model's state.
    pub model: ModelReport,
    /// Hidden truth, in simulation.
    pub truth: Option<TruthReport>,
}

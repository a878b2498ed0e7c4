//! Limits that downstream code cannot violate.
//!
//! [`Limiter`] is the pure limiter of joint rates; [`Guard`] adds a workspace and speed caps of
//! the tool; [`Guarded`] puts a guard in front of any [`Arm`](crate::Arm). A driver that streams set points
//! uses a [`Guard`] on its own set points, where the guarantees are exact.

mod arm;
mod axis;
mod binding;
mod blend;
mod limiter;
mod motion;

use nalgebra::{Isometry3, Point3};

pub use arm::Guarded;
pub use limiter::Limiter;
pub use motion::{Course, Limited, LimiterError, Motion};

use crate::telemetry::Limit;
use crate::{Joints, Twist};

/// Halvings of a command that would leave the workspace, before it is stopped.
const WORKSPACE_HALVINGS: u32 = 8;
/// Longest stop that is looked ahead for the workspace, in periods.
const LONGEST_STOP: usize = 4096;

/// Kinematics of the guarded tool, in the frame in which its workspace is given.
pub trait Tool: Send {
    /// Pose of the tool, its z along the needle, for joint positions \[rad\].
    fn pose(&self, positions: &Joints) -> Isometry3<f64>;

    /// Twist of the tool's origin for joint rates \[rad/s\].
    fn twist(&self, positions: &Joints, rates: &Joints) -> Twist;
}

/// A box that the tool's origin must not leave \[m\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Workspace {
    /// Lowest coordinates \[m\].
    pub lower: Point3<f64>,
    /// Highest coordinates \[m\].
    pub upper: Point3<f64>,
}

impl Workspace {
    /// How far `point` is outside, along the axis where it is worst \[m\]; 0 inside. A box with a
    /// bound that is not a number has no inside.
    pub fn excess(&self, point: &Point3<f64>) -> f64 {
        if self
            .lower
            .iter()
            .chain(self.upper.iter())
            .any(|x| x.is_nan())
        {
            return f64::INFINITY;
        }
        (0..3).fold(0.0, |worst: f64, k| {
            worst
                .max(self.lower[k] - point[k])
                .max(point[k] - self.upper[k])
        })
    }
}

/// Highest speeds of the tool's origin \[m/s\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpeedCaps {
    /// Along the needle.
    pub along: f64,
    /// Across the needle.
    pub across: f64,
}

impl SpeedCaps {
    /// For all motion of a needle, in the tissue or beside it: 5 mm/s along it, 8 mm/s across.
    pub const INSERTING: Self = Self {
        along: 0.005,
        across: 0.008,
    };
    /// No cap.
    pub const NONE: Self = Self {
        along: f64::INFINITY,
        across: f64::INFINITY,
    };
}

/// A [`Limiter`], a workspace and speed caps of the tool, and the memory of the motion.
pub struct Guard {
    limiter: Limiter,
    motion: Motion,
    tool: Option<Box<dyn Tool>>,
    workspace: Option<Workspace>,
    caps: SpeedCaps,
}

impl Guard {
    /// Joint limits only.
    pub fn new(limiter: Limiter) -> Self {
        let mut rest = Joints::from([0.0; crate::MAX_JOINTS]);
        if let Ok(zeros) = Joints::zeros(limiter.limits().len()) {
            rest = zeros;
        }
        Self {
            limiter,
            motion: Motion::steady(rest),
            tool: None,
            workspace: None,
            caps: SpeedCaps::NONE,
        }
    }

    /// With limits of the tool: a workspace, where given, and speed caps.
    #[must_use]
    pub fn with_tool(
        mut self,
        tool: Box<dyn Tool>,
        workspace: Option<Workspace>,
        caps: SpeedCaps,
    ) -> Self {
        self.tool = Some(tool);
        self.workspace = workspace;
        self.caps = caps;
        self
    }

    /// The joint limiter.
    pub fn limiter(&self) -> &Limiter {
        &self.limiter
    }

    /// What the guard last let through.
    pub fn motion(&self) -> &Motion {
        &self.motion
    }

    /// Tells the guard that the arm moves differently from what it let through last: it was
    /// stopped or has just been connected.
    pub fn assume(&mut self, motion: Motion) {
        self.motion = motion;
    }

    /// Rates for the coming period `dt` \[s\] of an arm at `positions` \[rad\]; see
    /// [`Limiter::step`]. All limits keep the direction of `wanted`. With a workspace, what is
    /// let through can be stopped inside it by wanting zero; exactly so if the arm executes it
    /// for `dt`, which then stays the same. An invalid period, or one beyond the holding time,
    /// counts as that.
    pub fn step(&mut self, positions: &Joints, wanted: &Joints, dt: f64) -> Limited {
        let dt = self.limiter.period(dt);
        let mut limits = Vec::new();
        let scale = self.cap(positions, wanted, &mut limits);
        let capped = wanted.map(|x| x * scale);
        let mut limited = self.limiter.step(positions, &self.motion, &capped, dt);
        if self.leaves_workspace(positions, &limited.rates, dt) {
            limits.push(Limit::Workspace);
            limited = self.inside_workspace(positions, &capped, dt);
        }
        self.motion = self.after(&limited.rates, dt);
        limits.append(&mut limited.limits);
        limited.limits = limits;
        limited
    }

    fn after(&self, rates: &Joints, dt: f64) -> Motion {
        Motion {
            rates: *rates,
            accelerations: rates.zip(&self.motion.rates, |new, old| (new - old) / dt),
        }
    }

    /// Factor by which the speed caps slow `wanted`.
    fn cap(&self, positions: &Joints, wanted: &Joints, limits: &mut Vec<Limit>) -> f64 {
        let Some(tool) = &self.tool else { return 1.0 };
        // A cap that is not a number, or negative, lets nothing through.
        let [cap_along, cap_across] = [self.caps.along, self.caps.across].map(|cap| cap.max(0.0));
        let velocity = tool.twist(positions, wanted).linear;
        let axis = tool.pose(positions).rotation * nalgebra::Vector3::z();
        let along = velocity.dot(&axis);
        let across = (velocity - axis * along).norm();
        if !(along.is_finite() && across.is_finite()) {
            limits.push(Limit::InsertionSpeed);
            return 0.0;
        }
        let mut scale = 1.0;
        if along.abs() > cap_along {
            scale = cap_along / along.abs();
            limits.push(Limit::InsertionSpeed);
        }
        if across > cap_across {
            scale = (cap_across / across).min(scale);
            limits.push(Limit::LateralSpeed);
        }
        scale
    }

    /// Whether one period at `rates` and the stop after it go (further) out of the workspace.
    fn leaves_workspace(&self, positions: &Joints, rates: &Joints, dt: f64) -> bool {
        let (Some(tool), Some(workspace)) = (&self.tool, &self.workspace) else {
            return false;
        };
        let outside = |q: &Joints| workspace.excess(&Point3::from(tool.pose(q).translation.vector));
        let mut worst = outside(positions);
        if worst == f64::INFINITY {
            return !rates.iter().all(|x| *x == 0.0);
        }
        let mut q = positions.zip(rates, |q, rate| q + rate * dt);
        let mut motion = self.after(rates, dt);
        let rest = rates.zeroed();
        for _ in 0..LONGEST_STOP {
            let excess = outside(&q);
            if excess > worst {
                return true;
            }
            worst = excess;
            if motion.is_rest() {
                return false;
            }
            let next = self.limiter.step(&q, &motion, &rest, dt).rates;
            motion = Motion {
                rates: next,
                accelerations: next.zip(&motion.rates, |new, old| (new - old) / dt),
            };
            q = q.zip(&next, |q, rate| q + rate * dt);
        }
        true
    }

    /// The fastest part of `wanted` that stays in the workspace; the stop that was looked ahead
    /// one period ago if none does.
    fn inside_workspace(&self, positions: &Joints, wanted: &Joints, dt: f64) -> Limited {
        let step = |scale: f64| {
            let slowed = wanted.map(|x| x * scale);
            self.limiter.step(positions, &self.motion, &slowed, dt)
        };
        let (mut good, mut best, mut bad) = (0.0, step(0.0), 1.0);
        for _ in 0..WORKSPACE_HALVINGS {
            let middle = 0.5 * (good + bad);
            let limited = step(middle);
            if self.leaves_workspace(positions, &limited.rates, dt) {
                bad = middle;
            } else {
                (good, best) = (middle, limited);
            }
        }
        best
    }
}

impl core::fmt::Debug for Guard {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Guard")
            .field("limiter", &self.limiter)
            .field("motion", &self.motion)
            .field("workspace", &self.workspace)
            .field("caps", &self.caps)
            .finish_non_exhaustive()
    }
}

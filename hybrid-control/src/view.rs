//! What a law sees and what it answers.

use hal::telemetry::{LawReport, SteeringMode};
use hal::{Stamp, Twist};
use nalgebra::{Isometry3, Matrix6, Point3, RowVector6, Unit, Vector2, Vector3};

use crate::estimator::Estimator;
use crate::freedom::Freedom;
use crate::settings::Limits;

/// The tip at the present time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tip {
    /// Pose of the tip frame (origin O, z along the axis, bevel direction -y) in World.
    pub world_from_tip: Isometry3<f64>,
    /// Standard deviation of the position across the axis, per axis \[m\].
    pub position_sigma: f64,
    /// Standard deviation of the direction, per axis \[rad\].
    pub direction_sigma: f64,
    /// Time since the last measurement \[s\]; infinite before the first.
    pub age: f64,
}

impl Tip {
    /// Coordinates of a World point in the tip frame \[m\].
    pub fn locate(&self, point: &Point3<f64>) -> Vector3<f64> {
        self.world_from_tip.inverse_transform_point(point).coords
    }

    /// The tip axis in World.
    pub fn axis(&self) -> Vector3<f64> {
        self.world_from_tip.rotation * Vector3::z()
    }
}

/// The target at the present time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Target {
    /// Position in World \[m\].
    pub position: Point3<f64>,
    /// Velocity in World \[m/s\].
    pub velocity: Vector3<f64>,
}

/// Where the needle enters the tissue.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// The entry point on the surface at rest, in World \[m\].
    pub point: Point3<f64>,
    /// Normal of the surface, into the tissue.
    pub inward: Unit<Vector3<f64>>,
}

/// Converged springs model: equilibrium and first derivatives.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Springs {
    /// Pose of the model's tip in World.
    pub world_from_tip: Isometry3<f64>,
    /// Base twist (of the base's origin) to tip twist (of O), both in World; eq. (12) before
    /// the change of axes.
    pub j_tip_base: Matrix6<f64>,
    /// Mean tissue displacement \[m\], eq. (16).
    pub mean_stretch: f64,
    /// Its derivative by the base twist \[m per unit twist\].
    pub j_mean_stretch: RowVector6<f64>,
    /// Tissue displacement at the entry point \[m\].
    pub entry_stretch: f64,
    /// Lateral force at the entry point \[N\].
    pub entry_force: f64,
}

/// Travel left for turning the needle about its own axis, both numbers non-negative \[rad\].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RollTravel {
    /// In the positive sense about the needle's z.
    pub positive: f64,
    /// In the negative sense.
    pub negative: f64,
}

impl RollTravel {
    /// The travel with `reserve` \[rad\] kept on either side.
    #[must_use]
    pub fn within(&self, reserve: f64) -> Self {
        Self {
            positive: (self.positive - reserve).max(0.0),
            negative: (self.negative - reserve).max(0.0),
        }
    }

    /// From one end to the other \[rad\].
    pub fn total(&self) -> f64 {
        self.positive + self.negative
    }

    /// As [`RollTravel::within`], with less of the reserve where less than `whole` \[rad\] would
    /// be left, down to `least` \[rad\].
    #[must_use]
    pub fn within_spare(&self, reserve: f64, least: f64, whole: f64) -> Self {
        let spare = 0.5 * (self.total() - whole);
        self.within(spare.max(least).min(reserve))
    }

    /// The end, as a rotation from here \[rad\], from which a bevel that shall turn by `wish`
    /// \[rad\], full turns not counting, differs least.
    pub fn end_next_to(&self, wish: f64) -> f64 {
        let off = |end: f64| crate::tasks::wrap(wish - end).abs();
        if off(self.positive) <= off(-self.negative) {
            self.positive
        } else {
            -self.negative
        }
    }

    /// Whether a rotation by the signed `angle` \[rad\] stays inside the travel.
    pub fn allows(&self, angle: f64) -> bool {
        if angle >= 0.0 {
            angle <= self.positive
        } else {
            -angle <= self.negative
        }
    }
}

/// Everything a law may use for one decision.
#[derive(Clone, Copy, Debug)]
pub struct View<'a> {
    /// The present time.
    pub time: Stamp,
    /// Time for which the decision will act \[s\].
    pub dt: f64,
    /// The filtered tip.
    pub tip: Tip,
    /// The target.
    pub target: Target,
    /// The entry.
    pub entry: Entry,
    /// Length of needle in the tissue \[m\].
    pub depth: f64,
    /// Pose of the needle's base in World.
    pub world_from_base: Isometry3<f64>,
    /// Springs model; `None` when it did not converge.
    pub springs: Option<Springs>,
    /// The needle by the springs model, from the base to the tip, in World \[m\]; nothing
    /// while it has no equilibrium.
    pub shape: &'a [Vector3<f64>],
    /// The estimator, with the predictive model.
    pub estimator: &'a Estimator,
    /// Travel left for spinning.
    pub roll_travel: RollTravel,
    /// What the device can do with the base.
    pub freedom: Freedom,
    /// Limits to keep.
    pub limits: &'a Limits,
    /// Nominal speed of insertion \[m/s\].
    pub insertion_speed: f64,
}

impl View<'_> {
    /// The needle's axis at its base, in World.
    pub fn base_axis(&self) -> Vector3<f64> {
        self.world_from_base.rotation * Vector3::z()
    }

    /// Base twist of a rotation about the entry point at `omega` \[rad/s\].
    pub fn pivot(&self, omega: &Vector3<f64>) -> Twist {
        let arm = self.world_from_base.translation.vector - self.entry.point.coords;
        Twist {
            linear: omega.cross(&arm),
            angular: *omega,
        }
    }

    /// Whether the device spins the needle.
    pub fn spins(&self) -> bool {
        self.freedom.gives(&self.screw(0.0, 1.0))
    }

    /// Base twist of insertion at `speed` \[m/s\] along the base's axis and spin about it at
    /// `omega` \[rad/s\].
    pub fn screw(&self, speed: f64, omega: f64) -> Twist {
        let axis = self.base_axis();
        Twist {
            linear: axis * speed,
            angular: axis * omega,
        }
    }

    /// Whether every number that a law reads is finite.
    pub fn is_finite(&self) -> bool {
        let pose = |p: &Isometry3<f64>| {
            p.translation.vector.iter().all(|x| x.is_finite())
                && p.rotation.coords.iter().all(|x| x.is_finite())
        };
        let springs = self.springs.is_none_or(|s| {
            pose(&s.world_from_tip)
                && s.j_tip_base.iter().all(|x| x.is_finite())
                && s.j_mean_stretch.iter().all(|x| x.is_finite())
                && s.mean_stretch.is_finite()
                && s.entry_stretch.is_finite()
        });
        springs
            && pose(&self.tip.world_from_tip)
            && pose(&self.world_from_base)
            && self.target.position.iter().all(|x| x.is_finite())
            && self.target.velocity.iter().all(|x| x.is_finite())
            && self.entry.point.iter().all(|x| x.is_finite())
            && self.entry.inward.iter().all(|x| x.is_finite())
            && self.roll_travel.positive.is_finite()
            && self.roll_travel.negative.is_finite()
            && [self.dt, self.depth, self.insertion_speed]
                .iter()
                .all(|x| x.is_finite())
            && self.tip.direction_sigma.is_finite()
    }
}

/// What a law decided.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Decision {
    /// Twist of the needle base's origin, in World.
    pub twist: Twist,
    /// Why.
    pub report: LawReport,
}

impl Decision {
    /// Standing still.
    pub fn hold() -> Self {
        Self {
            twist: Twist::zero(),
            report: LawReport {
                mode: SteeringMode::Hold,
                ..blank_report()
            },
        }
    }
}

/// A report in which everything that may be unknown is unknown.
pub(crate) fn blank_report() -> LawReport {
    LawReport {
        duty_cycle: f64::NAN,
        predicted_miss: Vector2::from_element(f64::NAN),
        shortfall: f64::NAN,
        base_authority: f64::NAN,
        bevel_authority: f64::NAN,
        ..LawReport::default()
    }
}

/// A steering law.
///
/// # Contract
/// * `decide` never fails and never blocks. What cannot be used (a non-finite number, a missing
///   model, a solver without success) gives zero velocity and the mode
///   [`Hold`](SteeringMode::Hold).
/// * The twist respects the speeds of [`Limits`] and the roll travel of the view, and is one that
///   the device can give.
/// * State is advanced by `view.dt` a call.
pub trait Law: Send {
    /// The name by which configurations select it, and results name it.
    fn name(&self) -> &str;

    /// The base twist from now on.
    fn decide(&mut self, view: &View<'_>) -> Decision;

    /// The path that the newest decision expects, in World \[m\]; nothing from laws that do not
    /// predict.
    fn predicted_path(&self, estimator: &Estimator, path: &mut Vec<Vector3<f64>>) {
        let _ = estimator;
        path.clear();
    }

    /// Forgets the past: a new insertion, or steering that resumes after a retraction.
    fn reset(&mut self);
}

//! From a policy's numbers to the twist of the base.

use core::f64::consts::TAU;

use hal::Twist;
use hybrid_control::{Entry, Limits, inside_workspace};
use nalgebra::{Isometry3, Vector3};

/// Turn of the base about the needle from its start, on either side \[rad\]: what the last joint of
/// a Viper S650 allows.
const ROLL_TRAVEL: f64 = TAU;

/// Which numbers a policy gives, each from -1 to 1.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Actions {
    /// The base twist in the base's frame: velocity of its origin (the third is the insertion), then
    /// angular velocity (the sixth is the spin).
    #[default]
    Twist,
    /// Insertion, two pivots about the entry (about the base's x and y), spin.
    Pivot,
    /// Insertion and spin.
    Bevel,
}

impl Actions {
    /// Names of all of them.
    pub const NAMES: [&str; 3] = ["twist", "pivot", "bevel"];

    /// The actions of that name.
    pub fn named(name: &str) -> Option<Self> {
        Some(match name {
            "twist" => Self::Twist,
            "pivot" => Self::Pivot,
            "bevel" => Self::Bevel,
            _ => return None,
        })
    }

    /// How many numbers.
    pub const fn len(self) -> usize {
        match self {
            Self::Twist => 6,
            Self::Pivot => 4,
            Self::Bevel => 2,
        }
    }

    /// Never.
    pub const fn is_empty(self) -> bool {
        false
    }
}

/// A policy's answer in numbers from -1 to 1.
pub type Action<'a> = &'a [f32];

/// The base twist in World that `action` asks for, within the limits: speeds, the box of places and
/// tilts that the base may use, and the travel of its roll. Numbers beyond -1 to 1 count as these;
/// what is not finite counts as 0.
pub(super) fn twist(
    actions: Actions,
    action: Action<'_>,
    base: &Isometry3<f64>,
    roll: f64,
    entry: &Entry,
    limits: &Limits,
    dt: f64,
) -> Twist {
    let share = |k: usize| {
        let number = action.get(k).copied().map_or(0.0, f64::from);
        if number.is_finite() {
            number.clamp(-1.0, 1.0)
        } else {
            0.0
        }
    };
    let lateral = limits.lateral_speed_mm_s * 1e-3;
    let insertion = limits.insertion_speed_mm_s * 1e-3;
    let (tilt, spin) = (
        limits.tilt_speed_deg_s.to_radians(),
        limits.spin_speed_deg_s.to_radians(),
    );
    let (along, across, turn, roll_rate) = match actions {
        Actions::Twist => (
            share(2),
            Vector3::new(share(0), share(1), 0.0) * lateral,
            Vector3::new(share(3), share(4), 0.0) * tilt,
            share(5),
        ),
        Actions::Pivot => (
            share(0),
            Vector3::zeros(),
            Vector3::new(share(1), share(2), 0.0) * tilt,
            share(3),
        ),
        Actions::Bevel => (share(0), Vector3::zeros(), Vector3::zeros(), share(1)),
    };
    let axis = base.rotation * Vector3::z();
    let mut tilting = base.rotation * turn.cap_magnitude(tilt);
    let mut moving = base.rotation * across.cap_magnitude(lateral);
    if actions == Actions::Pivot {
        let arm = base.translation.vector - entry.point.coords;
        let pivot = tilting.cross(&arm);
        // A long arm moves faster than the base may: the whole pivot is slowed.
        let part = (lateral / pivot.norm().max(f64::MIN_POSITIVE)).min(1.0);
        tilting *= part;
        moving = pivot * part;
    }
    let side = Twist {
        linear: moving,
        angular: tilting,
    };
    let part = inside_workspace(&side, base, entry, limits);
    let wanted = roll_rate * spin * dt;
    let rolled = (roll + wanted).clamp(-ROLL_TRAVEL, ROLL_TRAVEL) - roll;
    Twist {
        linear: moving * part + axis * (along * insertion),
        angular: tilting * part + axis * (rolled / dt),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Point3;

    fn entry() -> Entry {
        Entry {
            point: Point3::origin(),
            inward: Vector3::z_axis(),
        }
    }

    #[test]
    fn a_full_action_is_the_limits_and_nonsense_is_rest() {
        let limits = Limits::default();
        let base = Isometry3::translation(0.0, 0.0, -0.126);
        let of = |actions, action: &[f32]| {
            twist(actions, action, &base, 0.0, &entry(), &limits, 1.0 / 30.0)
        };
        let full = of(Actions::Twist, &[0.0, 1.0, 1.0, -1.0, 0.0, 1.0]);
        assert!((full.linear - Vector3::new(0.0, 8e-3, 3e-3)).norm() < 1e-12);
        let angular = Vector3::new(-3.0_f64.to_radians(), 0.0, TAU);
        assert!((full.angular - angular).norm() < 1e-9, "{}", full.angular);
        let corner = of(Actions::Twist, &[9.0, 9.0, 0.0, 9.0, 9.0, 0.0]);
        assert!((corner.linear.norm() - 8e-3).abs() < 1e-12);
        assert!((corner.angular.norm() - 3.0_f64.to_radians()).abs() < 1e-12);
        assert_eq!(
            of(Actions::Bevel, &[f32::NAN, f32::INFINITY]),
            Twist::zero()
        );
        let pivot = of(Actions::Pivot, &[0.0, 1.0, 0.0, 0.0]);
        let at_entry = pivot.linear + pivot.angular.cross(&Vector3::new(0.0, 0.0, 0.126));
        assert!(at_entry.norm() < 1e-12 && pivot.angular.x > 0.0);
    }

    #[test]
    fn the_roll_stays_in_its_travel() {
        let limits = Limits::default();
        let base = Isometry3::identity();
        let dt = 1.0 / 30.0;
        let mut roll = 0.0;
        for _ in 0..1000 {
            let turn = twist(
                Actions::Bevel,
                &[0.0, 1.0],
                &base,
                roll,
                &entry(),
                &limits,
                dt,
            );
            roll += turn.angular.z * dt;
        }
        assert!((roll - ROLL_TRAVEL).abs() < 1e-9);
    }
}

//! An affine field of displacement over depth, and what it does to points, poses and twists.

use hal::Twist;
use nalgebra::{Isometry3, Point3, Quaternion, Unit, UnitQuaternion, Vector3};

use crate::settings::Limits;
use crate::view::Entry;
use crate::workspace::inside_workspace;

/// Tissue displaced by `shift + shear * depth`, depth along the surface's inward normal at rest.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TissueField {
    entry: Point3<f64>,
    inward: Unit<Vector3<f64>>,
    /// Displacement at the surface \[m\] and its rate \[m/s\].
    shift: [Vector3<f64>; 2],
    /// Displacement per depth and its rate \[1/s\].
    shear: [Vector3<f64>; 2],
}

/// Largest shear taken for real: about 17 degrees.
const LARGEST_SHEAR: f64 = 0.3;

impl TissueField {
    /// Tissue at rest.
    pub fn still(entry: &Entry) -> Self {
        Self::new(entry, [Vector3::zeros(); 2], [Vector3::zeros(); 2])
    }

    /// A field of \[shift \[m\], shear\] and their rates per second.
    pub(super) fn new(entry: &Entry, value: [Vector3<f64>; 2], rate: [Vector3<f64>; 2]) -> Self {
        Self {
            entry: entry.point,
            inward: entry.inward,
            shift: [value[0], rate[0]],
            shear: [value[1].cap_magnitude(LARGEST_SHEAR), rate[1]],
        }
    }

    /// Takes over the rates of another instant.
    pub(super) fn take_rates(&mut self, other: &Self) {
        self.shift[1] = other.shift[1];
        self.shear[1] = other.shear[1];
    }

    fn depth_at_rest(&self, point: &Point3<f64>) -> f64 {
        let n = &self.inward;
        ((point - self.entry).dot(n) - self.shift[0].dot(n)) / (1.0 + self.shear[0].dot(n))
    }

    /// Where a point of the moving tissue (World) is at rest \[m\].
    pub fn point_to_rest(&self, point: &Point3<f64>) -> Point3<f64> {
        let depth = self.depth_at_rest(point);
        point - self.shift[0] - self.shear[0] * depth
    }

    /// Where a point at rest is now, in World \[m\].
    pub fn point_from_rest(&self, point: &Point3<f64>) -> Point3<f64> {
        let depth = (point - self.entry).dot(&self.inward);
        point + self.shift[0] + self.shear[0] * depth
    }

    /// A direction of the moving tissue at rest.
    pub fn direction_to_rest(&self, direction: &Unit<Vector3<f64>>) -> Unit<Vector3<f64>> {
        let n = &self.inward;
        let along = direction.dot(n) / (1.0 + self.shear[0].dot(n));
        Unit::new_normalize(direction.into_inner() - self.shear[0] * along)
    }

    fn direction_from_rest(&self, direction: &Vector3<f64>) -> Vector3<f64> {
        (direction + self.shear[0] * direction.dot(&self.inward)).normalize()
    }

    /// A pose carried to rest: its origin as a point, its z axis as a direction, turned the
    /// shortest way.
    pub fn pose_to_rest(&self, pose: &Isometry3<f64>) -> Isometry3<f64> {
        let axis = Unit::new_normalize(pose.rotation * Vector3::z());
        let at_rest = self.direction_to_rest(&axis);
        carried(pose, &axis, &at_rest, |p| self.point_to_rest(p))
    }

    /// The inverse of [`Self::pose_to_rest`].
    pub fn pose_from_rest(&self, pose: &Isometry3<f64>) -> Isometry3<f64> {
        let axis = pose.rotation * Vector3::z();
        let now = self.direction_from_rest(&axis);
        carried(pose, &axis, &now, |p| self.point_from_rest(p))
    }

    /// Twist in World of a body that moves with `twist` at rest, where its pose is `at_rest`:
    /// the field's own motion is fed forward.
    ///
    /// Spin about the z axis is kept; what the shortest turn adds to it is of second order in
    /// the shear.
    pub fn twist_from_rest(&self, at_rest: &Isometry3<f64>, twist: &Twist) -> Twist {
        let n = self.inward.into_inner();
        let origin = Point3::from(at_rest.translation.vector);
        let depth = (origin - self.entry).dot(&n);
        let linear = twist.linear
            + self.shear[0] * twist.linear.dot(&n)
            + self.shift[1]
            + self.shear[1] * depth;
        let axis = at_rest.rotation * Vector3::z();
        let turning = twist.angular.cross(&axis);
        let carried = axis + self.shear[0] * axis.dot(&n);
        let rate = turning + self.shear[0] * turning.dot(&n) + self.shear[1] * axis.dot(&n);
        let now = carried.normalize();
        let now_rate = (rate - now * now.dot(&rate)) / carried.norm();
        Twist {
            linear,
            angular: now.cross(&now_rate) + now * twist.angular.dot(&axis),
        }
    }

    /// As [`Self::twist_from_rest`], the law's part slowed until the whole keeps the speeds of
    /// `limits`; motion of the tissue that is too fast by itself is followed as fast as allowed,
    /// and up to the workspace's bounds.
    pub fn twist_within(&self, at_rest: &Isometry3<f64>, twist: &Twist, limits: &Limits) -> Twist {
        let whole = self.twist_in_speed(at_rest, twist, limits);
        let entry = Entry {
            point: self.entry,
            inward: self.inward,
        };
        let base = self.pose_from_rest(at_rest);
        whole.scaled(inside_workspace(&whole, &base, &entry, limits))
    }

    /// See [`Self::twist_within`]; without the workspace.
    fn twist_in_speed(&self, at_rest: &Isometry3<f64>, twist: &Twist, limits: &Limits) -> Twist {
        let axis = self.direction_from_rest(&(at_rest.rotation * Vector3::z()));
        let follow = self.twist_from_rest(at_rest, &Twist::zero());
        let over = excess(&follow, &axis, limits);
        if over > 1.0 {
            return follow.scaled(1.0 / over);
        }
        let with = |share: f64| self.twist_from_rest(at_rest, &twist.scaled(share));
        if excess(&with(1.0), &axis, limits) <= 1.0 + 1e-9 {
            return with(1.0);
        }
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..20 {
            let middle = 0.5 * (low + high);
            if excess(&with(middle), &axis, limits) <= 1.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        with(low)
    }
}

/// A pose whose axis `from` becomes `to` by the shortest turn, its origin moved by `place`.
fn carried(
    pose: &Isometry3<f64>,
    from: &Vector3<f64>,
    to: &Vector3<f64>,
    place: impl Fn(&Point3<f64>) -> Point3<f64>,
) -> Isometry3<f64> {
    // Along the half turn's cosine and sine: exact for small turns, where an arc cosine is not.
    let half = Quaternion::from_parts(1.0 + from.dot(to), from.cross(to));
    let turn = UnitQuaternion::try_new(half, 1e-9).unwrap_or_default();
    let origin = place(&Point3::from(pose.translation.vector));
    Isometry3::from_parts(origin.coords.into(), turn * pose.rotation)
}

/// Largest of the speeds of a base twist over its limit.
fn excess(twist: &Twist, axis: &Vector3<f64>, limits: &Limits) -> f64 {
    let (along, spin) = (axis.dot(&twist.linear), axis.dot(&twist.angular));
    [
        along.abs() / (limits.insertion_speed_mm_s * 1e-3),
        (twist.linear - axis * along).norm() / (limits.lateral_speed_mm_s * 1e-3),
        (twist.angular - axis * spin).norm() / limits.tilt_speed_deg_s.to_radians(),
        spin.abs() / limits.spin_speed_deg_s.to_radians(),
    ]
    .into_iter()
    .fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn entry() -> Entry {
        Entry {
            point: Point3::new(0.4, 0.0, 0.25),
            inward: -Vector3::z_axis(),
        }
    }

    fn field(x: &[f64], seconds: f64) -> TissueField {
        let v = |k: usize| Vector3::new(x[k], x[k + 1], x[k + 2]);
        let (shift, shear) = (v(0) * 5e-3, v(3) * 0.05);
        let (shift_rate, shear_rate) = (v(6) * 5e-3, v(9) * 0.05);
        TissueField::new(
            &entry(),
            [shift + shift_rate * seconds, shear + shear_rate * seconds],
            [shift_rate, shear_rate],
        )
    }

    fn base(x: &[f64]) -> Isometry3<f64> {
        Isometry3::new(
            Vector3::new(0.4 + 0.01 * x[0], 0.01 * x[1], 0.33 + 0.03 * x[2]),
            Vector3::new(core::f64::consts::PI, 0.0, 0.0),
        ) * UnitQuaternion::from_scaled_axis(Vector3::new(0.1 * x[3], 0.1 * x[4], x[5]))
    }

    proptest! {
        #![proptest_config(crate::seeded())]

        /// To rest and back is the same pose and the same point.
        #[test]
        fn rest_and_back(x in prop::collection::vec(-1.0_f64..1.0, 18)) {
            let (field, pose) = (field(&x, 0.0), base(&x[12..]));
            let back = field.pose_from_rest(&field.pose_to_rest(&pose));
            prop_assert!((back.to_homogeneous() - pose.to_homogeneous()).abs().max() < 1e-12);
            let point = Point3::from(pose.translation.vector);
            prop_assert!((field.point_from_rest(&field.point_to_rest(&point)) - point).norm() < 1e-14);
        }

        /// The twist that is fed forward is the derivative of the pose.
        #[test]
        fn feed_forward_is_the_derivative(
            x in prop::collection::vec(-1.0_f64..1.0, 18), y in prop::collection::vec(-1.0_f64..1.0, 6),
        ) {
            let rest = base(&x[12..]);
            let twist = Twist {
                linear: Vector3::new(y[0], y[1], y[2]) * 3e-3,
                angular: Vector3::new(y[3], y[4], y[5]) * 0.05,
            };
            let fed = field(&x, 0.0).twist_from_rest(&rest, &twist);
            let h = 1e-4;
            let at = |t: f64| field(&x, t).pose_from_rest(&twist.integrate(&rest, t));
            let (a, b) = (at(-h), at(h));
            let linear = (b.translation.vector - a.translation.vector) / (2.0 * h);
            let angular = (b.rotation * a.rotation.inverse()).scaled_axis() / (2.0 * h);
            prop_assert!((linear - fed.linear).norm() < 1e-8);
            // The spin of the shortest turn is left out: shear squared.
            let axis = at(0.0).rotation * Vector3::z();
            let difference = angular - fed.angular;
            prop_assert!((difference - axis * axis.dot(&difference)).norm() < 1e-6);
            prop_assert!(difference.norm() < 2e-2);
        }

        /// Whatever the field and the law ask for, the limits hold.
        #[test]
        fn limits_hold_with_feed_forward(
            x in prop::collection::vec(-3.0_f64..3.0, 18), y in prop::collection::vec(-1.0_f64..1.0, 6),
        ) {
            let limits = Limits::default();
            let pose: Vec<f64> = x[12..].iter().map(|v| v / 3.0).collect();
            let rest = base(&pose);
            let twist = Twist {
                linear: Vector3::new(y[0], y[1], y[2]) * 5e-3,
                angular: Vector3::new(y[3], y[4], y[5]) * 0.1,
            };
            let field = field(&x, 0.0);
            let whole = field.twist_within(&rest, &twist, &limits);
            let axis = field.pose_from_rest(&rest).rotation * Vector3::z();
            prop_assert!(excess(&whole, &axis, &limits) <= 1.0 + 1e-6);
        }
    }

    /// A base at the bound is not carried out of it, and may be carried in.
    #[test]
    fn moving_tissue_does_not_carry_the_base_out_of_its_workspace() {
        let limits = Limits::default();
        let outermost = limits.base_offset_mm * 1e-3;
        let rest = Isometry3::new(
            Vector3::new(0.4 + outermost, 0.0, 0.33),
            Vector3::new(core::f64::consts::PI, 0.0, 0.0),
        );
        for speed in [3e-3, -3e-3] {
            let rate = [Vector3::x() * speed, Vector3::zeros()];
            let field = TissueField::new(&entry(), [Vector3::zeros(); 2], rate);
            let carried = field.twist_within(&rest, &Twist::zero(), &limits).linear.x;
            assert!((carried - speed.min(0.0)).abs() < 1e-6, "{carried}");
        }
    }

    #[test]
    fn still_tissue_changes_nothing() {
        let (field, pose) = (TissueField::still(&entry()), base(&[0.3; 6]));
        let rest = field.pose_to_rest(&pose);
        assert!((rest.to_homogeneous() - pose.to_homogeneous()).abs().max() < 1e-15);
        let twist = Twist {
            linear: Vector3::new(1e-3, 0.0, -1e-3),
            angular: Vector3::new(0.01, 0.02, 0.0),
        };
        let fed = field.twist_within(&rest, &twist, &Limits::default());
        assert!((fed.to_vector() - twist.to_vector()).norm() < 1e-12);
    }
}

//! How far the base has come along the needle.

use std::collections::VecDeque;

use hal::Stamp;
use nalgebra::{Isometry3, Vector3};

/// Readings kept: 4 s at the 16 ms period of a Viper, 1 s at 4 ms.
const KEPT: usize = 256;

/// Motion of the base along the needle's own axis, integrated; positive into the tissue.
#[derive(Clone, Debug, Default)]
pub struct Advance {
    last: Option<Isometry3<f64>>,
    readings: VecDeque<(Stamp, f64)>,
    total: f64,
}

impl Advance {
    /// Takes in the pose of the base at `stamp`; one that is not newer than the last is ignored.
    pub fn push(&mut self, stamp: Stamp, world_from_base: &Isometry3<f64>) {
        if self.readings.back().is_some_and(|(last, _)| *last >= stamp) {
            return;
        }
        if let Some(last) = &self.last {
            let axis = last.rotation.slerp(&world_from_base.rotation, 0.5) * Vector3::z();
            self.total += axis.dot(&(world_from_base.translation.vector - last.translation.vector));
        }
        self.last = Some(*world_from_base);
        if self.readings.len() == KEPT {
            self.readings.pop_front();
        }
        self.readings.push_back((stamp, self.total));
    }

    /// The way since the first pose \[m\].
    pub const fn total(&self) -> f64 {
        self.total
    }

    /// The way at `stamp`, linear between readings, held at both ends \[m\].
    pub fn at(&self, stamp: Stamp) -> Option<f64> {
        let after = self.readings.partition_point(|(at, _)| *at < stamp);
        let Some((t1, next)) = self.readings.get(after) else {
            return self.readings.back().map(|(_, way)| *way);
        };
        let Some((t0, before)) = after.checked_sub(1).and_then(|i| self.readings.get(i)) else {
            return Some(*next);
        };
        let share = stamp.secs_since(*t0) / t1.secs_since(*t0);
        Some(before + share * (next - before))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::UnitQuaternion;

    #[test]
    fn only_motion_along_the_needle_counts() {
        let mut advance = Advance::default();
        let mut pose = Isometry3::identity();
        let push = |advance: &mut Advance, k: u64, pose: &Isometry3<f64>| {
            advance.push(Stamp::from_nanos(k * 10_000_000), pose);
        };
        push(&mut advance, 0, &pose);
        for k in 1..=100 {
            pose *= Isometry3::translation(2e-5, 0.0, 1e-5);
            push(&mut advance, k, &pose);
        }
        assert!((advance.total() - 1e-3).abs() < 1e-12);
        assert!((advance.at(Stamp::from_secs(0.505)).unwrap() - 0.505e-3).abs() < 1e-12);
        // A pivot about a point 100 mm ahead moves the base across the needle.
        let ahead = Isometry3::translation(0.0, 0.0, 0.1);
        for k in 101..=200 {
            let turn = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), 2e-3);
            pose = pose * ahead * turn * ahead.inverse();
            push(&mut advance, k, &pose);
        }
        assert!((advance.total() - 1e-3).abs() < 1e-6, "{}", advance.total());
    }
}

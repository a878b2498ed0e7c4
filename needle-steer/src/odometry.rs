//! Recent base poses, so that a measurement meets the pose of its own instant.

use std::collections::VecDeque;

use hal::Stamp;
use nalgebra::Isometry3;

/// Poses of the needle's base over the last second or so, from the encoders.
#[derive(Clone, Debug)]
pub struct Odometry {
    poses: VecDeque<(Stamp, Isometry3<f64>)>,
    capacity: usize,
}

impl Odometry {
    /// Keeps the newest `capacity` poses.
    pub fn new(capacity: usize) -> Self {
        Self {
            poses: VecDeque::with_capacity(capacity),
            capacity,
        }
    }

    /// Adds a pose; one that is not newer than the last is ignored.
    pub fn push(&mut self, stamp: Stamp, world_from_base: Isometry3<f64>) {
        if self.poses.back().is_some_and(|(last, _)| *last >= stamp) {
            return;
        }
        if self.poses.len() == self.capacity {
            self.poses.pop_front();
        }
        self.poses.push_back((stamp, world_from_base));
    }

    /// The newest pose.
    pub fn newest(&self) -> Option<&(Stamp, Isometry3<f64>)> {
        self.poses.back()
    }

    /// The pose at `stamp`: interpolated between its neighbours, held at both ends.
    pub fn at(&self, stamp: Stamp) -> Option<Isometry3<f64>> {
        let after = self.poses.iter().position(|(s, _)| *s >= stamp);
        match after {
            None => self.poses.back().map(|(_, pose)| *pose),
            Some(0) => self.poses.front().map(|(_, pose)| *pose),
            Some(index) => {
                let (t0, before) = self.poses.get(index - 1)?;
                let (t1, next) = self.poses.get(index)?;
                let fraction = stamp.secs_since(*t0) / t1.secs_since(*t0);
                Some(between(before, next, fraction))
            }
        }
    }
}

/// Linear in position, along the shortest rotation in orientation.
fn between(a: &Isometry3<f64>, b: &Isometry3<f64>, fraction: f64) -> Isometry3<f64> {
    let turn = (a.rotation.inverse() * b.rotation).scaled_axis() * fraction;
    Isometry3::from_parts(
        a.translation
            .vector
            .lerp(&b.translation.vector, fraction)
            .into(),
        a.rotation * nalgebra::UnitQuaternion::from_scaled_axis(turn),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Vector3;

    #[test]
    fn interpolates_and_holds_at_the_ends() {
        let mut odometry = Odometry::new(3);
        assert!(odometry.at(Stamp::ZERO).is_none());
        for k in 0..5_u32 {
            let pose = Isometry3::new(
                Vector3::z() * f64::from(k),
                Vector3::z() * (0.1 * f64::from(k)),
            );
            odometry.push(Stamp::from_secs(f64::from(k)), pose);
        }
        let middle = odometry.at(Stamp::from_secs(3.25)).unwrap();
        assert!((middle.translation.z - 3.25).abs() < 1e-12);
        assert!((middle.rotation.angle() - 0.325).abs() < 1e-12);
        assert!((odometry.at(Stamp::ZERO).unwrap().translation.z - 2.0).abs() < 1e-15);
        assert!((odometry.at(Stamp::from_secs(9.0)).unwrap().translation.z - 4.0).abs() < 1e-15);
    }
}

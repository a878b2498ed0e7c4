//! The way back: base poses of an insertion, and the twist that retraces them.

use hal::Twist;
use nalgebra::{Isometry3, Vector3};

/// Distance between kept poses \[m\].
const SPACING: f64 = 0.2e-3;
/// Turn between kept poses \[rad\].
const TURN: f64 = 0.1;
/// A kept pose counts as passed within this \[m\], \[rad\]: the way back looks one pose ahead.
const PASSED: (f64, f64) = (0.3e-3, 0.15);
/// The start counts as reached within this \[m\], \[rad\].
const REACHED: (f64, f64) = (0.1e-3, 5e-3);
/// Shortest time to a pose \[s\]: longer than an arm's latency, so that it is not overshot.
const HORIZON: f64 = 0.15;

/// Base poses of the insertion so far, oldest first.
#[derive(Clone, Debug, Default)]
pub struct Withdrawal {
    poses: Vec<Isometry3<f64>>,
}

impl Withdrawal {
    /// Keeps a pose of the insertion, unless it is close to the last.
    pub fn note(&mut self, pose: &Isometry3<f64>) {
        let near = self.poses.last().is_some_and(|last| {
            let (distance, turn) = apart(last, pose);
            distance.norm() < SPACING && turn.norm() < TURN
        });
        if !near {
            self.poses.push(*pose);
        }
    }

    /// Twist of the base at `pose` towards the newest pose left, at most at `speed` \[m/s\] and
    /// `spin` \[rad/s\]; poses reached are dropped. Nothing when the start is reached.
    pub fn twist(&mut self, pose: &Isometry3<f64>, speed: f64, spin: f64) -> Option<Twist> {
        loop {
            let (distance, turn) = apart(pose, self.poses.last()?);
            let near = if self.poses.len() == 1 {
                REACHED
            } else {
                PASSED
            };
            if distance.norm() < near.0 && turn.norm() < near.1 {
                self.poses.pop();
                continue;
            }
            // Both arrive together; the slower of the two sets the time.
            let time = (distance.norm() / speed)
                .max(turn.norm() / spin)
                .max(HORIZON);
            return Some(Twist {
                linear: distance / time,
                angular: turn / time,
            });
        }
    }
}

/// Translation and rotation vector from `a` to `b`, in World.
fn apart(a: &Isometry3<f64>, b: &Isometry3<f64>) -> (Vector3<f64>, Vector3<f64>) {
    let distance = b.translation.vector - a.translation.vector;
    (distance, (b.rotation * a.rotation.inverse()).scaled_axis())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_curved_way_is_retraced_to_its_start() {
        let mut withdrawal = Withdrawal::default();
        let at = |k: f64| {
            Isometry3::new(
                Vector3::new(1e-5 * k * k, 0.0, 5e-4 * k),
                Vector3::z() * (0.02 * k),
            )
        };
        let mut k = 0.0;
        while k <= 60.0 {
            withdrawal.note(&at(k));
            k += 0.25;
        }
        let (mut pose, dt) = (at(60.0), 0.016);
        let (mut steps, mut farthest) = (0, 0.0_f64);
        while let Some(twist) = withdrawal.twist(&pose, 2e-3, 1.0) {
            assert!(twist.linear.norm() < 2e-3 + 1e-12 && twist.angular.norm() < 1.0 + 1e-12);
            pose = twist.integrate(&pose, dt);
            let k = pose.translation.z / 5e-4;
            farthest = farthest.max((pose.translation.x - 1e-5 * k * k).abs());
            steps += 1;
            assert!(steps < 10_000, "never arrives");
        }
        let (distance, turn) = apart(&pose, &at(0.0));
        assert!(distance.norm() < REACHED.0 && turn.norm() < REACHED.1);
        // Chords of 0.5 mm leave this parabola by less than 1e-5.
        assert!(farthest < 5e-5, "left the way by {farthest} m");
    }
}

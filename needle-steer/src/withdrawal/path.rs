//! The way back: where the arm was during an insertion, and the joint rates that retrace it.
//!
//! Joints are retraced, not poses: a pose does not say how often the last joint has turned.

use hal::{Joints, Twist};
use nalgebra::{Isometry3, Point3, Vector3};

/// Distance between kept poses \[m\].
const SPACING: f64 = 0.2e-3;
/// Turn of a joint between kept poses \[rad\].
const TURN: f64 = 0.1;
/// A kept pose counts as passed within this \[m\], a joint within \[rad\]: the way back looks one pose ahead.
const PASSED: (f64, f64) = (0.3e-3, 0.15);
/// The start counts as reached within this \[m\], a joint within \[rad\].
const REACHED: (f64, f64) = (0.1e-3, 5e-3);
/// Shortest time to a pose \[s\]: longer than an arm's latency, so that it is not overshot.
const HORIZON: f64 = 0.15;
/// A turn of one radian counts as this way \[m\] where the way left is measured, ...
const LEVER: f64 = 10e-3;
/// ... and as this where the nearest pose is looked for: places count first.
const NEAR_LEVER: f64 = 1e-3;
/// The base counts as on the path within this distance \[m\] and tilt \[rad\]. How far it is
/// turned about the needle hurts nothing: a stop finds it spinning, and the way back unwinds that.
const ON_PATH: (f64, f64) = (1e-3, 0.1);
/// What an arm needs to come to rest at the guard's caps (8 mm/s across, 5 mm/s along), a relay and
/// late feedback included \[m\]: 0.35 s.
const BRAKING: f64 = 3e-3;
/// Beyond the recorded end the base may have left its axis by this share of the way, besides
/// [`Lead::aside`].
const SLOPE: f64 = 0.3;
/// ... and be tilted by so much \[rad\].
const TILT: f64 = 0.35;
/// A base that pivoted holds its needle so near to the entry \[m\]: outside of the tissue it is bent.
const ENTRY: f64 = 10e-3;

/// Where a base may be beyond the recorded end of its path, if it went on unrecorded.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lead {
    /// At most so far ahead of the end along its axis \[m\].
    pub ahead: f64,
    /// At most so far beside that axis \[m\], and a share of the way ahead besides.
    pub aside: f64,
    /// Where the needle enters the tissue, if the base may have pivoted about that.
    pub through: Option<Point3<f64>>,
}

impl Lead {
    /// Nothing is missing.
    pub const NONE: Self = Self {
        ahead: 0.0,
        aside: 0.0,
        through: None,
    };
    /// The whole way was recorded: the arm still braked.
    pub const BRAKED: Self = Self {
        ahead: BRAKING,
        aside: BRAKING,
        through: None,
    };
    /// A fault let the arm of this process go on.
    pub const WENT_ON: Self = Self {
        ahead: 30e-3,
        aside: BRAKING,
        through: None,
    };

    /// The log breaks off: any part of the needle may follow, and the base may have gone aside by
    /// centimetres, as laws that pivot it do; but its needle still goes in at the entry.
    pub const fn broken_off(entry: Point3<f64>) -> Self {
        Self {
            ahead: 0.3,
            aside: BRAKING,
            through: Some(entry),
        }
    }

    /// Whether a base at `pose` is within it of the path's `end`.
    fn holds(&self, pose: &Isometry3<f64>, end: &Isometry3<f64>) -> bool {
        let beside = |from: &Isometry3<f64>, place: Vector3<f64>| {
            let offset = place - from.translation.vector;
            let axis = from.rotation * Vector3::z();
            let along = offset.dot(&axis);
            (along, (offset - axis * along).norm())
        };
        let (ahead, aside) = beside(end, pose.translation.vector);
        let pivoted = self
            .through
            .is_some_and(|entry| ahead >= -ENTRY && beside(pose, entry.coords).1 <= ENTRY);
        let straight = ahead >= -ON_PATH.0 && aside <= self.aside + SLOPE * ahead;
        (pivoted || straight) && ahead <= self.ahead && tilt_between(pose, end) <= TILT
    }
}

#[derive(Clone, Copy, Debug)]
struct Kept {
    pose: Isometry3<f64>,
    joints: Joints,
    /// Way from the start \[m\].
    way: f64,
    /// Way and turns from the start, a radian as [`LEVER`] \[m\].
    effort: f64,
}

/// Base poses of the insertion so far in World, oldest first.
#[derive(Clone, Debug, Default)]
pub struct BasePath {
    poses: Vec<Kept>,
    /// Where the leg that is driven now began.
    from: Option<Isometry3<f64>>,
}

/// Where a base stands with respect to a path.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Place {
    /// At its start: nothing is left to withdraw.
    AtStart,
    /// On it, or ahead of its recorded end.
    On {
        /// Way left to its start \[m\].
        left: f64,
        /// Part of it that is not recorded, and driven straight \[m\].
        gap: f64,
    },
}

/// A base that stands beside the path.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error(
    "the needle's base stands {:.1} mm and {:.1} deg (tilt) from the nearest place of the recorded \
     path ({:.1} mm and {:.1} deg are allowed), {:.1} mm from its end",
    distance * 1e3, tilt.to_degrees(), ON_PATH.0 * 1e3, ON_PATH.1.to_degrees(), from_end * 1e3
)]
pub struct OffPath {
    /// Distance from the nearest recorded pose \[m\].
    pub distance: f64,
    /// Tilt from it \[rad\].
    pub tilt: f64,
    /// Distance from the recorded end \[m\].
    pub from_end: f64,
}

impl BasePath {
    /// Keeps a pose of the insertion and its joints, unless they are close to the last.
    pub fn note(&mut self, pose: &Isometry3<f64>, joints: &Joints) {
        let (mut way, mut effort) = (0.0, 0.0);
        if let Some(last) = self.poses.last() {
            let (distance, turn) = last.apart(pose, joints);
            if distance < SPACING && turn < TURN {
                return;
            }
            way = last.way + distance;
            effort = last.effort + distance + LEVER * turn;
        }
        self.poses.push(Kept {
            pose: *pose,
            joints: *joints,
            way,
            effort,
        });
    }

    /// Whether nothing was recorded.
    pub const fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }

    /// Where the base began.
    pub fn start(&self) -> Option<&Isometry3<f64>> {
        self.poses.first().map(|kept| &kept.pose)
    }

    /// Finds the base at `pose`, the arm at `joints`, on the path and forgets what lies beyond it. A base beyond the
    /// recorded end within `lead`, as a log that breaks off leaves it, counts as on it.
    ///
    /// # Errors
    /// It stands beside the path, or there is none.
    pub fn rejoin(
        &mut self,
        pose: &Isometry3<f64>,
        joints: &Joints,
        lead: Lead,
    ) -> Result<Place, OffPath> {
        self.from = Some(*pose);
        let (mut nearest, mut least) = (0, f64::INFINITY);
        for (k, kept) in self.poses.iter().enumerate() {
            let (distance, turn) = kept.apart(pose, joints);
            let weighed = distance + NEAR_LEVER * turn;
            // Of places passed twice, the later one.
            if weighed <= least {
                (nearest, least) = (k, weighed);
            }
        }
        let (Some(found), Some(end)) = (self.poses.get(nearest), self.poses.last()) else {
            let unknown = f64::NAN;
            return Err(OffPath {
                distance: unknown,
                tilt: unknown,
                from_end: unknown,
            });
        };
        let (distance, turn) = found.apart(pose, joints);
        let tilt = tilt_between(pose, &found.pose);
        if distance <= ON_PATH.0 && tilt <= ON_PATH.1 {
            let left = found.way + distance;
            self.poses.truncate(nearest + 1);
            let is_start = nearest == 0 && distance < REACHED.0 && turn < REACHED.1;
            return Ok(if is_start {
                Place::AtStart
            } else {
                Place::On { left, gap: 0.0 }
            });
        }
        let offset = pose.translation.vector - end.pose.translation.vector;
        if lead.holds(pose, &end.pose) {
            return Ok(Place::On {
                left: end.way + offset.norm(),
                gap: offset.norm(),
            });
        }
        Err(OffPath {
            distance,
            tilt,
            from_end: offset.norm(),
        })
    }

    /// Way and effort left from here: way \[m\], and the same with a radian as 10 mm.
    pub fn left(&self, pose: &Isometry3<f64>, joints: &Joints) -> (f64, f64) {
        self.poses.last().map_or((0.0, 0.0), |last| {
            let (distance, turn) = last.apart(pose, joints);
            (last.way + distance, last.effort + distance + LEVER * turn)
        })
    }

    /// Effort for each second at these speeds, the slower of both \[m/s\].
    pub const fn pace(speed: f64, spin: f64) -> f64 {
        speed.min(LEVER * spin)
    }

    /// How far a base at `pose` is beside the leg that it drives: distance \[m\], tilt \[rad\].
    pub fn beside(&self, pose: &Isometry3<f64>) -> (f64, f64) {
        let (Some(from), Some(to)) = (&self.from, self.poses.last()) else {
            return (0.0, 0.0);
        };
        let place = |pose: &Isometry3<f64>| pose.translation.vector;
        let (leg, offset) = (place(&to.pose) - place(from), place(pose) - place(from));
        let share = if leg.norm() > 0.0 {
            (offset.dot(&leg) / leg.norm_squared()).clamp(0.0, 1.0)
        } else {
            0.0
        };
        let tilt = tilt_between(pose, &to.pose) - tilt_between(from, &to.pose);
        ((offset - leg * share).norm(), tilt.max(0.0))
    }

    /// Joint rates from here towards the newest pose left, and the twist of the base, at most at
    /// `speed` \[m/s\] and at `spin` \[rad/s\] for every joint; poses reached are dropped, but for
    /// the start. Nothing when that is reached.
    pub fn rates(
        &mut self,
        pose: &Isometry3<f64>,
        joints: &Joints,
        speed: f64,
        spin: f64,
    ) -> Option<(Joints, Twist)> {
        loop {
            let last = self.poses.last()?;
            let (distance, turn) = last.apart(pose, joints);
            let near = if self.poses.len() == 1 {
                REACHED
            } else {
                PASSED
            };
            if distance < near.0 && turn < near.1 {
                if self.poses.len() == 1 {
                    return None;
                }
                self.poses.pop();
                self.from = Some(*pose);
                continue;
            }
            // All arrive together; the slowest sets the time.
            let time = (distance / speed).max(turn / spin).max(HORIZON);
            let rates = last.joints.zip(joints, |to, from| (to - from) / time);
            let rotation = last.pose.rotation * pose.rotation.inverse();
            let twist = Twist {
                linear: (last.pose.translation.vector - pose.translation.vector) / time,
                angular: rotation.scaled_axis() / time,
            };
            return Some((rates, twist));
        }
    }
}

impl Kept {
    /// Distance of the base \[m\] and largest turn of a joint \[rad\] from here.
    fn apart(&self, pose: &Isometry3<f64>, joints: &Joints) -> (f64, f64) {
        let distance = pose.translation.vector - self.pose.translation.vector;
        let turn = joints.zip(&self.joints, |a, b| a - b).max_abs();
        (distance.norm(), turn)
    }
}

/// Angle between the needle's axes \[rad\].
fn tilt_between(a: &Isometry3<f64>, b: &Isometry3<f64>) -> f64 {
    (a.rotation * Vector3::z()).angle(&(b.rotation * Vector3::z()))
}

#[cfg(test)]
mod tests {
    use super::*;

    /// An arm whose joints are x and z of the base and its roll.
    fn base(joints: &Joints) -> Isometry3<f64> {
        let roll = Vector3::z() * joints[2];
        Isometry3::new(Vector3::new(joints[0], 0.0, joints[1]), roll)
    }

    /// A curved path of 30 mm on which the needle turns round more than once.
    fn at(k: f64) -> Joints {
        Joints::from_slice(&[1e-5 * k * k, 5e-4 * k, 0.15 * k]).unwrap()
    }

    fn path() -> BasePath {
        let mut path = BasePath::default();
        for k in 0..=240_u32 {
            let joints = at(f64::from(k) * 0.25);
            path.note(&base(&joints), &joints);
        }
        path
    }

    /// Where a base with this pose is on the path, its roll that of `at(k)`.
    fn find(k: f64, aside: Isometry3<f64>, ahead: f64) -> Result<Place, OffPath> {
        let lead = Lead {
            ahead,
            ..Lead::BRAKED
        };
        path().rejoin(&(base(&at(k)) * aside), &at(k), lead)
    }

    #[test]
    fn a_curved_way_is_retraced_to_its_start_with_all_of_its_turns() {
        let mut path = path();
        let (mut joints, dt) = (at(60.0), 0.016);
        let (mut steps, mut farthest) = (0, 0.0_f64);
        path.rejoin(&base(&joints), &joints, Lead::NONE).unwrap();
        while let Some((rates, twist)) = path.rates(&base(&joints), &joints, 2e-3, 1.0) {
            assert!(twist.linear.norm() < 2e-3 + 1e-12 && rates.max_abs() < 1.0 + 1e-12);
            joints = joints.zip(&rates, |q, rate| q + rate * dt);
            let k = joints[1] / 5e-4;
            farthest = farthest.max((joints[0] - 1e-5 * k * k).abs());
            let (aside, tilt) = path.beside(&base(&joints));
            assert!(aside < 1e-5 && tilt < 1e-6, "{aside} m, {tilt} rad");
            steps += 1;
            assert!(steps < 10_000, "never arrives");
        }
        assert!(joints.zip(&at(0.0), |a, b| a - b).max_abs() < REACHED.1);
        assert!((base(&joints).translation.vector).norm() < REACHED.0);
        // Chords of 0.5 mm leave this parabola by less than 1e-5.
        assert!(farthest < 5e-5, "left the way by {farthest} m");
    }

    #[test]
    fn a_base_is_found_on_the_path_ahead_of_it_or_beside_it() {
        let shift = Isometry3::translation;
        let half = find(30.0, shift(0.0, 0.0, 0.0), 0.0).unwrap();
        let Place::On { left, gap } = half else {
            panic!("{half:?}")
        };
        assert!((left - 0.0175).abs() < 1e-3 && gap == 0.0, "{half:?}");
        assert_eq!(find(0.0, shift(0.0, 0.0, 0.0), 0.0), Ok(Place::AtStart));
        let ahead = shift(0.2e-3, 0.0, 4e-3);
        assert!(find(60.0, ahead, 3e-3).is_err());
        let found = find(60.0, ahead, 5e-3).unwrap();
        assert!(matches!(found, Place::On { gap, .. } if (gap - 4e-3).abs() < 1e-4));
        for (k, beside) in [
            (30.0, shift(5e-3, 0.0, 0.0)),
            (30.0, Isometry3::rotation(Vector3::x() * 0.2)),
            (60.0, shift(6e-3, 0.0, 4e-3)),
            (0.0, shift(0.0, 0.0, -4e-3)),
        ] {
            let off = find(k, beside, 10e-3).unwrap_err();
            assert!(off.distance > 1e-3 || off.tilt > 0.1, "{off}");
        }
        let nothing = BasePath::default().rejoin(&base(&at(0.0)), &at(0.0), Lead::WENT_ON);
        assert!(nothing.is_err());
    }

    /// Laws pivot the base about the entry while the needle hardly advances.
    #[test]
    fn a_base_that_pivoted_beyond_a_broken_log_is_found_by_its_entry() {
        let end = base(&at(60.0));
        let entry = end * Point3::new(0.0, 0.0, 0.12);
        let lead = Lead::broken_off(entry);
        let turn = Isometry3::rotation(Vector3::x() * 0.1);
        let about = Isometry3::from(entry.coords) * turn * Isometry3::from(-entry.coords);
        let pivoted = about * end;
        let place = path().rejoin(&pivoted, &at(60.0), lead);
        assert!(
            matches!(place, Ok(Place::On { gap, .. }) if gap > 10e-3),
            "{place:?}"
        );
        assert!(path().rejoin(&pivoted, &at(60.0), Lead::BRAKED).is_err());
        // As far aside, but its needle would not be in that hole.
        for elsewhere in [
            Isometry3::translation(0.0, 15e-3, 0.0) * end,
            Isometry3::translation(0.0, 0.0, -20e-3) * pivoted,
        ] {
            assert!(path().rejoin(&elsewhere, &at(60.0), lead).is_err());
        }
    }

    /// Its last speed was aside.
    #[test]
    fn a_base_that_braked_beside_the_recorded_end_is_found() {
        for aside in [1.4e-3, -2.5e-3] {
            let braked = Isometry3::translation(0.0, aside, -0.1e-3);
            let found = find(60.0, braked, 3e-3);
            assert!(
                matches!(found, Ok(Place::On { gap, .. }) if gap > 1e-3),
                "{found:?}"
            );
        }
    }

    #[test]
    fn a_base_that_leaves_its_leg_is_told_by_how_much() {
        let mut path = path();
        let end = base(&at(60.0));
        path.rejoin(&end, &at(60.0), Lead::NONE).unwrap();
        path.rates(&end, &at(60.0), 1e-3, 1.0).unwrap();
        let off = Isometry3::translation(0.0, 2e-3, 0.0) * end;
        assert!((path.beside(&off).0 - 2e-3).abs() < 1e-5);
        let tilted = end * Isometry3::rotation(Vector3::x() * 0.1);
        assert!((path.beside(&tilted).1 - 0.1).abs() < 2e-2);
        // A spin about the needle is no deviation, at the end of the path too.
        let mut spun = at(60.0);
        spun[2] += 2.0;
        assert!(path.beside(&base(&spun)).1 < 1e-6);
        let place = path.rejoin(&base(&spun), &spun, Lead::NONE);
        assert!(matches!(place, Ok(Place::On { gap: 0.0, .. })), "{place:?}");
        let (way, effort) = path.left(&off, &at(60.0));
        assert!(way > 0.03 && effort > way);
    }
}

//! Has the target been passed? The estimate says when to look, the measurement says so.

use std::collections::VecDeque;

use hal::frame::LeftCamera;
use hal::{Position, SensedTip, Stamp};
use nalgebra::{Matrix3, Vector3};

/// Distance along the axis within which a target counts as passed \[m\].
const WITHIN: f64 = 1e-3;
/// Deviations within which the measured tip has to have reached the target's plane: 99.7 % of them.
const SIGMAS: f64 = 3.0;
/// Distance ahead that no sensor resolves better, with its bias \[m\].
const LEAST: f64 = 0.15e-3;
/// Farthest that the tip may lie from where it is said to be \[m\]: a millimetre, less the bias of a
/// sensor.
const APART: f64 = 0.8e-3;
/// Deviations of noise, and of how the tip wanders about where it is said to be, that are counted.
const COUNTED: f64 = 2.0;
/// Least time over which measurements are compared with what was said \[s\].
const COMPARED: f64 = 0.3;
/// Places said that are kept: a second at 250 Hz.
const KEPT: usize = 256;
/// Time in which the arm comes to rest \[s\]: until then the tip may still leap.
const RESTS: f64 = 0.2;
/// Longest wait for a measurement that agrees with the estimate \[s\]: half a second of latency,
/// and the time in which the estimate follows the measurements.
const PATIENCE: f64 = 3.0;
/// Longest wait for a tip that wanders about where it is said to be \[s\]: a breath.
const BREATH: f64 = 7.0;

/// What a look at the target's plane came to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Answer {
    /// The target is still ahead.
    Ahead,
    /// The estimate has passed it; a measurement has yet to say so. The arm stands still.
    Awaited,
    /// The measured tip has passed it.
    Passed,
    /// The measured tip is beyond it by so much \[m\].
    Beyond(f64),
    /// The measurements do not agree: the target is still so far ahead \[m\].
    Disagree(f64),
    /// The tip is measured so far from where it is said to be \[m\].
    Apart(f64),
    /// The tip wanders so far about where it is said to be that its place now is not known \[m\].
    Carried(f64),
}

/// Waits for the measurement that confirms what the estimate says.
#[derive(Clone, Debug, Default)]
pub struct Passing {
    since: Option<Stamp>,
    /// Where the tip was said to be, and when.
    said: VecDeque<(Stamp, Vector3<f64>)>,
    /// How measurements differ from that since the arm stands.
    differences: Differences,
}

impl Passing {
    /// Takes in where the tip is said to be at `stamp`.
    pub fn say(&mut self, stamp: Stamp, tip: &Position<LeftCamera>) {
        keep(&mut self.said, KEPT, stamp, tip);
    }

    /// The target as it is now; `estimated`: its distance ahead of the estimated tip \[m\];
    /// `measured`: the newest measured tip with its exposure, in the frame of `target`.
    pub fn look(
        &mut self,
        now: Stamp,
        estimated: f64,
        target: &Position<LeftCamera>,
        measured: Option<&(Stamp, SensedTip)>,
    ) -> Answer {
        if estimated > 0.0 {
            self.since = None;
            self.differences = Differences::default();
            return Answer::Ahead;
        }
        let since = *self.since.get_or_insert(now);
        let waited = now.secs_since(since);
        let rested = |(exposed, _): &&(Stamp, SensedTip)| exposed.secs_since(since) >= RESTS;
        let Some((exposed, tip)) = measured.filter(rested) else {
            return Answer::Awaited;
        };
        let said = self.said.iter().rev().find(|(at, _)| at <= exposed);
        if let Some((_, said)) = said {
            self.differences.add(*exposed, tip.position.coords() - said);
        }
        let (ahead, sigma) = ahead(target, tip);
        if ahead < -WITHIN - SIGMAS * sigma {
            Answer::Beyond(-ahead)
        } else if ahead <= (SIGMAS * sigma).clamp(LEAST, WITHIN) {
            match self.differences.judge(&tip.covariance) {
                Known::There => Answer::Passed,
                Known::Apart(by) if waited > PATIENCE => Answer::Apart(by),
                Known::Wanders(by) if waited > BREATH => Answer::Carried(by),
                _ => Answer::Awaited,
            }
        } else if waited > PATIENCE {
            Answer::Disagree(ahead)
        } else {
            Answer::Awaited
        }
    }

    /// Whether the arm stands still until a measurement came.
    pub const fn is_waiting(&self) -> bool {
        self.since.is_some()
    }
}

/// What is known of where the tip is now.
enum Known {
    /// It is where it is said to be.
    There,
    /// It is so far from there \[m\].
    Apart(f64),
    /// It wanders by so much about there \[m\].
    Wanders(f64),
    /// There is too little to compare.
    Nothing,
}

/// Measured places less those that were said for the same instants. What is said now is said in the
/// same way, from measurements as old, so it is wrong by as much.
#[derive(Clone, Debug, Default)]
struct Differences {
    sum: Vector3<f64>,
    squares: Matrix3<f64>,
    count: u32,
    /// First and newest exposure.
    between: Option<(Stamp, Stamp)>,
}

impl Differences {
    fn add(&mut self, exposed: Stamp, difference: Vector3<f64>) {
        let (first, newest) = self.between.unwrap_or((exposed, exposed));
        if self.count > 0 && exposed <= newest {
            return;
        }
        self.between = Some((first, exposed));
        self.sum += difference;
        self.squares += difference * difference.transpose();
        self.count += 1;
    }

    /// `noise`: covariance of a measured place.
    fn judge(&self, noise: &Matrix3<f64>) -> Known {
        let (Some((first, newest)), 3..) = (self.between, self.count) else {
            return Known::Nothing;
        };
        if newest.secs_since(first) < COMPARED {
            return Known::Nothing;
        }
        let count = f64::from(self.count);
        let mean = self.sum / count;
        let spread = (self.squares - mean * self.sum.transpose()) / (count - 1.0);
        let wanders = (spread - noise).symmetric_eigenvalues().max().max(0.0);
        let wanders = COUNTED * wanders.sqrt();
        let apart = mean.norm() + COUNTED * (noise.trace() / 3.0 / count).sqrt();
        if apart + wanders <= APART {
            Known::There
        } else if apart > APART {
            Known::Apart(mean.norm())
        } else {
            Known::Wanders(wanders)
        }
    }
}

/// Adds a place that is newer than those before; the oldest of more than `most` goes.
fn keep(
    places: &mut VecDeque<(Stamp, Vector3<f64>)>,
    most: usize,
    stamp: Stamp,
    place: &Position<LeftCamera>,
) {
    if places.back().is_some_and(|(last, _)| *last >= stamp) {
        return;
    }
    if places.len() == most {
        places.pop_front();
    }
    places.push_back((stamp, place.coords()));
}

/// Distance of `target` ahead of a measured tip along its axis, and its standard deviation \[m\].
fn ahead(target: &Position<LeftCamera>, tip: &SensedTip) -> (f64, f64) {
    let axis: Vector3<f64> = tip.direction.into_inner();
    let offset = target.point() - tip.position.point();
    let ahead = axis.dot(&offset);
    let aside = (offset - axis * ahead).norm();
    let by_position = axis.dot(&(tip.covariance * axis)).max(0.0);
    (ahead, by_position.sqrt().hypot(aside * tip.direction_sigma))
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::{Matrix3, Point3};

    fn tip(z: f64) -> SensedTip {
        SensedTip {
            position: Position::new(Point3::new(0.0, 0.0, z)),
            covariance: Matrix3::identity() * 0.05e-3_f64.powi(2),
            direction: Vector3::z_axis(),
            direction_sigma: 2e-3,
        }
    }

    #[test]
    fn an_estimate_alone_passes_nothing() {
        let target = Position::new(Point3::new(1e-3, 0.0, 0.1));
        let at = Stamp::from_secs;
        let look = |passing: &mut Passing, now, estimated, seen: Option<(f64, f64)>| {
            let seen = seen.map(|(exposed, z)| (at(exposed), tip(z)));
            passing.say(at(now), &Position::new(Point3::new(0.0, 0.0, 0.1)));
            passing.look(at(now), estimated, &target, seen.as_ref())
        };
        let mut passing = Passing::default();
        assert_eq!(
            look(&mut passing, 1.0, 1e-4, Some((1.0, 0.2))),
            Answer::Ahead
        );
        assert_eq!(
            look(&mut passing, 2.0, -1e-4, Some((1.9, 0.1))),
            Answer::Awaited
        );
        assert_eq!(look(&mut passing, 2.1, -1e-4, None), Answer::Awaited);
        assert_eq!(
            look(&mut passing, 2.1, -1e-4, Some((2.05, 0.0999))),
            Answer::Awaited
        );
        for (now, seen) in [(2.3, 2.25), (2.4, 2.35), (2.5, 2.45)] {
            let seen = Some((seen, 0.0999));
            assert_eq!(look(&mut passing, now, -1e-4, seen), Answer::Awaited);
        }
        assert_eq!(
            look(&mut passing, 2.6, -1e-4, Some((2.55, 0.0999))),
            Answer::Passed
        );
        // Thirty millimetres short: no verdict but a disagreement, in the end.
        let short = Some((2.65, 0.07));
        assert_eq!(look(&mut passing, 2.7, -1e-4, short), Answer::Awaited);
        assert!(matches!(
            look(&mut passing, 6.0, -1e-4, short),
            Answer::Disagree(by) if (by - 0.03).abs() < 1e-9
        ));
        assert!(matches!(
            look(&mut passing, 6.0, -1e-4, Some((6.0, 0.102))),
            Answer::Beyond(by) if (by - 2e-3).abs() < 1e-9
        ));
        // An estimate that learns from the measurement goes on.
        assert_eq!(look(&mut passing, 6.1, 0.03, short), Answer::Ahead);
        assert!(!passing.is_waiting());
    }

    #[test]
    fn a_tip_elsewhere_than_was_said_passes_nothing() {
        let target = Position::new(Point3::new(1e-3, 0.0, 0.1));
        let answer = |aside: f64| {
            let mut passing = Passing::default();
            let said = Position::new(Point3::new(aside, 0.0, 0.1));
            let mut last = Answer::Ahead;
            for k in 0..=120_u32 {
                let now = Stamp::from_secs(1.0 + f64::from(k) / 30.0);
                passing.say(now, &said);
                last = passing.look(now, -1e-5, &target, Some(&(now, tip(0.1))));
                if last == Answer::Passed {
                    break;
                }
            }
            last
        };
        assert_eq!(answer(0.5e-3), Answer::Passed);
        assert!(matches!(answer(1.2e-3), Answer::Apart(by) if (by - 1.2e-3).abs() < 1e-9));
    }

    /// What 10 s of looks at a tip that breathes aside by `breath` \[m\] come to, and after how long
    /// \[s\]; measured 0.4 s late, and said as it was measured last.
    fn breathing(breath: f64) -> Option<(f64, Answer)> {
        const LATE: i32 = 12;
        let target = Position::new(Point3::new(0.0, 0.0, 0.1));
        let mut passing = Passing::default();
        let at = |k: i32| 5.0 + f64::from(k) / 30.0;
        let place = |k: i32| {
            let aside = breath * (core::f64::consts::TAU * 0.2 * at(k)).sin();
            Position::new(Point3::new(aside, 0.0, 0.1))
        };
        (0..=300).find_map(|k| {
            let now = Stamp::from_secs(at(k));
            passing.say(now, &place(k - LATE));
            let mut seen = tip(0.1);
            seen.position = place(k - LATE);
            let exposed = Stamp::from_secs(at(k - LATE));
            let answer = passing.look(now, -1e-5, &target, Some(&(exposed, seen)));
            (answer != Answer::Awaited).then_some((at(k) - at(0), answer))
        })
    }

    #[test]
    fn a_tip_that_wanders_little_has_passed() {
        let (after, answer) = breathing(0.5e-3).unwrap();
        assert_eq!(answer, Answer::Passed);
        assert!(after < 2.0, "{after}");
    }

    /// Tissue that breathes carries the tip on from where a late measurement saw it: by 2 mm at most,
    /// and where it is now is not known.
    #[test]
    fn a_tip_that_its_tissue_carries_about_is_not_known_to_have_passed() {
        let (after, answer) = breathing(4e-3).unwrap();
        assert!(
            matches!(answer, Answer::Carried(by) if by > 1e-3)
                || matches!(answer, Answer::Apart(_)),
            "{answer:?}"
        );
        assert!(after > PATIENCE, "{after}");
    }
}

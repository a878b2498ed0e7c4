//! From one direction of motion to another without a third.
//!
//! What the arm does now (rates and accelerations) and what is wanted span a plane in the space
//! of joint accelerations. Of the accelerations in it that all joints admit, the one closest to
//! the ideal is taken. Rates then stay linear combinations of motion and command: what neither of
//! them does, such as a motion of the tool across the needle, the arm does not do on the way.

use super::axis::Admissible;
use crate::Joints;

/// Rounding allowed for the corners of what is admissible, relative to its size.
const CORNER: f64 = 1e-12;
/// Share of an acceleration across the change of rates below which it counts as rounding.
const ASIDE: f64 = 1e-12;
/// Ratio of squared distances beyond all rounding.
const FARTHER: f64 = 1.0 + 1e-9;

/// A side of a joint's admissible range: joint, and whether the upper one.
pub(super) type Side = (usize, bool);

/// The plane of accelerations spanned by a change of rates and by the acceleration of the motion.
#[derive(Debug)]
pub(super) struct Plane {
    /// Unit vector along the change, and one across it (zero if the motion accelerates along it).
    along: Joints,
    across: Joints,
    /// Coordinates across and along the change of the acceleration that the motion has. What is
    /// chosen lies between it and the ideal: more of either would make a direction of what may
    /// be rounding.
    now: (f64, f64),
    /// Coordinate along the change of the acceleration that is wanted.
    ideal: f64,
}

/// A half-plane of the admissible accelerations: `a u + b t <= c`.
struct Half {
    a: f64,
    b: f64,
    c: f64,
    side: Option<Side>,
}

/// An admissible acceleration, and the sides of the joints' ranges that hold it back.
pub(super) struct Chosen {
    pub(super) accelerations: Joints,
    pub(super) held: Vec<Side>,
}

fn dot(x: &Joints, y: &Joints) -> f64 {
    x.iter().zip(y.iter()).map(|(x, y)| x * y).sum()
}

impl Plane {
    /// The plane of `change` and `acceleration`, with the wanted acceleration `ideal` times
    /// `change`; only the line of `acceleration` without a change.
    pub(super) fn new(change: &Joints, acceleration: &Joints, ideal: f64) -> Self {
        let size = dot(change, change).sqrt();
        let is_change = size > f64::MIN_POSITIVE.sqrt();
        let along = change.map(|x| if is_change { x / size } else { 0.0 });
        let share = dot(acceleration, &along);
        let aside = acceleration.zip(&along, |a, l| a - share * l);
        let rest = dot(&aside, &aside).sqrt();
        let is_aside = rest > ASIDE * (share.abs() + rest);
        let across = aside.map(|x| if is_aside { x / rest } else { 0.0 });
        Self {
            along,
            across,
            now: (if is_aside { rest } else { 0.0 }, share),
            ideal: if is_change { ideal * size } else { 0.0 },
        }
    }

    /// The admissible acceleration closest to the ideal one; `None` if the plane has none.
    pub(super) fn closest<'a>(
        &self,
        ranges: impl Iterator<Item = &'a Admissible>,
    ) -> Option<Chosen> {
        let mut halves = Vec::with_capacity(2 * crate::MAX_JOINTS + 4);
        let (across, along) = self.now;
        for (a, b, c) in [
            (1.0, 0.0, across),
            (-1.0, 0.0, 0.0),
            (0.0, 1.0, along.max(self.ideal)),
            (0.0, -1.0, -along.min(self.ideal)),
        ] {
            let side = None;
            halves.push(Half { a, b, c, side });
        }
        for (i, range) in ranges.enumerate() {
            let (a, b) = (self.across[i], self.along[i]);
            for (sign, c, upper) in [(1.0, range.high, true), (-1.0, -range.low, false)] {
                halves.push(Half {
                    a: sign * a,
                    b: sign * b,
                    c,
                    side: Some((i, upper)),
                });
            }
        }
        let mut best: Option<(f64, f64, f64)> = None;
        let mut propose = |u: f64, t: f64| {
            // Most points are farther by much, which takes no root to see.
            let aside = t - self.ideal;
            if best.is_some_and(|(least, ..)| u * u + aside * aside > FARTHER * least * least) {
                return;
            }
            let distance = u.hypot(aside);
            let closer = best.is_none_or(|(least, ..)| distance < least);
            if closer && halves.iter().all(|half| half.excess(u, t) <= half.slack()) {
                best = Some((distance, u, t));
            }
        };
        propose(0.0, self.ideal);
        for (i, half) in halves.iter().enumerate() {
            let squared = half.a * half.a + half.b * half.b;
            if squared == 0.0 {
                continue;
            }
            let beyond = half.excess(0.0, self.ideal) / squared;
            propose(-half.a * beyond, self.ideal - half.b * beyond);
            for other in &halves[..i] {
                let det = half.a * other.b - half.b * other.a;
                if det.abs() > CORNER * squared {
                    propose(
                        (half.c * other.b - half.b * other.c) / det,
                        (half.a * other.c - half.c * other.a) / det,
                    );
                }
            }
        }
        let (distance, u, t) = best?;
        let held = if distance == 0.0 {
            Vec::new()
        } else {
            let holding = |half: &&Half| half.excess(u, t) >= -half.slack();
            halves
                .iter()
                .filter(holding)
                .filter_map(|half| half.side)
                .collect()
        };
        Some(Chosen {
            accelerations: self.across.zip(&self.along, |a, b| u * a + t * b),
            held,
        })
    }
}

impl Half {
    fn excess(&self, u: f64, t: f64) -> f64 {
        self.a * u + self.b * t - self.c
    }

    fn slack(&self) -> f64 {
        CORNER * (1.0 + self.c.abs())
    }
}

//! The needle as a beam on an elastic bed, held by a support before the tissue.
//!
//! Small deflections across the insertion, both directions alike: EI u'''' = -K (u - r), where r is
//! the path that the tip has cut (springs are born at the tip, as in the paper's model). The support
//! holds position and direction, the tip is free. Only the wave length (4 EI / K)^(1/4) counts.

use nalgebra::Vector2;

/// Spacing of the springs \[m\], as the paper has it.
const PITCH: f64 = 2.5e-3;
/// Stiffness of the surface, as a length of tissue that it adds \[m\]: the first millimetres hold
/// the needle better than the bed says, in gels with and without a skin (docs/REAL_NEEDLES.md).
const SURFACE: f64 = 6e-3;
/// Least depth of the tip, and least distance of the tip from the last spring \[m\].
const LEAST: f64 = 0.05e-3;
/// Least distance of the support from the surface \[m\].
const LEAST_GAP: f64 = 1e-3;

/// What the answer to a motion depends on.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Bed {
    /// Wave length (4 EI / K)^(1/4) \[m\].
    pub(super) wave_length: f64,
    /// How much farther from the surface the support is than its pose says \[m\].
    pub(super) farther: f64,
    /// How far the sensor sits behind the tip \[m\].
    pub(super) setback: f64,
}

/// Support and sensor at one row, relative to the straight needle of the first row.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Place {
    /// Depth of the sensor under the surface \[m\].
    pub(super) depth: f64,
    /// Distance of the support before the surface \[m\].
    pub(super) gap: f64,
    /// Position \[m\] and slope of the support across the insertion.
    pub(super) support: Vector2<f64>,
    pub(super) tilt: Vector2<f64>,
}

/// The needle at the sensor.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(super) struct Answer {
    /// Position across the insertion \[m\].
    pub(super) position: Vector2<f64>,
    /// Slope against the insertion.
    pub(super) slope: Vector2<f64>,
    /// Change by the support's motion alone, before the needle advances.
    pub(super) moved_position: Vector2<f64>,
    pub(super) moved_slope: Vector2<f64>,
}

impl Bed {
    /// The needle at every place of an insertion: at each the support moves first, then the needle
    /// advances.
    pub(super) fn follow(&self, places: &[Place]) -> Vec<Answer> {
        let mut springs = Springs {
            bed: *self,
            rest: Vec::new(),
            beam: Beam::default(),
        };
        let mut answers: Vec<Answer> = Vec::with_capacity(places.len());
        let mut before: Option<&Place> = None;
        for place in places {
            let mut answer = Answer::default();
            if let (Some(before), Some(last)) = (before, answers.last()) {
                let (position, slope) = springs.sensor(place, before.depth);
                answer.moved_position = position - last.position;
                answer.moved_slope = slope - last.slope;
            }
            springs.advance(place);
            (answer.position, answer.slope) = springs.sensor(place, place.depth);
            answers.push(answer);
            before = Some(place);
        }
        answers
    }
}

struct Springs {
    bed: Bed,
    /// Rest positions, at depths of half a pitch, one and a half, ...
    rest: Vec<Vector2<f64>>,
    beam: Beam,
}

fn spring_depth(k: usize) -> f64 {
    PITCH * (k as f64 + 0.5)
}

impl Springs {
    /// Bears the springs between the last one and the tip.
    fn advance(&mut self, place: &Place) {
        let tip = (place.depth + self.bed.setback).max(LEAST);
        while spring_depth(self.rest.len()) < tip {
            let depth = spring_depth(self.rest.len());
            self.solve(place, depth);
            self.rest.push(self.beam.tip());
        }
    }

    /// Position and slope at the sensor, the sensor at `depth`.
    fn sensor(&mut self, place: &Place, depth: f64) -> (Vector2<f64>, Vector2<f64>) {
        let tip = (depth + self.bed.setback).max(LEAST);
        self.solve(place, tip);
        self.beam.at(tip - self.bed.setback, place)
    }

    fn solve(&mut self, place: &Place, tip: f64) {
        let stiffness = 4.0 / self.bed.wave_length.powi(4);
        let beam = &mut self.beam;
        beam.start(-(place.gap + self.bed.farther).max(LEAST_GAP));
        let inside = self.rest.iter().enumerate();
        for (k, rest) in inside.take_while(|(k, _)| spring_depth(*k) < tip - LEAST) {
            let length = if k == 0 { PITCH + SURFACE } else { PITCH };
            beam.node(spring_depth(k), stiffness * length, *rest);
        }
        beam.node(tip, 0.0, Vector2::zeros());
        beam.solve(place.support, place.tilt);
    }
}

/// Hermite beam elements between nodes, clamped at the first; bending stiffness 1.
#[derive(Debug, Default)]
struct Beam {
    depths: Vec<f64>,
    /// Lower band of the stiffness of all nodes but the first: diagonal first.
    band: Vec<[f64; 4]>,
    /// Load, then deflection and slope.
    state: Vec<Vector2<f64>>,
    /// Coupling of the first free node to the clamped one.
    coupling: [[f64; 2]; 2],
}

impl Beam {
    fn start(&mut self, depth: f64) {
        self.depths.clear();
        self.band.clear();
        self.state.clear();
        self.depths.push(depth);
    }

    fn node(&mut self, depth: f64, spring: f64, rest: Vector2<f64>) {
        let last = self.depths.last().copied().unwrap_or_default();
        let length = depth - last;
        let (l2, l3) = (length * length, length.powi(3));
        let first = self.depths.len() == 1;
        self.depths.push(depth);
        if first {
            // Rows of this node, columns of the clamped one.
            self.coupling = [[-12.0 / l3, -6.0 / l2], [6.0 / l2, 2.0 / length]];
        } else {
            let k = self.band.len() - 2;
            self.band[k][0] += 12.0 / l3;
            self.band[k][1] += 6.0 / l2;
            self.band[k + 1][0] += 4.0 / length;
            self.band[k][2] = -12.0 / l3;
            self.band[k][3] = 6.0 / l2;
            self.band[k + 1][1] = -6.0 / l2;
            self.band[k + 1][2] = 2.0 / length;
        }
        self.band.push([12.0 / l3 + spring, -6.0 / l2, 0.0, 0.0]);
        self.band.push([4.0 / length, 0.0, 0.0, 0.0]);
        self.state.push(rest * spring);
        self.state.push(Vector2::zeros());
    }

    /// Cholesky's factors of a band of width 3, both directions at once.
    fn solve(&mut self, support: Vector2<f64>, tilt: Vector2<f64>) {
        for (load, row) in self.state.iter_mut().zip(&self.coupling) {
            *load -= support * row[0] + tilt * row[1];
        }
        let n = self.band.len();
        for i in 0..n {
            let pivot = self.band[i][0].max(f64::MIN_POSITIVE).sqrt();
            self.band[i][0] = pivot;
            for j in 1..4 {
                self.band[i][j] /= pivot;
            }
            let column = self.band[i];
            for j in 1..4_usize.min(n - i) {
                for k in j..4.min(n - i) {
                    self.band[i + j][k - j] -= column[j] * column[k];
                }
            }
            self.state[i] /= pivot;
            let known = self.state[i];
            for j in 1..4_usize.min(n - i) {
                self.state[i + j] -= known * column[j];
            }
        }
        for i in (0..n).rev() {
            let mut value = self.state[i];
            for j in 1..4_usize.min(n - i) {
                value -= self.state[i + j] * self.band[i][j];
            }
            self.state[i] = value / self.band[i][0];
        }
    }

    fn tip(&self) -> Vector2<f64> {
        self.state.iter().nth_back(1).copied().unwrap_or_default()
    }

    /// Deflection and slope at a depth.
    fn at(&self, depth: f64, place: &Place) -> (Vector2<f64>, Vector2<f64>) {
        let node = |k: usize| match k.checked_sub(1) {
            None => (place.support, place.tilt),
            Some(free) => (self.state[2 * free], self.state[2 * free + 1]),
        };
        if depth <= self.depths[0] {
            return node(0);
        }
        let last = self.depths.len() - 1;
        let k = self.depths[1..last]
            .iter()
            .take_while(|end| **end < depth)
            .count();
        let length = self.depths[k + 1] - self.depths[k];
        let t = ((depth - self.depths[k]) / length).min(1.0);
        let ((u0, s0), (u1, s1)) = (node(k), node(k + 1));
        let (t2, t3) = (t * t, t * t * t);
        let position = u0 * (1.0 - 3.0 * t2 + 2.0 * t3)
            + s0 * (length * (t - 2.0 * t2 + t3))
            + u1 * (3.0 * t2 - 2.0 * t3)
            + s1 * (length * (t3 - t2));
        let slope = (u1 - u0) * (6.0 * (t - t2) / length)
            + s0 * (1.0 - 4.0 * t + 3.0 * t2)
            + s1 * (3.0 * t2 - 2.0 * t);
        (position, slope)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn places(depth: f64, steps: u32, moved: f64) -> Vec<Place> {
        let mut places: Vec<Place> = (0..=steps)
            .map(|k| Place {
                depth: depth * f64::from(k) / f64::from(steps),
                gap: 25e-3,
                ..Place::default()
            })
            .collect();
        let last = places[places.len() - 1];
        places.push(Place {
            support: Vector2::new(moved, 0.0),
            ..last
        });
        places
    }

    const BED: Bed = Bed {
        wave_length: 25e-3,
        farther: 0.0,
        setback: 0.0,
    };

    #[test]
    fn a_support_that_does_not_move_leaves_the_needle_straight() {
        for answer in BED.follow(&places(80e-3, 16, 0.0)) {
            assert!(answer.position.norm() < 1e-15 && answer.slope.norm() < 1e-15);
        }
    }

    #[test]
    fn without_tissue_the_needle_moves_with_its_support() {
        let soft = Bed {
            wave_length: 10.0,
            ..BED
        };
        let answers = soft.follow(&places(60e-3, 12, 1e-3));
        let last = answers.last().unwrap();
        assert!((last.position - Vector2::new(1e-3, 0.0)).norm() < 1e-6);
        assert!((last.moved_position - last.position).norm() < 1e-12);
    }

    /// Hetenyi: far from the surface a bent beam swings about the bed with period 2 pi lambda and
    /// fades by exp(-pi) in half of it.
    #[test]
    fn a_push_fades_with_the_wave_length() {
        let deep = |depth: f64| {
            let answers = BED.follow(&places(depth, 80, 1e-3));
            answers.last().unwrap().slope.x
        };
        let (near, far) = (deep(30e-3), deep(140e-3));
        assert!(near < -1e-3, "the tip turns against the push: {near}");
        assert!(far.abs() < 0.02 * near.abs(), "{far} against {near}");
    }

    #[test]
    fn finer_steps_do_not_change_the_answer() {
        let slope = |steps| {
            BED.follow(&places(42e-3, steps, 2e-3))
                .last()
                .map(|a| a.slope.x)
                .unwrap()
        };
        assert!((slope(6) / slope(60) - 1.0).abs() < 1e-9);
    }
}

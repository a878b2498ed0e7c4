//! The needle as a curve: points, tangents and samples at true arc length from the base.

use nalgebra::Vector3;

use crate::equilibrium::Equilibrium;
use crate::segment::Segment;

impl Equilibrium {
    /// Segment that holds the arc length `s` from the base, and the coordinate along it.
    pub(crate) fn locate(&self, s: f64) -> (usize, f64) {
        let n = self.springs.len();
        let mut start = 0.0;
        for i in 0..n {
            let l = self.nodes[i + 1].l;
            if s <= start + l {
                return (i, arc_coordinate(&self.segment(i), s - start, l));
            }
            start += l;
        }
        (n, arc_coordinate(&self.segment(n), s - start, self.tip.arc))
    }

    /// Point of the needle at the arc length `s` \[m\] from the base, held to the needle's ends.
    pub fn point(&self, s: f64) -> Vector3<f64> {
        let (i, l) = self.locate(s);
        self.segment(i).position(l)
    }

    /// Unit tangent at the arc length `s` \[m\] from the base, held to the needle's ends.
    pub fn tangent_at(&self, s: f64) -> Vector3<f64> {
        let (i, l) = self.locate(s);
        self.segment(i).derivative(l).normalize()
    }

    /// Points (s, position) every `spacing` \[m\] from the base, and the tip.
    pub fn samples(&self, spacing: f64) -> Vec<(f64, Vector3<f64>)> {
        let length = self.needle.length();
        let mut samples = Vec::new();
        if spacing > 0.0 {
            // A sample within a nanometre of the tip is the tip; a million are enough.
            let last = ((length - 1e-9) / spacing).floor().min(1e6);
            let mut i = 0.0;
            while i <= last {
                samples.push((i * spacing, self.point(i * spacing)));
                i += 1.0;
            }
        }
        samples.push((length, self.tip_position()));
        samples
    }
}

/// Coordinate on `segment` at the arc length `s` from its start, of `arc` in all.
fn arc_coordinate(segment: &Segment, s: f64, arc: f64) -> f64 {
    if !(s > 0.0 && arc > 0.0) {
        return 0.0;
    }
    if s >= arc {
        return segment.length;
    }
    let mut l = segment.length * s / arc;
    for _ in 0..20 {
        let step = (s - segment.arc_length(l)) / segment.derivative(l).norm();
        l += step;
        if step.abs() < 1e-14 {
            break;
        }
    }
    l.clamp(0.0, segment.length.max(0.0))
}

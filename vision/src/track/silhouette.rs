//! The tip's silhouette: how the needle's width falls off along its axis.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "coordinates of pixels, checked against the image"
)]

/// Entries of a table.
const ENTRIES: usize = 96;
/// Nodes of the blur's quadrature, in standard deviations, and their weights.
const BLUR: [(f64, f64); 5] = [
    (-2.0, 0.066_807),
    (-1.0, 0.241_730),
    (0.0, 0.382_925),
    (1.0, 0.241_730),
    (2.0, 0.066_807),
];

/// A tip as a camera sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TipView {
    /// Length of the bevel along the axis in the image \[px\]; 0 for a flat tip.
    pub bevel_px: f64,
    /// Sine of the angle by which the bevel's direction is out of the line of sight: 1 when the
    /// bevel is seen from its side, 0 when its face looks into the camera or away from it.
    pub side: f64,
}

impl TipView {
    /// Width of the silhouette relative to the shaft's, `u` ahead of O \[px\].
    ///
    /// A plane cuts the cylinder: at `u` the part of the section's disc remains that lies below
    /// the chord at height `c` (in radii); its extent across the line of sight is the width.
    pub(super) fn width(&self, u: f64) -> f64 {
        if u <= 0.0 {
            return 1.0;
        }
        if u >= self.bevel_px {
            return 0.0;
        }
        let c = 1.0 - 2.0 * u / self.bevel_px;
        let along = (1.0 - self.side * self.side).max(0.0).sqrt();
        let chord = along * (1.0 - c * c).sqrt();
        let upper = if self.side <= c {
            1.0
        } else {
            chord + self.side * c
        };
        let lower = if -self.side <= c {
            1.0
        } else {
            chord - self.side * c
        };
        0.5 * (upper + lower)
    }
}

/// Blurred width over the distance ahead of O, tabulated.
#[derive(Clone, Debug)]
pub(super) struct Falloff {
    start: f64,
    step: f64,
    values: [f64; ENTRIES],
}

impl Falloff {
    /// The silhouette of `view` in images blurred by `blur` \[px\].
    pub(super) fn new(view: &TipView, blur: f64) -> Self {
        let margin = 3.0 * blur + 1.0;
        let step = (view.bevel_px + 2.0 * margin) / (ENTRIES - 1) as f64;
        let mut values = [0.0; ENTRIES];
        for (k, value) in values.iter_mut().enumerate() {
            let u = -margin + step * k as f64;
            *value = BLUR
                .iter()
                .map(|(node, weight)| weight * view.width(u + node * blur))
                .sum();
        }
        smooth(&mut values);
        Self {
            start: -margin,
            step,
            values,
        }
    }

    /// Value and slope \[1/px\] at `u` ahead of O.
    pub(super) fn at(&self, u: f64) -> (f64, f64) {
        let x = (u - self.start) / self.step;
        if x < 0.0 {
            return (1.0, 0.0);
        }
        let k = x as usize;
        let (Some(a), Some(b)) = (self.values.get(k), self.values.get(k + 1)) else {
            return (0.0, 0.0);
        };
        (a + (b - a) * (x - k as f64), (b - a) / self.step)
    }
}

/// Rounds the corners that the quadrature leaves.
fn smooth(values: &mut [f64; ENTRIES]) {
    let raw = *values;
    for k in 1..ENTRIES - 1 {
        if let (Some(value), Some(part)) = (values.get_mut(k), raw.get(k - 1..=k + 1)) {
            *value = 0.25 * part[0] + 0.5 * part[1] + 0.25 * part[2];
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seen_from_the_side_the_bevel_is_a_ramp() {
        let view = TipView {
            bevel_px: 10.0,
            side: 1.0,
        };
        for u in [0.5, 2.5, 7.0, 9.9] {
            assert!((view.width(u) - (1.0 - u / 10.0)).abs() < 1e-12);
        }
        assert!(view.width(-1.0) == 1.0 && view.width(10.1) == 0.0);
    }

    #[test]
    fn the_silhouette_is_that_of_a_sampled_cut_cylinder() {
        for side in [0.0, 0.3, 0.7, 0.95] {
            let view = TipView {
                bevel_px: 8.0,
                side,
            };
            let across = (1.0 - side * side).sqrt();
            for u in [0.4, 2.0, 3.9, 4.1, 6.5, 7.8] {
                let cut = 1.0 - 2.0 * u / 8.0;
                let (mut low, mut high) = (f64::MAX, f64::MIN);
                for i in 0..=2000 {
                    let y = -1.0 + f64::from(i) * 1e-3;
                    if y > cut {
                        break;
                    }
                    let x = (1.0 - y * y).max(0.0).sqrt();
                    for x in [-x, x] {
                        let e = across * x + side * y;
                        (low, high) = (low.min(e), high.max(e));
                    }
                }
                // The disc is sampled at a thousandth of its radius; rims are steep there.
                assert!(
                    (view.width(u) - 0.5 * (high - low)).abs() < 3e-3,
                    "{side} {u}"
                );
            }
        }
    }
}

//! The tip's silhouette: how the needle's width falls off along its axis.
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "coordinates of pixels, checked against the image"
)]

/// Entries of a table.
const ENTRIES: usize = 96;
/// Most entries on one side of the blur's kernel.
const KERNEL: usize = 48;

/// A tip as a camera sees it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TipView {
    /// Length of the bevel along the axis in the image \[px\]; 0 for a flat tip.
    pub bevel_px: f64,
    /// Sine of the angle by which the bevel's direction is out of the line of sight: 1 when the
    /// bevel is seen from its side, 0 when its face looks into the camera or away from it.
    pub side: f64,
    /// How far the rim of a flat end stands before its centre, where the axis is not square to
    /// the line of sight \[px\].
    pub rim_px: f64,
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
        if self.bevel_px < 1.0 {
            let x = u / self.rim_px.max(1e-6);
            return (1.0 - x * x).max(0.0).sqrt();
        }
        if u >= self.bevel_px {
            return 0.0;
        }
        let (upper, lower) = self.extents(1.0 - 2.0 * u / self.bevel_px);
        0.5 * (upper + lower)
    }

    /// How far the section reaches to both sides of the axis, away from the bevel's point and
    /// towards it \[radii\], where the face cuts it at the height `c` \[radii\].
    fn extents(&self, c: f64) -> (f64, f64) {
        let along = (1.0 - self.side * self.side).max(0.0).sqrt();
        let chord = along * (1.0 - c * c).max(0.0).sqrt();
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
        (upper, lower)
    }
}

/// Share of the bevel's length, next to O, that is left out of [`leaning`]: there the section is
/// still nearly whole.
pub(super) const WHOLE: f64 = 0.25;

/// First moment of the silhouette's area about the axis, ahead of [`WHOLE`], towards the normal of
/// the curve, relative to the bevel's length and the squared radius. `side` is the bevel's
/// direction along that normal, with its sign; see [`TipView::side`].
pub(super) fn leaning(side: f64) -> f64 {
    const STEPS: usize = 24;
    let view = TipView {
        bevel_px: 1.0,
        side: side.abs().min(1.0),
        rim_px: 0.0,
    };
    let mut sum = 0.0;
    for k in 0..STEPS {
        let share = WHOLE + (1.0 - WHOLE) * (k as f64 + 0.5) / STEPS as f64;
        let (upper, lower) = view.extents(1.0 - 2.0 * share);
        sum += 0.5 * (lower * lower - upper * upper);
    }
    sum * (1.0 - WHOLE) / STEPS as f64 * side.signum()
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
        let step = (view.bevel_px.max(view.rim_px) + 2.0 * margin) / (ENTRIES - 1) as f64;
        let mut sharp = [0.0; ENTRIES];
        for (k, value) in sharp.iter_mut().enumerate() {
            // A step between two entries is shared between them.
            let u = -margin + step * k as f64;
            *value = 0.5 * (view.width(u - 0.25 * step) + view.width(u + 0.25 * step));
        }
        let values = blurred(&sharp, blur / step);
        Self {
            start: -margin,
            step,
            values,
        }
    }

    /// Where ahead of O it falls \[px\]: it is 1 before, 0 afterwards.
    pub(super) fn span(&self) -> [f64; 2] {
        [self.start, self.start + (ENTRIES - 1) as f64 * self.step]
    }

    /// Value and slope \[1/px\] at `u` ahead of O.
    pub(super) fn at(&self, u: f64) -> (f64, f64) {
        let x = (u - self.start) / self.step;
        if x < 0.0 {
            return (1.0, 0.0);
        }
        let k = x as u32;
        let here = k as usize;
        let (Some(a), Some(b)) = (self.values.get(here), self.values.get(here + 1)) else {
            return (0.0, 0.0);
        };
        (a + (b - a) * (x - f64::from(k)), (b - a) / self.step)
    }
}

/// The table under a Gaussian of `sigma` entries; beyond its ends are shaft and nothing.
fn blurred(sharp: &[f64; ENTRIES], sigma: f64) -> [f64; ENTRIES] {
    let reach = ((3.0 * sigma).ceil() as usize).min(KERNEL);
    let mut kernel = [0.0; KERNEL + 1];
    let mut total = 0.0;
    for (k, weight) in kernel.iter_mut().enumerate().take(reach + 1) {
        *weight = (-0.5 * (k as f64 / sigma).powi(2)).exp();
        total += if k == 0 { *weight } else { 2.0 * *weight };
    }
    let at = |k: usize| match k.checked_sub(reach) {
        None => 1.0,
        Some(k) => sharp.get(k).copied().unwrap_or(0.0),
    };
    let mut padded = [0.0; ENTRIES + 2 * KERNEL];
    for (k, value) in padded.iter_mut().enumerate().take(ENTRIES + 2 * reach) {
        *value = at(k);
    }
    // Tap by tap rather than entry by entry: neighbours are summed at once.
    let mut values = [0.0; ENTRIES];
    for tap in 0..=2 * reach {
        let weight = kernel[tap.abs_diff(reach)] / total;
        for (value, sample) in values.iter_mut().zip(&padded[tap..]) {
            *value += weight * sample;
        }
    }
    values
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn seen_from_the_side_the_bevel_is_a_ramp() {
        let view = TipView {
            bevel_px: 10.0,
            side: 1.0,
            rim_px: 0.0,
        };
        for u in [0.5, 2.5, 7.0, 9.9] {
            assert!((view.width(u) - (1.0 - u / 10.0)).abs() < 1e-12);
        }
        assert!(view.width(-1.0) == 1.0 && view.width(10.1) == 0.0);
    }

    #[test]
    fn a_bevel_leans_towards_its_point() {
        // Seen from the side the section ends at the height c: the integral of (1 - c2) / 4 over
        // c from -1 to 1/2 is 9/32; the sum's steps leave out 1e-3.
        assert!((leaning(1.0) - 9.0 / 32.0).abs() < 1e-3, "{}", leaning(1.0));
        assert!((leaning(-1.0) + leaning(1.0)).abs() < 1e-15);
        assert!(leaning(0.0).abs() < 1e-12);
        // Grows until the face's outline hides behind the section, then changes by 5 %.
        for k in 0..16 {
            let side = f64::from(k) / 20.0;
            assert!(leaning(side + 0.05) > leaning(side));
        }
        assert!((leaning(0.95) / leaning(1.0) - 1.0).abs() < 0.06);
    }

    #[test]
    fn a_flat_tip_falls_off_as_the_blur() {
        let flat = TipView {
            bevel_px: 0.0,
            side: 1.0,
            rim_px: 0.0,
        };
        let falloff = Falloff::new(&flat, 0.9);
        // Against the error function at half and at one standard deviation; the kernel ends at
        // three, which leaves out 0.3 %.
        for (u, value) in [
            (0.0, 0.5),
            (0.45, 0.308_538),
            (-0.9, 0.841_345),
            (1.8, 0.022_75),
        ] {
            let (found, slope) = falloff.at(u);
            assert!((found - value).abs() < 5e-3, "{u}: {found}");
            assert!(slope < 0.0);
        }
    }

    #[test]
    fn the_silhouette_is_that_of_a_sampled_cut_cylinder() {
        for side in [0.0, 0.3, 0.7, 0.95] {
            let view = TipView {
                bevel_px: 8.0,
                side,
                rim_px: 0.0,
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

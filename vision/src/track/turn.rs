//! How the bevel is turned about the needle's axis against what the arm tells.
//!
//! A needle is never clamped with its bevel exactly where it is meant to be. Seen from its side, a
//! bevel turned by 20 degrees moves the tip along the axis by a tenth of its length, to and fro as
//! the needle turns, and not alike in the two images. But it also leans: its point lies beside
//! the axis, on a side and by an amount that the images show.

use super::silhouette::leaning;

/// Standard deviation before anything was seen \[rad\].
const UNKNOWN: f64 = 0.3;
/// Change from pair to pair, by torsion of the shaft \[rad\].
const WALK: f64 = 3e-3;
/// Standard deviation of a measured leaning; the largest leaning is 0.28. Much of it is a lasting
/// error of the axis beside which the point lies.
const NOISE: f64 = 0.06;
/// Deviation beyond which a measurement tells of something else, such as a bubble, in standard
/// deviations.
const GATE: f64 = 3.3;
/// Step of the numerical derivative \[rad\].
const STEP: f64 = 0.02;

/// The angle about the axis by which the bevel is ahead of what is told.
#[derive(Clone, Copy, Debug)]
pub(super) struct Turn {
    angle: f64,
    variance: f64,
}

impl Turn {
    pub(super) const fn unknown() -> Self {
        Self {
            angle: 0.0,
            variance: UNKNOWN * UNKNOWN,
        }
    }

    /// \[rad\]
    pub(super) const fn angle(&self) -> f64 {
        self.angle
    }

    /// To the next pair.
    pub(super) fn predict(&mut self) {
        self.variance = (self.variance + WALK * WALK).min(UNKNOWN * UNKNOWN);
    }

    /// Takes in one image's leaning; `side` is the sine at which the bevel would be seen if it were
    /// turned by a given angle, see [`super::Look::side`].
    pub(super) fn observe(&mut self, measured: f64, side: impl Fn(f64) -> f64) {
        let at = |angle: f64| leaning(side(angle).clamp(-1.0, 1.0));
        let slope = (at(self.angle + STEP) - at(self.angle - STEP)) / (2.0 * STEP);
        let innovation = measured - at(self.angle);
        let variance = slope * slope * self.variance + NOISE * NOISE;
        if innovation * innovation > GATE * GATE * variance {
            return;
        }
        let gain = self.variance * slope / variance;
        self.angle += gain * innovation;
        self.variance *= 1.0 - gain * slope;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Two cameras a right angle apart, from every direction.
    #[test]
    fn a_bevel_clamped_askew_is_found_from_two_sides() {
        let truth = -0.4;
        for k in 0..12 {
            let told = f64::from(k) * core::f64::consts::TAU / 12.0;
            let mut turn = Turn::unknown();
            for _ in 0..60 {
                turn.predict();
                turn.observe(leaning((told + truth).sin()), |angle| (told + angle).sin());
                turn.observe(leaning((told + truth).cos()), |angle| (told + angle).cos());
            }
            // The prior holds it back a little.
            assert!((turn.angle() - truth).abs() < 0.03, "{k}: {}", turn.angle());
        }
    }

    #[test]
    fn a_leaning_that_no_bevel_has_is_not_believed() {
        let mut turn = Turn::unknown();
        turn.observe(2.0, f64::sin);
        assert!(turn.angle() == 0.0);
    }
}

//! Two filters side by side: a tip that uncut tissue holds, and one that answers forces. The
//! first rules until measurements speak for the second.

use nalgebra::Vector2;

use super::filter::{Behaviour, Filter, TipState};
use super::unseen::{SlopeBy, Unseen};
use crate::settings::EstimatorSettings;

/// Evidence, as the logarithm of a likelihood ratio, at which a tip counts as free. Measurements
/// are not as independent as a likelihood takes them for: tips held by the phantom's tissue came to
/// 3, the springs model's to 200 and more within ten seconds.
const FREE: f64 = 8.0;
/// Most that one measurement may say for or against: an outlier says little.
const MOST: f64 = 2.0;

/// The tip's state under both behaviours.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct TipFilter {
    held: Filter,
    free: Filter,
    /// Logarithm of how much likelier the measurements were of a free tip; none below zero.
    evidence: f64,
    rules: Behaviour,
}

impl TipFilter {
    pub(crate) fn new(
        position: Vector2<f64>,
        s: &EstimatorSettings,
        unseen: Option<&Unseen>,
    ) -> Self {
        let filter = |behaviour| Filter::new(position, behaviour, s, unseen.cloned());
        Self {
            held: filter(Behaviour::Held),
            free: filter(Behaviour::Free),
            evidence: 0.0,
            rules: Behaviour::Held,
        }
    }

    /// The state under the behaviour that measurements speak for.
    pub(crate) const fn ruling(&self) -> &Filter {
        match self.rules {
            Behaviour::Held => &self.held,
            Behaviour::Free => &self.free,
        }
    }

    pub(crate) fn position(&self) -> Vector2<f64> {
        self.ruling().position()
    }

    /// Lasting error of the measured place \[m\].
    pub(crate) fn place_bias(&self) -> Vector2<f64> {
        let unseen = self.ruling().unseen();
        unseen.map_or_else(Vector2::zeros, Unseen::place)
    }

    /// Puts the tip aside by `by` \[m\], whatever it is held by.
    pub(crate) fn shift(&mut self, by: &Vector2<f64>) {
        for filter in [&mut self.held, &mut self.free] {
            let mut position = filter.x.fixed_rows_mut::<2>(0);
            position += by;
        }
    }

    /// Puts the tip at `position` \[m\].
    pub(crate) fn place(&mut self, position: &Vector2<f64>) {
        for filter in [&mut self.held, &mut self.free] {
            filter.x.fixed_rows_mut::<2>(0).copy_from(position);
        }
    }

    pub(crate) fn propagate(
        &mut self,
        advance: f64,
        tip: &TipState,
        azimuth: f64,
        s: &EstimatorSettings,
    ) {
        self.held.propagate(advance, tip, azimuth, s);
        self.free.propagate(advance, tip, azimuth, s);
    }

    /// Takes in the tip's lateral position \[m\]; `carried`: the tissue moves it, which says nothing
    /// of how it answers forces.
    pub(crate) fn measure_position(&mut self, measured: &Vector2<f64>, sigma: f64, carried: bool) {
        let held = self.held.measure_position(measured, sigma);
        let free = self.free.measure_position(measured, sigma);
        if carried {
            self.evidence = 0.0;
        } else {
            self.evidence = (self.evidence + (free - held).clamp(-MOST, MOST)).max(0.0);
        }
        self.rules = match self.rules {
            Behaviour::Held if self.evidence > FREE => Behaviour::Free,
            Behaviour::Free if self.evidence <= 0.0 => Behaviour::Held,
            as_before => as_before,
        };
    }

    pub(crate) fn measure_slope(&mut self, difference: &Vector2<f64>, by: &SlopeBy, sigma: f64) {
        for filter in [&mut self.held, &mut self.free] {
            filter.measure_slope(difference, by, sigma);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use nalgebra::Rotation2;

    /// Stiffness that draws the tip to where the shaft would be straight \[N/m\].
    const DRAWN: f64 = 150.0;
    /// 2 E I / lambda^2 of the paper's needle in soft gel \[N/rad\].
    const FORCE_OF_ANGLE: f64 = 4.3;

    /// A filter after 80 mm of a tip of `compliance` \[rad/N\] and `yielding`, whose base swings.
    fn after(compliance: f64, yielding: f64, carried: bool) -> TipFilter {
        // As the process is: a steady direction.
        let s = EstimatorSettings {
            tip_compliance_sigma_deg_n: 15.0,
            disturbance_walk_deg: 0.02,
            cut_noise_deg: 0.02,
            ..EstimatorSettings::default()
        };
        let mut filter = TipFilter::new(Vector2::zeros(), &s, None);
        let g = Vector2::new(0.024, 0.0);
        let mut c = Vector2::zeros();
        for i in 0..1600 {
            let t = f64::from(i) * 0.02;
            let straight = Vector2::new(1.5 * t.sin(), 2.0 * (0.7 * t).cos()) * 1e-3;
            let pushed = (c - straight) * DRAWN;
            let tip = TipState {
                force: (filter.position() - straight) * DRAWN,
                force_by_position: DRAWN,
                force_by_base: Vector2::new((3.0 * t).cos(), (2.0 * t).sin()) * 1e-3,
                force_of_angle: FORCE_OF_ANGLE,
                ..TipState::default()
            };
            let (azimuth, d) = (if (i / 200) % 2 == 0 { 0.3 } else { 2.5 }, 0.05e-3);
            let bevel = Rotation2::new(azimuth) * g;
            let bevel = if yielding > 0.0 {
                bevel * (1.0 + compliance * FORCE_OF_ANGLE)
            } else {
                bevel
            };
            c += (bevel - pushed * compliance) * d - tip.force_by_base / DRAWN * yielding;
            filter.propagate(d, &tip, azimuth, &s);
            filter.measure_position(&c, 0.02e-3, carried);
        }
        filter
    }

    #[test]
    fn a_tip_that_answers_forces_is_found_and_a_held_one_stays_held() {
        let free = after(12_f64.to_radians(), 0.8, false);
        assert_eq!(free.rules, Behaviour::Free);
        let found = (
            free.ruling().compliance().to_degrees(),
            free.ruling().yielding(),
        );
        assert!((found.0 - 12.0).abs() < 2.0, "{found:?}");
        assert!((found.1 - 0.8).abs() < 0.1, "{found:?}");

        let told = EstimatorSettings::default().tip_compliance_deg_n;
        let held = after(told.to_radians(), 0.0, false);
        assert_eq!(held.rules, Behaviour::Held, "{}", held.evidence);
    }

    /// What the tissue's own motion does to a tip would be taken for its answer.
    #[test]
    fn tissue_that_carries_the_tip_says_nothing() {
        assert_eq!(after(12_f64.to_radians(), 0.8, true).rules, Behaviour::Held);
    }
}

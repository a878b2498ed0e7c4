//! Ranges of the settings.

use super::LawSettings;
use crate::laws::LawError;

fn in_range(
    key: &'static str,
    value: f64,
    low: f64,
    high: f64,
    expected: &'static str,
) -> Result<(), LawError> {
    if value >= low && value <= high {
        Ok(())
    } else {
        Err(LawError::BadSetting {
            key,
            value,
            expected,
        })
    }
}

const RATE: &str = "a number from 0.1 to 3600";
const SMALL: &str = "a number from 0.01 to 1000";
const FRACTION: &str = "a fraction from 0 to 1";

impl LawSettings {
    /// Checks every range.
    ///
    /// # Errors
    /// The first setting outside its range, by its key.
    #[expect(clippy::too_many_lines, reason = "one range after the other")]
    pub fn validate(&self) -> Result<(), LawError> {
        let (p, h, b) = (&self.paper, &self.hybrid, &self.broyden);
        in_range(
            "paper.omega_z_max_deg_s",
            p.omega_z_max_deg_s,
            0.1,
            3600.0,
            RATE,
        )?;
        in_range(
            "paper.stretch_gain_per_s",
            p.stretch_gain_per_s,
            0.0,
            100.0,
            "a number from 0 to 100",
        )?;
        in_range(
            "paper.cycle_length_mm",
            p.cycle_length_mm,
            0.01,
            1000.0,
            SMALL,
        )?;
        in_range(
            "paper.natural_curvature_per_m",
            p.natural_curvature_per_m,
            0.01,
            1000.0,
            SMALL,
        )?;
        in_range(
            "paper.pivot_damping_m",
            p.pivot_damping_m,
            0.0,
            1.0,
            FRACTION,
        )?;
        in_range("paper.gate_from", p.gate_from, 0.0, 1.0, FRACTION)?;
        in_range(
            "paper.gate_to",
            p.gate_to,
            p.gate_from,
            1.0,
            "a fraction not below gate_from",
        )?;
        in_range(
            "paper.tangent_filter_s",
            p.tangent_filter_s,
            0.0,
            60.0,
            "a number from 0 to 60",
        )?;
        in_range(
            "paper.length_scale_mm",
            p.length_scale_mm,
            1.0,
            1e4,
            "a number from 1 to 10000",
        )?;
        in_range(
            "hybrid.plan_rate_hz",
            h.plan_rate_hz,
            0.1,
            1000.0,
            "a number from 0.1 to 1000",
        )?;
        in_range(
            "hybrid.debt_threshold_mm",
            h.debt_threshold_mm,
            0.01,
            1000.0,
            SMALL,
        )?;
        in_range("hybrid.spin_deg_s", h.spin_deg_s, 0.1, 3600.0, RATE)?;
        in_range("hybrid.bevel_reserve", h.bevel_reserve, 0.0, 1.0, FRACTION)?;
        in_range(
            "hybrid.reserve_until_mm",
            h.reserve_until_mm,
            0.0,
            1000.0,
            "a number from 0 to 1000",
        )?;
        in_range(
            "hybrid.pivot_weight_deg",
            h.pivot_weight_deg,
            0.01,
            1000.0,
            SMALL,
        )?;
        in_range(
            "hybrid.shift_weight_mm",
            h.shift_weight_mm,
            0.01,
            1000.0,
            SMALL,
        )?;
        in_range(
            "hybrid.pivot_fade_mm_deg",
            h.pivot_fade_mm_deg,
            0.0,
            10.0,
            "a number from 0 to 10",
        )?;
        in_range(
            "hybrid.shift_fade",
            h.shift_fade,
            0.0,
            10.0,
            "a number from 0 to 10",
        )?;
        in_range("hybrid.slow_mm", h.slow_mm, 0.01, 1000.0, SMALL)?;
        in_range(
            "hybrid.slow_most_s",
            h.slow_most_s,
            0.0,
            3600.0,
            "a number from 0 to 3600",
        )?;
        in_range(
            "hybrid.base_gain_per_s",
            h.base_gain_per_s,
            0.0,
            100.0,
            "a number from 0 to 100",
        )?;
        in_range(
            "hybrid.calm_from_mm",
            h.calm_from_mm,
            0.0,
            1000.0,
            "a number from 0 to 1000",
        )?;
        in_range(
            "hybrid.calm_to_mm",
            h.calm_to_mm,
            h.calm_from_mm,
            1000.0,
            "a number not below calm_from_mm, at most 1000",
        )?;
        in_range(
            "hybrid.regain_gain_per_s",
            h.regain_gain_per_s,
            0.0,
            100.0,
            "a number from 0 to 100",
        )?;
        in_range(
            "hybrid.unload_gain_per_s",
            h.unload_gain_per_s,
            0.0,
            100.0,
            "a number from 0 to 100",
        )?;
        in_range("broyden.update_gain", b.update_gain, 0.0, 1.0, FRACTION)?;
        in_range(
            "broyden.update_step_mm",
            b.update_step_mm,
            0.01,
            1000.0,
            SMALL,
        )?;
        in_range(
            "broyden.gain_per_s",
            b.gain_per_s,
            0.0,
            100.0,
            "a number from 0 to 100",
        )
    }
}

//! Settings of limits, estimator and laws: plain data with units in the keys.
//!
//! Values marked *assumed* are not in the paper; they were chosen on study plants.

use serde::{Deserialize, Serialize};

mod check;
mod motion;

pub use motion::MotionSettings;

/// Limits that every law keeps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Limits {
    /// Highest speed of insertion \[mm/s\] (assumed).
    pub insertion_speed_mm_s: f64,
    /// Highest turning speed of the base, without spin \[deg/s\] (assumed).
    pub tilt_speed_deg_s: f64,
    /// Highest speed of the base across the needle \[mm/s\] (assumed).
    pub lateral_speed_mm_s: f64,
    /// Highest spin about the needle's axis \[deg/s\] (assumed).
    pub spin_speed_deg_s: f64,
    /// Travel of the last joint that spinning leaves for tilting, on either side \[deg\].
    pub roll_reserve_deg: f64,
    /// Largest tilt of the base away from the surface's normal \[deg\] (assumed).
    pub tilt_deg: f64,
    /// Largest offset of the base across the insertion axis \[mm\] (assumed).
    pub base_offset_mm: f64,
    /// Largest tissue stretch at the entry that a plan may cause \[mm\] (assumed; tissue tears
    /// at 2 to 3 mm).
    pub entry_stretch_mm: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self {
            insertion_speed_mm_s: 3.0,
            tilt_speed_deg_s: 3.0,
            lateral_speed_mm_s: 8.0,
            spin_speed_deg_s: 360.0,
            roll_reserve_deg: 20.0,
            tilt_deg: 20.0,
            base_offset_mm: 40.0,
            entry_stretch_mm: 1.5,
        }
    }
}

/// The estimator of path, disturbance, bevel and stiffness.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct EstimatorSettings {
    /// Start value of the tissue's stiffness per length \[N/m2\]. Too stiff is harmless, too
    /// soft is not.
    pub stiffness_n_m2: f64,
    /// Its prior standard deviation, of the logarithm.
    pub stiffness_sigma: f64,
    /// Wave length (4 EI/K_T)^(1/4) of the needle in the tissue \[mm\], the prior of `estimate`
    /// for recordings of a tip sensor; 0: by the stiffness.
    pub wave_length_mm: f64,
    /// Axial load in the predictive model \[N\] (assumed).
    pub axial_load_n: f64,
    /// Prior of the bevel's cut angle \[deg\] (assumed).
    pub cut_angle_deg: f64,
    /// Relative standard deviation of its size.
    pub cut_angle_sigma: f64,
    /// Relative standard deviation across it (azimuth error of the bevel, rad).
    pub cut_across_sigma: f64,
    /// Change of the bevel vector, relative, in 15 mm.
    pub bevel_walk: f64,
    /// Change of the direction disturbance in 10 mm \[deg\].
    pub disturbance_walk_deg: f64,
    /// Standard deviation of the disturbance at the start \[deg\].
    pub start_disturbance_deg: f64,
    /// Length over which a disturbance is expected to fade \[mm\].
    pub disturbance_fade_mm: f64,
    /// Direction noise of the cut, correlated over 5 mm \[deg\].
    pub cut_noise_deg: f64,
    /// Standard deviation of the tip's position at the start \[mm\].
    pub start_sigma_mm: f64,
    /// Least standard deviation given to a measured direction: it carries model error \[deg\].
    pub direction_floor_deg: f64,
    /// Compliance of the tip: change of the cut angle by the path's reaction \[deg/N\] (assumed:
    /// half of what a compliant tip may have; the disturbance carries the rest either way). Where
    /// measurements say that no tissue holds the tip, the prior of what is estimated then.
    pub tip_compliance_deg_n: f64,
    /// Standard deviation of that prior \[deg/N\] (assumed).
    pub tip_compliance_sigma_deg_n: f64,
    /// Standard deviation of the yielding of a tip that nothing holds: the share of its free way
    /// that it goes aside with the base, 0 to 1 (assumed).
    pub tip_yielding_sigma: f64,
    /// Spacing of the path's marks and of the rollout's steps \[mm\].
    pub step_mm: f64,
    /// Period of the stiffness estimation \[s\].
    pub stiffness_period_s: f64,
    /// Prior standard deviation of the base's position error \[mm\].
    pub base_shift_sigma_mm: f64,
    /// Prior standard deviation of the base's direction error \[deg\].
    pub base_tilt_sigma_deg: f64,
    /// Feature switch, for ablation: predict from the image's time to the present.
    pub compensate_latency: bool,
}

impl Default for EstimatorSettings {
    fn default() -> Self {
        Self {
            stiffness_n_m2: 2e4,
            stiffness_sigma: 0.6,
            wave_length_mm: 0.0,
            axial_load_n: 0.4,
            cut_angle_deg: 1.5,
            cut_angle_sigma: 0.4,
            cut_across_sigma: 0.25,
            bevel_walk: 0.04,
            disturbance_walk_deg: 0.3,
            start_disturbance_deg: 0.3,
            disturbance_fade_mm: 60.0,
            cut_noise_deg: 0.15,
            start_sigma_mm: 0.3,
            direction_floor_deg: 0.6,
            tip_compliance_deg_n: 5.0,
            tip_compliance_sigma_deg_n: 4.0,
            tip_yielding_sigma: 0.3,
            step_mm: 2.0,
            stiffness_period_s: 1.0,
            base_shift_sigma_mm: 0.2,
            base_tilt_sigma_deg: 0.3,
            compensate_latency: true,
        }
    }
}

/// The paper's laws and their deviations.
#[expect(
    clippy::struct_excessive_bools,
    reason = "each is a named switch of a configuration"
)]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PaperSettings {
    /// Largest spin omega_z,max of eq. (15) \[deg/s\] (assumed).
    pub omega_z_max_deg_s: f64,
    /// Gain lambda of the stretch reduction \[1/s\] (assumed).
    pub stretch_gain_per_s: f64,
    /// Whether the third task acts.
    pub stretch_task: bool,
    /// Length L_DC of a duty cycle \[mm\] (assumed).
    pub cycle_length_mm: f64,
    /// Natural curvature K_nat \[1/m\] where it is not estimated (assumed).
    pub natural_curvature_per_m: f64,
    /// Take K_nat = 2 gamma / lambda from the estimator.
    pub estimate_curvature: bool,
    /// P1: the base only pivots about the entry.
    pub pivot_only: bool,
    /// P1: damping of the pivot's gain \[m/rad\].
    pub pivot_damping_m: f64,
    /// P2: fade base motion out with its authority over the tip's slope.
    pub authority_gate: bool,
    /// P2: authority below which base motion stops, and above which it is full.
    pub gate_from: f64,
    /// P2: see `gate_from`.
    pub gate_to: f64,
    /// P3: cycles are finished, alternate in sense, and end at 1.5 theta_DC.
    pub steady_cycles: bool,
    /// P3: time constant of the tangent's low-pass \[s\]; 0 is off.
    pub tangent_filter_s: f64,
    /// P4: sigma wrapped, held below the noise floor, bevel azimuth estimated.
    pub robust_bevel: bool,
    /// P5: the third task in its damped, saturated form.
    pub damped_stretch: bool,
    /// P7: length that turns radians into metres in every pseudo-inverse \[mm\].
    pub length_scale_mm: f64,
}

impl PaperSettings {
    /// The paper to the letter.
    pub fn verbatim() -> Self {
        Self {
            estimate_curvature: false,
            pivot_only: false,
            authority_gate: false,
            steady_cycles: false,
            tangent_filter_s: 0.0,
            robust_bevel: false,
            damped_stretch: false,
            length_scale_mm: 1000.0,
            ..Self::default()
        }
    }
}

impl Default for PaperSettings {
    fn default() -> Self {
        Self {
            omega_z_max_deg_s: 360.0,
            stretch_gain_per_s: 0.1,
            stretch_task: true,
            cycle_length_mm: 3.0,
            natural_curvature_per_m: 2.0,
            estimate_curvature: true,
            pivot_only: true,
            pivot_damping_m: 1e-3,
            authority_gate: true,
            gate_from: 0.1,
            gate_to: 0.2,
            steady_cycles: true,
            tangent_filter_s: 1.0,
            robust_bevel: true,
            damped_stretch: true,
            length_scale_mm: 126.0,
        }
    }
}

/// The hybrid law.
#[expect(
    clippy::struct_excessive_bools,
    reason = "each is a named switch of a configuration"
)]
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct HybridSettings {
    /// Plans a second \[Hz\].
    pub plan_rate_hz: f64,
    /// Debt threshold e_h of the bevel modulator \[mm of full curvature\].
    pub debt_threshold_mm: f64,
    /// Spin while the bevel turns \[deg/s\].
    pub spin_deg_s: f64,
    /// Bevel curvature kept in reserve early, as a fraction.
    pub bevel_reserve: f64,
    /// Distance to the target below which the reserve is released \[mm\].
    pub reserve_until_mm: f64,
    /// Pivot that counts as one in the effort \[deg\].
    pub pivot_weight_deg: f64,
    /// Shift that counts as one in the effort \[mm\].
    pub shift_weight_mm: f64,
    /// Pivot authority below which pivoting fades out \[mm/deg\].
    pub pivot_fade_mm_deg: f64,
    /// Shift authority below which shifting fades out \[mm/mm\].
    pub shift_fade: f64,
    /// Unfinished base motion that halves the speed of insertion \[mm at the target\].
    pub slow_mm: f64,
    /// Longest time that slowing down may cost in one insertion \[s\].
    pub slow_most_s: f64,
    /// Gain of the base's approach to its plan \[1/s\].
    pub base_gain_per_s: f64,
    /// Gain of the relief of the tissue where the base steers no more \[1/s\].
    pub unload_gain_per_s: f64,
    /// Gain with which a tip drawn back by the base is brought to the end of its path \[1/s\].
    pub regain_gain_per_s: f64,
    /// Standard deviation of the tip's estimated position from which the base is led calmly:
    /// slowly, by pivot alone, and without slowing the insertion down \[mm\].
    pub calm_from_mm: f64,
    /// The same at which it is led all calmly \[mm\].
    pub calm_to_mm: f64,
    /// Feature switches, for ablation: base pivot, base shift, relief of the tissue, slowing down,
    /// the level that spares the entry, partial curvature of the bevel by debt.
    pub pivot: bool,
    /// See `pivot`.
    pub shift: bool,
    /// See `pivot`.
    pub unload: bool,
    /// See `pivot`.
    pub slow_down: bool,
    /// See `pivot`.
    pub spare_entry: bool,
    /// See `pivot`.
    pub modulate: bool,
}

impl Default for HybridSettings {
    fn default() -> Self {
        Self {
            plan_rate_hz: 5.0,
            debt_threshold_mm: 0.75,
            spin_deg_s: 360.0,
            bevel_reserve: 0.7,
            reserve_until_mm: 40.0,
            pivot_weight_deg: 4.0,
            shift_weight_mm: 1.0,
            pivot_fade_mm_deg: 0.1,
            shift_fade: 0.15,
            slow_mm: 0.5,
            slow_most_s: 20.0,
            base_gain_per_s: 2.0,
            unload_gain_per_s: 0.2,
            regain_gain_per_s: 3.0,
            calm_from_mm: 0.012,
            calm_to_mm: 0.016,
            pivot: true,
            shift: true,
            unload: true,
            slow_down: true,
            spare_entry: true,
            modulate: true,
        }
    }
}

/// The data-driven baseline.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct BroydenSettings {
    /// Fraction of a secant correction taken at once.
    pub update_gain: f64,
    /// Base displacement between corrections \[mm\].
    pub update_step_mm: f64,
    /// Gain from miss to base speed \[1/s\].
    pub gain_per_s: f64,
}

impl Default for BroydenSettings {
    fn default() -> Self {
        Self {
            update_gain: 0.2,
            update_step_mm: 0.5,
            gain_per_s: 0.3,
        }
    }
}

/// All laws' settings.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct LawSettings {
    /// Laws `paper`, `tip-only`, `base-only`.
    pub paper: PaperSettings,
    /// Law `hybrid`.
    pub hybrid: HybridSettings,
    /// Law `broyden`.
    pub broyden: BroydenSettings,
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_survive_toml_and_refuse_unknown_keys() {
        let text = toml::to_string(&LawSettings::default()).unwrap();
        assert_eq!(
            toml::from_str::<LawSettings>(&text).unwrap(),
            LawSettings::default()
        );
        assert!(toml::from_str::<LawSettings>("[hybrid]\nplan_rate = 5").is_err());
        let mut bad = LawSettings::default();
        bad.hybrid.plan_rate_hz = f64::NAN;
        assert!(
            bad.validate()
                .unwrap_err()
                .to_string()
                .contains("hybrid.plan_rate_hz")
        );
    }
}

//! Every property and every flaw of the simulated world is a setting.
//!
//! [`Settings::default`] is the preset `ideal`: nominal needle and tissue, no flaw. Each key
//! carries its unit; unknown keys are refused. Where a value comes from is said as *paper*
//! (\[Chevrie2016\]), *computed* or *assumed*.

mod continuum;
mod devices;
mod preset;
mod validate;

use documented::DocumentedFields;
use serde::{Deserialize, Serialize};

pub use continuum::ContinuumSettings;
pub use devices::{EmSettings, FbgSettings, GuideSettings, HandSettings};
pub use preset::PRESETS;
pub(crate) use preset::merge;
pub use validate::SettingsError;
pub(crate) use validate::{is_pose, placed, within};

/// Everything about the simulated needle, tissue, fast sensor and robot, but the cameras.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct Settings {
    /// The needle.
    pub needle: NeedleSettings,
    /// The tissue beside the shaft.
    pub tissue: TissueSettings,
    /// The tissue at the tip.
    pub tip: TipSettings,
    /// Friction along the shaft.
    pub friction: FrictionSettings,
    /// The skin at the entry.
    pub entry: EntrySettings,
    /// Motion of the tissue.
    pub motion: MotionSettings,
    /// The fast sensor.
    pub sensor: SensorSettings,
    /// The electromagnetic sensor in the tip.
    pub em: EmSettings,
    /// Fibre Bragg gratings in the needle.
    pub fbg: FbgSettings,
    /// The guide before the tissue.
    pub guide: GuideSettings,
    /// The hand that pushes the needle where no axis does.
    pub hand: HandSettings,
    /// Flaws of the robot and of the needle's mounting.
    pub robot: RobotSettings,
    /// What differs from run to run.
    pub spread: SpreadSettings,
    /// The bevel and the tissue of the plant `continuum`; the rod's plant does not read them.
    pub continuum: ContinuumSettings,
}

impl Settings {
    /// What a key means, `table.key`: its documentation.
    pub fn meaning(key: &str) -> Option<&'static str> {
        let (table, key) = key.split_once('.')?;
        match table {
            "needle" => NeedleSettings::get_field_docs(key),
            "tissue" => TissueSettings::get_field_docs(key),
            "tip" => TipSettings::get_field_docs(key),
            "friction" => FrictionSettings::get_field_docs(key),
            "entry" => EntrySettings::get_field_docs(key),
            "motion" => MotionSettings::get_field_docs(key),
            "sensor" => SensorSettings::get_field_docs(key),
            "em" => EmSettings::get_field_docs(key),
            "fbg" => FbgSettings::get_field_docs(key),
            "guide" => GuideSettings::get_field_docs(key),
            "hand" => HandSettings::get_field_docs(key),
            "robot" => RobotSettings::get_field_docs(key),
            "spread" => SpreadSettings::get_field_docs(key),
            "continuum" => ContinuumSettings::get_field_docs(key),
            _ => return None,
        }
        .ok()
    }
}

/// The needle.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct NeedleSettings {
    /// Free length from the holder to O (paper).
    pub length_mm: f64,
    /// Outer diameter (paper).
    pub outer_diameter_mm: f64,
    /// Inner diameter (paper).
    pub inner_diameter_mm: f64,
    /// Young's modulus (paper).
    pub young_gpa: f64,
    /// Shear modulus of steel (computed).
    pub shear_gpa: f64,
    /// Angle between the axis and the bevel's face (assumed; the paper gives none).
    pub bevel_deg: f64,
    /// Number of edges of the discrete rod; 252 make 0.5 mm.
    pub elements: usize,
    /// Bending stress beyond which the shaft stays bent, reported as an event (assumed).
    pub yield_mpa: f64,
}

impl Default for NeedleSettings {
    fn default() -> Self {
        Self {
            length_mm: 126.0,
            outer_diameter_mm: 0.70,
            inner_diameter_mm: 0.48,
            young_gpa: 200.0,
            shear_gpa: 77.0,
            bevel_deg: 24.0,
            elements: 252,
            yield_mpa: 900.0,
        }
    }
}

/// A layer of tissue, from its depth to the next layer's.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(deny_unknown_fields)]
pub struct Layer {
    /// Depth at which the layer begins.
    pub from_mm: f64,
    /// Its stiffness over the nominal one.
    pub stiffness_ratio: f64,
    /// Its cut angle over the nominal one.
    pub cut_ratio: f64,
    /// Axial force to puncture the membrane at its beginning.
    pub puncture_n: f64,
}

/// The tissue beside the shaft: force per length `K u (1 + a (u/d)^2)` on the displacement
/// `u` from the cut path, less what relaxes; `d` is the outer diameter.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct TissueSettings {
    /// Stiffness per length K before relaxation (paper's start value; 5e3-3e4).
    pub stiffness_n_m2: f64,
    /// Stiffening `a` (assumed).
    pub stiffening: f64,
    /// Fraction of the force that relaxes, standard linear solid (assumed; 0.1-0.3).
    pub relaxed_fraction: f64,
    /// Time constant of relaxation (assumed; 10-60 s).
    pub relaxation_s: f64,
    /// Play of the shaft in its slit, each side; the force starts smoothly (assumed).
    pub slit_gap_um: f64,
    /// Displacement beyond which the path tears and stays displaced; 0 never (assumed; 2-3).
    pub tear_mm: f64,
    /// Variation of the stiffness along depth, standard deviation over mean (assumed).
    pub field_cv: f64,
    /// Correlation length of that variation (assumed).
    pub field_length_mm: f64,
    /// Layers by rising depth; none means one homogeneous gel.
    pub layers: Vec<Layer>,
}

impl Default for TissueSettings {
    fn default() -> Self {
        Self {
            stiffness_n_m2: 1e4,
            stiffening: 0.0,
            relaxed_fraction: 0.0,
            relaxation_s: 20.0,
            slit_gap_um: 0.0,
            tear_mm: 0.0,
            field_cv: 0.0,
            field_length_mm: 10.0,
            layers: Vec::new(),
        }
    }
}

/// The tissue at the tip. The path goes on along the tip's direction turned by
/// `cut_angle b - compliance F` (vectors): `b` the material bevel direction, `F` the lateral
/// force of the tissue on the tip.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct TipSettings {
    /// Angle gamma_0 between the path and the tip's direction (computed from the paper's miss).
    pub cut_angle_deg: f64,
    /// C_t: turn of the path by the lateral force (assumed; 0-2, compliant family 10).
    pub compliance_deg_n: f64,
    /// C_m: turn of the path by the bending moment one bevel length behind O (assumed).
    pub moment_compliance_deg_nm: f64,
    /// Variation of gamma_0 along depth, standard deviation over mean (assumed; 0.1-0.2).
    pub field_cv: f64,
    /// Correlation length of that variation (assumed; 10-20).
    pub field_length_mm: f64,
    /// Noise of the path's direction, per axis (assumed).
    pub direction_noise_deg: f64,
    /// Correlation length of that noise (assumed).
    pub direction_noise_length_mm: f64,
    /// Lateral stiffness with which uncut tissue holds the tip (assumed; stiff beside K
    /// lambda = 300 N/m).
    pub hold_n_m: f64,
    /// Axial force of cutting (assumed; 0.2-0.8).
    pub cutting_n: f64,
}

impl Default for TipSettings {
    fn default() -> Self {
        Self {
            cut_angle_deg: 1.75,
            compliance_deg_n: 0.0,
            moment_compliance_deg_nm: 0.0,
            field_cv: 0.0,
            field_length_mm: 15.0,
            direction_noise_deg: 0.0,
            direction_noise_length_mm: 5.0,
            hold_n_m: 5e4,
            cutting_n: 0.0,
        }
    }
}

/// Friction between shaft and tissue, axial and, at half the diameter, torsional.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct FrictionSettings {
    /// Sliding friction per length (assumed; 5-30, sticky 100).
    pub shaft_n_m: f64,
    /// Elastic slide before friction is fully mobilised (assumed).
    pub presliding_um: f64,
    /// Breakaway friction over sliding friction; above 1 the shaft sticks and slips (assumed).
    pub static_ratio: f64,
}

impl Default for FrictionSettings {
    fn default() -> Self {
        Self {
            shaft_n_m: 0.0,
            presliding_um: 0.5,
            static_ratio: 1.0,
        }
    }
}

/// Entry sliding: a skin on the gel whose hole pulls at the shaft and slides along the surface.
/// Without `skin_n_m` there is none. All assumed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct EntrySettings {
    /// Stiffness with which the skin holds the shaft along the surface; 0 means no skin
    /// (100-1000).
    pub skin_n_m: f64,
    /// Pull beyond which the hole slides over the gel, and stays; 0 never (0.1-1).
    pub slide_n: f64,
    /// Friction of the hole on the shaft, axial and, at half the diameter, torsional (0-0.5).
    pub grip_n: f64,
    /// Share of the gel's motion in which the skin takes part; below 1 the moving gel slides
    /// under the entry.
    pub follow: f64,
}

impl Default for EntrySettings {
    fn default() -> Self {
        Self {
            skin_n_m: 0.0,
            slide_n: 0.0,
            grip_n: 0.0,
            follow: 1.0,
        }
    }
}

/// Motion of the tissue, in the phantom frame (z into the gel). All assumed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct MotionSettings {
    /// Amplitude of breathing at the surface, a cos^4 of time (2-15).
    pub breathing_mm: f64,
    /// Rate of breathing (0.2-0.3).
    pub breathing_hz: f64,
    /// Direction of breathing.
    pub breathing_direction: [f64; 3],
    /// Phase at the start; 90 is the end of exhalation.
    pub breathing_phase_deg: f64,
    /// Relative loss of breathing motion per depth: makes it affine instead of rigid. Below zero
    /// it grows: -50 moves 80 mm of depth by five times the motion at the surface.
    pub breathing_fade_1_m: f64,
    /// Steady drift.
    pub drift_mm_min: [f64; 3],
    /// Steady rotation about the phantom's x axis through the entry.
    pub rotation_deg_min: f64,
}

impl Default for MotionSettings {
    fn default() -> Self {
        Self {
            breathing_mm: 0.0,
            breathing_hz: 0.25,
            breathing_direction: [1.0, 0.0, 0.0],
            breathing_phase_deg: 90.0,
            breathing_fade_1_m: 0.0,
            drift_mm_min: [0.0; 3],
            rotation_deg_min: 0.0,
        }
    }
}

/// The fast sensor: shape points and tip without images.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct SensorSettings {
    /// Rate of exposures.
    pub rate_hz: f64,
    /// Delay from exposure to delivery; also applied to rendered images.
    pub latency_ms: f64,
    /// Fraction of exposures that are lost; also applied to rendered images.
    pub drop_fraction: f64,
    /// Spacing of the points along the visible shaft.
    pub spacing_mm: f64,
    /// White noise of every point, per axis.
    pub noise_mm: f64,
    /// White noise of the tip's direction, per axis.
    pub direction_noise_deg: f64,
    /// Standard deviation, per axis, of a bias that is constant through a run.
    pub bias_mm: f64,
}

impl Default for SensorSettings {
    fn default() -> Self {
        Self {
            rate_hz: 30.0,
            latency_ms: 0.0,
            drop_fraction: 0.0,
            spacing_mm: 2.5,
            noise_mm: 0.0,
            direction_noise_deg: 0.0,
            bias_mm: 0.0,
        }
    }
}

/// Flaws of the robot and of the needle's mounting. All assumed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct RobotSettings {
    /// Hidden kinematic error that varies over the workspace: position, standard deviation per
    /// axis (0.1-0.3).
    pub kinematic_mm: f64,
    /// The same: orientation (0.05-0.1).
    pub kinematic_deg: f64,
    /// Distance over which that error varies.
    pub kinematic_length_mm: f64,
    /// Hand-eye error: offset of the needle in its holder, standard deviation across.
    pub holder_offset_mm: f64,
    /// Hand-eye error: tilt of the needle in its holder, standard deviation per axis; it turns
    /// with the last joint (run-out).
    pub holder_tilt_deg: f64,
    /// Time constant of the servos.
    pub servo_lag_ms: f64,
    /// Yielding of the holder to lateral force.
    pub compliance_mm_n: f64,
    /// Yielding of the holder to a moment.
    pub compliance_deg_nm: f64,
}

impl Default for RobotSettings {
    fn default() -> Self {
        Self {
            kinematic_mm: 0.0,
            kinematic_deg: 0.0,
            kinematic_length_mm: 100.0,
            holder_offset_mm: 0.0,
            holder_tilt_deg: 0.0,
            servo_lag_ms: 0.0,
            compliance_mm_n: 0.0,
            compliance_deg_nm: 0.0,
        }
    }
}

/// What is drawn anew for every run.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, DocumentedFields)]
#[serde(deny_unknown_fields, default)]
pub struct SpreadSettings {
    /// Tissue stiffness, log-normal about its setting, standard deviation over mean.
    pub stiffness_cv: f64,
    /// Cut angle, log-normal about its setting, standard deviation over mean.
    pub cut_angle_cv: f64,
    /// Error of the bevel's azimuth in its holder, standard deviation.
    pub azimuth_deg: f64,
    /// Tilt of the needle and of its direction of insertion against the holder's nominal axis,
    /// about the tip at the start, standard deviation per axis.
    pub tilt_deg: f64,
    /// Straight insertion before the experiment starts, uniform between the two.
    pub pre_insertion_mm: [f64; 2],
}

impl Default for SpreadSettings {
    fn default() -> Self {
        Self {
            stiffness_cv: 0.0,
            cut_angle_cv: 0.0,
            azimuth_deg: 0.0,
            tilt_deg: 0.0,
            pre_insertion_mm: [5.0, 5.0],
        }
    }
}

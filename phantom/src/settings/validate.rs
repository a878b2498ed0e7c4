//! Physical ranges of the settings.

use nalgebra::Isometry3;

use super::Settings;

/// A preset or a setting that cannot be simulated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SettingsError {
    /// A value outside its physical range.
    #[error("{key} = {value}: must be from {lowest} to {highest}")]
    OutOfRange {
        /// Key of the setting, as in the file.
        key: &'static str,
        /// The refused value, in the key's unit.
        value: f64,
        /// Lowest allowed value.
        lowest: f64,
        /// Highest allowed value.
        highest: f64,
    },
    /// Two values that contradict each other.
    #[error("{key}: {expected}")]
    Inconsistent {
        /// Key of the setting, as in the file.
        key: &'static str,
        /// What must hold.
        expected: &'static str,
    },
    /// An invalid pose.
    #[error("{key}: must be a finite pose within {} m of the origin", FARTHEST)]
    Pose {
        /// What should stand there.
        key: &'static str,
    },
    /// No such preset.
    #[error("no preset `{name}`; there are {}", super::PRESETS.join(", "))]
    UnknownPreset {
        /// The name asked for.
        name: String,
    },
    /// Text or keys that do not make settings.
    #[error("settings: {0}")]
    Syntax(#[from] toml::de::Error),
}

/// Farthest place in the laboratory \[m\]: there a double still resolves 1e-14 m.
const FARTHEST: f64 = 100.0;

/// Whether `pose` is finite, within the laboratory, and its quaternion of unit length.
pub(crate) fn is_pose(pose: &Isometry3<f64>) -> bool {
    let unit = pose.rotation.quaternion().norm_squared();
    // Written so that NaN is refused.
    pose.translation.vector.norm() <= FARTHEST && (unit - 1.0).abs() < 1e-6
}

/// Refuses what is no pose.
pub(crate) fn placed(key: &'static str, pose: &Isometry3<f64>) -> Result<(), SettingsError> {
    if is_pose(pose) {
        Ok(())
    } else {
        Err(SettingsError::Pose { key })
    }
}

/// NaN is outside every range.
pub(crate) fn within(
    key: &'static str,
    value: f64,
    lowest: f64,
    highest: f64,
) -> Result<(), SettingsError> {
    if value >= lowest && value <= highest {
        Ok(())
    } else {
        Err(SettingsError::OutOfRange {
            key,
            value,
            lowest,
            highest,
        })
    }
}

fn holds(condition: bool, key: &'static str, expected: &'static str) -> Result<(), SettingsError> {
    if condition {
        Ok(())
    } else {
        Err(SettingsError::Inconsistent { key, expected })
    }
}

impl Settings {
    /// Checks every setting against its physical range.
    ///
    /// # Errors
    /// The first setting outside its range, with the range.
    pub fn validate(&self) -> Result<(), SettingsError> {
        self.validate_needle()?;
        self.validate_tissue()?;
        self.validate_tip_and_friction()?;
        self.validate_motion()?;
        self.continuum.validate()?;
        self.validate_devices()
    }

    fn validate_needle(&self) -> Result<(), SettingsError> {
        let n = &self.needle;
        within("needle.length_mm", n.length_mm, 20.0, 400.0)?;
        within("needle.outer_diameter_mm", n.outer_diameter_mm, 0.2, 3.0)?;
        within("needle.inner_diameter_mm", n.inner_diameter_mm, 0.0, 2.99)?;
        holds(
            n.inner_diameter_mm < 0.95 * n.outer_diameter_mm,
            "needle.inner_diameter_mm",
            "must be below 95 % of the outer diameter",
        )?;
        within("needle.young_gpa", n.young_gpa, 10.0, 500.0)?;
        within("needle.shear_gpa", n.shear_gpa, 3.0, 200.0)?;
        within("needle.bevel_deg", n.bevel_deg, 5.0, 85.0)?;
        within("needle.elements", n.elements as f64, 16.0, 2000.0)?;
        within("needle.yield_mpa", n.yield_mpa, 10.0, 1e4)
    }

    fn validate_tissue(&self) -> Result<(), SettingsError> {
        let t = &self.tissue;
        within("tissue.stiffness_n_m2", t.stiffness_n_m2, 1e2, 1e6)?;
        within("tissue.stiffening", t.stiffening, 0.0, 10.0)?;
        within("tissue.relaxed_fraction", t.relaxed_fraction, 0.0, 0.9)?;
        within("tissue.relaxation_s", t.relaxation_s, 0.1, 1e4)?;
        within("tissue.slit_gap_um", t.slit_gap_um, 0.0, 500.0)?;
        within("tissue.tear_mm", t.tear_mm, 0.0, 50.0)?;
        holds(
            t.tear_mm == 0.0 || t.tear_mm >= 0.1,
            "tissue.tear_mm",
            "must be 0 (never) or at least 0.1",
        )?;
        within("tissue.field_cv", t.field_cv, 0.0, 0.3)?;
        within("tissue.field_length_mm", t.field_length_mm, 1.0, 100.0)?;
        for (i, layer) in t.layers.iter().enumerate() {
            within("tissue.layers.from_mm", layer.from_mm, 0.0, 400.0)?;
            within(
                "tissue.layers.stiffness_ratio",
                layer.stiffness_ratio,
                0.3,
                5.0,
            )?;
            within("tissue.layers.cut_ratio", layer.cut_ratio, 0.7, 1.4)?;
            within("tissue.layers.puncture_n", layer.puncture_n, 0.0, 5.0)?;
            holds(
                i == 0 || t.layers[i - 1].from_mm < layer.from_mm,
                "tissue.layers",
                "must be ordered by rising from_mm",
            )?;
        }
        Ok(())
    }

    fn validate_tip_and_friction(&self) -> Result<(), SettingsError> {
        let t = &self.tip;
        within("tip.cut_angle_deg", t.cut_angle_deg, 0.0, 15.0)?;
        within("tip.compliance_deg_n", t.compliance_deg_n, 0.0, 30.0)?;
        within(
            "tip.moment_compliance_deg_nm",
            t.moment_compliance_deg_nm,
            0.0,
            1e4,
        )?;
        within("tip.field_cv", t.field_cv, 0.0, 0.3)?;
        within("tip.field_length_mm", t.field_length_mm, 1.0, 100.0)?;
        within("tip.direction_noise_deg", t.direction_noise_deg, 0.0, 3.0)?;
        within(
            "tip.direction_noise_length_mm",
            t.direction_noise_length_mm,
            1.0,
            100.0,
        )?;
        within("tip.hold_n_m", t.hold_n_m, 1e2, 1e6)?;
        within("tip.cutting_n", t.cutting_n, 0.0, 2.0)?;
        let f = &self.friction;
        within("friction.shaft_n_m", f.shaft_n_m, 0.0, 300.0)?;
        within("friction.presliding_um", f.presliding_um, 0.1, 100.0)?;
        within("friction.static_ratio", f.static_ratio, 1.0, 3.0)?;
        let e = &self.entry;
        within("entry.skin_n_m", e.skin_n_m, 0.0, 1e4)?;
        within("entry.slide_n", e.slide_n, 0.0, 10.0)?;
        within("entry.grip_n", e.grip_n, 0.0, 2.0)?;
        within("entry.follow", e.follow, 0.0, 1.0)?;
        holds(
            e.grip_n == 0.0 || f.shaft_n_m > 0.0,
            "entry.grip_n",
            "needs friction.shaft_n_m above 0",
        )
    }

    fn validate_motion(&self) -> Result<(), SettingsError> {
        let m = &self.motion;
        within("motion.breathing_mm", m.breathing_mm, 0.0, 30.0)?;
        within("motion.breathing_hz", m.breathing_hz, 0.0, 2.0)?;
        for x in m.breathing_direction {
            within("motion.breathing_direction", x, -1e3, 1e3)?;
        }
        holds(
            m.breathing_mm == 0.0 || m.breathing_direction.iter().any(|x| *x != 0.0),
            "motion.breathing_direction",
            "must not be zero while breathing_mm is not",
        )?;
        within(
            "motion.breathing_phase_deg",
            m.breathing_phase_deg,
            -360.0,
            360.0,
        )?;
        within(
            "motion.breathing_fade_1_m",
            m.breathing_fade_1_m,
            -100.0,
            20.0,
        )?;
        let [x, y, z] = m.breathing_direction;
        let steep = z.abs() / (x * x + y * y + z * z).sqrt();
        holds(
            m.breathing_mm == 0.0
                || m.breathing_mm * 1e-3 * m.breathing_fade_1_m.abs() * steep < 0.5,
            "motion.breathing_fade_1_m",
            "must change the tissue's length along depth by less than half",
        )?;
        for x in m.drift_mm_min {
            within("motion.drift_mm_min", x, -60.0, 60.0)?;
        }
        within("motion.rotation_deg_min", m.rotation_deg_min, -60.0, 60.0)
    }

    fn validate_devices(&self) -> Result<(), SettingsError> {
        let s = &self.sensor;
        within("sensor.rate_hz", s.rate_hz, 1.0, 1000.0)?;
        within("sensor.latency_ms", s.latency_ms, 0.0, 1000.0)?;
        within("sensor.drop_fraction", s.drop_fraction, 0.0, 0.95)?;
        within("sensor.spacing_mm", s.spacing_mm, 0.1, 50.0)?;
        within("sensor.noise_mm", s.noise_mm, 0.0, 5.0)?;
        within(
            "sensor.direction_noise_deg",
            s.direction_noise_deg,
            0.0,
            20.0,
        )?;
        within("sensor.bias_mm", s.bias_mm, 0.0, 5.0)?;
        self.em.validate()?;
        self.fbg.validate()?;
        within("guide.gap_mm", self.guide.gap_mm, 0.0, 200.0)?;
        self.hand.validate()?;
        let r = &self.robot;
        within("robot.kinematic_mm", r.kinematic_mm, 0.0, 5.0)?;
        within("robot.kinematic_deg", r.kinematic_deg, 0.0, 5.0)?;
        within(
            "robot.kinematic_length_mm",
            r.kinematic_length_mm,
            10.0,
            1e4,
        )?;
        within("robot.holder_offset_mm", r.holder_offset_mm, 0.0, 5.0)?;
        within("robot.holder_tilt_deg", r.holder_tilt_deg, 0.0, 5.0)?;
        within("robot.servo_lag_ms", r.servo_lag_ms, 0.0, 500.0)?;
        within("robot.compliance_mm_n", r.compliance_mm_n, 0.0, 0.5)?;
        within("robot.compliance_deg_nm", r.compliance_deg_nm, 0.0, 50.0)?;
        let p = &self.spread;
        within("spread.stiffness_cv", p.stiffness_cv, 0.0, 1.0)?;
        within("spread.cut_angle_cv", p.cut_angle_cv, 0.0, 1.0)?;
        within("spread.azimuth_deg", p.azimuth_deg, 0.0, 60.0)?;
        within("spread.tilt_deg", p.tilt_deg, 0.0, 5.0)?;
        for x in p.pre_insertion_mm {
            within("spread.pre_insertion_mm", x, 0.0, 50.0)?;
        }
        holds(
            p.pre_insertion_mm[0] <= p.pre_insertion_mm[1],
            "spread.pre_insertion_mm",
            "must be [lowest, highest]",
        )
    }
}

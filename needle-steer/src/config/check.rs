//! Ranges of the configuration's values.

mod range;
mod remote;

pub(crate) use range::in_other_unit;
use range::{agree, zero_or_within};
pub(super) use range::{positive, within};

use super::{
    Backend, Config, FARTHEST_MM, InsertionBy, Invalid, LARGEST_SEED, NeedleSupport, SensorKind,
    TargetKind,
};

impl Config {
    /// Checks every range.
    ///
    /// # Errors
    /// The first key whose value is outside its range.
    pub fn validate(&self) -> Result<(), Invalid> {
        self.validate_run()?;
        self.validate_needle()?;
        self.validate_insertion()?;
        self.validate_law()?;
        self.validate_phantom()?;
        self.validate_cameras()?;
        self.validate_motion()?;
        self.validate_estimator()?;
        self.validate_arm()?;
        self.validate_ros()?;
        self.validate_remote()?;
        self.validate_fbg()?;
        self.validate_limits()?;
        self.validate_law_limits()
    }

    fn validate_run(&self) -> Result<(), Invalid> {
        positive(
            "run.insertion_speed_mm_s",
            self.run.insertion_speed_mm_s,
            5.0,
        )?;
        positive("run.max_duration_s", self.run.max_duration_s, 86_400.0)?;
        if self.run.seed > LARGEST_SEED {
            return Err(Invalid {
                key: "run.seed".into(),
                problem: format!("expected at most {LARGEST_SEED}, found {}", self.run.seed),
            });
        }
        let target = &self.target;
        within("target.goal_mm", target.goal_mm, 0.001, 100.0)?;
        if matches!(target.kind, TargetKind::Stereo | TargetKind::World) {
            for value in target.position_mm {
                within("target.position_mm", value, -2000.0, 2000.0)?;
            }
            return Ok(());
        }
        within("target.depth_mm", target.depth_mm, 1.0, 500.0)?;
        within("target.offset_mm", target.offset_mm, 0.0, 200.0)?;
        within("target.angle_deg", target.angle_deg, -360.0, 360.0)
    }

    fn validate_needle(&self) -> Result<(), Invalid> {
        let needle = &self.needle;
        within("needle.length_mm", needle.length_mm, 10.0, 1000.0)?;
        within(
            "needle.outer_diameter_mm",
            needle.outer_diameter_mm,
            0.1,
            5.0,
        )?;
        zero_or_within(
            "needle.inner_diameter_mm",
            needle.inner_diameter_mm,
            0.02,
            5.0,
        )?;
        if needle.inner_diameter_mm >= needle.outer_diameter_mm {
            return Err(Invalid {
                key: "needle.inner_diameter_mm".into(),
                problem: format!(
                    "expected less than needle.outer_diameter_mm ({}), found {}",
                    needle.outer_diameter_mm, needle.inner_diameter_mm
                ),
            });
        }
        positive("needle.young_modulus_gpa", needle.young_modulus_gpa, 1000.0)?;
        within("needle.bevel_deg", needle.bevel_deg, 1.0, 89.0)?;
        for (key, value, least, most) in [
            ("needle.guide_gap_mm", needle.guide_gap_mm, 1.0, 500.0),
            (
                "needle.guide_gap_sigma_mm",
                needle.guide_gap_sigma_mm,
                0.01,
                100.0,
            ),
            (
                "needle.sensor_setback_mm",
                needle.sensor_setback_mm,
                0.05,
                50.0,
            ),
        ] {
            zero_or_within(key, value, least, most)?;
        }
        for value in needle.axis_drift_rad_per_m {
            within("needle.axis_drift_rad_per_m", value, -50.0, 50.0)?;
        }
        for value in needle.tip_drift_mm_per_m {
            within("needle.tip_drift_mm_per_m", value, -1000.0, 1000.0)?;
        }
        within(
            "tissue.spring_spacing_mm",
            self.tissue.spring_spacing_mm,
            0.5,
            20.0,
        )?;
        for value in self.tissue.entry_mm {
            within("tissue.entry_mm", value, -5000.0, 5000.0)?;
        }
        let norm = self.tissue.inward.iter().map(|x| x * x).sum::<f64>().sqrt();
        within("tissue.inward", norm, 0.999, 1.001).map_err(|mut e| {
            e.problem = format!("expected a unit vector, found one of length {norm}");
            e
        })
    }

    fn validate_insertion(&self) -> Result<(), Invalid> {
        within("insertion.step_mm", self.insertion.step_mm, 0.5, 50.0)?;
        if self.insertion.by == InsertionBy::Axis || self.is_dry() {
            return Ok(());
        }
        let needs = [
            (
                self.needle.support == NeedleSupport::Guide,
                "a hand pushes the needle through a guide: expected needle.support = \"guide\"",
            ),
            (
                !matches!(self.run.sensor, SensorKind::Images | SensorKind::Fbg),
                "the advance of a hand is measured by a sensor of the tip: expected run.sensor = \"em\" or \
                 \"shape\"",
            ),
            (
                self.run.backend == Backend::Sim,
                "insertion by hand is there for backend \"sim\" alone",
            ),
        ];
        match needs.into_iter().find(|(given, _)| !given) {
            Some((_, problem)) => Err(Invalid {
                key: "insertion.by".into(),
                problem: problem.into(),
            }),
            None => Ok(()),
        }
    }

    fn validate_law(&self) -> Result<(), Invalid> {
        hybrid_control::law_by_name(&self.run.law, &self.law).map_err(|e| Invalid {
            key: match &e {
                hybrid_control::LawError::BadSetting { key, .. } => format!("law.{key}"),
                hybrid_control::LawError::UnknownLaw { .. } => "run.law".into(),
            },
            problem: e.to_string(),
        })?;
        Ok(())
    }

    fn validate_cameras(&self) -> Result<(), Invalid> {
        let width = self.cameras.width_px;
        if ![640, 1280].contains(&width) {
            return Err(Invalid {
                key: "cameras.width_px".into(),
                problem: format!("expected 640 or 1280, found {width}"),
            });
        }
        let cameras = &self.cameras;
        if cameras.calibration.is_empty() != cameras.registration.is_empty() {
            let [key, other] = if cameras.calibration.is_empty() {
                ["calibration", "registration"]
            } else {
                ["registration", "calibration"]
            };
            return Err(Invalid {
                key: format!("cameras.{key}"),
                problem: format!("missing: cameras.{other} is given, and one needs the other"),
            });
        }
        if cameras.calibration.is_empty() && !cameras.second_calibration.is_empty() {
            return Err(Invalid {
                key: "cameras.calibration".into(),
                problem: "missing: cameras.second_calibration is given".to_owned(),
            });
        }
        if !(cameras.unit_mm >= 0.0 && cameras.unit_mm.is_finite()) {
            return Err(Invalid {
                key: "cameras.unit_mm".into(),
                problem: format!(
                    "expected 0 (metres), 1 (millimetres) or a square's side, found {}",
                    cameras.unit_mm
                ),
            });
        }
        self.tracking.validate().map_err(|e| Invalid {
            key: format!("tracking.{}", e.key),
            problem: e.to_string(),
        })?;
        crate::cameras::settings(self)
            .map_err(|e| e.to_string())
            .and_then(|settings| settings.validate().map_err(|e| e.to_string()))
            .map_err(|problem| Invalid {
                key: "cameras.simulated".into(),
                problem,
            })
    }

    /// Refuses what needs somebody, or somebody's node, beside many runs in a row.
    ///
    /// # Errors
    /// The key that asks for it.
    pub fn check_unattended(&self) -> Result<(), Invalid> {
        let refused = |key: &str, problem: &str| {
            Err(Invalid {
                key: key.to_owned(),
                problem: problem.to_owned(),
            })
        };
        if self.supervisor.dead_man_ms > 0.0 {
            let problem = "nothing can refresh the dead-man's switch of many runs; expected 0";
            return refused("supervisor.dead_man_ms", problem);
        }
        if self.ros.publish {
            return refused(
                "ros.publish",
                "many runs are not shown over ROS; expected false",
            );
        }
        if self.tracker.is_used() {
            return refused(
                "tracker.source",
                "many runs take no wall-clock time, as a tracker does; expected none",
            );
        }
        Ok(())
    }

    /// Limits of the laws, each by itself and against what they must agree with.
    fn validate_law_limits(&self) -> Result<(), Invalid> {
        let l = &self.limits;
        for (key, value, most) in [
            ("insertion_speed_mm_s", l.insertion_speed_mm_s, 100.0),
            ("tilt_speed_deg_s", l.tilt_speed_deg_s, 90.0),
            ("lateral_speed_mm_s", l.lateral_speed_mm_s, 100.0),
            ("spin_speed_deg_s", l.spin_speed_deg_s, 3600.0),
            ("tilt_deg", l.tilt_deg, 60.0),
        ] {
            positive(&format!("limits.{key}"), value, most)?;
        }
        within("limits.base_offset_mm", l.base_offset_mm, 0.5, 500.0)?;
        within("limits.entry_stretch_mm", l.entry_stretch_mm, 0.02, 50.0)?;
        within("limits.roll_reserve_deg", l.roll_reserve_deg, 0.0, 180.0)?;
        let speed = self.run.insertion_speed_mm_s;
        agree(
            ("run.insertion_speed_mm_s", speed),
            ("limits.insertion_speed_mm_s", l.insertion_speed_mm_s),
        )?;
        agree(
            ("limits.base_offset_mm", l.base_offset_mm),
            (
                "supervisor.workspace_radius_mm",
                self.supervisor.workspace_radius_mm,
            ),
        )?;
        agree(
            ("limits.entry_stretch_mm", l.entry_stretch_mm),
            (
                "supervisor.tissue_stretch_mm",
                self.supervisor.tissue_stretch_mm,
            ),
        )
    }

    fn validate_estimator(&self) -> Result<(), Invalid> {
        let e = &self.estimator;
        within("estimator.stiffness_n_m2", e.stiffness_n_m2, 5e2, 3e5)?;
        within("estimator.wave_length_mm", e.wave_length_mm, 0.0, 500.0)?;
        for (key, value, most) in [
            ("stiffness_sigma", e.stiffness_sigma, 10.0),
            ("cut_angle_deg", e.cut_angle_deg, 20.0),
            ("disturbance_fade_mm", e.disturbance_fade_mm, 1e6),
            ("start_sigma_mm", e.start_sigma_mm, 100.0),
        ] {
            positive(&format!("estimator.{key}"), value, most)?;
        }
        // A finer path than the model of a shaft resolves costs time and conditions nothing.
        within("estimator.step_mm", e.step_mm, 0.5, 20.0)?;
        for (key, value, most) in [
            ("axial_load_n", e.axial_load_n, 2.0),
            ("cut_angle_sigma", e.cut_angle_sigma, 10.0),
            ("cut_across_sigma", e.cut_across_sigma, 10.0),
            ("bevel_walk", e.bevel_walk, 10.0),
            ("disturbance_walk_deg", e.disturbance_walk_deg, 90.0),
            ("start_disturbance_deg", e.start_disturbance_deg, 90.0),
            ("cut_noise_deg", e.cut_noise_deg, 90.0),
            ("direction_floor_deg", e.direction_floor_deg, 90.0),
            ("tip_compliance_deg_n", e.tip_compliance_deg_n, 100.0),
            (
                "tip_compliance_sigma_deg_n",
                e.tip_compliance_sigma_deg_n,
                100.0,
            ),
            ("tip_yielding_sigma", e.tip_yielding_sigma, 1.0),
            ("stiffness_period_s", e.stiffness_period_s, 1e9),
            ("base_shift_sigma_mm", e.base_shift_sigma_mm, 100.0),
            ("base_tilt_sigma_deg", e.base_tilt_sigma_deg, 90.0),
        ] {
            within(&format!("estimator.{key}"), value, 0.0, most)?;
        }
        Ok(())
    }

    fn validate_motion(&self) -> Result<(), Invalid> {
        let motion = &self.motion;
        within("motion.breathing_hz", motion.breathing_hz, 0.02, 2.0)?;
        within("motion.breathing_sigma", motion.breathing_sigma, 0.01, 1.0)?;
        within("motion.amplitude_mm", motion.amplitude_mm, 0.1, 50.0)?;
        within("motion.surface_ratio", motion.surface_ratio, -1.0, 2.0)?;
        within("motion.surface_sigma", motion.surface_sigma, 0.0, 10.0)?;
        within("motion.mean_walk_mm", motion.mean_walk_mm, 0.0, 10.0)?;
        within(
            "motion.amplitude_walk_mm",
            motion.amplitude_walk_mm,
            0.0,
            10.0,
        )?;
        within("motion.lead_ms", motion.lead_ms, 0.0, 500.0)
    }

    fn validate_arm(&self) -> Result<(), Invalid> {
        for value in self.arm.base_mm {
            within("arm.base_mm", value, -5000.0, 5000.0)?;
        }
        for value in self.arm.base_rpy_deg {
            within("arm.base_rpy_deg", value, -360.0, 360.0)?;
        }
        for value in self.arm.tip_mm {
            within("arm.tip_mm", value, -1000.0, 1000.0)?;
        }
        for value in self.arm.tip_rpy_deg {
            within("arm.tip_rpy_deg", value, -360.0, 360.0)?;
        }
        for (joint, value) in &self.arm.held_joints_mm {
            within(&format!("arm.held_joints_mm.{joint}"), *value, -1e4, 1e4)?;
        }
        for (joint, value) in &self.arm.held_joints_deg {
            within(&format!("arm.held_joints_deg.{joint}"), *value, -1e4, 1e4)?;
        }
        let speed = self.arm.joint_speed_deg_s;
        within("arm.joint_speed_deg_s", speed, 0.0, 720.0)
    }

    fn validate_ros(&self) -> Result<(), Invalid> {
        let ros = &self.ros;
        within("ros.period_ms", ros.period_ms, 1.0, 48.0)?;
        within("ros.late_ms", ros.late_ms, 20.0, 1000.0)?;
        within("ros.joint_states_hz", ros.joint_states_hz, 1.0, 1000.0)?;
        within("ros.poses_hz", ros.poses_hz, 0.1, ros.joint_states_hz)?;
        within("ros.markers_hz", ros.markers_hz, 0.1, ros.joint_states_hz)?;
        within("ros.marker_sigma_mm", ros.marker_sigma_mm, 1e-3, 10.0)?;
        let refused = |problem: String| {
            Err(Invalid {
                key: "ros.version".into(),
                problem,
            })
        };
        match ros.version {
            1 => {}
            2 if cfg!(feature = "ros2") => {}
            2 => return refused(rosbridge::NodeError::NoRos2.to_string()),
            other => return refused(format!("expected 1 or 2, found {other}")),
        }
        if ros.uri.is_empty() || ros.uri.starts_with("http://") {
            return Ok(());
        }
        Err(Invalid {
            key: "ros.uri".into(),
            problem: format!("expected http://HOST:PORT/, found `{}`", ros.uri),
        })
    }

    fn validate_limits(&self) -> Result<(), Invalid> {
        let supervisor = &self.supervisor;
        within(
            "supervisor.tissue_stretch_mm",
            supervisor.tissue_stretch_mm,
            0.05,
            50.0,
        )?;
        positive("supervisor.entry_force_n", supervisor.entry_force_n, 50.0)?;
        within(
            "supervisor.workspace_radius_mm",
            supervisor.workspace_radius_mm,
            1.0,
            1000.0,
        )?;
        let box_mm = supervisor
            .workspace_min_mm
            .iter()
            .zip(&supervisor.workspace_max_mm);
        for (&low, &high) in box_mm {
            let key = "supervisor.workspace_min_mm";
            within(key, low, -FARTHEST_MM, FARTHEST_MM)?;
            within(
                "supervisor.workspace_max_mm",
                high,
                -FARTHEST_MM,
                FARTHEST_MM,
            )?;
            agree((key, low), ("supervisor.workspace_max_mm", high))?;
        }
        within(
            "supervisor.image_hold_ms",
            supervisor.image_hold_ms,
            34.0,
            200.0,
        )?;
        within(
            "supervisor.image_stop_ms",
            supervisor.image_stop_ms,
            200.0,
            60_000.0,
        )?;
        within(
            "supervisor.image_age_ms",
            supervisor.image_age_ms,
            10.0,
            1000.0,
        )?;
        within(
            "supervisor.encoder_stop_ms",
            supervisor.encoder_stop_ms,
            20.0,
            1000.0,
        )?;
        within(
            "supervisor.dead_man_ms",
            supervisor.dead_man_ms,
            0.0,
            10_000.0,
        )
    }
}

//! The no-divergence campaign: laws, presets, start values and bad sensors thrown together, every
//! step of every run held against its limits.

pub mod confirm;
pub mod watch;
pub mod wide;

use std::fmt;

use hal::JointLimit;
use hal::telemetry::{Phase, Telemetry};
use nalgebra::Vector3;

use crate::config::{self, Config, ConfigError};
use crate::controls::Controls;
use crate::outcome::Ended;
use crate::rig::Rig;
use crate::run::{Observer, RunError, run};
use hybrid_control::LAW_NAMES;

/// Presets of the phantom that take part.
pub const PRESETS: [&str; 4] = ["paper", "harsh", "paper-compliant", "ideal"];
/// Start values of the stiffness \[N/m2\].
const STIFFNESS: [f64; 5] = [1e3, 3e3, 1e4, 3e4, 1e5];
/// Farthest that the true tip may stray from the nominal axis \[m\]: beyond the farthest target and
/// the largest uncontrolled miss together.
const FARTHEST: f64 = 0.04;
/// Largest difference between estimated and true tip in World at any step \[m\]: the robot's flaws
/// and its registration take up to 3.5 mm of it in `harsh`.
const LOST: f64 = 5e-3;
/// Slack of the workspace: arms brake within this \[m\], \[rad\].
const SLACK: (f64, f64) = (0.5e-3, 4e-3);

/// One run of the campaign.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Case {
    /// Number in the campaign.
    pub index: u64,
    /// Changes to the configuration.
    pub overrides: Vec<String>,
}

impl Case {
    /// The case of that number. Numbers near each other differ in law, preset and sensor; seeds
    /// are 5000 and up, which nothing else uses.
    pub fn new(index: u64) -> Self {
        let pick = |count: usize, stride: u64| -> usize {
            usize::try_from(index / stride % count as u64).unwrap_or_default()
        };
        let law = LAW_NAMES[pick(LAW_NAMES.len(), 1)];
        let preset = PRESETS[pick(PRESETS.len(), 7)];
        let stiffness = STIFFNESS[pick(STIFFNESS.len(), 3)];
        let offset = [0.0, 5.0, 10.0, 15.0][pick(4, 2)];
        let angle = (index * 77) % 360;
        let mut overrides = vec![
            format!("run.law={law}"),
            format!("run.phantom={preset}"),
            format!("run.seed={}", 5000 + index),
            // What follows spoils the fast sensor, so that has to close the loop.
            "run.sensor=shape".to_owned(),
            "run.check_reach=false".to_owned(),
            format!("estimator.stiffness_n_m2={stiffness:?}"),
            "target.kind=shifted".to_owned(),
            format!("target.offset_mm={offset:?}"),
            format!("target.angle_deg={angle}.0"),
        ];
        let noise = if preset == "harsh" {
            (0.5, 2.0)
        } else {
            (0.1, 0.2)
        };
        let sensor = pick(5, 5);
        if sensor == 0 || sensor == 4 {
            overrides.push(format!("phantom.sensor.noise_mm={:?}", noise.0));
            overrides.push(format!("phantom.sensor.direction_noise_deg={:?}", noise.1));
        }
        if sensor == 1 || sensor == 4 {
            overrides.push("phantom.sensor.drop_fraction=0.3".to_owned());
        }
        if sensor == 2 || sensor == 4 {
            overrides.push("phantom.sensor.latency_ms=100.0".to_owned());
        }
        if index.is_multiple_of(11) {
            overrides.extend(breathing().map(str::to_owned));
        }
        Self { index, overrides }
    }

    /// Its configuration.
    ///
    /// # Errors
    /// Never, while the overrides agree with the configuration's keys; a test holds that.
    pub fn config(&self) -> Result<Config, ConfigError> {
        config::load(None, &self.overrides)
    }
}

/// The breathing patient: lateral, affine, cos^4 at 0.2 Hz, 5 mm at 80 mm depth, 1 mm at the entry;
/// the target is a marker that the tissue carries.
pub fn breathing() -> [&'static str; 5] {
    [
        "target.kind=marker",
        "phantom.motion.breathing_mm=1.0",
        "phantom.motion.breathing_hz=0.2",
        "phantom.motion.breathing_direction=[1.0, 0.0, 0.0]",
        "phantom.motion.breathing_fade_1_m=-50.0",
    ]
}

/// What a case came to.
#[derive(Clone, Debug, PartialEq)]
pub struct Outcome {
    /// The verdict.
    pub ended: Ended,
    /// True error at the end \[mm\].
    pub error_mm: f64,
    /// Farthest that the estimated tip was from the true one while steering \[mm\].
    pub estimate_off_mm: f64,
    /// What went wrong, first of each kind.
    pub violations: Vec<Violation>,
}

/// Something that must not happen.
#[derive(Clone, Debug, PartialEq)]
pub struct Violation {
    /// What.
    pub kind: &'static str,
    /// When, in the run \[s\].
    pub at_s: f64,
    /// The value found, in SI units.
    pub value: f64,
}

impl fmt::Display for Violation {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {:.4} at {:.2} s", self.kind, self.value, self.at_s)
    }
}

/// Carries out one case.
///
/// # Errors
/// The run could not be carried out, which is a failure of the campaign too.
pub fn carry_out(config: &Config) -> Result<Outcome, RunError> {
    let mut rig = Rig::new(config)?;
    let joint_limits = rig.bearings.chain.limits().to_vec();
    let mut audit = Audit::new(config, joint_limits);
    let summary = run(config, &mut rig, &mut audit, &Controls::default())?;
    if matches!(summary.ended, Ended::TimedOut(_)) {
        audit.note("no verdict in time", summary.duration_s);
    }
    let error_mm = summary.true_error_mm.unwrap_or(f64::NAN);
    if !error_mm.is_finite() {
        audit.note("no true error", error_mm);
    }
    Ok(Outcome {
        ended: summary.ended,
        error_mm,
        estimate_off_mm: audit.farthest * 1e3,
        violations: audit.violations,
    })
}

/// Holds every step against its limits.
#[derive(Debug)]
pub struct Audit {
    config: Config,
    joint_limits: Vec<JointLimit>,
    now: f64,
    /// Largest difference between estimated and true tip \[m\].
    farthest: f64,
    /// What was found so far.
    pub violations: Vec<Violation>,
}

impl Audit {
    /// An audit of a run of `config` on an arm with these limits.
    pub fn new(config: &Config, joint_limits: Vec<JointLimit>) -> Self {
        Self {
            config: config.clone(),
            joint_limits,
            now: 0.0,
            farthest: 0.0,
            violations: Vec::new(),
        }
    }

    fn note(&mut self, kind: &'static str, value: f64) {
        if self.violations.iter().all(|v| v.kind != kind) {
            self.violations.push(Violation {
                kind,
                at_s: self.now,
                value,
            });
        }
    }

    /// Beyond the bound, or not a number.
    fn hold(&mut self, kind: &'static str, value: f64, bound: f64) {
        if value.is_nan() || value > bound {
            self.note(kind, value);
        }
    }

    fn speeds(&mut self, t: &Telemetry) {
        let limits = self.config.limits.clone();
        let axis = t.world_from_base.rotate(&Vector3::z());
        let (v, w) = (&t.base_twist.linear, &t.base_twist.angular);
        let (along, spin) = (axis.dot(v), axis.dot(w));
        let slack = 1.0 + 1e-6;
        self.hold(
            "insertion speed",
            along.abs(),
            limits.insertion_speed_mm_s * 1e-3 * slack,
        );
        self.hold(
            "lateral speed",
            (v - axis * along).norm(),
            limits.lateral_speed_mm_s * 1e-3 * slack,
        );
        self.hold(
            "tilt speed",
            (w - axis * spin).norm(),
            limits.tilt_speed_deg_s.to_radians() * slack,
        );
        self.hold(
            "spin speed",
            spin.abs(),
            limits.spin_speed_deg_s.to_radians() * slack,
        );
    }

    fn joints(&mut self, t: &Telemetry) {
        for i in 0..self.joint_limits.len() {
            let limit = self.joint_limits[i];
            let (q, rate) = (t.joints[i], t.joint_rates[i]);
            let last = i + 1 == self.joint_limits.len();
            let kind = if last { "joint 6" } else { "joint position" };
            self.hold(kind, (q - limit.upper).max(limit.lower - q), 0.0);
            self.hold("joint rate", rate.abs(), limit.velocity * (1.0 + 1e-9));
        }
    }

    fn places(&mut self, t: &Telemetry) {
        let (entry, inward) = (self.config.entry(), self.config.inward());
        let across = |p: &Vector3<f64>| {
            let out = p - entry.coords;
            (out - inward.into_inner() * inward.dot(&out)).norm()
        };
        let limits = self.config.limits.clone();
        let tilt = t.world_from_base.rotate(&Vector3::z()).angle(&inward);
        self.hold(
            "tilt of the base",
            tilt,
            limits.tilt_deg.to_radians() + SLACK.1,
        );
        self.hold(
            "workspace",
            across(&t.world_from_base.origin().coords()),
            limits.base_offset_mm * 1e-3 + SLACK.0,
        );
        self.hold("stiffness", t.model.stiffness, 3e5 * (1.0 + 1e-9));
        self.hold("stiffness below", 5e2 / t.model.stiffness, 1.0 + 1e-9);
        if let Some(truth) = &t.truth {
            self.hold("tip astray", across(&truth.tip), FARTHEST);
            let lost = (t.world_from_tip.origin().coords() - truth.tip).norm();
            // Truth is of the last exposure; the estimate is of now.
            if t.phase == Phase::Steering {
                self.farthest = self.farthest.max(lost);
                self.hold("tip lost", lost, LOST);
            }
        }
    }
}

impl Observer for Audit {
    fn step(&mut self, t: &Telemetry) {
        self.now = t.stamp.as_secs();
        self.speeds(t);
        self.joints(t);
        self.places(t);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cases_are_configurations_and_cover_laws_presets_and_sensors() {
        let mut seen = std::collections::BTreeSet::new();
        for index in 0..1000 {
            let config = Case::new(index).config().unwrap();
            assert_eq!(config.run.seed, 5000 + index);
            assert_eq!(config.run.sensor, config::SensorKind::Shape);
            seen.insert((
                config.run.law,
                config.run.phantom,
                Case::new(index).overrides.len(),
            ));
        }
        // Seven laws, three presets, four numbers of overrides at least.
        assert!(seen.len() >= 7 * 3 * 4, "{}", seen.len());
    }
}

//! Settings of the driver.

use std::time::Duration;

use hal::JointLimit;

use super::wire::steer;

/// What the controller's program speaks.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dialect {
    /// The public V+ program of 2018: positioning only. A segment runs at full speed and cannot
    /// be stopped inside; not for smooth insertion.
    Adept2018,
    /// Our own program: timed points, watchdog, braking stop. Untested on hardware.
    Steer,
}

/// Settings of the driver; the defaults are those of a Viper S650.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// Name of the device in messages and errors.
    pub name: String,
    /// Host name or address of the controller.
    pub host: String,
    /// Port for points, stops and their answers.
    pub motion_port: u16,
    /// Port of the feedback.
    pub state_port: u16,
    /// What the controller speaks.
    pub dialect: Dialect,
    /// Bytes to ignore after connecting, on each port: 0 or 4.
    pub preamble: usize,
    /// Names of the joints, base to flange.
    pub joint_names: Vec<String>,
    /// Limits of the joints, base to flange.
    pub limits: Vec<JointLimit>,
    /// Time between points, 8 to 100 ms.
    pub period: Duration,
    /// How long to wait for what.
    pub timing: Timing,
    /// Which deviations to accept.
    pub tolerances: Tolerances,
    /// Seed of the jitter of reconnections.
    pub seed: u64,
}

/// How long to wait for what.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Timing {
    /// An older command ramps to zero.
    pub command_hold: Duration,
    /// An older command faults.
    pub command_fault: Duration,
    /// Older feedback stops and faults.
    pub feedback: Duration,
    /// A longer wait for an answer faults.
    pub acknowledgement: Duration,
    /// A longer wait for a connection is given up.
    pub connect: Duration,
    /// A link silent for longer is torn down and made anew.
    pub silence: Duration,
    /// First wait before connecting again; doubles with every failure.
    pub backoff_least: Duration,
    /// Longest wait before connecting again.
    pub backoff_most: Duration,
    /// An arm still moving after a stop for longer faults.
    pub stop: Duration,
    /// The `steer` controller brakes after this time without a point.
    pub controller_watchdog: Duration,
}

/// Which deviations to accept.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerances {
    /// Distance kept from the joints' limits \[rad\].
    pub limit_margin: f64,
    /// Between the first set point and the arm \[rad\].
    pub start: f64,
    /// Between set points and the arm \[rad\].
    pub tracking: f64,
    /// Samples beyond `tracking` in a row that fault.
    pub tracking_samples: u32,
    /// Motion of an arm that has no command \[rad\].
    pub rest: f64,
    /// Least bend of joint 5 to enable \[rad\]; 0 allows any (for moving single joints).
    pub wrist_bend: f64,
    /// Between the controller's limits and ours \[rad, rad/s\].
    pub limits: f64,
}

impl Default for Timing {
    fn default() -> Self {
        Self {
            command_hold: Duration::from_millis(48),
            command_fault: Duration::from_millis(200),
            feedback: Duration::from_millis(350),
            acknowledgement: Duration::from_millis(500),
            connect: Duration::from_secs(1),
            silence: Duration::from_secs(1),
            backoff_least: Duration::from_millis(100),
            backoff_most: Duration::from_secs(5),
            stop: Duration::from_secs(3),
            controller_watchdog: Duration::from_millis(100),
        }
    }
}

impl Default for Tolerances {
    fn default() -> Self {
        Self {
            limit_margin: 0.5_f64.to_radians(),
            start: 0.01,
            tracking: 0.05,
            tracking_samples: 3,
            rest: 0.01,
            wrist_bend: 5_f64.to_radians(),
            limits: 0.5_f64.to_radians(),
        }
    }
}

impl Config {
    /// A Viper S650 behind `host`, at the dialect's usual ports.
    pub fn viper(host: impl Into<String>, dialect: Dialect) -> Self {
        // `steer` has ports of its own, so that no frame of it reaches the 2018 program by
        // mistake.
        let (motion_port, state_port) = match dialect {
            Dialect::Adept2018 => (11_000, 11_002),
            Dialect::Steer => (11_010, 11_012),
        };
        Self {
            name: "viper".into(),
            host: host.into(),
            motion_port,
            state_port,
            dialect,
            preamble: 0,
            joint_names: (1..=6).map(|joint| format!("joint_{joint}")).collect(),
            limits: viper_limits(),
            period: Duration::from_millis(16),
            timing: Timing::default(),
            tolerances: Tolerances::default(),
            seed: 0,
        }
    }

    /// Checks the ranges.
    ///
    /// # Errors
    /// The first setting out of range.
    pub fn validate(&self) -> Result<(), ConfigError> {
        let joints = self.limits.len();
        if joints != steer::JOINTS || self.joint_names.len() != joints {
            return Err(ConfigError::Joints {
                limits: joints,
                names: self.joint_names.len(),
            });
        }
        for (joint, limit) in self.limits.iter().enumerate() {
            let positive = [limit.velocity, limit.acceleration, limit.jerk];
            let span = limit.upper - limit.lower;
            if positive.iter().any(|x| !x.is_finite() || *x <= 0.0)
                || !span.is_finite()
                || span <= 2.0 * self.tolerances.limit_margin
            {
                return Err(ConfigError::Limit { joint });
            }
        }
        if !(Duration::from_millis(8)..=Duration::from_millis(100)).contains(&self.period) {
            return Err(ConfigError::Period {
                period_ms: self.period.as_secs_f64() * 1e3,
            });
        }
        if !matches!(self.preamble, 0 | 4) {
            return Err(ConfigError::Preamble {
                bytes: self.preamble,
            });
        }
        let timing = &self.timing;
        if timing.command_hold >= timing.command_fault
            || timing.backoff_least.is_zero()
            || timing.backoff_least > timing.backoff_most
        {
            return Err(ConfigError::Timing);
        }
        let tolerances = &self.tolerances;
        let values = [
            tolerances.limit_margin,
            tolerances.start,
            tolerances.tracking,
            tolerances.rest,
            tolerances.wrist_bend,
            tolerances.limits,
        ];
        if values.iter().any(|x| !x.is_finite() || *x < 0.0) {
            return Err(ConfigError::Tolerance);
        }
        Ok(())
    }
}

/// A setting out of range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum ConfigError {
    /// Not six joints, or not as many names as limits.
    #[error("{limits} joint limits and {names} joint names where 6 are needed")]
    Joints {
        /// Number of limits.
        limits: usize,
        /// Number of names.
        names: usize,
    },
    /// A joint's limits make no range, or are not positive numbers.
    #[error("limits of joint {joint} (from 0) make no range")]
    Limit {
        /// Joint, from 0.
        joint: usize,
    },
    /// Period out of range.
    #[error("period of {period_ms} ms is not between 8 and 100 ms")]
    Period {
        /// The period \[ms\].
        period_ms: f64,
    },
    /// Preamble out of range.
    #[error("preamble of {bytes} bytes; only 0 and 4 are known")]
    Preamble {
        /// The preamble.
        bytes: usize,
    },
    /// Times in the wrong order.
    #[error("command_hold must be below command_fault, and 0 < backoff_least <= backoff_most")]
    Timing,
    /// A tolerance that is negative or not a number.
    #[error("tolerances must be finite and not negative")]
    Tolerance,
}

/// Published position and speed limits of the Viper S650. Its accelerations and jerks are not
/// published: these are conservative assumptions.
pub fn viper_limits() -> Vec<JointLimit> {
    let degrees: [[f64; 3]; 6] = [
        [-170.0, 170.0, 328.0],
        [-190.0, 45.0, 300.0],
        [-29.0, 256.0, 375.0],
        [-190.0, 190.0, 375.0],
        [-120.0, 120.0, 375.0],
        [-360.0, 360.0, 600.0],
    ];
    let limit = |(joint, [lower, upper, speed]): (usize, [f64; 3])| {
        let (acceleration, jerk) = if joint == 5 {
            (40.0, 400.0)
        } else {
            (4.0, 40.0)
        };
        JointLimit {
            lower: lower.to_radians(),
            upper: upper.to_radians(),
            velocity: speed.to_radians(),
            acceleration,
            jerk,
        }
    };
    degrees.into_iter().enumerate().map(limit).collect()
}

//! What is served to other programs, and what they measure.

use nalgebra::Vector3;

use super::within;
use crate::config::{Config, FARTHEST_MM, Invalid, RosClock, SensorKind, TrackerSource};

/// A name that messages carry.
fn device(key: &str, name: &str) -> Result<(), Invalid> {
    if (1..=20).contains(&name.len()) && name.chars().all(|c| c.is_ascii_graphic()) {
        return Ok(());
    }
    Err(Invalid {
        key: key.into(),
        problem: format!("expected 1 to 20 letters, digits and signs, found `{name}`"),
    })
}

impl Config {
    pub(super) fn validate_remote(&self) -> Result<(), Invalid> {
        let igtl = &self.igtl;
        within("igtl.poses_hz", igtl.poses_hz, 0.1, 200.0)?;
        within("igtl.lines_hz", igtl.lines_hz, 0.1, 200.0)?;
        within("igtl.images_hz", igtl.images_hz, 0.1, 100.0)?;
        let live = &self.live;
        within("live.poses_hz", live.poses_hz, 0.1, 200.0)?;
        within("live.lines_hz", live.lines_hz, 0.1, 200.0)?;
        within("live.images_hz", live.images_hz, 0.1, 100.0)?;
        device("igtl.target_device", &igtl.target_device)?;
        self.validate_tracker()
    }

    fn validate_tracker(&self) -> Result<(), Invalid> {
        let tracker = &self.tracker;
        device("tracker.device", &tracker.device)?;
        for value in tracker.position_mm {
            within("tracker.position_mm", value, -FARTHEST_MM, FARTHEST_MM)?;
        }
        for value in tracker.rpy_deg {
            within("tracker.rpy_deg", value, -360.0, 360.0)?;
        }
        for value in tracker.tip_mm {
            within("tracker.tip_mm", value, -100.0, 100.0)?;
        }
        for value in tracker.axis {
            within("tracker.axis", value, -1.0, 1.0)?;
        }
        within("tracker.sigma_mm", tracker.sigma_mm, 0.01, 10.0)?;
        within(
            "tracker.axis_sigma_mrad",
            tracker.axis_sigma_mrad,
            0.1,
            300.0,
        )?;
        within("tracker.delay_ms", tracker.delay_ms, 0.0, 500.0)?;
        let em = &self.em;
        within("em.bias_mm", em.bias_mm, 0.0, 10.0)?;
        within("em.axis_bias_mrad", em.axis_bias_mrad, 0.0, 300.0)?;
        within("em.bias_length_mm", em.bias_length_mm, 1.0, 1000.0)?;
        let refused = |key: &str, problem: &str| {
            Err(Invalid {
                key: key.to_owned(),
                problem: problem.to_owned(),
            })
        };
        if Vector3::from(tracker.axis).norm() < 0.1 {
            return refused("tracker.axis", "expected a direction, found none");
        }
        if !tracker.is_used() {
            return Ok(());
        }
        if self.run.sensor != SensorKind::Em {
            return refused(
                "tracker.source",
                "a tracker closes the loop with run.sensor = \"em\" only",
            );
        }
        if tracker.source == TrackerSource::Clients && !self.igtl.serve {
            return refused(
                "tracker.source",
                "\"clients\" have nowhere to connect to: expected igtl.serve = true (run --igtl)",
            );
        }
        if tracker
            .device
            .eq_ignore_ascii_case(&self.igtl.target_device)
        {
            return refused(
                "tracker.device",
                "expected another name than igtl.target_device",
            );
        }
        if self.has_node() && self.ros.clock == RosClock::Simulated {
            return refused(
                "ros.clock",
                "a tracker measures on the wall clock: expected \"wall\"",
            );
        }
        Ok(())
    }
}

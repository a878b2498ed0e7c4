//! How far a measured tip lies from the true one, in the frame in which targets are given.
//!
//! A law cannot see such a bias; what it steers to is off by as much. In simulation it can be
//! measured, exposure by exposure.

use std::collections::VecDeque;

use hal::frame::{LeftCamera, World};
use hal::telemetry::{Telemetry, Tracking};
use hal::{Stamp, Transform};
use nalgebra::Vector3;

use crate::observer::Observer;

/// Truths kept: a second at the rate of images and more.
const KEPT: usize = 64;

/// Compares measured tips with the truth at their exposures, of a run with hidden truth.
#[derive(Clone, Debug)]
pub struct TipBias {
    stereo_from_world: Transform<LeftCamera, World>,
    window: f64,
    truths: VecDeque<(Stamp, Vector3<f64>)>,
    differences: VecDeque<(Stamp, Vector3<f64>)>,
    newest: Option<Stamp>,
}

impl TipBias {
    /// Looks at the last `window` \[s\] of a run whose measurements are in the frame that truly
    /// lies at `stereo_from_world`.
    pub const fn new(stereo_from_world: Transform<LeftCamera, World>, window: f64) -> Self {
        Self {
            stereo_from_world,
            window,
            truths: VecDeque::new(),
            differences: VecDeque::new(),
            newest: None,
        }
    }

    /// Mean of measured less true tip over the window, in the stereo frame \[m\]; nothing where
    /// nothing was measured.
    pub fn mean(&self) -> Option<Vector3<f64>> {
        let count = self.differences.len();
        (count > 0).then(|| {
            self.differences
                .iter()
                .map(|(_, difference)| difference)
                .sum::<Vector3<f64>>()
                / count as f64
        })
    }

    /// The true tip at `stamp`, linear between the states around it.
    fn truth_at(&self, stamp: Stamp) -> Option<Vector3<f64>> {
        let after = self.truths.iter().position(|(at, _)| *at >= stamp)?;
        let (late, to) = self.truths.get(after)?;
        let (early, from) = self.truths.get(after.checked_sub(1)?)?;
        let share = stamp.secs_since(*early) / late.secs_since(*early);
        Some(from + (to - from) * share)
    }
}

impl Observer for TipBias {
    fn step(&mut self, telemetry: &Telemetry) {
        let Some(truth) = &telemetry.truth else {
            return;
        };
        if self
            .truths
            .back()
            .is_none_or(|(last, _)| *last < truth.stamp)
        {
            if self.truths.len() == KEPT {
                self.truths.pop_front();
            }
            self.truths.push_back((truth.stamp, truth.tip));
        }
        let (Some(stamp), Some(tip)) = (telemetry.image_stamp, &telemetry.measured_tip) else {
            return;
        };
        if self.newest == Some(stamp) || telemetry.tracking != Tracking::Tracked {
            return;
        }
        self.newest = Some(stamp);
        if let Some(truth) = self.truth_at(stamp) {
            let seen = self.stereo_from_world.isometry() * nalgebra::Point3::from(truth);
            self.differences
                .push_back((stamp, tip.position.coords() - seen.coords));
        }
        while let Some((first, _)) = self.differences.front()
            && stamp.secs_since(*first) > self.window
        {
            self.differences.pop_front();
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::{Config, SensorKind, TargetKind};
    use crate::controls::Controls;
    use crate::rig::Rig;
    use crate::run::run;

    /// The bias found with a sensor's bias of so many mm, 1 sigma.
    fn found(bias_mm: f64) -> Vector3<f64> {
        let mut config = Config::default();
        config.run.sensor = SensorKind::Shape;
        config.target.kind = TargetKind::Aligned;
        config.target.depth_mm = 15.0;
        let mut sensor = toml::Table::new();
        for (key, value) in [("noise_mm", 0.02), ("bias_mm", bias_mm)] {
            sensor.insert(key.into(), value.into());
        }
        config.phantom.insert("sensor".into(), sensor.into());
        let mut rig = Rig::new(&config).unwrap();
        let truth = rig.world.as_ref().unwrap().stereo_from_world();
        let mut bias = TipBias::new(truth, 5.0);
        run(&config, &mut rig, &mut bias, &Controls::default()).unwrap();
        bias.mean().unwrap()
    }

    #[test]
    fn a_bias_of_the_sensor_is_found_and_nothing_else() {
        // Noise of 0.02 mm over a hundred and more exposures.
        let small = 0.01e-3;
        let [none, one, two] = [0.0, 0.2, 0.4].map(found);
        assert!(none.norm() < small, "{none}");
        assert!(one.norm() > 0.05e-3, "{one}");
        assert!((two - one * 2.0).norm() < 2.0 * small, "{one} {two}");
    }
}

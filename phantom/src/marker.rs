//! A marker: a material point of the tissue, and the sensor that sees it.
//!
//! The marker moves with the tissue (breathing, drift); the needle does not push it, because
//! the bed is local.

use core::time::Duration;
use std::collections::VecDeque;

use hal::frame::{LeftCamera, World};
use hal::{Position, Stamp, Transform};
use nalgebra::{Point3, Vector3};
use rand_chacha::ChaCha8Rng;

use crate::draw::{Purpose, normal, stream, uniform};
use crate::settings::SensorSettings;

/// A measurement of the marker.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SensedMarker {
    /// Instant of the exposure.
    pub stamp: Stamp,
    /// Number of the exposure since the start; dropped ones leave gaps.
    pub sequence: u64,
    /// Where the marker seemed to be \[m\].
    pub position: Position<LeftCamera>,
    /// Standard deviation of the noise per axis \[m\]; the bias is not in it.
    pub sigma: f64,
}

/// A sensor of a marker's place, with the rate, noise, bias, latency and drops of the fast sensor
/// in random streams of its own.
#[derive(Clone, Debug)]
pub(crate) struct MarkerSensor {
    settings: SensorSettings,
    left_from_world: Transform<LeftCamera, World>,
    noise: ChaCha8Rng,
    drops: ChaCha8Rng,
    bias: Vector3<f64>,
    in_flight: VecDeque<(Stamp, SensedMarker)>,
}

impl MarkerSensor {
    /// The sensor of run `seed`; it reports in the stereo frame at `left_from_world`.
    pub(crate) fn new(
        settings: &SensorSettings,
        left_from_world: &Transform<LeftCamera, World>,
        seed: u64,
    ) -> Self {
        let mut bias = stream(seed, Purpose::MarkerBias);
        Self {
            left_from_world: *left_from_world,
            noise: stream(seed, Purpose::Marker),
            drops: stream(seed, Purpose::MarkerDrops),
            bias: Vector3::from_fn(|_, _| normal(&mut bias)) * (settings.bias_mm * 1e-3),
            in_flight: VecDeque::new(),
            settings: settings.clone(),
        }
    }

    /// Looks at the marker, in truth at `world` \[m\], in the exposure `sequence` at `stamp`.
    pub(crate) fn expose(&mut self, world: &Vector3<f64>, stamp: Stamp, sequence: u64) {
        if uniform(&mut self.drops) < self.settings.drop_fraction {
            return;
        }
        let sigma = self.settings.noise_mm * 1e-3;
        let noise = Vector3::from_fn(|_, _| normal(&mut self.noise)) * sigma;
        let left = self.left_from_world * Position::<World>::new(Point3::from(*world));
        let latency = Duration::from_secs_f64(self.settings.latency_ms * 1e-3);
        let sensed = SensedMarker {
            stamp,
            sequence,
            position: Position::new(Point3::from(left.coords() + self.bias + noise)),
            sigma,
        };
        self.in_flight.push_back((stamp + latency, sensed));
    }

    /// The newest measurement delivered by `now` and not yet returned.
    pub(crate) fn poll(&mut self, now: Stamp) -> Option<SensedMarker> {
        let mut newest = None;
        while self.in_flight.front().is_some_and(|(due, _)| *due <= now) {
            newest = self.in_flight.pop_front().map(|(_, sensed)| sensed);
        }
        newest
    }
}

//! The fast sensor: the needle's shape with noise, latency and drops, without images.

use core::time::Duration;
use std::collections::VecDeque;

use hal::frame::{LeftCamera, World};
use hal::{Position, SensedPoint, SensedShape, SensedTip, Stamp, Transform};
use nalgebra::{Matrix3, Point3, Unit, Vector3};
use rand_chacha::ChaCha8Rng;

use crate::draw::{Purpose, normal, stream, uniform};
use crate::em::Coil;
use crate::settings::{EmSettings, SensorSettings};
use crate::view::NeedleView;

/// A sensor of needle shapes over the truth.
#[derive(Clone, Debug)]
pub(crate) struct FastSensor {
    settings: SensorSettings,
    left_from_world: Transform<LeftCamera, World>,
    noise: ChaCha8Rng,
    drops: ChaCha8Rng,
    bias: Vector3<f64>,
    sequence: u64,
    in_flight: VecDeque<(Stamp, SensedShape)>,
    /// What sees the tip alone, in the place of the shape.
    coil: Option<Coil>,
}

impl FastSensor {
    /// The sensor of run `seed`; it reports in the stereo frame at `left_from_world`.
    pub(crate) fn new(
        settings: &SensorSettings,
        left_from_world: &Transform<LeftCamera, World>,
        seed: u64,
    ) -> Self {
        let mut bias = stream(seed, Purpose::SensorBias);
        Self {
            left_from_world: *left_from_world,
            noise: stream(seed, Purpose::Sensor),
            drops: stream(seed, Purpose::SensorDrops),
            bias: Vector3::from_fn(|_, _| normal(&mut bias)) * (settings.bias_mm * 1e-3),
            sequence: 0,
            in_flight: VecDeque::new(),
            coil: None,
            settings: settings.clone(),
        }
    }

    /// The electromagnetic sensor of run `seed`: a coil in the tip, which shows no shaft.
    pub(crate) fn em(
        settings: &EmSettings,
        left_from_world: &Transform<LeftCamera, World>,
        seed: u64,
    ) -> Self {
        let timing = SensorSettings {
            rate_hz: settings.rate_hz,
            latency_ms: settings.latency_ms,
            drop_fraction: settings.drop_fraction,
            ..SensorSettings::default()
        };
        Self {
            coil: Some(Coil::new(settings, seed)),
            ..Self::new(&timing, left_from_world, seed)
        }
    }

    /// What a distorted field adds to a tip measured at `place`, World \[m\]; nothing where there is
    /// no such field.
    pub(crate) fn bias_at(&self, place: &Vector3<f64>) -> Option<Vector3<f64>> {
        Some(self.coil.as_ref()?.distortion().of_place(place))
    }

    /// When the next exposure is due: 0, 1, 2 ... over the rate.
    pub(crate) fn next_exposure(&self) -> Stamp {
        Stamp::from_secs(self.sequence as f64 / self.settings.rate_hz)
    }

    /// Number of the next exposure.
    pub(crate) fn sequence(&self) -> u64 {
        self.sequence
    }

    /// Looks at the needle at the next exposure, unless that one is dropped.
    pub(crate) fn expose(&mut self, needle: &NeedleView) {
        let stamp = self.next_exposure();
        let sequence = self.sequence;
        self.sequence += 1;
        if uniform(&mut self.drops) < self.settings.drop_fraction {
            return;
        }
        let latency = Duration::from_secs_f64(self.settings.latency_ms * 1e-3);
        let shape = match &mut self.coil {
            Some(coil) => coil.sense(needle, &self.left_from_world, stamp, sequence),
            None => self.sense(needle, stamp, sequence),
        };
        self.in_flight.push_back((stamp + latency, shape));
    }

    /// The newest shape delivered by `now` and not yet returned.
    pub(crate) fn poll(&mut self, now: Stamp) -> Option<SensedShape> {
        let mut newest = None;
        while self.in_flight.front().is_some_and(|(due, _)| *due <= now) {
            newest = self.in_flight.pop_front().map(|(_, shape)| shape);
        }
        newest
    }

    fn sense(&mut self, needle: &NeedleView, stamp: Stamp, sequence: u64) -> SensedShape {
        let sigma = self.settings.noise_mm * 1e-3;
        let spacing = self.settings.spacing_mm * 1e-3;
        let visible = needle.inserted_length();
        let mut points = Vec::new();
        let mut along = 0.0;
        // The tip itself is reported apart.
        while along < visible - 1e-9 {
            if let Some(point) = needle.point_at(needle.entry_arc + along) {
                let position = self.measure(&point, sigma);
                points.push(SensedPoint { position, sigma });
            }
            along += spacing;
        }
        let tip = needle.world_from_tip.origin().coords();
        let position = self.measure(&tip, sigma);
        let direction_sigma = self.settings.direction_noise_deg.to_radians();
        let axis = self
            .left_from_world
            .rotate(&needle.world_from_tip.rotate(&Vector3::z()));
        let noise = Vector3::from_fn(|_, _| normal(&mut self.noise)) * direction_sigma;
        let across = noise - axis * axis.dot(&noise);
        SensedShape {
            stamp,
            sequence,
            points,
            tip: SensedTip {
                position,
                covariance: Matrix3::from_diagonal_element(sigma * sigma),
                direction: Unit::new_normalize(axis + across),
                direction_sigma,
            },
        }
    }

    fn measure(&mut self, world: &Vector3<f64>, sigma: f64) -> Position<LeftCamera> {
        let noise = Vector3::from_fn(|_, _| normal(&mut self.noise)) * sigma;
        let left = self.left_from_world * Position::<World>::new(Point3::from(*world));
        Position::new(Point3::from(left.coords() + self.bias + noise))
    }
}

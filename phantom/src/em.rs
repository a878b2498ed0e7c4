//! An electromagnetic sensor in the needle's tip: place and axis of a coil, distorted by the field.
//!
//! Five degrees of freedom, as a coil has them: what the needle turns by is not seen, nor any of its
//! shaft. After registration a field's distortion is left that is large against the noise and slow in
//! space; it is drawn as a Gaussian field with squared-exponential correlation, for the place and for
//! the axis apart.

use hal::frame::{LeftCamera, World};
use hal::{Position, SensedShape, SensedTip, Stamp, Transform};
use nalgebra::{Matrix3, Point3, Unit, Vector3};
use rand_chacha::ChaCha8Rng;

use crate::draw::{Purpose, normal, stream, uniform};
use crate::settings::EmSettings;
use crate::view::NeedleView;

/// Waves that make a field: with 64 its values are normal to a tenth of their standard deviation.
const WAVES: usize = 64;

/// One wave of the distortion.
#[derive(Clone, Copy, Debug)]
struct Wave {
    /// Wave vector \[1/m\].
    vector: Vector3<f64>,
    phase: f64,
    /// Amplitudes of the place \[m\] and of the axis \[rad\].
    place: Vector3<f64>,
    axis: Vector3<f64>,
}

/// What the field does to measurements, by place in World.
#[derive(Clone, Debug)]
pub(crate) struct Distortion(Vec<Wave>);

impl Distortion {
    /// The distortion of run `seed`.
    pub(crate) fn new(settings: &EmSettings, seed: u64) -> Self {
        let mut rng = stream(seed, Purpose::Distortion);
        let scale = (2.0 / WAVES as f64).sqrt();
        let place = settings.distortion_mm * 1e-3 * scale;
        let axis = settings.axis_distortion_mrad * 1e-3 * scale;
        let length = settings.distortion_length_mm * 1e-3;
        let mut draw = |factor: f64| Vector3::from_fn(|_, _| normal(&mut rng)) * factor;
        let mut waves: Vec<Wave> = (0..WAVES)
            .map(|_| Wave {
                vector: draw(1.0 / length),
                phase: 0.0,
                place: draw(place),
                axis: draw(axis),
            })
            .collect();
        for wave in &mut waves {
            wave.phase = uniform(&mut rng) * core::f64::consts::TAU;
        }
        Self(waves)
    }

    /// Error of a measured place at `place` (World) \[m\].
    pub(crate) fn of_place(&self, place: &Vector3<f64>) -> Vector3<f64> {
        self.sum(place, |wave| wave.place)
    }

    /// Error of a measured axis at `place` (World) \[rad\].
    pub(crate) fn of_axis(&self, place: &Vector3<f64>) -> Vector3<f64> {
        self.sum(place, |wave| wave.axis)
    }

    fn sum(&self, place: &Vector3<f64>, of: impl Fn(&Wave) -> Vector3<f64>) -> Vector3<f64> {
        let wave = |w: &Wave| of(w) * (w.vector.dot(place) + w.phase).cos();
        self.0.iter().map(wave).sum()
    }
}

/// A coil in the tip.
#[derive(Clone, Debug)]
pub(crate) struct Coil {
    settings: EmSettings,
    distortion: Distortion,
    noise: ChaCha8Rng,
}

impl Coil {
    pub(crate) fn new(settings: &EmSettings, seed: u64) -> Self {
        Self {
            distortion: Distortion::new(settings, seed),
            noise: stream(seed, Purpose::Coil),
            settings: settings.clone(),
        }
    }

    pub(crate) const fn distortion(&self) -> &Distortion {
        &self.distortion
    }

    /// The tip as the coil shows it: the coil's axis is drawn on to the tip, which a bent needle
    /// leaves.
    pub(crate) fn sense(
        &mut self,
        needle: &NeedleView,
        left_from_world: &Transform<LeftCamera, World>,
        stamp: Stamp,
        sequence: u64,
    ) -> SensedShape {
        let setback = self.settings.setback_mm * 1e-3;
        let (sigma, axis_sigma) = (
            self.settings.noise_mm * 1e-3,
            self.settings.axis_noise_mrad * 1e-3,
        );
        let tip = needle.world_from_tip.origin().coords();
        let tip_axis = needle.world_from_tip.rotate(&Vector3::z());
        let length = needle.spacing() * needle.centreline.len().saturating_sub(1) as f64;
        let arc = length - setback;
        let ends = [arc - needle.spacing(), arc].map(|at| needle.point_at(at));
        let (coil, axis) = match ends {
            [Some(behind), Some(coil)] if setback > 0.0 && coil != behind => {
                (coil, (coil - behind).normalize())
            }
            _ => (tip - tip_axis * setback, tip_axis),
        };
        let noise = |rng: &mut ChaCha8Rng| Vector3::from_fn(|_, _| normal(rng));
        let place = coil + self.distortion.of_place(&coil) + noise(&mut self.noise) * sigma;
        let turn = self.distortion.of_axis(&coil) + noise(&mut self.noise) * axis_sigma;
        let axis = Unit::new_normalize(axis + turn - axis * axis.dot(&turn));
        let place = place + axis.into_inner() * setback;
        let direction = left_from_world.rotate(&axis);
        // As a tracker states it: its noise, and what its field is known to do.
        let known = sigma.hypot(self.settings.stated_mm * 1e-3);
        SensedShape {
            stamp,
            sequence,
            points: Vec::new(),
            tip: SensedTip {
                position: *left_from_world * Position::<World>::new(Point3::from(place)),
                covariance: Matrix3::from_diagonal_element(known * known),
                direction: Unit::new_normalize(direction),
                direction_sigma: axis_sigma.hypot(self.settings.stated_mrad * 1e-3),
            },
        }
    }
}

/// A tip measured in air, by the median of several measurements.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct InAir {
    /// Where it was measured, World \[m\].
    pub tip: Vector3<f64>,
    /// Its axis as measured.
    pub axis: Unit<Vector3<f64>>,
    /// Standard deviation of a single measurement, World's axes \[m\].
    pub deviation: Vector3<f64>,
}

/// What the sensor of run `seed` shows of a straight needle that is held still in air with its tip at
/// each of `tips` (World) and its axis along `axis`, `samples` times each: the field is that of the run, the
/// noise another.
pub fn in_air<'a>(
    settings: &EmSettings,
    seed: u64,
    tips: impl IntoIterator<Item = &'a Vector3<f64>>,
    axis: &Unit<Vector3<f64>>,
    samples: usize,
) -> Vec<InAir> {
    let field = Distortion::new(settings, seed);
    let mut rng = stream(seed, Purpose::InAir);
    let setback = axis.into_inner() * (settings.setback_mm * 1e-3);
    let mut measure = |tip: &Vector3<f64>| {
        let coil = tip - setback;
        let mut noise = |sigma: f64| Vector3::from_fn(|_, _| normal(&mut rng)) * sigma;
        let mut seen = Vec::with_capacity(samples);
        for _ in 0..samples {
            let turn = field.of_axis(&coil) + noise(settings.axis_noise_mrad * 1e-3);
            let shown = Unit::new_normalize(axis.into_inner() + turn - **axis * axis.dot(&turn));
            let place = coil + field.of_place(&coil) + noise(settings.noise_mm * 1e-3);
            seen.push((place + *shown * (settings.setback_mm * 1e-3), shown));
        }
        let count = seen.len().max(1) as f64;
        let mean = seen.iter().map(|(tip, _)| tip).sum::<Vector3<f64>>() / count;
        let square: Vector3<f64> = seen
            .iter()
            .map(|(tip, _)| (tip - mean).map(|x| x * x))
            .sum();
        let tip = |i: usize| middle(seen.iter().map(|(tip, _)| tip[i]).collect());
        let axis = |i: usize| middle(seen.iter().map(|(_, axis)| axis[i]).collect());
        InAir {
            tip: Vector3::from_fn(|i, _| tip(i)),
            axis: Unit::new_normalize(Vector3::from_fn(|i, _| axis(i))),
            deviation: square.map(|x| (x / (count - 1.0).max(1.0)).sqrt()),
        }
    };
    tips.into_iter().map(&mut measure).collect()
}

/// The median.
fn middle(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let half = values.len() / 2;
    match (values.get(half), values.get(half.wrapping_sub(1))) {
        (Some(upper), Some(lower)) if values.len().is_multiple_of(2) => 0.5 * (upper + lower),
        (Some(one), _) => *one,
        (None, _) => 0.0,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_field_has_its_size_and_is_slow_in_space() {
        let settings = EmSettings::measured();
        let (mut square, mut product, mut axis) = (0.0, 0.0, 0.0);
        let runs = 1500;
        let apart = Vector3::new(0.0, settings.distortion_length_mm * 1e-3, 0.0);
        for seed in 0..runs {
            let field = Distortion::new(&settings, seed);
            let here = field.of_place(&Vector3::new(0.1, -0.2, 0.3));
            let there = field.of_place(&(Vector3::new(0.1, -0.2, 0.3) + apart));
            square += here.norm_squared();
            product += here.dot(&there);
            axis += field.of_axis(&apart).norm_squared();
        }
        let n = 3.0 * runs as f64;
        let sigma = (square / n).sqrt() * 1e3;
        // Standard errors of 1.1 %; five of them.
        assert!(
            (sigma / settings.distortion_mm - 1.0).abs() < 0.055,
            "{sigma}"
        );
        let correlation = product / square;
        assert!(
            (correlation - (-0.5_f64).exp()).abs() < 0.06,
            "{correlation}"
        );
        let axis = (axis / n).sqrt() * 1e3;
        assert!((axis / settings.axis_distortion_mrad - 1.0).abs() < 0.055);
    }
}

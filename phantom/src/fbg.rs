//! Fibre Bragg gratings in the needle: what bending, warmth and age do to their wavelengths.
//!
//! Each active area sees the turn of the centreline over its grating's length, in the needle's own
//! frame there: carried along from the base, twisted as the tip is. How fibres lie in an area is told by
//! their sensitivities, as a calibration has them; in truth the area is off that by a factor and a turn.

use core::time::Duration;
use std::collections::VecDeque;

use hal::{Stamp, WavelengthShifts};
use nalgebra::{Isometry3, Rotation2, Vector2, Vector3};
use rand_chacha::ChaCha8Rng;

use crate::draw::{Purpose, normal, stream, uniform};
use crate::settings::FbgSettings;
use crate::twist::transport;
use crate::view::NeedleView;

/// An active area of the needle, as a calibration knows it.
#[derive(Clone, Debug, PartialEq)]
pub struct FibreArea {
    /// Distance from O, the shaft's end \[m\].
    pub from_tip: f64,
    /// Shift of each channel's wavelength by a turn of the needle about x and y of the fibres' frame, per
    /// length \[nm m\].
    pub sensitivity: Vec<[f64; 2]>,
}

/// An area as it truly is.
#[derive(Clone, Debug)]
struct Area {
    told: FibreArea,
    /// Factor on the curvature.
    gain: f64,
    /// Azimuth of the fibres' frame in the needle's, about z \[rad\].
    azimuth: f64,
    /// Warming over that of the first of the areas that are in the gel \[K\].
    warmth: f64,
    /// Of each channel: lasting error \[nm\], and shift by warmth \[nm/K\].
    channels: Vec<(f64, f64)>,
}

/// Gratings with their interrogator.
#[derive(Clone, Debug)]
pub(crate) struct Gratings {
    settings: FbgSettings,
    areas: Vec<Area>,
    noise: ChaCha8Rng,
    drops: ChaCha8Rng,
    sequence: u64,
    in_flight: VecDeque<(Stamp, WavelengthShifts)>,
}

impl Gratings {
    /// The gratings of run `seed` in a needle whose bevel was mounted off by `azimuth` \[rad\]: the
    /// holder keys the fibres, not the bevel.
    pub(crate) fn new(
        settings: &FbgSettings,
        areas: &[FibreArea],
        azimuth: f64,
        seed: u64,
    ) -> Self {
        let mut lasting = stream(seed, Purpose::Fibres);
        let roll = settings.roll_error_deg.to_radians() * normal(&mut lasting);
        let mut area = |told: &FibreArea| Area {
            gain: 1.0 + settings.gain_error * normal(&mut lasting),
            azimuth: roll - azimuth
                + settings.azimuth_error_deg.to_radians() * normal(&mut lasting),
            warmth: 0.0,
            channels: (told.sensitivity.iter())
                .map(|_| {
                    let drift = settings.drift_pm * normal(&mut lasting);
                    let uneven = 1.0 + settings.thermal_mismatch * normal(&mut lasting);
                    (drift * 1e-3, settings.thermal_pm_k * uneven * 1e-3)
                })
                .collect(),
            told: told.clone(),
        };
        Self {
            areas: areas.iter().map(&mut area).collect(),
            noise: stream(seed, Purpose::FibreNoise),
            drops: stream(seed, Purpose::FibreDrops),
            sequence: 0,
            in_flight: VecDeque::new(),
            settings: settings.clone(),
        }
    }

    /// When the next exposure is due: 0, 1, 2 ... over the rate.
    pub(crate) fn next_exposure(&self) -> Stamp {
        Stamp::from_secs(self.sequence as f64 / self.settings.rate_hz)
    }

    /// Reads the gratings of a needle with its base at `base` at the next exposure, unless that one is
    /// dropped.
    pub(crate) fn expose(&mut self, needle: &NeedleView, base: &Isometry3<f64>) {
        let (stamp, sequence) = (self.next_exposure(), self.sequence);
        self.sequence += 1;
        self.warm(needle);
        let mut shifts_nm = self.without_noise(needle, base);
        for shift in &mut shifts_nm {
            *shift += self.settings.noise_pm * 1e-3 * normal(&mut self.noise);
        }
        if uniform(&mut self.drops) < self.settings.drop_fraction {
            return;
        }
        let latency = Duration::from_secs_f64(self.settings.latency_ms * 1e-3);
        let reading = WavelengthShifts {
            stamp,
            sequence,
            shifts_nm,
        };
        self.in_flight.push_back((stamp + latency, reading));
    }

    /// The newest reading delivered by `now` and not yet returned.
    pub(crate) fn poll(&mut self, now: Stamp) -> Option<WavelengthShifts> {
        let mut newest = None;
        while self.in_flight.front().is_some_and(|(due, _)| *due <= now) {
            newest = self.in_flight.pop_front().map(|(_, reading)| reading);
        }
        newest
    }

    /// Areas in the gel take on its temperature.
    fn warm(&mut self, needle: &NeedleView) {
        let length = length(needle);
        let share = 1.0 - (-1.0 / (self.settings.rate_hz * self.settings.warming_s)).exp();
        for area in &mut self.areas {
            if length - area.told.from_tip > needle.entry_arc {
                area.warmth += (self.settings.warming_k - area.warmth) * share;
            }
        }
    }

    /// The shifts that an interrogator without noise reads now \[nm\].
    pub(crate) fn without_noise(&self, needle: &NeedleView, base: &Isometry3<f64>) -> Vec<f64> {
        let half = 0.5e-3 * self.settings.grating_mm;
        let bending = Bending::of(needle, base);
        let mut shifts = Vec::new();
        for area in &self.areas {
            let turn = bending.at(length(needle) - area.told.from_tip, half);
            let turn = Rotation2::new(-area.azimuth) * turn * area.gain;
            let channels = area.told.sensitivity.iter().zip(&area.channels);
            shifts.extend(channels.map(|(by, (drift, by_warmth))| {
                Vector2::from(*by).dot(&turn) + drift + by_warmth * area.warmth
            }));
        }
        shifts
    }
}

fn length(needle: &NeedleView) -> f64 {
    needle.spacing() * needle.centreline.len().saturating_sub(1) as f64
}

/// A centreline with the needle's own frame along it.
struct Bending<'a> {
    needle: &'a NeedleView,
    spacing: f64,
    /// x axis of the base's frame, carried to each edge without twist.
    directors: Vec<Vector3<f64>>,
    /// Twist at the tip \[rad\].
    twist: f64,
}

impl<'a> Bending<'a> {
    fn of(needle: &'a NeedleView, base: &Isometry3<f64>) -> Self {
        let mut tangent = base.rotation * Vector3::z();
        let mut carried = base.rotation * Vector3::x();
        let mut directors = Vec::with_capacity(needle.centreline.len());
        for ends in needle.centreline.windows(2) {
            let along = (ends[1] - ends[0]).normalize();
            carried = transport(&carried, &tangent, &along);
            tangent = along;
            directors.push(carried);
        }
        let end = needle.world_from_tip.rotate(&Vector3::z());
        let carried = transport(&carried, &tangent, &end);
        let material = needle.world_from_tip.rotate(&Vector3::x());
        Self {
            needle,
            spacing: needle.spacing(),
            directors,
            twist: end
                .dot(&carried.cross(&material))
                .atan2(carried.dot(&material)),
        }
    }

    /// Twist at an arc length: torque is the same up to the gel, and even friction takes it away from
    /// there to the tip \[rad\].
    fn twist_at(&self, arc: f64) -> f64 {
        let length = length(self.needle);
        let outside = self.needle.entry_arc.min(length);
        let inside = (length - outside).max(f64::MIN_POSITIVE);
        let within = (arc - outside).max(0.0);
        let to = |arc: f64, within: f64| arc.min(outside) + within - 0.5 * within * within / inside;
        self.twist * to(arc, within) / to(length, length - outside).max(f64::MIN_POSITIVE)
    }

    /// Turn of the needle per length about its own x and y at `arc`, over `half` a grating to both
    /// sides \[1/m\].
    fn at(&self, arc: f64, half: f64) -> Vector2<f64> {
        let points = &self.needle.centreline;
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a share of a needle's few hundred points"
        )]
        let nodes = |by: f64| (by / self.spacing).round().max(0.0) as usize;
        let most = (points.len() - 1) / 2;
        let side = nodes(half).clamp(1, most.max(1));
        let node = nodes(arc).clamp(side, (points.len() - 1).saturating_sub(side).max(side));
        let (Some(before), Some(here), Some(after)) = (
            points.get(node - side),
            points.get(node),
            points.get(node + side),
        ) else {
            return Vector2::zeros();
        };
        let (back, ahead) = ((here - before).normalize(), (after - here).normalize());
        let turn = back.cross(&ahead) / (0.5 * (after - before).norm());
        let x = self.directors[node - 1];
        let y = ahead.cross(&x);
        Rotation2::new(-self.twist_at(arc)) * Vector2::new(turn.dot(&x), turn.dot(&y))
    }
}

#[cfg(test)]
mod tests {
    use hal::Transform;
    use nalgebra::{Translation3, UnitQuaternion};

    use super::*;

    /// A needle of 100 mm that turns by `curvature` about the base's x, twisted by `twist` at the tip.
    fn arc(curvature: f64, twist: f64) -> NeedleView {
        let at = |s: f64| {
            let k = curvature;
            Vector3::new(0.0, -(1.0 - (k * s).cos()) / k, (k * s).sin() / k)
        };
        let centreline = (0..=200_u32).map(|i| at(5e-4 * f64::from(i))).collect();
        let turn = UnitQuaternion::from_scaled_axis(Vector3::x() * (curvature * 0.1));
        let twist = UnitQuaternion::from_scaled_axis(Vector3::z() * twist);
        NeedleView {
            stamp: Stamp::ZERO,
            centreline,
            world_from_tip: Transform::assume(Isometry3::from_parts(
                Translation3::from(at(0.1)),
                turn * twist,
            )),
            outer_diameter: 1e-3,
            bevel_angle: 0.4,
            entry_arc: 0.04,
        }
    }

    fn area() -> FibreArea {
        FibreArea {
            from_tip: 30e-3,
            sensitivity: vec![[0.5, 0.0], [0.0, 0.5]],
        }
    }

    /// Shifts of the first reading \[nm\].
    fn shifts(settings: &FbgSettings, needle: &NeedleView, azimuth: f64, seed: u64) -> Vec<f64> {
        let mut gratings = Gratings::new(settings, &[area()], azimuth, seed);
        gratings.expose(needle, &Isometry3::identity());
        gratings.poll(Stamp::ZERO).unwrap().shifts_nm
    }

    #[test]
    fn an_arc_shifts_the_channels_that_see_it() {
        let found = shifts(&FbgSettings::default(), &arc(2.0, 0.0), 0.0, 1);
        // 0.5 nm m times 2 per metre; chords of 2.5 mm leave a millionth.
        assert!((found[0] - 1.0).abs() < 1e-4, "{found:?}");
        assert!(found[1].abs() < 1e-9, "{found:?}");
    }

    #[test]
    fn twist_turns_what_is_seen_and_the_mounting_of_the_bevel_does_not() {
        let settings = FbgSettings::default();
        let twist = 0.1;
        let found = shifts(&settings, &arc(2.0, twist), 0.0, 1);
        // At 70 mm of 100, 40 of them outside: (40 + 30 - 7.5) / (40 + 30) of the tip's.
        let expected = -twist * (62.5 / 70.0);
        let angle = found[1].atan2(found[0]);
        assert!((angle - expected).abs() < 1e-3, "{angle} {expected}");
        // A needle that is turned in its holder turns its own frame; the fibres stay where they are keyed.
        let azimuth = 0.2;
        let turned = UnitQuaternion::from_scaled_axis(Vector3::z() * azimuth);
        let mut gratings = Gratings::new(&settings, &[area()], azimuth, 1);
        let mut needle = arc(2.0, azimuth);
        needle.entry_arc = 0.1;
        let base = Isometry3::from_parts(Translation3::identity(), turned);
        gratings.expose(&needle, &base);
        let found = gratings.poll(Stamp::ZERO).unwrap().shifts_nm;
        assert!(found[1].abs() < 1e-3, "{found:?}");
    }

    #[test]
    fn flaws_have_their_sizes_and_warmth_is_common() {
        let settings = FbgSettings {
            gain_error: 0.03,
            ..FbgSettings::default()
        };
        let runs = 2000;
        let square: f64 = (0..runs)
            .map(|seed| (shifts(&settings, &arc(2.0, 0.0), 0.0, seed)[0] - 1.0).powi(2))
            .sum();
        let sigma = (square / runs as f64).sqrt();
        // Standard error of 1.6 %; five of them.
        assert!((sigma / 0.03 - 1.0).abs() < 0.08, "{sigma}");

        let settings = FbgSettings {
            warming_k: 10.0,
            warming_s: 1e-3,
            thermal_pm_k: 10.0,
            ..FbgSettings::default()
        };
        let warm = shifts(&settings, &arc(2.0, 0.0), 0.0, 1);
        assert!((warm[0] - 1.1).abs() < 1e-3 && (warm[1] - 0.1).abs() < 1e-3);
    }
}

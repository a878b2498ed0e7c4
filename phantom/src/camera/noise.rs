//! The sensor's noise: a strip of standard normal samples drawn once, read at random offsets.

use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::settings::NoiseSettings;

/// Grey levels in the renderer's 16-bit planes carry 6 fractional bits.
pub(super) const GREY_BITS: u32 = 6;
/// One grey level in these planes.
pub(super) const GREY: f64 = 64.0;
/// One standard deviation in the strip of samples.
const SIGMA: f64 = 4096.0;
/// Length of the strip; a power of two.
const STRIP: usize = 1 << 17;

/// Independent random streams of one seed.
#[derive(Clone, Copy, Debug)]
pub(super) enum Stream {
    Bubbles,
    Backlight,
    Strip,
    Calibration,
    Exposure,
    Delivery,
}

/// Generator of one stream at one exposure, so that any exposure can be drawn on its own.
pub(super) fn generator(seed: u64, stream: Stream, number: u64) -> ChaCha8Rng {
    let mut generator = ChaCha8Rng::seed_from_u64(seed);
    generator.set_stream((number << 4) | stream as u64);
    generator
}

/// Amplitude of the noise by grey level, and the samples it multiplies.
#[derive(Clone, Debug)]
pub(super) struct Noise {
    /// `samples[i] * amplitude >> 16` is in the renderer's units.
    samples: Vec<i16>,
    /// By grey level, in 1/4 grey.
    amplitudes: Vec<i16>,
}

impl Noise {
    /// None if the sensor is noiseless.
    #[expect(
        clippy::cast_possible_truncation,
        reason = "samples are clamped and amplitudes bounded by the settings' ranges"
    )]
    pub(super) fn new(settings: &NoiseSettings, width: usize, seed: u64) -> Option<Self> {
        if settings.gaussian_grey == 0.0 && settings.poisson_grey == 0.0 {
            return None;
        }
        let mut generator = generator(seed, Stream::Strip, 0);
        let drawn: Vec<f64> = (0..STRIP)
            .map(|_| StandardNormal.sample(&mut generator))
            .collect();
        // Exact moments, so that long-run statistics are those of the settings.
        let mean = drawn.iter().sum::<f64>() / STRIP as f64;
        let variance = drawn.iter().map(|x| (x - mean).powi(2)).sum::<f64>() / STRIP as f64;
        let scale = SIGMA / variance.sqrt();
        let samples = (0..STRIP + width)
            .map(|i| {
                ((drawn[i % STRIP] - mean) * scale)
                    .clamp(-32767.0, 32767.0)
                    .round() as i16
            })
            .collect();
        let amplitudes = (0..=255 * 4)
            .map(|quarter| {
                let variance = settings.gaussian_grey.powi(2)
                    + settings.poisson_grey * f64::from(quarter) / 4.0;
                (variance.sqrt() * GREY * 65536.0 / SIGMA)
                    .min(32767.0)
                    .round() as i16
            })
            .collect();
        Some(Self {
            samples,
            amplitudes,
        })
    }

    /// Amplitude at a level in the renderer's units.
    #[expect(clippy::cast_sign_loss, reason = "clamped to be positive")]
    pub(super) fn amplitude(&self, level: i16) -> i16 {
        let quarter = (level.max(0) >> (GREY_BITS - 2)) as usize;
        self.amplitudes[quarter.min(self.amplitudes.len() - 1)]
    }

    /// The samples of one row.
    pub(super) fn row(&self, generator: &mut ChaCha8Rng, width: usize) -> &[i16] {
        let offset = generator.next_u32() as usize & (STRIP - 1);
        &self.samples[offset..offset + width]
    }
}

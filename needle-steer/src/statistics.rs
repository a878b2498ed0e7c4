//! Order statistics of runs, and paired comparison with bootstrap intervals.

/// The value below which `fraction` of the sorted sample lies, with linear interpolation between
/// neighbours (the convention of NumPy's default). NaN for an empty sample.
pub fn percentile(sample: &[f64], fraction: f64) -> f64 {
    let mut sorted = sample.to_vec();
    sorted.sort_by(f64::total_cmp);
    let Some(last) = sorted.len().checked_sub(1) else {
        return f64::NAN;
    };
    let at = fraction.clamp(0.0, 1.0) * last as f64;
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "0 <= at <= last"
    )]
    let below = at.floor() as usize;
    let above = (below + 1).min(last);
    sorted[below] + (at - below as f64) * (sorted[above] - sorted[below])
}

/// The median.
pub fn median(sample: &[f64]) -> f64 {
    percentile(sample, 0.5)
}

/// Resamplings of a bootstrap.
const RESAMPLINGS: usize = 2000;

/// Median of paired differences with its 95 % interval.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct PairedDifference {
    /// Median of the differences.
    pub median: f64,
    /// Lower end of the interval.
    pub low: f64,
    /// Upper end.
    pub high: f64,
}

impl PairedDifference {
    /// Whether the interval leaves out zero.
    pub fn is_clear(&self) -> bool {
        self.low > 0.0 || self.high < 0.0
    }
}

/// Median of `sample - reference`, pair by pair, with the percentile bootstrap's 95 % interval
/// \[Efron1993\]; the same numbers give the same interval. Pairs with a value that is not finite
/// are left out; nothing is left: NaN.
pub fn paired_difference(sample: &[f64], reference: &[f64]) -> PairedDifference {
    let differences: Vec<f64> = sample
        .iter()
        .zip(reference)
        .map(|(a, b)| a - b)
        .filter(|d| d.is_finite())
        .collect();
    let mut state = 0x9E37_79B9_7F4A_7C15_u64;
    let mut drawn = vec![0.0; differences.len()];
    let medians: Vec<f64> = (0..RESAMPLINGS)
        .map(|_| {
            for value in &mut drawn {
                *value = differences[below(&mut state, differences.len())];
            }
            median(&drawn)
        })
        .collect();
    PairedDifference {
        median: median(&differences),
        low: percentile(&medians, 0.025),
        high: percentile(&medians, 0.975),
    }
}

/// A number below `count` by the generator `SplitMix64` \[Steele2014\].
fn below(state: &mut u64, count: usize) -> usize {
    *state = state.wrapping_add(0x9E37_79B9_7F4A_7C15);
    let mut z = *state;
    z = (z ^ (z >> 30)).wrapping_mul(0xBF58_476D_1CE4_E5B9);
    z = (z ^ (z >> 27)).wrapping_mul(0x94D0_49BB_1331_11EB);
    z ^= z >> 31;
    #[expect(clippy::cast_possible_truncation, reason = "below `count`")]
    let index = (z % count.max(1) as u64) as usize;
    index
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_paired_difference_is_found_and_bounded() {
        // Large common spread, small difference: pairing sees it.
        let reference: Vec<f64> = (0..60).map(|i| f64::from((i * 37) % 60)).collect();
        let sample: Vec<f64> = reference
            .iter()
            .enumerate()
            .map(|(i, r)| r + 0.5 + 0.1 * ((i % 7) as f64 - 3.0))
            .collect();
        let d = paired_difference(&sample, &reference);
        assert!((d.median - 0.5).abs() < 0.06, "{d:?}");
        assert!(d.low > 0.3 && d.high < 0.7 && d.is_clear(), "{d:?}");
        assert!(!paired_difference(&reference, &reference).is_clear());
        assert!(paired_difference(&[f64::NAN], &[1.0]).median.is_nan());
        assert!(paired_difference(&[], &[]).low.is_nan());
    }

    #[test]
    fn percentiles_interpolate() {
        let sample = [4.0, 1.0, 3.0, 2.0];
        assert!((median(&sample) - 2.5).abs() < 1e-15);
        assert!((percentile(&sample, 0.05) - 1.15).abs() < 1e-12);
        assert!((percentile(&sample, 1.0) - 4.0).abs() < 1e-15);
        assert!(percentile(&[], 0.5).is_nan());
        assert!((percentile(&[7.0], 0.95) - 7.0).abs() < 1e-15);
    }
}

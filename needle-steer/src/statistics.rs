//! Order statistics of runs.

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

#[cfg(test)]
mod tests {
    use super::*;

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

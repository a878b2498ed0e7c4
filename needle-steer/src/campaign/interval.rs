//! Confidence intervals that assume no distribution, all at 95 %.

/// Standard normal quantile of 97.5 %.
const Z: f64 = 1.959_963_984_540_054;

/// Wilson's score interval of a proportion, `hits` of `n`; the whole range for no trial.
pub fn proportion(hits: u64, n: u64) -> [f64; 2] {
    if n == 0 {
        return [0.0, 1.0];
    }
    let (n, p) = (n as f64, hits as f64 / n as f64);
    let centre = p + Z * Z / (2.0 * n);
    let spread = Z * (p * (1.0 - p) / n + Z * Z / (4.0 * n * n)).sqrt();
    let scale = 1.0 + Z * Z / n;
    [
        ((centre - spread) / scale).max(0.0),
        ((centre + spread) / scale).min(1.0),
    ]
}

/// Exact interval (Clopper and Pearson) of a proportion, `hits` of `n`; the whole range for no
/// trial.
pub fn exact(hits: u64, n: u64) -> [f64; 2] {
    // The proportion at which at most `most` hits have a chance of 2.5 %.
    let solve = |most: u64, chance: f64| {
        let (mut low, mut high) = (0.0, 1.0);
        for _ in 0..60 {
            let p = 0.5 * (low + high);
            if at_most(most, n, p) > chance {
                low = p;
            } else {
                high = p;
            }
        }
        0.5 * (low + high)
    };
    [
        if hits == 0 {
            0.0
        } else {
            solve(hits - 1, 0.975)
        },
        if hits >= n { 1.0 } else { solve(hits, 0.025) },
    ]
}

/// Probability of at most `most` of `n` hits, each of probability `p`.
fn at_most(most: u64, n: u64, p: f64) -> f64 {
    let mut log = n as f64 * (-p).ln_1p();
    let mut sum = log.exp();
    for k in 0..most {
        log += ((n - k) as f64 / (k + 1) as f64).ln() + p.ln() - (-p).ln_1p();
        sum += log.exp();
    }
    sum
}

/// Interval of the median from order statistics; nothing for fewer than six values, which cannot
/// give 95 %. `sorted` rises.
pub fn median(sorted: &[f64]) -> Option<[f64; 2]> {
    // Largest k with P(B < k) <= 2.5 %, B binomial(n, 1/2): the k-th value from either end.
    let mut below = 0.0;
    let mut k = 0;
    while k < sorted.len() {
        below += half_binomial(sorted.len(), k);
        if below > 0.025 {
            break;
        }
        k += 1;
    }
    let low = sorted.get(k.checked_sub(1)?)?;
    let high = sorted.get(sorted.len() - k)?;
    Some([*low, *high])
}

/// Two-sided probability of a split at least as uneven as `wins` of `n` fair coins (sign test).
pub fn sign_test(wins: usize, n: usize) -> f64 {
    let tail: f64 = (0..=wins.min(n - wins.min(n)))
        .map(|k| half_binomial(n, k))
        .sum();
    (2.0 * tail).min(1.0)
}

/// Probability of `k` of `n` fair coins.
fn half_binomial(n: usize, k: usize) -> f64 {
    let mut log = -(n as f64) * core::f64::consts::LN_2;
    for i in 0..k {
        log += ((n - i) as f64 / (i + 1) as f64).ln();
    }
    log.exp()
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Against tables: none of 2000 is at most 0.184 %, 95 of 100 is 88.72 to 98.36 %.
    #[test]
    fn exact_intervals_are_those_of_tables() {
        let [low, high] = exact(0, 0);
        assert!(low <= 0.0 && high >= 1.0);
        let [low, high] = exact(0, 2000);
        assert!(low <= 0.0 && (high - 1.8427e-3).abs() < 1e-6, "{high}");
        let [low, high] = exact(95, 100);
        assert!((low - 0.8872).abs() < 1e-4 && (high - 0.9836).abs() < 1e-4);
        assert!((exact(100, 100)[0] - 0.9638).abs() < 1e-4);
    }

    /// Against tables: Wilson's interval of 8 of 10 is 0.4902 to 0.9433.
    #[test]
    fn proportions_agree_with_tables() {
        let [low, high] = proportion(8, 10);
        assert!((low - 0.4902).abs() < 1e-4 && (high - 0.9433).abs() < 1e-4);
        let [low, high] = proportion(0, 0);
        assert!(low.abs() < 1e-12 && (high - 1.0).abs() < 1e-12);
        let [low, _] = proportion(20, 20);
        assert!((low - 0.8389).abs() < 1e-4);
    }

    /// Conover's table: for n = 20 the 95 % interval runs from the 6th to the 15th value, for
    /// n = 6 from the first to the last.
    #[test]
    fn medians_agree_with_tables() {
        let values: Vec<f64> = (1..=20).map(f64::from).collect();
        assert_eq!(median(&values), Some([6.0, 15.0]));
        assert_eq!(median(&values[..6]), Some([1.0, 6.0]));
        assert_eq!(median(&values[..5]), None);
        assert_eq!(median(&[]), None);
    }

    #[test]
    fn sign_test_of_small_samples() {
        assert!((sign_test(0, 6) - 2.0 / 64.0).abs() < 1e-12);
        assert!((sign_test(6, 6) - 2.0 / 64.0).abs() < 1e-12);
        assert!((sign_test(3, 6) - 1.0).abs() < 1e-12);
        assert!((sign_test(0, 0) - 1.0).abs() < 1e-12);
        // 1000 coins: no underflow to zero, no overflow.
        assert!(sign_test(500, 1000) > 0.99 && sign_test(400, 1000) < 1e-9);
    }

    /// The interval covers the true median in at least 95 % of samples.
    #[test]
    fn median_intervals_cover() {
        let mut state = 7_u64;
        let mut uniform = || {
            state = state
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1);
            (state >> 11) as f64 / (1_u64 << 53) as f64
        };
        let covered = (0..2000)
            .filter(|_| {
                let mut sample: Vec<f64> = (0..25).map(|_| uniform()).collect();
                sample.sort_by(f64::total_cmp);
                median(&sample).is_some_and(|[low, high]| low <= 0.5 && 0.5 <= high)
            })
            .count();
        assert!(covered >= 1880, "{covered} of 2000");
    }
}

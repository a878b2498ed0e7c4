//! Virtual springs: the tissue at one place along the needle (section II.A).

use nalgebra::Vector3;

/// One virtual spring.
#[derive(Debug, Clone, Copy, PartialEq)]
pub struct Spring {
    /// Rest position p_0 in World \[m\].
    pub rest: Vector3<f64>,
    /// Stiffness K \[N/m\].
    pub stiffness: f64,
}

/// Force of a spring on the needle \[N\]: Eq. (1).
///
/// `k` \[N/m\], needle point `p_n` and rest point `p_0` \[m\].
///
/// # Deviation
/// The sign: the tissue pushes the needle back to the rest point, -K (p_n - p_0). Read literally,
/// the equation gives the needle's force on the tissue.
pub fn spring_force(k: f64, p_n: &Vector3<f64>, p_0: &Vector3<f64>) -> Vector3<f64> {
    -k * (p_n - p_0)
}

/// Stiffness of a spring \[N/m\]: Eq. (2).
///
/// `k_t`: stiffness of the tissue per length \[N/m2\]; `l`: length the spring supports \[m\].
pub const fn spring_stiffness(k_t: f64, l: f64) -> f64 {
    k_t * l
}

/// Lengths \[m\] supported by the springs of a needle whose springs are `gaps` apart (`gaps[i]`
/// between springs i and i+1) with the tip `tip_gap` beyond the last, into `supported`
/// (one longer than `gaps`).
///
/// Each spring supports half of the gaps beside it, the last one also what lies before it. So that
/// nothing jumps when a spring is born, it takes over its half of the gap behind it in proportion
/// to `tip_gap / pitch`; the sum is the inserted length at all times.
///
/// # Panics
/// Never: a `supported` of another length than `gaps` + 1 is filled as far as both reach.
pub fn supported_lengths(gaps: &[f64], tip_gap: f64, pitch: f64, supported: &mut [f64]) {
    let n = supported.len().min(gaps.len() + 1);
    for i in 0..n {
        let behind = if i > 0 { gaps[i - 1] / 2.0 } else { 0.0 };
        let ahead = if i + 1 < n { gaps[i] / 2.0 } else { tip_gap };
        supported[i] = behind + ahead;
    }
    if n > 1 {
        let missing = gaps[n - 2] / 2.0 * (1.0 - (tip_gap / pitch).clamp(0.0, 1.0));
        supported[n - 1] -= missing;
        supported[n - 2] += missing;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn force_points_back_to_rest() {
        let force = spring_force(
            2.0,
            &Vector3::new(1.0, 0.0, 3.0),
            &Vector3::new(0.0, 0.0, 3.0),
        );
        assert_eq!(force, Vector3::new(-2.0, 0.0, 0.0));
    }

    #[test]
    fn supported_lengths_follow_the_newborn_law() {
        let (h, mut l) = (2.5e-3, [0.0; 3]);
        for xi in [0.0, 0.7e-3, 2.5e-3] {
            supported_lengths(&[h, h], xi, h, &mut l);
            assert!((l[2] - 1.5 * xi).abs() < 1e-18);
            assert!((l[1] - (1.5 * h - 0.5 * xi)).abs() < 1e-18);
            assert!((l.iter().sum::<f64>() - (2.0 * h + xi)).abs() < 1e-18);
        }
        // Birth changes no existing support.
        let mut before = [0.0; 2];
        supported_lengths(&[h], h, h, &mut before);
        supported_lengths(&[h, h], 0.0, h, &mut l);
        assert_eq!(before, l[..2]);
    }

    #[test]
    fn stiffness_is_per_length() {
        assert!((spring_stiffness(1e4, 2.5e-3) - 25.0).abs() < 1e-12);
    }
}

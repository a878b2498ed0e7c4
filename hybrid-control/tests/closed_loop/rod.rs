//! A linear rod on a bed laid along its path: Hermite elements, one plane shape, two load cases.
//! Written for the tests alone and independent of the library's model.

use nalgebra::Vector2;

pub(crate) const EI: f64 = 1.836e-3;
pub(crate) const LENGTH: f64 = 0.126;
const ELEMENTS: usize = 126;
const DOF: usize = 2 * (ELEMENTS + 1);
const BAND: usize = 4;

/// Displacements and slopes at the nodes, base to tip.
pub(crate) struct Shape {
    pub(crate) z: Vec<f64>,
    pub(crate) w: Vec<Vector2<f64>>,
    pub(crate) slope: Vec<Vector2<f64>>,
    /// Force of the path on the held tip \[N\]; zero where the tip is free.
    pub(crate) reaction: Vector2<f64>,
}

impl Shape {
    pub(crate) fn tip_slope(&self) -> Vector2<f64> {
        *self.slope.last().unwrap()
    }

    pub(crate) fn tip(&self) -> Vector2<f64> {
        *self.w.last().unwrap()
    }

    /// Axial shortening by the slopes \[m\].
    pub(crate) fn shortening(&self) -> f64 {
        self.z
            .windows(2)
            .zip(self.slope.windows(2))
            .map(|(z, s)| (z[1] - z[0]) * 0.25 * (s[0].norm_squared() + s[1].norm_squared()))
            .sum()
    }
}

pub(crate) struct Bed<'a> {
    pub(crate) stiffness: &'a dyn Fn(f64) -> f64,
    pub(crate) path: &'a dyn Fn(f64) -> Vector2<f64>,
    pub(crate) axial: f64,
    /// Tip load of a free tip: force \[N\].
    pub(crate) free_tip_force: Option<Vector2<f64>>,
}

/// Equilibrium from the base at `z0` to the tip at `z1`; clamped at the base.
pub(crate) fn equilibrium(
    z0: f64,
    z1: f64,
    base: Vector2<f64>,
    base_slope: Vector2<f64>,
    bed: &Bed<'_>,
) -> Shape {
    let h = (z1 - z0) / ELEMENTS as f64;
    let mut k = vec![[0.0_f64; BAND]; DOF]; // k[i][j] = K(i, i + j)
    let mut f = vec![Vector2::zeros(); DOF];
    let bend = [
        [12.0, 6.0 * h, -12.0, 6.0 * h],
        [0.0, 4.0 * h * h, -6.0 * h, 2.0 * h * h],
        [0.0, 0.0, 12.0, -6.0 * h],
        [0.0, 0.0, 0.0, 4.0 * h * h],
    ];
    let geo = [
        [36.0, 3.0 * h, -36.0, 3.0 * h],
        [0.0, 4.0 * h * h, -3.0 * h, -h * h],
        [0.0, 0.0, 36.0, -3.0 * h],
        [0.0, 0.0, 0.0, 4.0 * h * h],
    ];
    for e in 0..ELEMENTS {
        let za = z0 + e as f64 * h;
        for a in 0..4 {
            for b in a..4 {
                let v = EI * bend[a][b] / (h * h * h) - bed.axial * geo[a][b] / (30.0 * h);
                k[2 * e + a][b - a] += v;
            }
        }
        for (xi, weight) in GAUSS {
            let z = za + xi * h;
            if z < 0.0 {
                continue;
            }
            let n = hermite(xi, h);
            let stiff = (bed.stiffness)(z) * weight * h;
            let c = (bed.path)(z);
            for a in 0..4 {
                for b in a..4 {
                    k[2 * e + a][b - a] += stiff * n[a] * n[b];
                }
                f[2 * e + a] += c * (stiff * n[a]);
            }
        }
    }
    let tip = DOF - 2;
    let mut tip_row = [0.0; BAND];
    let mut tip_right = Vector2::zeros();
    if let Some(force) = bed.free_tip_force {
        f[tip] += force;
    } else {
        // Remember the tip's equation for the reaction, then hold it.
        for j in 1..BAND {
            tip_row[j] = k[tip - j][j];
        }
        tip_right = f[tip];
        let diagonal = k[tip][0];
        let right = k[tip][1];
        hold(&mut k, &mut f, tip, (bed.path)(z1));
        tip_row[0] = diagonal;
        // Coupling to the tip's own slope is stored apart in `right`.
        let shape = finish(&mut k, &mut f, base, base_slope, z0, h);
        let mut reaction =
            shape.w[ELEMENTS] * tip_row[0] + shape.slope[ELEMENTS] * right - tip_right;
        reaction += shape.slope[ELEMENTS - 1] * tip_row[1] + shape.w[ELEMENTS - 1] * tip_row[2];
        return Shape { reaction, ..shape };
    }
    let _ = (tip_row, tip_right);
    finish(&mut k, &mut f, base, base_slope, z0, h)
}

const GAUSS: [(f64, f64); 3] = [
    (0.112_701_665_379_258_3, 0.277_777_777_777_777_8),
    (0.5, 0.444_444_444_444_444_4),
    (0.887_298_334_620_741_7, 0.277_777_777_777_777_8),
];

fn hermite(x: f64, h: f64) -> [f64; 4] {
    [
        1.0 - 3.0 * x * x + 2.0 * x * x * x,
        h * (x - 2.0 * x * x + x * x * x),
        3.0 * x * x - 2.0 * x * x * x,
        h * (x * x * x - x * x),
    ]
}

/// Prescribes one unknown.
fn hold(k: &mut [[f64; BAND]], f: &mut [Vector2<f64>], i: usize, value: Vector2<f64>) {
    for j in 1..BAND {
        if i + j < DOF {
            let v = k[i][j];
            f[i + j] -= value * v;
            k[i][j] = 0.0;
        }
        if i >= j {
            let v = k[i - j][j];
            f[i - j] -= value * v;
            k[i - j][j] = 0.0;
        }
    }
    k[i][0] = 1.0;
    f[i] = value;
}

fn finish(
    k: &mut [[f64; BAND]],
    f: &mut [Vector2<f64>],
    base: Vector2<f64>,
    base_slope: Vector2<f64>,
    z0: f64,
    h: f64,
) -> Shape {
    hold(k, f, 0, base);
    hold(k, f, 1, base_slope);
    // Banded L D L'.
    for i in 0..DOF {
        for j in 1..BAND {
            if i + j >= DOF {
                break;
            }
            let l = k[i][j] / k[i][0];
            if l == 0.0 {
                continue;
            }
            for m in j..BAND {
                k[i + j][m - j] -= l * k[i][m];
            }
            let fi = f[i];
            f[i + j] -= fi * l;
        }
    }
    for i in (0..DOF).rev() {
        for j in 1..BAND {
            if i + j < DOF {
                let fj = f[i + j];
                f[i] -= fj * k[i][j];
            }
        }
        f[i] /= k[i][0];
    }
    Shape {
        z: (0..=ELEMENTS).map(|i| z0 + i as f64 * h).collect(),
        w: f.iter().step_by(2).copied().collect(),
        slope: f.iter().skip(1).step_by(2).copied().collect(),
        reaction: Vector2::zeros(),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Cantilever under a tip force: w = F L^3 / (3 EI).
    #[test]
    fn cantilever() {
        let bed = Bed {
            stiffness: &|_| 0.0,
            path: &|_| Vector2::zeros(),
            axial: 0.0,
            free_tip_force: Some(Vector2::new(0.01, 0.0)),
        };
        let s = equilibrium(-LENGTH, 0.0, Vector2::zeros(), Vector2::zeros(), &bed);
        let exact = 0.01 * LENGTH.powi(3) / (3.0 * EI);
        assert!(
            (s.tip().x / exact - 1.0).abs() < 1e-8,
            "{}",
            s.tip().x / exact
        );
    }

    /// Held tip: its reaction is that of a propped cantilever, 3 EI w / L^3.
    #[test]
    fn propped_cantilever_reaction() {
        let bed = Bed {
            stiffness: &|_| 0.0,
            path: &|_| Vector2::new(1e-3, 0.0),
            axial: 0.0,
            free_tip_force: None,
        };
        let s = equilibrium(-LENGTH, 0.0, Vector2::zeros(), Vector2::zeros(), &bed);
        let exact = 3.0 * EI * 1e-3 / LENGTH.powi(3);
        assert!(
            (s.reaction.x / exact - 1.0).abs() < 1e-6,
            "{}",
            s.reaction.x / exact
        );
    }
}

//! Where the base loses its authority over a tip that is free to move through the tissue.

#![expect(clippy::unwrap_used, reason = "a failed set-up fails the test")]
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "counts of springs from lengths"
)]

use nalgebra::{Isometry3, Vector3};
use needle_model::{Equilibrium, Needle, Spring, TipLoad};

/// Slope per shift, slope per pivot about the entry, position per shift, position per tilt of a
/// straight needle of 126 mm, from eq. (12) with springs 0.5 mm apart.
fn rates(k: f64, depth: f64) -> [f64; 4] {
    let length = 0.126;
    let needle = Needle::new(length, 0.7e-3, 0.48e-3, 200e9).unwrap();
    let base = Isometry3::translation(0.0, 0.0, depth - length);
    let count = (depth / 0.5e-3).round().max(2.0) as usize;
    let pitch = depth / count as f64;
    let springs: Vec<_> = (0..count)
        .map(|i| Spring {
            rest: Vector3::z() * (pitch * (i as f64 + 0.5)),
            stiffness: k * pitch,
        })
        .collect();
    let mut free = Equilibrium::new(needle, base);
    free.solve(&base, &springs, TipLoad::default()).unwrap();
    let j = free.tip_jacobian().unwrap();
    let pivot = j[(4, 4)] - (length - depth) * j[(4, 0)];
    [j[(4, 0)], pivot, j[(0, 0)], j[(0, 4)]]
}

/// All changes of sign between 2 and 100 mm of depth \[mm\].
fn zeros(k: f64) -> [Vec<f64>; 4] {
    let mut found: [Vec<f64>; 4] = Default::default();
    let mut before = rates(k, 2e-3);
    for mm in 2..100 {
        let after = rates(k, f64::from(mm + 1) * 1e-3);
        for which in 0..4 {
            // Linear between millimetres: to 0.1 mm.
            let (a, b) = (before[which], after[which]);
            if a * b <= 0.0 {
                found[which].push(f64::from(mm) + a / (a - b));
            }
        }
        before = after;
    }
    found
}

/// "Below 5 mm" of the table: found between 4 and 5.
const BELOW: f64 = 4.5;

#[test]
fn authority_over_a_free_tip_vanishes_where_the_table_says() {
    // K; zeros (mm) of slope per shift, slope per pivot, position per shift, position per tilt.
    let table: [(f64, [&[f64]; 4]); 4] = [
        (5e3, [&[], &[85.0], &[10.0], &[20.0]]),
        (1e4, [&[88.0], &[74.0], &[7.0], &[13.0]]),
        (2e4, [&[68.0], &[63.0], &[BELOW, 93.0], &[9.0]]),
        (5e4, [&[51.0], &[49.0], &[68.0], &[6.0, 74.0]]),
    ];
    for (k, expected) in table {
        let found = zeros(k);
        println!("K {k:e}: {found:.2?} mm, table {expected:?}");
        for (which, (found, expected)) in found.iter().zip(expected).enumerate() {
            // All of them and no other; the table begins at 5 mm, but for its one "below 5".
            let from = if expected.first() == Some(&BELOW) {
                0.0
            } else {
                5.0
            };
            let found: Vec<f64> = found.iter().copied().filter(|mm| *mm > from).collect();
            assert_eq!(found.len(), expected.len(), "K {k:e}, column {which}");
            for (mm, zero) in found.iter().zip(expected) {
                assert!((mm - zero).abs() < 1.0, "K {k:e}, column {which}: {mm}");
            }
        }
    }
}

//! Analytic derivatives against converged finite differences.

mod random;

use nalgebra::{Isometry3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use needle_model::Equilibrium;
use proptest::prelude::*;
use random::{State, state};

/// Twist of the base frame by `step`, about its own origin, in World axes.
fn moved(base: &Isometry3<f64>, k: usize, step: f64) -> Isometry3<f64> {
    let axis = Vector3::ith(k % 3, step);
    if k < 3 {
        return Isometry3::from_parts(
            Translation3::from(base.translation.vector + axis),
            base.rotation,
        );
    }
    Isometry3::from_parts(base.translation, UnitQuaternion::new(axis) * base.rotation)
}

fn solved(state: &State, base: &Isometry3<f64>) -> Equilibrium {
    let mut needle = Equilibrium::new(state.needle, *base);
    needle.set_tolerance(1e-12);
    needle.solve(base, &state.springs, state.load).unwrap();
    needle
}

/// Twist between two tip frames around a middle one, over `step`.
fn rate(plus: &Equilibrium, minus: &Equilibrium, step: f64) -> Vector6<f64> {
    let v = (plus.tip_position() - minus.tip_position()) / (2.0 * step);
    let turn = plus.world_from_tip().rotation * minus.world_from_tip().rotation.inverse();
    let w = turn.scaled_axis() / (2.0 * step);
    Vector6::new(v.x, v.y, v.z, w.x, w.y, w.z)
}

/// Differences of fourth order, of step `h`.
fn difference(state: &State, k: usize, h: f64) -> Vector6<f64> {
    let at = |s: f64| solved(state, &moved(&state.base, k, s));
    let one = rate(&at(h), &at(-h), h);
    let two = rate(&at(2.0 * h), &at(-2.0 * h), 2.0 * h);
    (one * 4.0 - two) / 3.0
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, rng_seed: proptest::test_runner::RngSeed::Fixed(3), ..ProptestConfig::default() })]

    #[test]
    fn tip_jacobian_matches_differences(state in state()) {
        let mut needle = solved(&state, &state.base);
        let jacobian = needle.tip_jacobian().unwrap();
        let mut numeric = Matrix6::zeros();
        for k in 0..6 {
            let h = if k < 3 { 2e-5 } else { 2e-4 };
            numeric.set_column(k, &difference(&state, k, h));
        }
        // Relative to the largest entry of each block of one unit, or a tenth of a rigid needle's.
        let l = state.needle.length();
        for (rows, columns, rigid) in [(0, 0, 1.0), (0, 3, l), (3, 0, 1.0 / l), (3, 3, 1.0)] {
            let a = jacobian.fixed_view::<3, 3>(rows, columns);
            let b = numeric.fixed_view::<3, 3>(rows, columns);
            let gap = (a - b).amax() / a.amax().max(0.1 * rigid);
            prop_assert!(gap < 1e-6, "block ({rows}, {columns}): {gap:e}\n{jacobian}{numeric}");
        }
    }
}

//! Analytic derivatives against converged finite differences.

#![expect(clippy::unwrap_used, reason = "a failed set-up fails the test")]

mod random;

use nalgebra::{DVector, Isometry3, Matrix6, Translation3, UnitQuaternion, Vector3, Vector6};
use needle_model::{Equilibrium, LOAD, PARAMETERS, STIFFNESS, Sensitivities};
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
    #![proptest_config(ProptestConfig { cases: 40, rng_seed: proptest::test_runner::RngSeed::Fixed(3), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn tip_jacobian_matches_differences(state in state()) {
        let gap = jacobian_gap(&state);
        prop_assert!(gap < 1e-6, "{gap:e}");
    }
}

/// Largest gap between analytic and numeric tip Jacobian, relative to each block of one unit.
fn jacobian_gap(state: &State) -> f64 {
    let jacobian = solved(state, &state.base).tip_jacobian().unwrap();
    let mut numeric = Matrix6::zeros();
    for k in 0..6 {
        let h = if k < 3 { 2e-5 } else { 2e-4 };
        numeric.set_column(k, &difference(state, k, h));
    }
    let l = state.needle.length();
    // The floor of a tenth of a rigid needle's: where stiff tissue holds the tip, the block is near 0.
    [(0, 0, 1.0), (0, 3, l), (3, 0, 1.0 / l), (3, 3, 1.0)]
        .into_iter()
        .map(|(rows, columns, rigid)| {
            let a = jacobian.fixed_view::<3, 3>(rows, columns);
            let b = numeric.fixed_view::<3, 3>(rows, columns);
            (a - b).amax() / a.amax().max(0.1 * rigid)
        })
        .fold(0.0, f64::max)
}

#[test]
fn named_base_motions_keep_the_jacobian_exact() {
    // A curved path 40 mm deep, every 2.5 mm; the base straight behind it.
    let needle = needle_model::Needle::biopsy();
    let springs = |factor: f64| -> Vec<_> {
        (0..16)
            .map(|i| {
                let s = 2.5e-3 * f64::from(i);
                needle_model::Spring {
                    rest: Vector3::new(1.2 * s * s, -0.7 * s * s, s),
                    stiffness: factor * 1e4 * 2.5e-3,
                }
            })
            .collect()
    };
    // 2.4 mm beyond the last spring, so that the retraction leaves all of them in use.
    let depth = 39.9e-3;
    let cases = [
        ("rotation", Vector3::zeros(), [0.0, 0.0, 2.0]),
        ("lateral motion", Vector3::new(5e-3, -4e-3, 0.0), [0.0; 3]),
        ("tilt", Vector3::zeros(), [0.1, -0.08, 0.0]),
        ("retraction", Vector3::new(0.0, 0.0, -1.2e-3), [0.0; 3]),
        ("all", Vector3::new(5e-3, -4e-3, -1.2e-3), [0.1, -0.08, 2.0]),
    ];
    for factor in [1.0, 10.0] {
        for (name, shift, [a, b, c]) in cases {
            let at = Vector3::z() * (depth - needle.length()) + shift;
            let state = State {
                needle,
                base: Isometry3::from_parts(
                    Translation3::from(at),
                    UnitQuaternion::from_euler_angles(a, b, c),
                ),
                springs: springs(factor),
                load: needle_model::TipLoad {
                    force: 0.015,
                    bending: 4.5e-6,
                },
            };
            let gap = jacobian_gap(&state);
            println!("{name}, stiffness x{factor}: {gap:e}");
            assert!(gap < 1e-6, "{name}, stiffness x{factor}: {gap:e}");
        }
    }
}

/// Everything that has a gradient, beside a characteristic size of each.
fn quantities(needle: &Equilibrium) -> DVector<f64> {
    let mut all = vec![
        needle.mean_stretch(),
        needle.tissue_energy(),
        needle.bending_energy(),
    ];
    all.extend(needle.entry_stretch().iter());
    all.extend(needle.entry_force().iter());
    all.extend(needle.base_wrench().iter());
    for s in POINTS {
        all.extend(needle.point(s * needle.needle().length()).iter());
    }
    DVector::from_vec(all)
}

const POINTS: [f64; 5] = [0.1, 0.5, 0.8, 0.97, 1.0];

fn gradients(needle: &Equilibrium, out: &Sensitivities) -> nalgebra::DMatrix<f64> {
    let points: Vec<_> = POINTS
        .iter()
        .map(|s| out.point(needle, s * needle.needle().length()))
        .collect();
    let mut rows: Vec<nalgebra::DMatrix<f64>> = vec![];
    let mut push = |m: &dyn Fn(usize, usize) -> f64, r: usize| {
        rows.push(nalgebra::DMatrix::from_fn(r, PARAMETERS, m));
    };
    let g = out.mean_stretch(needle);
    push(&|_, c| g[c], 1);
    let g = out.tissue_energy(needle);
    push(&|_, c| g[c], 1);
    let g = out.bending_energy(needle);
    push(&|_, c| g[c], 1);
    let g = out.entry_stretch();
    push(&|r, c| g[(r, c)], 3);
    let g = out.entry_force(needle);
    push(&|r, c| g[(r, c)], 3);
    let g = out.base_wrench(needle);
    push(&|r, c| g[(r, c)], 6);
    for p in &points {
        push(&|r, c| p[(r, c)], 3);
    }
    let mut all =
        nalgebra::DMatrix::zeros(rows.iter().map(nalgebra::DMatrix::nrows).sum(), PARAMETERS);
    let mut at = 0;
    for m in rows {
        all.rows_mut(at, m.nrows()).copy_from(&m);
        at += m.nrows();
    }
    all
}

/// The state with parameter `k` changed by `step`.
fn changed(state: &State, k: usize, step: f64) -> State {
    let mut other = state.clone();
    match k {
        STIFFNESS => other
            .springs
            .iter_mut()
            .for_each(|s| s.stiffness *= step.exp()),
        LOAD => other.load = other.load * step.exp(),
        _ => other.base = moved(&state.base, k, step),
    }
    other
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 40, rng_seed: proptest::test_runner::RngSeed::Fixed(5), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn all_gradients_match_differences(state in state()) {
        let mut needle = solved(&state, &state.base);
        let mut out = Sensitivities::default();
        needle.sensitivities(&mut out).unwrap();
        let analytic = gradients(&needle, &out);
        prop_assert!((out.tip_jacobian() - needle.tip_jacobian().unwrap()).amax() < 1e-9);
        let mut numeric = analytic.clone();
        for k in 0..PARAMETERS {
            let h = match k { 0..3 => 2e-5, 3..6 => 2e-4, _ => 4e-3 };
            let at = |s: f64| { let other = changed(&state, k, s); quantities(&solved(&other, &other.base)) };
            let one = (at(h) - at(-h)) / (2.0 * h);
            let two = (at(2.0 * h) - at(-2.0 * h)) / (4.0 * h);
            numeric.set_column(k, &((one * 4.0 - two) / 3.0));
        }
        // d_m has kinks where a stretch vanishes and where the last spring is as far behind the tip
        // as its predecessor behind it: no derivative to compare there.
        let lengths: Vec<f64> = needle.segment_lengths().collect();
        let born = (lengths[lengths.len() - 1] - lengths[lengths.len() - 2.min(lengths.len())]).abs();
        let least = needle.spring_points().zip(&state.springs).map(|(p, s)| (p.0 - s.rest).norm());
        let kinked = born < 2e-4 || least.fold(1.0, f64::min) < 3e-4;
        for r in usize::from(kinked)..analytic.nrows() {
            for (first, count) in [(0, 3), (3, 3), (6, 2)] {
                let a = analytic.view((r, first), (1, count));
                let b = numeric.view((r, first), (1, count));
                // Relative to the row's largest entry of that unit; rows that are 0 by symmetry
                // against the whole quantity.
                let block = if r < 3 { 1 } else { 3 };
                let from = if r < 3 { r } else { r / 3 * 3 };
                let size = analytic.view((from, first), (block, count)).amax();
                let floor = [1e-3, 1e-3, 1e-6][usize::from(first > 0) + usize::from(first > 3)];
                let gap = (a - b).amax() / size.max(floor);
                prop_assert!(gap < 1e-6, "row {r} columns {first}..: {gap:e}\n{a}{b}");
            }
        }
    }

    #[test]
    fn rest_point_derivatives_match_differences(state in state(), which in 0_usize..100, axis in 0_usize..3) {
        prop_assume!(!state.springs.is_empty());
        let i = which % state.springs.len();
        let mut needle = solved(&state, &state.base);
        let mut all = vec![];
        needle.tip_by_rest_points(&mut all).unwrap();
        prop_assert_eq!(all.len(), state.springs.len());
        let at = |step: f64| {
            let mut other = state.clone();
            other.springs[i].rest[axis] += step;
            solved(&other, &other.base)
        };
        let h = 2e-5;
        let one = rate(&at(h), &at(-h), h);
        let two = rate(&at(2.0 * h), &at(-2.0 * h), 2.0 * h);
        let (a, b) = (all[i].column(axis).into_owned(), (one * 4.0 - two) / 3.0);
        for first in [0, 3] {
            let gap = (a.rows(first, 3) - b.rows(first, 3)).amax();
            let size = all.iter().map(|m| m.rows(first, 3).amax()).fold(0.0, f64::max);
            prop_assert!(gap < 1e-6 * size, "{gap:e} of {size}\n{a}{b}");
        }
    }
}

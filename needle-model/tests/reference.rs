//! The frozen equilibria of `tests/data/needle` (see its README), through [`Case`].

#![expect(clippy::unwrap_used, reason = "a failed set-up fails the test")]

use needle_model::{Case, CaseError, EquilibriumError};
use serde_json::Value;

/// How far independent solvers of these equilibria lie from the reference, in m, rounded up
/// (`tests/data/needle/README.md`).
const FAIR_M: f64 = 1e-7;

fn numbers<const N: usize>(v: &Value) -> [f64; N] {
    std::array::from_fn(|i| v[i].as_f64().unwrap())
}

fn distance(a: &[f64; 3], b: &[f64; 3]) -> f64 {
    (0..3).map(|i| (a[i] - b[i]).powi(2)).sum::<f64>().sqrt()
}

fn cases() -> Vec<(Value, Case)> {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../tests/data/needle/ustk_equilibria.json"
    );
    let all: Vec<Value> = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    all.into_iter()
        .map(|value| {
            let f = |v: &Value| v.as_f64().unwrap();
            let needle = &value["needle"];
            let case = Case {
                length_m: f(&needle["length_m"]),
                outer_diameter_m: f(&needle["outer_diameter_m"]),
                inner_diameter_m: f(&needle["inner_diameter_m"]),
                young_modulus_pa: f(&needle["young_modulus_pa"]),
                world_from_base: std::array::from_fn(|r| numbers(&value["world_from_base"][r])),
                tip_force_n: f(&value["tip_force_n"]),
                tip_moment_nm: f(&value["tip_moment_nm"]),
                springs: value["springs"]
                    .as_array()
                    .unwrap()
                    .iter()
                    .map(|s| (numbers(&s["rest_m"]), f(&s["stiffness_n_per_m"])))
                    .collect(),
            };
            (value, case)
        })
        .collect()
}

#[test]
fn frozen_equilibria_agree() {
    let all = cases();
    assert_eq!(all.len(), 18);
    let (mut worst_tip, mut worst_point, mut worst_shape) = (0.0_f64, 0.0_f64, 0.0_f64);
    for (value, case) in &all {
        let name = &value["name"];
        let expected = &value["expected"];
        let shape = case.solve().unwrap();
        let tip = distance(&shape.tip_m, &numbers(&expected["tip_m"]));
        assert!(tip < FAIR_M, "{name}: tip {tip:e}");
        worst_tip = worst_tip.max(tip);
        let turned = distance(&shape.tip_direction, &numbers(&expected["tip_direction"]));
        // What moves the last two spring planes, 20 mm apart, by that much against each other.
        assert!(turned < FAIR_M / 20e-3, "{name}: direction {turned:e}");
        let points = expected["spring_points_m"].as_array().unwrap();
        assert_eq!(points.len(), shape.spring_points_m.len());
        for (point, reference) in shape.spring_points_m.iter().zip(points) {
            let gap = distance(point, &numbers(reference));
            assert!(gap < FAIR_M, "{name}: {gap:e}");
            worst_point = worst_point.max(gap);
        }
        // The reference samples at parameters; compare across the needle at its arc lengths.
        for sample in expected["shape"].as_array().unwrap() {
            let [s, x, y, z] = numbers::<4>(sample);
            let i = shape
                .shape
                .partition_point(|p| p[0] < s)
                .clamp(2, shape.shape.len() - 3);
            // Cubic interpolation of our samples: error below h^4 |S''''| / 40 = 1e-9 m.
            let nodes: Vec<_> = (i - 2..=i + 1).collect();
            let mut at = [0.0; 3];
            for &a in &nodes {
                let mut weight = 1.0;
                for &b in &nodes {
                    if a != b {
                        weight *= (s - shape.shape[b][0]) / (shape.shape[a][0] - shape.shape[b][0]);
                    }
                }
                for k in 0..3 {
                    at[k] += weight * shape.shape[a][k + 1];
                }
            }
            worst_shape = worst_shape.max(distance(&at, &[x, y, z]));
        }
    }
    println!("worst: tip {worst_tip:e}, spring points {worst_point:e}, shape {worst_shape:e} m");
    assert!(worst_shape < FAIR_M, "{worst_shape:e}");
}

#[test]
fn bad_cases_are_named() {
    let good = cases()[3].1.clone();
    let error = |change: &dyn Fn(&mut Case)| {
        let mut case = good.clone();
        change(&mut case);
        case.solve().unwrap_err()
    };
    let text = error(&|c| c.length_m = f64::NAN).to_string();
    assert!(text.contains("length_m") && text.contains("NaN"), "{text}");
    let text = error(&|c| c.outer_diameter_m = -1.0).to_string();
    assert!(
        text.contains("outer_diameter_m") && text.contains("-1"),
        "{text}"
    );
    let text = error(&|c| c.springs[4].1 = 0.0).to_string();
    assert!(
        text.contains("springs[4]") && text.contains("stiffness_n_per_m"),
        "{text}"
    );
    let text = error(&|c| c.springs[2].0[1] = f64::INFINITY).to_string();
    assert!(
        text.contains("springs[2]") && text.contains("rest_m[1]"),
        "{text}"
    );
    let text = error(&|c| c.world_from_base[1][3] = f64::NAN).to_string();
    assert!(text.contains("world_from_base[1][3]"), "{text}");
    assert!(matches!(
        error(&|c| c.world_from_base[0][0] = 2.0),
        CaseError::Rotation { .. }
    ));
    assert!(matches!(
        error(&|c| c.world_from_base[3][0] = 1.0),
        CaseError::PoseLastRow
    ));
    assert!(matches!(
        error(&|c| c.tip_moment_nm = f64::NAN),
        CaseError::TipLoad { .. }
    ));
    assert!(matches!(
        error(&|c| c.springs.swap(3, 4)),
        CaseError::Equilibrium(EquilibriumError::Order { index: 4, .. })
    ));
    assert!(matches!(
        error(&|c| c.springs[0].0[2] = -0.2),
        CaseError::Equilibrium(EquilibriumError::BehindBase { index: 0, .. })
    ));
    assert!(matches!(
        error(&|c| c.length_m = 0.12),
        CaseError::Equilibrium(EquilibriumError::TooShort { .. })
    ));
}

//! The frozen equilibria of `tests/data/needle` (see its README).
use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};
use needle_model::{Equilibrium, Needle, Spring, TipLoad};
use serde_json::Value;

fn vector(v: &Value) -> Vector3<f64> {
    Vector3::from_fn(|i, _| v[i].as_f64().unwrap())
}

#[test]
fn frozen_equilibria_agree() {
    let path = concat!(
        env!("CARGO_MANIFEST_DIR"),
        "/../tests/data/needle/ustk_equilibria.json"
    );
    let cases: Value = serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap();
    for case in cases.as_array().unwrap() {
        let m = &case["world_from_base"];
        let rotation = Matrix3::from_fn(|r, c| m[r][c].as_f64().unwrap());
        let translation = Translation3::from(Vector3::from_fn(|r, _| m[r][3].as_f64().unwrap()));
        let rotation =
            UnitQuaternion::from_rotation_matrix(&Rotation3::from_matrix_unchecked(rotation));
        let base = Isometry3::from_parts(translation, rotation);
        let springs: Vec<_> = case["springs"]
            .as_array()
            .unwrap()
            .iter()
            .map(|s| Spring {
                rest: vector(&s["rest_m"]),
                stiffness: s["stiffness_n_per_m"].as_f64().unwrap(),
            })
            .collect();
        let load = TipLoad {
            force: -case["tip_force_n"].as_f64().unwrap(),
            bending: case["tip_moment_nm"].as_f64().unwrap(),
        };
        let mut eq = Equilibrium::new(Needle::biopsy(), base);
        let c = eq.solve(&base, &springs, load).unwrap();
        let e = &case["expected"];
        let tip = (eq.tip_position() - vector(&e["tip_m"])).norm();
        let dir = (eq.tip_axis() - vector(&e["tip_direction"])).norm();
        let x = (eq.world_from_tip() * Vector3::x() - vector(&e["tip_x_axis"])).norm();
        let pts = eq
            .spring_points()
            .enumerate()
            .map(|(i, (p, _))| (p - vector(&e["spring_points_m"][i])).norm())
            .fold(0.0, f64::max);
        println!(
            "{:40} it {} res {:.1e} tip {:.2e} dir {:.1e} x {:.1e} pts {:.2e} len {:.1e}",
            case["name"].as_str().unwrap(),
            c.iterations,
            c.residual,
            tip,
            dir,
            x,
            pts,
            eq.segment_lengths().sum::<f64>() - 0.126
        );
        assert!(tip < 1e-6 && pts < 1e-7);
    }
}

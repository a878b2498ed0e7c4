//! Forward kinematics and Jacobians against reference data computed with ViSP and with an
//! independent reading of the same URDF (tests/data/viper/README.md).
#![expect(clippy::unwrap_used, reason = "a helper that fails fails its test")]

use hal::Joints;
use nalgebra::{Isometry3, Matrix6, Translation3, UnitQuaternion, Vector3};
use robots::arms::{FLANGE, NEEDLE_BASE, VIPER_S650};
use robots::kinematics::Chain;

/// Rounding in six rotations and in the printed reference stays two orders below this.
const TOLERANCE: f64 = 1e-12;
/// ViSP's end effector sits on a tool changer of this length \[m\].
const TOOL_CHANGER: f64 = 0.1016;

struct Row {
    label: String,
    q: Joints,
    values: Vec<f64>,
}

fn rows(csv: &str) -> Vec<Row> {
    let rows: Vec<Row> = csv
        .lines()
        .skip(1)
        .map(|line| {
            let fields: Vec<&str> = line.split(',').collect();
            let numbers: Vec<f64> = fields[2..].iter().map(|x| x.parse().unwrap()).collect();
            Row {
                label: fields[1].to_owned(),
                q: Joints::from_slice(&numbers[..6]).unwrap(),
                values: numbers[6..].to_vec(),
            }
        })
        .collect();
    assert!(rows.len() >= 12, "the reference has 12 joint vectors");
    rows
}

fn assert_pose(pose: &Isometry3<f64>, row: &Row) {
    let matrix = pose.to_homogeneous();
    for (k, expected) in row.values.iter().enumerate() {
        let (i, j) = (k / 4, k % 4);
        let error = (matrix[(i, j)] - expected).abs();
        assert!(
            error < TOLERANCE,
            "{} {:?} ({i},{j}): {error:e}",
            row.label,
            row.q
        );
    }
}

fn assert_jacobian(jacobian: &Matrix6<f64>, row: &Row) {
    for (k, expected) in row.values.iter().enumerate() {
        let (i, j) = (k / 6, k % 6);
        let error = (jacobian[(i, j)] - expected).abs();
        assert!(
            error < TOLERANCE,
            "{} {:?} ({i},{j}): {error:e}",
            row.label,
            row.q
        );
    }
}

fn along_z(offset: f64) -> Isometry3<f64> {
    Isometry3::from_parts(
        Translation3::new(0.0, 0.0, offset),
        UnitQuaternion::identity(),
    )
}

/// The flange's Jacobian moved to a point `offset` further along the flange's z.
fn jacobian_at(chain: &Chain, q: &Joints, offset: f64) -> Matrix6<f64> {
    let (pose, jacobian) = chain.forward_jacobian(q);
    let lever = pose.rotation * Vector3::new(0.0, 0.0, offset);
    let mut moved: Matrix6<f64> = jacobian.fixed_columns::<6>(0).into_owned();
    for mut column in moved.column_iter_mut() {
        let angular: Vector3<f64> = column.fixed_rows::<3>(3).into_owned();
        let mut linear = column.fixed_rows_mut::<3>(0);
        linear += angular.cross(&lever);
    }
    moved
}

#[test]
fn flange_equals_the_reference_of_the_urdf() {
    let chain = Chain::from_urdf(VIPER_S650, FLANGE).unwrap();
    for row in rows(include_str!("../../tests/data/viper/urdf_flange_fk.csv")) {
        assert_pose(&chain.forward(&row.q), &row);
    }
    for row in rows(include_str!("../../tests/data/viper/urdf_flange_jac.csv")) {
        assert_jacobian(&jacobian_at(&chain, &row.q, 0.0), &row);
    }
}

#[test]
fn wrist_and_end_effector_equal_visp() {
    let chain = Chain::from_urdf(VIPER_S650, FLANGE).unwrap();
    for row in rows(include_str!("../../tests/data/viper/visp_fk.csv")) {
        let offset = match row.label.as_str() {
            "fMw" => -0.080,
            "fMe" => TOOL_CHANGER,
            other => panic!("unknown frame {other}"),
        };
        assert_pose(&(chain.forward(&row.q) * along_z(offset)), &row);
    }
    for row in rows(include_str!("../../tests/data/viper/visp_jac.csv")) {
        let jacobian = match row.label.as_str() {
            "fJw" => jacobian_at(&chain, &row.q, -0.080),
            "fJe" => jacobian_at(&chain, &row.q, TOOL_CHANGER),
            "eJe" => {
                let e_from_base = chain.forward(&row.q).rotation.inverse();
                let r = e_from_base.to_rotation_matrix();
                let mut turn = Matrix6::zeros();
                turn.fixed_view_mut::<3, 3>(0, 0).copy_from(r.matrix());
                turn.fixed_view_mut::<3, 3>(3, 3).copy_from(r.matrix());
                turn * jacobian_at(&chain, &row.q, TOOL_CHANGER)
            }
            other => panic!("unknown Jacobian {other}"),
        };
        assert_jacobian(&jacobian, &row);
    }
}

#[test]
fn needle_base_lies_60_mm_out_of_the_flange() {
    let flange = Chain::from_urdf(VIPER_S650, FLANGE).unwrap();
    let needle = Chain::from_urdf(VIPER_S650, NEEDLE_BASE).unwrap();
    let q = Joints::from([0.3, -0.9, 2.2, 0.4, 0.8, -1.1]);
    let relative = flange.forward(&q).inverse() * needle.forward(&q);
    assert!((relative.translation.vector - Vector3::new(0.0, 0.0, 0.060)).norm() < TOLERANCE);
    assert!(relative.rotation.angle() < TOLERANCE);
}

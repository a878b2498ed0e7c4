//! Insertions: independence of steps, continuity, the hole, rest points, refusals.

#![expect(clippy::unwrap_used, reason = "a failed set-up fails the test")]
#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "counts of steps from lengths"
)]

use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use needle_model::{
    Bevel, Insertion, InsertionError, InsertionSettings, Layer, Needle, RestPoint, Tissue,
};

fn base_at(depth: f64) -> Isometry3<f64> {
    Isometry3::translation(0.0, 0.0, depth - Needle::biopsy().length())
}

fn bevel() -> Bevel {
    Bevel::plane_cut(24_f64.to_radians(), 0.7e-3).unwrap()
}

fn start(settings: InsertionSettings) -> Insertion {
    let tissue = Tissue::uniform(Vector3::zeros(), Vector3::z(), 1e4).unwrap();
    Insertion::new(Needle::biopsy(), bevel(), tissue, settings, &base_at(0.0)).unwrap()
}

fn with(rest_point: RestPoint) -> InsertionSettings {
    InsertionSettings {
        rest_point,
        ..InsertionSettings::default()
    }
}

fn inserted(settings: InsertionSettings, step: f64, depth: f64) -> Insertion {
    let mut insertion = start(settings);
    let steps = (depth / step).round() as usize;
    for i in 1..=steps {
        insertion
            .insert(&base_at(depth * i as f64 / steps as f64), None)
            .unwrap();
    }
    insertion
}

#[test]
fn the_step_size_does_not_matter() {
    for rest_point in [RestPoint::ModelCentre, RestPoint::CuttingEdge] {
        let tip = |step| {
            inserted(with(rest_point), step, 0.08)
                .equilibrium()
                .tip_position()
        };
        let fine = tip(0.02e-3);
        println!("{rest_point:?}: tip {fine:?}");
        for step in [0.1e-3, 0.37e-3, 1e-3] {
            let gap = (tip(step) - fine).norm();
            println!("step {step}: {gap:e} m");
            assert!(gap < 5e-6, "step {step}: {gap:e}");
        }
    }
}

/// Orders of convergence of the tip with the spring pitch, halved from 5 mm, 80 mm deep.
fn orders_in_the_pitch(k_t: f64, rest_point: RestPoint) -> Vec<f64> {
    let tip = |halvings: i32| {
        let settings = InsertionSettings {
            pitch: 5e-3 * 0.5_f64.powi(halvings),
            ..with(rest_point)
        };
        let tissue = Tissue::uniform(Vector3::zeros(), Vector3::z(), k_t).unwrap();
        let needle = Needle::biopsy();
        let mut insertion =
            Insertion::new(needle, bevel(), tissue, settings, &base_at(0.0)).unwrap();
        for i in 1..=80 {
            insertion
                .insert(&base_at(1e-3 * f64::from(i)), None)
                .unwrap();
        }
        insertion.equilibrium().tip_position()
    };
    let tips: Vec<_> = (0..6).map(tip).collect();
    tips.windows(3)
        .map(|t| ((t[0] - t[1]).norm() / (t[1] - t[2]).norm()).log2())
        .collect()
}

#[test]
fn the_entry_sets_the_order_of_convergence_in_the_pitch() {
    let needle = Needle::biopsy();
    for rest_point in [RestPoint::ModelCentre, RestPoint::CuttingEdge] {
        for k_t in [1e3, 1e4] {
            let entry = 3.0 * needle.bending_stiffness() / (k_t * needle.length().powi(3));
            let orders = orders_in_the_pitch(k_t, rest_point);
            println!(
                "{rest_point:?}, K {k_t:e}, entry length {:.2} mm: orders {orders:.2?} from 5 mm on",
                entry * 1e3
            );
            // At least first order once the pitch resolves the entry, far less before.
            let mut finest = 2.5e-3;
            for order in &orders {
                finest /= 2.0;
                if finest < 0.7 * entry {
                    assert!(*order > 0.95, "pitch {finest}: {order}");
                }
            }
            assert!(orders.is_sorted(), "{orders:?}");
        }
    }
}

#[test]
fn births_do_not_move_the_tip() {
    for rest_point in [RestPoint::ModelCentre, RestPoint::CuttingEdge] {
        let mut insertion = start(with(rest_point));
        let (step, mut tips, mut springs) = (0.004e-3, vec![], vec![]);
        for i in 1..=7450 {
            insertion
                .insert(&base_at(step * f64::from(i)), None)
                .unwrap();
            tips.push(insertion.equilibrium().tip_position());
            springs.push(insertion.equilibrium().springs().len());
        }
        let mut births = 0;
        for i in 3..tips.len() {
            if springs[i] == springs[i - 1] || springs[i - 1] == 0 {
                continue;
            }
            births += 1;
            // Beyond the steady motion of the steps before; a jump does not shrink with the step.
            let jump = (tips[i] - tips[i - 1] - (tips[i - 1] - tips[i - 2])).norm();
            assert!(jump < 1e-6, "birth {births}: {jump:e}");
        }
        assert_eq!(births, 11);
    }
}

#[test]
fn the_hole_is_kept() {
    let mut insertion = inserted(with(RestPoint::CuttingEdge), 0.5e-3, 0.05);
    let (tip, springs) = {
        let needle = insertion.equilibrium();
        (needle.tip_position(), needle.springs().to_vec())
    };
    for depth in [0.045, 0.04, 0.031, 0.02] {
        insertion.move_base(&base_at(depth)).unwrap();
    }
    assert_eq!(
        insertion.equilibrium().springs().len() + insertion.springs_ahead(),
        springs.len()
    );
    assert!(insertion.springs_ahead() >= 11);
    let away = (insertion.equilibrium().tip_position() - tip).norm();
    assert!(away > 0.029, "{away}");
    for depth in [0.0333, 0.041, 0.05] {
        insertion.insert(&base_at(depth), None).unwrap();
    }
    assert_eq!(insertion.springs_ahead(), 0);
    let needle = insertion.equilibrium();
    for (now, then) in needle.springs().iter().zip(&springs) {
        assert_eq!(now.rest, then.rest);
        assert!((now.stiffness - then.stiffness).abs() < 1e-6 * then.stiffness);
    }
    let gap = (needle.tip_position() - tip).norm();
    assert!(gap < 1e-8, "{gap:e}");
    // Out of the tissue altogether, and in again through the same hole.
    insertion.move_base(&base_at(-0.005)).unwrap();
    assert!(insertion.equilibrium().springs().is_empty());
    insertion.insert(&base_at(0.05), None).unwrap();
    let gap = (insertion.equilibrium().tip_position() - tip).norm();
    assert!(gap < 1e-8, "{gap:e}");
}

#[test]
fn moving_the_base_cuts_nothing() {
    let mut insertion = inserted(with(RestPoint::ModelCentre), 1e-3, 0.0301);
    let count = insertion.equilibrium().springs().len();
    let mut aside = base_at(0.034);
    aside.translation.vector.x += 2e-3;
    insertion.move_base(&aside).unwrap();
    assert_eq!(insertion.equilibrium().springs().len(), count);
    insertion.insert(&aside, None).unwrap();
    assert!(insertion.equilibrium().springs().len() > count);
}

#[test]
fn springs_are_born_at_the_measured_tip() {
    let mut insertion = start(InsertionSettings::default());
    let offset = Vector3::new(0.2e-3, -0.1e-3, 0.3e-3);
    for i in 1..=26 {
        let base = base_at(1e-3 * f64::from(i));
        let model = insertion.equilibrium().tip_position() + Vector3::z() * 1e-3;
        insertion.insert(&base, Some(model + offset)).unwrap();
    }
    let needle = insertion.equilibrium();
    let (rest, reach) = (
        needle.springs()[0].rest,
        needle.spring_points().next().unwrap(),
    );
    // Where it was measured across the axis, on the surface along it.
    assert!(
        (rest.x - offset.x).abs() < 1e-5 && rest.z.abs() < 1e-5,
        "{rest:?} {reach:?}"
    );
    assert!(needle.tip_position().x > 0.1e-3);
}

#[test]
fn the_rest_point_decides_the_deflection() {
    let tip = |r| inserted(with(r), 1e-3, 0.08).equilibrium().tip_position().y;
    let (centre, edge) = (tip(RestPoint::ModelCentre), tip(RestPoint::CuttingEdge));
    println!(
        "deflection at 80 mm: centre {centre:e}, edge {edge:e}, ratio {}",
        edge / centre
    );
    // Both bend in the bevel direction.
    assert!(centre < 0.0 && edge < 3.0 * centre);
}

#[test]
fn the_bevel_turns_with_the_base() {
    let settings = with(RestPoint::CuttingEdge);
    let tip = inserted(settings, 1e-3, 0.04).equilibrium().tip_position();
    let roll = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), 1.1);
    let tissue = Tissue::uniform(Vector3::zeros(), Vector3::z(), 1e4).unwrap();
    let turned = |depth| base_at(depth) * roll;
    let needle = Needle::biopsy();
    let mut other = Insertion::new(needle, bevel(), tissue, settings, &turned(0.0)).unwrap();
    for i in 1..=40 {
        other.insert(&turned(1e-3 * f64::from(i)), None).unwrap();
    }
    assert!((other.equilibrium().tip_position() - roll * tip).norm() < 1e-9);
}

#[test]
fn a_stiffer_layer_is_felt_at_its_depth() {
    let layers = vec![
        Layer {
            from_depth: 0.0,
            stiffness: 5e3,
        },
        Layer {
            from_depth: 0.02,
            stiffness: 5e4,
        },
    ];
    let tissue = Tissue::layered(Vector3::zeros(), Vector3::z(), layers).unwrap();
    let needle = Needle::biopsy();
    let settings = with(RestPoint::ModelCentre);
    let mut insertion = Insertion::new(needle, bevel(), tissue, settings, &base_at(0.0)).unwrap();
    insertion.insert(&base_at(0.04), None).unwrap();
    let springs = insertion.equilibrium().springs();
    // To the change of the gaps since the births.
    assert!((springs[4].stiffness / (5e3 * 2.5e-3) - 1.0).abs() < 0.01);
    assert!((springs[12].stiffness / (5e4 * 2.5e-3) - 1.0).abs() < 0.01);
    let before = springs[4].stiffness;
    insertion.rescale(2.0, 0.5).unwrap();
    assert!((insertion.equilibrium().springs()[4].stiffness / before - 2.0).abs() < 1e-3);
}

#[test]
fn failures_leave_the_needle_where_it_was() {
    let mut insertion = inserted(with(RestPoint::CuttingEdge), 1e-3, 0.04);
    let tip = insertion.equilibrium().tip_position();
    let nan = Isometry3::translation(f64::NAN, 0.0, 0.0);
    assert_eq!(insertion.insert(&nan, None), Err(InsertionError::BasePose));
    let measured = Some(Vector3::new(0.0, f64::INFINITY, 0.0));
    assert_eq!(
        insertion.insert(&base_at(0.04), measured),
        Err(InsertionError::MeasuredTip)
    );
    // The holder cannot pass through the tissue.
    let folded = Isometry3::from_parts(
        Translation3::new(0.0, 0.0, 0.2),
        UnitQuaternion::from_euler_angles(2.8, 0.0, 0.0),
    );
    assert!(insertion.insert(&folded, None).is_err());
    let gap = (insertion.equilibrium().tip_position() - tip).norm();
    assert!(gap < 1e-7, "{gap:e}");
    let bad = InsertionSettings {
        pitch: 0.0,
        ..InsertionSettings::default()
    };
    let tissue = Tissue::uniform(Vector3::zeros(), Vector3::z(), 1e4).unwrap();
    let needle = Needle::biopsy();
    let refused = Insertion::new(needle, bevel(), tissue.clone(), bad, &base_at(0.0));
    assert!(matches!(
        refused,
        Err(InsertionError::Setting { name: "pitch", .. })
    ));
    let settings = InsertionSettings::default();
    let refused = Insertion::new(needle, bevel(), tissue, settings, &base_at(0.01));
    assert!(matches!(refused, Err(InsertionError::StartsInside { .. })));
}

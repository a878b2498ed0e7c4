//! Closed forms: cantilever, beam on an elastic foundation; convergence with spring spacing.

#![expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "counts of springs from lengths"
)]

use nalgebra::{Isometry3, Vector3};
use needle_model::{
    Bevel, Equilibrium, Insertion, InsertionSettings, Needle, RestPoint, Spring, TipLoad, Tissue,
};

#[test]
fn a_free_needle_is_a_cantilever() {
    let needle = Needle::biopsy();
    let (l, ei) = (needle.length(), needle.bending_stiffness());
    let base = Isometry3::identity();
    let mut free = Equilibrium::new(needle, base);
    let (force, bending) = (2e-4, 5e-6);
    free.solve(&base, &[], TipLoad { force, bending }).unwrap();
    let deflection = force * l.powi(3) / (3.0 * ei) + bending * l * l / (2.0 * ei);
    let slope = force * l * l / (2.0 * ei) + bending * l / ei;
    // Slope 1.2e-3: second order is 1e-6.
    assert!((free.tip_position().y / deflection - 1.0).abs() < 3e-6);
    assert!((free.tip_axis().y / slope - 1.0).abs() < 3e-6);
    let wrench = free.base_wrench();
    assert!((wrench[1] + force).abs() < 1e-9 && (wrench[3] - (force * l + bending)).abs() < 1e-9);
    let energy = (bending.powi(2) * l + bending * force * l * l + force.powi(2) * l.powi(3) / 3.0)
        / (2.0 * ei);
    assert!((free.bending_energy() / energy - 1.0).abs() < 1e-5);
}

/// Largest error against w = d exp(-x / lambda) (cos x / lambda + sin x / lambda) for a clamped base
/// moved aside by d, needle all in tissue, springs `h` apart.
fn foundation_error(h: f64) -> f64 {
    let needle = Needle::new(0.3, 0.7e-3, 0.48e-3, 200e9).unwrap();
    let (k, d) = (5e4, 1e-5);
    let lambda = (4.0 * needle.bending_stiffness() / k).powf(0.25);
    let base = Isometry3::translation(d, 0.0, 0.0);
    let count = (0.3 / h).round() as usize - 1;
    let springs: Vec<_> = (0..count)
        .map(|i| Spring {
            rest: Vector3::z() * (h * (i as f64 + 0.5)),
            stiffness: k * h,
        })
        .collect();
    let mut beam = Equilibrium::new(needle, base);
    beam.solve(&base, &springs, TipLoad::default()).unwrap();
    let exact = |x: f64| d * (-x / lambda).exp() * ((x / lambda).cos() + (x / lambda).sin());
    beam.spring_points()
        .map(|(p, _)| (p.x - exact(p.z)).abs() / d)
        .fold(0.0, f64::max)
}

#[test]
fn a_needle_in_tissue_is_a_beam_on_an_elastic_foundation() {
    let errors = [5e-3, 2.5e-3, 1.25e-3].map(foundation_error);
    let order = (errors[0] / errors[2]).log2() / 2.0;
    println!("relative errors at 5, 2.5, 1.25 mm: {errors:?}; order {order:.2}");
    assert!(errors[1] < 2e-3 && order > 1.8, "{errors:?} {order}");
}

#[test]
fn an_insertion_converges_with_spring_spacing() {
    let needle = Needle::biopsy();
    let base = |depth: f64| Isometry3::translation(0.0, 0.0, depth - needle.length());
    let tip = |pitch: f64, rest_point: RestPoint| {
        let settings = InsertionSettings {
            pitch,
            rest_point,
            ..InsertionSettings::default()
        };
        let tissue = Tissue::uniform(Vector3::zeros(), Vector3::z(), 1e4).unwrap();
        let bevel = Bevel::plane_cut(24_f64.to_radians(), 0.7e-3).unwrap();
        let mut insertion = Insertion::new(needle, bevel, tissue, settings, &base(0.0)).unwrap();
        for i in 1..=60 {
            insertion.insert(&base(1e-3 * f64::from(i)), None).unwrap();
        }
        insertion.equilibrium().tip_position().y
    };
    // Slowly (about the root of the pitch): what is cut remembers how far the tip had been pushed.
    for rest_point in [RestPoint::CuttingEdge, RestPoint::ModelCentre] {
        let y = [5e-3, 2.5e-3, 1.25e-3, 0.625e-3].map(|pitch| tip(pitch, rest_point));
        let steps = [y[0] - y[1], y[1] - y[2], y[2] - y[3]];
        let order = (steps[0] / steps[2]).abs().log2() / 2.0;
        println!("{rest_point:?}: tip {y:?} m, order {order:.2}");
        assert!(order > 0.25, "{rest_point:?} {order}");
    }
}

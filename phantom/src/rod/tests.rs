//! The rod against closed forms.

use nalgebra::Vector3;

use super::band::Band;
use super::{Load, Rod, Section};

const LENGTH: f64 = 0.126;

fn steel() -> Section {
    Section::tube(0.70e-3, 0.48e-3, 200e9, 77e9)
}

fn needle(edges: usize) -> Rod {
    Rod::straight(steel(), LENGTH, edges, Vector3::zeros(), Vector3::z())
}

/// A constant force on the last node.
struct DeadForce(Vector3<f64>);

impl Load for DeadForce {
    fn add(&mut self, _: &[Vector3<f64>], force: &mut [Vector3<f64>], _: &mut Band) {
        if let Some(last) = force.last_mut() {
            *last += self.0;
        }
    }
}

/// Springs that hold the last nodes at given points, and a constant force on the last one.
struct Held {
    targets: Vec<Vector3<f64>>,
    stiffness: Vector3<f64>,
    push: Vector3<f64>,
}

impl Load for Held {
    fn add(&mut self, nodes: &[Vector3<f64>], force: &mut [Vector3<f64>], stiffness: &mut Band) {
        let last = nodes.len() - 1;
        let first = nodes.len() - self.targets.len();
        for (i, target) in (first..=last).zip(&self.targets) {
            force[i] += self.stiffness.component_mul(&(target - nodes[i]));
            stiffness.add_diagonal(i - 1, &nalgebra::Matrix3::from_diagonal(&self.stiffness));
        }
        force[last] += self.push;
    }
}

#[test]
fn section_is_the_needle_of_the_paper() {
    // phantom.md: EI = 1.836e-3, GJ = 1.414e-3 N m2, to the digits given.
    assert!((steel().bending - 1.836e-3).abs() < 5e-7);
    assert!((steel().torsion - 1.414e-3).abs() < 5e-7);
}

#[test]
fn cantilever_deflects_by_f_l3_over_3ei() {
    let mut rod = needle(252);
    let force = 1e-3;
    let solution = rod.relax(&mut DeadForce(Vector3::x() * force));
    assert!(solution.converged && solution.stable);
    let expected = force * LENGTH.powi(3) / (3.0 * rod.section.bending);
    // Slope 4e-3: the linear formula is right to 1e-5; the mesh to 1 / (4 n^2) of it.
    let tip = rod.nodes[252].x;
    assert!((tip / expected - 1.0).abs() < 3e-5, "{tip} {expected}");
    let moment = rod.bending_moment(0);
    assert!((moment + Vector3::y() * force * LENGTH).norm() < 1e-3 * force * LENGTH);
    assert!((rod.clamp_force() + Vector3::x() * force).norm() < 1e-12);
}

/// Incomplete elliptic integrals F and E of modulus p from `from` to `to`, by Simpson's rule.
fn elliptic(p: f64, from: f64, to: f64) -> (f64, f64) {
    let n = 2000;
    let h = (to - from) / f64::from(n);
    let mut sums = (0.0, 0.0);
    for i in 0..=n {
        let weight = match i {
            0 => 1.0,
            i if i == n => 1.0,
            i if i % 2 == 1 => 4.0,
            _ => 2.0,
        };
        let root = (1.0 - (p * (from + h * f64::from(i)).sin()).powi(2)).sqrt();
        sums.0 += weight / root;
        sums.1 += weight * root;
    }
    (sums.0 * h / 3.0, sums.1 * h / 3.0)
}

/// Tip deflection over length of a cantilever under a dead force across it (Bisshopp and
/// Drucker 1945): `load` = F L^2 / E I.
fn elastica(load: f64) -> (f64, f64) {
    let quarter = core::f64::consts::FRAC_PI_2;
    let start = |p: f64| (1.0 / (p * 2f64.sqrt())).asin();
    let (mut low, mut high) = (0.5f64.sqrt() + 1e-12, 1.0 - 1e-12);
    for _ in 0..100 {
        let p = 0.5 * (low + high);
        if elliptic(p, start(p), quarter).0 < load.sqrt() {
            low = p;
        } else {
            high = p;
        }
    }
    let (f, e) = elliptic(low, start(low), quarter);
    let sin_tip = 2.0 * low * low - 1.0;
    let across = 1.0 - 2.0 * e / f;
    let along = (2.0 * sin_tip / load).sqrt();
    (across, along)
}

fn elastica_error(edges: usize, load: f64) -> f64 {
    let mut rod = needle(edges);
    // The closed form is for an inextensible rod; steel stretches by 1e-5 under this force.
    rod.section.axial *= 1e3;
    let force = load * rod.section.bending / (LENGTH * LENGTH);
    for step in 1..=10 {
        let share = f64::from(step) / 10.0;
        let solution = rod.relax(&mut DeadForce(Vector3::x() * force * share));
        assert!(solution.converged, "{solution:?}");
    }
    let (across, along) = elastica(load);
    let tip = rod.nodes[edges] / LENGTH;
    (tip.x - across).hypot(tip.z - along)
}

#[test]
fn elastica_at_large_rotation_and_its_order_in_the_element() {
    // The tip turns by 26, 45 and 72 degrees.
    for load in [1.0, 2.0, 5.0] {
        let error = elastica_error(252, load);
        assert!(error < 3e-5, "load {load}: {error}");
    }
    let coarse = elastica_error(32, 5.0);
    let fine = elastica_error(64, 5.0);
    let order = (coarse / fine).log2();
    assert!((order - 2.0).abs() < 0.1, "order {order}");
}

#[test]
fn buckling_load_of_the_clamped_pinned_needle() {
    let edges = 252;
    // First root of tan x = x, squared.
    let expected = 4.493_409_457_909_064_f64.powi(2) * steel().bending / (LENGTH * LENGTH);
    let stable = |push: f64| {
        let mut rod = needle(edges);
        let mut load = Held {
            targets: vec![rod.nodes[edges]],
            stiffness: Vector3::new(1e6, 1e6, 0.0),
            push: -Vector3::z() * push,
        };
        rod.relax(&mut load).stable
    };
    let (mut low, mut high) = (0.5 * expected, 1.5 * expected);
    for _ in 0..30 {
        let push = 0.5 * (low + high);
        if stable(push) {
            low = push;
        } else {
            high = push;
        }
    }
    assert!((expected - 2.33).abs() < 0.01);
    assert!(
        (low / expected - 1.0).abs() < 0.01,
        "{low} N, expected {expected} N"
    );
}

/// A helix of the given Frenet curvature and torsion that starts along z.
fn helix(curvature: f64, torsion: f64, edges: usize) -> Vec<Vector3<f64>> {
    let w = curvature.hypot(torsion);
    let (radius, rise) = (curvature / (w * w), torsion / w);
    let at = |s: f64| {
        Vector3::new(
            radius * (w * s).cos() - radius,
            radius * (w * s).sin(),
            rise * s,
        )
    };
    // Tangent at 0 is (0, radius w, rise): turn it to z about x.
    let turn = nalgebra::Rotation3::from_axis_angle(&Vector3::x_axis(), (radius * w).atan2(rise));
    (0..=edges)
        .map(|i| turn * at(LENGTH / edges as f64 * i as f64))
        .collect()
}

/// Worst distance from the exact helix \[m\] of a rod clamped into it at the base, held in it at
/// its last two nodes and twisted by `torque`; and the clamp's force along the helix's axis \[N\].
fn helical(curvature: f64, torsion: f64, torque: f64, edges: usize) -> (f64, f64) {
    let mut rod = needle(edges);
    rod.torque.fill(torque);
    // The last rounds only polish: the springs are too stiff for a force after a long step.
    for step in 1..=14 {
        let share = (f64::from(step) / 8.0).min(1.0);
        let solution = rod.relax(&mut Held {
            targets: helix(curvature * share, torsion, edges)[edges - 1..].to_vec(),
            stiffness: Vector3::repeat(1e10),
            push: Vector3::zeros(),
        });
        assert!(solution.converged && solution.stable, "{solution:?}");
    }
    let exact = helix(curvature, torsion, edges);
    let worst = rod
        .nodes
        .iter()
        .zip(&exact)
        .fold(0.0f64, |m, (a, b)| m.max((a - b).norm()));
    let axis = Vector3::new(0.0, -curvature, torsion) / curvature.hypot(torsion);
    let force = rod.clamp_force();
    assert!((force - axis * axis.dot(&force)).norm() < 0.02, "{force}");
    (worst, axis.dot(&force))
}

/// Kirchhoff's helical rod: with bending moment EI k b and twisting moment T t, balance asks for
/// the force w (T - EI torsion) along the axis, w^2 = k^2 + torsion^2; none for T = EI torsion.
#[test]
fn helix_under_force_and_moment() {
    let (curvature, torsion) = (6.0, 4.0);
    let matching = steel().bending * torsion;
    let unit = matching * f64::hypot(curvature, torsion);
    for share in [0.0, 1.0, 2.0, -1.0] {
        let (gap, force) = helical(curvature, torsion, share * matching, 252);
        println!(
            "T = {share} EI torsion: off by {gap:.1e} m, force {:.4}",
            force / unit
        );
        assert!(gap < 2e-6, "{gap}");
        // By the clamp on the rod, hence the sign.
        assert!(
            (force / unit + (share - 1.0)).abs() < 0.02,
            "{force} of {unit}"
        );
    }
}

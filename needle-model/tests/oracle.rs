//! The paper's 12 (N + 1) equations solved densely (faer), planes, lengths and tip frame iterated to
//! their fixed point, against the block-tridiagonal solver; residuals of each equation.

#![expect(clippy::unwrap_used, reason = "a failed set-up fails the test")]

mod random;

use faer::Mat;
use faer::prelude::Solve;
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use needle_model::{Equilibrium, Needle, Segment, Spring, TipLoad};
use proptest::prelude::*;
use random::{State, state};

/// How eq. (8) is read.
#[derive(Debug, Clone, Copy, PartialEq)]
enum Reading {
    /// Each spring's force in its own plane, as the solver does.
    EachInItsPlane,
    /// The sum of the forces projected on plane i, to the letter.
    Literal,
}

/// Unit vectors across `n`.
fn across(n: &Vector3<f64>) -> [Vector3<f64>; 2] {
    let first = n.cross(&Vector3::ith(n.iamin(), 1.0)).normalize();
    [first, n.cross(&first)]
}

/// `y` carried along the segments in many small rotations.
fn carried(segments: &[Segment], z: &Vector3<f64>, y: &Vector3<f64>) -> Vector3<f64> {
    let (mut t, mut y) = (*z, *y);
    for segment in segments {
        for k in 1..=400 {
            let next = segment
                .derivative(segment.length * f64::from(k) / 400.0)
                .normalize();
            y -= (t + next) * (next.dot(&y) / (1.0 + t.dot(&next)));
            t = next;
        }
    }
    y
}

#[expect(
    clippy::too_many_lines,
    reason = "the whole system of the paper, in its order"
)]
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    reason = "orders of derivatives, at most 3"
)]
fn dense(state: &State, reading: Reading, rounds: usize) -> (Vec<Segment>, f64) {
    let n = state.springs.len();
    let ei = state.needle.bending_stiffness();
    let base = state.base.translation.vector;
    let (z, y_base) = (state.base * Vector3::z(), state.base * Vector3::y());
    let chord = state
        .springs
        .last()
        .map_or(z, |s| (s.rest - base).normalize());
    let mut normals = vec![chord; n];
    let mut lengths: Vec<f64> = vec![];
    let mut before = 0.0;
    for spring in &state.springs {
        let s = chord.dot(&(spring.rest - base));
        lengths.push(s - before);
        before = s;
    }
    lengths.push(state.needle.length() - before);
    let mut y = y_base;
    let mut segments: Vec<Segment> = vec![];
    let mut change = f64::INFINITY;
    for _ in 0..rounds {
        let size = 12 * (n + 1);
        let (mut a, mut b) = (Mat::<f64>::zeros(size, size), Mat::<f64>::zeros(size, 1));
        // Unknown (i, k, c): coefficient k of (l / L_i)^k, coordinate c.
        let at = |i: usize, k: usize, c: usize| 12 * i + 3 * k + c;
        let mut row = 0;
        for c in 0..3 {
            a[(row, at(0, 0, c))] = 1.0;
            b[(row, 0)] = base[c];
            a[(row + 1, at(0, 1, c))] = 1.0;
            b[(row + 1, 0)] = z[c] * lengths[0];
            row += 2;
        }
        // Derivative `order` at the end of segment i, as factors of its coefficients.
        let end = |i: usize, order: usize, k: usize| -> f64 {
            let factor: f64 = (0..order).map(|d| (k as f64 - d as f64).max(0.0)).product();
            factor / lengths[i].powi(order as i32)
        };
        let first = |i: usize, order: usize| -> f64 {
            (1..=order).map(|d| d as f64).product::<f64>() / lengths[i].powi(order as i32)
        };
        for i in 0..n {
            // Eqs. (5), (6), (7), scaled to length.
            for order in 0..3 {
                let scale = lengths[i].powi(order as i32);
                for c in 0..3 {
                    for k in 0..4 {
                        a[(row, at(i, k, c))] = end(i, order, k) * scale;
                    }
                    a[(row, at(i + 1, order, c))] = -first(i + 1, order) * scale;
                    row += 1;
                }
            }
            // Eqs. (8), (9) with (1), in the plane.
            let scale = lengths[i].powi(3) / ei;
            for e in across(&normals[i]) {
                for c in 0..3 {
                    a[(row, at(i, 3, c))] += ei * first(i, 3) * scale * e[c];
                    let last = if reading == Reading::Literal {
                        n
                    } else {
                        i + 1
                    };
                    for j in i..last {
                        let spring = &state.springs[j];
                        for k in 0..4 {
                            a[(row, at(j, k, c))] -= spring.stiffness * end(j, 0, k) * scale * e[c];
                        }
                        b[(row, 0)] -= spring.stiffness * spring.rest[c] * scale * e[c];
                    }
                    if reading == Reading::Literal {
                        b[(row, 0)] -= state.load.force * y[c] * scale * e[c];
                    } else {
                        a[(row, at(i + 1, 3, c))] -= ei * first(i + 1, 3) * scale * e[c];
                    }
                }
                row += 1;
            }
            // Along the needle: the point stays in the spring's plane.
            for c in 0..3 {
                for k in 0..4 {
                    a[(row, at(i, k, c))] = normals[i][c];
                }
                b[(row, 0)] += normals[i][c] * state.springs[i].rest[c];
            }
            row += 1;
        }
        // The tip: eqs. (9) and (11).
        let (l, last) = (lengths[n], n);
        for c in 0..3 {
            a[(row, at(last, 3, c))] = 6.0;
            b[(row, 0)] = -state.load.force * y[c] * l.powi(3) / ei;
            for k in 2..4 {
                a[(row + 1, at(last, k, c))] = end(last, 2, k) * l * l;
            }
            b[(row + 1, 0)] = state.load.bending * y[c] * l * l / ei;
            row += 2;
        }
        assert_eq!(row, size);
        let x = a.partial_piv_lu().solve(&b);
        let segments_before = std::mem::take(&mut segments);
        for i in 0..=n {
            let coefficients = std::array::from_fn(|k| {
                Vector3::from_fn(|c, _| x[(at(i, k, c), 0)] / lengths[i].powi(k as i32))
            });
            segments.push(Segment {
                coefficients,
                length: lengths[i],
            });
        }
        let place = |s: &Segment| s.position(s.length);
        change = segments
            .iter()
            .zip(&segments_before)
            .map(|(s, t)| (place(s) - place(t)).norm())
            .fold(0.0, f64::max);
        let mut used = 0.0;
        for i in 0..n {
            normals[i] = segments[i].derivative(lengths[i]).normalize();
            lengths[i] = segments[i].arc_length(lengths[i]);
            used += lengths[i];
        }
        let arc = segments[n].arc_length(lengths[n]);
        lengths[n] += state.needle.length() - used - arc;
        y = carried(&segments, &z, &y_base);
        if segments_before.len() == segments.len() && change < 1e-14 {
            break;
        }
    }
    (segments, change)
}

/// Largest distance between the ends of the segments.
fn gap(needle: &Equilibrium, segments: &[Segment]) -> f64 {
    let ends = |s: &Segment| s.position(s.length);
    needle
        .segments()
        .zip(segments)
        .map(|(a, b)| (ends(&a) - ends(b)).norm())
        .fold(0.0, f64::max)
}

fn solved(state: &State) -> Equilibrium {
    let mut needle = Equilibrium::new(state.needle, state.base);
    needle.set_tolerance(1e-12);
    needle
        .solve(&state.base, &state.springs, state.load)
        .unwrap();
    needle
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 24, rng_seed: proptest::test_runner::RngSeed::Fixed(9), failure_persistence: None, ..ProptestConfig::default() })]

    #[test]
    fn banded_and_dense_solutions_agree(state in state()) {
        let needle = solved(&state);
        let (segments, change) = dense(&state, Reading::EachInItsPlane, 200);
        prop_assert!(change < 1e-12, "the fixed point did not settle: {change:e}");
        let gap = gap(&needle, &segments) / state.needle.length();
        prop_assert!(gap < 1e-9, "{gap:e}");
    }

    #[test]
    fn every_equation_holds(state in state()) {
        let needle = solved(&state);
        let r = needle.residuals();
        // Positions to rounding; forces to the rounding of 12 EI p / L^3 = 1e6 N/m x 1e-16 m over
        // the shortest pieces; lengths to the quadrature.
        prop_assert!(r.position < 1e-15 && r.derivative < 1e-12, "{r:?}");
        prop_assert!(r.moment < 1e-11 && r.shear < 1e-8 && r.tip_moment < 1e-15, "{r:?}");
        prop_assert!(r.plane < 1e-15 && r.arc < 1e-9 && r.length < 1e-9, "{r:?}");
    }

    #[test]
    fn a_rigid_motion_of_the_world_changes_nothing(state in state(), axis in (-3.0..3.0, -3.0..3.0, -3.0..3.0)) {
        let needle = solved(&state);
        let motion = Isometry3::from_parts(
            Translation3::new(0.2, -0.5, 0.1),
            UnitQuaternion::new(Vector3::new(axis.0, axis.1, axis.2)),
        );
        let moved = |p: Vector3<f64>| (motion * nalgebra::Point3::from(p)).coords;
        let springs = state.springs.iter().map(|s| Spring { rest: moved(s.rest), ..*s }).collect();
        let other = solved(&State { base: motion * state.base, springs, ..state.clone() });
        let gap = (moved(needle.tip_position()) - other.tip_position()).norm();
        prop_assert!(gap < 1e-12, "{gap:e}");
        let turned = (motion * needle.world_from_tip()).rotation.angle_to(&other.world_from_tip().rotation);
        prop_assert!(turned < 1e-9, "{turned:e}");
    }
}

/// A needle on a path bent to `slope` at the tip in tissue of stiffness `k_t` per length, its base
/// pushed aside.
fn bent(slope: f64, k_t: f64) -> State {
    let needle = Needle::biopsy();
    let (count, pitch) = (16, 2.5e-3);
    let depth = pitch * f64::from(count);
    let curvature = slope / depth;
    let springs = (0..count)
        .map(|i| {
            let s = pitch * f64::from(i);
            let angle = curvature * s;
            let rest = if curvature > 0.0 {
                Vector3::new(
                    0.0,
                    (1.0 - angle.cos()) / curvature,
                    angle.sin() / curvature,
                )
            } else {
                Vector3::z() * s
            };
            Spring {
                rest,
                stiffness: k_t * pitch,
            }
        })
        .collect();
    let base = Isometry3::translation(-2e-3, 0.0, -(needle.length() - depth - 1e-3));
    State {
        needle,
        base,
        springs,
        load: TipLoad {
            force: 5e-3,
            bending: 1e-6,
        },
    }
}

#[test]
fn the_gap_to_the_literal_reading_grows_with_the_slope() {
    let mut gaps = vec![];
    for (slope, k_t) in [
        (0.05, 2e4),
        (0.1, 2e4),
        (0.2, 2e4),
        (0.4, 2e4),
        (0.8, 2e4),
        (0.8, 2e5),
        (1.0, 1e6),
    ] {
        let state = bent(slope, k_t);
        let needle = solved(&state);
        let (own, change) = dense(&state, Reading::EachInItsPlane, 300);
        assert!(change < 1e-12 && gap(&needle, &own) < 1e-10);
        let (literal, change) = dense(&state, Reading::Literal, 300);
        assert!(change < 1e-12, "{change:e}");
        let gap = gap(&needle, &literal);
        let reached = needle.tip_axis().angle(&(state.base * Vector3::z()));
        println!(
            "tip angle {:.3} rad: literal eq. (8) differs by {:.3} um",
            reached,
            gap * 1e6
        );
        gaps.push((reached, gap));
    }
    let order = (gaps[3].1 / gaps[1].1).ln() / (gaps[3].0 / gaps[1].0).ln();
    println!("order {order:.2}");
    assert!(order > 1.5, "{order}");
}

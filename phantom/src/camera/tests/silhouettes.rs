//! Silhouettes against rays traced backwards: every image row is cut into 16, and in each the
//! edges of what the rays hit are found by bisection.

use nalgebra::{Point3, Vector3};

use super::scene::{needle, rig, world_from_phantom};
use crate::NeedleView;
use crate::camera::coverage::SparsePlane;
use crate::camera::silhouette::Silhouette;
use crate::camera::{CameraSettings, Ray, Side, Through, View};

/// Rows into which an image row is cut.
const SUBROWS: usize = 16;
/// Height of the gel's surface in World [m].
const SURFACE: f64 = 0.25;

fn covered(view: &View, needle: &NeedleView, settings: &CameraSettings) -> SparsePlane {
    let mut plane = SparsePlane::new(settings.width_px, settings.height_px);
    Silhouette::default().trace(view, needle, |o| plane.outline(o), |_, _, _, _, _| {});
    plane.resolve();
    plane
}

/// Whether a ray meets the needle before `reach` [m].
fn meets(ray: &Ray, reach: f64, needle: &NeedleView) -> bool {
    let d = ray.direction;
    let radius = 0.5 * needle.outer_diameter;
    let across = |v: Vector3<f64>| v - d * d.dot(&v);
    // The shaft as a chain of tubes with round joints, up to 0.5 mm before O ...
    let nodes = &needle.centreline[..needle.centreline.len() - 1];
    // (looked at in pieces of 5 mm, as most are far from the ray).
    let shaft = (0..nodes.len() - 1).step_by(10).any(|first| {
        let piece = &nodes[first..(first + 11).min(nodes.len())];
        across(piece[piece.len() / 2] - ray.origin.coords).norm() < 6e-3
            && piece.windows(2).any(|ab| {
                let from = ab[0] - ray.origin.coords;
                let edge = ab[1] - ab[0];
                let (a, e) = (across(from), across(edge));
                let s = (-a.dot(&e) / e.norm_squared()).clamp(0.0, 1.0);
                let t = d.dot(&(from + s * edge));
                (a + s * e).norm() <= radius && t > 0.0 && t < reach
            })
    });
    if shaft {
        return true;
    }
    // ... then a straight cylinder cut by the bevel's plane.
    let tip_from_world = needle.world_from_tip.isometry().inverse();
    let o = tip_from_world * ray.origin;
    let v = tip_from_world.rotation * d;
    let (a, b, c) = (
        v.x * v.x + v.y * v.y,
        o.x * v.x + o.y * v.y,
        o.x * o.x + o.y * o.y - radius * radius,
    );
    let root = b * b - a * c;
    if root < 0.0 {
        return false;
    }
    let mut from = ((-b - root.sqrt()) / a).max(0.0);
    let mut to = ((-b + root.sqrt()) / a).min(reach);
    let length = needle.bevel_length();
    // Half-spaces n.p <= k: before the bevel's face, and no further back than 0.6 mm.
    for (n, k) in [
        (Vector3::new(0.0, 0.5 * length / radius, 1.0), 0.5 * length),
        (Vector3::new(0.0, 0.0, -1.0), 0.6e-3),
    ] {
        let (slope, at) = (n.dot(&v), n.dot(&o.coords) - k);
        if slope > 0.0 {
            to = to.min(-at / slope);
        } else if slope < 0.0 {
            from = from.max(-at / slope);
        } else if at > 0.0 {
            return false;
        }
    }
    from <= to
}

/// Whether the needle is what a pixel sees, directly, above the surface, or mirrored in it.
fn hits(view: &View, pixel: [f64; 2], needle: &NeedleView) -> bool {
    let free = view.ray(pixel, Through::FreeWall).unwrap();
    if free.origin.z > SURFACE {
        return meets(&free, f64::INFINITY, needle);
    }
    let ray = view.ray(pixel, Through::Gel).unwrap();
    if ray.direction.z <= 0.0 {
        return meets(&ray, f64::INFINITY, needle);
    }
    let reach = (SURFACE - ray.origin.z) / ray.direction.z;
    let d = ray.direction;
    let mirrored = Ray {
        origin: ray.origin + reach * d,
        direction: Vector3::new(d.x, d.y, -d.z),
    };
    meets(&ray, reach, needle) || meets(&mirrored, f64::INFINITY, needle)
}

struct Worst {
    pixel: f64,
    edge: f64,
    rows: usize,
}

fn compare(
    view: &View,
    needle: &NeedleView,
    plane: &SparsePlane,
    subrows: usize,
    rows: impl Iterator<Item = usize>,
) -> Worst {
    let mut worst = Worst {
        pixel: 0.0,
        edge: 0.0,
        rows: 0,
    };
    for y in rows {
        let span = plane.span(y);
        if span.is_empty() {
            continue;
        }
        let (from, to) = (span.start as f64 - 2.0, span.end as f64 + 2.0);
        let mut truth = vec![0.0; span.len()];
        let (mut left, mut right, mut full) = (0.0, 0.0, 0);
        for j in 0..subrows {
            let v = y as f64 - 0.5 + (j as f64 + 0.5) / subrows as f64;
            let steps = 8 * (span.len() + 4);
            let at = |k: usize| from + (to - from) * k as f64 / steps as f64;
            let inside: Vec<usize> = (0..=steps)
                .filter(|k| hits(view, [at(*k), v], needle))
                .collect();
            let (Some(&first), Some(&last)) = (inside.first(), inside.last()) else {
                continue;
            };
            let edge = |mut out: f64, mut within: f64| {
                for _ in 0..30 {
                    let middle = 0.5 * (out + within);
                    if hits(view, [middle, v], needle) {
                        within = middle;
                    } else {
                        out = middle;
                    }
                }
                within
            };
            let l = edge(at(first) - 0.125, at(first));
            let r = edge(at(last) + 0.125, at(last));
            for (x, t) in span.clone().zip(&mut truth) {
                let overlap = r.min(x as f64 + 0.5) - l.max(x as f64 - 0.5);
                *t += overlap.max(0.0) / subrows as f64;
            }
            (left, right, full) = (left + l, right + r, full + 1);
        }
        let mut sums = [0.0; 2];
        for (x, t) in span.zip(&truth) {
            let c = f64::from(plane.row(y)[x]).abs().min(1.0);
            worst.pixel = worst.pixel.max((c - t).abs());
            sums[0] += c;
            sums[1] += t;
        }
        if full == subrows {
            // Width; and each edge, from the coverage on either side of the middle.
            worst.edge = worst.edge.max((sums[0] - sums[1]).abs());
            let middle = 0.5 * (left + right) / subrows as f64;
            let half = |values: &dyn Fn(usize) -> f64| {
                plane
                    .span(y)
                    .map(|x| values(x) * (middle - (x as f64 - 0.5)).clamp(0.0, 1.0))
                    .sum::<f64>()
            };
            let start = plane.span(y).start;
            let drawn = half(&|x| f64::from(plane.row(y)[x]).abs().min(1.0));
            let true_ = half(&|x| truth[x - start]);
            worst.edge = worst.edge.max((drawn - true_).abs());
            worst.rows += 1;
        }
    }
    worst
}

#[test]
fn silhouettes_are_true_to_a_hundredth_of_a_pixel() {
    for settings in [CameraSettings::paper(), CameraSettings::paper().at_1280()] {
        let rig = rig(&settings, 2);
        for (azimuth, bevel) in [(0.3, 0.0), (1.9, 0.9), (-2.4, 2.3), (0.0, -1.6)] {
            let shown = needle(0.078, 0.8, azimuth, bevel);
            for side in Side::BOTH {
                let view = rig.truth().view(side);
                let plane = covered(&view, &shown, &settings);
                let end = plane.rows().end;
                assert!(end > settings.height_px / 2, "the tip is in the image");
                let shaft = compare(&view, &shown, &plane, SUBROWS, (60..end - 40).step_by(23));
                let tip = compare(&view, &shown, &plane, SUBROWS, end - 20..end);
                println!(
                    "{} px, azimuth {azimuth}: shaft edges {:.4} px, coverage {:.4}; tip {:.4}, {:.4}",
                    settings.width_px, shaft.edge, shaft.pixel, tip.edge, tip.pixel
                );
                assert!(shaft.rows > 8 && tip.rows > 8);
                assert!(shaft.edge < 0.01 && tip.edge < 0.01);
                // The bevel's corners fall between two of the 16 subrows.
                assert!(shaft.pixel < 0.01 && tip.pixel < 0.02);
            }
        }
    }
}

#[test]
fn the_entry_is_seen_as_optics_has_it() {
    let settings = CameraSettings::paper().at_1280();
    let rig = rig(&settings, 2);
    // Leaning, so that the mirror image and the view above the surface are kinked.
    let mut shown = needle(0.05, 0.0, 0.0, 0.0);
    let entry = world_from_phantom() * Point3::origin();
    let lean = nalgebra::Rotation3::new(Vector3::new(0.06, 0.05, 0.0));
    for p in &mut shown.centreline {
        *p = entry.coords + lean * (*p - entry.coords);
    }
    let tip = *shown.world_from_tip.isometry();
    let turned = nalgebra::Isometry3::from_parts(
        nalgebra::Translation3::from(*shown.centreline.last().unwrap()),
        nalgebra::UnitQuaternion::from_rotation_matrix(&lean) * tip.rotation,
    );
    shown.world_from_tip = hal::Transform::assume(turned);
    for side in Side::BOTH {
        let view = rig.truth().view(side);
        let plane = covered(&view, &shown, &settings);
        assert_eq!(
            plane.rows().start,
            0,
            "the shaft leaves the image at the top"
        );
        let worst = compare(&view, &shown, &plane, 128, 0..70);
        println!(
            "entry: edges {:.4} px, coverage {:.4}",
            worst.edge, worst.pixel
        );
        assert!(worst.rows > 60);
        // At the contact line, where the images jump sideways by some pixels, the bisected rows
        // know the line's height only to 1/256 px each.
        assert!(worst.edge < 0.02, "{}", worst.edge);
        let below = compare(&view, &shown, &plane, SUBROWS, 70..110);
        assert!(below.edge < 0.01, "{}", below.edge);
    }
}

#[test]
fn the_surface_hides_what_optics_says_it_hides() {
    let rig = rig(&CameraSettings::ideal(), 0);
    let at = |depth: f64| world_from_phantom() * Point3::new(0.0, 0.0, depth);
    for side in Side::BOTH {
        let view = rig.truth().view(side);
        for depth in [0.0, 1e-4, 2e-3, 0.03, 0.09] {
            let direct = view.project(&at(depth), Through::Gel);
            assert_eq!(view.see(&at(depth)), direct);
            assert!(direct.is_some());
        }
        // The camera is 50 mm below the surface and 450 mm before the wall's inner face: a line
        // of sight through the contact line passes the axis 50 * 50 / 450 = 5.6 mm above it.
        assert_eq!(view.see(&at(-1e-4)), None);
        assert_eq!(view.see(&at(-5.2e-3)), None);
        let above = view.see(&at(-5.9e-3));
        assert_eq!(above, view.project(&at(-5.9e-3), Through::FreeWall));
        assert!(above.is_some());
        // Outside the image.
        assert_eq!(view.see(&at(-0.05)), None);
    }
}

fn area(plane: &SparsePlane) -> f64 {
    plane
        .rows()
        .flat_map(|y| plane.span(y).map(move |x| (y, x)))
        .map(|(y, x)| f64::from(plane.row(y)[x]).abs())
        .sum()
}

#[test]
fn a_bevel_seen_edge_on_moves_the_tip_by_half_its_length() {
    let settings = CameraSettings::ideal().at_1280();
    let rig = rig(&settings, 0);
    let view = rig.truth().view(Side::Left);
    // Straight down, so that the tip is level with the camera and seen square.
    let eighth = core::f64::consts::FRAC_PI_4;
    for (bevel, expected) in [
        (eighth, 0.5),
        (eighth + core::f64::consts::PI, 0.5),
        // Seen onto its face, or onto its back: the mean of (1 + sqrt(1 - x^2)) / 2.
        (-eighth, 0.5 + core::f64::consts::PI / 8.0),
        (3.0 * eighth, 0.5 + core::f64::consts::PI / 8.0),
    ] {
        let shown = needle(0.05, 0.0, 0.0, bevel);
        let mut flat = shown.clone();
        flat.bevel_angle = core::f64::consts::FRAC_PI_2;
        let o = shown.world_from_tip.origin();
        let ahead = shown.world_from_tip.isometry() * Point3::new(0.0, 0.0, 1e-3);
        let pixel = |p: &Point3<f64>| view.project(p, Through::Gel).unwrap();
        let scale = 1e3 * (pixel(&ahead)[1] - pixel(o.point())[1]);
        let beyond =
            area(&covered(&view, &shown, &settings)) - area(&covered(&view, &flat, &settings));
        let measured = beyond / (scale * shown.outer_diameter) / scale;
        println!(
            "bevel at {bevel:.2} rad: tip biased by {:.3} mm = {:.2} px",
            1e3 * measured,
            measured * scale
        );
        // Perspective over the bevel's length is 0.3 %; the ellipse's chords take 0.1 %.
        assert!((measured / shown.bevel_length() - expected).abs() < 0.005);
        // The sharp point is where the silhouette ends, on the side of -y.
        let sharp = pixel(&Point3::from(shown.sharp_point()));
        let plane = covered(&view, &shown, &settings);
        let last = plane.rows().rfind(|y| !plane.span(*y).is_empty()).unwrap();
        assert!((last as f64 - sharp[1]).abs() < 1.5, "{last} {}", sharp[1]);
    }
}

#[test]
fn no_needle_position_breaks_the_renderer() {
    let settings = CameraSettings::paper();
    let mut rig = rig(&settings, 0);
    let empty = rig.empty(0);
    // High above, through the surface with the bevel only, at the floor, out of the image.
    assert_eq!(rig.render(&needle(-0.1, 0.0, 0.0, 0.0), 0), empty);
    for depth in [-0.02, -0.001, -0.0005, 0.0, 0.0005, 0.002, 0.1, 0.126] {
        let pair = rig.render(&needle(depth, 0.4, 0.4, 1.0), 0);
        assert!(pair[0].pixels().len() == 640 * 480);
    }
    for bend in [-30.0, 30.0, f64::NAN] {
        rig.render(&needle(0.08, bend, 0.4, 1.0), 0);
    }
    let mut bare = needle(0.08, 0.0, 0.0, 0.0);
    bare.centreline.clear();
    rig.render(&bare, 0);
    // Towards a camera: no tangent across the line of sight.
    let towards = world_from_phantom().rotation * Vector3::new(1.0, 1.0, 0.0).normalize();
    let o = bare.world_from_tip.origin().coords();
    bare.centreline = (0..20)
        .map(|i| o - towards * 1e-3 * f64::from(20 - i))
        .collect();
    rig.render(&bare, 0);
}

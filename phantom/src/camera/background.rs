//! What a camera sees without the needle: computed once.

use nalgebra::{Isometry3, Point3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};

use super::coverage::SparsePlane;
use super::geometry::{gel_centre, towards_camera};
use super::lens::Pixel;
use super::noise::{Stream, generator};
use super::settings::CameraSettings;
use super::view::{Through, View};

/// Brightness of the white screen over the image \[grey\], row-major.
pub(super) fn screen(settings: &CameraSettings, index: usize, seed: u64) -> Vec<f32> {
    let (w, h) = (settings.width_px, settings.height_px);
    let b = &settings.backlight;
    let mut generator = generator(seed, Stream::Backlight, index as u64);
    let direction = generator.random::<f64>() * core::f64::consts::TAU;
    let moire_direction = generator.random::<f64>() * core::f64::consts::TAU;
    let phase = generator.random::<f64>() * core::f64::consts::TAU;
    let (gy, gx) = direction.sin_cos();
    let (my, mx) = moire_direction.sin_cos();
    let wave = core::f64::consts::TAU / b.moire_period_px;
    let (half_w, half_h) = (0.5 * w as f64, 0.5 * h as f64);
    let clouds = Clouds::new(&mut generator, w as f64 / 9.0);
    let mut values = Vec::with_capacity(w * h);
    for y in 0..h {
        for x in 0..w {
            let (dx, dy) = (x as f64 + 0.5 - half_w, y as f64 + 0.5 - half_h);
            let gradient = 1.0 + 0.5 * b.gradient * (gx * dx + gy * dy) / half_w;
            let r2 = (dx * dx + dy * dy) / (half_w * half_w + half_h * half_h);
            let vignetting = 1.0 - b.vignetting * r2;
            // Two crossed gratings of nearly the same period, as of a screen's pixel grid.
            let moire = if b.moire > 0.0 {
                let a = wave * (mx * dx + my * dy) + phase;
                let c = 1.07 * wave * (my * dx - mx * dy) + 2.0 * phase;
                1.0 + 0.5 * b.moire * (a.sin() + c.sin())
            } else {
                1.0
            };
            let cloud = 1.0 + b.clouds * clouds.at(x as f64, y as f64);
            values.push(to_f32(b.level_grey * gradient * vignetting * moire * cloud));
        }
    }
    values
}

/// Smooth random brightness, of unit variance at its nodes: the gel is never quite homogeneous.
struct Clouds {
    nodes: Vec<f64>,
    cell: f64,
}

impl Clouds {
    const SIDE: usize = 16;

    fn new(generator: &mut ChaCha8Rng, cell: f64) -> Self {
        let nodes = (0..Self::SIDE * Self::SIDE)
            .map(|_| StandardNormal.sample(generator))
            .collect();
        Self { nodes, cell }
    }

    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "pixel coordinates are small and positive"
    )]
    fn at(&self, x: f64, y: f64) -> f64 {
        let (u, v) = (x / self.cell, y / self.cell);
        let (i, j) = (u as usize, v as usize);
        let smooth = |t: f64| t * t * (3.0 - 2.0 * t);
        let (s, t) = (smooth(u - i as f64), smooth(v - j as f64));
        let node = |i: usize, j: usize| self.nodes[(j % Self::SIDE) * Self::SIDE + i % Self::SIDE];
        let row = |j: usize| node(i, j) + s * (node(i + 1, j) - node(i, j));
        row(j) + t * (row(j + 1) - row(j))
    }
}

/// Multiplies the screen by what the container and the bubbles let through.
pub(super) fn gel(
    values: &mut [f32],
    settings: &CameraSettings,
    index: usize,
    view: &View,
    world_from_phantom: &Isometry3<f64>,
    seed: u64,
) {
    if settings.backlight.outline {
        outline(values, settings, index, view, world_from_phantom);
    }
    let bubbles = &settings.bubbles;
    let mut generator = generator(seed, Stream::Bubbles, 0);
    for _ in 0..bubbles.count {
        let place = in_gel(settings, &mut generator);
        let radius =
            1e-3 * log_uniform(&mut generator, bubbles.radius_min_mm, bubbles.radius_max_mm);
        let world = world_from_phantom * place;
        let aside = world_from_phantom * (place + radius * Vector3::z());
        if let (Some(centre), Some(edge)) = (
            view.project(&world, Through::Gel),
            view.project(&aside, Through::Gel),
        ) {
            bubble(
                values,
                settings,
                centre,
                (edge[1] - centre[1]).hypot(edge[0] - centre[0]),
            );
        }
    }
}

/// A point of the gel, uniform, in the phantom's frame: between both cameras' walls and as far
/// back behind the axis.
fn in_gel(settings: &CameraSettings, generator: &mut ChaCha8Rng) -> Point3<f64> {
    let half = 1e-3 * settings.container.gel_half_width_mm;
    let walls = [0, 1].map(|index| towards_camera(settings, index));
    let across = Vector3::z().cross(&walls[0]);
    let z = generator.random_range(0.0..=1e-3 * settings.container.gel_depth_mm);
    loop {
        let a = generator.random_range(-half..=half);
        let b = generator.random_range(-half..=half);
        let p = a * walls[0] + b * across;
        if walls[1].dot(&p) <= half {
            return Point3::new(p.x, p.y, z);
        }
    }
}

fn log_uniform(generator: &mut ChaCha8Rng, min: f64, max: f64) -> f64 {
    (min.ln() + generator.random::<f64>() * (max / min).ln()).exp()
}

/// A bubble before a bright screen: its middle passes light, its rim deflects it.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "clamped to the image"
)]
fn bubble(values: &mut [f32], settings: &CameraSettings, centre: Pixel, radius: f64) {
    let (w, h) = (settings.width_px, settings.height_px);
    let reach = radius + 1.0;
    let first = |c: f64, n: usize| (c - reach).floor().clamp(0.0, n as f64) as usize;
    let end = |c: f64, n: usize| ((c + reach).ceil() + 1.0).clamp(0.0, n as f64) as usize;
    let step = |a: f64, b: f64, x: f64| {
        let t = ((x - a) / (b - a)).clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    };
    for y in first(centre[1], h)..end(centre[1], h) {
        for x in first(centre[0], w)..end(centre[0], w) {
            let mut dark = 0.0;
            for s in 0..16 {
                let px = x as f64 + 0.25 * f64::from(s % 4) - 0.375;
                let py = y as f64 + 0.25 * f64::from(s / 4) - 0.375;
                let rho = (px - centre[0]).hypot(py - centre[1]) / radius;
                if rho < 1.0 {
                    dark += (0.72 * step(0.25, 0.8, rho) - 0.04) / 16.0;
                }
            }
            values[y * w + x] *= 1.0 - to_f32(dark);
        }
    }
}

/// Container edges, floor, meniscus and the gel's absorption, on the inner face of the wall.
fn outline(
    values: &mut [f32],
    settings: &CameraSettings,
    index: usize,
    view: &View,
    world_from_phantom: &Isometry3<f64>,
) {
    let towards = towards_camera(settings, index);
    let half = 1e-3 * settings.container.gel_half_width_mm;
    let depth = 1e-3 * settings.container.gel_depth_mm;
    let face = gel_centre(settings) + half * towards;
    let right = Vector3::z().cross(&-towards);
    // The wall ends where it meets the other camera's wall; on its far side, at the half width.
    let facet = (half * (0.5 * settings.separation_deg.to_radians()).tan()).min(half);
    let (from, to) = if index == 0 {
        (-half, facet)
    } else {
        (-facet, half)
    };
    // A rectangle of the inner face: across from a to b, from depth top to depth bottom.
    let mut band = |a: f64, b: f64, top: f64, bottom: f64, dark: f64| {
        let corner = |u: f64, z: f64| {
            let mut p = face + u * right;
            p.z = z;
            view.project(&(world_from_phantom * p), Through::Gel)
        };
        let steps = 16;
        let at = |k: i32| f64::from(k) / f64::from(steps);
        let edge = (0..=steps)
            .map(|k| (a + (b - a) * at(k), top))
            .chain((0..=steps).map(|k| (b, top + (bottom - top) * at(k))))
            .chain((0..=steps).map(|k| (b + (a - b) * at(k), bottom)))
            .chain((0..=steps).map(|k| (a, bottom + (top - bottom) * at(k))));
        let mut plane = SparsePlane::new(settings.width_px, settings.height_px);
        plane.polygon(edge.filter_map(|(u, z)| corner(u, z)), dark);
        plane.resolve();
        for y in plane.rows() {
            for x in plane.span(y) {
                values[y * settings.width_px + x] *= 1.0 - plane.row(y)[x].abs();
            }
        }
    };
    let edge = 4e-3;
    // Far enough to leave the image, near enough for the distortion not to fold.
    let beyond = 0.1;
    let (top, bottom) = (-beyond, depth + beyond);
    // The gel absorbs a little.
    band(from, to, 0.0, depth, 0.10);
    // The meniscus bends light away about the contact line, and fades downwards.
    for k in 0..12 {
        let z = -0.6e-3 + 0.25e-3 * f64::from(k);
        let fall = (f64::from(k) - 3.0) / if k < 3 { 1.3 } else { 3.5 };
        band(from, to, z, z + 0.25e-3, 0.62 * (-fall * fall).exp());
    }
    // The vertical walls edge-on: dark, with light caught between their faces.
    for (inner, outward) in [(from, -1.0), (to, 1.0)] {
        for k in 0..16 {
            let (u, step) = (f64::from(k) / 16.0, outward * edge / 16.0);
            let caught = 0.18 * (-((u - 0.6) / 0.12).powi(2)).exp();
            let dark = 0.30 + 0.35 * (2.0 * u - 1.0).powi(4) - caught;
            let a = inner + step * f64::from(k);
            band(a.min(a + step), a.max(a + step), top, bottom, dark);
        }
        let glue = inner - 0.3e-3 * outward;
        band(glue.min(inner), glue.max(inner), top, bottom, 0.35);
    }
    // The floor, and its soft upper edge.
    for k in 0..6 {
        let z = depth - 0.2e-3 * f64::from(k);
        band(from, to, z, bottom, 0.06);
    }
    band(from - edge, to + edge, depth, bottom, 0.70);
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "grey levels need no double precision"
)]
fn to_f32(x: f64) -> f32 {
    x as f32
}

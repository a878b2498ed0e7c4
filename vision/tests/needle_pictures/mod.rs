//! Pictures of a needle for the tracker's tests and benches.
#![allow(
    dead_code,
    unreachable_pub,
    clippy::allow_attributes,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::large_types_passed_by_value,
    reason = "each test and bench uses a part"
)]

pub mod film;

use std::sync::Arc;

use hal::{CameraFrame, GrayImage, Stamp, StereoFrame, Transform};
use nalgebra::{Isometry3, Point3, Unit, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use vision::camera::{Camera, Container, Distortion, FlatWindow, StereoRig, View};

/// Subpixels per pixel and axis.
const FINE: usize = 4;
/// Marking every subpixel touched would make the needle half a subpixel too large all round \[px\].
const EXCESS: f64 = 0.5 / FINE as f64;

/// Two cameras 90 degrees apart, 0.5 m from the middle, each square to its wall: 0.25 mm/px at
/// 640 columns.
pub fn rig(width: usize) -> StereoRig {
    let scale = width as f64 / 640.0;
    let camera = Camera {
        width,
        height: width * 3 / 4,
        fx: 2000.0 * scale,
        fy: 2000.0 * scale,
        cx: 319.5 * scale,
        cy: 239.5 * scale,
        distortion: Distortion::from_array([-0.1, 0.05, 0.001, -0.0005, 0.0]),
    };
    let centre = Isometry3::translation(0.0, 0.0, 0.5);
    let turn = Isometry3::rotation(Vector3::y() * core::f64::consts::FRAC_PI_2);
    let window = FlatWindow {
        normal: Unit::new_normalize(Vector3::new(0.0, 0.0, 1.0)),
        distance: 0.447,
        thickness: 0.003,
        wall_index: 1.49,
        gel_index: 1.35,
    };
    StereoRig {
        left: camera,
        right: camera,
        right_from_left: Transform::assume(centre * turn * centre.inverse()),
        container: Some(Container {
            left: window,
            right: window,
        }),
    }
}

/// A needle that enters at the top of both pictures.
#[derive(Clone, Copy, Debug)]
pub struct Needle {
    pub depth: f64,
    pub bevel_length: f64,
    /// Of the bevel about the axis \[rad\].
    pub azimuth: f64,
    pub curvature: f64,
    /// Amplitude of an S-bend that is no cubic \[m\].
    pub wave: f64,
}

impl Needle {
    pub fn bent(depth: f64, bevel_length: f64, azimuth: f64) -> Self {
        Self {
            depth,
            bevel_length,
            azimuth,
            curvature: 2.0,
            wave: 0.0,
        }
    }

    /// Centre line at depth `s`; y of the stereo frame points down.
    pub fn point(&self, s: f64) -> Vector3<f64> {
        let bend = 0.5 * self.curvature * s.max(0.0).powi(2);
        let wave = self.wave * (-s / 0.008).exp() * (s / 0.005).sin();
        Vector3::new(
            0.002 + bend + 0.03 * s + wave,
            -0.04 + s,
            0.5 - 0.6 * bend + 0.02 * s - 0.5 * wave,
        )
    }

    fn axis(&self, s: f64) -> Vector3<f64> {
        (self.point(s + 1e-6) - self.point(s - 1e-6)).normalize()
    }

    pub fn bevel_direction(&self) -> Unit<Vector3<f64>> {
        let axis = self.axis(self.depth);
        let a = axis.cross(&Vector3::x()).normalize();
        let b = axis.cross(&a);
        Unit::new_normalize(a * self.azimuth.cos() + b * self.azimuth.sin())
    }

    pub fn guess(&self) -> Vec<Point3<f64>> {
        // A model's prediction: the chord's shape is off by a few tenths of a millimetre.
        (0..=20)
            .map(|i| self.depth * f64::from(i) / 20.0)
            .map(|s| {
                Point3::from(self.point(s) + Vector3::new(0.2e-3 * s / self.depth, 0.0, 0.1e-3))
            })
            .collect()
    }
}

/// Cameras and what is behind the needle.
pub struct Scene {
    pub rig: StereoRig,
    pub noise: f64,
    /// Dark discs: column, row, radius \[px\], in either image.
    pub discs: Vec<[f64; 3]>,
    /// Dark bars: first and last column, first and last row \[px\], in either image.
    pub bars: Vec<[f64; 4]>,
    seed: u64,
}

impl Scene {
    pub fn new(rig: StereoRig, seed: u64) -> Self {
        Self {
            rig,
            noise: 3.0,
            discs: Vec::new(),
            bars: Vec::new(),
            seed,
        }
    }

    pub fn pair(&self, needle: &Needle, number: u64) -> StereoFrame {
        self.frames(Some(needle), number)
    }

    pub fn empty(&self, number: u64) -> StereoFrame {
        self.frames(None, number)
    }

    /// Of one grey level all over.
    pub fn blank(&self, grey: u8, number: u64) -> StereoFrame {
        let camera = self.rig.left;
        let frame = CameraFrame {
            stamp: Stamp::from_secs(number as f64 / 30.0),
            sequence: number,
            image: Arc::new(GrayImage::filled(camera.width, camera.height, grey)),
        };
        StereoFrame {
            left: frame.clone(),
            right: frame,
        }
    }

    fn frames(&self, needle: Option<&Needle>, number: u64) -> StereoFrame {
        let views = self.rig.views();
        let frame = |k: usize| CameraFrame {
            stamp: Stamp::from_secs(number as f64 / 30.0),
            sequence: number,
            image: Arc::new(self.draw(&views[k], needle, number * 2 + k as u64)),
        };
        StereoFrame {
            left: frame(0),
            right: frame(1),
        }
    }

    fn draw(&self, view: &View, needle: Option<&Needle>, number: u64) -> GrayImage {
        let (w, h) = (view.camera.width, view.camera.height);
        let mut fine = vec![false; w * h * FINE * FINE];
        if let Some(n) = needle {
            splat(&mut fine, view, n);
        }
        let mut cover: Vec<f32> = vec![0.0; w * h];
        for (i, _) in fine.iter().enumerate().filter(|(_, on)| **on) {
            let (x, y) = (i % (w * FINE) / FINE, i / (w * FINE) / FINE);
            cover[y * w + x] += 1.0 / (FINE * FINE) as f32;
        }
        // A triangular point-spread function, twice as wide at twice the resolution.
        let kernel: &[f32] = if w > 1000 {
            &[0.08, 0.16, 0.52, 0.16, 0.08]
        } else {
            &[0.2, 0.6, 0.2]
        };
        let cover = blurred(&blurred(&cover, 1, kernel), w, kernel);
        let mut generator =
            ChaCha8Rng::seed_from_u64(self.seed.wrapping_mul(7919).wrapping_add(number));
        let mut image = GrayImage::filled(w, h, 0);
        for (i, p) in image.pixels_mut().iter_mut().enumerate() {
            let (x, y) = ((i % w) as f64, (i / w) as f64);
            let (u, v) = (x / w as f64 - 0.4, y / h as f64 - 0.6);
            let mut level = 175.0 + 40.0 * u - 60.0 * v * v + 25.0 * u * v;
            for d in &self.discs {
                if (x - d[0]).hypot(y - d[1]) < d[2] {
                    level = 45.0;
                }
            }
            for b in &self.bars {
                if (b[0]..b[1]).contains(&x) && (b[2]..b[3]).contains(&y) {
                    level = 45.0;
                }
            }
            let grey = level + f64::from(cover[i]) * (40.0 - level);
            let noise = generator.random_range(-1.0..1.0) * self.noise;
            *p = (grey + noise).round().clamp(0.0, 255.0) as u8;
        }
        image
    }
}

/// Marks every subpixel that a slice of the needle covers.
fn splat(fine: &mut [bool], view: &View, needle: &Needle) {
    let w = view.camera.width;
    let eye = view.camera_from_left.inverse() * Point3::origin();
    let radius = 0.35e-3;
    let sharp = needle.bevel_direction();
    let step = 0.05e-3 * 320.0 / w as f64;
    let end = needle.depth + needle.bevel_length - EXCESS * 0.25e-3 * 640.0 / w as f64;
    let slices = ((end + 0.01) / step) as usize;
    for k in 0..slices {
        // From the end backwards, that the last slice lies at the tip.
        let s = end - step * k as f64;
        let beyond = s - needle.depth;
        let (centre, axis) = if beyond < 0.0 {
            (needle.point(s), needle.axis(s))
        } else {
            let axis = needle.axis(needle.depth);
            (needle.point(needle.depth) + axis * beyond, axis)
        };
        let across = axis.cross(&(centre - eye.coords)).normalize();
        let away = axis.cross(&across);
        // The slice: a disc, beyond O only its part towards the sharp side.
        let least = if beyond > 0.0 && needle.bevel_length > 0.0 {
            radius * (2.0 * beyond / needle.bevel_length - 1.0)
        } else {
            -2.0 * radius
        };
        let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
        for i in 0..256 {
            let (sin, cos) = (core::f64::consts::TAU * f64::from(i) / 256.0).sin_cos();
            for r in [radius, 0.66 * radius, 0.33 * radius] {
                let d = across * (r * cos) + away * (r * sin);
                if d.dot(&sharp) >= least {
                    low = low.min(r * cos);
                    high = high.max(r * cos);
                }
            }
        }
        if low > high {
            continue;
        }
        mark(
            fine,
            view,
            &(centre + across * low),
            &(centre + across * high),
        );
        if k == 0 && needle.bevel_length == 0.0 {
            // The rim of a flat end stands out where the axis is not square to the line of sight.
            for i in -16..=16 {
                let height = radius * f64::from(i) / 16.0;
                let half = across * (radius * radius - height * height).max(0.0).sqrt();
                let middle = centre + away * height;
                mark(fine, view, &(middle - half), &(middle + half));
            }
        }
    }
}

/// Marks the subpixels between two points across the needle.
fn mark(fine: &mut [bool], view: &View, from: &Vector3<f64>, to: &Vector3<f64>) {
    let (w, h) = (view.camera.width, view.camera.height);
    let (Some(a), Some(b)) = (view.project(from), view.project(to)) else {
        return;
    };
    let excess = EXCESS.min(0.45 * (b.0 - a.0).norm());
    let Some(inwards) = (b.0 - a.0).try_normalize(1e-9) else {
        return;
    };
    let (a, b) = (a.0 + inwards * excess, b.0 - inwards * excess);
    let dots = ((b - a).norm() * 2.0 * FINE as f64).ceil() as usize + 1;
    for i in 0..=dots {
        let p = a + (b - a) * (i as f64 / dots as f64);
        let (x, y) = (
            ((p.x + 0.5) * FINE as f64).floor(),
            ((p.y + 0.5) * FINE as f64).floor(),
        );
        if x >= 0.0 && y >= 0.0 && x < (w * FINE) as f64 && y < (h * FINE) as f64 {
            fine[y as usize * w * FINE + x as usize] = true;
        }
    }
}

fn blurred(values: &[f32], stride: usize, kernel: &[f32]) -> Vec<f32> {
    let half = kernel.len() / 2;
    let n = values.len();
    (0..n)
        .map(|i| {
            kernel
                .iter()
                .enumerate()
                .map(|(k, w)| {
                    let j = (i + k * stride).checked_sub(half * stride);
                    j.and_then(|j| values.get(j)).map_or(0.0, |v| v * w)
                })
                .sum()
        })
        .collect()
}

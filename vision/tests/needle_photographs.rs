//! The tracker on photographs of real needles, turned into exact stereo pairs.
//!
//! The needle lies in a plane at right angles to the camera's view, so that a second camera's
//! picture is a homography of the first. Read through `NEEDLE_STEER_REFERENCE`, never copied.
#![allow(
    clippy::unwrap_used,
    clippy::panic,
    clippy::print_stdout,
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    clippy::allow_attributes,
    reason = "a test reports, and fails where it cannot go on"
)]

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use hal::telemetry::Tracking;
use hal::{CameraFrame, GrayImage, Stamp, StereoFrame, Transform};
use nalgebra::{Isometry3, Point3, Vector3};
use vision::camera::{Camera, Distortion, StereoRig};
use vision::files::read_image;
use vision::track::{Appearance, Context, StereoTracker, TrackSettings};

/// Focal length of the photographs' virtual camera \[px\].
const FOCAL: f64 = 2000.0;
/// Resolution in the needle's plane \[px/m\]: 157 px on 28 mm.
const PX_PER_M: f64 = 157.0 / 0.028;
/// Distance of the needle's plane \[m\].
const DISTANCE: f64 = FOCAL / PX_PER_M;
/// Baseline of the parallel cameras \[m\].
const PARALLEL: f64 = 0.04;
/// Shortest shaft that must be found \[m\].
const SHAFT: f64 = 0.02;
/// Row at which the gel begins, about \[px\].
const SURFACE: f64 = 50.0;
/// Columns beside the needle's that a picture without it must have \[px\].
const ROOM: f64 = 150.0;

/// How the second camera stands.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Second {
    /// Turned by 30 degrees about the plane's middle.
    Turned,
    /// Beside the first, looking the same way.
    Parallel,
}

/// What is known of one photograph.
struct Reference {
    /// Column of the shaft's middle at each row \[px\].
    shaft: Vec<(f64, f64)>,
    tip: Option<(f64, f64)>,
}

/// A frame's number and its tip's row and column \[px\].
type Tip = (usize, Option<(f64, f64)>);

struct Sequence {
    name: String,
    frames: Vec<(GrayImage, Reference)>,
}

#[expect(
    clippy::disallowed_methods,
    reason = "tests are told where the photographs are"
)]
fn folder() -> Option<PathBuf> {
    let Ok(path) = std::env::var("NEEDLE_STEER_REFERENCE") else {
        println!("skipped: no photographs (NEEDLE_STEER_REFERENCE is not set)");
        return None;
    };
    let folder = PathBuf::from(path).join("real/photographs");
    assert!(folder.is_dir(), "{} is no folder", folder.display());
    Some(folder)
}

fn table(path: &Path) -> Vec<Vec<String>> {
    let text = std::fs::read_to_string(path).unwrap();
    let lines = text.lines().skip(1);
    lines
        .map(|l| l.split(',').map(str::to_owned).collect())
        .collect()
}

/// The photographs of every `every`th sequence, from the `first`.
fn sequences(folder: &Path, first: usize, every: usize) -> Vec<Sequence> {
    let mut shapes: BTreeMap<(String, usize), Vec<(f64, f64)>> = BTreeMap::new();
    for row in table(&folder.join("derived_shapes.csv")) {
        let point = (row[2].parse().unwrap(), row[3].parse().unwrap());
        let key = (row[0].clone(), row[1].parse().unwrap());
        shapes.entry(key).or_default().push(point);
    }
    let mut frames: BTreeMap<String, Vec<Tip>> = BTreeMap::new();
    for row in table(&folder.join("derived_tips.csv")) {
        let tip = row[2].parse().ok().zip(row[3].parse().ok());
        let frame = (row[1].parse().unwrap(), tip);
        frames.entry(row[0].clone()).or_default().push(frame);
    }
    let chosen = frames.into_iter().skip(first).step_by(every);
    chosen
        .map(|(name, mut frames)| {
            frames.sort_by_key(|frame| frame.0);
            let frames = frames
                .into_iter()
                .map(|(frame, tip)| {
                    let path = folder.join(&name).join(format!("ImgFeedback{frame}.jpg"));
                    let shaft = shapes.remove(&(name.clone(), frame)).unwrap_or_default();
                    (read_image(&path).unwrap(), Reference { shaft, tip })
                })
                .collect();
            Sequence { name, frames }
        })
        .collect()
}

/// A pair of cameras whose left one took the photograph.
fn rig(width: usize, height: usize, second: Second) -> StereoRig {
    let margin = match second {
        Second::Turned => 0,
        Second::Parallel => shift(),
    };
    let camera = |cx: f64| Camera {
        width: width + margin,
        height,
        fx: FOCAL,
        fy: FOCAL,
        cx,
        cy: (height as f64 - 1.0) * 0.5,
        distortion: Distortion::from_array([0.0; 5]),
    };
    let middle = (width as f64 - 1.0) * 0.5 + margin as f64;
    let centre = Isometry3::translation(0.0, 0.0, DISTANCE);
    let right_from_left = match second {
        Second::Turned => {
            centre * Isometry3::rotation(Vector3::y() * 30_f64.to_radians()) * centre.inverse()
        }
        Second::Parallel => Isometry3::translation(-PARALLEL, 0.0, 0.0),
    };
    StereoRig {
        left: camera(middle),
        right: camera(middle),
        right_from_left: Transform::assume(right_from_left),
        container: None,
    }
}

/// Disparity of the parallel cameras in the needle's plane \[px\].
fn shift() -> usize {
    (PARALLEL * PX_PER_M).round() as usize
}

/// Both cameras' pictures of a photograph.
fn pair(photograph: &GrayImage, rig: &StereoRig, second: Second, number: u64) -> StereoFrame {
    let (w, h) = (photograph.width(), photograph.height());
    let margin = if second == Second::Parallel {
        shift()
    } else {
        0
    };
    let views = rig.views();
    let picture = |k: usize| {
        let camera = views[k].camera;
        let back = views[k].camera_from_left.inverse();
        let (turn, eye) = (back.rotation.to_rotation_matrix(), back.translation.vector);
        let mut image = GrayImage::filled(camera.width, camera.height, 0);
        for (i, pixel) in image.pixels_mut().iter_mut().enumerate() {
            let (x, y) = ((i % camera.width) as f64, (i / camera.width) as f64);
            let sight = Vector3::new(x - camera.cx, y - camera.cy, FOCAL) / FOCAL;
            let sight = turn * sight;
            let at = eye + sight * ((DISTANCE - eye.z) / sight.z);
            let u = at.x * PX_PER_M + camera.cx - margin as f64;
            let v = at.y * PX_PER_M + camera.cy;
            if (0.0..=(w - 1) as f64).contains(&u) && (0.0..=(h - 1) as f64).contains(&v) {
                *pixel = sample(photograph, u, v);
            }
        }
        CameraFrame {
            stamp: Stamp::from_secs(number as f64),
            sequence: number,
            image: Arc::new(image),
        }
    };
    StereoFrame {
        left: picture(0),
        right: picture(1),
    }
}

fn sample(image: &GrayImage, u: f64, v: f64) -> u8 {
    let (x, y) = (
        (u as usize).min(image.width() - 2),
        (v as usize).min(image.height() - 2),
    );
    let (fx, fy) = (u - x as f64, v - y as f64);
    let at = |x: usize, y: usize| f64::from(image.row(y)[x]);
    let top = at(x, y) * (1.0 - fx) + at(x + 1, y) * fx;
    let below = at(x, y + 1) * (1.0 - fx) + at(x + 1, y + 1) * fx;
    (top * (1.0 - fy) + below * fy).round() as u8
}

fn tracker_of(rig: &StereoRig) -> StereoTracker {
    let needle = Appearance {
        diameter: 0.7e-3,
        bevel_length: 0.0,
    };
    StereoTracker::new(rig, needle, &TrackSettings::default()).unwrap()
}

#[derive(Default)]
struct Figures {
    frames: usize,
    found: usize,
    /// In-plane distance of the shaft, RMS a frame \[mm\].
    shaft: Vec<f64>,
    /// In-plane distance of the tip \[mm\].
    tip: Vec<f64>,
    /// Farthest from the plane \[mm\].
    depth: Vec<f64>,
    false_finds: usize,
    empty: usize,
    found_in_empty: usize,
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_by(f64::total_cmp);
    let last = values.len().saturating_sub(1) as f64;
    values
        .get((share * last).round() as usize)
        .copied()
        .unwrap_or(f64::NAN)
}

impl Figures {
    fn note(&mut self, name: &str, tracker: &StereoTracker, reference: &Reference, place: Place) {
        let Some(tip) = reference.tip else { return };
        if (tip.0 - SURFACE) / PX_PER_M < SHAFT {
            return;
        }
        self.frames += 1;
        let tracked = tracker.tracked();
        let found = tracked.status == Tracking::Tracked;
        let px = |p: &Point3<f64>| {
            (
                PX_PER_M * p.x + 0.5 * (place.size.0 as f64 - 1.0),
                PX_PER_M * p.y + 0.5 * (place.size.1 as f64 - 1.0),
            )
        };
        let mut said = format!("{:?}", tracked.loss);
        if found {
            let shape: Vec<_> = tracked
                .shape
                .points
                .iter()
                .map(|p| *p.position.point())
                .collect();
            let squares: Vec<f64> = reference
                .shaft
                .iter()
                .filter_map(|(y, x)| {
                    let y = *y;
                    let pairs = shape.windows(2).map(|w| (px(&w[0]), px(&w[1])));
                    let mut hits = pairs.filter(|(a, b)| (a.1 <= y) != (b.1 <= y));
                    let (a, b) = hits.next()?;
                    let at = a.0 + (b.0 - a.0) * (y - a.1) / (b.1 - a.1);
                    Some(((at - x) * 1e3 / PX_PER_M).powi(2))
                })
                .collect();
            let rms = (squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt();
            let share = squares.len() as f64 / reference.shaft.len().max(1) as f64;
            let end = px(tracked.shape.tip.position.point());
            let error = (end.0 - tip.1).hypot(end.1 - tip.0) * 1e3 / PX_PER_M;
            let depth = shape.iter().map(|p| (p.z - DISTANCE).abs() * 1e3);
            let depth = depth.fold(0.0, f64::max);
            said = format!(
                "tip {:.1} mm ahead, shaft {rms:.3} mm over {:.0} %, tip {error:.2} mm, depth {depth:.2} mm",
                (end.1 - tip.0) * 1e3 / PX_PER_M,
                100.0 * share
            );
            // Another line in the image is no needle found.
            if rms < 1.0 && share > 0.3 {
                self.found += 1;
                self.shaft.push(rms);
                self.tip.push(error);
                self.depth.push(depth);
                if rms < 0.2 && error < 1.5 {
                    return;
                }
            } else {
                self.false_finds += 1;
                said = format!("FALSE {said}");
            }
        }
        println!("  {name} {}: tip at {:.0}: {said}", place.number, tip.0);
    }

    fn report(&mut self, name: &str) {
        let n = self.frames.max(1) as f64;
        let within = self.tip.iter().filter(|e| **e <= 1.5).count() as f64;
        println!(
            "{name}: {} of {} found ({:.1} %), shaft median {:.3} mm, 90 % {:.3} mm; tip within 1.5 mm {:.1} %, \
             median {:.2} mm; off the plane 50 % {:.2} 90 % {:.2} mm; {} false beside a needle, {} of {} without one",
            self.found,
            self.frames,
            100.0 * self.found as f64 / n,
            quantile(&mut self.shaft, 0.5),
            quantile(&mut self.shaft, 0.9),
            100.0 * within / self.tip.len().max(1) as f64,
            quantile(&mut self.tip, 0.5),
            quantile(&mut self.depth, 0.5),
            quantile(&mut self.depth, 0.9),
            self.false_finds,
            self.found_in_empty,
            self.empty
        );
    }
}

/// Where in which photograph.
#[derive(Clone, Copy)]
struct Place {
    number: usize,
    size: (usize, usize),
}

/// Cuts a part without the needle out of a photograph.
fn without(photograph: &GrayImage, reference: &Reference) -> Option<GrayImage> {
    let columns = reference
        .shaft
        .iter()
        .map(|p| p.1)
        .chain(reference.tip.map(|t| t.1));
    let (low, high) = columns.fold((f64::MAX, f64::MIN), |(l, h), x| (l.min(x), h.max(x)));
    let width = photograph.width() as f64;
    let (from, to) = if low > width - high {
        (0.0, low - 20.0)
    } else {
        (high + 20.0, width)
    };
    if reference.shaft.is_empty() || to - from < ROOM {
        return None;
    }
    let (from, to) = (from as usize, to as usize);
    let rows = (0..photograph.height()).flat_map(|y| photograph.row(y)[from..to].iter().copied());
    GrayImage::from_pixels(to - from, photograph.height(), rows.collect()).ok()
}

fn measure(name: &str, sequences: &[Sequence], second: Second, film: bool) -> Figures {
    let mut figures = Figures::default();
    for sequence in sequences {
        let first = &sequence.frames[0].0;
        let rig_of = rig(first.width(), first.height(), second);
        let mut tracker = tracker_of(&rig_of);
        for (number, (photograph, reference)) in sequence.frames.iter().enumerate() {
            if !film {
                tracker = tracker_of(&rig_of);
            }
            let pair = pair(photograph, &rig_of, second, number as u64);
            tracker.track(&pair, &Context::default()).unwrap();
            let place = Place {
                number: number + 1,
                size: (photograph.width(), photograph.height()),
            };
            figures.note(&sequence.name, &tracker, reference, place);
            if !film && let Some(empty) = without(photograph, reference) {
                let rig = rig(empty.width(), empty.height(), second);
                let mut tracker = tracker_of(&rig);
                let pair = self::pair(&empty, &rig, second, 0);
                let tracked = tracker.track(&pair, &Context::default()).unwrap();
                figures.empty += 1;
                if tracked.status == Tracking::Tracked {
                    figures.found_in_empty += 1;
                    let [l, r] = tracked.curves.map(|c| c.map(|c| (c.at(0.0), c.tip())));
                    println!(
                        "  {} {}: in a picture without a needle {l:?} {r:?}",
                        sequence.name,
                        number + 1
                    );
                }
            }
        }
    }
    figures.report(name);
    figures
}

/// Every one of so many sequences is gone through; all of them take some minutes.
#[expect(
    clippy::disallowed_methods,
    reason = "a measurement is told how much to measure"
)]
fn step() -> usize {
    let step = std::env::var("PHOTOGRAPHS_STEP");
    step.ok().and_then(|s| s.parse().ok()).unwrap_or(1)
}

/// Which of the four measurements are made, by their letters.
#[expect(
    clippy::disallowed_methods,
    reason = "a measurement is told how much to measure"
)]
fn wanted() -> String {
    std::env::var("PHOTOGRAPHS_WAYS").unwrap_or_else(|_| "tfpq".to_owned())
}

#[test]
#[ignore = "takes minutes; a shorter one runs always"]
fn needles_in_all_photographs() {
    let Some(folder) = folder() else { return };
    let sequences = sequences(&folder, 0, step());
    for (letter, name, second, film) in [
        ('t', "turned, frame by frame", Second::Turned, false),
        ('f', "turned, films", Second::Turned, true),
        ('p', "parallel, frame by frame", Second::Parallel, false),
        ('q', "parallel, films", Second::Parallel, true),
    ] {
        if wanted().contains(letter) {
            measure(name, &sequences, second, film);
        }
    }
}

#[test]
fn needles_in_some_photographs_are_found_with_their_tips() {
    let Some(folder) = folder() else { return };
    let sequences = sequences(&folder, 3, 14);
    for (name, second, film) in [
        ("turned, frame by frame", Second::Turned, false),
        ("parallel, films", Second::Parallel, true),
    ] {
        let figures = measure(name, &sequences, second, film);
        let share = figures.found as f64 / figures.frames as f64;
        assert!(share >= 0.97, "{name}: {share} found");
        assert_eq!((figures.false_finds, figures.found_in_empty), (0, 0));
        let median = quantile(&mut figures.shaft.clone(), 0.5);
        assert!(median <= 0.15, "{name}: shaft {median} mm");
        let within = figures.tip.iter().filter(|e| **e <= 1.5).count();
        assert!(10 * within >= 9 * figures.found, "{name}: {within} tips");
    }
}

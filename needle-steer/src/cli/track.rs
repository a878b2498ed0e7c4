//! `track`: the needle in recorded pairs of images.

use std::fs::{File, OpenOptions};
use std::io::{BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::Context as _;
use clap::Args;
use hal::telemetry::Tracking;
use hal::{CameraFrame, Stamp, StereoFrame};
use nalgebra::{Matrix3, Point3};
use serde::Serialize;
use vision::DistortedPx;
use vision::files::{FileError, read_image, same_size, write_overlay};
use vision::track::{Appearance, Context, FrameError, Loss, StereoTracker, TrackSettings, Tracked};

use super::{Usage, calibration, print_json};
use crate::sight;

#[derive(Debug, Args)]
pub(super) struct TrackArgs {
    /// Images of the left camera, in the order of time.
    #[arg(long, required = true, num_args = 1..)]
    left: Vec<PathBuf>,
    /// Images of the right camera, in the same order.
    #[arg(long, required = true, num_args = 1..)]
    right: Vec<PathBuf>,
    /// The stereo calibration: one file, or two (both cameras', left first, or intrinsics and
    /// extrinsics). OpenCV, ROS `camera_info`, Kalibr; refraction counts if it names the
    /// container's windows.
    #[arg(long, required = true, num_args = 1..=2)]
    calibration: Vec<PathBuf>,
    /// Unit of the calibration's lengths \[mm\], where it is not the metre: 1 for millimetres.
    #[arg(long)]
    unit_mm: Option<f64>,
    /// File for the results: a JSON line a frame. Nothing is written over.
    #[arg(long)]
    out: PathBuf,
    /// Length of the bevel along the needle's axis \[mm\]; 0 for a flat tip.
    #[arg(long, default_value_t = 0.0)]
    bevel_mm: f64,
    /// Outer diameter of the needle \[mm\].
    #[arg(long, default_value_t = 0.7)]
    diameter_mm: f64,
    /// Two points on the needle in the first left image, its tip second: x,y,x,y \[px\]. Without,
    /// the needle is sought.
    #[arg(long, requires = "start_right", allow_hyphen_values = true)]
    start_left: Option<String>,
    /// The same in the first right image.
    #[arg(long, requires = "start_left", allow_hyphen_values = true)]
    start_right: Option<String>,
    /// Folder for a picture a frame: both images, the curve in red; made if missing.
    #[arg(long)]
    overlay: Option<PathBuf>,
    /// Rate at which the images were taken \[Hz\].
    #[arg(long, default_value_t = 30.0)]
    rate_hz: f64,
    /// Print a summary as JSON.
    #[arg(long)]
    json: bool,
}

/// One frame's results.
#[derive(Serialize)]
struct Line {
    frame: usize,
    status: &'static str,
    tip_m: Option<[f64; 3]>,
    shape_m: Option<Vec<[f64; 3]>>,
    tip_covariance_m2: Option<[[f64; 3]; 3]>,
    left_tip_px: Option<[f64; 2]>,
    right_tip_px: Option<[f64; 2]>,
    tip_point_m: Option<[f64; 3]>,
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
}

#[derive(Default, Serialize)]
struct Summary {
    frames: usize,
    tracked: usize,
    predicted: usize,
    lost: usize,
    out: PathBuf,
}

pub(super) fn execute(args: &TrackArgs) -> anyhow::Result<ExitCode> {
    let mut tracker = prepare(args)?;
    let mut out = create(&args.out)?;
    let tracked = track(args, &mut tracker, &mut out);
    let tracked = tracked.and_then(|(summary, problem)| {
        if summary.tracked == 0 {
            return Err(nowhere(args, &problem).into());
        }
        out.flush()
            .with_context(|| args.out.display().to_string())?;
        Ok(summary)
    });
    if tracked.is_err() {
        // Half a result would look like a whole one.
        let _ = std::fs::remove_file(&args.out);
        if let Some(folder) = &args.overlay {
            for frame in 0..args.left.len() {
                let _ = std::fs::remove_file(picture(folder, frame));
            }
            // Stays if there was something else in it.
            let _ = std::fs::remove_dir(folder);
        }
    }
    let summary = tracked?;
    if args.json {
        print_json(&summary)?;
    } else {
        writeln!(
            std::io::stdout(),
            "{} frames: {} tracked, {} predicted, {} lost; written to {}",
            summary.frames,
            summary.tracked,
            summary.predicted,
            summary.lost,
            args.out.display()
        )?;
    }
    Ok(ExitCode::SUCCESS)
}

/// No pair shows a needle; `problem` is what the first one that says more than that had.
fn nowhere(args: &TrackArgs, problem: &str) -> Usage {
    Usage(format!(
        "the needle was found in none of {} pairs ({problem}): are these its images, and is {} the calibration of their cameras?",
        args.left.len(),
        calibration::names(&args.calibration)
    ))
}

/// Checks everything that can be checked before the first frame.
fn prepare(args: &TrackArgs) -> Result<StereoTracker, Usage> {
    if args.left.len() != args.right.len() {
        return Err(Usage(format!(
            "--left names {} images, --right {}: every pair needs both",
            args.left.len(),
            args.right.len()
        )));
    }
    if !(args.rate_hz.is_finite() && args.rate_hz > 0.0) {
        return Err(Usage(format!(
            "--rate-hz {}: expected a number above 0",
            args.rate_hz
        )));
    }
    let left_size = same_size(&args.left).map_err(refused)?;
    let right_size = same_size(&args.right).map_err(refused)?;
    let sizes = [left_size, right_size];
    let calibration = calibration::read(&args.calibration, args.unit_mm, Some(sizes))?;
    if let Some(path) = args.calibration.first() {
        calibration.check_sizes(path, sizes).map_err(refused)?;
    }
    let needle = appearance(args)?;
    let mut tracker = StereoTracker::new(&calibration.rig, needle, &TrackSettings::default())
        .map_err(|e| Usage(e.to_string()))?;
    if let (Some(left), Some(right)) = (&args.start_left, &args.start_right) {
        tracker.start_at(
            clicks("--start-left", left, left_size)?,
            clicks("--start-right", right, right_size)?,
        );
    }
    if let Some(folder) = &args.overlay {
        let pictures = (0..args.left.len()).map(|frame| picture(folder, frame));
        if let Some(there) = pictures.into_iter().find(|path| path.exists()) {
            return Err(exists(&there));
        }
        std::fs::create_dir_all(folder).map_err(|e| Usage(format!("{}: {e}", folder.display())))?;
    }
    Ok(tracker)
}

#[expect(clippy::needless_pass_by_value, reason = "as `map_err` hands it over")]
fn refused(error: FileError) -> Usage {
    Usage(error.to_string())
}

fn exists(path: &Path) -> Usage {
    Usage(format!(
        "{}: is there already, and nothing is written over",
        path.display()
    ))
}

fn appearance(args: &TrackArgs) -> Result<Appearance, Usage> {
    let millimetres = |option: &str, value: f64, lowest: f64, highest: f64| {
        if value >= lowest && value <= highest {
            return Ok(value * 1e-3);
        }
        Err(Usage(format!(
            "--{option} {value}: expected millimetres from {lowest} to {highest}"
        )))
    };
    Ok(Appearance {
        diameter: millimetres("diameter-mm", args.diameter_mm, 0.05, 10.0)?,
        bevel_length: millimetres("bevel-mm", args.bevel_mm, 0.0, 20.0)?,
    })
}

/// Two points of an image.
fn clicks(option: &str, text: &str, size: (usize, usize)) -> Result<[DistortedPx; 2], Usage> {
    let wrong = || {
        Usage(format!(
            "{option} {text}: expected x,y,x,y: two points in images of {} x {}",
            size.0, size.1
        ))
    };
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    let numbers = numbers.ok_or_else(wrong)?;
    let [x1, y1, x2, y2] = numbers[..] else {
        return Err(wrong());
    };
    let point = |x: f64, y: f64| {
        let inside = |v: f64, pixels: usize| v >= -0.5 && v <= pixels as f64 - 0.5;
        let seen = inside(x, size.0) && inside(y, size.1);
        seen.then(|| DistortedPx([x, y].into())).ok_or_else(wrong)
    };
    let points = [point(x1, y1)?, point(x2, y2)?];
    if points[0].0 == points[1].0 {
        return Err(wrong());
    }
    Ok(points)
}

fn create(path: &Path) -> Result<BufWriter<File>, Usage> {
    let file = OpenOptions::new().write(true).create_new(true).open(path);
    file.map(BufWriter::new).map_err(|e| match e.kind() {
        ErrorKind::AlreadyExists => exists(path),
        _ => Usage(format!("{}: {e}", path.display())),
    })
}

fn picture(folder: &Path, frame: usize) -> PathBuf {
    folder.join(format!("frame-{frame:06}.png"))
}

fn track(
    args: &TrackArgs,
    tracker: &mut StereoTracker,
    out: &mut impl Write,
) -> anyhow::Result<(Summary, String)> {
    let mut summary = Summary {
        out: args.out.clone(),
        ..Summary::default()
    };
    let mut problem = String::new();
    let not_found = sight::problem(&Loss::NotFound);
    for (frame, (left, right)) in args.left.iter().zip(&args.right).enumerate() {
        let pair = pair([left, right], frame, args.rate_hz).map_err(refused)?;
        let refused = tracker.track(&pair, &Context::default()).err();
        let tracked = tracker.tracked();
        let line = line(frame, tracked, refused.as_ref(), args.bevel_mm * 1e-3);
        if let Some(text) = &line.problem
            && (problem.is_empty() || problem == not_found)
        {
            problem.clone_from(text);
        }
        summary.frames += 1;
        *match tracked.status {
            Tracking::Tracked => &mut summary.tracked,
            Tracking::Predicted => &mut summary.predicted,
            Tracking::None | Tracking::Lost => &mut summary.lost,
        } += 1;
        serde_json::to_writer(&mut *out, &line)
            .map_err(anyhow::Error::from)
            .and_then(|()| Ok(writeln!(out)?))
            .with_context(|| args.out.display().to_string())?;
        if let Some(folder) = &args.overlay {
            let images = [pair.left.image.as_ref(), pair.right.image.as_ref()];
            write_overlay(&picture(folder, frame), images, &tracked.curves)?;
        }
    }
    Ok((summary, problem))
}

fn pair(files: [&PathBuf; 2], frame: usize, rate_hz: f64) -> Result<StereoFrame, FileError> {
    let stamp = Stamp::from_secs(frame as f64 / rate_hz);
    let read = |path: &Path| {
        Ok(CameraFrame {
            stamp,
            sequence: frame as u64,
            image: Arc::new(read_image(path)?),
        })
    };
    Ok(StereoFrame {
        left: read(files[0])?,
        right: read(files[1])?,
    })
}

fn line(frame: usize, tracked: &Tracked, refused: Option<&FrameError>, bevel: f64) -> Line {
    let status = match tracked.status {
        Tracking::Tracked => "tracked",
        Tracking::Predicted => "predicted",
        Tracking::None | Tracking::Lost => "lost",
    };
    let known = status != "lost";
    let shape = &tracked.shape;
    let tip = known.then(|| shape.tip.position.point());
    let pixel = |k: usize| {
        let curve = tracked.curves[k].filter(|_| known)?;
        Some([curve.tip().x, curve.tip().y])
    };
    Line {
        frame,
        status,
        tip_m: tip.map(coordinates),
        shape_m: known.then(|| {
            let points = shape.points.iter();
            points.map(|p| coordinates(p.position.point())).collect()
        }),
        tip_covariance_m2: known.then(|| rows(&shape.tip.covariance)),
        left_tip_px: pixel(0),
        right_tip_px: pixel(1),
        // Images do not tell to which side of the axis the bevel's point lies.
        tip_point_m: tip
            .filter(|_| bevel > 0.0)
            .map(|tip| coordinates(&(tip + shape.tip.direction.into_inner() * bevel))),
        problem: refused
            .map(ToString::to_string)
            .or_else(|| tracked.loss.as_ref().map(sight::problem)),
    }
}

fn coordinates(point: &Point3<f64>) -> [f64; 3] {
    point.coords.into()
}

fn rows(matrix: &Matrix3<f64>) -> [[f64; 3]; 3] {
    core::array::from_fn(|i| core::array::from_fn(|j| matrix[(i, j)]))
}

//! `track`: the needle in recorded images of two cameras, or of one and a known plane.

mod input;

use std::fs::{File, OpenOptions};
use std::io::{BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::Context as _;
use clap::Args;
use hal::telemetry::Tracking;
use hal::{CameraFrame, GrayImage, Stamp, StereoFrame};
use serde::Serialize;
use vision::files::{FileError, Pixels, read_image_of, write_overlay};
use vision::track::{Context, FrameError, Tracked};

use super::images::ImageArgs;
use super::{Usage, print_json};
use crate::tracked::Line;
use input::{Tracker, out_of_order, picture, prepare, refused};

#[derive(Debug, Args)]
pub(super) struct TrackArgs {
    /// Images of the left camera, or of the only one, in the order of time.
    #[arg(long, required = true, num_args = 1..)]
    left: Vec<PathBuf>,
    /// Images of the right camera, in the same order.
    #[arg(long, required_unless_present = "plane", conflicts_with = "plane", num_args = 1..)]
    right: Vec<PathBuf>,
    #[command(flatten)]
    images: ImageArgs,
    /// The stereo calibration; refraction counts if it names the container's windows. With
    /// `--plane`, that of one camera, or a stereo calibration whose left camera it is.
    /// One file, or two: both cameras', left first, or intrinsics and extrinsics; OpenCV, ROS
    /// `camera_info`, Kalibr.
    #[arg(long, required = true, num_args = 1..=2)]
    calibration: Vec<PathBuf>,
    /// Unit of the calibration's lengths [mm], where it is not the metre: 1 for millimetres.
    #[arg(long)]
    unit_mm: Option<f64>,
    /// One camera only: the plane in which the needle moves, in the camera's frame (x right, y
    /// down, z ahead), as a point [mm] and a normal: x,y,z,nx,ny,nz. At right angles to the view
    /// at 350 mm: 0,0,350,0,0,1.
    #[arg(long, allow_hyphen_values = true)]
    plane: Option<String>,
    /// How far off the plane the needle may be (1 sigma) [mm]; part of the tip's covariance.
    #[arg(long, default_value_t = 0.5, requires = "plane")]
    plane_sigma_mm: f64,
    /// File for the results: a JSON line a frame. Nothing is written over.
    #[arg(long)]
    out: PathBuf,
    /// Length of the bevel along the needle's axis [mm]; 0 for a flat tip.
    #[arg(long, default_value_t = 0.0)]
    bevel_mm: f64,
    /// Outer diameter of the needle [mm]: a hint, the width in the images counts.
    #[arg(long, default_value_t = 0.7)]
    diameter_mm: f64,
    /// Blur of the images, as a Gaussian [px]; without, it is found in the images.
    #[arg(long)]
    blur_px: Option<f64>,
    /// The needle is brighter than what is behind it; without, that is found in the images.
    #[arg(long)]
    bright: bool,
    /// Two points on the needle in the first left image, its tip second: x,y,x,y [px]. Without,
    /// the needle is sought.
    #[arg(long, allow_hyphen_values = true)]
    start_left: Option<String>,
    /// The same in the first right image.
    #[arg(long, requires = "start_left", allow_hyphen_values = true)]
    start_right: Option<String>,
    /// Folder for a picture a frame: the images, the curve in red, where there is none what was
    /// considered in blue; made if missing.
    #[arg(long)]
    overlay: Option<PathBuf>,
    /// Rate at which the images were taken [Hz].
    #[arg(long, default_value_t = 30.0)]
    rate_hz: f64,
    /// Print a summary as JSON.
    #[arg(long)]
    json: bool,
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
    if args.plane.is_none() && args.start_left.is_some() != args.start_right.is_some() {
        let text = "--start-left needs --start-right: points in both images of the first pair";
        return Err(Usage(text.to_owned()).into());
    }
    let mut tracker = prepare(args)?;
    if out_of_order(&args.left) || out_of_order(&args.right) {
        writeln!(
            std::io::stderr(),
            "the images come in the order of the alphabet (1, 10, 2), not of their numbers: if that is not \
             the order of time, `ls -v` gives it"
        )?;
    }
    if let Some(folder) = &args.overlay {
        let pictures = (0..args.left.len()).map(|frame| picture(folder, frame));
        if let Some(there) = pictures.into_iter().find(|path| path.exists()) {
            return Err(exists(&there).into());
        }
        std::fs::create_dir_all(folder).map_err(|e| Usage(format!("{}: {e}", folder.display())))?;
    }
    let mut out = create(&args.out)?;
    let tracked = track(args, &mut tracker, &mut out).and_then(|result| {
        out.flush()
            .with_context(|| args.out.display().to_string())?;
        Ok(result)
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
    let (summary, reason) = tracked?;
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
    if summary.tracked == 0 {
        writeln!(
            std::io::stderr(),
            "the needle was found in none of {} frames; the first: {reason}. {} has the reason for each; \
             --overlay draws what was considered, --start-left{} shows where to look",
            summary.frames,
            args.out.display(),
            if args.plane.is_some() {
                ""
            } else {
                " and --start-right"
            }
        )?;
        return Ok(ExitCode::FAILURE);
    }
    Ok(ExitCode::SUCCESS)
}

fn exists(path: &Path) -> Usage {
    Usage(format!(
        "{}: is there already, and nothing is written over",
        path.display()
    ))
}

fn create(path: &Path) -> Result<BufWriter<File>, Usage> {
    let file = OpenOptions::new().write(true).create_new(true).open(path);
    file.map(BufWriter::new).map_err(|e| match e.kind() {
        ErrorKind::AlreadyExists => exists(path),
        _ => Usage(format!("{}: {e}", path.display())),
    })
}

impl Tracker {
    /// Takes the images of one frame in; answers what was wrong with them.
    fn take(&mut self, frames: &[CameraFrame]) -> Option<FrameError> {
        match (self, frames) {
            (Self::Stereo(tracker), [left, right]) => {
                let pair = StereoFrame {
                    left: left.clone(),
                    right: right.clone(),
                };
                tracker.track(&pair, &Context::default()).err()
            }
            (Self::Plane(tracker), [image, ..]) => tracker.track(image).err(),
            _ => None,
        }
    }

    const fn tracked(&self) -> &Tracked {
        match self {
            Self::Stereo(tracker) => tracker.tracked(),
            Self::Plane(tracker) => tracker.tracked(),
        }
    }
}

/// Goes through all frames; answers the reason of the first that was not tracked, too.
fn track(
    args: &TrackArgs,
    tracker: &mut Tracker,
    out: &mut impl Write,
) -> anyhow::Result<(Summary, String)> {
    let mut summary = Summary {
        out: args.out.clone(),
        ..Summary::default()
    };
    let mut reason = String::new();
    for (number, left) in args.left.iter().enumerate() {
        let files = [Some(left), args.right.get(number)];
        let frames: Result<Vec<_>, FileError> = files
            .into_iter()
            .flatten()
            .map(|path| read(path, args.images.pixels(), number, args.rate_hz))
            .collect();
        let frames = frames.map_err(refused)?;
        let refused = tracker.take(&frames);
        let tracked = tracker.tracked();
        let line = Line::new(number, tracked, refused.as_ref(), args.bevel_mm * 1e-3);
        if let (Some(text), true) = (&line.reason, reason.is_empty()) {
            reason.clone_from(text);
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
            let images: Vec<&GrayImage> = frames.iter().map(|f| f.image.as_ref()).collect();
            let path = picture(folder, number);
            write_overlay(&path, &images, &tracked.curves, &tracked.considered)?;
        }
    }
    Ok((summary, reason))
}

fn read(
    path: &Path,
    pixels: Pixels,
    number: usize,
    rate_hz: f64,
) -> Result<CameraFrame, FileError> {
    Ok(CameraFrame {
        stamp: Stamp::from_secs(number as f64 / rate_hz),
        sequence: number as u64,
        image: Arc::new(read_image_of(path, pixels)?),
    })
}

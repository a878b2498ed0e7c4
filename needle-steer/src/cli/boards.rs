//! `calibrate corners` and `calibrate mono`.

use std::io::Write as _;
use std::path::PathBuf;
use std::process::ExitCode;

use anyhow::Context as _;
use clap::Args;
use serde::Serialize;
use vision::calibrate::{Board, BoardView, StereoOptions, calibrate_mono};
use vision::detect::RefineOptions;
use vision::files::{camera_info_of, read_image_of, read_images, write_all};

use super::calibrate::{board_kind, name, square};
use super::images::ImageArgs;
use super::{Usage, print_json};
use crate::results::check_free;
use crate::stereo::{CameraOutput, LENSES, camera_output, lens};

#[derive(Debug, Args)]
pub(super) struct CornersArgs {
    /// Images of the board.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// The board: 9x6 (inner corners of a chessboard), charuco:7x5:DICT_4X4_50, circles:4x11.
    #[arg(long)]
    board: String,
    #[command(flatten)]
    images: ImageArgs,
    /// Print the corners as JSON; else as a table.
    #[arg(long)]
    json: bool,
}

/// One image's corners.
#[derive(Serialize)]
struct ImageCorners {
    file: PathBuf,
    width_px: usize,
    height_px: usize,
    corners_px: Option<Vec<Option<[f64; 2]>>>,
    #[serde(skip_serializing_if = "Option::is_none")]
    problem: Option<String>,
}

pub(super) fn corners(args: &CornersArgs) -> anyhow::Result<ExitCode> {
    let kind = board_kind(&args.board)?;
    let mut images = Vec::with_capacity(args.files.len());
    for file in &args.files {
        let image = read_image_of(file, args.images.pixels()).map_err(|e| Usage(e.to_string()))?;
        let found = kind.detect(&image, &RefineOptions::default());
        let (corners_px, problem) = match found {
            Ok(board) => {
                let corners = board.into_iter().map(|p| p.map(|p| [p.x, p.y]));
                (Some(corners.collect()), None)
            }
            Err(e) => (None, Some(e.to_string())),
        };
        images.push(ImageCorners {
            file: file.clone(),
            width_px: image.width(),
            height_px: image.height(),
            corners_px,
            problem,
        });
    }
    if images.iter().all(|i| i.corners_px.is_none()) {
        let why: Vec<String> = images
            .iter()
            .filter_map(|i| Some(format!("{}: {}", i.file.display(), i.problem.as_ref()?)))
            .collect();
        return Err(Usage(format!(
            "the board of {} was found in none of {} images; {}",
            args.board,
            images.len(),
            why.join("; ")
        ))
        .into());
    }
    if args.json {
        print_json(&images)?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut stdout = std::io::stdout().lock();
    for image in &images {
        let file = image.file.display();
        match (&image.corners_px, &image.problem) {
            (Some(corners), _) => {
                let seen = corners.iter().flatten().count();
                writeln!(stdout, "{file}: {seen} of {} corners", corners.len())?;
                for corner in corners {
                    match corner {
                        Some([x, y]) => writeln!(stdout, "  {x:.3} {y:.3}")?,
                        None => writeln!(stdout, "  -")?,
                    }
                }
            }
            (None, problem) => writeln!(stdout, "{file}: {}", problem.as_deref().unwrap_or(""))?,
        }
    }
    Ok(ExitCode::SUCCESS)
}

#[derive(Debug, Args)]
pub(super) struct MonoArgs {
    /// Images of the camera.
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// The board: 9x6 (inner corners of a chessboard), charuco:7x5:DICT_4X4_50 (squares, OpenCV's
    /// dictionary; parts of it count), circles:4x11 (asymmetric grid).
    #[arg(long)]
    board: String,
    /// Side of a square, of circles the distance of two rows [mm].
    #[arg(long)]
    square_mm: f64,
    /// Model of the lens.
    #[arg(long, default_value = "plumb_bob", value_parser = LENSES)]
    lens: String,
    #[command(flatten)]
    images: ImageArgs,
    /// Folder for `camera.yaml` (ROS `camera_info`), made if missing; nothing is written over.
    #[arg(long)]
    out: PathBuf,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Serialize)]
struct MonoOutput<'a> {
    rms_px: f64,
    lens: &'a str,
    camera: CameraOutput,
    sigma: &'a [f64],
    views: Vec<ViewOutput<'a>>,
    rejected: &'a [String],
}

#[derive(Serialize)]
struct ViewOutput<'a> {
    image: &'a str,
    rms_px: f64,
}

pub(super) fn mono(args: &MonoArgs) -> anyhow::Result<ExitCode> {
    let kind = board_kind(&args.board)?;
    let board = Board::new(&kind, square(args.square_mm)?);
    let file = args.out.join("camera.yaml");
    check_free(&file)?;
    let images =
        read_images(&args.files, args.images.pixels()).map_err(|e| Usage(e.to_string()))?;
    let size = images.first().map_or((0, 0), |i| (i.width(), i.height()));
    let (mut views, mut rejected) = (Vec::new(), Vec::new());
    for (k, image) in images.iter().enumerate() {
        let name = name(args.files.get(k));
        match kind.detect(image, &RefineOptions::default()) {
            Ok(corners) => views.push(BoardView { name, corners }),
            Err(e) => rejected.push(format!("{name}: {e}")),
        }
    }
    let options = StereoOptions {
        lens: lens(&args.lens),
        ..StereoOptions::default()
    };
    let found = calibrate_mono(&board.points(), &views, size, rejected, &options)
        .map_err(|e| Usage(e.to_string()))?;
    std::fs::create_dir_all(&args.out).with_context(|| args.out.display().to_string())?;
    let info = camera_info_of(&found.camera, "camera");
    write_all(&[(file, info.to_yaml())])?;
    if args.json {
        print_json(&MonoOutput {
            rms_px: found.rms_px,
            lens: &args.lens,
            camera: camera_output(&found.camera),
            sigma: &found.sigmas,
            views: found
                .views
                .iter()
                .map(|(image, rms_px)| ViewOutput {
                    image,
                    rms_px: *rms_px,
                })
                .collect(),
            rejected: &found.rejected,
        })?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut stdout = std::io::stdout().lock();
    writeln!(
        stdout,
        "{} images, {} rejections",
        found.views.len(),
        found.rejected.len()
    )?;
    for rejected in &found.rejected {
        writeln!(stdout, "  {rejected}")?;
    }
    let (camera, sigma) = (&found.camera, &found.sigmas);
    writeln!(
        stdout,
        "RMS {:.4} px; fx {:.2} (sigma {:.2}), fy {:.2} ({:.2}), cx {:.2} ({:.2}), cy {:.2} ({:.2}) px",
        found.rms_px,
        camera.fx,
        sigma[0],
        camera.fy,
        sigma[1],
        camera.cx,
        sigma[2],
        camera.cy,
        sigma[3]
    )?;
    writeln!(stdout, "camera.yaml in {}", args.out.display())?;
    Ok(ExitCode::SUCCESS)
}

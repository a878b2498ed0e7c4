//! `calibrate stereo`, `calibrate register` and `calibrate distortion`.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::{Args, Subcommand};
use vision::calibrate::{StereoCalibration, rectify};
use vision::detect::BoardKind;
use vision::files::{camchain, write_all};
use vision::register::{
    RegistrationError, RegistrationFile, assumed_calibration, read_poses, register,
};

use super::images::ImageArgs;
use super::{Usage, boards, calibration, print_json};
use crate::identify::distortion::{Lie, map_of};
use crate::results::check_free;
use crate::stereo::{self, LENSES, Request, calibrate, output, write};

/// Camera calibration and registration.
#[derive(Debug, Subcommand)]
pub(super) enum CalibrateCommand {
    /// Stereo calibration from photographs of a board.
    Stereo(StereoArgs),
    /// Calibration of one camera from photographs of a board.
    Mono(boards::MonoArgs),
    /// Corner pixels of a board in photographs, as `register` wants them.
    Corners(boards::CornersArgs),
    /// Registration of the cameras to the arm from recorded poses.
    Register(RegisterArgs),
    /// Map of an electromagnetic field's distortion from a needle in air, its guide at known places.
    Distortion(DistortionArgs),
}

#[derive(Debug, Args)]
pub(super) struct StereoArgs {
    /// Images of the left camera.
    #[arg(long, required = true, num_args = 1..)]
    left: Vec<PathBuf>,
    /// Images of the right camera, in the same order.
    #[arg(long, required = true, num_args = 1..)]
    right: Vec<PathBuf>,
    /// The board: 9x6 (inner corners of a chessboard), charuco:7x5:DICT_4X4_50 (squares, OpenCV's
    /// dictionary; parts of it count), circles:4x11 (asymmetric grid).
    #[arg(long)]
    board: String,
    /// Side of a square, of circles the distance of two rows [mm].
    #[arg(long)]
    square_mm: f64,
    #[command(flatten)]
    images: ImageArgs,
    /// Folder for `report.html`, `left.yaml`, `right.yaml`, `stereo.yml`, and `camchain.yaml`
    /// where Kalibr has the lens model (`radtan`, `equidistant`); made if missing; nothing is written over.
    #[arg(long)]
    out: PathBuf,
    /// Model of both lenses.
    #[arg(long, default_value = "plumb_bob", value_parser = LENSES)]
    lens: String,
    /// Print the result as JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
pub(super) struct RegisterArgs {
    /// Recorded poses (JSON).
    poses: Option<PathBuf>,
    /// The stereo calibration: one file, or two (both cameras', left first, or intrinsics and
    /// extrinsics).
    #[arg(long, required = true, num_args = 1..=2)]
    calibration: Vec<PathBuf>,
    /// Unit of the calibration's lengths [mm], where it is not the metre: 1 for millimetres.
    #[arg(long)]
    unit_mm: Option<f64>,
    /// File for the registration (JSON); nothing is written over.
    #[arg(long)]
    out: PathBuf,
    /// Print the registration as JSON.
    #[arg(long)]
    json: bool,
}

#[derive(Debug, Args)]
pub(super) struct DistortionArgs {
    /// Table: `depth_mm`, `guide_*_mm` (the tip's place at depth 0; along the insertion it may be left out),
    /// `tip_*_mm`, `axis_*`, and `sd_*_mm`, `samples` if there are, in World.
    table: PathBuf,
    /// File for the map (TOML), for `em.map`; nothing is written over.
    #[arg(long)]
    out: PathBuf,
    /// The tip truly is where guide and depth say; without, how the needle lies in its guide is not
    /// known, and the means of place and axis are left as they are.
    #[arg(long)]
    exact: bool,
    /// Print the map as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(command: &CalibrateCommand) -> anyhow::Result<ExitCode> {
    match command {
        CalibrateCommand::Stereo(args) => cameras(args),
        CalibrateCommand::Mono(args) => boards::mono(args),
        CalibrateCommand::Corners(args) => boards::corners(args),
        CalibrateCommand::Register(args) => registration(args),
        CalibrateCommand::Distortion(args) => distortion(args),
    }
}

fn distortion(args: &DistortionArgs) -> anyhow::Result<ExitCode> {
    check_free(&args.out)?;
    let lie = if args.exact { Lie::Exact } else { Lie::Fitted };
    let map = map_of(&args.table, lie).map_err(|e| Usage(e.to_string()))?;
    write_all(&[(args.out.clone(), toml::to_string(&map)?)])?;
    if args.json {
        print_json(&map)?;
        return Ok(ExitCode::SUCCESS);
    }
    let mut stdout = std::io::stdout().lock();
    writeln!(
        stdout,
        "{} places, noise {:.3} mm per axis",
        map.places, map.noise_mm
    )?;
    for (what, unit, smooth) in [
        ("place", "mm", &map.place_mm),
        ("axis", "mrad", &map.axis_mrad),
    ] {
        writeln!(
            stdout,
            "{what}: {:.2} {unit} per axis without the map, {:.2} {unit} with it at places left out of the fit \
             (degree {} across, {} along)",
            smooth.before, smooth.left, smooth.degree_across, smooth.degree_along
        )?;
    }
    writeln!(
        stdout,
        "written to {}; next: [em] map = \"{0}\"",
        args.out.display()
    )?;
    Ok(ExitCode::SUCCESS)
}

fn cameras(args: &StereoArgs) -> anyhow::Result<ExitCode> {
    let request = Request {
        left: args.left.clone(),
        right: args.right.clone(),
        board: args.board.clone(),
        square_mm: args.square_mm,
        lens: args.lens.clone(),
        pixels: args.images.pixels(),
    };
    stereo::check_free(&args.out)?;
    let calibration = calibrate(&request).map_err(|e| Usage(e.to_string()))?;
    write(&args.out, &calibration)?;
    if args.json {
        print_json(&output(&calibration))?;
    } else {
        print_stereo(&calibration, &args.out)?;
    }
    Ok(ExitCode::SUCCESS)
}

pub(super) fn board_kind(text: &str) -> Result<BoardKind, Usage> {
    text.parse().map_err(|e| Usage(format!("--board {e}")))
}

pub(super) fn square(square_mm: f64) -> Result<f64, Usage> {
    let checked = stereo::check_square(square_mm).map_err(|e| Usage(e.to_string()))?;
    Ok(checked * 1e-3)
}

pub(super) fn name(path: Option<&PathBuf>) -> String {
    path.and_then(|p| p.file_name())
        .map_or_else(String::new, |n| n.to_string_lossy().into_owned())
}

fn print_stereo(c: &StereoCalibration, out: &Path) -> std::io::Result<()> {
    let mut stdout = std::io::stdout().lock();
    writeln!(
        stdout,
        "{} pairs, {} rejections",
        c.views.len(),
        c.rejected.len()
    )?;
    for rejected in &c.rejected {
        writeln!(stdout, "  {rejected}")?;
    }
    writeln!(
        stdout,
        "RMS {:.4} px joint, {:.4} px left alone, {:.4} px right alone; rectified {} {:.4} px",
        c.joint_rms_px,
        c.left_rms_px,
        c.right_rms_px,
        if rectify(&c.rig).is_some_and(|r| r.vertical) {
            "dx (one above the other)"
        } else {
            "dy"
        },
        c.rectified_dy.rms_px
    )?;
    writeln!(stdout, "baseline {:.3} mm", c.rig.baseline() * 1e3)?;
    writeln!(
        stdout,
        "report, left.yaml, right.yaml, stereo.yml{} in {}",
        if camchain(&c.rig).is_some() {
            ", camchain.yaml"
        } else {
            ""
        },
        out.display()
    )?;
    if camchain(&c.rig).is_none() {
        writeln!(
            stdout,
            "no camchain.yaml: Kalibr knows the lenses radtan and equidistant (--lens)"
        )?;
    }
    Ok(())
}

fn registration(args: &RegisterArgs) -> anyhow::Result<ExitCode> {
    // Behind `--calibration A` the poses are taken for a second calibration file.
    let (files, recorded) = match (&args.poses, args.calibration.as_slice()) {
        (Some(poses), files) => (files, poses),
        (None, [files @ .., poses]) if !files.is_empty() => (files, poses),
        _ => return Err(Usage("POSES is missing: the recorded poses (JSON)".to_owned()).into()),
    };
    check_free(&args.out)?;
    let calibration = calibration::read(files, args.unit_mm, None)?;
    let (target, poses, options) = read_poses(recorded).map_err(|e| Usage(e.to_string()))?;
    let refused = |e: RegistrationError| Usage(format!("{}: {e}", recorded.display()));
    let stated = calibration.covariance.is_some();
    let covariance = match calibration.covariance {
        None => {
            assumed_calibration(&calibration.rig, &target, &poses, &options).map_err(refused)?
        }
        known => known,
    };
    if !stated {
        let assumed = if covariance.is_some() {
            format!(
                "that of an ordinary one is assumed (12 pairs of a board, corners to {} px: pixel_sigma_px of the poses)",
                options.pixel_sigma_px
            )
        } else {
            "the predicted target error leaves it out, and is too small".to_owned()
        };
        writeln!(
            std::io::stderr(),
            "note: {}: how exact the calibration is does not stand there; {assumed}. The stereo.yml of `calibrate \
             stereo` says it",
            calibration::names(files)
        )?;
    }
    let found = register(
        &calibration.rig,
        covariance.as_ref(),
        &target,
        &poses,
        &options,
    )
    .map_err(refused)?;
    let left_from_world = found.world_from_left_camera.inverse();
    let places: Vec<_> = poses
        .iter()
        .map(|pose| {
            let target = found.flange_from_target.translation.vector.into();
            left_from_world * (pose.world_from_flange * hal::Position::new(target))
        })
        .collect();
    let file = RegistrationFile {
        calibration_assumed: !stated,
        ..RegistrationFile::new(&found, &places)
    };
    write_all(&[(args.out.clone(), file.to_json()?)])?;
    if args.json {
        print_json(&file)?;
    } else {
        writeln!(
            std::io::stdout(),
            "FRE {:.3} mm, predicted target error {:.3} mm, chi2 per freedom {:.2}; written to {}",
            file.fre_mm,
            file.predicted_tre_mm,
            file.chi2_per_freedom,
            args.out.display()
        )?;
    }
    Ok(ExitCode::SUCCESS)
}

//! Files to try other commands on before there are own ones: boards and a film from the phantom's
//! cameras, recordings of insertions.

use std::fmt::Write as _;
use std::io::Write as _;
use std::path::Path;
use std::time::Duration;

use anyhow::Context;
use hal::{ArmState, GrayImage, SensedShape, Stamp, StereoFrame, Telemetry};
use image::codecs::png::PngEncoder;
use image::{ExtendedColorType, ImageEncoder};
use phantom::camera::{StereoRig, calibration_boards};
use vision::files::{StereoFile, stereo_yml};
use vision::track::Tracked;

use crate::bearings::{Bearings, base_pose};
use crate::cameras;
use crate::config::Config;
use crate::controls::Controls;
use crate::observer::Observer;
use crate::odometry::Odometry;
use crate::results::save;
use crate::rig::Rig;
use crate::run::run;

/// Pairs of images of the chessboard.
pub const BOARDS: usize = 15;
/// Time between two pairs of a film.
const FILM_PERIOD: Duration = Duration::from_secs(2);
/// Half width of the grid of a needle in air, across, and the distance of its places \[mm\].
const IN_AIR: (i32, usize) = (15, 5);
/// Distance of its depths \[mm\].
const IN_AIR_DEPTHS: usize = 10;
/// How far beyond the target it goes \[mm\].
const IN_AIR_BEYOND: f64 = 15.0;
/// Measurements at each place.
const IN_AIR_SAMPLES: usize = 5;
/// Time between two rows of a recording.
const RECORDING_PERIOD: Duration = Duration::from_millis(250);
/// Feedback of the arm that is kept: more than any sensor's latency \[readings\].
const FEEDBACK: usize = 256;

/// Writes `stereo.yml`, the calibration of the phantom's cameras, into the folder.
///
/// # Errors
/// The configuration describes no cameras, or the file cannot be written.
pub fn calibration(config: &Config, folder: &Path) -> anyhow::Result<()> {
    let file = StereoFile {
        rig: cameras::calibrated(photographer(config)?.given()),
        covariance: None,
        corner_sigma_px: None,
    };
    let text = stereo_yml(&file);
    save(&folder.join("stereo.yml"), |out| {
        Ok(out.write_all(text.as_bytes())?)
    })
}

/// Writes what the phantom's electromagnetic sensor shows of a needle in air, its guide at known
/// places about the entry, as a table for `calibrate distortion`; answers the number of places.
///
/// # Errors
/// The insertion goes along none of World's axes, the phantom's settings are wrong, or the file cannot be
/// written.
pub fn in_air(config: &Config, file: &Path) -> anyhow::Result<usize> {
    let inward = config.inward();
    let along = inward.iamax();
    anyhow::ensure!(
        inward[along].abs() > 1.0 - 1e-6,
        "tissue.inward = {:?}: a table in air needs an insertion along one of World's axes",
        config.tissue.inward
    );
    let steps = || (-IN_AIR.0..=IN_AIR.0).step_by(IN_AIR.1).map(f64::from);
    let deepest = config.target.depth_mm + IN_AIR_BEYOND;
    let mut places = Vec::new();
    let mut depth = 0.0;
    while depth <= deepest {
        for first in steps() {
            for second in steps() {
                let mut guide = config.entry().coords;
                guide[(along + 1) % 3] += first * 1e-3;
                guide[(along + 2) % 3] += second * 1e-3;
                places.push((depth, guide, guide + inward.scale(depth * 1e-3)));
            }
        }
        depth += IN_AIR_DEPTHS as f64;
    }
    let settings = config.phantom_settings()?.em;
    let tips = places.iter().map(|(.., tip)| tip);
    let seen = phantom::in_air(&settings, config.run.seed, tips, &inward, IN_AIR_SAMPLES);
    let mut text = String::from(
        "depth_mm,guide_x_mm,guide_y_mm,guide_z_mm,tip_x_mm,tip_y_mm,tip_z_mm,axis_x,axis_y,axis_z,\
         sd_x_mm,sd_y_mm,sd_z_mm,samples\n",
    );
    for ((depth, guide, _), seen) in places.iter().zip(&seen) {
        let [guide, tip, sd] = [*guide, seen.tip, seen.deviation].map(|v| v * 1e3);
        writeln!(
            text,
            "{depth},{:.3},{:.3},{:.3},{:.3},{:.3},{:.3},{:.5},{:.5},{:.5},{:.3},{:.3},{:.3},{IN_AIR_SAMPLES}",
            guide.x,
            guide.y,
            guide.z,
            tip.x,
            tip.y,
            tip.z,
            seen.axis.x,
            seen.axis.y,
            seen.axis.z,
            sd.x,
            sd.y,
            sd.z
        )?;
    }
    save(file, |out| Ok(out.write_all(text.as_bytes())?))?;
    Ok(seen.len())
}

/// Writes pairs of images of a chessboard of 9 x 6 inner corners, as the phantom's cameras see it
/// without the container; returns the side of a square \[m\].
///
/// # Errors
/// The configuration describes no cameras, or a file cannot be written.
pub fn boards(config: &Config, folder: &Path) -> anyhow::Result<f64> {
    let mut rig = photographer(config)?;
    std::fs::create_dir_all(folder)?;
    let views = calibration_boards(rig.truth(), BOARDS, config.run.seed);
    for (number, view) in (0..).zip(&views) {
        let pair = rig.board_pair(view, number)?;
        save_pair(folder, number, [&pair[0], &pair[1]])?;
    }
    views
        .first()
        .map(|view| view.square)
        .context("no boards were asked for")
}

fn photographer(config: &Config) -> anyhow::Result<StereoRig> {
    let settings = cameras::settings(config)?;
    let seed = config.run.seed;
    Ok(StereoRig::new(&settings, &config.world_from_entry(), seed)?)
}

/// Writes pairs of images of an insertion that images steer; returns their number.
///
/// # Errors
/// The insertion cannot be carried out, or a file cannot be written.
pub fn film(config: &Config, folder: &Path) -> anyhow::Result<u64> {
    std::fs::create_dir_all(folder)?;
    let mut film = Film {
        folder,
        next: Stamp::ZERO,
        pairs: 0,
        failed: None,
    };
    run(
        config,
        &mut Rig::new(config)?,
        &mut film,
        &Controls::default(),
    )?;
    film.failed.map_or(Ok(film.pairs), Err)
}

struct Film<'a> {
    folder: &'a Path,
    next: Stamp,
    pairs: u64,
    failed: Option<anyhow::Error>,
}

impl Observer for Film<'_> {
    fn step(&mut self, _: &Telemetry) {}

    fn images(&mut self, pair: &StereoFrame, _: &Tracked) {
        if pair.left.stamp < self.next || self.failed.is_some() {
            return;
        }
        self.next = pair.left.stamp + FILM_PERIOD;
        let images = [&*pair.left.image, &*pair.right.image];
        self.failed = save_pair(self.folder, self.pairs, images).err();
        self.pairs += 1;
    }
}

fn save_pair(folder: &Path, number: u64, images: [&GrayImage; 2]) -> anyhow::Result<()> {
    for (side, image) in ["left", "right"].into_iter().zip(images) {
        let (width, height) = (image.width().try_into()?, image.height().try_into()?);
        save(&folder.join(format!("{side}_{number:03}.png")), |out| {
            let encoder = PngEncoder::new(out);
            Ok(encoder.write_image(image.pixels(), width, height, ExtendedColorType::L8)?)
        })?;
    }
    Ok(())
}

/// Writes the recording of an insertion as the table that `estimate` reads; returns its rows.
///
/// # Errors
/// The insertion cannot be carried out, or the file cannot be written.
pub fn recording(config: &Config, file: &Path) -> anyhow::Result<usize> {
    let mut rig = Rig::new(config)?;
    let mut table = Table {
        bearings: rig.bearings.clone(),
        odometry: Odometry::new(FEEDBACK),
        next: Stamp::ZERO,
        text: "t_s,base_x_m,base_y_m,base_z_m,base_qx,base_qy,base_qz,base_qw,tip_x_m,tip_y_m,\
               tip_z_m,axis_x,axis_y,axis_z,points_m\n"
            .to_owned(),
        rows: 0,
    };
    run(config, &mut rig, &mut table, &Controls::default())?;
    save(file, |out| Ok(out.write_all(table.text.as_bytes())?))?;
    Ok(table.rows)
}

struct Table {
    bearings: Bearings,
    odometry: Odometry,
    next: Stamp,
    text: String,
    rows: usize,
}

impl Observer for Table {
    fn step(&mut self, _: &Telemetry) {}

    fn arm(&mut self, state: &ArmState) {
        let base = base_pose(&self.bearings, state);
        self.odometry.push(state.stamp, base);
    }

    fn inputs(&mut self, _: &ArmState, shape: Option<&SensedShape>) {
        let Some(shape) = shape.filter(|shape| shape.stamp >= self.next) else {
            return;
        };
        let Some(base) = self.odometry.at(shape.stamp) else {
            return;
        };
        self.next = shape.stamp + RECORDING_PERIOD;
        self.rows += 1;
        let world = self.bearings.world_from_left_camera;
        let turn = base.rotation.coords;
        let tip = (world * shape.tip.position).coords();
        let axis = world.isometry() * shape.tip.direction.into_inner();
        let points = shape.points.iter().map(|point| {
            let p = (world * point.position).coords();
            format!("{:.6} {:.6} {:.6}", p.x, p.y, p.z)
        });
        let points = points.collect::<Vec<_>>().join(";");
        let numbers = base.translation.vector.iter().chain(turn.iter());
        let numbers = numbers.chain(tip.iter()).chain(axis.iter());
        // Writing to a string does not fail.
        let _ = write!(self.text, "{:.4}", shape.stamp.as_secs());
        for number in numbers {
            let _ = write!(self.text, ",{number:.7}");
        }
        let _ = writeln!(self.text, ",{points}");
    }
}

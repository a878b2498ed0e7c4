//! Writes what the cameras see as PNG files: `cargo run --release -p phantom --example
//! render_views -- FOLDER`.
#![expect(clippy::print_stderr, reason = "an example reports on the terminal")]

use std::error::Error;
use std::path::PathBuf;

use hal::{GrayImage, Stamp, Transform};
use nalgebra::{Isometry3, Translation3, UnitQuaternion, Vector3};
use phantom::NeedleView;
use phantom::camera::{CameraSettings, StereoRig, calibration_boards};

/// A needle bent towards `azimuth` about the insertion axis, its bevel turned there too.
fn needle(world_from_phantom: &Isometry3<f64>, depth: f64, azimuth: f64) -> NeedleView {
    let bend = 0.9;
    let turn = UnitQuaternion::from_axis_angle(&Vector3::z_axis(), azimuth);
    let at = |z: f64| turn * Vector3::new(0.0, -bend * z.max(0.0).powi(2), z);
    let lean = UnitQuaternion::from_axis_angle(&Vector3::x_axis(), (2.0 * bend * depth).atan());
    NeedleView {
        stamp: Stamp::ZERO,
        centreline: (0..=252)
            .map(|i| at(depth - 0.126 + 0.5e-3 * f64::from(i)))
            .map(|p| (world_from_phantom * nalgebra::Point3::from(p)).coords)
            .collect(),
        world_from_tip: Transform::assume(
            world_from_phantom * Isometry3::from_parts(Translation3::from(at(depth)), turn * lean),
        ),
        outer_diameter: 0.7e-3,
        bevel_angle: 24f64.to_radians(),
        entry_arc: 0.126 - depth,
    }
}

fn save(folder: &std::path::Path, name: &str, image: &GrayImage) -> Result<(), Box<dyn Error>> {
    let path = folder.join(format!("{name}.png"));
    image::save_buffer(
        &path,
        image.pixels(),
        u32::try_from(image.width())?,
        u32::try_from(image.height())?,
        image::ColorType::L8,
    )?;
    eprintln!("{}", path.display());
    Ok(())
}

fn main() -> Result<(), Box<dyn Error>> {
    let folder = PathBuf::from(std::env::args().nth(1).unwrap_or_else(|| "views".into()));
    std::fs::create_dir_all(&folder)?;
    let world_from_phantom = Isometry3::new(
        Vector3::new(0.4, 0.0, 0.25),
        Vector3::x() * std::f64::consts::PI,
    );
    for (name, settings, depth, azimuth) in [
        ("ideal", CameraSettings::ideal(), 0.08, 0.8),
        ("paper", CameraSettings::paper(), 0.08, 0.8),
        ("paper1280", CameraSettings::paper().at_1280(), 0.08, -0.6),
        ("harsh", CameraSettings::harsh(), 0.06, 2.0),
    ] {
        let mut rig = StereoRig::new(&settings, &world_from_phantom, 1)?;
        let [left, right] = rig.render(&needle(&world_from_phantom, depth, azimuth), 1);
        save(&folder, &format!("{name}_left"), &left)?;
        save(&folder, &format!("{name}_right"), &right)?;
        if name == "paper" {
            for (i, board) in calibration_boards(rig.truth(), 3, 1).iter().enumerate() {
                let [left, right] = rig.board_pair(board, i as u64)?;
                save(&folder, &format!("board{i}_left"), &left)?;
                save(&folder, &format!("board{i}_right"), &right)?;
            }
        }
    }
    Ok(())
}

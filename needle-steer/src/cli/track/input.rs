//! What the options of `track` say, checked before the first frame.

use std::path::{Path, PathBuf};

use nalgebra::{Unit, Vector3};
use vision::camera::View;
use vision::files::{FileError, read_camera, same_size};
use vision::track::{Appearance, Hints, Plane, PlaneTracker, StereoTracker, TrackSettings};
use vision::{Camera, DistortedPx};

use super::TrackArgs;
use crate::cli::{Usage, calibration};
use crate::config::in_other_unit;

/// One needle, seen by two cameras or by one.
pub(super) enum Tracker {
    Stereo(Box<StereoTracker>),
    Plane(Box<PlaneTracker>),
}

/// Checks everything that can be checked before the first frame.
pub(super) fn prepare(args: &TrackArgs) -> Result<Tracker, Usage> {
    if args.plane.is_none() && args.left.len() != args.right.len() {
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
    let needle = appearance(args)?;
    let hints = hints(args)?;
    match &args.plane {
        Some(plane) => one_camera(args, plane, needle, hints),
        None => two_cameras(args, needle, hints),
    }
}

/// Whether files come as a shell sorts them, 1, 10, 2, where their numbers go another way: a film out of
/// order.
pub(super) fn out_of_order(files: &[PathBuf]) -> bool {
    let numbers = |file: &PathBuf| -> Vec<u64> {
        let name = file.to_string_lossy().into_owned();
        let runs = name.split(|c: char| !c.is_ascii_digit());
        runs.filter_map(|digits| digits.parse().ok()).collect()
    };
    files.is_sorted() && !files.is_sorted_by_key(numbers)
}

fn two_cameras(args: &TrackArgs, needle: Appearance, hints: Hints) -> Result<Tracker, Usage> {
    let left_size = same_size(&args.left).map_err(refused)?;
    let right_size = same_size(&args.right).map_err(refused)?;
    let sizes = [left_size, right_size];
    let calibration = calibration::read(&args.calibration, args.unit_mm, Some(sizes))?;
    if let Some(path) = args.calibration.first() {
        calibration.check_sizes(path, sizes).map_err(refused)?;
    }
    let settings = TrackSettings::default();
    let mut tracker = StereoTracker::new(&calibration.rig, needle, &settings)
        .map_err(|e| Usage(e.to_string()))?;
    tracker.set_hints(hints);
    if let (Some(left), Some(right)) = (&args.start_left, &args.start_right) {
        tracker.start_at(
            clicks("--start-left", left, left_size)?,
            clicks("--start-right", right, right_size)?,
        );
    }
    Ok(Tracker::Stereo(Box::new(tracker)))
}

fn one_camera(
    args: &TrackArgs,
    text: &str,
    needle: Appearance,
    hints: Hints,
) -> Result<Tracker, Usage> {
    let plane = plane(text, args.plane_sigma_mm)?;
    let (width, height) = same_size(&args.left).map_err(refused)?;
    let camera = left_camera(args, (width, height))?;
    if (width, height) != (camera.width, camera.height) {
        return Err(refused(FileError::OtherCamera {
            path: args.calibration.first().cloned().unwrap_or_default(),
            calibrated_width: camera.width,
            calibrated_height: camera.height,
            width,
            height,
        }));
    }
    let view = View {
        camera,
        camera_from_left: nalgebra::Isometry3::identity(),
        window: None,
    };
    let mut tracker = PlaneTracker::new(view, plane, needle, &TrackSettings::default())
        .map_err(|e| Usage(e.to_string()))?;
    tracker.set_hints(hints);
    if let Some(left) = &args.start_left {
        tracker.start_at(clicks("--start-left", left, (width, height))?);
    }
    Ok(Tracker::Plane(Box::new(tracker)))
}

/// The camera of a single calibration, or the left one of a stereo calibration.
fn left_camera(args: &TrackArgs, size: (usize, usize)) -> Result<Camera, Usage> {
    match calibration::read(&args.calibration, args.unit_mm, Some([size; 2])) {
        Ok(file) => Ok(file.rig.left),
        Err(stereo) => {
            let path = args.calibration.first().map_or(Path::new(""), |p| p);
            let single = read_camera(path, Some(size));
            single.map(|(camera, _)| camera).map_err(|single| {
                Usage(format!(
                    "neither a stereo calibration ({stereo}) nor that of one camera ({single})"
                ))
            })
        }
    }
}

/// Distances at which a camera sees a needle \[mm\].
const SIGHT_MM: (f64, f64) = (5.0, 10_000.0);

/// A point [mm] and a normal in the camera's frame.
fn plane(text: &str, sigma_mm: f64) -> Result<Plane, Usage> {
    let wrong = || {
        Usage(format!(
            "--plane {text}: expected x,y,z,nx,ny,nz: a point of the needle's plane in front of \
             the camera in millimetres and the plane's normal, both in the camera's frame (x right, \
             y down, z ahead)"
        ))
    };
    let numbers: Option<Vec<f64>> = text.split(',').map(|n| n.trim().parse().ok()).collect();
    let Some(&[x, y, z, nx, ny, nz]) = numbers.as_deref() else {
        return Err(wrong());
    };
    let away = Vector3::new(x, y, z).norm();
    let (least, most) = SIGHT_MM;
    if away.is_finite() && z > 0.0 && !(least..=most).contains(&away) {
        return Err(Usage(format!(
            "--plane {text}: its point is {away} mm from the camera, expected millimetres from {least} to \
             {most}{}",
            in_other_unit(away, least, most)
        )));
    }
    let point = Vector3::new(x, y, z) * 1e-3;
    let normal = Unit::try_new(Vector3::new(nx, ny, nz), 1e-9).ok_or_else(wrong)?;
    let finite = point.iter().chain(normal.iter()).all(|v| v.is_finite());
    if !finite || point.z <= 0.0 {
        return Err(wrong());
    }
    if !(0.0..=100.0).contains(&sigma_mm) {
        return Err(Usage(format!(
            "--plane-sigma-mm {sigma_mm}: expected millimetres from 0 to 100"
        )));
    }
    Ok(Plane {
        point,
        normal,
        sigma: sigma_mm * 1e-3,
    })
}

#[expect(clippy::needless_pass_by_value, reason = "as `map_err` hands it over")]
pub(super) fn refused(error: FileError) -> Usage {
    Usage(error.to_string())
}

fn appearance(args: &TrackArgs) -> Result<Appearance, Usage> {
    let millimetres = |option: &str, value: f64, lowest: f64, highest: f64| {
        if value >= lowest && value <= highest {
            return Ok(value * 1e-3);
        }
        Err(Usage(format!(
            "--{option} {value}: expected millimetres from {lowest} to {highest}{}",
            in_other_unit(value, lowest, highest)
        )))
    };
    Ok(Appearance {
        diameter: millimetres("diameter-mm", args.diameter_mm, 0.05, 10.0)?,
        bevel_length: if args.bevel_mm == 0.0 {
            0.0
        } else {
            millimetres("bevel-mm", args.bevel_mm, 0.05, 20.0)?
        },
    })
}

fn hints(args: &TrackArgs) -> Result<Hints, Usage> {
    /// Blurs that a needle can be found in [px].
    const BLURS: core::ops::RangeInclusive<f64> = 0.2..=20.0;
    if let Some(blur) = args.blur_px
        && !BLURS.contains(&blur)
    {
        return Err(Usage(format!(
            "--blur-px {blur}: expected pixels from {} to {}",
            BLURS.start(),
            BLURS.end()
        )));
    }
    Ok(Hints {
        blur_px: args.blur_px,
        bright: args.bright.then_some(true),
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

/// The pictures of a folder, one a frame.
pub(super) fn picture(folder: &Path, frame: usize) -> PathBuf {
    folder.join(format!("frame-{frame:06}.png"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_shells_order_of_numbers_is_noticed() {
        let named = |numbers: &[&str]| -> Vec<PathBuf> {
            let name = |n: &&str| PathBuf::from(format!("film_2/left_{n}.png"));
            numbers.iter().map(name).collect()
        };
        assert!(out_of_order(&named(&["1", "10", "2"])));
        assert!(!out_of_order(&named(&["1", "2", "10"])));
        assert!(!out_of_order(&named(&["01", "02", "10"])));
        assert!(!out_of_order(&named(&["a", "b"])));
    }
}

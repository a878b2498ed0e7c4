//! From found values to cameras and what lies between them.

use hal::Transform;
use nalgebra::{DMatrix, Isometry3, Matrix3, UnitQuaternion, Vector3};

use super::keys::{
    Affix, BODY, COEFFICIENTS, FISHEYE, Found, Keys, LABELS, MATRIX, NEITHER, PROJECTION,
    RECTIFICATION, ROTATION, SIDES, TRANSFORM, TRANSLATION,
};
use super::node::Node;
use super::pose::{ROUNDING, rotation, three, transform};
use super::{ReadCalibration, ReadOptions, lens};
use crate::camera::{Camera, LensModel, StereoRig};
use crate::files::opencv::extras;
use crate::files::{FileError, StereoFile};

/// Baselines that cameras on a bench have \[m\]; others are most likely lengths in another unit.
const PLAUSIBLE_BASELINE: core::ops::RangeInclusive<f64> = 1e-3..=2.0;

/// The same where the unit was given: wider, as it is meant.
const POSSIBLE_BASELINE: core::ops::RangeInclusive<f64> = 1e-4..=20.0;

/// Reads a rig.
pub(super) fn read(keys: &Keys, options: &ReadOptions) -> Result<ReadCalibration, FileError> {
    let sides = sides(keys)?;
    let mut notes = Vec::new();
    let size = |side: usize| options.image_sizes.map(|sizes| sizes[side]);
    let left = one_camera(keys, sides[0], Some(0), size(0), &mut notes)?;
    let right = one_camera(keys, sides[1], Some(1), size(1), &mut notes)?;
    let (mut pose, baseline) = relative(keys, sides, &mut notes)?;
    if let Some(unit) = options.unit {
        pose.translation.vector *= unit;
    }
    plausible(&pose, &baseline, options)?;
    let rig = StereoRig {
        left,
        right,
        right_from_left: Transform::assume(pose),
        container: None,
    };
    let (covariance, corner_sigma_px, container) = extras(keys, &rig)?;
    Ok(ReadCalibration {
        file: StereoFile {
            rig: rig.with_container(container),
            covariance,
            corner_sigma_px,
        },
        notes,
    })
}

/// How these files tell left from right.
fn sides(keys: &Keys) -> Result<[Affix; 2], FileError> {
    let has = |affix: &Affix| matrix(keys, *affix).is_some() || scalars(keys, *affix).is_some();
    let both = SIDES.iter().find(|pair| pair.iter().all(has));
    if let Some(pair) = both {
        return Ok(*pair);
    }
    let names = "camera matrix; also K, cameraMatrix, mtx, intrinsics, with 1/2, left/right or \
                 cam0/cam1";
    Err(if SIDES.iter().any(|[left, _]| has(left)) {
        keys.missing("M2", &format!("the right camera's {names}"))
    } else {
        keys.missing("M1", &format!("the left camera's {names}"))
    })
}

fn matrix(keys: &Keys, affix: Affix) -> Option<Found<'_>> {
    // Distortion coefficients have names like `k1` too: a matrix has more than one number.
    keys.find_where(affix, MATRIX, |node| {
        matches!(node, Node::Map(_)) || node.matrix().is_some_and(|m| m.len() >= 4)
    })
}

/// fx fy cx cy as keys of their own.
fn scalars(keys: &Keys, Affix(before, after): Affix) -> Option<[f64; 4]> {
    let one = |name: &str| {
        let found = keys.find(Affix(before, after), &[name])?;
        found.node.number()
    };
    Some([one("fx")?, one("fy")?, one("cx")?, one("cy")?])
}

/// One camera: matrix, distortion, size. `side` is 0 for the left one, 1 for the right one.
pub(super) fn one_camera(
    keys: &Keys,
    affix: Affix,
    side: Option<usize>,
    image_size: Option<(usize, usize)>,
    notes: &mut Vec<String>,
) -> Result<Camera, FileError> {
    let [fx, fy, cx, cy] = intrinsics(keys, affix)?;
    let labels: Vec<Found<'_>> = [affix, NEITHER]
        .into_iter()
        .find_map(|a| {
            let all: Vec<_> = keys.all(a, LABELS).collect();
            (!all.is_empty()).then_some(all)
        })
        .unwrap_or_default();
    let mut names: Vec<&str> = labels.iter().filter_map(|l| l.node.text()).collect();
    let fisheye = [affix, NEITHER].into_iter().any(|a| {
        let switch = keys.find(a, FISHEYE).and_then(|f| f.node.number());
        switch.is_some_and(|on| on != 0.0)
    });
    if fisheye {
        names.push("fisheye");
    }
    let (coefficients, at) = coefficients(keys, affix)?;
    let distortion = lens::distortion(&names, &coefficients).map_err(|why| {
        let label = labels.first();
        FileError::Lens {
            path: at
                .or(label.copied())
                .map_or(keys.path(), |f| f.path)
                .to_owned(),
            key: label
                .filter(|_| why.starts_with("the model"))
                .or(at.as_ref())
                .map_or_else(String::new, |f| f.name.to_owned()),
            why,
        }
    })?;
    if !matches!(distortion.model, LensModel::PlumbBob | LensModel::RadTan) {
        let text = format!("lens model {}", distortion.model.name());
        if !notes.contains(&text) {
            notes.push(text);
        }
    }
    let (width, height) = match size(keys, affix, side)? {
        Some(size) => size,
        None => image_size.ok_or_else(|| {
            keys.missing(
                "image_width",
                "and `image_height`; also image_size, resolution",
            )
        })?,
    };
    Camera {
        width,
        height,
        fx,
        fy,
        cx,
        cy,
        distortion,
    }
    .validated()
    .map_err(|source| FileError::Camera {
        path: keys.path().to_owned(),
        source,
    })
}

fn intrinsics(keys: &Keys, affix: Affix) -> Result<[f64; 4], FileError> {
    let Some(found) = matrix(keys, affix) else {
        return scalars(keys, affix)
            .ok_or_else(|| keys.missing("K", "camera matrix; also M, camera_matrix, intrinsics"));
    };
    let m = found.matrix()?;
    if m.len() == 4 {
        return Ok([m[0], m[1], m[2], m[3]]);
    }
    let k: Matrix3<f64> = three(&m).ok_or_else(|| found.wrong("a matrix of 3 x 3"))?;
    if k[(2, 0)] != 0.0 && k[(0, 2)] == 0.0 {
        return Err(found.wrong(
            "fx 0 cx, 0 fy cy, 0 0 1; this is its transpose, as MATLAB has it: transpose it (and \
             the rotation)",
        ));
    }
    if k[(0, 1)] != 0.0 {
        return Err(found.wrong("no skew (the second number of the first row is not 0)"));
    }
    Ok([k[(0, 0)], k[(1, 1)], k[(0, 2)], k[(1, 2)]])
}

/// The distortion coefficients, in one list or as keys of their own; none without.
fn coefficients(keys: &Keys, affix: Affix) -> Result<(Vec<f64>, Option<Found<'_>>), FileError> {
    if let Some(found) = keys.find(affix, COEFFICIENTS) {
        if *found.node == Node::Null || *found.node == Node::List(Vec::new()) {
            return Ok((Vec::new(), Some(found)));
        }
        let m = found.matrix()?;
        if m.nrows() != 1 && m.ncols() != 1 {
            return Err(found.wrong("coefficients in one row: k1 k2 p1 p2 [k3 [k4 k5 k6]]"));
        }
        return Ok((found.numbers()?, Some(found)));
    }
    let one = |name: &str| {
        let found = keys.find(affix, &[name])?;
        found.node.number()
    };
    let names = ["k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6"];
    let Some(k1) = one("k1") else {
        let d = if affix == NEITHER { "D" } else { "D1, D2" };
        return Err(keys.missing(d, "distortion coefficients; also distCoeffs, distortion"));
    };
    // A fisheye's four have no tangential ones between them.
    let fisheye = one("p1").is_none() && one("k4").is_some();
    let list = if fisheye {
        vec![
            k1,
            one("k2").unwrap_or(0.0),
            one("k3").unwrap_or(0.0),
            one("k4").unwrap_or(0.0),
        ]
    } else {
        names.iter().map(|name| one(name).unwrap_or(0.0)).collect()
    };
    Ok((list, None))
}

/// The image size, this camera's own (under any name of its side) before one for both.
fn size(
    keys: &Keys,
    affix: Affix,
    side: Option<usize>,
) -> Result<Option<(usize, usize)>, FileError> {
    let named = side
        .into_iter()
        .flat_map(|s| SIDES.iter().map(move |pair| pair[s]));
    for affix in core::iter::once(affix).chain(named).chain([NEITHER]) {
        let width = keys.find(affix, &["imagewidth", "width", "w"]);
        let height = keys.find(affix, &["imageheight", "height", "h"]);
        if let (Some(width), Some(height)) = (width, height) {
            let count = |f: Found<'_>| f.node.count().ok_or_else(|| f.wrong("an integer above 0"));
            return Ok(Some((count(width)?, count(height)?)));
        }
        let list = keys.find(
            affix,
            &["imagesize", "resolution", "imgsize", "size", "shape"],
        );
        if let Some(found) = list {
            let wrong = || found.wrong("width and height, two integers above 0");
            let Node::List(sizes) = found.node else {
                let m = found.matrix()?;
                let node = |k: usize| m.get(k).and_then(|n| Node::Number(*n).count());
                return Ok(Some((
                    node(0).ok_or_else(wrong)?,
                    node(1).ok_or_else(wrong)?,
                )));
            };
            let [width, height] = sizes.as_slice() else {
                return Err(wrong());
            };
            return match (width.count(), height.count()) {
                (Some(width), Some(height)) => Ok(Some((width, height))),
                _ => Err(wrong()),
            };
        }
    }
    Ok(None)
}

/// The right camera's pose, and the key that holds the baseline.
fn relative<'a>(
    keys: &'a Keys,
    [left, right]: [Affix; 2],
    notes: &mut Vec<String>,
) -> Result<(Isometry3<f64>, Found<'a>), FileError> {
    let mut orthonormal = |found: &Found<'_>, off: f64| {
        if off > ROUNDING {
            notes.push(format!(
                "`{}` was made orthonormal: it was off by {off:.1e}",
                found.name
            ));
        }
    };
    let four = |node: &Node| {
        node.matrix()
            .is_some_and(|m| m.len() == 16 || m.shape() == (3, 4))
    };
    for affix in [right, NEITHER] {
        if let Some(found) = keys.find_where(affix, TRANSFORM, four) {
            let (pose, off) = transform(&found.matrix()?)
                .ok_or_else(|| found.wrong("a rotation and a translation, 4 x 4"))?;
            orthonormal(&found, off);
            return Ok((pose, found));
        }
    }
    if let Some(found) = keys.find_where(NEITHER, &["stereotc1c2", "tc1c2"], four) {
        let (pose, off) = transform(&found.matrix()?)
            .ok_or_else(|| found.wrong("a rotation and a translation, 4 x 4"))?;
        orthonormal(&found, off);
        return Ok((pose.inverse(), found));
    }
    let bodies = [left, right].map(|a| keys.find_where(a, BODY, four));
    if let [Some(l), Some(r)] = bodies {
        let pose = |f: &Found<'_>| {
            transform(&f.matrix()?).ok_or_else(|| f.wrong("a rotation and a translation, 4 x 4"))
        };
        let ((left, _), (right, off)) = (pose(&l)?, pose(&r)?);
        orthonormal(&r, off);
        return Ok((right.inverse() * left, r));
    }
    if let (Some(r), Some(t)) = (
        keys.find(NEITHER, ROTATION),
        keys.find(NEITHER, TRANSLATION),
    ) {
        let (turn, off) = rotation(&r.matrix()?)
            .ok_or_else(|| r.wrong("a rotation matrix (orthonormal within 0.01)"))?;
        orthonormal(&r, off);
        let t3 = t.matrix()?;
        if t3.len() != 3 {
            return Err(t.wrong("three numbers"));
        }
        let shift = Vector3::from_column_slice(t3.as_slice());
        return Ok((Isometry3::from_parts(shift.into(), turn), t));
    }
    rectified(keys, [left, right], &mut orthonormal)?.ok_or_else(|| {
        keys.missing(
            "R",
            "and `T`, rotation and translation from the left camera's \
                                    coordinates to the right's; also rectification and projection \
                                    matrices of both, T_cn_cnm1",
        )
    })
}

/// The relative pose that two rectifications and projections imply.
fn rectified<'a>(
    keys: &'a Keys,
    sides: [Affix; 2],
    orthonormal: &mut impl FnMut(&Found<'_>, f64),
) -> Result<Option<(Isometry3<f64>, Found<'a>)>, FileError> {
    let mut turns = [UnitQuaternion::identity(); 2];
    let mut shifts = [Vector3::zeros(); 2];
    let mut last = None;
    for (k, affix) in sides.into_iter().enumerate() {
        let rectification = keys.find(affix, RECTIFICATION);
        let projection = keys.find(affix, PROJECTION);
        let (Some(r), Some(p)) = (rectification, projection) else {
            return Ok(None);
        };
        let (turn, off) = rotation(&r.matrix()?).ok_or_else(|| r.wrong("a rotation matrix"))?;
        orthonormal(&r, off);
        turns[k] = turn;
        let m = p.matrix()?;
        let m = match m.shape() {
            (3, 4) => m,
            (12, 1) => DMatrix::from_row_slice(3, 4, m.as_slice()),
            _ => return Err(p.wrong("a matrix of 3 x 4")),
        };
        if !(m[(0, 0)] > 0.0 && m[(1, 1)] > 0.0) {
            return Err(p.wrong("positive focal lengths"));
        }
        shifts[k] = Vector3::new(m[(0, 3)] / m[(0, 0)], m[(1, 3)] / m[(1, 1)], 0.0);
        last = Some(p);
    }
    let back = turns[1].inverse();
    let shift = back * (shifts[1] - shifts[0]);
    let pose = Isometry3::from_parts(shift.into(), back * turns[0]);
    Ok(last.map(|p| (pose, p)))
}

/// Refuses a baseline that no bench has.
fn plausible(
    pose: &Isometry3<f64>,
    baseline: &Found<'_>,
    options: &ReadOptions,
) -> Result<(), FileError> {
    let baseline_m = pose.translation.vector.norm();
    let expected = if options.unit.is_some() {
        POSSIBLE_BASELINE
    } else {
        PLAUSIBLE_BASELINE
    };
    if expected.contains(&baseline_m) {
        return Ok(());
    }
    let remedy = if let Some(unit) = options.unit.filter(|_| baseline_m > 1e-9) {
        format!(
            "with the unit that was given, {} mm: --unit-mm (cameras.unit_mm in a configuration) is how many \
             millimetres one of the file's lengths is, 1 for millimetres and 1000 for metres",
            unit * 1e3
        )
    } else if baseline_m < 1e-9 {
        "both cameras stand at one place: give the files of a stereo calibration, not of two \
         single ones"
            .to_owned()
    } else if baseline_m < *PLAUSIBLE_BASELINE.start() {
        "give the unit of the file's lengths with --unit-mm, cameras.unit_mm in a configuration"
            .to_owned()
    } else if PLAUSIBLE_BASELINE.contains(&(baseline_m * 1e-3)) {
        format!(
            "are its lengths millimetres? then give --unit-mm 1 (baseline {baseline_m:.1} mm); are they \
             squares of the board, give the square's side: --unit-mm 25 (in a configuration: \
             cameras.unit_mm)"
        )
    } else {
        "give the unit of the file's lengths: --unit-mm 1 for millimetres, --unit-mm 25 for \
         squares of 25 mm (in a configuration: cameras.unit_mm)"
            .to_owned()
    };
    Err(FileError::Baseline {
        path: baseline.path.to_owned(),
        key: baseline.name.to_owned(),
        baseline_m,
        remedy,
    })
}

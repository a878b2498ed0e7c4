//! The report of a stereo calibration: one self-contained HTML page.

mod advice;
mod plots;

pub use advice::advice;

use core::fmt::Write as _;

use crate::calibrate::StereoCalibration;
use crate::camera::INTRINSICS;

/// A plot that could not be drawn.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("a plot could not be drawn: {reason}")]
pub struct ReportError {
    /// What the plotting library said.
    pub reason: String,
}

/// Names of a camera's parameters, in the order of [`crate::Camera::intrinsics`].
const INTRINSIC: [&str; INTRINSICS] = [
    "fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6",
];

/// A parameter of the covariance: its name, value, unit, and what makes that unit of SI's.
struct Parameter {
    name: String,
    value: f64,
    unit: &'static str,
    scale: f64,
}

/// The covariance's parameters, in its order.
fn listed(c: &StereoCalibration) -> Vec<Parameter> {
    let mut all = Vec::with_capacity(c.covariance.nrows());
    for (side, camera) in [("left", &c.rig.left), ("right", &c.rig.right)] {
        let values = camera.intrinsics();
        for &k in camera.distortion.model.used() {
            all.push(Parameter {
                name: format!("{side} {}", INTRINSIC[k]),
                value: values[k],
                unit: if k < 4 { "px" } else { "" },
                scale: 1.0,
            });
        }
    }
    let pose = c.rig.right_from_left.isometry();
    let turn = pose.rotation.scaled_axis();
    for (what, unit, vector) in [("T", "mm", pose.translation.vector), ("R", "mrad", turn)] {
        for (axis, value) in ["x", "y", "z"].into_iter().zip(vector.iter()) {
            all.push(Parameter {
                name: format!("{what} {axis}"),
                value: value * 1e3,
                unit,
                scale: 1e3,
            });
        }
    }
    all
}

const STYLE: &str = "body{font:15px/1.45 sans-serif;max-width:1100px;margin:2em auto;padding:0 1em;\
color:#222}table{border-collapse:collapse;margin:.6em 0}td,th{padding:.15em .8em;text-align:right;\
border-bottom:1px solid #ddd}td:first-child,th:first-child{text-align:left}.plots{display:flex;\
flex-wrap:wrap;gap:1em}.good{color:#17692b}.poor{color:#a3231f}svg{background:#fff}";

/// The page: figures, advice, residuals, views, coverage, epipolar errors, sigmas,
/// correlations and rejections.
///
/// # Errors
/// A plot could not be drawn.
pub fn calibration_report(c: &StereoCalibration) -> Result<String, ReportError> {
    let mut page = format!(
        "<!DOCTYPE html>\n<html lang=\"en\"><head><meta charset=\"utf-8\">\
         <title>Stereo calibration</title><style>{STYLE}</style></head><body>\n\
         <h1>Stereo calibration</h1>\n"
    );
    page += &figures(c);
    page += "<h2>Advice</h2>\n<ul>\n";
    for line in advice(c) {
        let class = if line.good { "good" } else { "poor" };
        let _ = writeln!(page, "<li class=\"{class}\">{}</li>", escaped(&line.text));
    }
    page += "</ul>\n<h2>Plots</h2>\n<div class=\"plots\">\n";
    for plot in [
        plots::residuals(c)?,
        plots::views(c)?,
        plots::coverage(c, 0)?,
        plots::coverage(c, 1)?,
        plots::epipolar(c)?,
    ] {
        page += &plot;
        page.push('\n');
    }
    page += "</div>\n";
    page += &parameters(c);
    page += &views(c);
    page += "<h2>Rejected</h2>\n";
    if c.rejected.is_empty() {
        page += "<p>Nothing.</p>\n";
    } else {
        page += "<ul>\n";
        for r in &c.rejected {
            let _ = writeln!(page, "<li>{}</li>", escaped(&r.to_string()));
        }
        page += "</ul>\n";
    }
    page += "</body></html>\n";
    Ok(page)
}

fn figures(c: &StereoCalibration) -> String {
    let corners: usize = c
        .views
        .iter()
        .flat_map(|v| &v.residuals)
        .map(|r| r.iter().flatten().count())
        .sum();
    let mut table = String::from("<table>\n");
    for (name, value) in [
        (
            "pairs, corners, board",
            format!(
                "{}, {corners}, {} x {} of {} mm",
                c.views.len(),
                c.board.size.cols,
                c.board.size.rows,
                c.board.square * 1e3
            ),
        ),
        ("joint RMS", format!("{:.4} px", c.joint_rms_px)),
        (
            "left, right alone",
            format!("{:.4}, {:.4} px", c.left_rms_px, c.right_rms_px),
        ),
        (
            "rectified difference across the baseline, RMS and greatest",
            format!(
                "{:.4}, {:.3} px",
                c.rectified_dy.rms_px, c.rectified_dy.max_px
            ),
        ),
        ("worst image", format!("{:.4} px", c.worst_image_rms_px())),
        (
            "corner noise, one sigma per axis",
            format!("{:.3} px", c.corner_sigma_px),
        ),
        ("baseline", format!("{:.3} mm", c.rig.baseline() * 1e3)),
    ] {
        let _ = writeln!(table, "<tr><td>{name}</td><td>{value}</td></tr>");
    }
    table + "</table>\n"
}

fn parameters(c: &StereoCalibration) -> String {
    let all = listed(c);
    let sigmas = c.sigmas();
    let mut table = String::from(
        "<h2>Parameters</h2>\n<table>\n<tr><th>parameter</th><th>value</th><th>sigma</th>\
         <th>strongest correlation</th></tr>\n",
    );
    for (k, p) in all.iter().enumerate() {
        let (name, value, unit) = (&p.name, p.value, p.unit);
        let mut strongest = (k, 0.0_f64);
        for j in 0..all.len() {
            let r = c.correlation(k, j);
            if j != k && r.abs() > strongest.1.abs() {
                strongest = (j, r);
            }
        }
        let _ = writeln!(
            table,
            "<tr><td>{name}</td><td>{value:.5} {unit}</td><td>{:.5}</td><td>{:+.3} with {}</td></tr>",
            sigmas[k] * p.scale,
            strongest.1,
            all[strongest.0].name
        );
    }
    table + "</table>\n"
}

fn views(c: &StereoCalibration) -> String {
    let mut table = String::from(
        "<h2>Pairs</h2>\n<p>Influence: what leaving the pair out would change, in sigmas.</p>\n\
         <table>\n<tr><th>pair</th><th>left RMS px</th><th>right RMS px</th><th>distance mm</th>\
         <th>tilt deg</th><th>on intrinsics</th><th>on relative pose</th></tr>\n",
    );
    for v in &c.views {
        let pose = v.left_from_board.isometry();
        let normal = pose.rotation * nalgebra::Vector3::z();
        let _ = writeln!(
            table,
            "<tr><td>{}, {}</td><td>{:.3}</td><td>{:.3}</td><td>{:.0}</td><td>{:.0}</td>\
             <td>{:.1}</td><td>{:.1}</td></tr>",
            escaped(&v.left_name),
            escaped(&v.right_name),
            v.rms_px[0],
            v.rms_px[1],
            pose.translation.vector.norm() * 1e3,
            normal.z.abs().min(1.0).acos().to_degrees(),
            v.influence.intrinsics_sigmas,
            v.influence.extrinsics_sigmas,
        );
    }
    table + "</table>\n"
}

fn escaped(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

//! Plots as SVG.

use plotters::prelude::*;

use super::ReportError;
use crate::calibrate::{StereoCalibration, rectify};
use crate::camera::DistortedPx;

const LEFT: RGBColor = RGBColor(31, 119, 180);
const RIGHT: RGBColor = RGBColor(214, 96, 40);
const SIZE: (u32, u32) = (520, 360);

fn drawn<E: core::fmt::Display>(e: E) -> ReportError {
    ReportError {
        reason: e.to_string(),
    }
}

/// A plot of points: title, axes' names and ranges, and series of coloured points.
struct Scatter<'a> {
    title: &'a str,
    x: (&'a str, f64, f64),
    y: (&'a str, f64, f64),
    series: Vec<(RGBColor, Vec<(f64, f64)>)>,
}

impl Scatter<'_> {
    fn svg(self) -> Result<String, ReportError> {
        let mut svg = String::new();
        {
            let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
            let mut chart = ChartBuilder::on(&root)
                .margin(10)
                .caption(self.title, ("sans-serif", 17))
                .x_label_area_size(38)
                .y_label_area_size(52)
                .build_cartesian_2d(self.x.1..self.x.2, self.y.1..self.y.2)
                .map_err(drawn)?;
            chart
                .configure_mesh()
                .x_desc(self.x.0)
                .y_desc(self.y.0)
                .light_line_style(TRANSPARENT)
                .draw()
                .map_err(drawn)?;
            for (colour, points) in self.series {
                let dots = points
                    .into_iter()
                    .map(|at| Circle::new(at, 2, colour.mix(0.6).filled()));
                chart.draw_series(dots).map_err(drawn)?;
            }
            root.present().map_err(drawn)?;
        }
        Ok(svg)
    }
}

/// Residuals of all corners.
pub(super) fn residuals(c: &StereoCalibration) -> Result<String, ReportError> {
    let of = |side: usize| -> Vec<(f64, f64)> {
        c.views
            .iter()
            .flat_map(|v| v.residuals[side].iter().flatten())
            .map(|r| (r.x, r.y))
            .collect()
    };
    let (left, right) = (of(0), of(1));
    let reach = left
        .iter()
        .chain(&right)
        .fold(0.3_f64, |m, p| m.max(p.0.abs()).max(p.1.abs()));
    let reach = reach * 1.05;
    Scatter {
        title: "Residuals (blue left, orange right)",
        x: ("x [px]", -reach, reach),
        y: ("y [px]", -reach, reach),
        series: vec![(LEFT, left), (RIGHT, right)],
    }
    .svg()
}

/// Where an image was covered with corners.
pub(super) fn coverage(c: &StereoCalibration, side: usize) -> Result<String, ReportError> {
    let (camera, colour, title) = if side == 0 {
        (&c.rig.left, LEFT, "Coverage of the left image")
    } else {
        (&c.rig.right, RIGHT, "Coverage of the right image")
    };
    let points = c
        .views
        .iter()
        .flat_map(|v| &v.corners[side])
        .filter(|p| p.x.is_finite())
        .map(|p| (p.x, p.y))
        .collect();
    Scatter {
        title,
        x: ("column [px]", 0.0, camera.width as f64),
        // Rows grow downwards.
        y: ("row [px]", camera.height as f64, 0.0),
        series: vec![(colour, points)],
    }
    .svg()
}

/// Differences across the baseline after rectification, along the rows of the left image.
pub(super) fn epipolar(c: &StereoCalibration) -> Result<String, ReportError> {
    let mut points = Vec::new();
    if let Some(r) = rectify(&c.rig) {
        for v in &c.views {
            let both = v.corners[0].iter().zip(&v.corners[1]);
            for (a, b) in both.filter(|(a, b)| a.x.is_finite() && b.x.is_finite()) {
                let left = r.map(&c.rig, 0, DistortedPx(*a));
                let right = r.map(&c.rig, 1, DistortedPx(*b));
                if let (Some(left), Some(right)) = (left, right) {
                    let across = usize::from(!r.vertical);
                    points.push((a.x, left[across] - right[across]));
                }
            }
        }
    }
    let reach = points.iter().fold(0.5_f64, |m, p| m.max(p.1.abs())) * 1.05;
    Scatter {
        title: "Epipolar error: left - right across the baseline, rectified",
        x: (
            "column in the left image [px]",
            0.0,
            c.rig.left.width as f64,
        ),
        y: ("difference [px]", -reach, reach),
        series: vec![(LEFT, points)],
    }
    .svg()
}

/// RMS of every image.
pub(super) fn views(c: &StereoCalibration) -> Result<String, ReportError> {
    let highest = c.worst_image_rms_px().max(0.1) * 1.15;
    let mut svg = String::new();
    {
        let root = SVGBackend::with_string(&mut svg, SIZE).into_drawing_area();
        let mut chart = ChartBuilder::on(&root)
            .margin(10)
            .caption(
                "RMS of each pair (blue left, orange right)",
                ("sans-serif", 17),
            )
            .x_label_area_size(38)
            .y_label_area_size(52)
            .build_cartesian_2d(0.0..c.views.len().max(1) as f64, 0.0..highest)
            .map_err(drawn)?;
        let name = |x: &f64| {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "an index of the axis"
            )]
            let k = *x as usize;
            c.views
                .get(k)
                .map_or_else(String::new, |v| stem(&v.left_name))
        };
        chart
            .configure_mesh()
            .disable_x_mesh()
            .x_labels(c.views.len().clamp(1, 15))
            .x_label_formatter(&name)
            .y_desc("RMS [px]")
            .light_line_style(TRANSPARENT)
            .draw()
            .map_err(drawn)?;
        for (k, v) in c.views.iter().enumerate() {
            for (side, colour) in [LEFT, RIGHT].into_iter().enumerate() {
                let x = k as f64 + 0.1 + 0.4 * side as f64;
                let bar = Rectangle::new([(x, 0.0), (x + 0.4, v.rms_px[side])], colour.filled());
                chart.draw_series([bar]).map_err(drawn)?;
            }
        }
        root.present().map_err(drawn)?;
    }
    Ok(svg)
}

/// A file's name without its ending.
fn stem(name: &str) -> String {
    std::path::Path::new(name)
        .file_stem()
        .map_or_else(|| name.to_owned(), |s| s.to_string_lossy().into_owned())
}

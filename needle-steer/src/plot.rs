//! The plot of a run: what Fig. 3 of the paper shows, and what the base did.

use std::path::Path;

use plotters::prelude::*;

use crate::series::Row;

/// A plot that could not be written.
#[derive(Debug, thiserror::Error)]
#[error("plot {file}: {message}")]
pub struct PlotError {
    /// The file.
    pub file: String,
    /// What the plotting library says.
    pub message: String,
}

/// Points of a curve, about; more cannot be seen.
const POINTS: usize = 500;

struct Curve<'a> {
    label: &'a str,
    colour: RGBColor,
    points: Vec<(f64, f64)>,
}

/// Writes four panels over time as SVG: lateral error (Fig. 3), base motion, stiffness, stretch.
///
/// # Errors
/// The file cannot be written.
pub fn write_run_plot(rows: &[Row], title: &str, file: &Path) -> Result<(), PlotError> {
    let fail = |message: String| PlotError {
        file: file.display().to_string(),
        message,
    };
    draw(rows, title, file).map_err(|e| fail(e.to_string()))
}

fn draw(rows: &[Row], title: &str, file: &Path) -> Result<(), Box<dyn std::error::Error>> {
    let root = SVGBackend::new(file, (960, 720)).into_drawing_area();
    root.fill(&WHITE)?;
    let root = root.titled(title, ("sans-serif", 20))?;
    let panels = root.split_evenly((2, 2));
    let start = rows.first().map_or(0.0, |row| row.t_s);
    let stride = (rows.len() / POINTS).max(1);
    let curve = |label, colour, value: fn(&Row) -> f64| Curve {
        label,
        colour,
        points: rows
            .iter()
            .step_by(stride)
            .map(|row| (row.t_s - start, value(row)))
            .filter(|(_, y)| y.is_finite())
            .collect(),
    };
    let blue = RGBColor(31, 119, 180);
    let orange = RGBColor(255, 127, 14);
    let green = RGBColor(44, 160, 44);
    let panel = |index: usize, name: &str, curves: &[Curve<'_>]| match panels.get(index) {
        Some(area) => draw_panel(area, name, curves),
        None => Ok(()),
    };
    panel(
        0,
        "distance of the target from the tip axis [mm]",
        &[
            curve("measured", orange, |r| r.lateral_error_mm),
            curve("true", blue, |r| r.true_lateral_error_mm),
            curve("predicted at the target", green, |r| r.predicted_miss_mm),
        ],
    )?;
    panel(
        1,
        "base motion across the needle [mm], tilt [deg]",
        &[
            curve("x", blue, |r| r.base_mm.x),
            curve("y", orange, |r| r.base_mm.y),
            curve("tilt", green, |r| r.tilt_deg),
        ],
    )?;
    panel(
        2,
        "estimated tissue stiffness [N/m2]",
        &[curve("K_T", blue, |r| r.stiffness)],
    )?;
    panel(
        3,
        "mean tissue displacement [mm]",
        &[
            curve("model", orange, |r| r.mean_stretch_mm),
            curve("true", blue, |r| r.true_mean_stretch_mm),
        ],
    )?;
    root.present()?;
    Ok(())
}

fn draw_panel(
    area: &DrawingArea<SVGBackend<'_>, plotters::coord::Shift>,
    name: &str,
    curves: &[Curve<'_>],
) -> Result<(), Box<dyn std::error::Error>> {
    let all = || curves.iter().flat_map(|c| c.points.iter());
    let duration = all().fold(1e-3_f64, |m, p| m.max(p.0));
    let (low, high) = all().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), p| {
        (l.min(p.1), h.max(p.1))
    });
    if low > high {
        return Ok(());
    }
    let margin = 0.05 * (high - low).max(1e-6);
    let mut chart = ChartBuilder::on(area)
        .caption(name, ("sans-serif", 15))
        .margin(10)
        .x_label_area_size(30)
        .y_label_area_size(55)
        .build_cartesian_2d(0.0..duration, (low - margin)..(high + margin))?;
    chart
        .configure_mesh()
        .x_desc("time [s]")
        .light_line_style(WHITE)
        .draw()?;
    for curve in curves.iter().filter(|c| !c.points.is_empty()) {
        let colour = curve.colour;
        chart
            .draw_series(LineSeries::new(
                curve.points.iter().copied(),
                colour.stroke_width(2),
            ))?
            .label(curve.label)
            .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
    }
    if curves.iter().filter(|c| !c.points.is_empty()).count() > 1 {
        chart
            .configure_series_labels()
            .background_style(WHITE.mix(0.8))
            .border_style(BLACK.mix(0.3))
            .draw()?;
    }
    Ok(())
}

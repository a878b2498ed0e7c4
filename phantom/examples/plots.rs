//! Draws the figures of `docs/PHANTOM.md` into the folder given (default `docs/phantom`).
//!
//! `cargo run --release -p phantom --example plots`

use std::error::Error;
use std::path::{Path, PathBuf};

use hal::{Stamp, Transform};
use nalgebra::{Isometry3, Vector3};
use phantom::experiment::{Uncontrolled, default_setup, uncontrolled};
use phantom::{Plant, RodPlant, Settings};
use plotters::coord::types::RangedCoordf64;
use plotters::prelude::*;

type Chart<'a> = ChartContext<'a, SVGBackend<'a>, Cartesian2d<RangedCoordf64, RangedCoordf64>>;
type Outcome<T = ()> = Result<T, Box<dyn Error>>;

const SIZE: (u32, u32) = (720, 420);
/// Colours that colour-blind readers can tell apart (Okabe and Ito).
const BLUE_: RGBColor = RGBColor(0, 114, 178);
const ORANGE: RGBColor = RGBColor(230, 159, 0);
const GREEN_: RGBColor = RGBColor(0, 158, 115);
const VERMILION: RGBColor = RGBColor(213, 94, 0);

struct Axes<'a> {
    title: &'a str,
    x: (&'a str, f64, f64),
    y: (&'a str, f64, f64),
    legend: SeriesLabelPosition,
}

fn chart(file: &Path, axes: &Axes, draw: impl FnOnce(&mut Chart) -> Outcome) -> Outcome {
    let area = SVGBackend::new(file, SIZE).into_drawing_area();
    area.fill(&WHITE)?;
    let mut chart = ChartBuilder::on(&area)
        .caption(axes.title, ("sans-serif", 18))
        .margin(12)
        .x_label_area_size(42)
        .y_label_area_size(56)
        .build_cartesian_2d(axes.x.1..axes.x.2, axes.y.1..axes.y.2)?;
    chart
        .configure_mesh()
        .light_line_style(WHITE)
        .x_desc(axes.x.0)
        .y_desc(axes.y.0)
        .label_style(("sans-serif", 13))
        .draw()?;
    draw(&mut chart)?;
    chart
        .configure_series_labels()
        .position(axes.legend.clone())
        .label_font(("sans-serif", 13))
        .background_style(WHITE.mix(0.85))
        .border_style(BLACK.mix(0.3))
        .draw()?;
    area.present()?;
    Ok(())
}

fn line(chart: &mut Chart, label: &str, colour: RGBColor, points: Vec<(f64, f64)>) -> Outcome {
    chart
        .draw_series(LineSeries::new(points, colour.stroke_width(2)))?
        .label(label)
        .legend(move |(x, y)| PathElement::new([(x, y), (x + 16, y)], colour.stroke_width(2)));
    Ok(())
}

fn dots(chart: &mut Chart, label: &str, colour: RGBColor, points: Vec<(f64, f64)>) -> Outcome {
    chart
        .draw_series(
            points
                .into_iter()
                .map(|p| Circle::new(p, 2, colour.filled())),
        )?
        .label(label)
        .legend(move |(x, y)| Circle::new((x + 8, y), 3, colour.filled()));
    Ok(())
}

/// A plant inserted straight to `depth_mm`, and the inverse of the phantom's pose.
fn inserted(settings: &Settings, depth_mm: f64) -> Outcome<(RodPlant, Isometry3<f64>)> {
    let setup = default_setup(settings, 1);
    let base = setup.world_from_base;
    let mut plant = RodPlant::new(settings, &setup.world_from_phantom, &base, 1)?;
    for step in 1..=240 {
        let way = depth_mm * 1e-3 * f64::from(step) / 240.0;
        let pose = base.isometry() * Isometry3::translation(0.0, 0.0, way);
        let stamp = Stamp::from_secs(depth_mm * f64::from(step) / 240.0);
        plant.advance(&Transform::assume(pose), stamp);
    }
    Ok((plant, setup.world_from_phantom.inverse()))
}

fn insertion(folder: &Path) -> Outcome {
    let axes = Axes {
        title: "Uncontrolled insertion, preset ideal: shaft and cut path at 20, 50 and 80 mm",
        x: ("depth [mm]", -60.0, 90.0),
        y: ("towards the bevel direction [mm]", -1.0, 8.0),
        legend: SeriesLabelPosition::UpperLeft,
    };
    chart(&folder.join("insertion.svg"), &axes, |chart| {
        let settings = Settings::default();
        for (depth, colour) in [(20.0, ORANGE), (50.0, GREEN_), (80.0, BLUE_)] {
            let (plant, into_phantom) = inserted(&settings, depth)?;
            let place = |p: &Vector3<f64>| {
                let p = into_phantom * nalgebra::Point3::from(*p);
                (p.z * 1e3, -p.y * 1e3)
            };
            let truth = plant.truth();
            let shaft = truth.needle.centreline.iter().map(place).collect();
            line(chart, &format!("shaft at {depth} mm"), colour, shaft)?;
            let path: Vec<_> = truth.cut_path.iter().map(place).collect();
            let thin = VERMILION.stroke_width(1);
            let series = chart.draw_series(LineSeries::new(path, thin))?;
            if depth > 79.0 {
                series.label("cut path").legend(move |(x, y)| {
                    PathElement::new([(x, y), (x + 16, y)], VERMILION.stroke_width(1))
                });
            }
        }
        let surface = [(0.0, -1.0), (0.0, 8.0)];
        chart.draw_series(LineSeries::new(surface, BLACK.mix(0.4)))?;
        Ok(())
    })
}

fn authority(folder: &Path) -> Outcome {
    let axes = Axes {
        title: "Authority of the base: tip tilt per millimetre of base shift",
        x: ("depth of O [mm]", 0.0, 90.0),
        y: ("tip tilt [deg/mm]", -0.9, 0.2),
        legend: SeriesLabelPosition::LowerRight,
    };
    chart(&folder.join("authority.svg"), &axes, |chart| {
        for (stiffness, colour) in [(5e3, ORANGE), (1e4, BLUE_), (2e4, GREEN_)] {
            let mut settings = Settings::default();
            settings.tip.cut_angle_deg = 0.0;
            settings.tissue.stiffness_n_m2 = stiffness;
            let mut points = Vec::new();
            for step in 1..=30 {
                let depth = 3.0 * f64::from(step);
                let (mut plant, into_phantom) = inserted(&settings, depth)?;
                let base = *plant.truth().world_from_base.isometry();
                let shift = into_phantom.inverse() * Vector3::x() * 0.2e-3;
                let moved = nalgebra::Translation3::from(shift) * base;
                plant.advance(&Transform::assume(moved), plant.truth().stamp);
                let direction = into_phantom * plant.truth().direction();
                points.push((depth, direction.x.asin().to_degrees() / 0.2));
            }
            line(chart, &format!("K = {stiffness:.0} N/m2"), colour, points)?;
        }
        let zero = [(0.0, 0.0), (90.0, 0.0)];
        chart.draw_series(LineSeries::new(zero, BLACK.mix(0.4)))?;
        Ok(())
    })
}

fn population(folder: &Path) -> Outcome {
    let axes = Axes {
        title: "Uncontrolled misses of 100 runs of each frozen population",
        x: ("aligned target [mm]", 0.0, 12.0),
        y: ("target shifted by 1 cm [mm]", 0.0, 10.0),
        legend: SeriesLabelPosition::UpperRight,
    };
    chart(&folder.join("population.svg"), &axes, |chart| {
        for (name, colour) in [("paper", BLUE_), ("paper-compliant", ORANGE)] {
            let settings = Settings::preset(name)?;
            let runs: Vec<Uncontrolled> = (1..=100)
                .map(|seed| uncontrolled(&settings, seed, 1e-3, 0.1))
                .collect::<Result<_, _>>()?;
            let points = runs
                .iter()
                .map(|r| (r.aligned * 1e3, r.shifted * 1e3))
                .collect();
            dots(chart, name, colour, points)?;
        }
        let cross = (7.6, 4.9);
        chart
            .draw_series([Cross::new(cross, 7, VERMILION.stroke_width(3))])?
            .label("[Chevrie2016]: 7.6 and 4.9 mm, two runs")
            .legend(|(x, y)| Cross::new((x + 8, y), 5, VERMILION.stroke_width(3)));
        Ok(())
    })
}

fn main() -> Outcome {
    let folder = std::env::args()
        .nth(1)
        .map_or_else(|| PathBuf::from("docs/phantom"), PathBuf::from);
    std::fs::create_dir_all(&folder)?;
    insertion(&folder)?;
    authority(&folder)?;
    population(&folder)
}

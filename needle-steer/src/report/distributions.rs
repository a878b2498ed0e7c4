//! Reports of many runs: campaigns and the paper's experiments.

use std::collections::BTreeMap;
use std::path::Path;

use plotly::box_plot::BoxPoints;
use plotly::common::{ColorScale, ColorScalePalette, DashType, Marker, Mode};
use plotly::layout::{Axis, AxisType, Shape, ShapeLine, ShapeType};
use plotly::{BoxPlot, Plot, Scatter};
use serde::Deserialize;

use super::charts::{BLUE, COLOURS, GREY, LEAST_ERROR_MM, RED, layout};
use super::{Page, ReportError};
use crate::campaign::compare::conclude;
use crate::campaign::ledger::collect;
use crate::campaign::{Cell, Plan, Row};

/// The report of a campaign's folder.
pub(super) fn campaign(folder: &Path) -> Result<Page, ReportError> {
    let plan = Plan::load(&folder.join("campaign.toml"))?;
    let lines = collect(&[folder.to_owned()], &plan)?;
    let rows: Vec<Row> = lines
        .values()
        .map(|line| Row::parse(line))
        .collect::<Result<_, _>>()?;
    let found = conclude(&plan, &rows);
    let mut page = Page::new(&format!("Campaign: {}", plan.laws.join(", ")));
    page.text(&format!(
        "{} of {} runs are finished, {} could not be carried out. A hit passes the target within \
         {} mm; a run that ended early has missed and counts with its error at the end. Intervals \
         are at 95 % and assume no distribution.",
        found.finished, found.runs, found.failed, plan.success_mm
    ));
    page.heading("Distributions");
    page.explained(
        "errors",
        420,
        &errors(&plan, &rows),
        "Each box holds the middle half of the seeds, its line is the median; whiskers reach to the last run \
         within one and a half boxes, runs beyond are points. On a logarithmic scale, the largest error of a hit \
         dotted.",
    );
    page.explained(
        "stretch",
        420,
        &stretches(&plan, &rows),
        "How far the shaft pushed the tissue aside at its worst moment. A law that hits by tearing is no better.",
    );
    cells(&mut page, &found.cells);
    if !found.pairs.is_empty() {
        page.heading(&format!(
            "Paired against the law {}, seed by seed",
            plan.reference
        ));
        page.grid(
            &[
                "law",
                "phantom",
                "target",
                "median difference mm",
                "interval mm",
                "better",
                "worse",
                "p (sign test)",
            ],
            &found
                .pairs
                .iter()
                .map(|p| {
                    vec![
                        p.law.clone(),
                        p.phantom.clone(),
                        p.target.clone(),
                        format!("{:+.3}", p.median_difference_mm),
                        range(p.interval_mm),
                        p.better.to_string(),
                        p.worse.to_string(),
                        if p.p_value < 1e-3 {
                            format!("{:.0e}", p.p_value)
                        } else {
                            format!("{:.3}", p.p_value)
                        },
                    ]
                })
                .collect::<Vec<_>>(),
        );
    }
    let places: std::collections::BTreeSet<[u64; 3]> = found
        .cells
        .iter()
        .map(|c| c.place.map(f64::to_bits))
        .collect();
    if places.len() > 3 {
        page.heading("Reachable set");
        page.text(
            "Each point is a target: its offset across the needle from the bevel direction \
             (upwards), coloured by the rate of hits.",
        );
        for (k, plot) in reachable(&found.cells).iter().enumerate() {
            page.plot(&format!("reach{k}"), 420, plot);
        }
    }
    page.heading("Settings");
    let text = toml::to_string(&plan.base).unwrap_or_default();
    page.folded("the configuration under all runs", &text);
    Ok(page)
}

fn range(interval: Option<[f64; 2]>) -> String {
    interval.map_or_else(
        || "fewer than six".into(),
        |[low, high]| format!("{low:.3} to {high:.3}"),
    )
}

fn cells(page: &mut Page, cells: &[Cell]) {
    page.grid(
        &[
            "law",
            "phantom",
            "target",
            "runs",
            "passed",
            "hits",
            "rate of hits",
            "median mm",
            "its interval mm",
            "5 %",
            "95 %",
            "largest stretch mm",
        ],
        &cells
            .iter()
            .map(|c| {
                vec![
                    c.law.clone(),
                    c.phantom.clone(),
                    c.target.clone(),
                    c.runs.to_string(),
                    c.passed.to_string(),
                    c.hits.to_string(),
                    format!(
                        "{:.2} to {:.2}",
                        c.hit_rate_interval[0], c.hit_rate_interval[1]
                    ),
                    format!("{:.3}", c.median_mm),
                    range(c.median_interval_mm),
                    format!("{:.3}", c.p5_mm),
                    format!("{:.3}", c.p95_mm),
                    format!("{:.2}", c.median_max_stretch_mm),
                ]
            })
            .collect::<Vec<_>>(),
    );
}

/// Places along the axis, and the value at each.
type Column = (Vec<String>, Vec<f64>);

/// One box for each law, in the campaign's order, side by side at each phantom and target.
fn boxes(plan: &Plan, rows: &[Row], title: &str, value: impl Fn(&Row) -> Option<f64>) -> Plot {
    let mut laws: Vec<(&str, Column)> = plan
        .laws
        .iter()
        .map(|law| (law.as_str(), Column::default()))
        .collect();
    let phantoms: std::collections::BTreeSet<&str> =
        rows.iter().map(|row| row.phantom.as_str()).collect();
    for row in rows {
        let Some(value) = value(row) else { continue };
        let Some((_, (places, values))) = laws.iter_mut().find(|(law, _)| *law == row.law) else {
            continue;
        };
        places.push(if phantoms.len() > 1 {
            format!("{}, {}", row.phantom, row.target)
        } else {
            row.target.clone()
        });
        values.push(value);
    }
    let mut plot = Plot::new();
    for ((law, (places, values)), colour) in laws.into_iter().zip(COLOURS.iter().cycle()) {
        plot.add_trace(
            BoxPlot::new_xy(places, values)
                .name(law)
                .box_points(BoxPoints::Outliers)
                .marker(Marker::new().color(*colour).size(3)),
        );
    }
    plot.set_layout(
        layout(title, "", "")
            .x_axis(Axis::new().type_(AxisType::Category).auto_margin(true))
            .y_axis(Axis::new().title("[mm]").zero_line(true))
            .box_mode(plotly::layout::BoxMode::Group),
    );
    plot
}

fn errors(plan: &Plan, rows: &[Row]) -> Plot {
    let title = "True lateral error";
    let mut plot = boxes(plan, rows, title, |row| {
        row.true_error_mm.map(|mm| mm.max(LEAST_ERROR_MM))
    });
    let hit = Shape::new()
        .shape_type(ShapeType::Line)
        .x_ref("paper")
        .x0(0.0)
        .x1(1.0)
        .y_ref("y")
        .y0(plan.success_mm)
        .y1(plan.success_mm)
        .line(ShapeLine::new().color(GREY).width(1.0).dash(DashType::Dot));
    let layout = plot.layout().clone();
    plot.set_layout(
        layout
            .y_axis(Axis::new().title("[mm]").type_(AxisType::Log))
            .shapes(vec![hit]),
    );
    plot
}

fn stretches(plan: &Plan, rows: &[Row]) -> Plot {
    boxes(plan, rows, "Largest true tissue displacement", |row| {
        (!row.is_failed()).then_some(row.max_stretch_mm)
    })
}

/// For each law, phantom and depth: the targets across the needle.
fn reachable(cells: &[Cell]) -> Vec<Plot> {
    let mut groups: BTreeMap<(String, String, u64), Vec<&Cell>> = BTreeMap::new();
    for cell in cells {
        let key = (
            cell.law.clone(),
            cell.phantom.clone(),
            cell.place[0].to_bits(),
        );
        groups.entry(key).or_default().push(cell);
    }
    groups
        .into_iter()
        .map(|((law, phantom, depth), cells)| {
            // The bevel direction upwards, angles right-handed about the needle's z, seen along it.
            let at = |c: &Cell| {
                let angle = c.place[2].to_radians();
                (-c.place[1] * angle.sin(), c.place[1] * angle.cos())
            };
            let (x, y): (Vec<f64>, Vec<f64>) = cells.iter().map(|c| at(c)).unzip();
            let rates: Vec<f64> = cells
                .iter()
                .map(|c| c.hits as f64 / c.runs as f64)
                .collect();
            let texts: Vec<String> = cells
                .iter()
                .map(|c| {
                    format!(
                        "{}: {}/{} hits, median {:.2} mm",
                        c.target, c.hits, c.runs, c.median_mm
                    )
                })
                .collect();
            let mut plot = Plot::new();
            plot.add_trace(
                Scatter::new(x, y)
                    .mode(Mode::Markers)
                    .text_array(texts)
                    .marker(
                        Marker::new()
                            .size(16)
                            .color_array(rates)
                            .color_scale(ColorScale::Palette(ColorScalePalette::Viridis))
                            .cmin(0.0)
                            .cmax(1.0)
                            .show_scale(true),
                    ),
            );
            let title = format!("{law}, {phantom}, {} mm deep", f64::from_bits(depth));
            plot.set_layout(
                layout(&title, "across the bevel direction [mm]", "")
                    .y_axis(
                        Axis::new()
                            .title("along the bevel direction [mm]")
                            .scale_anchor("x"),
                    )
                    .hover_mode(plotly::layout::HoverMode::Closest),
            );
            plot
        })
        .collect()
}

/// The document that `reproduce --json` prints.
#[derive(Deserialize)]
struct Reproduced {
    experiments: Vec<Experiment>,
}

#[derive(Deserialize)]
struct Experiment {
    name: String,
    law: String,
    target: String,
    paper_error_mm: f64,
    runs: Vec<Run>,
    median_mm: f64,
    p5_mm: f64,
    p95_mm: f64,
}

#[derive(Deserialize)]
struct Run {
    true_error_mm: Option<f64>,
    ended: String,
}

/// The report of the paper's experiments.
pub(super) fn experiments(file: &Path) -> Result<Page, ReportError> {
    let text = std::fs::read(file).map_err(|source| ReportError::Io {
        file: file.to_owned(),
        source,
    })?;
    let document: Reproduced =
        serde_json::from_slice(&text).map_err(|source| ReportError::Results {
            file: file.to_owned(),
            source,
        })?;
    let mut page = Page::new("The paper's four experiments (Table I)");
    page.text(
        "Each box is the distribution over seeds of the true distance of the target from the tip \
         axis; the crosses are the paper's single runs.",
    );
    let mut plot = Plot::new();
    for experiment in &document.experiments {
        let name = format!(
            "{} {}, {}",
            experiment.name, experiment.law, experiment.target
        );
        let errors: Vec<f64> = experiment
            .runs
            .iter()
            .filter_map(|r| r.true_error_mm)
            .collect();
        plot.add_trace(
            BoxPlot::new_xy(vec![name.clone(); errors.len()], errors)
                .name(name.as_str())
                .box_points(BoxPoints::All)
                .jitter(0.4)
                .point_pos(-1.6)
                .marker(Marker::new().color(BLUE).size(4))
                .show_legend(false),
        );
    }
    let (names, papers): (Vec<String>, Vec<f64>) = document
        .experiments
        .iter()
        .map(|e| {
            (
                format!("{} {}, {}", e.name, e.law, e.target),
                e.paper_error_mm,
            )
        })
        .unzip();
    plot.add_trace(
        Scatter::new(names, papers)
            .mode(Mode::Markers)
            .marker(
                Marker::new()
                    .color(RED)
                    .size(10)
                    .symbol(plotly::common::MarkerSymbol::X),
            )
            .name("paper"),
    );
    plot.set_layout(
        layout("True lateral error", "", "")
            .x_axis(Axis::new().type_(AxisType::Category))
            .y_axis(Axis::new().title("[mm]")),
    );
    page.plot("table1", 520, &plot);
    page.grid(
        &[
            "",
            "law",
            "target",
            "paper mm",
            "median mm",
            "5 %",
            "95 %",
            "passed",
        ],
        &document
            .experiments
            .iter()
            .map(|e| {
                let passed = e.runs.iter().filter(|r| r.ended == "target passed").count();
                vec![
                    e.name.clone(),
                    e.law.clone(),
                    e.target.clone(),
                    format!("{:.1}", e.paper_error_mm),
                    format!("{:.3}", e.median_mm),
                    format!("{:.3}", e.p5_mm),
                    format!("{:.3}", e.p95_mm),
                    format!("{passed} of {}", e.runs.len()),
                ]
            })
            .collect::<Vec<_>>(),
    );
    Ok(page)
}

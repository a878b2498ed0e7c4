//! The charts of a run over time.

use plotly::common::{Fill, Font, Line, LineShape, Marker, Mode, Orientation, Title};
use plotly::layout::{Axis, AxisType, HoverMode, Legend, Margin};
use plotly::{Histogram, Layout, Plot, Scatter};

use super::course::{Course, Sample};

pub(super) const BLUE: &str = "#1f77b4";
pub(super) const ORANGE: &str = "#ff7f0e";
pub(super) const GREEN: &str = "#2ca02c";
pub(super) const RED: &str = "#d62728";
pub(super) const GREY: &str = "#7f7f7f";

/// Points of a curve, about; more cannot be seen.
const POINTS: usize = 1500;

/// All charts over time, in reading order.
pub(super) fn all(course: &Course) -> Vec<Plot> {
    vec![
        error(course),
        base(course),
        stiffness(course),
        stretch(course),
        bevel(course),
        steering(course),
        limits(course),
    ]
}

fn thinned(course: &Course) -> impl Iterator<Item = &Sample> {
    course
        .samples
        .iter()
        .step_by((course.samples.len() / POINTS).max(1))
}

type Curve = Box<Scatter<f64, f64>>;

fn curve(course: &Course, name: &str, colour: &'static str, y: impl Fn(&Sample) -> f64) -> Curve {
    let start = course.samples.first().map_or(0.0, |s| s.row.t_s);
    let (times, values) = thinned(course).map(|s| (s.row.t_s - start, y(s))).unzip();
    Scatter::new(times, values)
        .mode(Mode::Lines)
        .line(Line::new().color(colour).width(1.5))
        .name(name)
}

/// A layout with a title and named axes, the legend below.
pub(super) fn layout(title: &str, x: &str, y: &str) -> Layout {
    Layout::new()
        .title(Title::with_text(title).x(0.02).font(Font::new().size(15)))
        .x_axis(Axis::new().title(x).zero_line(false))
        .y_axis(Axis::new().title(y))
        .hover_mode(HoverMode::X)
        .legend(Legend::new().orientation(Orientation::Horizontal).y(-0.25))
        .margin(Margin::new().left(60).right(20).top(45).bottom(70))
}

fn chart(title: &str, y: &str, curves: Vec<Curve>) -> Plot {
    let mut plot = Plot::new();
    for curve in curves {
        plot.add_trace(curve);
    }
    plot.set_layout(layout(title, "time [s]", y));
    plot
}

/// Fig. 3 of the paper, with truth and prediction beside the measurement.
fn error(course: &Course) -> Plot {
    chart(
        "Distance of the target from the tip axis (Fig. 3)",
        "[mm]",
        vec![
            curve(course, "measured", ORANGE, |s| s.row.lateral_error_mm),
            curve(course, "true", BLUE, |s| s.row.true_lateral_error_mm),
            curve(course, "predicted at the target", GREEN, |s| {
                s.row.predicted_miss_mm
            }),
        ],
    )
}

fn base(course: &Course) -> Plot {
    chart(
        "Motion of the base across the needle",
        "[mm], [deg]",
        vec![
            curve(course, "x [mm]", BLUE, |s| s.row.base_mm.x),
            curve(course, "y [mm]", ORANGE, |s| s.row.base_mm.y),
            curve(course, "tilt [deg]", GREEN, |s| s.row.tilt_deg),
        ],
    )
}

fn stiffness(course: &Course) -> Plot {
    let bound =
        |sign: f64| move |s: &Sample| s.row.stiffness * (sign * 1.96 * s.stiffness_sigma).exp();
    let faint = "rgba(31,119,180,0.2)";
    chart(
        "Estimated tissue stiffness K_T",
        "[N/m²]",
        vec![
            curve(course, "95 % band, low", faint, bound(-1.0)).show_legend(false),
            curve(course, "95 % band", faint, bound(1.0))
                .fill(Fill::ToNextY)
                .fill_color(faint),
            curve(course, "K_T", BLUE, |s| s.row.stiffness),
        ],
    )
}

fn stretch(course: &Course) -> Plot {
    chart(
        "Mean tissue displacement",
        "[mm]",
        vec![
            curve(course, "model", ORANGE, |s| s.row.mean_stretch_mm),
            curve(course, "true", BLUE, |s| s.row.true_mean_stretch_mm),
        ],
    )
}

fn bevel(course: &Course) -> Plot {
    chart(
        "Last joint and bevel error",
        "[deg]",
        vec![
            curve(course, "last joint", BLUE, |s| s.row.roll_deg),
            curve(course, "bevel error sigma", ORANGE, |s| s.bevel_error),
            curve(course, "heading error", GREEN, |s| s.heading_error),
        ],
    )
}

/// Duty cycle and mode of steering. The modes are names, one line each.
fn steering(course: &Course) -> Plot {
    let start = course.samples.first().map_or(0.0, |s| s.row.t_s);
    let mut plot = Plot::new();
    plot.add_trace(
        curve(course, "duty cycle", BLUE, |s| s.row.duty_cycle)
            .line(Line::new().color(BLUE).width(1.5).shape(LineShape::Hv)),
    );
    let modes: std::collections::BTreeSet<String> = course
        .samples
        .iter()
        .map(|s| format!("{:?}", s.row.mode))
        .collect();
    for (k, mode) in modes.iter().enumerate() {
        let level = -0.15 * (k + 1) as f64;
        let times: Vec<f64> = thinned(course)
            .filter(|s| format!("{:?}", s.row.mode) == *mode)
            .map(|s| s.row.t_s - start)
            .collect();
        let levels = vec![level; times.len()];
        plot.add_trace(
            Scatter::new(times, levels)
                .mode(Mode::Markers)
                .marker(Marker::new().size(5))
                .name(mode.as_str()),
        );
    }
    let lowest = -0.15 * (modes.len() + 1) as f64;
    plot.set_layout(
        layout("Duty cycle and mode of steering", "time [s]", "")
            .y_axis(Axis::new().title("duty cycle").range(vec![lowest, 1.05])),
    );
    plot
}

fn limits(course: &Course) -> Plot {
    let start = course.samples.first().map_or(0.0, |s| s.row.t_s);
    let (mut times, mut names) = (Vec::new(), Vec::new());
    for sample in thinned(course) {
        for limit in &sample.row.limits {
            times.push(sample.row.t_s - start);
            names.push(format!("{limit:?}"));
        }
    }
    let none = times.is_empty();
    let mut plot = Plot::new();
    plot.add_trace(
        Scatter::new(times, names)
            .mode(Mode::Markers)
            .marker(Marker::new().size(5).color(RED))
            .name("limit"),
    );
    let title = if none {
        "Limits that acted: none"
    } else {
        "Limits that acted"
    };
    let axis = Axis::new().type_(AxisType::Category).auto_margin(true);
    plot.set_layout(layout(title, "time [s]", "").y_axis(axis));
    plot
}

/// Age of the measurement at each step, and the time from step to step.
pub(super) fn ages(course: &Course) -> Plot {
    let mut plot = Plot::new();
    let ages: Vec<f64> = course.samples.iter().filter_map(|s| s.image_age).collect();
    let steps: Vec<f64> = course.samples.iter().filter_map(|s| s.interval).collect();
    for (values, name, colour) in [
        (ages, "age of the measurement", BLUE),
        (steps, "from step to step", ORANGE),
    ] {
        plot.add_trace(
            Histogram::new(values)
                .name(name)
                .opacity(0.6)
                .marker(Marker::new().color(colour)),
        );
    }
    plot.set_layout(
        layout("Timing of the run", "[ms]", "steps").bar_mode(plotly::layout::BarMode::Overlay),
    );
    plot
}

/// Time that a step takes on this machine \[s\].
pub(super) fn times(times: &[f64]) -> Plot {
    let us: Vec<f64> = times.iter().map(|t| t * 1e6).collect();
    let median = crate::statistics::median(&us);
    let p99 = crate::statistics::percentile(&us, 0.99);
    // A few interruptions by other programs must not squeeze the rest into one bar.
    let shown = us.iter().copied().filter(|t| *t <= 1.5 * p99).collect();
    let mut plot = Plot::new();
    plot.add_trace(
        Histogram::new(shown)
            .name("steps")
            .n_bins_x(80)
            .marker(Marker::new().color(BLUE)),
    );
    let title = format!(
        "Time of a step, replayed on this machine: median {median:.0} µs, 99 % {p99:.0} µs"
    );
    plot.set_layout(layout(&title, "[µs]", "steps"));
    plot
}

//! The charts of a run over time.

use plotly::common::{DashType, Fill, Font, Line, LineShape, Marker, Mode, Orientation, Title};
use plotly::histogram::Bins;
use plotly::layout::{Axis, AxisType, HoverMode, Legend, Margin};
use plotly::{Histogram, Layout, Plot, Scatter};

use super::course::{Course, Sample};

// Okabe and Ito's palette, which also the colour-blind tell apart. On every page the truth is
// blue, what is measured or modelled orange, what is predicted green, and a warning red.
pub(super) const BLUE: &str = "#0072b2";
pub(super) const ORANGE: &str = "#e69f00";
pub(super) const GREEN: &str = "#009e73";
pub(super) const RED: &str = "#d55e00";
pub(super) const GREY: &str = "#7f7f7f";
/// The same in their order, for what has no colour of its own.
pub(super) const COLOURS: [&str; 5] = [BLUE, ORANGE, GREEN, RED, GREY];

/// Smaller errors are drawn as this one \[mm\]: a logarithm has no zero, and no sensor sees less.
pub(super) const LEAST_ERROR_MM: f64 = 1e-3;

/// Points of a curve, about; more cannot be seen.
const POINTS: usize = 1500;

/// All charts over time, in reading order, each with how to read it.
pub(super) fn all(course: &Course) -> Vec<(Plot, &'static str)> {
    vec![
        (
            error(course),
            "On a logarithmic scale, the goal dotted. Steering is good where the green curve, what \
             would come of doing nothing more, falls early; the blue and the orange one count at \
             the end only.",
        ),
        (
            base(course),
            "Large motion early, while the base has authority, and none at depth: there it only \
             stretches the tissue.",
        ),
        (
            stiffness(course),
            "The band is what the controller believes with 95 %. It narrows once the base has \
             moved: without motion nothing tells.",
        ),
        (
            stretch(course),
            "How far the shaft pushes the tissue aside, in the mean over its length; the model is \
             right where the curves agree.",
        ),
        (
            bevel(course),
            "Each step of the last joint is a turn of the bevel. Its error is the angle to the side \
             that the law wants; it may be large while little curvature is wanted.",
        ),
        (steering(course), "What the law did at each time."),
        (
            limits(course),
            "A limit that acts for long is what to look at first when a run misses.",
        ),
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
    let goal = course.config.target.goal_mm;
    // Without a target there is no distance: a gap.
    let seen = |mm: f64| {
        if mm > 0.0 {
            mm.max(LEAST_ERROR_MM)
        } else {
            f64::NAN
        }
    };
    let mut plot = chart(
        "Distance of the target from the tip axis (Fig. 3)",
        "[mm]",
        vec![
            curve(course, "measured", ORANGE, |s| seen(s.row.lateral_error_mm)),
            curve(course, "true", BLUE, |s| seen(s.row.true_lateral_error_mm)),
            curve(course, "predicted at the target", GREEN, |s| {
                seen(s.row.predicted_miss_mm)
            }),
            curve(course, "goal", GREY, |_| goal)
                .line(Line::new().color(GREY).width(1.0).dash(DashType::Dot)),
        ],
    );
    let layout = plot.layout().clone();
    plot.set_layout(layout.y_axis(Axis::new().title("[mm]").type_(AxisType::Log)));
    plot
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
    let faint = "rgba(0,114,178,0.2)";
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
        "Last joint, bevel and heading",
        "[deg]",
        vec![
            curve(course, "last joint", BLUE, |s| s.row.roll_deg),
            curve(course, "bevel error", ORANGE, |s| s.bevel_error),
            curve(course, "heading error", GREEN, |s| s.heading_error),
        ],
    )
}

/// Duty cycle and mode of steering. The modes are names, one line each.
fn steering(course: &Course) -> Plot {
    let start = course.samples.first().map_or(0.0, |s| s.row.t_s);
    let mut plot = Plot::new();
    let cycles = course.samples.iter().any(|s| s.row.duty_cycle.is_finite());
    if cycles {
        plot.add_trace(
            curve(course, "duty cycle", BLUE, |s| s.row.duty_cycle)
                .line(Line::new().color(BLUE).width(1.5).shape(LineShape::Hv)),
        );
    }
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
                .marker(Marker::new().size(5).color(COLOURS[k % COLOURS.len()]))
                .name(mode.as_str()),
        );
    }
    let lowest = -0.15 * (modes.len() + 1) as f64;
    let (title, axis) = if cycles {
        let axis = Axis::new().title("duty cycle").range(vec![lowest, 1.05]);
        ("Duty cycle and mode of steering", axis)
    } else {
        let axis = Axis::new().range(vec![lowest, 0.05]);
        ("Mode of steering", axis.show_tick_labels(false))
    };
    plot.set_layout(layout(title, "time [s]", "").y_axis(axis));
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
    let longest = ages.iter().chain(&steps).copied().fold(1.0, f64::max);
    for (values, name, colour) in [
        (ages, "age of the measurement", BLUE),
        (steps, "from step to step", ORANGE),
    ] {
        plot.add_trace(
            Histogram::new(values)
                .name(name)
                .opacity(0.6)
                .x_bins(Bins::new(0.0, 1.01 * longest, longest / 80.0))
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
    let title = format!("Time of a step, replayed: median {median:.0} µs, 99 % {p99:.0} µs");
    plot.set_layout(layout(&title, "[µs]", "steps"));
    plot
}

//! The three-dimensional view: needle, springs, path and target over time.

use nalgebra::Vector3;
use plotly::common::{Line, Marker, MarkerSymbol, Mode};
use plotly::layout::update_menu::{ButtonBuilder, UpdateMenu, UpdateMenuDirection, UpdateMenuType};
use plotly::layout::{
    Animation, AnimationMode, AnimationOptions, AspectMode, AspectRatio, Axis, Camera,
    CameraCenter, Eye, Frame as PlotFrame, FrameSettings, LayoutScene, Margin, Slider,
    SliderCurrentValue, SliderStepBuilder, TransitionSettings,
};
use plotly::{Layout, Plot, Scatter3D, Trace, Traces};

use super::charts::{BLUE, GREEN, GREY, ORANGE, RED};
use super::course::{Course, Frame};

/// Length of the view along the needle against its width.
const TALL: f64 = 1.5;

/// Colour of the tissue's surface.
const SKIN: &str = "#b08a60";
/// Half the width of the surface that is drawn \[mm\].
const SURFACE_MM: f64 = 6.0;

/// The view with a slider and a play button.
pub(super) fn plot(course: &Course) -> Plot {
    let mut plot = Plot::new();
    let last = course.frames.len() - 1;
    let shown = &course.frames[last];
    let moving = moving(course, shown, last);
    let count = moving.len();
    plot.add_traces(moving);
    for (name, colour, target) in [
        ("target, as registered", RED, course.target),
        ("target, in truth", GREY, course.true_target),
    ] {
        if let Some(target) = target {
            let trace = points(&[target])
                .mode(Mode::Markers)
                .marker(
                    Marker::new()
                        .color(colour)
                        .size(6)
                        .symbol(MarkerSymbol::Cross),
                )
                .name(name);
            plot.add_trace(trace);
        }
    }
    plot.add_trace(
        line(&surface(course), SKIN, 3.0).name("surface of the tissue, about the entry"),
    );
    for (k, frame) in course.frames.iter().enumerate() {
        let mut traces = Traces::new();
        for trace in self::moving(course, frame, k) {
            traces.push(trace);
        }
        plot.add_frame(
            PlotFrame::new()
                .name(k.to_string())
                .data(traces)
                .traces((0..count).collect()),
        );
    }
    plot.set_layout(layout(course));
    plot
}

/// What changes from frame to frame, always the same traces in the same order.
fn moving(course: &Course, frame: &Frame, index: usize) -> Vec<Box<dyn Trace>> {
    let trail: Vec<Vector3<f64>> = course
        .frames
        .iter()
        .take(index + 1)
        .filter_map(|f| f.sensed_tip)
        .collect();
    vec![
        line(&frame.model, ORANGE, 5.0).name("needle, model"),
        line(&frame.truth, BLUE, 3.0).name("needle, truth"),
        line(&springs(frame), GREY, 2.0).name("springs (tissue at rest to needle)"),
        line(&trail, GREEN, 2.0).name("measured tip, its path"),
        points(&[frame.tip])
            .mode(Mode::Markers)
            .marker(Marker::new().color(ORANGE).size(4))
            .name("tip"),
    ]
}

/// A square in the tissue's surface, and a cross at the entry.
fn surface(course: &Course) -> Vec<Vector3<f64>> {
    let turned = course.config.world_from_entry().rotation;
    let at = |x: f64, y: f64| turned * Vector3::new(x, y, 0.0) * SURFACE_MM;
    let gap = Vector3::from_element(f64::NAN);
    let corners = [
        (1.0, 1.0),
        (1.0, -1.0),
        (-1.0, -1.0),
        (-1.0, 1.0),
        (1.0, 1.0),
    ];
    let mut lines: Vec<_> = corners.into_iter().map(|(x, y)| at(x, y)).collect();
    lines.extend([
        gap,
        at(0.2, 0.0),
        at(-0.2, 0.0),
        gap,
        at(0.0, 0.2),
        at(0.0, -0.2),
    ]);
    lines
}

/// One broken line through all springs.
fn springs(frame: &Frame) -> Vec<Vector3<f64>> {
    let gap = Vector3::from_element(f64::NAN);
    frame
        .springs
        .iter()
        .flat_map(|[point, rest]| [*point, *rest, gap])
        .collect()
}

type Points = Box<Scatter3D<f64, f64, f64>>;

fn points(points: &[Vector3<f64>]) -> Points {
    // Hundredths of a millimetre are finer than a pixel.
    let column = |k: usize| points.iter().map(|p| (p[k] * 1e3).round() * 1e-3).collect();
    Scatter3D::new(column(0), column(1), column(2))
}

fn line(through: &[Vector3<f64>], colour: &'static str, width: f64) -> Points {
    points(through)
        .mode(Mode::Lines)
        .line(Line::new().color(colour).width(width))
}

fn layout(course: &Course) -> Layout {
    let shapes = || {
        course.frames.iter().flat_map(|f| {
            let springs = f.springs.iter().flatten();
            f.model.iter().chain(&f.truth).chain(springs)
        })
    };
    let ends = || shapes().chain(&course.target).chain(&course.true_target);
    let extent = |k: usize| {
        ends()
            .filter(|p| p.iter().all(|x| x.is_finite()))
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| {
                (low.min(p[k]), high.max(p[k]))
            })
    };
    let (x, y, z) = (extent(0), extent(1), extent(2));
    // The same enlargement in both directions across the needle.
    let half = 0.55 * (x.1 - x.0).max(y.1 - y.0).max(2.0);
    let about = |(low, high): (f64, f64)| {
        let middle = f64::midpoint(low, high);
        vec![middle - half, middle + half]
    };
    let axis = |title: &str, range: Vec<f64>| Axis::new().title(title.to_owned()).range(range);
    let scene = LayoutScene::new()
        .x_axis(axis("x [mm]", about(x)))
        .y_axis(axis("y [mm]", about(y)))
        .z_axis(axis("z [mm]", vec![z.0 - 3.0, z.1 + 3.0]))
        .aspect_mode(AspectMode::Manual)
        .aspect_ratio(AspectRatio::new().x(1.0).y(1.0).z(TALL))
        .camera(
            Camera::new()
                .eye(Eye::from((1.7, 1.36, 0.4)))
                .center(CameraCenter::from((0.0, 0.0, -0.1))),
        );
    Layout::new()
        .scene(scene)
        .margin(Margin::new().left(0).right(0).top(30).bottom(95))
        .sliders(vec![slider(course)])
        .update_menus(vec![buttons()])
}

fn at_once(duration: usize) -> AnimationOptions {
    AnimationOptions::new()
        .mode(AnimationMode::Immediate)
        .frame(FrameSettings::new().duration(duration).redraw(true))
        .transition(TransitionSettings::new().duration(0))
        .fromcurrent(true)
}

fn slider(course: &Course) -> Slider {
    let steps = course
        .frames
        .iter()
        .enumerate()
        .filter_map(|(k, frame)| {
            SliderStepBuilder::new()
                .label(format!("{:.1}", frame.time))
                .animation(Animation::frames(vec![k.to_string()]).options(at_once(0)))
                .build()
                .ok()
        })
        .collect();
    Slider::new()
        .active(i32::try_from(course.frames.len().saturating_sub(1)).unwrap_or(0))
        .current_value(SliderCurrentValue::new().prefix("time ").suffix(" s"))
        .length(0.85)
        .x(0.12)
        .y(0.0)
        .steps(steps)
}

fn buttons() -> UpdateMenu {
    let button = |label: &str, animation: Animation| {
        ButtonBuilder::new()
            .label(label)
            .animation(animation)
            .build()
            .ok()
    };
    let play = Animation::all_frames().options(at_once(80));
    UpdateMenu::new()
        .ty(UpdateMenuType::Buttons)
        .direction(UpdateMenuDirection::Left)
        .show_active(false)
        .x(0.1)
        .y(0.0)
        .buttons(
            [button("play", play), button("pause", Animation::pause())]
                .into_iter()
                .flatten()
                .collect(),
        )
}

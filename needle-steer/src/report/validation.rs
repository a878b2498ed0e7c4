//! The page of `validate`: predicted against measured changes.

use plotly::common::{Line, Marker, Mode};
use plotly::{Plot, Scatter};

use super::Page;
use super::charts::{BLUE, GREY, layout};
use crate::identify::Validation;

/// One page of a validation.
pub fn validation(found: &Validation) -> Page {
    let mut page = Page::new("Predictions of recorded steps");
    let (axis, tip) = (&found.axis, &found.tip);
    let row = |name: &str, value: String| (name.to_owned(), value);
    page.table(&[
        row("changes (steps times two axes)", found.changes.to_string()),
        row("R2 of the axis", format!("{:.3}", axis.r2)),
        row("measured over predicted", format!("{:.3}", axis.slope)),
        row("axis, measured", format!("{:.1} mrad", axis.rms_mrad)),
        row(
            "axis, unexplained",
            format!("{:.1} mrad", axis.unexplained_mrad),
        ),
        row("tip, the model's error", format!("{:.3} mm", tip.rms_mm)),
        row(
            "tip, stays as it was",
            format!("{:.3} mm", tip.persistence_mm),
        ),
        row("tip, straight line", format!("{:.3} mm", tip.straight_mm)),
        row("tip, Broyden", format!("{:.3} mm", tip.broyden_mm)),
    ]);
    page.plot(
        "axis",
        450,
        &chart("Change of the axis", "mrad", &found.curves.axis_mrad),
    );
    page.plot(
        "tip",
        450,
        &chart("Change of the tip across", "mm", &found.curves.tip_mm),
    );
    page.heading("Files");
    let rows: Vec<Vec<String>> = found
        .files
        .iter()
        .map(|file| {
            vec![
                file.file.clone(),
                file.changes.to_string(),
                format!("{:.3}", file.axis.r2),
                format!("{:.3}", file.axis.slope),
                format!("{:.3}", file.tip.rms_mm),
                format!("{:.3}", file.tip.persistence_mm),
                format!("{:.3}", file.tip.broyden_mm),
            ]
        })
        .collect();
    let columns = [
        "file",
        "changes",
        "R2",
        "slope",
        "tip mm",
        "stays mm",
        "Broyden mm",
    ];
    page.grid(&columns, &rows);
    for part in &found.left_out {
        page.text(&format!(
            "Left out: {}, {} rows from row {}: {}.",
            part.file, part.rows, part.from_row, part.reason
        ));
    }
    page
}

fn chart(title: &str, unit: &str, pairs: &[(f64, f64)]) -> Plot {
    let (said, seen): (Vec<f64>, Vec<f64>) = pairs.iter().copied().unzip();
    let most = seen
        .iter()
        .chain(&said)
        .fold(0.0_f64, |most, v| most.max(v.abs()));
    let mut plot = Plot::new();
    plot.add_trace(
        Scatter::new(vec![-most, most], vec![-most, most])
            .mode(Mode::Lines)
            .line(Line::new().color(GREY).width(1.0))
            .name("equal"),
    );
    plot.add_trace(
        Scatter::new(said, seen)
            .mode(Mode::Markers)
            .marker(Marker::new().color(BLUE).size(5))
            .name("steps"),
    );
    let axis = |what: &str| format!("{what} [{unit}]");
    plot.set_layout(layout(title, &axis("predicted"), &axis("measured")));
    plot
}

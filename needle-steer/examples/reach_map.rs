//! The reachable region of each law over target offsets up to 25 mm, drawn as SVG.
//!
//! `cargo run --release -p needle-steer --example reach_map [-- FILE [FIRST_SEED SEEDS]]`
//!
//! Each sector is one target 80 mm ahead; its colour is the median true error over the seeds.
#![expect(clippy::print_stdout, reason = "an example reports on stdout")]

use std::f64::consts::TAU;
use std::fmt::Write;
use std::process::ExitCode;

use hybrid_control::LAW_NAMES;
use needle_steer::config::{self, Config};
use needle_steer::experiments::in_parallel;
use needle_steer::run::simulate;
use needle_steer::statistics::median;

/// Offsets of the targets \[mm\].
const OFFSETS: [f64; 6] = [0.0, 5.0, 10.0, 15.0, 20.0, 25.0];
/// Directions of the offsets.
const DIRECTIONS: usize = 8;
/// Upper bounds of the classes \[mm\], their colours and names.
const CLASSES: [(f64, &str, &str); 5] = [
    (0.1, "#1a9850", "up to 0.1 mm"),
    (0.5, "#91cf60", "0.1 to 0.5 mm"),
    (1.0, "#d9ef8b", "0.5 to 1 mm"),
    (3.0, "#fee08b", "1 to 3 mm"),
    (f64::INFINITY, "#d73027", "more than 3 mm"),
];
/// Radius of one disc and spacing of the discs in the drawing \[px\].
const RADIUS: f64 = 95.0;
const SPACING: f64 = 225.0;
/// Discs in a row.
const COLUMNS: usize = 4;

struct Target {
    law: &'static str,
    ring: usize,
    direction: usize,
    config: Config,
}

fn targets(first_seed: u64, seeds: u64) -> Result<Vec<Target>, config::ConfigError> {
    let mut targets = Vec::new();
    for law in LAW_NAMES {
        for (ring, offset) in OFFSETS.into_iter().enumerate() {
            for direction in 0..if ring == 0 { 1 } else { DIRECTIONS } {
                let angle = 360.0 / DIRECTIONS as f64 * direction as f64;
                for seed in first_seed..first_seed + seeds {
                    let config = config::load(
                        None,
                        &[
                            format!("run.law={law}"),
                            format!("run.seed={seed}"),
                            "run.sensor=shape".to_owned(),
                            "run.check_reach=false".to_owned(),
                            "target.kind=shifted".to_owned(),
                            format!("target.offset_mm={offset:?}"),
                            format!("target.angle_deg={angle:?}"),
                        ],
                    )?;
                    targets.push(Target {
                        law,
                        ring,
                        direction,
                        config,
                    });
                }
            }
        }
    }
    Ok(targets)
}

/// One ring's sector as an SVG path; the bevel direction points down.
fn sector(centre: (f64, f64), ring: usize, direction: usize) -> String {
    let unit = RADIUS / (OFFSETS.len() as f64 - 0.5);
    if ring == 0 {
        return format!(
            "<circle cx=\"{:.1}\" cy=\"{:.1}\" r=\"{:.1}\"",
            centre.0,
            centre.1,
            0.5 * unit
        );
    }
    let (inner, outer) = ((ring as f64 - 0.5) * unit, (ring as f64 + 0.5) * unit);
    let at = |radius: f64, side: f64| {
        let angle = TAU * (direction as f64 + side) / DIRECTIONS as f64;
        (
            centre.0 + radius * angle.sin(),
            centre.1 + radius * angle.cos(),
        )
    };
    let (a, b, c, d) = (
        at(inner, -0.5),
        at(outer, -0.5),
        at(outer, 0.5),
        at(inner, 0.5),
    );
    format!(
        "<path d=\"M{:.1} {:.1}L{:.1} {:.1}A{outer:.1} {outer:.1} 0 0 0 {:.1} {:.1}L{:.1} {:.1}A{inner:.1} {inner:.1} 0 0 1 {:.1} {:.1}Z\"",
        a.0, a.1, b.0, b.1, c.0, c.1, d.0, d.1, a.0, a.1
    )
}

fn draw(errors: &[(&Target, f64)], seeds: u64) -> String {
    let rows = LAW_NAMES.len().div_ceil(COLUMNS);
    let (width, height) = (
        SPACING * COLUMNS as f64,
        (SPACING + 25.0) * rows as f64 + 60.0,
    );
    let mut svg = format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"{width}\" height=\"{height}\" font-family=\"sans-serif\" font-size=\"13\">\n<rect width=\"100%\" height=\"100%\" fill=\"white\"/>\n"
    );
    for (number, law) in LAW_NAMES.into_iter().enumerate() {
        let centre = (
            SPACING * ((number % COLUMNS) as f64 + 0.5),
            (SPACING + 25.0) * (number / COLUMNS) as f64 + 0.5 * SPACING + 25.0,
        );
        let _ = writeln!(
            svg,
            "<text x=\"{:.0}\" y=\"{:.0}\" text-anchor=\"middle\" font-weight=\"bold\">{law}</text>",
            centre.0,
            centre.1 - RADIUS - 9.0
        );
        for ring in 0..OFFSETS.len() {
            for direction in 0..if ring == 0 { 1 } else { DIRECTIONS } {
                let cell: Vec<f64> = errors
                    .iter()
                    .filter(|(t, _)| (t.law, t.ring, t.direction) == (law, ring, direction))
                    .map(|(_, error)| *error)
                    .collect();
                let error = median(&cell);
                let colour = CLASSES
                    .iter()
                    .find(|(bound, ..)| error <= *bound)
                    .map_or("#888888", |class| class.1);
                let _ = writeln!(
                    svg,
                    "{} fill=\"{colour}\" stroke=\"white\"><title>{law}, {} mm at {} deg: {error:.2} mm</title></{}>",
                    sector(centre, ring, direction),
                    OFFSETS[ring],
                    360 / DIRECTIONS * direction,
                    if ring == 0 { "circle" } else { "path" },
                );
            }
        }
    }
    for (i, (_, colour, name)) in CLASSES.iter().enumerate() {
        let x = 15.0 + 175.0 * i as f64;
        let _ = writeln!(
            svg,
            "<rect x=\"{x}\" y=\"{:.0}\" width=\"14\" height=\"14\" fill=\"{colour}\"/><text x=\"{}\" y=\"{:.0}\">{name}</text>",
            height - 52.0,
            x + 20.0,
            height - 40.0
        );
    }
    let _ = writeln!(
        svg,
        "<text x=\"15\" y=\"{:.0}\">Targets 80 mm ahead, aside by 0 to 25 mm (rings of 5 mm), bevel direction down; median true error of {seeds} seeds.</text>\n</svg>",
        height - 15.0
    );
    svg
}

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let file = arguments.next().unwrap_or_else(|| "reach.svg".to_owned());
    let mut number = |default| {
        arguments
            .next()
            .and_then(|a| a.parse().ok())
            .unwrap_or(default)
    };
    let (first_seed, seeds) = (number(101), number(2));
    let targets = match targets(first_seed, seeds) {
        Ok(targets) => targets,
        Err(error) => {
            println!("{error}");
            return ExitCode::FAILURE;
        }
    };
    let jobs = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let errors: Vec<(&Target, f64)> = targets
        .iter()
        .zip(in_parallel(&targets, jobs, |target| {
            // A run that could not be carried out counts as missed.
            simulate(&target.config)
                .ok()
                .and_then(|summary| summary.true_error_mm)
                .unwrap_or(f64::INFINITY)
        }))
        .collect();
    for law in LAW_NAMES {
        let print: Vec<String> = (0..OFFSETS.len())
            .map(|ring| {
                let cell: Vec<f64> = errors
                    .iter()
                    .filter(|(t, _)| t.law == law && t.ring == ring)
                    .map(|(_, e)| *e)
                    .collect();
                let hit = cell.iter().filter(|e| **e <= 1.0).count();
                format!("{:.3} ({}/{})", median(&cell), hit, cell.len())
            })
            .collect();
        println!("| `{law}` | {} |", print.join(" | "));
    }
    match std::fs::write(&file, draw(&errors, seeds)) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            println!("{file}: {error}");
            ExitCode::FAILURE
        }
    }
}

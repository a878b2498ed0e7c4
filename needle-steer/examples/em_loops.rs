//! Loops closed on an electromagnetic tip in the phantom.
//!
//! `cargo run --release -p needle-steer --example em_loops -- DEVICE FIRST LAST [KEY=VALUE ...]`
//! inserts with `guide` (through a guide, preset `gel-guide`), `hand` (the same, pushed by hand in steps of
//! 5 mm) or `stage` (a stage with a rotary axis, preset `paper`), seeds FIRST to LAST, in an even field and in one that is distorted as
//! measured, and says how it ended: all passes count, stops are named by their cause.

use std::collections::BTreeMap;
use std::error::Error;
use std::io::Write as _;
use std::path::Path;

use needle_steer::config::{self, Config};
use needle_steer::experiments::in_parallel;
use needle_steer::identify::distortion::{Lie, map_of};
use needle_steer::outcome::{Ended, Summary};
use needle_steer::rig;
use needle_steer::run::simulate;
use needle_steer::samples;
use needle_steer::statistics::median;

const EVEN: [&str; 3] = [
    "phantom.em.distortion_mm=0.0",
    "phantom.em.axis_distortion_mrad=0.0",
    "run.sensor=em",
];

/// A thick needle through a guide in a stiff gel, as docs/REAL_NEEDLES.md has it.
const THROUGH_A_GUIDE: [&str; 12] = [
    "run.phantom=gel-guide",
    "needle.support=\"guide\"",
    "needle.guide_gap_mm=25.0",
    "needle.length_mm=200.0",
    "needle.outer_diameter_mm=1.27",
    "needle.inner_diameter_mm=0.84",
    "estimator.stiffness_n_m2=2.1e5",
    "estimator.stiffness_sigma=0.1",
    "estimator.cut_angle_deg=0.36",
    "estimator.cut_angle_sigma=0.1",
    "estimator.tip_compliance_deg_n=0.1",
    "supervisor.tissue_stretch_mm=5.5",
];

fn device(name: &str, more: &[String]) -> Result<Config, Box<dyn Error>> {
    let (urdf, settings): (_, &[&str]) = match name {
        "guide" | "hand" => ("guide", &THROUGH_A_GUIDE),
        "stage" => ("stage", &[]),
        other => return Err(format!("{other}: expected guide, hand or stage").into()),
    };
    let urdf = Path::new(env!("CARGO_MANIFEST_DIR")).join(format!("../robots/urdf/{urdf}.urdf"));
    let mut sets = vec![
        format!("arm.urdf={urdf:?}"),
        "arm.tip_link=needle_base".to_owned(),
        "arm.mechanism=true".to_owned(),
        "run.sensor=em".to_owned(),
    ];
    sets.extend(settings.iter().map(ToString::to_string));
    if name == "hand" {
        sets.push("insertion.by=hand".to_owned());
    }
    sets.extend(more.iter().cloned());
    Ok(rig::placed(&config::load(None, &sets)?)?)
}

fn main() -> Result<(), Box<dyn Error>> {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [name, first, last, more @ ..] = args.as_slice() else {
        return Err("expected DEVICE FIRST LAST [KEY=VALUE ...]".into());
    };
    let (first, last): (u64, u64) = (first.parse()?, last.parse()?);
    let folder = std::env::temp_dir().join(format!("em-loops-{}", std::process::id()));
    std::fs::create_dir_all(&folder)?;
    for (field, settings, map) in [
        ("even", &EVEN[..], None),
        ("distorted", &EVEN[2..], None),
        ("distorted and mapped", &EVEN[2..], Some(folder.as_path())),
    ] {
        let mut sets: Vec<String> = settings.iter().map(ToString::to_string).collect();
        sets.extend(more.iter().cloned());
        let config = device(name, &sets)?;
        let runs = run(&config, first, last, map)?;
        report(&format!("{name}, {field} field"), &runs)?;
    }
    std::fs::remove_dir_all(&folder)?;
    Ok(())
}

/// One insertion; with a folder, in a field that was mapped in air before.
fn insert(config: &Config, maps: Option<&Path>) -> Result<Summary, Box<dyn Error>> {
    let mut config = config.clone();
    if let Some(folder) = maps {
        let name = |end: &str| folder.join(format!("{}.{end}", config.run.seed));
        samples::in_air(&config, &name("csv"))?;
        let map = map_of(&name("csv"), Lie::Exact)?;
        std::fs::write(name("toml"), toml::to_string(&map)?)?;
        config.em.map = name("toml").display().to_string();
    }
    Ok(simulate(&config)?)
}

/// Runs of the seeds, in order, on all cores.
fn run(
    config: &Config,
    first: u64,
    last: u64,
    maps: Option<&Path>,
) -> Result<Vec<Summary>, Box<dyn Error>> {
    let seeds: Vec<u64> = (first..=last).collect();
    let cores = std::thread::available_parallelism()?.get();
    let runs = in_parallel(&seeds, cores, |&seed| {
        let mut config = config.clone();
        config.run.seed = seed;
        insert(&config, maps).map_err(|error| error.to_string())
    });
    Ok(runs.into_iter().collect::<Result<_, String>>()?)
}

fn report(title: &str, runs: &[Summary]) -> Result<(), Box<dyn Error>> {
    let mut out = std::io::stdout().lock();
    let mut ends: BTreeMap<String, usize> = BTreeMap::new();
    let (mut less_bias, mut truly) = (Vec::new(), Vec::new());
    for run in runs {
        let passed = run.ended == Ended::TargetPassed;
        let mm = |value: Option<f64>| value.map_or("-".to_owned(), |v| format!("{v:.3}"));
        writeln!(
            out,
            "  {}: {} mm less bias, {} mm in truth, stretch {:.1} mm{}",
            run.seed,
            mm(run.true_error_less_bias_mm),
            mm(run.true_error_mm),
            run.max_stretch_mm,
            if passed {
                String::new()
            } else {
                format!("; {}", run.ended)
            }
        )?;
        if passed {
            less_bias.extend(run.true_error_less_bias_mm);
            truly.extend(run.true_error_mm);
        } else {
            let cause = run
                .cause
                .map_or("?".to_owned(), |cause| format!("{cause:?}"));
            *ends.entry(cause).or_default() += 1;
        }
    }
    writeln!(
        out,
        "{title}: {} of {} passed; median {:.2} mm less bias (worst {:.2}), {:.2} mm in truth (worst {:.2}); others {ends:?}",
        less_bias.len(),
        runs.len(),
        median(&less_bias),
        less_bias.iter().copied().fold(0.0, f64::max),
        median(&truly),
        truly.iter().copied().fold(0.0, f64::max),
    )?;
    Ok(())
}

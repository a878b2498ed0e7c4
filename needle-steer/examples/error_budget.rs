//! What each error of the cameras' calibration costs: the bias of the tracked tip against the
//! truth in the stereo frame, and the true lateral error, in Markdown.
//!
//! `cargo run --release -p needle-steer --example error_budget -- [FIRST_SEED RUNS]`
#![expect(clippy::print_stdout, reason = "an example reports on stdout")]

use std::path::Path;
use std::process::ExitCode;

use nalgebra::Vector3;
use needle_steer::bias::TipBias;
use needle_steer::config::{Config, ConfigError, parse};
use needle_steer::controls::Controls;
use needle_steer::experiments::in_parallel;
use needle_steer::rig::Rig;
use needle_steer::run::{RunError, run};
use needle_steer::statistics::{median, percentile};

/// Length of the run's end that the bias is averaged over \[s\].
const WINDOW: f64 = 2.0;

/// Errors of what the controller is told, by their key under `cameras.simulated`.
const CALIBRATION: [&str; 2] = ["calibration.corner_sigma_px", "calibration.drift_mrad"];
const CONTAINER: [&str; 2] = ["calibration.container_mm", "calibration.container_deg"];
const INDEX: [&str; 1] = ["calibration.gel_index"];
const REGISTRATION: [&str; 2] = [
    "calibration.registration_mm",
    "calibration.registration_deg",
];

/// Rows of the budget: what is left in.
const ROWS: [(&str, &[&[&str]]); 6] = [
    ("tracking alone", &[]),
    ("and calibration of the cameras", &[&CALIBRATION]),
    ("and place of the container", &[&CONTAINER]),
    ("and the gel's refractive index", &[&INDEX]),
    ("and registration to the arm", &[&REGISTRATION]),
    (
        "everything",
        &[&CALIBRATION, &CONTAINER, &INDEX, &REGISTRATION],
    ),
];

/// Why the budget could not be made.
#[derive(Debug, thiserror::Error)]
enum Failure {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Run(#[from] RunError),
}

/// Bias in the stereo frame and lateral error of one run \[mm\].
type Figures = (Option<Vector3<f64>>, Option<f64>);

fn measure(config: &Config) -> Result<Figures, Failure> {
    let mut rig = Rig::new(config).map_err(RunError::from)?;
    let truth = rig.world.as_ref().map(|world| world.stereo_from_world());
    let mut bias = truth.map(|truth| TipBias::new(truth, WINDOW));
    let controls = Controls::default();
    let summary = match &mut bias {
        Some(bias) => run(config, &mut rig, bias, &controls)?,
        None => run(
            config,
            &mut rig,
            &mut needle_steer::run::Unobserved,
            &controls,
        )?,
    };
    let mean = bias.and_then(|bias| bias.mean());
    Ok((mean.map(|mean| mean * 1e3), summary.true_error_mm))
}

fn row(name: &str, kept: &[&[&str]], first_seed: u64, runs: u64) -> Result<String, Failure> {
    let mut overrides = vec!["run.sensor=\"images\"".to_owned()];
    for key in CALIBRATION
        .iter()
        .chain(&CONTAINER)
        .chain(&INDEX)
        .chain(&REGISTRATION)
    {
        if !kept.iter().any(|keys| keys.contains(key)) {
            overrides.push(format!("cameras.simulated.{key}=0.0"));
        }
    }
    let config = parse("", Path::new(""), &overrides)?;
    let configs: Vec<Config> = (first_seed..first_seed + runs)
        .map(|seed| {
            let mut config = config.clone();
            config.run.seed = seed;
            config
        })
        .collect();
    let jobs = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let figures = in_parallel(&configs, jobs, measure)
        .into_iter()
        .collect::<Result<Vec<_>, _>>()?;
    let biases: Vec<Vector3<f64>> = figures.iter().filter_map(|f| f.0).collect();
    let errors: Vec<f64> = figures.iter().filter_map(|f| f.1).collect();
    let count = biases.len() as f64;
    let mean = biases.iter().sum::<Vector3<f64>>() / count;
    let variance = biases
        .iter()
        .map(|b| (b - mean).component_mul(&(b - mean)))
        .sum::<Vector3<f64>>()
        / (count - 1.0);
    let axis = |k: usize| format!("{:+.3} ± {:.3}", mean[k], variance[k].sqrt());
    Ok(format!(
        "| {name} | {} | {} | {} | {:.3} | {:.3} |",
        axis(0),
        axis(1),
        axis(2),
        median(&errors),
        percentile(&errors, 0.95)
    ))
}

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let mut number = |default| arguments.next().map_or(Some(default), |a| a.parse().ok());
    let (Some(first_seed), Some(runs)) = (number(101), number(30)) else {
        println!("first seed and runs: expected whole numbers");
        return ExitCode::from(2);
    };
    println!("| errors | bias x mm | y | z (mean ± 1 sigma) | error median mm | 95 % |");
    println!("|---|---|---|---|---|---|");
    for (name, kept) in ROWS {
        match row(name, kept, first_seed, runs) {
            Ok(row) => println!("{row}"),
            Err(error) => {
                println!("{error}");
                return ExitCode::FAILURE;
            }
        }
    }
    ExitCode::SUCCESS
}

//! Tables of laws and of features on the same seeds, with paired intervals, in Markdown; the
//! fast sensor closes the loop unless `run.sensor=images` is given.
//!
//! `cargo run --release -p needle-steer --example comparison -- laws|ablation [FIRST_SEED RUNS [key=value ...]]`
#![expect(clippy::print_stdout, reason = "an example reports on stdout")]

use std::process::ExitCode;

use needle_steer::comparison::{Comparison, ablations, laws, markdown};
use needle_steer::config::ConfigError;
use needle_steer::experiments::EXPERIMENTS;
use needle_steer::run::{RunError, simulate};

/// Why a table could not be made.
#[derive(Debug, thiserror::Error)]
enum Failure {
    #[error(transparent)]
    Config(#[from] ConfigError),
    #[error(transparent)]
    Run(#[from] RunError),
}

fn main() -> ExitCode {
    let mut arguments = std::env::args().skip(1);
    let variants = match arguments.next().as_deref() {
        Some("laws") => laws(),
        Some("ablation") => ablations(),
        _ => {
            println!("expected: laws or ablation, then first seed, runs, key=value ...");
            return ExitCode::from(2);
        }
    };
    let mut number = |default| arguments.next().map_or(Some(default), |a| a.parse().ok());
    let (Some(first_seed), Some(runs)) = (number(101), number(50)) else {
        println!("first seed and runs: expected whole numbers");
        return ExitCode::from(2);
    };
    let mut common = vec!["run.sensor=shape".to_owned()];
    common.extend(arguments);
    let comparison = Comparison {
        variants,
        experiments: vec![EXPERIMENTS[1], EXPERIMENTS[3]],
        first_seed,
        runs,
        common,
    };
    let jobs = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    match comparison.carry_out(jobs, |config| simulate(config).map_err(Failure::from)) {
        Ok(cells) => {
            println!("{}", markdown(&cells));
            ExitCode::SUCCESS
        }
        Err(error) => {
            println!("{error}");
            ExitCode::FAILURE
        }
    }
}

//! Insertions with each arm of a folder of URDFs beside the Viper's on the same seeds, aligned and
//! 1 cm aside, seen by the fast sensor. Prints a line a run, then a table: what an arm's median and
//! 95th percentile lie above the Viper's, and the median of the differences seed by seed.
//!
//! `cargo run --release -p needle-steer --example arms -- FOLDER [FIRST COUNT JOBS]`
#![expect(clippy::print_stdout, reason = "an example reports on stdout")]

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use needle_steer::config::{self, Config};
use needle_steer::experiments::in_parallel;
use needle_steer::outcome::Ended;
use needle_steer::rig;
use needle_steer::run::simulate;
use needle_steer::statistics::{median, paired_difference, percentile};

/// Most by which an arm may lie above the Viper, median and 95th percentile \[mm\].
const WORSE_MM: [f64; 2] = [0.02, 0.1];

/// An arm that can carry out insertions of one kind.
struct Arm {
    name: String,
    kind: &'static str,
    config: Config,
}

fn insertion(urdf: Option<&Path>, kind: &str) -> Result<Config, String> {
    let mut overrides = vec!["run.sensor=shape".to_owned(), format!("target.kind={kind}")];
    if let Some(file) = urdf {
        overrides.push(format!("arm.urdf={:?}", file.to_string_lossy()));
        overrides.push("arm.tip_link=tool0".to_owned());
    }
    config::load(None, &overrides).map_err(|e| e.to_string())
}

/// The Viper and the arms of the folder, where a target aside can be reached as well; and those
/// that are refused, with the reason.
fn arms(files: &[PathBuf]) -> Result<(Vec<Arm>, Vec<String>), String> {
    let (mut arms, mut refused) = (Vec::new(), Vec::new());
    let all = std::iter::once(None).chain(files.iter().map(|file| Some(file.as_path())));
    for urdf in all {
        let name = urdf.map_or("viper".into(), |file| {
            file.file_stem().unwrap_or_default().to_string_lossy()
        });
        match rig::placed(&insertion(urdf, "shifted")?) {
            Err(reason) => refused.push(format!("{name}: {reason}")),
            Ok(there) => {
                for kind in ["aligned", "shifted"] {
                    let mut config = insertion(urdf, kind)?;
                    config.arm = there.arm.clone();
                    let name = name.to_string();
                    arms.push(Arm { name, kind, config });
                }
            }
        }
    }
    Ok((arms, refused))
}

/// The true error of one insertion \[mm\]; nothing if it did not pass the target.
fn error(arm: &Arm, seed: u64) -> Option<f64> {
    let mut config = arm.config.clone();
    config.run.seed = seed;
    let outcome = simulate(&config);
    let (ended, error) = match &outcome {
        Ok(summary) => (summary.ended.to_string(), summary.true_error_mm),
        Err(refused) => (refused.to_string(), None),
    };
    let mm = error.unwrap_or(f64::NAN);
    println!("{},{},{seed},{mm:.4},{ended}", arm.name, arm.kind);
    let passed = outcome.is_ok_and(|summary| summary.ended == Ended::TargetPassed);
    error.filter(|_| passed)
}

fn main() -> Result<ExitCode, String> {
    let mut arguments = std::env::args().skip(1);
    let folder = arguments.next().ok_or("which folder of URDFs?")?;
    let mut numbers = arguments.filter_map(|a| a.parse::<u32>().ok());
    let first = numbers.next().unwrap_or(200);
    let count = numbers.next().unwrap_or(20);
    let cores = std::thread::available_parallelism().map_or(1, std::num::NonZero::get);
    let jobs = numbers.next().map_or(cores, |jobs| jobs as usize);
    let entries = std::fs::read_dir(&folder).map_err(|e| format!("{folder}: {e}"))?;
    let mut files: Vec<PathBuf> = entries.flatten().map(|entry| entry.path()).collect();
    files.sort();

    let (arms, refused) = arms(&files)?;
    let seeds: Vec<u64> = (first..first + count).map(u64::from).collect();
    let runs: Vec<(&Arm, u64)> = arms
        .iter()
        .flat_map(|arm| seeds.iter().map(move |seed| (arm, *seed)))
        .collect();
    println!("arm,target,seed,error_mm,ended");
    let errors = in_parallel(&runs, jobs, |(arm, seed)| error(arm, *seed));
    let of = |index: usize| -> Vec<f64> {
        let errors = &errors[index * seeds.len()..(index + 1) * seeds.len()];
        errors.iter().map(|e| e.unwrap_or(f64::NAN)).collect()
    };

    println!(
        "| arm | target | passed | median (mm) | 95 % (mm) | above the Viper's median | above its 95 % | seed by seed |"
    );
    println!("|---|---|---|---|---|---|---|---|");
    let mut worse = 0;
    for (index, arm) in arms.iter().enumerate() {
        let same = |other: &Arm| other.name == "viper" && other.kind == arm.kind;
        let viper = of(arms.iter().position(same).unwrap_or_default());
        let mine = of(index);
        let figures = |all: &[f64]| {
            let passed: Vec<f64> = all.iter().copied().filter(|e| e.is_finite()).collect();
            (passed.len(), median(&passed), percentile(&passed, 0.95))
        };
        let (passed, middle, most) = figures(&mine);
        let (_, viper_middle, viper_most) = figures(&viper);
        let above = [middle - viper_middle, most - viper_most];
        let bad = passed < seeds.len() || above.iter().zip(WORSE_MM).any(|(a, w)| *a > w);
        worse += usize::from(bad);
        let paired = paired_difference(&mine, &viper);
        println!(
            "| {} | {} | {passed} of {count} | {middle:.3} | {most:.3} | {:+.3} | {:+.3} | {:+.3} ({:+.3} to {:+.3}) |{}",
            arm.name,
            arm.kind,
            above[0],
            above[1],
            paired.median,
            paired.low,
            paired.high,
            if bad { " worse" } else { "" }
        );
    }
    for reason in &refused {
        println!("refused: {reason}");
    }
    println!(
        "{worse} of {} worse than the Viper, or not passed",
        arms.len()
    );
    Ok(if worse == 0 {
        ExitCode::SUCCESS
    } else {
        ExitCode::FAILURE
    })
}

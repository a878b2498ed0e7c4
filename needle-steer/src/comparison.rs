//! Laws and features side by side on the same seeds: the tables of docs/RESULTS.md.
//!
//! A [`Variant`] is a name and overrides of the configuration as `--set` takes them, so each cell
//! of a table can be repeated by hand with `needle-steer run`.

use std::fmt::Write;

use serde::Serialize;

use crate::config::{self, Config, ConfigError};
use crate::experiments::{Experiment, Plan, RunFigures, in_parallel};
use crate::outcome::Summary;
use crate::statistics::{PairedDifference, median, paired_difference, percentile};

/// One row of a table.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Variant {
    /// What the row is called.
    pub name: String,
    /// Changes to the configuration: `key=value`.
    pub overrides: Vec<String>,
}

impl Variant {
    /// A variant of that name with those overrides.
    pub fn new(name: &str, overrides: &[&str]) -> Self {
        Self {
            name: name.to_owned(),
            overrides: overrides.iter().map(|&o| o.to_owned()).collect(),
        }
    }
}

/// Law `hybrid`, first, and every other law.
pub fn laws() -> Vec<Variant> {
    [
        "hybrid",
        "paper",
        "paper-verbatim",
        "tip-only",
        "base-only",
        "broyden",
        "none",
    ]
    .into_iter()
    .map(|law| Variant::new(law, &[&format!("run.law={law}")]))
    .collect()
}

/// Law `hybrid`, first, and the same with one feature after the other taken away.
pub fn ablations() -> Vec<Variant> {
    let mut rows = vec![Variant::new("hybrid", &[])];
    rows.extend(
        [
            ("pivot of the base", &["law.hybrid.pivot=false"] as &[&str]),
            ("shift of the base", &["law.hybrid.shift=false"]),
            (
                "both: bevel only",
                &["law.hybrid.pivot=false", "law.hybrid.shift=false"],
            ),
            (
                "level that spares the entry",
                &["law.hybrid.spare_entry=false"],
            ),
            ("relief of the tissue", &["law.hybrid.unload=false"]),
            ("slowing down", &["law.hybrid.slow_down=false"]),
            ("bevel in reserve", &["law.hybrid.bevel_reserve=0"]),
            ("partial curvature by debt", &["law.hybrid.modulate=false"]),
            (
                "fading of base authority",
                &[
                    "law.hybrid.pivot_fade_mm_deg=0.001",
                    "law.hybrid.shift_fade=0.001",
                ],
            ),
            (
                "regaining a drawn-back tip",
                &["law.hybrid.regain_gain_per_s=0"],
            ),
            (
                "estimated stiffness",
                &["estimator.stiffness_period_s=1000000"],
            ),
            (
                "estimated bevel",
                &[
                    "estimator.cut_angle_sigma=0.0",
                    "estimator.cut_across_sigma=0.0",
                    "estimator.bevel_walk=0.0",
                ],
            ),
            (
                "estimated disturbance",
                &[
                    "estimator.start_disturbance_deg=0.0",
                    "estimator.disturbance_walk_deg=0.0",
                ],
            ),
            ("axial load", &["estimator.axial_load_n=0.0"]),
            (
                "compliance of the tip",
                &["estimator.tip_compliance_deg_n=0.0"],
            ),
            (
                "prediction over latency",
                &["estimator.compensate_latency=false"],
            ),
        ]
        .into_iter()
        .map(|(name, overrides)| Variant::new(&format!("without {name}"), overrides)),
    );
    rows
}

/// One cell: a variant on one experiment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Cell {
    /// The variant's name.
    pub variant: String,
    /// The experiment's name.
    pub experiment: &'static str,
    /// Its runs by seed.
    pub runs: Vec<RunFigures>,
    /// Median true error \[mm\].
    pub median_mm: f64,
    /// 95th percentile of the true error \[mm\].
    pub p95_mm: f64,
    /// Runs that passed the target.
    pub passed: usize,
    /// Median over the runs of the mean tissue displacement \[mm\].
    pub stretch_mm: f64,
    /// True error minus the first variant's, seed by seed \[mm\].
    pub error_difference_mm: PairedDifference,
    /// Mean tissue displacement minus the first variant's, seed by seed \[mm\].
    pub stretch_difference_mm: PairedDifference,
}

/// The same seeds for every variant; the first is what the others are compared with.
#[derive(Clone, Debug)]
pub struct Comparison {
    /// Rows.
    pub variants: Vec<Variant>,
    /// Experiments; the law of controlled ones is the variant's.
    pub experiments: Vec<Experiment>,
    /// First seed.
    pub first_seed: u64,
    /// Number of seeds.
    pub runs: u64,
    /// Overrides of every run.
    pub common: Vec<String>,
}

impl Comparison {
    /// Carries the comparison out on `jobs` threads.
    ///
    /// # Errors
    /// A variant's configuration, or the first run that could not be carried out.
    pub fn carry_out<E: Send + From<ConfigError>>(
        &self,
        jobs: usize,
        run: impl Fn(&Config) -> Result<Summary, E> + Sync,
    ) -> Result<Vec<Cell>, E> {
        let mut tasks = Vec::new();
        for variant in &self.variants {
            let mut overrides = self.common.clone();
            overrides.extend(variant.overrides.iter().cloned());
            let base = config::load(None, &overrides)?;
            let plan = Plan {
                experiments: self.experiments.clone(),
                law: base.run.law.clone(),
                first_seed: self.first_seed,
                runs: self.runs,
                brackets: false,
                base,
            };
            for experiment in &self.experiments {
                for seed in self.first_seed..self.first_seed + self.runs {
                    tasks.push(plan.config(experiment, seed));
                }
            }
        }
        let results: Result<Vec<RunFigures>, E> = in_parallel(&tasks, jobs, |config| {
            run(config).map(|summary| RunFigures::from(&summary))
        })
        .into_iter()
        .collect();
        let mut results = results?.into_iter();
        let mut cells: Vec<Cell> = Vec::new();
        for variant in &self.variants {
            for (column, experiment) in self.experiments.iter().enumerate() {
                let runs: Vec<RunFigures> = (0..self.runs).filter_map(|_| results.next()).collect();
                let reference = cells
                    .get(column)
                    .map_or_else(|| runs.clone(), |c| c.runs.clone());
                cells.push(Cell::new(variant, experiment, runs, &reference));
            }
        }
        Ok(cells)
    }
}

impl Cell {
    fn new(
        variant: &Variant,
        experiment: &Experiment,
        runs: Vec<RunFigures>,
        reference: &[RunFigures],
    ) -> Self {
        let errors =
            |runs: &[RunFigures]| -> Vec<f64> { runs.iter().map(|r| r.true_error_mm).collect() };
        let stretches =
            |runs: &[RunFigures]| -> Vec<f64> { runs.iter().map(|r| r.mean_stretch_mm).collect() };
        let (e, s) = (errors(&runs), stretches(&runs));
        Self {
            variant: variant.name.clone(),
            experiment: experiment.name,
            median_mm: median(&e),
            p95_mm: percentile(&e, 0.95),
            passed: runs.iter().filter(|r| r.ended == "target passed").count(),
            stretch_mm: median(&s),
            error_difference_mm: paired_difference(&e, &errors(reference)),
            stretch_difference_mm: paired_difference(&s, &stretches(reference)),
            runs,
        }
    }
}

/// The cells as a table in Markdown.
pub fn markdown(cells: &[Cell]) -> String {
    let mut text = String::from(
        "| | | median | 95 % | error minus the first row's: median [95 % interval] | mean tissue displacement | minus the first row's | passed |\n|---|---|---|---|---|---|---|---|\n",
    );
    for cell in cells {
        let show =
            |d: &PairedDifference| format!("{:+.3} [{:+.3}, {:+.3}]", d.median, d.low, d.high);
        // Writing to a string cannot fail.
        let _ = writeln!(
            text,
            "| {} | {} | {:.3} | {:.3} | {} | {:.3} | {} | {}/{} |",
            cell.variant,
            cell.experiment,
            cell.median_mm,
            cell.p95_mm,
            show(&cell.error_difference_mm),
            cell.stretch_mm,
            show(&cell.stretch_difference_mm),
            cell.passed,
            cell.runs.len(),
        );
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::experiments::EXPERIMENTS;
    use crate::outcome::Ended;

    #[test]
    fn every_variant_is_a_configuration() {
        for variant in laws().into_iter().chain(ablations()) {
            config::load(None, &variant.overrides)
                .unwrap_or_else(|e| panic!("{}: {e}", variant.name));
        }
    }

    #[test]
    fn variants_meet_the_same_seeds_and_the_first_row() {
        let comparison = Comparison {
            variants: vec![
                Variant::new("a", &[]),
                Variant::new("b", &["run.law=paper"]),
            ],
            experiments: vec![EXPERIMENTS[1], EXPERIMENTS[3]],
            first_seed: 7,
            runs: 5,
            common: Vec::new(),
        };
        let cells = comparison
            .carry_out(2, |config| {
                let worse = if config.run.law == "paper" { 1.0 } else { 0.0 };
                Ok::<_, ConfigError>(Summary {
                    ended: Ended::TargetPassed,
                    cause: None,
                    hit: true,
                    goal_mm: 0.5,
                    events: Vec::new(),
                    spoilt: false,
                    law: config.run.law.clone(),
                    phantom: config.run.phantom.clone(),
                    seed: config.run.seed,
                    true_error_mm: Some(config.run.seed as f64 + worse),
                    true_error_less_bias_mm: None,
                    measured_error_mm: None,
                    axial_error_mm: None,
                    max_stretch_mm: 0.0,
                    mean_stretch_mm: config.target.offset_mm,
                    duration_s: 0.0,
                    steps: 0,
                    out: None,
                    log: None,
                    log_complete: None,
                })
            })
            .unwrap();
        assert_eq!(cells.len(), 4);
        assert_eq!(cells[3].variant, "b");
        assert!((cells[3].error_difference_mm.median - 1.0).abs() < 1e-12);
        assert!((cells[3].median_mm - 10.0).abs() < 1e-12);
        assert!(markdown(&cells).lines().count() == 6);
    }
}

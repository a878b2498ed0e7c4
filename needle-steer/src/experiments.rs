//! The paper's four experiments as distributions over seeds: Table I.

use std::sync::Mutex;
use std::sync::atomic::{AtomicUsize, Ordering};

use serde::Serialize;

use crate::config::{Config, TargetKind};
use crate::outcome::Summary;
use crate::statistics::{median, percentile};

/// One of the paper's experiments (section IV.C).
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Experiment {
    /// Short name.
    pub name: &'static str,
    /// Whether the controller is active.
    #[serde(skip)]
    pub controlled: bool,
    /// The target in words.
    pub target: &'static str,
    /// Offset of the target across the needle \[mm\].
    #[serde(skip)]
    pub offset_mm: f64,
    /// Direction of the offset from the bevel direction \[deg\].
    #[serde(skip)]
    pub angle_deg: f64,
    /// Final lateral error of the paper's one run, Table I \[mm\].
    pub paper_error_mm: f64,
}

/// The paper's experiments in its order.
pub const EXPERIMENTS: [Experiment; 4] = [
    Experiment {
        name: "e1",
        controlled: false,
        target: "aligned",
        offset_mm: 0.0,
        angle_deg: 0.0,
        paper_error_mm: 7.6,
    },
    Experiment {
        name: "e2",
        controlled: true,
        target: "aligned",
        offset_mm: 0.0,
        angle_deg: 0.0,
        paper_error_mm: 0.6,
    },
    Experiment {
        name: "e3",
        controlled: false,
        target: "shifted 1 cm in the bevel direction",
        offset_mm: 10.0,
        angle_deg: 0.0,
        paper_error_mm: 4.9,
    },
    Experiment {
        name: "e4",
        controlled: true,
        target: "shifted 1 cm at 135 degrees",
        offset_mm: 10.0,
        angle_deg: 135.0,
        paper_error_mm: 0.1,
    },
];

/// What to reproduce.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Experiments, of [`EXPERIMENTS`].
    pub experiments: Vec<Experiment>,
    /// Law of the controlled ones.
    pub law: String,
    /// First seed.
    pub first_seed: u64,
    /// Number of seeds.
    pub runs: u64,
    /// Everything else.
    pub base: Config,
}

impl Plan {
    /// Configuration of one run of one experiment.
    pub fn config(&self, experiment: &Experiment, seed: u64) -> Config {
        let mut config = self.base.clone();
        config.run.law = if experiment.controlled {
            self.law.clone()
        } else {
            "none".to_owned()
        };
        config.run.seed = seed;
        // A law that cannot reach the target is measured all the same.
        config.run.check_reach = false;
        config.target.kind = if experiment.offset_mm > 0.0 {
            TargetKind::Shifted
        } else {
            TargetKind::Aligned
        };
        config.target.depth_mm = 80.0;
        config.target.offset_mm = experiment.offset_mm;
        config.target.angle_deg = experiment.angle_deg;
        config
    }
}

/// One run in the table.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RunFigures {
    /// Seed.
    pub seed: u64,
    /// Distance of the true target from the true tip axis at the end \[mm\].
    pub true_error_mm: f64,
    /// The same by the sensor \[mm\].
    pub measured_error_mm: Option<f64>,
    /// Along the axis \[mm\].
    pub axial_error_mm: Option<f64>,
    /// Largest true tissue displacement \[mm\].
    pub max_stretch_mm: f64,
    /// Mean true tissue displacement \[mm\].
    pub mean_stretch_mm: f64,
    /// Duration of steering \[s\].
    pub duration_s: f64,
    /// The verdict.
    pub ended: String,
}

impl From<&Summary> for RunFigures {
    fn from(summary: &Summary) -> Self {
        Self {
            seed: summary.seed,
            true_error_mm: summary.true_error_mm.unwrap_or(f64::NAN),
            measured_error_mm: summary.measured_error_mm,
            axial_error_mm: summary.axial_error_mm,
            max_stretch_mm: summary.max_stretch_mm,
            mean_stretch_mm: summary.mean_stretch_mm,
            duration_s: summary.duration_s,
            ended: summary.ended.to_string(),
        }
    }
}

/// The distribution of one experiment.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExperimentResult {
    /// The experiment.
    #[serde(flatten)]
    pub experiment: Experiment,
    /// Law in force.
    pub law: String,
    /// All runs, by seed.
    pub runs: Vec<RunFigures>,
    /// Median of the true error \[mm\].
    pub median_mm: f64,
    /// 5th percentile of the true error \[mm\].
    pub p5_mm: f64,
    /// 95th percentile of the true error \[mm\].
    pub p95_mm: f64,
}

impl ExperimentResult {
    fn new(experiment: Experiment, law: String, runs: Vec<RunFigures>) -> Self {
        let errors: Vec<f64> = runs.iter().map(|run| run.true_error_mm).collect();
        Self {
            experiment,
            law,
            median_mm: median(&errors),
            p5_mm: percentile(&errors, 0.05),
            p95_mm: percentile(&errors, 0.95),
            runs,
        }
    }
}

/// Runs the plan on `jobs` threads; the result does not depend on their number.
///
/// # Errors
/// The first run, in order, that could not be carried out.
pub fn reproduce<E: Send>(
    plan: &Plan,
    jobs: usize,
    run: impl Fn(&Config) -> Result<Summary, E> + Sync,
    progress: impl Fn() + Sync,
) -> Result<Vec<ExperimentResult>, E> {
    let tasks: Vec<(Experiment, Config)> = plan
        .experiments
        .iter()
        .flat_map(|e| (0..plan.runs).map(move |k| (*e, plan.config(e, plan.first_seed + k))))
        .collect();
    let mut results = in_parallel(&tasks, jobs, |(_, config)| {
        let figures = run(config).map(|summary| RunFigures::from(&summary));
        progress();
        figures
    })
    .into_iter();
    plan.experiments
        .iter()
        .map(|experiment| {
            let runs: Result<Vec<_>, E> = (0..plan.runs).filter_map(|_| results.next()).collect();
            let law = if experiment.controlled {
                plan.law.clone()
            } else {
                "none".to_owned()
            };
            Ok(ExperimentResult::new(*experiment, law, runs?))
        })
        .collect()
}

/// Maps `tasks` on `jobs` threads, keeping their order.
pub fn in_parallel<T: Sync, R: Send>(
    tasks: &[T],
    jobs: usize,
    work: impl Fn(&T) -> R + Sync,
) -> Vec<R> {
    let next = AtomicUsize::new(0);
    let done: Mutex<Vec<(usize, R)>> = Mutex::new(Vec::with_capacity(tasks.len()));
    std::thread::scope(|scope| {
        for _ in 0..jobs.clamp(1, tasks.len().max(1)) {
            scope.spawn(|| {
                while let Some((index, task)) = {
                    let index = next.fetch_add(1, Ordering::Relaxed);
                    tasks.get(index).map(|task| (index, task))
                } {
                    let result = work(task);
                    done.lock()
                        .unwrap_or_else(std::sync::PoisonError::into_inner)
                        .push((index, result));
                }
            });
        }
    });
    let mut done = done
        .into_inner()
        .unwrap_or_else(std::sync::PoisonError::into_inner);
    done.sort_by_key(|(index, _)| *index);
    done.into_iter().map(|(_, result)| result).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parallel_results_keep_their_order() {
        let tasks: Vec<u64> = (0..100).collect();
        let squares = in_parallel(&tasks, 4, |x| x * x);
        assert_eq!(squares, tasks.iter().map(|x| x * x).collect::<Vec<_>>());
        assert!(in_parallel(&[] as &[u64], 4, |x| *x).is_empty());
    }

    #[test]
    fn controlled_experiments_take_the_law_of_the_plan() {
        let plan = Plan {
            experiments: EXPERIMENTS.to_vec(),
            law: "paper".into(),
            first_seed: 5,
            runs: 2,
            base: Config::default(),
        };
        assert_eq!(plan.config(&EXPERIMENTS[0], 5).run.law, "none");
        let e4 = plan.config(&EXPERIMENTS[3], 6);
        assert_eq!((e4.run.law.as_str(), e4.run.seed), ("paper", 6));
        assert_eq!((e4.target.offset_mm, e4.target.angle_deg), (10.0, 135.0));
    }
}

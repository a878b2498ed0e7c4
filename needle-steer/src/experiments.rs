//! The paper's four experiments as distributions over seeds: Table I.

use std::sync::atomic::{AtomicBool, AtomicU64, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use serde::Serialize;

use phantom::{Draw, Settings, SettingsError};

use crate::config::{Config, PlantKind, TargetKind};
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

/// In whose place an experiment is carried out. The null and the oracle bracket every result of a
/// law; the same-model column beside it tells what the phantom's other physics costs.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Column {
    /// The law on the phantom.
    #[default]
    Phantom,
    /// No control: the upper bracket.
    Null,
    /// The law told the truth: exact measurements without delay or loss, a robot without flaws,
    /// the run's true stiffness, cut angle and compliance at the start. The lower bracket.
    Oracle,
    /// The law on the controller's own model in the phantom's place.
    SameModel,
}

impl Column {
    /// All that say something about an experiment: uncontrolled ones are their own null, and
    /// have nothing to know.
    pub fn of(experiment: &Experiment) -> &'static [Self] {
        if experiment.controlled {
            &[Self::Phantom, Self::Null, Self::Oracle, Self::SameModel]
        } else {
            &[Self::Phantom, Self::SameModel]
        }
    }

    /// The name in tables.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Phantom => "phantom",
            Self::Null => "null",
            Self::Oracle => "oracle",
            Self::SameModel => "same model",
        }
    }
}

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
    /// Whether null, oracle and same model go with every experiment.
    pub brackets: bool,
    /// Everything else.
    pub base: Config,
}

impl Plan {
    /// Configuration of one run of one experiment. Depth and everything else that makes no
    /// experiment come from the base.
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
        config.target.kind = match self.base.target.kind {
            TargetKind::Marker => TargetKind::Marker,
            _ if experiment.offset_mm > 0.0 => TargetKind::Shifted,
            _ => TargetKind::Aligned,
        };
        config.target.offset_mm = experiment.offset_mm;
        config.target.angle_deg = experiment.angle_deg;
        config
    }

    /// Configuration of one run in one column.
    ///
    /// # Errors
    /// The phantom's settings.
    pub fn config_in(
        &self,
        column: Column,
        experiment: &Experiment,
        seed: u64,
    ) -> Result<Config, SettingsError> {
        let mut config = self.config(experiment, seed);
        match column {
            Column::Phantom => {}
            Column::Null => "none".clone_into(&mut config.run.law),
            Column::Oracle => tell_truth(&mut config)?,
            Column::SameModel => config.run.plant = PlantKind::Springs,
        }
        Ok(config)
    }

    /// Number of runs.
    pub fn len(&self) -> u64 {
        let cells = self
            .experiments
            .iter()
            .map(|e| self.columns(e).len() as u64);
        self.runs.saturating_mul(cells.sum())
    }

    /// Whether there is nothing to run.
    pub fn is_empty(&self) -> bool {
        self.len() == 0
    }

    fn columns(&self, experiment: &Experiment) -> &'static [Column] {
        if self.brackets {
            Column::of(experiment)
        } else {
            &[Column::Phantom]
        }
    }
}

/// Takes away what stands between the controller and the truth of this run.
fn tell_truth(config: &mut Config) -> Result<(), SettingsError> {
    let settings = config.phantom_settings()?;
    let draw = Draw::new(&settings, config.run.seed);
    let exact = Settings::default();
    for (name, table) in [
        ("sensor", toml::Table::try_from(exact.sensor)),
        ("robot", toml::Table::try_from(exact.robot)),
    ] {
        // Plain numbers: they always make a table.
        if let Ok(table) = table {
            config.phantom.insert(name.into(), table.into());
        }
    }
    let e = &mut config.estimator;
    e.stiffness_n_m2 = draw.stiffness;
    e.stiffness_sigma = 0.2;
    e.cut_angle_deg = draw.cut_angle.to_degrees();
    e.cut_angle_sigma = 0.15;
    e.tip_compliance_deg_n = settings.tip.compliance_deg_n;
    e.axial_load_n = settings.tip.cutting_n;
    Ok(())
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
    /// In whose place.
    pub column: Column,
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
    fn new(experiment: Experiment, law: String, column: Column, runs: Vec<RunFigures>) -> Self {
        let errors: Vec<f64> = runs.iter().map(|run| run.true_error_mm).collect();
        Self {
            experiment,
            law,
            column,
            median_mm: median(&errors),
            p5_mm: percentile(&errors, 0.05),
            p95_mm: percentile(&errors, 0.95),
            runs,
        }
    }
}

/// What is finished of a plan.
#[derive(Debug)]
pub struct Reproduced<E> {
    /// Experiments of which a run is finished.
    pub experiments: Vec<ExperimentResult>,
    /// Finished runs.
    pub finished: u64,
    /// Runs of the plan.
    pub planned: u64,
    /// The first run, in order, that could not be carried out.
    pub error: Option<E>,
}

/// One finished run of a plan and where it belongs.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finished {
    /// Name of the experiment.
    pub experiment: &'static str,
    /// In whose place.
    pub column: Column,
    /// Its figures.
    #[serde(flatten)]
    pub figures: RunFigures,
}

/// Runs the plan on `jobs` threads, seed by seed; the result does not depend on their number.
/// `run` answers nothing when it was interrupted: no other is begun then. A run that cannot be
/// carried out does not stop the others, unless none before it could be.
pub fn reproduce<E: Send + From<SettingsError>>(
    plan: &Plan,
    jobs: usize,
    run: impl Fn(&Config) -> Result<Option<Summary>, E> + Sync,
    finished: impl Fn(&Finished) + Sync,
) -> Reproduced<E> {
    let cells: Vec<(Experiment, Column)> = plan
        .experiments
        .iter()
        .flat_map(|e| plan.columns(e).iter().map(|column| (*e, *column)))
        .collect();
    let kinds = (cells.len() as u64).max(1);
    let planned = plan.len();
    let (next, stop) = (AtomicU64::new(0), AtomicBool::new(false));
    let done: Mutex<Vec<(u64, RunFigures)>> = Mutex::default();
    let errors: Mutex<Vec<(u64, E)>> = Mutex::default();
    let work = || {
        while !stop.load(Ordering::Relaxed) {
            let index = next.fetch_add(1, Ordering::Relaxed);
            let Some((experiment, column)) = cells.get(in_usize(index % kinds)) else {
                return;
            };
            if index >= planned {
                return;
            }
            let seed = plan.first_seed.saturating_add(index / kinds);
            let result = plan
                .config_in(*column, experiment, seed)
                .map_err(E::from)
                .and_then(|config| run(&config));
            let mut done = done.lock().unwrap_or_else(PoisonError::into_inner);
            match result {
                Ok(None) => stop.store(true, Ordering::Relaxed),
                Ok(Some(summary)) => {
                    let run = Finished {
                        experiment: experiment.name,
                        column: *column,
                        figures: RunFigures::from(&summary),
                    };
                    finished(&run);
                    done.push((index, run.figures));
                }
                Err(error) => {
                    let mut errors = errors.lock().unwrap_or_else(PoisonError::into_inner);
                    errors.push((index, error));
                    if done.is_empty() {
                        stop.store(true, Ordering::Relaxed);
                    }
                }
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..jobs.clamp(1, in_usize(planned.max(1))) {
            scope.spawn(work);
        }
    });
    let mut runs = done.into_inner().unwrap_or_else(PoisonError::into_inner);
    let errors = errors.into_inner().unwrap_or_else(PoisonError::into_inner);
    runs.sort_by_key(|(index, _)| *index);
    let of_cell = |(k, (experiment, column)): (u64, (Experiment, Column))| {
        let law = if experiment.controlled && column != Column::Null {
            plan.law.clone()
        } else {
            "none".to_owned()
        };
        let of_cell = runs.iter().filter(|(index, _)| index % kinds == k);
        let runs: Vec<RunFigures> = of_cell.map(|(_, figures)| figures.clone()).collect();
        (!runs.is_empty()).then(|| ExperimentResult::new(experiment, law, column, runs))
    };
    Reproduced {
        experiments: (0..).zip(cells).filter_map(of_cell).collect(),
        finished: runs.len() as u64,
        planned,
        error: errors
            .into_iter()
            .min_by_key(|(index, _)| *index)
            .map(|(_, error)| error),
    }
}

fn in_usize(number: u64) -> usize {
    usize::try_from(number).unwrap_or(usize::MAX)
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
                        .unwrap_or_else(PoisonError::into_inner)
                        .push((index, result));
                }
            });
        }
    });
    let mut done = done.into_inner().unwrap_or_else(PoisonError::into_inner);
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
            brackets: false,
            base: Config::default(),
        };
        assert_eq!(plan.config(&EXPERIMENTS[0], 5).run.law, "none");
        let e4 = plan.config(&EXPERIMENTS[3], 6);
        assert_eq!((e4.run.law.as_str(), e4.run.seed), ("paper", 6));
        assert_eq!((e4.target.offset_mm, e4.target.angle_deg), (10.0, 135.0));
    }

    #[test]
    fn columns_change_what_they_say() {
        let plan = Plan {
            experiments: EXPERIMENTS.to_vec(),
            law: "hybrid".into(),
            first_seed: 5,
            runs: 1,
            brackets: true,
            base: Config::default(),
        };
        let at = |column| plan.config_in(column, &EXPERIMENTS[3], 5).unwrap();
        assert_eq!(at(Column::Null).run.law, "none");
        assert_eq!(at(Column::SameModel).run.plant, PlantKind::Springs);
        let oracle = at(Column::Oracle);
        let told = Settings::preset("paper")
            .unwrap()
            .overridden(oracle.phantom.clone())
            .unwrap();
        assert_eq!(told.sensor, Settings::default().sensor);
        assert_eq!(told.robot, Settings::default().robot);
        assert_ne!(oracle.estimator, Config::default().estimator);
        assert!(oracle.validate().is_ok());
        assert_eq!(Column::of(&EXPERIMENTS[0]).len(), 2);
    }
}

//! The paper's experiments as a user asks for them.

use serde::Serialize;

use crate::config::{self, Config, ConfigError};
use crate::controls::Controls;
use crate::experiments::{EXPERIMENTS, Experiment, ExperimentResult, Plan};
use crate::outcome::{Ended, Summary};
use crate::rig::Rig;
use crate::run::{RunError, Unobserved, run};

/// What is asked for.
#[derive(Clone, Debug)]
pub struct Request {
    /// Some of e1, e2, e3, e4.
    pub experiments: Vec<String>,
    /// Law of the controlled experiments e2 and e4.
    pub law: String,
    /// Runs of each experiment.
    pub runs: u64,
    /// First seed.
    pub seed: u64,
    /// Preset of the phantom.
    pub phantom: String,
    /// What closes the loop; the configuration's default where nothing is said.
    pub sensor: Option<String>,
    /// Add what brackets every result.
    pub brackets: bool,
    /// Changes to the configuration of every run: `key=value`.
    pub set: Vec<String>,
}

/// A request that cannot be met.
#[derive(Debug, thiserror::Error)]
pub enum RequestError {
    /// An option.
    #[error("{0}")]
    Option(String),
    /// The configuration.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// A configuration that is no table.
    #[error(transparent)]
    Table(#[from] toml::ser::Error),
}

/// The results, as `reproduce --json` prints them.
#[derive(Clone, Debug, Serialize)]
pub struct Document<'a> {
    /// Each experiment's.
    pub experiments: &'a [ExperimentResult],
    /// Changes to the configuration of every run.
    pub set: &'a [String],
    /// Runs that were carried out.
    pub finished: u64,
    /// Runs that were asked for.
    pub planned: u64,
}

/// Why a run could not be carried out.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The run.
    #[error(transparent)]
    Run(#[from] RunError),
    /// Its phantom.
    #[error("phantom: {0}")]
    Phantom(#[from] phantom::SettingsError),
}

/// One run; nothing where the user stopped it.
///
/// # Errors
/// It could not be carried out.
pub fn one(config: &Config, interrupt: &Controls) -> Result<Option<Summary>, Failure> {
    if interrupt.is_interrupted() {
        return Ok(None);
    }
    let mut rig = Rig::new(config).map_err(RunError::from)?;
    let summary = run(config, &mut rig, &mut Unobserved, interrupt)?;
    Ok((summary.ended != Ended::Interrupted).then_some(summary))
}

impl Request {
    /// The plan.
    ///
    /// # Errors
    /// An option or a key that cannot be used, or that an experiment would not heed.
    pub fn plan(&self) -> Result<Plan, RequestError> {
        let experiments: Result<Vec<Experiment>, RequestError> = self
            .experiments
            .iter()
            .map(|name| {
                EXPERIMENTS
                    .into_iter()
                    .find(|e| e.name == name)
                    .ok_or_else(|| {
                        RequestError::Option(format!(
                            "--experiments: `{name}` is unknown; expected some of e1,e2,e3,e4"
                        ))
                    })
            })
            .collect();
        if self.runs == 0 {
            return Err(RequestError::Option("--runs: expected at least 1".into()));
        }
        if self.seed.checked_add(self.runs - 1).is_none() {
            return Err(RequestError::Option(format!(
                "--seed {} --runs {}: the last seed is above {}, the largest there is",
                self.seed,
                self.runs,
                u64::MAX
            )));
        }
        let mut overrides = self.set.clone();
        overrides.push(format!("run.phantom={}", config::quoted(&self.phantom)));
        overrides.push(format!("run.law={}", config::quoted(&self.law)));
        overrides.extend(
            self.sensor
                .as_ref()
                .map(|s| format!("run.sensor={}", config::quoted(s))),
        );
        let plan = Plan {
            experiments: experiments?,
            law: self.law.clone(),
            first_seed: self.seed,
            runs: self.runs,
            brackets: self.brackets,
            base: config::load(None, &overrides)?,
        };
        let unattended = plan.base.check_unattended();
        unattended.map_err(|e| RequestError::Option(format!("key `{}`: {}", e.key, e.problem)))?;
        self.check_heeded(&plan)?;
        Ok(plan)
    }

    /// Refuses a `--set` that an experiment would not heed.
    fn check_heeded(&self, plan: &Plan) -> Result<(), RequestError> {
        let given = toml::Value::try_from(config::load(None, &self.set)?)?;
        for argument in &self.set {
            let key = argument.split('=').next().unwrap_or_default().trim();
            for experiment in &plan.experiments {
                // A seed of its own: every run has another.
                let run = toml::Value::try_from(plan.config(experiment, 0))?;
                let (wanted, taken) = (value_at(&given, key), value_at(&run, key));
                if key == "run.seed" || wanted != taken {
                    return Err(RequestError::Option(format!(
                        "--set {argument}: {} sets {key} itself{}",
                        experiment.name,
                        instead_of(key)
                    )));
                }
            }
        }
        Ok(())
    }
}

fn value_at<'a>(config: &'a toml::Value, key: &str) -> Option<&'a toml::Value> {
    key.split('.')
        .try_fold(config, |table, part| table.get(part.trim()))
}

/// Why a key is not heeded, and what is.
fn instead_of(key: &str) -> &'static str {
    match key {
        "run.seed" => "; --seed gives the first one",
        "run.law" => "; --law names the law of e2 and e4",
        "run.phantom" => "; use --phantom",
        "run.sensor" => "; use --sensor",
        "run.check_reach" => ": a target out of reach is measured all the same",
        _ if key.starts_with("target") => {
            ": where the paper has its targets; `run` and `campaign` take others"
        }
        _ => "",
    }
}

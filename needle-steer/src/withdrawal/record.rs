//! The results of a withdrawal: its own log, series and summary. Nothing that fails here keeps a
//! needle in.

use std::io::Write;
use std::path::{Path, PathBuf};

use hal::telemetry::Telemetry;
use hal::{ArmState, RateCommand, SensedShape, Stamp};

use super::verdict::Summary;
use crate::clock::began;
use crate::config::Config;
use crate::journal::Journal;
use crate::observer::Observer;
use crate::rig::Rig;
use crate::series::{Row, Series, write_csv};

/// Keeps what a withdrawal does.
#[derive(Debug, Default)]
pub struct Record {
    journal: Option<Journal>,
    folder: Option<PathBuf>,
    insertion: Option<PathBuf>,
    rows: Vec<Row>,
    series: Series,
    problem: Option<String>,
}

impl Record {
    /// Keeps nothing.
    pub fn none() -> Self {
        Self::default()
    }

    /// Writes into `folder`, which is made. Where that fails, it says so and keeps nothing.
    /// `insertion` is the log of the insertion.
    pub fn create(folder: PathBuf, config: &Config, rig: &Rig, insertion: Option<&Path>) -> Self {
        // A log is read from other folders too.
        let absolute = insertion.and_then(|log| std::path::absolute(log).ok());
        let before = absolute.as_deref();
        let made = std::fs::create_dir_all(&folder)
            .map_err(Into::into)
            .and_then(|()| {
                let (place, began) = (folder.join("run.mcap"), began(rig.clock.now()));
                Journal::of_withdrawal(&place, config, &rig.bearings, before, began)
            });
        let mut record = Self {
            insertion: insertion.map(Path::to_owned),
            ..Self::default()
        };
        match made {
            Ok(journal) => {
                record.journal = Some(journal);
                record.folder = Some(folder);
            }
            Err(error) => warn(&format!(
                "the withdrawal is not logged: {}: {error:#}",
                folder.display()
            )),
        }
        record
    }

    /// Writes into the next free `withdrawal-N` in the folder of the insertion's results.
    pub fn beside(results: &Path, config: &Config, rig: &Rig, insertion: Option<&Path>) -> Self {
        let free = (1_u32..).map(|n| results.join(format!("withdrawal-{n}")));
        match free.into_iter().find(|folder| !folder.exists()) {
            Some(folder) => Self::create(folder, config, rig, insertion),
            None => Self::none(),
        }
    }

    /// Completes the files.
    pub(super) fn finish(mut self, now: Stamp, config: &Config, mut summary: Summary) -> Summary {
        summary.insertion = self
            .insertion
            .as_ref()
            .map(|file| file.display().to_string());
        let Some(folder) = &self.folder else {
            return summary;
        };
        summary.out = Some(folder.display().to_string());
        summary.log = Some(folder.join("run.mcap").display().to_string());
        summary.log_complete = true;
        if let Some(mut journal) = self.journal.take() {
            let success = summary.ended.is_success();
            journal.conclude(now, success, &summary.ended.to_string(), &summary);
            if let Err(error) = journal.finish() {
                self.problem = Some(error.to_string());
            }
        }
        summary.log_complete = self.problem.is_none();
        if let Err(error) = self.write(folder, config, &summary) {
            self.problem = Some(format!("{error:#}"));
        }
        if let Some(problem) = &self.problem {
            warn(&format!(
                "results of the withdrawal in {} are not complete: {problem}",
                folder.display()
            ));
        }
        summary
    }

    fn write(&self, folder: &Path, config: &Config, summary: &Summary) -> anyhow::Result<()> {
        std::fs::write(folder.join("config.toml"), toml::to_string(config)?)?;
        let csv = std::fs::File::create(folder.join("series.csv"))?;
        write_csv(&self.rows, std::io::BufWriter::new(csv))?;
        let mut json = serde_json::to_vec_pretty(summary)?;
        json.push(b'\n');
        Ok(std::fs::write(folder.join("summary.json"), json)?)
    }
}

fn warn(text: &str) {
    // Nothing can be done about a closed stderr.
    let _ = writeln!(std::io::stderr(), "{text}");
}

impl Observer for Record {
    fn inputs(&mut self, arm: &ArmState, shape: Option<&SensedShape>) {
        if let Some(journal) = &mut self.journal {
            journal.inputs(arm, shape);
        }
    }

    fn step(&mut self, telemetry: &Telemetry) {
        let Some(journal) = &mut self.journal else {
            return;
        };
        journal.step(telemetry);
        self.rows.push(self.series.row(telemetry));
    }

    fn command(&mut self, command: &RateCommand) {
        if let Some(journal) = &mut self.journal {
            journal.command(command);
        }
    }
}

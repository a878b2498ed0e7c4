//! What one insertion leaves: its verdict, its time series and, in a folder, its files. Nothing is
//! printed here.

use std::io::Write;
use std::path::{Path, PathBuf};

use anyhow::Context;
use hal::telemetry::Telemetry;
use hal::{ArmState, RateCommand, SensedMarker, SensedShape, Stamp, StereoFrame};
use hybrid_control::Law;
use rosbridge::log::{LogReader, Overflow, ReadError, WriteError};
use vision::track::Tracked;

use crate::clock::began;
use crate::config::{Config, Invalid};
use crate::controls::Controls;
use crate::journal::Journal;
use crate::observer::{Both, Observer};
use crate::outcome::Summary;
use crate::plot::write_run_plot;
use crate::results::{ResultsError, RunFolder, save};
use crate::rig::{PlantMaker, Rig, RigBuildError};
use crate::run::{Insertion, RunError};
use crate::series::{Row, Series, write_csv};

/// One insertion, as it ended.
#[derive(Clone, Debug, PartialEq)]
pub struct Record {
    /// The verdict and its figures.
    pub summary: Summary,
    /// The time series, a row each law step.
    pub rows: Vec<Row>,
}

/// An insertion that left no record.
#[derive(Debug, thiserror::Error)]
pub enum RecordError {
    /// It could not be carried out.
    #[error(transparent)]
    Run(#[from] RunError),
    /// It wants somebody who attends to it.
    #[error("key `{}`: {}", .0.key, .0.problem)]
    Unattended(Invalid),
    /// Its folder.
    #[error(transparent)]
    Folder(#[from] ResultsError),
    /// Its files.
    #[error("{0:#}")]
    Files(#[from] anyhow::Error),
    /// Its log breaks off.
    #[error("the log is not complete: {0}")]
    Log(#[from] WriteError),
}

impl From<RigBuildError> for RecordError {
    fn from(error: RigBuildError) -> Self {
        Self::Run(error.into())
    }
}

/// What takes the place of what a configuration names.
#[derive(Default)]
pub struct Parts {
    /// A law of one's own; it is held to the limits as the built-in ones are.
    pub law: Option<Box<dyn Law>>,
    /// A plant of one's own.
    pub plant: Option<PlantMaker>,
    /// Folder for log, series, summary, configuration and plot; without it nothing is written.
    pub out: Option<PathBuf>,
}

impl core::fmt::Debug for Parts {
    fn fmt(&self, f: &mut core::fmt::Formatter<'_>) -> core::fmt::Result {
        f.debug_struct("Parts")
            .field("law", &self.law.as_ref().map(|law| law.name().to_owned()))
            .field("plant", &self.plant.is_some())
            .field("out", &self.out)
            .finish()
    }
}

/// Carries out one insertion that nobody attends to.
///
/// # Errors
/// See [`RecordError`]; a run that ends early is no error but a verdict.
pub fn carry_out(
    config: &Config,
    parts: Parts,
    watcher: &mut dyn Observer,
    controls: &Controls,
) -> Result<Record, RecordError> {
    config.check_unattended().map_err(RecordError::Unattended)?;
    let out = parts.out.as_deref().map(RunFolder::claim).transpose()?;
    let mut rig = match parts.plant {
        Some(plant) => Rig::with_plant(config, plant)?,
        None => Rig::new(config)?,
    };
    let mut recorder = Recorder::new(config, &rig, out.as_ref())?;
    let mut insertion = Insertion::begin(config, &mut rig)?;
    insertion.folder = out.as_ref().map(|out| out.path().to_owned());
    if let Some(law) = parts.law {
        insertion.set_law(hybrid_control::guarded(law));
    }
    let mut both = Both(&mut recorder, watcher);
    let carried_out = insertion.carry_out(config, &mut both, controls);
    let mut summary = recorder.close(carried_out, out.as_ref())?;
    let logged = recorder.finish(&mut summary, out.as_ref());
    if let Some(out) = &out {
        write_results(out.path(), config, &recorder.rows, &summary)?;
    }
    logged?;
    Ok(Record {
        summary,
        rows: recorder.rows,
    })
}

/// Keeps a run's time series and, where there is a folder, its log.
#[derive(Debug)]
pub struct Recorder {
    /// A row each law step.
    pub rows: Vec<Row>,
    journal: Option<Journal>,
    series: Series,
    last: Option<Stamp>,
}

impl Recorder {
    /// A recorder of a run of `rig` on `config`, with a log in `out` if there is that folder.
    ///
    /// # Errors
    /// The log cannot be begun.
    pub fn new(config: &Config, rig: &Rig, out: Option<&RunFolder>) -> anyhow::Result<Self> {
        let (bearings, began) = (&rig.bearings, Some(began(rig.clock.now())));
        let begin = |out: &RunFolder| {
            let (file, place) = out.log()?;
            Journal::new(file, &place, config, bearings, overflow(config), began)
        };
        Ok(Self {
            rows: Vec::new(),
            journal: out.map(begin).transpose()?,
            series: Series::default(),
            last: None,
        })
    }

    /// Why the log can no longer be written, if so.
    pub fn log_error(&self) -> Option<&WriteError> {
        self.journal.as_ref()?.error()
    }

    /// The summary of a run that was carried out. One that was refused before anything moved
    /// leaves nothing in its folder.
    ///
    /// # Errors
    /// Those of the run.
    pub fn close(
        &mut self,
        carried_out: Result<Summary, RunError>,
        out: Option<&RunFolder>,
    ) -> Result<Summary, RunError> {
        if let (Err(_), None, Some(out)) = (&carried_out, self.last, out) {
            drop(self.journal.take());
            out.forget();
        }
        carried_out
    }

    /// Completes the log, and tells the summary where the results are.
    ///
    /// # Errors
    /// The log is not complete.
    pub fn finish(
        &mut self,
        summary: &mut Summary,
        out: Option<&RunFolder>,
    ) -> Result<(), WriteError> {
        if let (Some(journal), Some(last)) = (&mut self.journal, self.last) {
            journal.result(last, summary);
        }
        let logged = self.journal.take().map_or(Ok(()), Journal::finish);
        if let Some(out) = out {
            let place = |path: &Path| Some(path.display().to_string());
            summary.out = place(out.path());
            summary.log = place(&out.path().join("run.mcap"));
            summary.log_complete = Some(logged.is_ok());
        }
        logged
    }
}

/// Simulated time waits for the disk; a real arm does not.
fn overflow(config: &Config) -> Overflow {
    if config.is_real() {
        Overflow::Drop
    } else {
        Overflow::Wait
    }
}

impl Observer for Recorder {
    fn start(&mut self, arm: &ArmState) {
        if let Some(journal) = &mut self.journal {
            journal.start(arm);
        }
    }

    fn inputs(&mut self, arm: &ArmState, shape: Option<&SensedShape>) {
        if let Some(journal) = &mut self.journal {
            journal.inputs(arm, shape);
        }
    }

    fn command(&mut self, command: &RateCommand) {
        if let Some(journal) = &mut self.journal {
            journal.command(command);
        }
    }

    fn images(&mut self, pair: &StereoFrame, tracked: &Tracked) {
        if let Some(journal) = &mut self.journal {
            journal.images(pair, tracked);
        }
    }

    fn marker(&mut self, marker: &SensedMarker) {
        if let Some(journal) = &mut self.journal {
            journal.marker(marker);
        }
    }

    fn step(&mut self, telemetry: &Telemetry) {
        if let Some(journal) = &mut self.journal {
            journal.step(telemetry);
        }
        self.last = Some(telemetry.stamp);
        self.rows.push(self.series.row(telemetry));
    }
}

/// Writes every file of a run that can be written, beside its log.
///
/// # Errors
/// The first file that could not be written.
pub fn write_results(
    out: &Path,
    config: &Config,
    rows: &[Row],
    summary: &Summary,
) -> anyhow::Result<()> {
    let place = |name: &str| out.join(name);
    let title = format!(
        "law {}, phantom {}, seed {}: {}",
        summary.law, summary.phantom, summary.seed, summary.ended
    );
    let plot = place("run.svg");
    let files = [
        save(&place("summary.json"), |file| {
            serde_json::to_writer_pretty(&mut *file, summary)?;
            Ok(writeln!(file)?)
        }),
        save(&place("config.toml"), |file| {
            let text = toml::to_string(config).context("configuration as TOML")?;
            Ok(file.write_all(text.as_bytes())?)
        }),
        save(&place("series.csv"), |file| Ok(write_csv(rows, file)?)),
        write_run_plot(rows, &title, &plot)
            .inspect_err(|_| {
                let _ = std::fs::remove_file(&plot);
            })
            .with_context(|| plot.display().to_string()),
    ];
    files.into_iter().collect()
}

/// A run as its log tells it.
#[derive(Clone, Debug, PartialEq)]
pub struct LoggedRun {
    /// The summary as the log holds it, in JSON; nothing where the run was killed.
    pub summary: Option<String>,
    /// The time series, a row each law step.
    pub rows: Vec<Row>,
    /// The configuration of the run, in TOML.
    pub config: String,
    /// Whether the log is whole.
    pub complete: bool,
}

/// Reads the log of a run.
///
/// # Errors
/// The file cannot be read, is no log of a run, or is damaged in the middle.
pub fn read_log(file: &Path) -> Result<LoggedRun, ReadError> {
    let mut log = LogReader::open(file)?;
    let mut run = LoggedRun {
        summary: None,
        rows: Vec::new(),
        config: log.run().config.clone(),
        complete: false,
    };
    let mut series = Series::default();
    for record in log.by_ref() {
        match record? {
            rosbridge::log::Record::Step(telemetry) => run.rows.push(series.row(&telemetry)),
            rosbridge::log::Record::Document { name, text } if name == "summary.json" => {
                run.summary = Some(text);
            }
            _ => {}
        }
    }
    run.complete = log.is_complete();
    Ok(run)
}

/// Makes a plant of `source`, whose shapes are those of the needle that `config`'s phantom has.
///
/// # Errors
/// The phantom's settings cannot be used.
pub fn own_plant(
    config: &Config,
    source: Box<dyn phantom::ShapeSource>,
) -> Result<PlantMaker, RigBuildError> {
    let settings = config.phantom_settings()?;
    let entry = config.world_from_entry();
    Ok(Box::new(move |world_from_base| {
        let plant = phantom::GivenPlant::new(&settings, &entry, world_from_base, source);
        Ok(Box::new(plant.map_err(RigBuildError::OwnPlant)?))
    }))
}

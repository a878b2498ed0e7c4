//! `run`: one insertion to a target.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::Context;
use clap::{Args, ValueEnum};
use hal::telemetry::Telemetry;
use hal::{Arm, ArmState, RateCommand, SensedShape, Stamp, StereoFrame};
use indicatif::{ProgressBar, ProgressStyle};
use vision::track::Tracked;

use super::{Usage, print_json};
use crate::config::{self, Config};
use crate::controls::Controls;
use crate::host::degrees;
use crate::journal::Journal;
use crate::outcome::Summary;
use crate::plot::write_run_plot;
use crate::rig::{self, Rig};
use crate::ros::{self, Leave, Link, Session};
use crate::run::{Insertion, Observer};
use crate::series::{Row, Series, write_csv};

/// What a dry run does.
#[derive(Clone, Copy, Debug, ValueEnum)]
enum DryRun {
    /// Checks everything, moves nothing.
    Checks,
    /// Moves the arm in air.
    Air,
}

/// One insertion to a target.
#[derive(Debug, Args)]
pub(super) struct RunArgs {
    /// Configuration file (TOML); without it, the paper's shifted-target experiment.
    config: Option<PathBuf>,
    /// Change one key of the configuration: key=value, the value in TOML.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Arm that executes the commands.
    #[arg(long)]
    backend: Option<String>,
    /// Steering law.
    #[arg(long)]
    law: Option<String>,
    /// What closes the loop.
    #[arg(long)]
    sensor: Option<String>,
    /// Preset of the phantom.
    #[arg(long)]
    phantom: Option<String>,
    /// Seed of everything random.
    #[arg(long)]
    seed: Option<u64>,
    /// Check everything, move nothing; with =air, move the arm in air, the controller's own model
    /// in the place of needle and tissue.
    #[arg(
        long,
        value_name = "HOW",
        num_args = 0..=1,
        require_equals = true,
        default_missing_value = "checks"
    )]
    dry_run: Option<DryRun>,
    /// Folder for the results, made if missing; by default the next free `out/NNN-LAW-PHANTOM-SEED`.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
}

impl RunArgs {
    fn config(&self) -> Result<Config, config::ConfigError> {
        let mut overrides = self.set.clone();
        let options = [
            ("run.backend", &self.backend),
            ("run.law", &self.law),
            ("run.sensor", &self.sensor),
            ("run.phantom", &self.phantom),
        ];
        for (key, value) in options {
            overrides.extend(
                value
                    .as_ref()
                    .map(|value| format!("{key}={}", quoted(value))),
            );
        }
        overrides.extend(self.seed.map(|seed| format!("run.seed={seed}")));
        overrides.extend(self.dry_run.map(|how| match how {
            DryRun::Checks => "run.dry_run=true".into(),
            DryRun::Air => "run.dry_run_air=true".into(),
        }));
        config::load(self.config.as_deref(), &overrides)
    }
}

/// A TOML string, so that a name like `1` stays a name.
pub(super) fn quoted(value: &str) -> String {
    toml::Value::String(value.to_owned()).to_string()
}

pub(super) fn execute(args: &RunArgs) -> anyhow::Result<ExitCode> {
    let config = args.config()?;
    if let Some(out) = &args.out {
        is_free(out)?;
    }
    ros::choose_master(&config)?;
    let controls = interrupt_flag()?;
    let link = Link::new(&config)?;
    if let Some(link) = &link {
        link.end_with_node(&controls);
    }
    let mut rig = Rig::build(&config, link.as_ref())?;
    if let Some(note) = rig::assumed_speeds(&config) {
        writeln!(std::io::stderr(), "{note}")?;
    }
    if config.run.dry_run {
        let joints = degrees(&rig.arm.state()?.positions);
        let margins = super::check::margins(&config, &rig.bearings.chain, &rig.course);
        writeln!(std::io::stderr(), "joints {joints} deg\narm: {margins}")?;
    }
    let mut session = match &link {
        Some(link) if config.ros.publish => Some(Session::new(&config, link, &rig, &controls)?),
        _ => None,
    };
    if let Some(session) = &mut session
        && !config.ros.autostart
        && ros::wait(&config, &mut rig, session, &controls)? == Leave::Quit
    {
        return Ok(ExitCode::from(1));
    }
    let out = match &args.out {
        Some(out) => {
            std::fs::create_dir_all(out).with_context(|| out.display().to_string())?;
            Some(out.clone())
        }
        None if config.run.dry_run => None,
        None => next_folder(&config),
    };
    let log = out.as_ref().map(|out| out.join("run.mcap"));
    let journal = match &log {
        Some(file) => Some(Journal::create(file, &config, &rig.bearings)?),
        None => None,
    };
    let mut recorder = Recorder::new(&config, journal, session);
    let mut insertion = Insertion::begin(&config, &mut rig)?;
    let mut summary = insertion.carry_out(&config, &mut recorder, &controls)?;
    recorder.progress.finish_and_clear();
    if let (Some(journal), Some(last)) = (&mut recorder.journal, recorder.last) {
        journal.result(last, &summary);
    }
    let logged = recorder.journal.take().map_or(Ok(()), Journal::finish);
    summary.log = log.map(|file| file.display().to_string());
    if let Some(out) = &out {
        summary.out = Some(out.display().to_string());
        write_results(out, &config, &recorder.rows, &summary)?;
    }
    if args.json {
        print_json(&summary)?;
    } else {
        print_text(&summary)?;
    }
    logged.context("the log is not complete")?;
    if let Some(session) = &mut recorder.session {
        session.show_end(&summary.ended);
        if config.ros.stay {
            ros::stay(&config, &mut insertion, session, &controls)?;
        }
    }
    Ok(if summary.ended.is_success() {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(1)
    })
}

/// Refuses a folder with the results of another run.
fn is_free(folder: &Path) -> Result<(), Usage> {
    let holds = |name: &str| {
        std::fs::metadata(folder.join(name)).is_ok_and(|found| found.is_file() && found.len() > 0)
    };
    match ["run.mcap", "summary.json"]
        .into_iter()
        .find(|name| holds(name))
    {
        None => Ok(()),
        Some(name) => Err(Usage(format!(
            "{} holds the results of another run ({name}): nothing is written over; name another folder",
            folder.display()
        ))),
    }
}

/// The next free folder under `out`; nothing, with a warning, where none can be made.
fn next_folder(config: &Config) -> Option<PathBuf> {
    let name = format!(
        "{}-{}-{}",
        config.run.law, config.run.phantom, config.run.seed
    );
    let make = || {
        let parent = Path::new("out");
        std::fs::create_dir_all(parent)?;
        let taken = std::fs::read_dir(parent)?
            .filter_map(|entry| {
                entry
                    .ok()?
                    .file_name()
                    .to_str()?
                    .split('-')
                    .next()?
                    .parse()
                    .ok()
            })
            .max()
            .unwrap_or(0_u32);
        let folder = parent.join(format!("{:03}-{name}", taken + 1));
        // Fails if another run took it meanwhile: nothing is ever written over.
        std::fs::create_dir(&folder).map(|()| folder)
    };
    make()
        .inspect_err(|error| {
            let _ = writeln!(
                std::io::stderr(),
                "no folder for results under out ({error}); --out DIR names another"
            );
        })
        .ok()
}

/// A flag that Ctrl-C and SIGTERM raise; the run then stops the arm and ends.
pub(super) fn interrupt_flag() -> anyhow::Result<Arc<Controls>> {
    let flag = Arc::new(Controls::default());
    let raised = Arc::clone(&flag);
    ctrlc::set_handler(move || raised.interrupt()).context("installing the signal handler")?;
    Ok(flag)
}

/// Keeps the time series and draws the progress line.
struct Recorder {
    journal: Option<Journal>,
    session: Option<Session>,
    rows: Vec<Row>,
    series: Series,
    last: Option<Stamp>,
    progress: ProgressBar,
    depth_mm: f64,
}

impl Recorder {
    fn new(config: &Config, journal: Option<Journal>, session: Option<Session>) -> Self {
        let depth_mm = config.target.depth_mm + 10.0;
        let progress = ProgressBar::new(1000);
        progress.set_style(
            ProgressStyle::with_template("{bar:30} {msg}")
                .unwrap_or_else(|_| ProgressStyle::default_bar()),
        );
        Self {
            journal,
            session,
            rows: Vec::new(),
            series: Series::default(),
            last: None,
            progress,
            depth_mm,
        }
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

    fn arm(&mut self, state: &ArmState) {
        if let Some(session) = &mut self.session {
            session.arm(state);
        }
    }

    fn images(&mut self, pair: &StereoFrame, tracked: &Tracked) {
        if let Some(session) = &mut self.session {
            session.images(pair, tracked);
        }
        if let Some(journal) = &mut self.journal {
            journal.images(pair, tracked);
        }
    }

    fn step(&mut self, telemetry: &Telemetry) {
        if let Some(session) = &mut self.session {
            session.step(telemetry);
        }
        if let Some(journal) = &mut self.journal {
            journal.step(telemetry);
        }
        self.last = Some(telemetry.stamp);
        self.rows.push(self.series.row(telemetry));
        if telemetry.step % 15 == 1 {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "clamped to 0..=1000"
            )]
            let part = (telemetry.depth * 1e6 / self.depth_mm).clamp(0.0, 1000.0) as u64;
            self.progress.set_position(part);
            self.progress.set_message(format!(
                "depth {:5.1} mm, target {:5.2} mm off axis, predicted miss {:5.2} mm, K_T {:6.0} N/m2, {:?}",
                telemetry.depth * 1e3,
                telemetry.lateral_error * 1e3,
                telemetry.law.predicted_miss.norm() * 1e3,
                telemetry.model.stiffness,
                telemetry.law.mode,
            ));
        }
    }
}

fn write_results(
    out: &Path,
    config: &Config,
    rows: &[Row],
    summary: &Summary,
) -> anyhow::Result<()> {
    let place = |name: &str| out.join(name);
    let text = toml::to_string(config).context("configuration as TOML")?;
    std::fs::write(place("config.toml"), text).with_context(|| out.display().to_string())?;
    let csv =
        std::fs::File::create(place("series.csv")).with_context(|| out.display().to_string())?;
    write_csv(rows, std::io::BufWriter::new(csv)).with_context(|| out.display().to_string())?;
    let mut json = serde_json::to_vec_pretty(summary)?;
    json.push(b'\n');
    std::fs::write(place("summary.json"), json).with_context(|| out.display().to_string())?;
    let title = format!(
        "law {}, phantom {}, seed {}: {}",
        summary.law, summary.phantom, summary.seed, summary.ended
    );
    write_run_plot(rows, &title, &place("run.svg"))?;
    Ok(())
}

fn print_text(summary: &Summary) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    let mm = |value: Option<f64>| value.map_or("unknown".into(), |v| format!("{v:.3} mm"));
    writeln!(out, "{}", summary.ended)?;
    writeln!(out, "  true error      {}", mm(summary.true_error_mm))?;
    writeln!(out, "  measured error  {}", mm(summary.measured_error_mm))?;
    writeln!(out, "  along the axis  {}", mm(summary.axial_error_mm))?;
    writeln!(
        out,
        "  tissue stretch  {:.2} mm largest, {:.2} mm mean",
        summary.max_stretch_mm, summary.mean_stretch_mm
    )?;
    writeln!(
        out,
        "  duration        {:.1} s, {} steps",
        summary.duration_s, summary.steps
    )?;
    if let Some(folder) = &summary.out {
        writeln!(out, "  results         {folder}")?;
    }
    Ok(())
}

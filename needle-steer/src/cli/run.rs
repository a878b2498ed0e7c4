//! `run`: one insertion to a target.

use std::io::Write;
use std::path::PathBuf;
use std::process::ExitCode;
use std::sync::Arc;

use anyhow::Context;
use clap::{Args, ValueEnum};
use hal::telemetry::Telemetry;
use hal::{Arm, ArmMode, ArmState, RateCommand, SensedMarker, SensedShape, StereoFrame};
use hybrid_control::LAW_NAMES;
use indicatif::{ProgressBar, ProgressStyle};
use phantom::settings::PRESETS;
use vision::track::Tracked;

use super::dead_man;
use super::print_json;
use super::served::Served;
use super::way_out::with_way_out;
use crate::clock::WallTime;
use crate::config::{self, Config};
use crate::controls::Controls;
use crate::hand::Prompt;
use crate::host::degrees;
use crate::outcome::{Ended, Summary};
use crate::record::{Recorder, write_results};
use crate::results::RunFolder;
use crate::rig::{self, NotAtStart, Pace, Rig, RigBuildError};
use crate::ros::{self, Link};
use crate::run::{Insertion, Observer};
use crate::session::{self, Leave, Session};
use crate::strut::Strut;
use crate::supervisor::StopReason;

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
    /// Arm that executes the commands: sim, viper, ros [default: run.backend, sim].
    #[arg(long)]
    backend: Option<String>,
    /// Steering law [default: run.law, hybrid].
    #[arg(long, value_parser = clap::builder::PossibleValuesParser::new(LAW_NAMES))]
    law: Option<String>,
    /// What closes the loop: images, shape, em, fbg [default: run.sensor, images].
    #[arg(long)]
    sensor: Option<String>,
    /// Preset of the phantom [default: run.phantom, paper].
    #[arg(long, value_parser = clap::builder::PossibleValuesParser::new(PRESETS))]
    phantom: Option<String>,
    /// Seed of everything random [default: run.seed, 1].
    #[arg(long, value_parser = super::seed)]
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
    #[command(flatten)]
    served: Served,
    /// Folder for the results, made if missing; by default the next free `out/NNN-LAW-PHANTOM-SEED`.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
    /// Write the page of the run (`report`) and show it in the browser.
    #[arg(long, conflicts_with = "dry_run")]
    open: bool,
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
                    .map(|value| format!("{key}={}", config::quoted(value))),
            );
        }
        overrides.extend(self.served.overrides());
        overrides.extend(self.seed.map(|seed| format!("run.seed={seed}")));
        overrides.extend(self.dry_run.map(|how| match how {
            DryRun::Checks => "run.dry_run=true".into(),
            DryRun::Air => "run.dry_run_air=true".into(),
        }));
        config::load(self.config.as_deref(), &overrides)
    }
}

pub(super) fn execute(args: &RunArgs) -> anyhow::Result<ExitCode> {
    let config = args.config()?;
    super::tell_doubts(&config);
    ros::choose_master(&config)?;
    // A dry run has no results.
    let out = args.out.as_deref().filter(|_| !config.run.dry_run);
    let out = out.map(RunFolder::claim).transpose()?;
    let controls = interrupt_flag()?;
    let link = Link::new(&config)?;
    if let Some(link) = &link {
        link.end_with_node(&controls);
    }
    let _watch = dead_man::watch(&config, link.as_ref(), &controls)?;
    let mut rig =
        build(&config, link.as_ref()).map_err(|error| with_way_out(error, args.out.as_deref()))?;
    if let Some(note) = rig::assumed_speeds(&config) {
        writeln!(std::io::stderr(), "{note}")?;
    }
    if rig.world.is_some() {
        for difference in config.needle_differences() {
            writeln!(std::io::stderr(), "{difference}")?;
        }
    }
    if let Some(problem) = Strut::of(&config).and_then(|strut| strut.problem()) {
        writeln!(std::io::stderr(), "note: {problem}")?;
    }
    if config.run.dry_run {
        let joints = degrees(&rig.arm.state()?.positions);
        let margins = super::check::margins(&config, &rig.bearings.chain, &rig.course);
        writeln!(std::io::stderr(), "joints {joints} deg\narm: {margins}")?;
        if let Some(elsewhere) = elsewhere(&config, &mut rig)? {
            writeln!(std::io::stderr(), "{elsewhere}")?;
            return Ok(ExitCode::SUCCESS);
        }
    }
    let mut session = Session::open(&config, link.as_ref(), &rig, &controls)?;
    if let Some(session) = &mut session {
        session::show(&config, &mut rig, session)?;
        if session.waits(&config, &mut rig)
            && session::wait(&config, &mut rig, session, &controls)? == Leave::Quit
        {
            return Ok(ExitCode::from(1));
        }
    }
    let out = match out {
        None if !config.run.dry_run => next_folder(&config),
        given => given,
    };
    let record = Recorder::new(&config, &rig, out.as_ref())?;
    let mut watcher = Watcher::new(&config, record, session);
    let mut insertion = Insertion::begin(&config, &mut rig)?;
    if config.run.dry_run
        && let Ok(words) = insertion.preview(&config)
    {
        writeln!(std::io::stderr(), "{words}")?;
    }
    insertion.folder = out.as_ref().map(|out| out.path().to_owned());
    let carried_out = insertion.carry_out(&config, &mut watcher, &controls);
    let mut summary = watcher.record.close(carried_out, out.as_ref())?;
    watcher.progress.finish_and_clear();
    let logged = watcher.record.finish(&mut summary, out.as_ref());
    // The verdict first: whatever becomes of the files, it is known.
    let printed = if args.json {
        print_json(&summary)
    } else {
        print_text(&summary, config.run.dry_run_air).map_err(anyhow::Error::from)
    };
    let written = out.as_ref().map_or(Ok(()), |out| {
        write_results(out.path(), &config, &watcher.record.rows, &summary)
    });
    if let Some(session) = &mut watcher.session {
        session.show_end(&summary.ended);
        if let (true, Some(why)) = (config.stays(), controls.why_interrupted()) {
            let log = summary.log.as_deref().unwrap_or("LOG");
            writeln!(
                std::io::stderr(),
                "the node cannot stay ({why}): nobody reaches it by its name any more, and while \
                 it held the arm no other could; `needle-steer withdraw {log}` takes the needle out"
            )?;
        }
        if config.stays() {
            session.stay(&config, &mut insertion, &controls)?;
        }
    }
    printed?;
    written?;
    logged.context("the log is not complete")?;
    if let (true, Some(out)) = (args.open, &out) {
        super::report::write_and_show(out.path())?;
    }
    Ok(if summary.ended.is_success() {
        ExitCode::SUCCESS
    } else {
        ExitCode::from(1)
    })
}

/// What keeps a real arm from the insertion that a dry run previews: a fault, or another place than the
/// start.
fn elsewhere(config: &Config, rig: &mut Rig) -> Result<Option<String>, hal::Error> {
    if !config.is_real() {
        return Ok(None);
    }
    let state = rig.arm.state()?;
    let mut words = Vec::new();
    if let ArmMode::Faulted(fault) = state.mode {
        let words_of_arm = rig.arm.explanation();
        words.push(
            StopReason::ArmFault {
                fault,
                words: words_of_arm,
            }
            .to_string(),
        );
    }
    let chain = &rig.bearings.chain;
    if let Err(away) = NotAtStart::check(chain, &state.positions, &rig.home) {
        words.push(format!(
            "{away}. The target is judged from there: `needle-steer check` and a dry run at the start say \
             whether it can be reached"
        ));
    }
    Ok((!words.is_empty()).then(|| words.join("\n")))
}

/// Somebody who holds a switch or watches does so on the wall clock: a simulated world keeps step
/// with it.
fn build(config: &Config, link: Option<&Link>) -> Result<Rig, RigBuildError> {
    let by_hand = config.supervisor.dead_man_ms > 0.0 || config.is_watched();
    if by_hand && link.is_none() && !config.is_real() {
        Rig::simulated(config, Pace::Paced(WallTime::start()))
    } else {
        Rig::build(config, link)
    }
}

/// The next free folder under `out`; nothing, with a warning, where none can be made.
fn next_folder(config: &Config) -> Option<RunFolder> {
    RunFolder::next(config)
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

/// Keeps the record of the run, shows it over ROS and draws the progress line.
struct Watcher {
    record: Recorder,
    session: Option<Session>,
    /// Whether the user was told that the log failed.
    told: bool,
    progress: ProgressBar,
    depth_mm: f64,
}

impl Watcher {
    fn new(config: &Config, record: Recorder, session: Option<Session>) -> Self {
        let depth_mm = config.target.depth_mm + 10.0;
        let progress = ProgressBar::new(1000);
        progress.set_style(
            ProgressStyle::with_template("{bar:30} {msg}")
                .unwrap_or_else(|_| ProgressStyle::default_bar()),
        );
        Self {
            record,
            session,
            told: false,
            progress,
            depth_mm,
        }
    }
}

impl Observer for Watcher {
    fn start(&mut self, arm: &ArmState) {
        self.record.start(arm);
    }

    fn prompt(&mut self, prompt: Prompt) {
        // On a line of its own: the operator reads it, and the bar goes on below.
        self.progress.suspend(|| {
            let _ = writeln!(std::io::stderr(), "{prompt}");
        });
    }

    fn inputs(&mut self, arm: &ArmState, shape: Option<&SensedShape>) {
        self.record.inputs(arm, shape);
    }

    fn command(&mut self, command: &RateCommand) {
        self.record.command(command);
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
        self.record.images(pair, tracked);
    }

    fn marker(&mut self, marker: &SensedMarker) {
        self.record.marker(marker);
    }

    fn step(&mut self, telemetry: &Telemetry) {
        if let Some(session) = &mut self.session {
            session.step(telemetry);
        }
        self.record.step(telemetry);
        let failed = self.record.log_error();
        if !core::mem::replace(&mut self.told, failed.is_some())
            && let Some(error) = failed
        {
            let _ = writeln!(
                std::io::stderr(),
                "the log can no longer be written ({}); the insertion goes on",
                std::error::Error::source(error).unwrap_or(error)
            );
        }
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

/// The verdict in words; `in_air` nothing was inserted, and no truth was missed.
fn print_text(summary: &Summary, in_air: bool) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    let mm = |value: Option<f64>| value.map_or("unknown".into(), |v| format!("{v:.3} mm"));
    writeln!(out, "{}", summary.ended)?;
    if summary.ended == Ended::DryRun {
        return Ok(());
    }
    if summary.ended == Ended::TargetPassed {
        let (hit, side) = if summary.hit {
            ("yes", "within")
        } else {
            ("no", "beyond")
        };
        let goal = summary.goal_mm;
        writeln!(
            out,
            "  hit             {hit} (measured error {side} {goal} mm)"
        )?;
    }
    if in_air {
        writeln!(
            out,
            "  in air          the controller's own model stood for needle and tissue"
        )?;
        return print_end(&mut out, summary, false);
    }
    writeln!(out, "  true error      {}", mm(summary.true_error_mm))?;
    if let Some(error) = summary.true_error_less_bias_mm {
        writeln!(out, "  less the bias   {}", mm(Some(error)))?;
    }
    writeln!(out, "  measured error  {}", mm(summary.measured_error_mm))?;
    writeln!(out, "  along the axis  {}", mm(summary.axial_error_mm))?;
    writeln!(
        out,
        "  tissue stretch  {:.2} mm largest, {:.2} mm mean",
        summary.max_stretch_mm, summary.mean_stretch_mm
    )?;
    print_end(&mut out, summary, summary.ended != Ended::Retracted)
}

/// How long it took and where the results are; the way out where the needle may be in tissue.
fn print_end(out: &mut impl Write, summary: &Summary, inside: bool) -> std::io::Result<()> {
    writeln!(
        out,
        "  duration        {:.1} s, {} steps",
        summary.duration_s, summary.steps
    )?;
    if let Some(folder) = &summary.out {
        writeln!(out, "  results         {folder}")?;
    }
    if let (Some(log), true) = (&summary.log, inside) {
        writeln!(out, "  way out         needle-steer withdraw {log}")?;
    }
    Ok(())
}

//! `withdraw`: the needle out of the tissue, in a new process, by the log of the insertion.

use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::ExitCode;

use clap::Args;
use hal::Arm;

use super::run::interrupt_flag;
use super::{print_json, unusable};
use crate::config::quoted;
use crate::config::{Backend, Config};
use crate::controls::Wish;
use crate::host::degrees;
use crate::observer::{Observer, Unobserved};
use crate::results::check_free;
use crate::rig::Rig;
use crate::ros::{self, Link};
use crate::session::Session;
use crate::withdrawal::{self, Record, Recording, Request, Summary};

/// The needle out of the tissue: the base goes back along the recorded path, whatever stopped the
/// insertion. Clears a latched fault of the arm whose cause is gone.
#[derive(Debug, Args)]
pub(super) struct WithdrawArgs {
    /// Log of the insertion (run.mcap), complete or not; or of a withdrawal that was stopped.
    log: PathBuf,
    /// Arm that holds the needle; by default that of the log.
    #[arg(long)]
    backend: Option<String>,
    /// Change one key of the log's configuration: key=value, the value in TOML.
    #[arg(long, value_name = "KEY=VALUE")]
    set: Vec<String>,
    /// Folder for the results, made if missing; by default the next free `withdrawal-N` beside
    /// the insertion's log.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Print the summary as JSON.
    #[arg(long)]
    json: bool,
}

pub(super) fn execute(args: &WithdrawArgs) -> anyhow::Result<ExitCode> {
    if let Some(out) = &args.out {
        check_free(&out.join("run.mcap"))?;
        check_free(&out.join("summary.json"))?;
    }
    let mut overrides = args.set.clone();
    let backend = args.backend.as_ref();
    overrides.extend(backend.map(|name| format!("run.backend={}", quoted(name))));
    let mut recording =
        Recording::read(&args.log, &overrides).map_err(|error| unusable(&args.log, error))?;
    let mut config = recording.config.clone();
    let rebuilt = lives_in_its_process(&config);
    // What is simulated is told by its log alone.
    config.ros.publish &= !rebuilt;
    // An address that is taken is no reason to leave the needle in.
    config.igtl.serve = false;
    config.live.serve = false;
    ros::choose_master(&config)?;
    let controls = interrupt_flag()?;
    let link = Link::new(&config)?;
    let mut rig = if rebuilt {
        withdrawal::rebuild(&config, &recording)?
    } else {
        Rig::arm_only(&config, link.as_ref())?
    };
    let mut session = Session::open(&config, link.as_ref(), &rig, &controls)?;
    controls.ask(Wish::Retract);
    let log = Some(args.log.as_path());
    let record = if let Some(out) = &args.out {
        Record::create(out.clone(), &config, &rig, log)
    } else {
        let beside = recording.insertion.parent().unwrap_or(Path::new("."));
        Record::beside(beside, &config, &rig, log)
    };
    let lead = recording.lead();
    let request = Request {
        path: &mut recording.path,
        lead,
        last_step: recording.last_step,
    };
    let mut nobody = Unobserved;
    let observer: &mut dyn Observer = match &mut session {
        Some(session) => session,
        None => &mut nobody,
    };
    let summary = withdrawal::withdraw(&config, &mut rig, request, observer, &controls, record);
    if args.json {
        print_json(&summary)?;
    } else {
        print_text(&summary)?;
    }
    if summary.ended.is_success() {
        return Ok(ExitCode::SUCCESS);
    }
    if let Ok(state) = rig.arm.state() {
        let (here, logged) = (
            degrees(&state.positions),
            degrees(&recording.last.positions),
        );
        writeln!(
            std::io::stderr(),
            "joints {here} deg, {:?}; logged last {logged} deg",
            state.mode
        )?;
    }
    Ok(ExitCode::from(1))
}

/// Whether the arm ended with the process that wrote the log.
fn lives_in_its_process(config: &Config) -> bool {
    match config.run.backend {
        Backend::Sim => true,
        Backend::Viper => config.viper.emulate,
        Backend::Ros => false,
    }
}

fn print_text(summary: &Summary) -> std::io::Result<()> {
    let mut out = std::io::stdout().lock();
    writeln!(out, "{}", summary.ended)?;
    writeln!(out, "  withdrawn       {:.2} mm", summary.withdrawn_mm)?;
    writeln!(out, "  left            {:.2} mm", summary.left_mm)?;
    if summary.gap_mm > 0.0 {
        let gap = summary.gap_mm;
        writeln!(out, "  not recorded    {gap:.2} mm, driven straight")?;
    }
    writeln!(
        out,
        "  beside the path {:.2} mm at most",
        summary.off_path_mm
    )?;
    if let Some(depth) = summary.tip_depth_mm {
        writeln!(out, "  tip             {depth:.2} mm below the surface")?;
    }
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

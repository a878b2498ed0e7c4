//! The kinds of stop that docs/WITHDRAWAL.md lists: after each of them one withdrawal takes the
//! needle to the surface, in the process that was stopped and in another one by its log, on every back end that runs in one process. `ros::ways_out` runs the
//! same list over a master.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Duration;

use hal::telemetry::{Phase, Telemetry};
use hal::{
    ArmState, Clock, Error, ErrorKind, GrayImage, RateCommand, SensedShape, ShapeSensor, Stamp,
    StereoCamera, StereoFrame,
};
use nalgebra::Point3;
use needle_steer::config::{self, Backend, Config};
use needle_steer::controls::Controls;
use needle_steer::cycle::base_pose;
use needle_steer::journal::Journal;
use needle_steer::rig::{Eyes, Rig};
use needle_steer::run::{Insertion, Observer, Unobserved};
use needle_steer::withdrawal::{self, Recording, Request, Verdict, rebuild, withdraw};
use robots::sim::{Fault, SimulatedArm};
use robots::viper::Emulator;
use rosbridge::log::{LogReader, Record};

/// The step at which something happens: about 12 mm deep.
const MOMENT: u64 = 400;

/// What is done to a run at [`MOMENT`], and from then on.
#[derive(Clone, Copy)]
pub(crate) enum Act {
    /// Nothing: the settings lead to the stop.
    Nothing,
    /// To what the sensor says.
    Sight(fn(SensedShape) -> Result<Option<SensedShape>, Error>),
    /// To the images.
    Blank,
    /// By the operator.
    Operator(fn(&Controls)),
    /// The operator holds the dead-man's switch until then.
    LetGo,
    /// To the arm; afterwards it is mended.
    Arm(Fault),
    /// A command is late.
    Late,
}

/// A kind of stop.
pub(crate) struct Kind {
    /// Its name in docs/WITHDRAWAL.md.
    name: &'static str,
    /// What the verdict says, in small letters.
    told: &'static str,
    /// Settings beside those of every run.
    settings: &'static [&'static str],
    act: Act,
}

const fn kind(
    name: &'static str,
    told: &'static str,
    settings: &'static [&'static str],
    act: Act,
) -> Kind {
    Kind {
        name,
        told,
        settings,
        act,
    }
}

const LINK: &str = "link lost and back";

/// The kinds; killed programs and full disks are whole processes (`needle-steer/tests/program/withdraw.rs`).
static KINDS: [Kind; 15] = [
    kind("no image", "no image", &[], Act::Sight(|_| Ok(None))),
    kind(
        "needle lost in the images",
        "not found in the images",
        &["run.sensor=images"],
        Act::Blank,
    ),
    kind(
        "a sensor in other units",
        "units",
        &[],
        Act::Sight(|shape| Ok(Some(in_millimetres(shape)))),
    ),
    kind(
        "a sensor that is gone",
        "not connected",
        &[],
        Act::Sight(|_| Err(Error::new("tracker", ErrorKind::Disconnected))),
    ),
    kind(
        "measurements late",
        "old when they arrive",
        &[],
        Act::Sight(|mut shape| {
            shape.stamp = Stamp::from_secs(shape.stamp.as_secs() - 1.0);
            Ok(Some(shape))
        }),
    ),
    kind(
        "a bound",
        "tissue stretched by",
        &[
            "supervisor.tissue_stretch_mm=0.4",
            "limits.entry_stretch_mm=0.4",
            "target.depth_mm=80",
            "target.offset_mm=10",
        ],
        Act::Nothing,
    ),
    kind(
        "stall or buckling",
        "the shaft",
        &[
            "run.seed=770001",
            "run.check_reach=false",
            "phantom.friction.shaft_n_m=100.0",
            // Else the law gives the target up to spare the tissue.
            "run.law=none",
            // Else the shaft is found beside its path first.
            "supervisor.tissue_stretch_mm=20.0",
            "target.depth_mm=80",
            "target.offset_mm=10",
        ],
        Act::Nothing,
    ),
    kind(
        "target out of reach on the way",
        "target out of reach",
        &[
            "target.depth_mm=80",
            "target.offset_mm=12",
            "target.angle_deg=0",
            "limits.tilt_deg=1",
            "limits.base_offset_mm=3",
            "estimator.cut_angle_deg=15",
            "phantom.tip.cut_angle_deg=2",
        ],
        Act::Nothing,
    ),
    kind(
        "target refused, then stopped",
        "interrupted",
        &[],
        Act::Operator(|controls| {
            controls.aim_then(hal::Position::new(Point3::new(0.0, 0.0, 17.0)), |answer| {
                assert!(answer.is_err());
            });
            controls.stop();
        }),
    ),
    kind(
        "emergency stop and reset",
        "emergencystop",
        &[],
        Act::Arm(Fault::EmergencyStop),
    ),
    kind(LINK, "connection", &[], Act::Arm(Fault::ConnectionLost)),
    kind("a late command", "rejected", &[], Act::Late),
    kind(
        "Ctrl-C",
        "interrupted",
        &[],
        Act::Operator(Controls::interrupt),
    ),
    kind(
        "dead-man's switch",
        "dead-man",
        &["supervisor.dead_man_ms=300"],
        Act::LetGo,
    ),
    kind(
        "time out",
        "timed out",
        &["run.max_duration_s=15"],
        Act::Nothing,
    ),
];

fn in_millimetres(mut shape: SensedShape) -> SensedShape {
    let scale = |p: &mut hal::Position<hal::frame::LeftCamera>| {
        *p = hal::Position::new((p.coords() * 1e3).into());
    };
    scale(&mut shape.tip.position);
    shape
        .points
        .iter_mut()
        .for_each(|point| scale(&mut point.position));
    shape
}

/// The configuration of a kind.
pub(crate) fn config_of(kind: &Kind, backend: Backend) -> Config {
    let common = [
        "run.sensor=shape",
        "target.depth_mm=40",
        "target.offset_mm=1",
    ];
    let all = common.iter().chain(kind.settings).map(ToString::to_string);
    let mut config = config::load(None, &all.collect::<Vec<_>>()).unwrap();
    config.run.backend = backend;
    config
}

/// What moves the needle in truth.
pub(crate) enum Machine {
    Simulated(SimulatedArm),
    Emulated(Emulator),
    /// The arm of an emulated laboratory: at the robot its fault is cleared, too.
    Laboratory(SimulatedArm),
}

impl Machine {
    fn of(rig: &Rig) -> Self {
        match (&rig.simulated_arm, &rig.emulator) {
            (Some(arm), _) => Self::Simulated(arm.clone()),
            (None, Some(emulator)) => Self::Emulated(emulator.clone()),
            (None, None) => panic!("this rig has no machine in this process"),
        }
    }

    /// The fault comes, or its cause is gone.
    fn turn(&self, fault: Fault, on: bool) {
        match self {
            Self::Simulated(arm) | Self::Laboratory(arm) if on => arm.inject(fault),
            Self::Simulated(arm) => arm.clear(fault),
            Self::Laboratory(arm) => {
                arm.clear(fault);
                hal::Arm::reset(&mut arm.driver()).unwrap();
            }
            Self::Emulated(emulator) => emulator.turn(|knobs| match fault {
                Fault::EmergencyStop => (knobs.e_stop, knobs.powered) = (on, !on),
                Fault::DrivesOff => knobs.powered = !on,
                Fault::Manual => knobs.mode = if on { 1 } else { 2 },
                Fault::ControllerError => knobs.error_code = if on { 7 } else { 0 },
                Fault::FeedbackFrozen => knobs.freeze_feedback = on,
                other => panic!("the emulated controller has no {other:?}"),
            }),
        }
    }
}

/// A sensor to which something happens once the moment has come.
struct Tampered {
    sensor: Box<dyn ShapeSensor>,
    come: Arc<AtomicBool>,
    act: fn(SensedShape) -> Result<Option<SensedShape>, Error>,
}

impl ShapeSensor for Tampered {
    fn poll(&mut self) -> Result<Option<SensedShape>, Error> {
        match self.sensor.poll()? {
            Some(shape) if self.come.load(Ordering::Relaxed) => (self.act)(shape),
            seen => Ok(seen),
        }
    }
}

/// Cameras that see only paper once the moment has come.
struct Covered(Box<dyn StereoCamera>, Arc<AtomicBool>);

impl StereoCamera for Covered {
    fn poll(&mut self) -> Result<Option<StereoFrame>, Error> {
        let mut seen = self.0.poll()?;
        if let (Some(pair), true) = (&mut seen, self.1.load(Ordering::Relaxed)) {
            for frame in [&mut pair.left, &mut pair.right] {
                let (width, height) = (frame.image.width(), frame.image.height());
                frame.image = GrayImage::filled(width, height, 200).into();
            }
        }
        Ok(seen)
    }
}

/// A clock that is read 150 ms late once.
struct Starved(Box<dyn Clock>, Arc<AtomicBool>);

impl Clock for Starved {
    fn now(&self) -> Stamp {
        let now = self.0.now();
        if self.1.swap(false, Ordering::Relaxed) {
            return Stamp::from_secs(now.as_secs() - 0.15);
        }
        now
    }

    fn wait_until(&mut self, deadline: Stamp) {
        self.0.wait_until(deadline);
    }
}

/// Keeps the log of a run to which something is done at every step.
struct Logged<F> {
    journal: Journal,
    act: F,
}

impl<F: FnMut(&Telemetry)> Observer for Logged<F> {
    fn start(&mut self, arm: &ArmState) {
        self.journal.start(arm);
    }

    fn inputs(&mut self, arm: &ArmState, shape: Option<&SensedShape>) {
        self.journal.inputs(arm, shape);
    }

    fn step(&mut self, telemetry: &Telemetry) {
        self.journal.step(telemetry);
        (self.act)(telemetry);
    }

    fn command(&mut self, command: &RateCommand) {
        self.journal.command(command);
    }
}

/// Depth of the true tip below the surface [mm].
fn tip_depth_mm(config: &Config, rig: &Rig) -> f64 {
    let tip = rig.world.as_ref().unwrap().true_tip() - config.entry().coords;
    tip.dot(&config.inward()) * 1e3
}

/// An insertion on `rig` that ends as `kind` says, and the withdrawal after it; twice: then there is
/// nothing left to withdraw. Answers the log of the insertion.
pub(crate) fn stop_and_withdraw(
    kind: &Kind,
    config: &Config,
    mut rig: Rig,
    machine: &Machine,
) -> PathBuf {
    let name = kind.name;
    let start = base_pose(&rig.bearings, &hal::Arm::state(&mut rig.arm).unwrap());
    let come = Arc::new(AtomicBool::new(false));
    match (kind.act, core::mem::replace(&mut rig.eyes, Eyes::none())) {
        (Act::Sight(act), Eyes::Shape(sensor)) => {
            let come = Arc::clone(&come);
            rig.eyes = Eyes::Shape(Box::new(Tampered { sensor, come, act }));
        }
        (Act::Blank, Eyes::Cameras(cameras)) => {
            rig.eyes = Eyes::Cameras(Box::new(Covered(cameras, Arc::clone(&come))));
        }
        (_, eyes) => rig.eyes = eyes,
    }
    if matches!(kind.act, Act::Late) {
        let clock = core::mem::replace(&mut rig.clock, Box::new(Stopped));
        rig.clock = Box::new(Starved(clock, Arc::clone(&come)));
    }
    let controls = Controls::default();
    let folder = folder(kind, config);
    let log = folder.join("run.mcap");
    let journal = Journal::create(&log, config, &rig.bearings).unwrap();
    let mut insertion = Insertion::begin(config, &mut rig).unwrap();
    insertion.folder = Some(folder);
    let act = |t: &Telemetry| {
        if matches!(kind.act, Act::LetGo) && t.step <= MOMENT {
            controls.refresh_dead_man();
        }
        if t.step != MOMENT {
            return;
        }
        come.store(true, Ordering::Relaxed);
        match kind.act {
            Act::Operator(act) => act(&controls),
            Act::Arm(fault) => machine.turn(fault, true),
            _ => {}
        }
    };
    let mut logged = Logged { journal, act };
    let summary = insertion.carry_out(config, &mut logged, &controls).unwrap();
    logged.journal.finish().unwrap();
    let ended = summary.ended.to_string().to_lowercase();
    assert!(ended.contains(kind.told), "{name}: {ended}");
    assert!(!summary.ended.is_success(), "{name}: {ended}");
    let deep = tip_depth_mm(config, insertion.rig);
    assert!(deep > 5.0, "{name}: only {deep} mm deep");
    if let Act::Arm(fault) = kind.act {
        let later = insertion.rig.clock.now() + Duration::from_millis(500);
        insertion.rig.clock.wait_until(later);
        machine.turn(fault, false);
        // The news has to come through.
        let later = insertion.rig.clock.now() + Duration::from_millis(500);
        insertion.rig.clock.wait_until(later);
    }
    // A new wish, as of a new command.
    let controls = Controls::default();
    let out = insertion.withdraw(config, &mut Unobserved, &controls);
    assert_eq!(out.ended, Verdict::Retracted, "{name}: {out:?}");
    assert!(out.log_complete, "{name}: {out:?}");
    let own = LogReader::open(Path::new(out.log.as_ref().unwrap())).unwrap();
    let retracting = own.filter(
        |record| matches!(record, Ok(Record::Step(step)) if step.phase == Phase::Retracting),
    );
    assert_eq!(retracting.count() as u64, out.steps, "{name}");
    assert!(
        out.withdrawn_mm > 5.0 && out.left_mm < 0.2,
        "{name}: {out:?}"
    );
    let depth = tip_depth_mm(config, insertion.rig);
    assert!(depth < 1.0, "{name}: the tip is {depth} mm deep");
    let state = hal::Arm::state(&mut insertion.rig.arm).unwrap();
    let end = base_pose(&insertion.rig.bearings, &state);
    let apart = (end.translation.vector - start.translation.vector).norm();
    assert!(apart < 0.3e-3, "{name}: {apart} m from the start");
    let again = insertion.withdraw(config, &mut Unobserved, &controls);
    assert_eq!(again.ended, Verdict::AtStart, "{name}");
    log
}

/// A folder of a test's own, made anew.
fn folder(kind: &Kind, config: &Config) -> PathBuf {
    let (backend, own) = (config.run.backend, std::process::id());
    let name = format!("ways-out-{own}/{backend:?}/{}", kind.name.replace(' ', "-"));
    let folder = std::env::temp_dir().join(name);
    std::fs::create_dir_all(&folder).unwrap();
    folder
}

/// Removes what a kind of stop that was tried has written.
pub(crate) fn forget(log: &Path) {
    std::fs::remove_dir_all(log.parent().unwrap()).unwrap();
}

/// What `needle-steer withdraw LOG` does in another process, where the simulated world is gone: the
/// world as it was when the insertion ended, and the needle out of that.
fn withdraw_by(log: &Path, kind: &Kind) {
    let mut recording = Recording::read(log, &[]).unwrap();
    let config = recording.config.clone();
    let mut rig = rebuild(&config, &recording).unwrap();
    let deep = tip_depth_mm(&config, &rig);
    assert!(deep > 5.0, "{}: rebuilt only {deep} mm deep", kind.name);
    let (lead, last_step) = (recording.lead(), recording.last_step);
    let path = &mut recording.path;
    let request = Request {
        path,
        lead,
        last_step,
    };
    let controls = Controls::default();
    let (nobody, record) = (&mut Unobserved, withdrawal::Record::none());
    let out = withdraw(&config, &mut rig, request, nobody, &controls, record);
    assert_eq!(out.ended, Verdict::Retracted, "{}: {out:?}", kind.name);
    let depth = tip_depth_mm(&config, &rig);
    assert!(depth < 1.0, "{}: the tip is {depth} mm deep", kind.name);
}

/// Stands in for a clock while one is exchanged.
struct Stopped;

impl Clock for Stopped {
    fn now(&self) -> Stamp {
        Stamp::ZERO
    }

    fn wait_until(&mut self, _: Stamp) {}
}

/// What the kinds are called.
pub(crate) fn names() -> impl Iterator<Item = &'static str> {
    KINDS.iter().map(|kind| kind.name)
}

/// Those in which no link between processes has to come back: in lockstep none does, and on the wall
/// clock needle-steer/tests has it.
pub(crate) fn in_lockstep() -> impl Iterator<Item = &'static Kind> {
    KINDS.iter().filter(|kind| kind.name != LINK)
}

/// Tries all `kinds`, and names every one that fails.
pub(crate) fn each<'a>(kinds: impl IntoIterator<Item = &'a Kind>, attempt: impl Fn(&Kind)) {
    let fails = |kind: &&Kind| catch_unwind(AssertUnwindSafe(|| attempt(kind))).is_err();
    let failed: Vec<_> = kinds
        .into_iter()
        .filter(fails)
        .map(|kind| kind.name)
        .collect();
    assert!(failed.is_empty(), "{failed:?}");
}

fn after_every_kind<'a>(backend: Backend, kinds: impl IntoIterator<Item = &'a Kind>) {
    each(kinds, |kind| {
        let config = config_of(kind, backend);
        let rig = Rig::new(&config).unwrap();
        let machine = Machine::of(&rig);
        let log = stop_and_withdraw(kind, &config, rig, &machine);
        // Jams are in no log, and settings that lead to a stop do so late: logs like the others.
        let is_told_by_log = match kind.act {
            Act::Nothing => false,
            Act::Arm(fault) => !matches!(fault, Fault::Jammed(_)),
            _ => true,
        };
        if backend == Backend::Sim && is_told_by_log {
            withdraw_by(&log, kind);
        }
        forget(&log);
    });
}

#[test]
fn after_every_kind_of_stop_the_needle_comes_out_of_the_simulator() {
    after_every_kind(Backend::Sim, &KINDS);
}

#[test]
fn after_every_kind_of_stop_the_needle_comes_out_with_the_emulated_viper() {
    after_every_kind(Backend::Viper, in_lockstep());
}

#[test]
fn after_faults_of_the_arm_whose_cause_is_gone_the_needle_comes_out() {
    let faults = [
        kind("drives off", "drivesoff", &[], Act::Arm(Fault::DrivesOff)),
        kind("manual mode", "notautomatic", &[], Act::Arm(Fault::Manual)),
        kind(
            "controller's error",
            "controllererror",
            &[],
            Act::Arm(Fault::ControllerError),
        ),
        kind(
            "frozen feedback",
            "feedback",
            &[],
            Act::Arm(Fault::FeedbackFrozen),
        ),
    ];
    after_every_kind(Backend::Viper, &faults);
    let jam = kind("jam", "trackingerror", &[], Act::Arm(Fault::Jammed(1)));
    after_every_kind(Backend::Sim, faults.iter().chain([&jam]));
}

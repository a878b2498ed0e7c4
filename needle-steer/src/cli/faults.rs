//! Faults of emulated hardware as commands, a line each on standard input: what a real arm's bad
//! day looks like can be rehearsed.

use std::io::{BufRead, Write};
use std::time::Duration;

use robots::sim::{Fault, SimulatedArm};
use robots::viper::{Emulator, Port};
use rosbridge::emulator::Reports;

/// What every emulated arm takes.
const COMMON: &str = "faults, a line each on standard input:
  e-stop | release         emergency stop pressed, released (power stays off)
  power off | power on     of the drives
  manual | automatic       operating mode
  error NUMBER             of the controller; 0: none
  silent | speak           no feedback, feedback again
  late MS                  feedback (and the Viper's answers) later by that much
  help                     these lines";

/// Longest delay that is taken \[ms\].
const LATEST_MS: f64 = 60_000.0;
/// Fastest creeping that is taken \[deg/s\].
const FASTEST_DEG_S: f64 = 10.0;

/// What a line says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Order {
    /// Emergency stop pressed, or released.
    EmergencyStop(bool),
    /// Power of the drives.
    Power(bool),
    /// Automatic mode, or manual.
    Automatic(bool),
    /// Number of the controller's error.
    Error(i32),
    /// No feedback, or feedback again.
    Silent(bool),
    /// Delay of the feedback.
    Late(Duration),
    /// All connections are closed.
    Cut,
    /// A joint (from 0) moves by itself; \[rad/s\].
    Creep { joint: usize, rate: f64 },
}

impl Order {
    /// What `line` says; nothing where it is empty.
    ///
    /// # Errors
    /// What was expected instead, in words; nothing where it is no order at all.
    fn parse(line: &str) -> Result<Option<Self>, Option<String>> {
        let words: Vec<&str> = line.split_whitespace().collect();
        Ok(Some(match words[..] {
            [] => return Ok(None),
            ["e-stop"] => Self::EmergencyStop(true),
            ["release"] => Self::EmergencyStop(false),
            ["power", "off"] => Self::Power(false),
            ["power", "on"] => Self::Power(true),
            ["manual"] => Self::Automatic(false),
            ["automatic"] => Self::Automatic(true),
            ["silent"] => Self::Silent(true),
            ["speak"] => Self::Silent(false),
            ["cut"] => Self::Cut,
            ["error", number] => Self::Error(
                number
                    .parse()
                    .map_err(|_| format!("error {number}: expected a whole number"))?,
            ),
            ["late", ms] => {
                let late = within(ms, 0.0..=LATEST_MS)
                    .ok_or_else(|| format!("late {ms}: expected 0 to {LATEST_MS} ms"))?;
                Self::Late(Duration::from_secs_f64(late * 1e-3))
            }
            ["creep", number, deg_s] => {
                let joint = number.parse().ok().and_then(|n: usize| n.checked_sub(1));
                let joint =
                    joint.ok_or_else(|| format!("creep {number}: expected a joint, from 1 on"))?;
                let rate = within(deg_s, -FASTEST_DEG_S..=FASTEST_DEG_S).ok_or_else(|| {
                    format!("creep {number} {deg_s}: expected at most {FASTEST_DEG_S} deg/s")
                })?;
                let rate = rate.to_radians();
                Self::Creep { joint, rate }
            }
            _ => return Err(None),
        }))
    }
}

fn within(text: &str, range: std::ops::RangeInclusive<f64>) -> Option<f64> {
    text.parse().ok().filter(|number| range.contains(number))
}

/// An emulated arm to which faults happen.
pub(super) trait Rehearsal: Send + 'static {
    /// Faults beyond those of all arms, as lines of the help.
    const OWN: &'static str;

    /// Lets it happen; whether it can.
    ///
    /// # Errors
    /// What is in the way, in words.
    fn take(&mut self, order: Order) -> Result<bool, String>;
}

/// The Viper's controller on TCP.
pub(super) struct Viper(pub(super) Emulator);

impl Rehearsal for Viper {
    const OWN: &'static str = "  cut                      both connections are closed";

    fn take(&mut self, order: Order) -> Result<bool, String> {
        let emulator = &self.0;
        match order {
            Order::EmergencyStop(pressed) => emulator.turn(|knobs| {
                knobs.e_stop = pressed;
                knobs.powered &= !pressed;
            }),
            Order::Power(on) => emulator.turn(|knobs| knobs.powered = on),
            Order::Automatic(on) => emulator.turn(|knobs| knobs.mode = if on { 2 } else { 1 }),
            Order::Error(number) => emulator.turn(|knobs| knobs.error_code = number),
            Order::Silent(silent) => emulator.turn(|knobs| knobs.freeze_feedback = silent),
            Order::Late(late) => emulator.turn(|knobs| {
                knobs.feedback_delay = late;
                knobs.answer_delay = late;
            }),
            Order::Cut => {
                for port in Port::ALL {
                    emulator.throw_out(port);
                }
            }
            Order::Creep { .. } => return Ok(false),
        }
        Ok(true)
    }
}

/// What a robot's controller sees, the gravest first.
const CAUSES: [Fault; 4] = [
    Fault::EmergencyStop,
    Fault::DrivesOff,
    Fault::Manual,
    Fault::ControllerError,
];

/// The arm of the laboratory behind ROS.
pub(super) struct Laboratory {
    arm: SimulatedArm,
    reports: Reports,
    /// Of [`CAUSES`], those that there are.
    present: Vec<Fault>,
}

impl Laboratory {
    pub(super) fn new(arm: &SimulatedArm, reports: &Reports) -> Self {
        Self {
            arm: arm.clone(),
            reports: reports.clone(),
            present: Vec::new(),
        }
    }

    fn set(&mut self, cause: Fault, is_there: bool) {
        self.present.retain(|present| *present != cause);
        self.present.extend(is_there.then_some(cause));
    }

    /// The controller forgets what was, and sees what there is now.
    fn renew(&self) -> Result<(), String> {
        for cause in CAUSES {
            self.arm.clear(cause);
        }
        let renewed = self.arm.reset();
        for cause in CAUSES {
            if self.present.contains(&cause) {
                self.arm.inject(cause);
            }
        }
        renewed.map_err(|refusal| format!("{refusal}; say it again"))
    }
}

impl Rehearsal for Laboratory {
    const OWN: &'static str =
        "  creep JOINT DEG_S        a joint (from 1) moves by itself; 0: no more";

    fn take(&mut self, order: Order) -> Result<bool, String> {
        match order {
            Order::EmergencyStop(pressed) => {
                self.set(Fault::EmergencyStop, pressed);
                if pressed {
                    self.set(Fault::DrivesOff, true);
                }
            }
            Order::Power(on) => self.set(Fault::DrivesOff, !on),
            Order::Automatic(on) => self.set(Fault::Manual, !on),
            Order::Error(number) => self.set(Fault::ControllerError, number != 0),
            Order::Silent(silent) => {
                self.reports.silence(silent);
                return Ok(true);
            }
            Order::Late(late) => {
                self.reports.delay(late);
                return Ok(true);
            }
            Order::Creep { joint, rate } => {
                let joints = self.arm.true_joints().len();
                if joint >= joints {
                    return Err(format!("creep {}: there are {joints} joints", joint + 1));
                }
                let fault = Fault::Creeping { joint, rate };
                if rate != 0.0 {
                    self.arm.inject(fault);
                    return Ok(true);
                }
                self.arm.clear(fault);
            }
            Order::Cut => return Ok(false),
        }
        self.renew().map(|()| true)
    }
}

fn help<R: Rehearsal>() -> String {
    format!("{COMMON}\n{}", R::OWN)
}

/// Does what a line says, and answers; a line without a fault is answered by what there is.
///
/// # Errors
/// What was expected instead, or what is in the way, in words.
fn act<R: Rehearsal>(rehearsal: &mut R, line: &str) -> Result<String, String> {
    let line = line.trim();
    if ["", "help", "?"].contains(&line) {
        return Ok(help::<R>());
    }
    let no_fault = || format!("`{line}` is no fault; {}", help::<R>());
    match Order::parse(line).map_err(|why| why.unwrap_or_else(no_fault))? {
        Some(order) if !rehearsal.take(order)? => Err(no_fault()),
        _ => Ok(format!("done: {line}")),
    }
}

/// Says what there is, and takes and answers faults from standard input until it is closed.
pub(super) fn listen<R: Rehearsal>(mut rehearsal: R) -> std::io::Result<()> {
    say(&help::<R>());
    std::thread::Builder::new()
        .name("faults".into())
        .spawn(move || {
            for line in std::io::stdin().lock().lines().map_while(Result::ok) {
                let (Ok(answer) | Err(answer)) = act(&mut rehearsal, &line);
                say(&answer);
            }
        })?;
    Ok(())
}

fn say(text: &str) {
    // Nobody may be reading.
    let _ = writeln!(std::io::stderr(), "{text}");
}

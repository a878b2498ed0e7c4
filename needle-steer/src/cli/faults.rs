//! Faults of emulated hardware as commands, a line each on standard input: what a real arm's bad
//! day looks like can be rehearsed.

use std::io::{BufRead, Write};
use std::time::Duration;

use robots::viper::emulator::Knobs;
use robots::viper::{Emulator, Port};

/// Printed at the start.
pub(super) const HELP: &str = "faults, a line each on standard input:
  e-stop | release         emergency stop pressed, released (power stays off)
  power off | power on     of the drives
  manual | automatic       operating mode
  error NUMBER             of the controller; 0: none
  silent | speak           no feedback, feedback again
  late MS                  feedback and answers later by that much
  cut                      both connections are closed";

/// Longest delay that is taken \[ms\].
const LATEST_MS: f64 = 60_000.0;

/// Does what a line says.
///
/// # Errors
/// What was expected instead, in words.
fn act(emulator: &Emulator, line: &str) -> Result<(), String> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let turn = |act: &dyn Fn(&mut Knobs)| emulator.turn(act);
    match words[..] {
        [] => {}
        ["e-stop"] => turn(&|knobs| {
            knobs.e_stop = true;
            knobs.powered = false;
        }),
        ["release"] => turn(&|knobs| knobs.e_stop = false),
        ["power", "off"] => turn(&|knobs| knobs.powered = false),
        ["power", "on"] => turn(&|knobs| knobs.powered = true),
        ["manual"] => turn(&|knobs| knobs.mode = 1),
        ["automatic"] => turn(&|knobs| knobs.mode = 2),
        ["error", number] => {
            let number = number
                .parse()
                .map_err(|_| format!("error {number}: expected a whole number"))?;
            turn(&|knobs| knobs.error_code = number);
        }
        ["silent"] => turn(&|knobs| knobs.freeze_feedback = true),
        ["speak"] => turn(&|knobs| knobs.freeze_feedback = false),
        ["late", ms] => {
            let late = ms.parse().ok().filter(|ms| (0.0..=LATEST_MS).contains(ms));
            let late = late.ok_or_else(|| format!("late {ms}: expected 0 to {LATEST_MS} ms"))?;
            let late = Duration::from_secs_f64(late * 1e-3);
            turn(&|knobs| {
                knobs.feedback_delay = late;
                knobs.answer_delay = late;
            });
        }
        ["cut"] => {
            for port in Port::ALL {
                emulator.throw_out(port);
            }
        }
        _ => return Err(format!("`{}` is no fault; {HELP}", line.trim())),
    }
    Ok(())
}

/// Takes faults from standard input, until it is closed.
pub(super) fn listen(emulator: Emulator) -> std::io::Result<()> {
    std::thread::Builder::new()
        .name("faults".into())
        .spawn(move || {
            for line in std::io::stdin().lock().lines().map_while(Result::ok) {
                if let Err(why) = act(&emulator, &line) {
                    // Nobody may be reading.
                    let _ = writeln!(std::io::stderr(), "{why}");
                }
            }
        })?;
    Ok(())
}

//! The log of a run that was paused, resumed and taken back replays as it was.

use std::path::Path;

use hal::telemetry::Telemetry;
use hal::{ArmState, RateCommand, SensedShape};
use needle_steer::config;
use needle_steer::controls::{Controls, Wish};
use needle_steer::journal::Journal;
use needle_steer::outcome::Ended;
use needle_steer::replay::replay;
use needle_steer::rig::Rig;
use needle_steer::run::{Observer, run};

/// Logs a run and changes the user's wish as it goes on.
struct Restless<'a> {
    journal: Journal,
    controls: &'a Controls,
}

impl Observer for Restless<'_> {
    fn start(&mut self, arm: &ArmState) {
        self.journal.start(arm);
    }

    fn inputs(&mut self, arm: &ArmState, shape: Option<&SensedShape>) {
        self.journal.inputs(arm, shape);
    }

    fn step(&mut self, telemetry: &Telemetry) {
        self.journal.step(telemetry);
        match telemetry.step {
            // Still in the straight start, then twice while steering.
            40 | 300 => self.controls.ask(Wish::Pause),
            700 => self.controls.ask(Wish::Retract),
            // A withdrawal goes on whatever is asked for.
            60 | 340 | 760 => self.controls.ask(Wish::Proceed),
            _ => {}
        }
    }

    fn command(&mut self, command: &RateCommand) {
        self.journal.command(command);
    }
}

#[test]
fn pauses_and_retractions_replay_bit_by_bit() {
    let file = Path::new(env!("CARGO_TARGET_TMPDIR")).join("paused.mcap");
    for law in ["hybrid", "paper"] {
        let config = config::load(
            None,
            &[
                "target.depth_mm=30".into(),
                "target.offset_mm=1".into(),
                format!("run.law={law}"),
            ],
        )
        .unwrap();
        let controls = Controls::default();
        let mut rig = Rig::new(&config).unwrap();
        let mut restless = Restless {
            journal: Journal::create(&file, &config, &rig.bearings).unwrap(),
            controls: &controls,
        };
        let summary = run(&config, &mut rig, &mut restless, &controls).unwrap();
        assert_eq!(summary.ended, Ended::Retracted);
        restless.journal.finish().unwrap();
        let report = replay(&file, &[]).unwrap();
        assert!(report.steps > 600, "{report:?}");
        assert_eq!(report.differing, 0, "{law}: {report:?}");
        assert_eq!(report.differing_reports, 0, "{law}: {report:?}");
    }
}

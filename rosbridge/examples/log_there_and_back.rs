//! Two steps of a run are written to a log, an MCAP file of ROS 1 messages, and read back bit by bit.
//!
//! `cargo run --release -p rosbridge --example log_there_and_back`
#![expect(clippy::print_stdout, reason = "an example shows what it does")]

use std::time::Duration;

use hal::{ArmMode, ArmState, Joints, RateCommand, Stamp};
use rosbridge::log::{Log, LogReader, Overflow, Record, RunInfo};

/// Between two steps.
const PERIOD: Duration = Duration::from_millis(16);

/// What the arm said and what it was told, in two steps.
fn steps() -> Vec<Record> {
    let rates = Joints::from([0.02, -0.01, 0.015, 0.0, 0.01, 0.3]);
    let mut records = Vec::new();
    let (mut stamp, mut positions) = (Stamp::ZERO, Joints::from([0.1, -1.2, 2.4, 0.2, 0.9, -0.3]));
    for sequence in 1..=2 {
        records.push(Record::from(ArmState {
            stamp,
            positions,
            rates,
            mode: ArmMode::Moving,
        }));
        records.push(Record::from(RateCommand {
            sequence,
            stamp,
            rates,
        }));
        positions = positions.zip(&rates, |q, v| q + v * PERIOD.as_secs_f64());
        stamp = stamp + PERIOD;
    }
    records
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let run = RunInfo {
        seed: 7,
        joint_names: (1..=6).map(|k| format!("joint_{k}")).collect(),
        ..RunInfo::default()
    };
    let path = std::env::temp_dir().join(format!("two-steps-{}.mcap", std::process::id()));
    // On a thread of its own; a control loop would take `Overflow::Drop` rather than wait.
    let mut log = Log::create(&path, &run, Overflow::Wait)?;
    for record in steps() {
        log.write(record)?;
    }
    let written = log.finish()?;
    println!("{}: {written:?}", path.display());

    let mut reader = LogReader::open(&path)?;
    let read = reader.by_ref().collect::<Result<Vec<_>, _>>()?;
    println!(
        "run of seed {}, joints {:?}",
        reader.run().seed,
        reader.run().joint_names
    );
    for record in &read {
        match record {
            Record::Arm(arm) => {
                println!(
                    "{:.3} s: joint_6 at {:.5} rad",
                    arm.stamp.as_secs(),
                    arm.positions[5]
                );
            }
            Record::Command(command) => println!(
                "{:.3} s: command {}, joint_6 at {} rad/s",
                command.stamp.as_secs(),
                command.sequence,
                command.rates[5],
            ),
            other => println!("{other:?}"),
        }
    }
    assert!(reader.is_complete() && *reader.run() == run);
    assert_eq!(read, steps());
    std::fs::remove_file(&path)?;
    Ok(())
}

#[test]
fn the_example_runs() {
    main().unwrap();
}

//! Reads a log step by step: time, depth, error.
//!
//! `cargo run --release -p needle-steer --example read_log -- first/run.mcap`

use std::io::Write as _;
use std::path::Path;

use rosbridge::log::{LogReader, Record};

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let file = std::env::args().nth(1).ok_or("expected the log of a run")?;
    let mut log = LogReader::open(Path::new(&file))?;
    let mut out = std::io::stdout().lock();
    writeln!(out, "seed {}", log.run().seed)?;
    for record in log.by_ref() {
        if let Record::Step(step) = record?
            && step.step.is_multiple_of(100)
        {
            writeln!(
                out,
                "{:7.2} s  {:5.1} mm deep  {:6.3} mm off axis  {:?}",
                step.stamp.as_secs(),
                step.depth * 1e3,
                step.lateral_error * 1e3,
                step.law.mode
            )?;
        }
    }
    if !log.is_complete() {
        writeln!(out, "the log breaks off here: its run was killed")?;
    }
    Ok(())
}

//! Carries a campaign out: runs that are not in the ledger yet, on several threads.

use std::collections::HashSet;
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering};
use std::sync::{Mutex, PoisonError};

use super::ledger::{Ledger, LedgerError};
use super::plan::{Plan, Task};
use super::table::Row;
use crate::config::Config;
use crate::controls::Controls;
use crate::outcome::{Ended, Summary};
use crate::rig::Rig;
use crate::run::{RunError, Unobserved, run};

/// A part of a campaign: every `of`-th run, beginning with `number` (from 1).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Shard {
    /// Which part, from 1.
    pub number: u64,
    /// Of how many.
    pub of: u64,
}

impl Shard {
    /// All of it.
    pub const WHOLE: Self = Self { number: 1, of: 1 };

    /// Whether a run belongs to this part.
    pub const fn has(&self, run: u64) -> bool {
        run % self.of == self.number - 1
    }
}

impl std::str::FromStr for Shard {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        let expected = || format!("expected K/N with K from 1 to N, found `{text}`");
        let (number, of) = text.split_once('/').ok_or_else(expected)?;
        let parse = |part: &str| part.parse::<u64>().map_err(|_| expected());
        let shard = Self {
            number: parse(number)?,
            of: parse(of)?,
        };
        if shard.number == 0 || shard.number > shard.of {
            return Err(expected());
        }
        Ok(shard)
    }
}

/// Why a campaign stopped before its end. What is in the ledger stays.
#[derive(Debug, thiserror::Error)]
pub enum Failure {
    /// The ledger.
    #[error(transparent)]
    Ledger(#[from] LedgerError),
    /// The user stopped it.
    #[error("interrupted; the same command goes on from here")]
    Interrupted,
}

/// Runs of a shard that are not `done`.
pub fn pending(plan: &Plan, shard: Shard, done: &[u64]) -> Vec<u64> {
    let done: HashSet<u64> = done.iter().copied().collect();
    (0..plan.len())
        .filter(|run| shard.has(*run) && !done.contains(run))
        .collect()
}

/// Carries out `runs` on `jobs` threads; `progress` is called after each.
///
/// # Errors
/// See [`Failure`]. A run that cannot be carried out is a row, not an error.
pub fn execute(
    plan: &Plan,
    runs: &[u64],
    ledger: Ledger,
    jobs: usize,
    controls: &Controls,
    progress: impl Fn() + Sync,
) -> Result<(), Failure> {
    let ledger = Mutex::new(ledger);
    let keep = |_, row: Row| {
        let mut ledger = ledger.lock().unwrap_or_else(PoisonError::into_inner);
        ledger.add(&row)?;
        progress();
        Ok::<(), LedgerError>(())
    };
    each(plan, runs, jobs, controls, keep)?;
    if controls.is_interrupted() {
        return Err(Failure::Interrupted);
    }
    Ok(())
}

/// Carries out `runs` on `jobs` threads and hands each row with its place in `runs` to `keep`, from
/// whichever thread has it. After an interruption rows are missing.
///
/// # Errors
/// The first of `keep`; no run begins after it.
pub fn each<E: Send>(
    plan: &Plan,
    runs: &[u64],
    jobs: usize,
    controls: &Controls,
    keep: impl Fn(usize, Row) -> Result<(), E> + Sync,
) -> Result<(), E> {
    let next = AtomicUsize::new(0);
    let stop = AtomicBool::new(false);
    let failed = Mutex::new(None);
    let work = || {
        while !stop.load(Ordering::Relaxed) && !controls.is_interrupted() {
            let place = next.fetch_add(1, Ordering::Relaxed);
            let Some(&run) = runs.get(place) else {
                return;
            };
            let Some(row) = carry_out(plan, &plan.task(run), controls) else {
                return;
            };
            if let Err(error) = keep(place, row) {
                let mut failed = failed.lock().unwrap_or_else(PoisonError::into_inner);
                failed.get_or_insert(error);
                stop.store(true, Ordering::Relaxed);
                return;
            }
        }
    };
    std::thread::scope(|scope| {
        for _ in 0..jobs.clamp(1, runs.len().max(1)) {
            scope.spawn(work);
        }
    });
    let failed = failed.into_inner().unwrap_or_else(PoisonError::into_inner);
    failed.map_or(Ok(()), Err)
}

/// One run's row; nothing where the user stopped it.
fn carry_out(plan: &Plan, task: &Task<'_>, controls: &Controls) -> Option<Row> {
    match one(&plan.config(task), controls) {
        Ok(summary) if summary.ended == Ended::Interrupted => None,
        Ok(summary) => Some(Row::new(task, &summary)),
        Err(error) => Some(Row::failed(task, &error.to_string())),
    }
}

fn one(config: &Config, controls: &Controls) -> Result<Summary, RunError> {
    let mut rig = Rig::new(config)?;
    run(config, &mut rig, &mut Unobserved, controls)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shards_cover_a_campaign_once() {
        for of in 1..6_u64 {
            for run in 0..30 {
                let owners = (1..=of).filter(|number| {
                    Shard {
                        number: *number,
                        of,
                    }
                    .has(run)
                });
                assert_eq!(owners.count(), 1);
            }
        }
        for bad in ["0/3", "4/3", "1", "a/3", "1/0", "-1/3", "1/3/2", ""] {
            assert!(bad.parse::<Shard>().is_err(), "{bad}");
        }
        assert_eq!("2/3".parse(), Ok(Shard { number: 2, of: 3 }));
    }
}

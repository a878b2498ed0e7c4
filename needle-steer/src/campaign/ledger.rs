//! The ledger: a line for each finished run, on the disk before it counts.
//!
//! Only whole lines count. What a killed process left of its last line is cut off when its shard
//! is taken up again, and skipped by whoever only reads.

use std::collections::{BTreeMap, BTreeSet};
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Read, Seek, SeekFrom, Write};
use std::path::{Path, PathBuf};

use super::execute::Shard;
use super::plan::Plan;
use super::table::{COLUMNS, Row};

/// A ledger that cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum LedgerError {
    /// The file or its folder cannot be read or written.
    #[error("{}: {source}", file.display())]
    Io {
        /// The file or folder.
        file: PathBuf,
        /// Why.
        source: std::io::Error,
    },
    /// Another process works on it.
    #[error("{}: another process is working on this shard", file.display())]
    Busy {
        /// The file.
        file: PathBuf,
    },
    /// Of another campaign, or of another version of the program.
    #[error(
        "{}: holds results of {found}; choose another --out, nothing was changed", file.display()
    )]
    Foreign {
        /// The file.
        file: PathBuf,
        /// Whose.
        found: &'static str,
    },
    /// A line inside is no result.
    #[error("{}:{line}: not a result of this campaign", file.display())]
    Damaged {
        /// The file.
        file: PathBuf,
        /// The line, from 1.
        line: usize,
    },
    /// A run stands in two ledgers with different results.
    #[error("run {run} has two different results, one in {}", file.display())]
    Contradiction {
        /// The run.
        run: u64,
        /// The ledger read last.
        file: PathBuf,
    },
    /// There is no ledger.
    #[error("{}: holds no results of a campaign", folder.display())]
    Missing {
        /// The folder.
        folder: PathBuf,
    },
}

/// The ledger of one shard, open for writing.
#[derive(Debug)]
pub struct Ledger {
    file: File,
    path: PathBuf,
}

/// First line: which campaign, by which program.
fn heading(plan: &Plan) -> String {
    let plan = serde_json::to_string(plan).unwrap_or_default();
    format!("# {} {plan}\n{}\n", crate::VERSION, COLUMNS.join(","))
}

impl Shard {
    /// Name of its ledger.
    pub fn ledger(self) -> String {
        format!("ledger-{}-of-{}.csv", self.number, self.of)
    }
}

/// Text of a ledger that holds these runs.
pub fn ledger_of(plan: &Plan, lines: &BTreeMap<u64, String>) -> String {
    let lines: String = lines.values().map(String::as_str).collect();
    heading(plan) + &lines
}

impl Ledger {
    /// Opens or starts the ledger of a shard in `folder`; answers the runs that it holds.
    ///
    /// # Errors
    /// See [`LedgerError`]. A ledger of another campaign is left as it is.
    pub fn open(folder: &Path, plan: &Plan, shard: Shard) -> Result<(Self, Vec<u64>), LedgerError> {
        let io = |file: &Path| {
            let file = file.to_owned();
            move |source| LedgerError::Io { file, source }
        };
        std::fs::create_dir_all(folder).map_err(io(folder))?;
        // Shards of another campaign, too, keep the folder to themselves.
        match collect(&[folder.to_owned()], plan) {
            Ok(_) | Err(LedgerError::Missing { .. }) => {}
            Err(error) => return Err(error),
        }
        let path = folder.join(shard.ledger());
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .map_err(io(&path))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(LedgerError::Busy { file: path }),
            Err(TryLockError::Error(source)) => return Err(LedgerError::Io { file: path, source }),
        }
        let mut text = Vec::new();
        file.read_to_end(&mut text).map_err(io(&path))?;
        let heading = heading(plan);
        let started = text.len() >= heading.len() || !heading.as_bytes().starts_with(&text);
        let (rows, whole) = if started {
            let (rows, whole) = parse(&text, &path, &heading)?;
            (rows.into_keys().collect(), whole)
        } else {
            // New, or killed while the heading was written.
            file.set_len(0).map_err(io(&path))?;
            file.rewind().map_err(io(&path))?;
            file.write_all(heading.as_bytes()).map_err(io(&path))?;
            (Vec::new(), heading.len())
        };
        if whole < text.len() {
            file.set_len(whole as u64).map_err(io(&path))?;
        }
        file.seek(SeekFrom::End(0)).map_err(io(&path))?;
        file.sync_all().map_err(io(&path))?;
        Ok((Self { file, path }, rows))
    }

    /// Adds a finished run; it is on the disk when this returns.
    ///
    /// # Errors
    /// The disk is full or gone; the runs before are kept.
    pub fn add(&mut self, row: &Row) -> Result<(), LedgerError> {
        let write = |file: &mut File| -> std::io::Result<()> {
            let line = row.line().map_err(std::io::Error::other)?;
            file.write_all(&line)?;
            file.sync_data()
        };
        write(&mut self.file).map_err(|source| LedgerError::Io {
            file: self.path.clone(),
            source,
        })
    }
}

/// Lines of rows by run, and how many runs were given more than once.
pub type Collected = (BTreeMap<u64, String>, usize);

/// Lines of rows by run, and the length of what is whole \[bytes\].
type Lines = (BTreeMap<u64, String>, usize);

fn parse(text: &[u8], path: &Path, heading: &str) -> Result<Lines, LedgerError> {
    let foreign = |found| LedgerError::Foreign {
        file: path.to_owned(),
        found,
    };
    if !text.starts_with(heading.as_bytes()) {
        let version = format!("# {} ", crate::VERSION);
        return Err(foreign(if text.starts_with(version.as_bytes()) {
            "another campaign"
        } else {
            "another version of the program or another campaign"
        }));
    }
    let mut rows = BTreeMap::new();
    let mut whole = heading.len();
    let body = text.get(whole..).unwrap_or_default();
    for (k, line) in body.split_inclusive(|b| *b == b'\n').enumerate() {
        if !line.ends_with(b"\n") {
            break;
        }
        let damaged = || LedgerError::Damaged {
            file: path.to_owned(),
            line: k + 3,
        };
        let line_text = std::str::from_utf8(line).map_err(|_| damaged())?;
        let row = Row::parse(line_text).map_err(|_| damaged())?;
        rows.insert(row.run, line_text.to_owned());
        whole += line.len();
    }
    Ok((rows, whole))
}

/// Every finished run of `plan` in the ledgers of `folders`, as lines of CSV by run.
///
/// # Errors
/// See [`LedgerError`].
pub fn collect(folders: &[PathBuf], plan: &Plan) -> Result<BTreeMap<u64, String>, LedgerError> {
    collect_counted(folders, plan).map(|(all, _)| all)
}

/// As [`collect`], with the number of runs that stand in more than one ledger; each counts once.
///
/// # Errors
/// See [`LedgerError`].
pub fn collect_counted(folders: &[PathBuf], plan: &Plan) -> Result<Collected, LedgerError> {
    let heading = heading(plan);
    let mut all: BTreeMap<u64, String> = BTreeMap::new();
    let mut twice = BTreeSet::new();
    for folder in folders {
        for path in ledgers(folder)? {
            let text = std::fs::read(&path).map_err(|source| LedgerError::Io {
                file: path.clone(),
                source,
            })?;
            // A shard that is only just being started has nothing to say yet.
            if text.len() < heading.len() && heading.as_bytes().starts_with(&text) {
                continue;
            }
            for (run, line) in parse(&text, &path, &heading)?.0 {
                match all.get(&run) {
                    None => {
                        all.insert(run, line);
                    }
                    Some(known) if *known != line => {
                        return Err(LedgerError::Contradiction { run, file: path });
                    }
                    Some(_) => {
                        twice.insert(run);
                    }
                }
            }
        }
    }
    Ok((all, twice.len()))
}

fn ledgers(folder: &Path) -> Result<Vec<PathBuf>, LedgerError> {
    let io = |source| LedgerError::Io {
        file: folder.to_owned(),
        source,
    };
    let mut found = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(io)? {
        let path = entry.map_err(io)?.path();
        let named = path.file_name().and_then(|n| n.to_str());
        if named.is_some_and(|n| n.starts_with("ledger-") && n.strip_suffix(".csv").is_some()) {
            found.push(path);
        }
    }
    if found.is_empty() {
        return Err(LedgerError::Missing {
            folder: folder.to_owned(),
        });
    }
    found.sort();
    Ok(found)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(count: u64) -> Plan {
        let text = format!(
            "laws = [\"paper\"]\nseeds = {{ first = 1, count = {count} }}\n[[target]]\nkind = \"aligned\"\n"
        );
        Plan::parse(&text, Path::new("c.toml")).unwrap()
    }

    fn folder(name: &str) -> PathBuf {
        let folder =
            std::env::temp_dir().join(format!("needle-steer-{name}-{}", std::process::id()));
        let _ = std::fs::remove_dir_all(&folder);
        folder
    }

    #[test]
    fn a_ledger_torn_at_any_byte_loses_at_most_its_last_run() {
        let (plan, folder) = (plan(4), folder("torn"));
        let (mut ledger, done) = Ledger::open(&folder, &plan, Shard::WHOLE).unwrap();
        assert!(done.is_empty());
        let mut ends = vec![std::fs::metadata(&ledger.path).unwrap().len()];
        for run in 0..3 {
            ledger.add(&Row::failed(&plan.task(run), "test")).unwrap();
            ends.push(std::fs::metadata(&ledger.path).unwrap().len());
        }
        let path = ledger.path.clone();
        drop(ledger);
        let text = std::fs::read(&path).unwrap();
        for length in 0..=text.len() {
            std::fs::write(&path, &text[..length]).unwrap();
            let (mut ledger, done) = Ledger::open(&folder, &plan, Shard::WHOLE).unwrap();
            let whole = ends.iter().filter(|end| **end <= length as u64).count();
            assert_eq!(done.len(), whole.saturating_sub(1), "cut at {length}");
            ledger.add(&Row::failed(&plan.task(3), "test")).unwrap();
            drop(ledger);
            let runs = collect(std::slice::from_ref(&folder), &plan).unwrap();
            assert_eq!(runs.len(), done.len() + 1, "cut at {length}");
        }
        std::fs::remove_dir_all(&folder).unwrap();
    }

    #[test]
    fn ledgers_of_others_are_left_alone() {
        let folder = folder("foreign");
        let (ledger, _) = Ledger::open(&folder, &plan(4), Shard::WHOLE).unwrap();
        let busy = Ledger::open(&folder, &plan(4), Shard::WHOLE).unwrap_err();
        assert!(matches!(busy, LedgerError::Busy { .. }), "{busy}");
        let path = ledger.path.clone();
        drop(ledger);
        let before = std::fs::read(&path).unwrap();
        let foreign = Ledger::open(&folder, &plan(5), Shard::WHOLE).unwrap_err();
        assert!(
            foreign.to_string().contains("another campaign"),
            "{foreign}"
        );
        assert_eq!(std::fs::read(&path).unwrap(), before);
        // Nor does another shard join them.
        let shard = Shard { number: 2, of: 2 };
        let foreign = Ledger::open(&folder, &plan(5), shard).unwrap_err();
        assert!(matches!(foreign, LedgerError::Foreign { .. }), "{foreign}");
        assert_eq!(std::fs::read_dir(&folder).unwrap().count(), 1);
        std::fs::remove_dir_all(&folder).unwrap();
    }
}

//! Files of results: made by one process, never written over, whole or not there.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{BufWriter, ErrorKind, Read, Write};
use std::path::{Path, PathBuf};

use anyhow::Context;

use crate::config::Config;

/// The log of a run; whoever holds it open and locked owns the folder.
const LOG: &str = "run.mcap";
/// What else a run writes.
const OTHERS: [&str; 4] = ["summary.json", "series.csv", "config.toml", "run.svg"];
/// Bytes of a file that tell whether it is a page.
const START: u64 = 64;
/// How often the next folder is sought while other runs take theirs.
const ATTEMPTS: u32 = 1000;

/// A place where no results can be written; nothing was changed there.
#[derive(Debug, thiserror::Error)]
#[error("{0}")]
pub struct ResultsError(String);

/// A folder that this process alone writes a run's results to. Dropped before anything was
/// logged, it leaves nothing behind.
#[derive(Debug)]
pub struct RunFolder {
    folder: PathBuf,
    log: File,
    /// Whether the folder was made for this run.
    fresh: bool,
}

impl RunFolder {
    /// Takes `folder`, made if missing.
    ///
    /// # Errors
    /// It holds results, another run is writing to it, or it cannot be made.
    pub fn claim(folder: &Path) -> Result<Self, ResultsError> {
        let unusable = |e: std::io::Error| ResultsError(format!("{}: {e}", folder.display()));
        let fresh = !folder.exists();
        std::fs::create_dir_all(folder).map_err(unusable)?;
        let claimed = Self {
            folder: folder.to_owned(),
            log: claim(&folder.join(LOG))?,
            fresh,
        };
        OTHERS
            .iter()
            .try_for_each(|name| check_free(&folder.join(name)))?;
        Ok(claimed)
    }

    /// Takes the next free folder under `out`.
    ///
    /// # Errors
    /// None can be made.
    pub fn next(config: &Config) -> std::io::Result<Self> {
        let run = &config.run;
        let name = format!("{}-{}-{}", run.law, run.phantom, run.seed);
        let parent = Path::new("out");
        std::fs::create_dir_all(parent)?;
        for _ in 0..ATTEMPTS {
            let folder = parent.join(format!("{:03}-{name}", newest(parent)? + 1));
            match std::fs::create_dir(&folder) {
                // Another run took the number meanwhile.
                Err(e) if e.kind() == ErrorKind::AlreadyExists => {}
                Err(e) => return Err(e),
                Ok(()) => {
                    let mut claimed = Self::claim(&folder).map_err(std::io::Error::other)?;
                    claimed.fresh = true;
                    return Ok(claimed);
                }
            }
        }
        Err(ErrorKind::AlreadyExists.into())
    }

    /// The folder.
    pub fn path(&self) -> &Path {
        &self.folder
    }

    /// Empties the log of a run that was refused before anything moved.
    pub fn forget(&self) {
        // What stays is only untidy.
        let _ = self.log.set_len(0);
    }

    /// The log, empty, and its place.
    ///
    /// # Errors
    /// The system refused.
    pub fn log(&self) -> std::io::Result<(File, PathBuf)> {
        Ok((self.log.try_clone()?, self.folder.join(LOG)))
    }
}

impl Drop for RunFolder {
    fn drop(&mut self) {
        if self.log.metadata().is_ok_and(|log| log.len() == 0) {
            // Still locked: nobody else has begun with it. The folder stays if it is not empty.
            let _ = std::fs::remove_file(self.folder.join(LOG));
            if self.fresh {
                let _ = std::fs::remove_dir(&self.folder);
            }
        }
    }
}

/// The highest number of the folders in `parent`.
fn newest(parent: &Path) -> std::io::Result<u32> {
    let number = |entry: std::io::Result<std::fs::DirEntry>| {
        entry
            .ok()?
            .file_name()
            .to_str()?
            .split('-')
            .next()?
            .parse()
            .ok()
    };
    Ok(std::fs::read_dir(parent)?
        .filter_map(number)
        .max()
        .unwrap_or(0))
}

/// Whether there is something in `file`.
fn holds(file: &Path) -> bool {
    std::fs::metadata(file).is_ok_and(|found| !found.is_file() || found.len() > 0)
}

/// Refuses a file with something in it.
///
/// # Errors
/// There is.
pub(crate) fn check_free(file: &Path) -> Result<(), ResultsError> {
    if holds(file) {
        Err(taken(file))
    } else {
        Ok(())
    }
}

fn taken(file: &Path) -> ResultsError {
    ResultsError(format!(
        "{}: is there already, of an earlier command, and nothing is written over; name another \
         folder or file",
        file.display()
    ))
}

/// Opens `file` for this process alone, as long as it is held open; an empty one may be there.
///
/// # Errors
/// It holds something, another process has it, or it cannot be made.
pub(crate) fn claim(file: &Path) -> Result<File, ResultsError> {
    let unusable = |e: std::io::Error| ResultsError(format!("{}: {e}", file.display()));
    let busy = || {
        ResultsError(format!(
            "{}: another process is writing its results there; name another folder",
            file.display()
        ))
    };
    let mut options = OpenOptions::new();
    options.write(true);
    let (open, fresh) = match options.clone().create_new(true).open(file) {
        Err(e) if e.kind() == ErrorKind::AlreadyExists => (options.open(file), false),
        made => (made, true),
    };
    let open = open.map_err(unusable)?;
    match open.try_lock() {
        Ok(()) => {}
        Err(TryLockError::WouldBlock) => return Err(busy()),
        // A file system without locks: who made the file has it.
        Err(TryLockError::Error(_)) if fresh => {}
        Err(TryLockError::Error(_)) => return Err(taken(file)),
    }
    if holds(file) {
        return Err(taken(file));
    }
    // Its owner may have given up, and removed it, between the two steps above.
    if !file.exists() {
        return Err(busy());
    }
    Ok(open)
}

/// Writes a whole new file; what cannot be written to its end is removed.
///
/// # Errors
/// There is something in it already, or the system refused.
pub(crate) fn save(
    file: &Path,
    write: impl FnOnce(&mut BufWriter<File>) -> anyhow::Result<()>,
) -> anyhow::Result<()> {
    let open = claim(file)?;
    let mut writer = BufWriter::new(open);
    let written = write(&mut writer).and_then(|()| Ok(writer.flush()?));
    if written.is_err() {
        // Half a result would look like a whole one.
        let _ = std::fs::remove_file(file);
    }
    written.with_context(|| file.display().to_string())
}

/// Puts a whole file in the place of an old one: a reader sees either.
///
/// # Errors
/// The system refused; the old file stays as it was.
pub(crate) fn replace(file: &Path, text: &[u8]) -> anyhow::Result<()> {
    if file.exists() && !file.is_file() {
        // A terminal or a pipe.
        return std::fs::write(file, text).with_context(|| file.display().to_string());
    }
    let mut name = file.as_os_str().to_owned();
    name.push(format!(".{}", std::process::id()));
    let fresh = PathBuf::from(name);
    let written = std::fs::write(&fresh, text).and_then(|()| std::fs::rename(&fresh, file));
    if written.is_err() {
        let _ = std::fs::remove_file(&fresh);
    }
    written.with_context(|| file.display().to_string())
}

/// Writes an HTML page. It takes the place of an older page, never of a log or anything else.
///
/// # Errors
/// Something else is there, or the system refused.
pub fn save_page(file: &Path, page: &str) -> anyhow::Result<()> {
    check_is_page(file)?;
    replace(file, page.as_bytes())
}

/// Refuses a file that is there and no page.
///
/// # Errors
/// It is something else, or cannot be read.
pub fn check_is_page(file: &Path) -> anyhow::Result<()> {
    if !file.is_file() {
        return Ok(());
    }
    let mut start = Vec::new();
    File::open(file)?.take(START).read_to_end(&mut start)?;
    let start = String::from_utf8_lossy(&start).to_lowercase();
    if start.is_empty() || start.trim_start().starts_with("<!doctype html") {
        return Ok(());
    }
    let name = file.display();
    Err(ResultsError(format!("{name}: is no HTML page, and is not written over")).into())
}

//! A log on a thread of its own.

use std::fs::File;
use std::path::Path;
use std::sync::mpsc::{Receiver, RecvTimeoutError, SyncSender, TrySendError, sync_channel};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use super::{LogWriter, Record, RunInfo, Scenery, WriteError};

/// Longest time that a record stays in memory.
const FLUSH_PERIOD: Duration = Duration::from_millis(500);
/// Records that may wait for the disk; at 30 Hz with images about four seconds.
const QUEUE: usize = 512;

/// What happens when the disk is slower than the run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Overflow {
    /// The run waits: for simulated time.
    Wait,
    /// Records are dropped and counted: the run never waits for a disk, and what was written is
    /// on it half a second later even if the power fails.
    Drop,
}

/// What a finished log holds.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Written {
    /// Records handed over for writing.
    pub records: u64,
    /// Records dropped because the disk was too slow.
    pub dropped: u64,
}

/// Writes the log of a run to a file, while it goes. Dropping it completes the file, too.
#[derive(Debug)]
pub struct Log {
    sender: Option<SyncSender<Record>>,
    thread: Option<JoinHandle<Result<(), WriteError>>>,
    overflow: Overflow,
    written: Written,
}

impl Log {
    /// Makes the file and writes what is known of the run.
    ///
    /// # Errors
    /// The file cannot be made or written.
    pub fn create(path: &Path, run: &RunInfo, overflow: Overflow) -> Result<Self, WriteError> {
        let file = File::create(path).map_err(|source| WriteError::Io {
            path: path.display().to_string(),
            source,
        })?;
        Self::new(file, path, run, Scenery::default(), overflow)
    }

    /// Writes what is known of the run to an empty `file`, which errors call `path`.
    ///
    /// # Errors
    /// The file cannot be written.
    pub fn new(
        file: File,
        path: &Path,
        run: &RunInfo,
        scenery: Scenery,
        overflow: Overflow,
    ) -> Result<Self, WriteError> {
        let io = |source| WriteError::Io {
            path: path.display().to_string(),
            source,
        };
        let disk = match overflow {
            Overflow::Wait => None,
            Overflow::Drop => Some(file.try_clone().map_err(io)?),
        };
        let writer = LogWriter::new(file, run, scenery)?;
        let (sender, receiver) = sync_channel(QUEUE);
        let thread = std::thread::Builder::new()
            .name("log".to_owned())
            .spawn(move || drain(writer, &receiver, disk.as_ref()))
            .map_err(io)?;
        Ok(Self {
            sender: Some(sender),
            thread: Some(thread),
            overflow,
            written: Written {
                records: 0,
                dropped: 0,
            },
        })
    }

    /// Hands a record over; it is on its way to the disk half a second later at the latest.
    ///
    /// # Errors
    /// The log has failed: the first call after the failure says why, later ones that it
    /// stopped.
    pub fn write(&mut self, record: impl Into<Record>) -> Result<(), WriteError> {
        let sender = self.sender.as_ref().ok_or(WriteError::Stopped)?;
        let record = record.into();
        let alive = match self.overflow {
            Overflow::Wait => sender.send(record).is_ok(),
            Overflow::Drop => match sender.try_send(record) {
                Err(TrySendError::Full(_)) => {
                    self.written.dropped += 1;
                    return Ok(());
                }
                sent => sent.is_ok(),
            },
        };
        if alive {
            self.written.records += 1;
            Ok(())
        } else {
            self.join().and(Err(WriteError::Stopped))
        }
    }

    /// Completes the file.
    ///
    /// # Errors
    /// Not everything could be written.
    pub fn finish(mut self) -> Result<Written, WriteError> {
        self.join()?;
        Ok(self.written)
    }

    fn join(&mut self) -> Result<(), WriteError> {
        self.sender = None;
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(result)) => result,
            Some(Err(_)) | None => Err(WriteError::Stopped),
        }
    }
}

impl Drop for Log {
    fn drop(&mut self) {
        // Nobody is left to be told of a failure.
        let _ = self.join();
    }
}

#[expect(
    clippy::disallowed_methods,
    reason = "the age of unwritten data is wall-clock time"
)]
fn drain(
    mut writer: LogWriter<File>,
    receiver: &Receiver<Record>,
    disk: Option<&File>,
) -> Result<(), WriteError> {
    let mut flushed = Instant::now();
    let mut has_start = false;
    loop {
        // Where the arm stood first is what leads back to it.
        let mut due = false;
        match receiver.recv_timeout(FLUSH_PERIOD.saturating_sub(flushed.elapsed())) {
            Ok(record) => {
                writer.write(&record)?;
                due = !has_start && matches!(record, Record::Arm(_));
            }
            Err(RecvTimeoutError::Timeout) => {}
            Err(RecvTimeoutError::Disconnected) => return writer.finish(),
        }
        has_start |= due;
        if due || flushed.elapsed() >= FLUSH_PERIOD {
            writer.flush()?;
            if let Some(disk) = disk {
                // A power failure takes what was only handed to the system.
                disk.sync_data()?;
            }
            flushed = Instant::now();
        }
    }
}

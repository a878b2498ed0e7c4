//! A recorded run for other programs: bags of ROS 1 and ROS 2, and its time series as a table.

#[cfg(feature = "parquet")]
mod parquet;
mod table;

use std::fs::File;
use std::io::BufWriter;
use std::path::Path;

use rosbridge::bag::{self, BagError};
use rosbridge::log::{LogReader, ReadError};

use crate::record::read_log;

/// What a log becomes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Format {
    /// A bag of ROS 1.
    Rosbag1,
    /// A bag of ROS 2: a folder.
    Rosbag2,
    /// The time series as CSV.
    Csv,
    /// The time series as Parquet.
    Parquet,
}

/// What was exported.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Exported {
    /// Messages or rows.
    pub entries: u64,
    /// Which of them.
    pub unit: &'static str,
    /// Whether the log was whole.
    pub complete: bool,
    /// Whether the log says when it began, so that stamps are wall-clock time.
    pub dated: bool,
}

/// A log that cannot be exported.
#[derive(Debug, thiserror::Error)]
pub enum ExportError {
    /// A bag.
    #[error(transparent)]
    Bag(#[from] BagError),
    /// The log.
    #[error(transparent)]
    Read(#[from] ReadError),
    /// The table's file.
    #[error("{path}")]
    Io {
        /// The file.
        path: String,
        /// Why.
        source: std::io::Error,
    },
    /// The table as Parquet.
    #[cfg(feature = "parquet")]
    #[error("Parquet")]
    Parquet(#[from] ::parquet::errors::ParquetError),
    /// There is no Parquet.
    #[cfg(not(feature = "parquet"))]
    #[error("this program was built without its feature `parquet`")]
    NoParquet,
}

/// Writes the run in the file `log` to `out` as `format`.
///
/// # Errors
/// See [`ExportError`].
pub fn export(log: &Path, format: Format, out: &Path) -> Result<Exported, ExportError> {
    let began = LogReader::open(log)?.run().began;
    let exported = |(entries, unit), complete| Exported {
        entries,
        unit,
        complete,
        dated: began.is_some(),
    };
    match format {
        Format::Rosbag1 => {
            let written = bag::write_ros1(log, out)?;
            Ok(exported((written.messages, "messages"), written.complete))
        }
        Format::Rosbag2 => {
            let written = bag::write_ros2(log, out)?;
            Ok(exported((written.messages, "messages"), written.complete))
        }
        Format::Csv | Format::Parquet => {
            let run = read_log(log)?;
            let columns = table::columns(&run.rows, began);
            let io = |source| ExportError::Io {
                path: out.display().to_string(),
                source,
            };
            let file = BufWriter::new(File::create(out).map_err(io)?);
            if format == Format::Csv {
                table::write_csv(&columns, file).map_err(io)?;
            } else {
                write_parquet(&columns, file)?;
            }
            Ok(exported((run.rows.len() as u64, "rows"), run.complete))
        }
    }
}

#[cfg(feature = "parquet")]
fn write_parquet(columns: &[table::Column], file: BufWriter<File>) -> Result<(), ExportError> {
    Ok(parquet::write(columns, file)?)
}

#[cfg(not(feature = "parquet"))]
fn write_parquet(_: &[table::Column], _: BufWriter<File>) -> Result<(), ExportError> {
    Err(ExportError::NoParquet)
}

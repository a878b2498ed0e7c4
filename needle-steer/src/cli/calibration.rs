//! The calibration files that commands read.

use std::io::Write as _;
use std::path::PathBuf;

use vision::files::{ReadOptions, StereoFile, read_calibration};

use super::Usage;

/// Reads one calibration file or two; what a user should know of it goes to the error output.
/// `unit_mm` is the unit of its lengths where that is not the metre, `image_sizes` serve where
/// the files name none.
pub(super) fn read(
    paths: &[PathBuf],
    unit_mm: Option<f64>,
    image_sizes: Option<[(usize, usize); 2]>,
) -> Result<StereoFile, Usage> {
    if let Some(unit) = unit_mm.filter(|u| !(u.is_finite() && *u > 0.0)) {
        return Err(Usage(format!(
            "--unit-mm {unit}: expected a number above 0: 1 for millimetres, a square's side for \
             squares"
        )));
    }
    let options = ReadOptions {
        unit: unit_mm.map(|u| u * 1e-3),
        image_sizes,
    };
    let read = read_calibration(paths, &options).map_err(|e| Usage(e.to_string()))?;
    for note in &read.notes {
        // A closed error output is no reason to stop.
        let _ = writeln!(std::io::stderr(), "note: {}: {note}", names(paths));
    }
    Ok(read.file)
}

/// The files' names for a message.
pub(super) fn names(paths: &[PathBuf]) -> String {
    let all: Vec<String> = paths.iter().map(|p| p.display().to_string()).collect();
    all.join(" ")
}

//! Calibrates the stereo photographs of a folder (`left01.jpg`, `right01.jpg`, ...) and writes
//! the report: `cargo run --release -p vision --example calibration_report FOLDER REPORT.html`.

use std::path::{Path, PathBuf};

use vision::calibrate::{Board, BoardPair, Layout, StereoOptions, calibrate_stereo};
use vision::detect::{BoardSize, RefineOptions, detect_board};
use vision::files::{read_image, write_all};
use vision::report::calibration_report;

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let mut arguments = std::env::args_os().skip(1).map(PathBuf::from);
    let (Some(folder), Some(page)) = (arguments.next(), arguments.next()) else {
        return Err("usage: calibration_report FOLDER REPORT.html".into());
    };
    let board = Board {
        size: BoardSize { cols: 9, rows: 6 },
        square: 0.025,
        layout: Layout::Square,
    };
    let mut pairs = Vec::new();
    for k in 1..=99 {
        let names = ["left", "right"].map(|side| format!("{side}{k:02}.jpg"));
        if !folder.join(&names[0]).exists() {
            continue;
        }
        pairs.push(BoardPair {
            left: corners(&folder, &names[0], &board)?,
            right: corners(&folder, &names[1], &board)?,
            left_name: names[0].clone(),
            right_name: names[1].clone(),
        });
    }
    let options = StereoOptions::default();
    let calibration = calibrate_stereo(&board, &pairs, (640, 480), Vec::new(), &options)?;
    write_all(&[(page, calibration_report(&calibration)?)])?;
    Ok(())
}

fn corners(
    folder: &Path,
    name: &str,
    board: &Board,
) -> Result<Vec<nalgebra::Point2<f64>>, Box<dyn std::error::Error>> {
    let image = read_image(&folder.join(name))?;
    let found = detect_board(&image, board.size, &RefineOptions::default());
    Ok(found.map_err(|e| format!("{name}: {e}"))?.corners)
}

//! Boards in real photographs, beside OpenCV's corners.

mod reference;

use vision::detect::{BoardSize, RefineOptions, detect_board};

const SIZE: BoardSize = BoardSize { cols: 9, rows: 6 };

#[test]
fn every_board_is_found_with_opencvs_labels() {
    let Some(opencv) = reference::opencv() else {
        return;
    };
    let (mut square, mut worst) = (0.0_f64, 0.0_f64);
    for name in reference::names() {
        let image = reference::photograph(&name).unwrap();
        let board = detect_board(&image, SIZE, &RefineOptions::default())
            .unwrap_or_else(|e| panic!("{name}: {e}"));
        assert_eq!(board.corners.len(), 54, "{name}");
        for (a, b) in board
            .corners
            .iter()
            .zip(reference::opencv_corners(&opencv, &name))
        {
            square += (a - b).norm_squared();
            worst = worst.max((a - b).norm());
        }
    }
    let rms = (square / (18.0 * 54.0)).sqrt();
    println!("difference from OpenCV's corners: rms {rms:.4} px, worst {worst:.4} px");
    // A false label would differ by 20 px; another refinement by a few tenths.
    assert!(worst < 0.5, "{worst}");
}

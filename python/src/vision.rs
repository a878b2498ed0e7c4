//! Calibration and tracking.

use std::path::PathBuf;
use std::sync::{Mutex, PoisonError};

use hal::{CameraFrame, GrayImage, Stamp, StereoFrame};
use needle_steer::controls::Controls;
use needle_steer::stereo::{Request, calibrate};
use needle_steer::tracked::Line;
use numpy::{PyReadonlyArray2, PyUntypedArrayMethods};
use pyo3::prelude::*;
use vision::files::{Pixels, ReadOptions, read_calibration};
use vision::track::{Appearance, Context, Hints, StereoTracker, TrackSettings};

use crate::arrays::shown;
use crate::convert::document;
use crate::errors::{failed, input};
use crate::work::{detached, interruptible};

/// Finds a needle in pairs of images.
#[pyclass(frozen, module = "needle_steer")]
pub(crate) struct PairTracker {
    tracker: Mutex<(StereoTracker, usize)>,
    bevel: f64,
}

#[pymethods]
impl PairTracker {
    #[new]
    fn new(
        calibration: Vec<PathBuf>,
        unit_mm: Option<f64>,
        diameter_mm: f64,
        bevel_mm: f64,
        blur_px: Option<f64>,
        bright: Option<bool>,
    ) -> PyResult<Self> {
        if unit_mm.is_some_and(|unit| !(unit.is_finite() && unit > 0.0)) {
            return Err(input(format!(
                "unit_mm {unit_mm:?}: expected a number above 0"
            )));
        }
        let options = ReadOptions {
            unit: unit_mm.map(|unit| unit * 1e-3),
            image_sizes: None,
        };
        let read = read_calibration(&calibration, &options).map_err(input)?;
        let needle = Appearance {
            diameter: diameter_mm * 1e-3,
            bevel_length: bevel_mm * 1e-3,
        };
        let settings = TrackSettings::default();
        let mut tracker = StereoTracker::new(&read.file.rig, needle, &settings).map_err(input)?;
        tracker.set_hints(Hints { blur_px, bright });
        Ok(Self {
            tracker: Mutex::new((tracker, 0)),
            bevel: needle.bevel_length,
        })
    }

    /// One pair, taken at `time` [s]: what a line of `needle-steer track` says.
    fn track<'py>(
        &self,
        py: Python<'py>,
        left: &Bound<'py, PyAny>,
        right: &Bound<'py, PyAny>,
        time: f64,
    ) -> PyResult<Bound<'py, PyAny>> {
        if !(time.is_finite() && time >= 0.0) {
            return Err(input(format!("time {time}: expected seconds from 0 on")));
        }
        let images = [image(left, "left")?, image(right, "right")?];
        let line = detached(py, || {
            let mut guard = self.tracker.lock().unwrap_or_else(PoisonError::into_inner);
            let (tracker, frame) = &mut *guard;
            let [left, right] = images.map(|image| CameraFrame {
                stamp: Stamp::from_secs(time),
                sequence: *frame as u64,
                image: image.into(),
            });
            let refused = tracker
                .track(&StereoFrame { left, right }, &Context::default())
                .err();
            let line = Line::new(*frame, tracker.tracked(), refused.as_ref(), self.bevel);
            *frame += 1;
            line
        })?;
        document(py, &line)
    }

    /// Forgets needle and background.
    fn reset(&self) {
        let mut guard = self.tracker.lock().unwrap_or_else(PoisonError::into_inner);
        guard.0.reset();
    }
}

/// A grey image, rows of eight-bit pixels.
fn image(value: &Bound<'_, PyAny>, side: &str) -> PyResult<GrayImage> {
    let wrong = || {
        input(format!(
            "{side}: expected a grey image, an array (height, width) of uint8, found {}",
            shown(value)
        ))
    };
    let array: PyReadonlyArray2<'_, u8> = value.extract().map_err(|_| wrong())?;
    let [height, width] = array.shape() else {
        return Err(wrong());
    };
    let pixels: Vec<u8> = array.as_array().iter().copied().collect();
    GrayImage::from_pixels(*width, *height, pixels).map_err(failed)
}

/// Stereo calibration from photographs of a board.
#[pyfunction]
pub(crate) fn calibrate_stereo<'py>(
    py: Python<'py>,
    left: Vec<PathBuf>,
    right: Vec<PathBuf>,
    board: String,
    square_mm: f64,
    lens: String,
    out: Option<PathBuf>,
) -> PyResult<Bound<'py, PyAny>> {
    let request = Request {
        left,
        right,
        board,
        square_mm,
        lens,
        pixels: Pixels::Plain,
    };
    let output = interruptible(py, &Controls::default(), || {
        let calibration = calibrate(&request).map_err(input)?;
        if let Some(out) = &out {
            needle_steer::stereo::write(out, &calibration).map_err(|e| failed(format!("{e:#}")))?;
        }
        serde_json::to_value(needle_steer::stereo::output(&calibration)).map_err(failed)
    })??;
    document(py, &output)
}

//! Pairs that show nothing.

use hal::{GrayImage, StereoFrame};

use crate::camera::{Camera, View};

/// Least range of grey levels of an image that shows something.
const RANGE: u8 = 12;
/// Largest difference of the two exposures \[s\].
const TOGETHER: f64 = 5e-3;

/// A pair in which no needle can be tracked.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum FrameError {
    /// An image is not of the size that the calibration is for.
    #[error(
        "the {side} image is {width} x {height}, the calibration is for {expected_width} x {expected_height}"
    )]
    Size {
        /// Which image.
        side: &'static str,
        /// Its width \[px\].
        width: usize,
        /// Its height \[px\].
        height: usize,
        /// Width of the calibration \[px\].
        expected_width: usize,
        /// Height of the calibration \[px\].
        expected_height: usize,
    },
    /// An image is of one grey level all over.
    #[error("the {side} image shows nothing: grey levels from {darkest} to {brightest}")]
    Blank {
        /// Which image.
        side: &'static str,
        /// Darkest pixel looked at.
        darkest: u8,
        /// Brightest pixel looked at.
        brightest: u8,
    },
    /// The images were not taken together.
    #[error("the images were taken {apart_s:.3} s apart")]
    Apart {
        /// Difference of the exposures \[s\].
        apart_s: f64,
    },
}

/// Checks that a pair is this rig's.
pub(super) fn fits(pair: &StereoFrame, views: &[View; 2]) -> Result<(), FrameError> {
    let apart_s = pair.right.stamp.secs_since(pair.left.stamp);
    if apart_s.abs() > TOGETHER {
        return Err(FrameError::Apart { apart_s });
    }
    for ((image, view), side) in [&pair.left.image, &pair.right.image]
        .into_iter()
        .zip(views)
        .zip(["left", "right"])
    {
        fits_camera(image, &view.camera, side)?;
    }
    Ok(())
}

/// Checks that an image is of a camera's size.
pub(super) fn fits_camera(
    image: &GrayImage,
    camera: &Camera,
    side: &'static str,
) -> Result<(), FrameError> {
    if (image.width(), image.height()) == (camera.width, camera.height) {
        return Ok(());
    }
    Err(FrameError::Size {
        side,
        width: image.width(),
        height: image.height(),
        expected_width: camera.width,
        expected_height: camera.height,
    })
}

/// Checks that both images show something; looks at every pixel.
pub(super) fn shows(pair: &StereoFrame) -> Result<(), FrameError> {
    blank(&pair.left.image, "left")?;
    blank(&pair.right.image, "right")
}

/// Checks that an image shows something.
pub(super) fn blank(image: &GrayImage, side: &'static str) -> Result<(), FrameError> {
    let (mut darkest, mut brightest) = (u8::MAX, u8::MIN);
    for grey in image.pixels() {
        darkest = darkest.min(*grey);
        brightest = brightest.max(*grey);
    }
    if brightest.saturating_sub(darkest) < RANGE {
        return Err(FrameError::Blank {
            side,
            darkest,
            brightest,
        });
    }
    Ok(())
}

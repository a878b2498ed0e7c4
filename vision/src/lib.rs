//! Stereo calibration and needle tracking.

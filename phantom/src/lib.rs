//! Ground truth: needle, tissue, cameras and their flaws.

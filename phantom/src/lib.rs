//! Ground truth: needle, tissue, cameras and their flaws.

pub mod view;

pub use view::NeedleView;

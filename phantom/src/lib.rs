//! Ground truth: needle, tissue, cameras and their flaws.

pub mod camera;
pub mod view;

pub use view::NeedleView;

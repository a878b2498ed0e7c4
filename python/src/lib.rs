//! The extension module of the Python package `needle_steer`: converts arguments and results, lets
//! go of the interpreter while it works, and has no logic of its own. What it exports is private to
//! the package; the Python files beside it are its users' surface.

#![expect(
    clippy::needless_pass_by_value,
    reason = "extracted arguments are handed over by value"
)]
#![expect(
    clippy::elidable_lifetime_names,
    reason = "the interpreter's lifetime has its name throughout"
)]

mod arrays;
mod campaign;
mod chain;
mod convert;
mod env;
mod errors;
mod hand;
mod identify;
mod law;
mod model;
mod plant;
mod run;
mod vision;
mod work;

/// Private: see the Python files.
#[pyo3::pymodule]
mod _core {
    #[pymodule_export]
    use crate::campaign::{campaign_conclude, campaign_lines, campaign_plan};
    #[pymodule_export]
    use crate::chain::ArmChain;
    #[pymodule_export]
    use crate::env::EnvPool;
    #[pymodule_export]
    use crate::hand::Phantom;
    #[pymodule_export]
    use crate::identify::{estimate, reproduce, validate};
    #[pymodule_export]
    use crate::law::LawView;
    #[pymodule_export]
    use crate::model::NeedleModel;
    #[pymodule_export]
    use crate::run::{default_config, make_config, read_log, report, run, shape};
    #[pymodule_export]
    use crate::vision::{PairTracker, calibrate_stereo};
    #[pymodule_export]
    use crate::work::panic_on_purpose;

    #[pymodule_export]
    const VERSION: &str = needle_steer::VERSION;
}

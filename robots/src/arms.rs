//! The arm descriptions that ship with the program.

/// URDF of the Adept Viper s650 with a needle holder. Root `base_link`; tips of interest
/// `tool0` (the flange) and `needle_base` (60 mm further along the flange's z).
pub const VIPER_S650: &str = include_str!("../urdf/viper_s650.urdf");

/// Link of [`VIPER_S650`] at the bare flange.
pub const FLANGE: &str = "tool0";

/// Link of [`VIPER_S650`] where the needle leaves its holder.
pub const NEEDLE_BASE: &str = "needle_base";

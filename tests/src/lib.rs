//! Simulator-backed integration tests of the whole workspace.
#![cfg(test)]

mod arm_contract;
mod arrows;
mod calibration_truth;
mod equations;
mod tidy;
<<<<<<< HEAD
mod supervision;
=======
mod viper_contract;
>>>>>>> main

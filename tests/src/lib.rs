//! Simulator-backed integration tests of the whole workspace.
#![cfg(test)]

mod arm_contract;
mod arms;
mod arrows;
mod bounds;
mod calibration_truth;
mod devices;
mod equations;
mod hazards;
mod monitor;
mod robustness;
mod ros;
mod singularity;
mod supervision;
mod targets;
mod tidy;
mod tracking;
mod viper_contract;
mod ways_out;
mod wide;
mod withdrawal;

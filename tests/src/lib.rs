//! Simulator-backed integration tests of the whole workspace.
#![cfg(test)]

mod arm_contract;
mod arrows;
mod equations;
mod tidy;
mod supervision;

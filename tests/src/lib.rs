//! Simulator-backed integration tests of the whole workspace.
#![cfg(test)]

mod arrows;
mod equations;
mod tidy;

//! Simulator-backed integration tests of the whole workspace.
#![cfg(test)]

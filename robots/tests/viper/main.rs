//! Fault tests T1-T20 of the Viper's driver against its controller's emulator.
//!
//! | test | where |
//! |---|---|
//! | T1 golden frames, T2 pieces, T3 bad frames, T16 byte order | `frames` |
//! | T4 connections | `links` |
//! | T15 soak | `../viper_soak.rs`, its threads in `sockets` |
//! | T5 delays, T6 lying answers, T14 stalls | `answers` |
//! | T7 emergency stop, T8 mode and power, T20 stop everywhere | `stops` |
//! | T9 bad callers, T13 killed driver, T19 start mismatch | `callers` |
//! | T10 random commands, T11 limits, T12 singularities | `limits` |
//! | T17 lockstep, and on the wall clock | `lockstep`, `sockets` |
//! | T18 second client; T4, T13 over real sockets | `sockets` |
#![expect(clippy::float_cmp, reason = "tests compare exact constructions")]
#![expect(
    clippy::unwrap_used,
    clippy::panic,
    reason = "a helper that fails fails its test"
)]

mod answers;
mod bench;
mod callers;
mod frames;
mod limits;
mod links;
mod lockstep;
mod sockets;
mod stops;

//! Tests of the cameras against independent constructions.

#![expect(clippy::float_cmp, reason = "tests compare exact constructions")]

mod boards;
mod calibrations;
mod delivery;
mod fermat;
mod lenses;
mod noises;
mod scene;
mod scenery;
mod settings;
mod silhouettes;

//! Meshes of the arm, for viewers that draw it: those that its description names, and no other file.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use robots::meshes;

use crate::config::Config;

/// Largest mesh that is sent \[bytes\].
const LARGEST: u64 = 64 << 20;

/// Files of the meshes by the names that the description has for them.
#[derive(Debug)]
pub(super) struct Meshes(BTreeMap<String, Option<PathBuf>>);

impl Meshes {
    /// The meshes of the arm that `config` names, whose description is `urdf`.
    pub(super) fn of(config: &Config, urdf: &str) -> Self {
        let place = Path::new(&config.arm.urdf);
        let names = meshes::names(urdf).into_iter();
        Self(
            names
                .map(|name| {
                    let file = meshes::file(place, &name);
                    (name, file)
                })
                .collect(),
        )
    }

    /// The mesh of that name.
    pub(super) fn read(&self, name: &str) -> Result<Vec<u8>, String> {
        let file = self
            .0
            .get(name)
            .ok_or_else(|| "not named by the arm's description".to_owned())?;
        let file = file
            .as_ref()
            .ok_or_else(|| format!("{name}: no such file"))?;
        let size = std::fs::metadata(file).map_err(|error| error.to_string())?;
        if size.len() > LARGEST {
            return Err(format!("{name}: larger than {LARGEST} bytes"));
        }
        std::fs::read(file).map_err(|error| error.to_string())
    }
}

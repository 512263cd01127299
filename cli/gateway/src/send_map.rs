//! `volcomp-gateway send-map`: loads a correction map into a control that interpolates it itself, and keeps the map
//! valid.

use std::{
    fmt::Write as _,
    path::{Path, PathBuf},
};

use sha2::{Digest, Sha256};
use volcomp_devices::map_device;
use volcomp_tables::{Map, Transfer, axes_of};

use crate::{config::MapSender, error::GatewayError};

mod sending;

pub use sending::{request_replacement, run};

#[derive(Clone, Debug)]
pub struct Checked {
    /// Settings of the sender: the control, the limits, and the addresses in the control's memory.
    pub config: MapSender,
    /// The map, within the limits of `config`.
    pub map: Map,
    pub path: PathBuf,
    /// First 16 hexadecimal digits of the SHA-256 of the map file, which confirm the map.
    pub hash: String,
}

/// Reads a sender's configuration and its map, and checks the map against the limits. No device is opened.
///
/// # Errors
/// A file is unreadable or invalid, or the map is damaged, for another machine, or beyond the limits.
pub fn check(path: &Path) -> Result<Checked, GatewayError> {
    let config = MapSender::read(path)?;
    // Reject an unreadable password before anything else is prepared.
    map_device(&config.keys).map_err(GatewayError::Device)?;
    let shown = config.keys.map.display().to_string();
    let bytes = std::fs::read(&config.keys.map)
        .map_err(|source| GatewayError::Read { file: shown.clone(), source })?;
    let wrong = |what: String| GatewayError::invalid_in(&shown, what);
    let map = Map::from_image(&bytes, config.keys.number).map_err(|e| wrong(e.to_string()))?;
    let admitted = config.allowed.check_map(&map);
    admitted.map_err(|e| wrong(e.to_string()))?;
    let hash = volcomp_model::hexadecimal(&Sha256::digest(&bytes)[..8]);
    Ok(Checked { config, map, path: path.to_owned(), hash })
}

impl Checked {
    /// Checks that `hash`, which the user confirmed, is the hash of the map.
    ///
    /// # Errors
    /// `hash` is another hash.
    pub fn confirmed(&self, hash: &str) -> Result<(), GatewayError> {
        if hash == self.hash {
            return Ok(());
        }
        Err(GatewayError::invalid_in(
            self.config.keys.map.display(),
            format_args!(
                "--confirm: found {hash:?}, expected {:?}: another map was confirmed",
                self.hash
            ),
        ))
    }

    /// Formats a summary of the map and its destination.
    #[must_use]
    pub fn text(&self) -> String {
        let header = self.map.header();
        let names = |layout| {
            let names: Vec<String> = axes_of(layout).map(|axis| axis.to_string()).collect();
            names.join(" ")
        };
        let allowed = &self.config.allowed;
        let mut text = String::new();
        let lines = [
            ("control", format!("{}, machine {}", self.config.keys.url, self.config.keys.number)),
            (
                "map",
                format!(
                    "number {}, of the machine file {:08x}…, {} words of {}, {} frames",
                    header.counter,
                    header.model,
                    self.map.words().len(),
                    allowed.capacity,
                    Transfer::of(&self.map).frames
                ),
            ),
            ("corrects", format!("{} over {}", names(header.outputs), names(header.grid))),
            (
                "within",
                format!(
                    "{:.1} µm, {:.1} µm/s; goes to zero {:.0} ms after the last frame at the latest",
                    allowed.limit_mm * 1e3,
                    allowed.slew_mm_per_s * 1e3,
                    allowed.zero_after_s * 1e3
                ),
            ),
            ("send it with", format!("--confirm {}", self.hash)),
        ];
        for (name, value) in lines {
            // Writing to a string never fails.
            let _ = writeln!(text, "{name:13} {value}");
        }
        text
    }
}

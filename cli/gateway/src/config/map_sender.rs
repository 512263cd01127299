//! The file of a map sender: which map goes into which control, and within which limits.

use std::path::Path;

use volcomp_devices::{config, map::MapKeys};
use volcomp_document::{Document, InputErrors, Mistakes};
use volcomp_guard::{barrier::LARGEST_MACHINE, ceiling};
use volcomp_tables::{
    Allowed, HEADER_WORDS, MOST_WORDS,
    control::{FRAME_WORDS, REPORT_WORDS},
};

use crate::error::GatewayError;

/// The longest time without a sender until a control goes to zero, s.
const LONGEST_SILENCE_S: f64 = 60.0;

/// Everything that the file of a map sender says.
#[derive(Clone, Debug, PartialEq)]
pub struct MapSender {
    /// The name of the file as messages have it.
    pub file: String,
    /// Its keys; paths are relative to its folder.
    pub keys: MapKeys,
    /// The largest correction, its fastest change and the longest silence that the control may be set to.
    pub allowed: Allowed,
}

impl MapSender {
    /// Reads a file.
    ///
    /// # Errors
    /// A file that cannot be read, or with file, line and key everything that is wrong in it.
    pub fn read(path: &Path) -> Result<Self, GatewayError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let document = Document::read(path)?;
        Ok(Self::decode(
            &document,
            &path.display().to_string(),
            folder,
        )?)
    }

    /// Takes the text of a file; paths in it are relative to `folder`.
    ///
    /// # Errors
    /// With file, line and key everything that is wrong.
    pub fn parse(text: &str, file: &str, folder: &Path) -> Result<Self, InputErrors> {
        Self::decode(&Document::new(file, text), file, folder)
    }

    fn decode(document: &Document, file: &str, folder: &Path) -> Result<Self, InputErrors> {
        let (mut keys, mut found) = document.structure::<MapKeys>(|_| None)?;
        validate(&keys, &mut found);
        keys.join(folder);
        let sender = Self {
            file: file.to_owned(),
            allowed: Allowed {
                limit_mm: keys.limit_um * 1e-3,
                slew_mm_per_s: keys.slew_um_per_s * 1e-3,
                zero_after_s: keys.zero_after_ms * 1e-3,
                scan_s: keys.scan_ms * 1e-3,
                capacity: keys.capacity,
            },
            keys,
        };
        found.none_or(sender)
    }
}

/// Reports every mistake.
fn validate(keys: &MapKeys, found: &mut Mistakes<'_>) {
    for key in [
        "map",
        "url",
        "number",
        "capacity",
        "scan_ms",
        "limit_um",
        "slew_um_per_s",
        "zero_after_ms",
    ] {
        found.require("", key);
    }
    if found.states("map") {
        config::path("map", &keys.map, found);
    }
    config::path("audit.dir", &keys.audit.dir, found);
    found.whole("number", keys.number, 0..=LARGEST_MACHINE);
    // A head and one value at the least.
    found.whole("capacity", keys.capacity, HEADER_WORDS + 1..=MOST_WORDS);
    let most_um = ceiling::LIMIT.0 * 1e3;
    let fastest_um = ceiling::SLEW_PER_S.0 * 1e3;
    found.range("limit_um", keys.limit_um, 0.001..=most_um);
    found.range("slew_um_per_s", keys.slew_um_per_s, 0.001..=fastest_um);
    let longest = LONGEST_SILENCE_S * 1e3;
    found.range("zero_after_ms", keys.zero_after_ms, 100.0..=longest);
    found.range("scan_ms", keys.scan_ms, 0.1..=1000.0);
    keys.validate_control([FRAME_WORDS, REPORT_WORDS], found);
}

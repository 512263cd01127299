use std::path::Path;

use volcomp_devices::{config, map::MapKeys};
use volcomp_document::{Document, InputErrors, Mistakes};
use volcomp_guard::{barrier::LARGEST_MACHINE, ceiling};
use volcomp_tables::{
    HEADER_WORDS, MAX_WORDS, SenderLimits,
    control::{FRAME_WORDS, REPORT_WORDS},
};

use crate::error::GatewayError;

/// Maximum time after the last frame until a control ramps to zero, s.
const LONGEST_SILENCE_S: f64 = 60.0;

/// The configuration of a map sender.
#[derive(Clone, Debug, PartialEq)]
pub struct MapSender {
    /// File name used in messages.
    pub file: String,
    /// The keys; relative paths are resolved against the folder of the file.
    pub keys: MapKeys,
    /// Upper bounds for the settings of the control: correction, rate and timeout.
    pub allowed: SenderLimits,
}

impl MapSender {
    /// Reads the configuration file.
    ///
    /// # Errors
    /// The file cannot be read, or it is invalid: every error with file, line and key.
    pub fn read(path: &Path) -> Result<Self, GatewayError> {
        let folder = path.parent().unwrap_or(Path::new(""));
        let document = Document::read(path)?;
        Ok(Self::decode(&document, &path.display().to_string(), folder)?)
    }

    /// Parses the text of a configuration; relative paths are resolved against `folder`.
    ///
    /// # Errors
    /// Every error, with file, line and key.
    pub fn parse(text: &str, file: &str, folder: &Path) -> Result<Self, InputErrors> {
        Self::decode(&Document::new(file, text), file, folder)
    }

    fn decode(document: &Document, file: &str, folder: &Path) -> Result<Self, InputErrors> {
        let (mut keys, mut found) = document.structure::<MapKeys>(|_| None)?;
        validate(&keys, &mut found);
        keys.join(folder);
        let sender = Self {
            file: file.to_owned(),
            allowed: SenderLimits {
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
    // Room for the header and at least one value.
    found.whole("capacity", keys.capacity, HEADER_WORDS + 1..=MAX_WORDS);
    let most_um = ceiling::LIMIT.0 * 1e3;
    let fastest_um = ceiling::SLEW_PER_S.0 * 1e3;
    found.range("limit_um", keys.limit_um, 0.001..=most_um);
    found.range("slew_um_per_s", keys.slew_um_per_s, 0.001..=fastest_um);
    let longest = LONGEST_SILENCE_S * 1e3;
    found.range("zero_after_ms", keys.zero_after_ms, 100.0..=longest);
    found.range("scan_ms", keys.scan_ms, 0.1..=1000.0);
    keys.validate_control([FRAME_WORDS, REPORT_WORDS], found);
}

//! Kinds of TOML file. The error for a file of the wrong kind names that kind instead of the first unknown key.

use crate::{error::InputError, toml_file::Section};

/// Kind of TOML file. Each kind has some keys that no other kind has.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// Geometry and errors of a machine.
    Machine,
    /// Measurement files of a machine, and the set-up of each measurement.
    Calibration,
    /// Volumetric observations, and the unknowns to estimate from them.
    Observations,
    /// Virtual shop, which is a machine and the instruments that measure it.
    Shop,
    /// Configuration of the gateway.
    Gateway,
    /// Registers of a Modbus module.
    Profile,
}

impl FileKind {
    const ALL: [Self; 6] = [
        Self::Machine,
        Self::Calibration,
        Self::Observations,
        Self::Shop,
        Self::Gateway,
        Self::Profile,
    ];

    fn name(self) -> &'static str {
        match self {
            Self::Machine => "a machine file",
            Self::Calibration => "a calibration file",
            Self::Observations => "a file of observations",
            Self::Shop => "a shop file",
            Self::Gateway => "a configuration of the gateway",
            Self::Profile => "a profile of a Modbus module",
        }
    }

    fn own_keys(self) -> &'static [&'static str] {
        match self {
            Self::Machine => &["structure", "type", "axes", "errors", "assembly", "thermal"],
            Self::Calibration => &["reference", "reference_axes", "uncertainty"],
            Self::Observations => &["unknown", "observation", "folds"],
            Self::Shop => &["instrument", "seed", "format"],
            Self::Gateway => &["controller", "thermometer", "guard", "cycle_ms", "audit"],
            Self::Profile => &["channels", "digital", "baud"],
        }
    }
}

impl Section<'_> {
    /// Rejects every root key except the expected keys. If the file has a key that is specific to another kind of file,
    /// and no key that is specific to this kind, the error names the other kind instead of a key.
    ///
    /// # Errors
    /// The file is of another kind, or has an unknown key. The error for the first unknown key is that of
    /// [`Section::allow`].
    pub fn allow_in(&self, kind: FileKind, expected: &[&str]) -> Result<(), InputError> {
        let Err(unknown) = self.allow(expected) else {
            return Ok(());
        };
        Err(self.other_kind(kind, expected).unwrap_or(unknown))
    }

    /// Error for a file of another kind, which has a key that is specific to that kind and no key that is specific to
    /// `kind`. `None` for any other file.
    pub fn other_kind(&self, kind: FileKind, expected: &[&str]) -> Option<InputError> {
        let key_of = |kind: FileKind| kind.own_keys().iter().find(|key| self.get(key).is_some());
        // A calibration file may also contain observations, so expected keys do not identify another kind.
        let foreign = |kind: FileKind| {
            let mut keys = kind.own_keys().iter();
            keys.find(|key| !expected.contains(key) && self.get(key).is_some())
        };
        // Calibration and shop files may both contain measurements. So measurements identify a calibration file only if
        // neither kind was expected.
        let no_measurements = !matches!(kind, FileKind::Shop | FileKind::Calibration);
        let measured = (no_measurements && self.get("measurement").is_some())
            .then_some((FileKind::Calibration, &"measurement"));
        let mut others = FileKind::ALL.into_iter().filter(|other| *other != kind);
        let found = others.find_map(|other| foreign(other).map(|key| (other, key))).or(measured);
        match found {
            Some((other, key)) if key_of(kind).is_none() => {
                let (found, expected) = (other.name(), kind.name());
                Some(
                    self.error(format!(
                        "found {found} (it has the key `{key}`), expected {expected}"
                    )),
                )
            }
            _ => None,
        }
    }
}

//! The kinds of TOML file that the programs read: a file of another kind is named instead of its first unknown key.

use crate::{error::InputError, toml_file::Section};

/// A kind of TOML file, with its own keys.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum FileKind {
    /// The geometry and the errors of a machine.
    Machine,
    /// The measurement files of a machine, and how each was taken.
    Calibration,
    /// Volumetric observations, and what is to be found from them.
    Observations,
    /// A virtual shop: a machine and the instruments that measure it.
    Shop,
    /// The configuration of the gateway.
    Gateway,
    /// The registers of a Modbus module.
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

    /// The name in messages.
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

    /// Keys of the root that files of no other kind have.
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
    /// Refuses every key of the root of a file but those expected in a file of this kind. A file that has a key of
    /// another kind of file, and none of this kind's own, is refused as a whole.
    ///
    /// # Errors
    /// The other kind of file, else the first unknown key, as [`Section::allow`] names it.
    pub fn allow_in(&self, kind: FileKind, expected: &[&str]) -> Result<(), InputError> {
        let Err(unknown) = self.allow(expected) else {
            return Ok(());
        };
        Err(self.other_kind(kind, expected).unwrap_or(unknown))
    }

    /// The error of a file that has a key of another kind of file, and none of this kind's own.
    pub fn other_kind(&self, kind: FileKind, expected: &[&str]) -> Option<InputError> {
        let key_of = |kind: FileKind| kind.own_keys().iter().find(|key| self.get(key).is_some());
        // A calibration file may have observations, too.
        let foreign = |kind: FileKind| {
            let mut keys = kind.own_keys().iter();
            keys.find(|key| !expected.contains(key) && self.get(key).is_some())
        };
        // Measurements stand in calibration and shop files, and make no other kind of file.
        let no_measurements = !matches!(kind, FileKind::Shop | FileKind::Calibration);
        let measured = (no_measurements && self.get("measurement").is_some())
            .then_some((FileKind::Calibration, &"measurement"));
        let mut others = FileKind::ALL.into_iter().filter(|other| *other != kind);
        let found = others
            .find_map(|other| foreign(other).map(|key| (other, key)))
            .or(measured);
        match found {
            Some((other, key)) if key_of(kind).is_none() => {
                let (found, expected) = (other.name(), kind.name());
                Some(self.error(format!(
                    "found {found} (it has the key `{key}`), expected {expected}"
                )))
            }
            _ => None,
        }
    }
}

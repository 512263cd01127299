//! The unit of targets.

use volcomp_document::unit_named;
use volcomp_vocabulary::AxisKind;

/// The unit in which a file has its targets.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
#[cfg_attr(feature = "serde", serde(rename_all = "lowercase"))]
pub enum TargetUnit {
    /// Millimetres.
    Mm,
    /// Degrees.
    Deg,
}

impl TargetUnit {
    /// The word in files: `mm` or `deg`.
    pub fn key(self) -> &'static str {
        self.kind().coordinate_unit()
    }

    /// The unit by any of its names; `None` where targets are never in it.
    pub(crate) fn named(text: &str) -> Option<Self> {
        match unit_named(text)? {
            "mm" => Some(Self::Mm),
            "deg" => Some(Self::Deg),
            _ => None,
        }
    }

    /// The kind of the axis that has such targets.
    pub fn kind(self) -> AxisKind {
        match self {
            Self::Mm => AxisKind::Linear,
            Self::Deg => AxisKind::Rotary,
        }
    }
}

//! Renishaw laser files: `.rtl` (linear, µm), `.rta` (angular, milliradian) and `.rts` (straightness, taken as µm), the dynamic captures `.rtx` and
//! the compensation exports `.REN`.

mod capture;
mod directions;
mod document;
mod environment;
mod export;
mod parse;
mod sections;
mod write;

pub use capture::{Capture, parse_rtx};
pub use export::parse_ren;
pub use parse::parse_renishaw;
pub use write::write_renishaw;

use crate::{DeviationUnit, FileFormat, Quantity};

/// Kind of a Renishaw laser file.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum RenishawKind {
    /// `.rtl`: linear, deviations in µm.
    Linear,
    /// `.rta`: angular, deviations in milliradian in the file, in µrad in memory.
    Angular,
    /// `.rts`: straightness, deviations perpendicular to the axis, taken as µm: the unit is not verified with a real file.
    Straightness,
}

impl RenishawKind {
    fn file_type(self) -> &'static str {
        match self {
            Self::Linear => "rtl",
            Self::Angular => "rta",
            Self::Straightness => "rts",
        }
    }

    fn unit(self) -> DeviationUnit {
        match self {
            Self::Linear | Self::Straightness => DeviationUnit::Um,
            Self::Angular => DeviationUnit::Urad,
        }
    }

    /// µm or µrad per unit of the file.
    fn scale(self) -> f64 {
        match self {
            Self::Linear | Self::Straightness => 1.0,
            Self::Angular => 1000.0,
        }
    }

    fn format(self) -> FileFormat {
        match self {
            Self::Linear => FileFormat::RenishawLinear,
            Self::Angular => FileFormat::RenishawAngular,
            Self::Straightness => FileFormat::RenishawStraightness,
        }
    }

    fn quantity(self) -> Quantity {
        match self {
            Self::Linear => Quantity::Positioning,
            Self::Angular => Quantity::Angle,
            Self::Straightness => Quantity::Straightness,
        }
    }
}

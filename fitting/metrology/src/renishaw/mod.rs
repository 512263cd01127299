//! Renishaw laser files: `.rtl` (linear, µm), `.rta` (angular, milliradian) and `.rts` (straightness, taken as µm);
//! also the dynamic captures `.rtx` and the compensation exports `.REN`.

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
    /// `.rtl`: linear optics, deviations in µm.
    Linear,
    /// `.rta`: angular optics. Deviations are in milliradian in the file and in µrad in memory.
    Angular,
    /// `.rts`: straightness optics. Deviations perpendicular to the axis are taken as µm; this unit is not verified
    /// with a real file.
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

    /// Factor from the unit of the file to µm or µrad.
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

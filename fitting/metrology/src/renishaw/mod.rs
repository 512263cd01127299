//! Renishaw laser files: `.rtl` (linear, µm) and `.rta` (angular, milliradian).

mod directions;
mod document;
mod environment;
mod parse;
mod sections;
mod write;

pub use parse::parse_renishaw;
pub use write::write_renishaw;

use crate::DeviationUnit;

/// Which of the Renishaw formats a file is.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum RenishawKind {
    /// `.rtl`: linear, deviations in µm.
    Linear,
    /// `.rta`: angular, deviations in milliradian in the file, in µrad in memory.
    Angular,
}

impl RenishawKind {
    fn file_type(self) -> &'static str {
        match self {
            Self::Linear => "rtl",
            Self::Angular => "rta",
        }
    }

    fn unit(self) -> DeviationUnit {
        match self {
            Self::Linear => DeviationUnit::Um,
            Self::Angular => DeviationUnit::Urad,
        }
    }

    /// µm or µrad for one unit of the file.
    fn scale(self) -> f64 {
        match self {
            Self::Linear => 1.0,
            Self::Angular => 1000.0,
        }
    }
}

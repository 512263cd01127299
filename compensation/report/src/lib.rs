#![doc = include_str!("../README.md")]

mod asked_for;
mod build;
mod curves;
mod html;
mod identified;
pub mod plot;
mod positioning;
mod report;
mod squares;
mod stated;
mod texts;
mod tolerance;
mod volume;
mod warnings;

pub use html::html;
pub use report::{
    AxisTravel, Band, BandKind, Branch, Check, Curve, CurveLine, Diagonal, Diagonals, FitNumbers,
    Head, Identified, Location, Outcome, Parameter, Positioning, Report, Run, Size, Slice,
    SourceFile, Square, State, Uncertainty, Vector, Volume, Warning, WarningKind,
};
pub use stated::Stated;
pub use texts::Language;
pub use tolerance::{Figure, SYMBOLS, Tolerance, ToleranceError, VOLUME, checks, tolerances};
pub use volume::{ErrorAt, uncertainty, volume};

#![doc = include_str!("../README.md")]

mod build;
mod curves;
mod html;
mod pictures;
pub mod plot;
mod report;
mod tolerance;
mod volume;

pub use html::html;
pub use pictures::{
    CirclePlot, ProgramFigures, ProgramPlace, SlopePlot, SquarenessPlot, StraightnessPlot,
    circles_picture, curve_picture, diagonals_picture, effects_picture, map_picture,
    measured_diagonals_picture, positioning_picture, program_picture, residuals_picture,
    squareness_picture, straightness_picture,
};
pub use report::{
    Band, Branch, Check, CheckOf, Contribution, Curve, CurveLine, Diagonal, Diagonals, Drawn,
    FigureUncertainty, FitNumbers, Head, Identified, Location, OfState, Parameter, Positioning,
    Report, Residual, Run, Size, Slice, SourceFile, Square, State, Stated, Tilt, Uncertainty,
    VOLUME, Vector, Volume, Warning, WarningKind,
};
pub use tolerance::{checks, refuse_two_units, tolerances};
pub use volcomp_fit::BandSource;
pub use volcomp_identify::Figures;
pub use volcomp_metrology::{Edition, Tolerance, Verdict};
pub use volume::{ErrorAt, uncertainty, volume};

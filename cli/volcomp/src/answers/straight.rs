//! The JSON documents of `volcomp straightness` and `volcomp squareness`.

use schemars::JsonSchema;
use serde::Serialize;

use super::quantity::{Decision, Quantity};

/// The document of `volcomp straightness`: of one file, or of each.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub(crate) enum StraightnessDocument {
    /// Of several files, in their order.
    Many {
        /// The evaluation of each.
        files: Vec<StraightnessDocument>,
    },
    /// Of one file.
    One(Box<Straightness>),
    /// A file that is refused, among others.
    Refused {
        /// The file as it was named in the call.
        file: String,
        /// Why it is refused.
        error: String,
    },
}

/// The straightness of a motion.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Straightness {
    /// The file as it was named in the call.
    pub(crate) file: String,
    /// How the readings were made: `direct`, or `angular-method` with `--bridge-mm`.
    pub(crate) method: &'static str,
    /// The straightness about each reference line.
    pub(crate) quantities: Vec<Quantity>,
    /// The slope of each reference line, µrad: least squares, end points, minimum zone.
    pub(crate) slopes_urad: [f64; 3],
    /// Standard uncertainty of the slope of least squares by the residuals, µrad; null with two targets.
    pub(crate) slope_standard_uncertainty_urad: Option<f64>,
    /// The largest difference of the two directions, µm; null with one direction or by the angular method.
    pub(crate) reversal_um: Option<f64>,
    /// The reference line that is taken out of the profile below.
    pub(crate) reference: &'static str,
    /// Targets, mm, and deviations from that line, µm.
    pub(crate) profile: Vec<[f64; 2]>,
    /// What was decided on the tolerances; null without any.
    pub(crate) decision: Option<Decision>,
    /// Whether every quantity with a tolerance passes; null without tolerances.
    pub(crate) pass: Option<bool>,
    /// Notes in words on the file and its readings.
    pub(crate) notes: Vec<String>,
}

/// The document of `volcomp squareness`.
#[derive(Debug, Serialize, JsonSchema)]
#[expect(
    clippy::struct_field_names,
    reason = "the keys are those of the document"
)]
pub(crate) struct Squareness {
    /// The squareness error: `EC0Y`, `EA0Z` or `EB0Z`.
    pub(crate) error: String,
    /// The two straightness errors with their files and slopes.
    pub(crate) parts: [SquarenessPart; 2],
    /// The angle of the reference beams, less 90°, µrad.
    pub(crate) reference_angle_urad: f64,
    /// The reference line whose slopes count.
    pub(crate) reference: &'static str,
    /// The squareness, µrad.
    pub(crate) squareness_urad: f64,
    /// Its expanded uncertainty (k = 2), µrad, of what is stated; null where a file has two targets or with another line than that of
    /// least squares.
    pub(crate) uncertainty_urad: Option<f64>,
    /// What it is made of; null where it is.
    pub(crate) uncertainty: Option<SquarenessUncertainty>,
    /// The squareness as a quantity, with its tolerance.
    pub(crate) quantities: Vec<Quantity>,
    /// What was decided on the tolerances; null without any.
    pub(crate) decision: Option<Decision>,
    /// Whether it is within its tolerance; null without one.
    pub(crate) pass: Option<bool>,
    /// Notes in words on the files and their readings.
    pub(crate) notes: Vec<String>,
}

/// The contributions to the uncertainty of a squareness, expanded (k = 2), µrad; null: not stated, and left out.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct SquarenessUncertainty {
    /// Of both slopes, by what their lines leave, straightness included.
    pub(crate) scatter_urad: f64,
    /// Of the square, by its calibration.
    pub(crate) square_urad: Option<f64>,
    /// Of the straight edge under both lines.
    pub(crate) straight_edge_urad: Option<f64>,
    /// Of changes of temperature.
    pub(crate) temperature_urad: Option<f64>,
    /// What was not stated.
    pub(crate) left_out: Vec<String>,
}

/// One of the two lines.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct SquarenessPart {
    /// The straightness error: `EXY`.
    pub(crate) error: String,
    /// The file as it was named in the call.
    pub(crate) file: String,
    /// The slope of its reference line, µrad.
    pub(crate) slope_urad: f64,
}

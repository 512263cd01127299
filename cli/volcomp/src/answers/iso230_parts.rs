//! The JSON documents of `volcomp iso230 --part 4` and `--part 6`.

use schemars::JsonSchema;
use serde::Serialize;

use super::quantity::{Decision, Quantity};

/// The document of `volcomp iso230 --part 4`: of one file, or of each.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub(crate) enum CircularTests {
    /// Of several files, in their order.
    Many {
        /// The evaluation of each.
        files: Vec<CircularTests>,
    },
    /// Of one file.
    One(Box<CircularTest>),
    /// A file that is refused, among others.
    Refused {
        /// The file as it was named in the call.
        file: String,
        /// Why it is refused.
        error: String,
    },
}

/// A circular test.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct CircularTest {
    /// The file as it was named in the call.
    pub(crate) file: String,
    /// The plane: `xy`, `yz` or `zx`.
    pub(crate) plane: &'static str,
    /// The nominal radius, mm; without `--radius-mm` the mean radius of the points.
    pub(crate) radius_mm: f64,
    /// Number of points run counter-clockwise, and clockwise.
    pub(crate) points: [usize; 2],
    /// G of each sense, G(b), F and D.
    pub(crate) quantities: Vec<Quantity>,
    /// The centre of least squares that was taken out, along the two axes, µm: with positions what is left of it after
    /// their centre was taken out when they were read.
    pub(crate) centre_um: [f64; 2],
    /// What the shape hints at, the largest first; empty where the points do not tell it.
    pub(crate) signatures: Vec<Signature>,
    /// Spikes at 0°, 90°, 180° and 270°, µm outward, null of a place that the points do not pass; null without signatures.
    pub(crate) spikes_um: Option<[Option<f64>; 4]>,
    /// Root mean square of what the signatures leave, µm; null without signatures.
    pub(crate) rms_left_um: Option<f64>,
    /// What was decided on the tolerances; null without any.
    pub(crate) decision: Option<Decision>,
    /// Whether every quantity with a tolerance passes; null without tolerances.
    pub(crate) pass: Option<bool>,
    /// Notes in words on the file and its points.
    pub(crate) notes: Vec<String>,
}

/// What the shape of a circle hints at.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Signature {
    /// `squareness`, `scale-mismatch`, `backlash-first`, `backlash-second`, `servo-mismatch`, `spikes-first` or `spikes-second`.
    pub(crate) kind: &'static str,
    /// The error or the axes that it belongs to: `EC0Y`, `X`, `X − Y`.
    pub(crate) of: String,
    /// Its size; of a squareness with the sign of the error that it names.
    pub(crate) size: f64,
    /// The unit of the size: `um` or `urad` (µm/m of a scale).
    pub(crate) unit: &'static str,
    /// Expanded uncertainty (k = 2) of the size by what the fit leaves.
    pub(crate) uncertainty: f64,
    /// The range of its radial deviation by itself, µm.
    pub(crate) range_um: f64,
    /// Its share of the ranges of all.
    pub(crate) share: f64,
    /// Of a servo mismatch the delay of the first axis behind the second, ms; only with `--feed`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) delay_ms: Option<f64>,
}

/// The document of `volcomp iso230 --part 6`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct MeasuredDiagonals {
    /// The diagonals in the order of the standard.
    pub(crate) diagonals: Vec<MeasuredDiagonal>,
    /// E_d, B_d, M_d and the spread, over all.
    pub(crate) quantities: Vec<Quantity>,
    /// What all diagonals have in common, µm/m.
    pub(crate) scale_um_per_m: f64,
    /// What the diagonals hint at; empty without `--box-mm` or where one is lacking.
    pub(crate) squareness: Vec<SquarenessHint>,
    /// Diagonals of the set that were not measured.
    pub(crate) lacking: Vec<&'static str>,
    /// Files that are refused; the others are evaluated.
    pub(crate) refused: Vec<RefusedFile>,
    /// What was decided on the tolerances; null without any.
    pub(crate) decision: Option<Decision>,
    /// Whether every quantity with a tolerance passes; null without tolerances.
    pub(crate) pass: Option<bool>,
    /// Notes in words on the files and their readings.
    pub(crate) notes: Vec<String>,
}

/// A file that is refused, among others.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct RefusedFile {
    /// The file as it was named in the call.
    pub(crate) file: String,
    /// Why it is refused.
    pub(crate) error: String,
}

/// One measured diagonal.
#[derive(Debug, Serialize, JsonSchema)]
#[expect(non_snake_case, reason = "the symbols of ISO 230-6 are keys")]
pub(crate) struct MeasuredDiagonal {
    /// Its name: `PPP`.
    pub(crate) diagonal: &'static str,
    /// The file as it was named in the call.
    pub(crate) file: String,
    /// Its length, mm.
    pub(crate) length_mm: f64,
    /// Systematic deviation of both directions; null with one direction.
    pub(crate) E_um: Option<f64>,
    /// Systematic deviation forward.
    pub(crate) E_forward_um: Option<f64>,
    /// Systematic deviation backward.
    pub(crate) E_backward_um: Option<f64>,
    /// Reversal value.
    pub(crate) B_um: Option<f64>,
    /// Mean deviation of both directions.
    pub(crate) M_um: Option<f64>,
    /// By how much it is too long over its length, by least squares.
    pub(crate) growth_um: f64,
}

/// A squareness error that diagonals hint at.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct SquarenessHint {
    /// `EC0Y`, `EA0Z` or `EB0Z`.
    pub(crate) error: String,
    /// Its size, µrad.
    pub(crate) urad: f64,
}

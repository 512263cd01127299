//! The JSON documents of `volcomp simulate`, `volcomp age` and `volcomp demo`.

#![expect(clippy::struct_field_names, reason = "the keys are named in full")]

use schemars::JsonSchema;
use serde::Serialize;

/// The document of `volcomp simulate`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Simulate {
    /// The folder of the files.
    pub(crate) folder: String,
    /// Names of the files that were written.
    pub(crate) files: Vec<String>,
    /// Names of those of them that stand in the place of an earlier file.
    pub(crate) replaced: Vec<String>,
    /// The calibration file that reads the lines; null where only observations were made.
    pub(crate) calibration: Option<String>,
    /// The file of observations that reads the observations; null where none were made.
    pub(crate) observations: Option<String>,
    /// The commands that make a machine file of them, in their order, to be run where this one was.
    pub(crate) next: Vec<String>,
}

/// The document of `volcomp demo`: before and after, of everything.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Demo {
    /// Every measured line of a linear error.
    pub(crate) lines: Vec<Line>,
    /// Every squareness, as the slopes of the lines show it.
    pub(crate) squareness: Vec<Squareness>,
    /// The body diagonals of ISO 230-6.
    pub(crate) diagonals: Vec<Diagonal>,
    /// Mean change in percent over lines or diagonals of one kind; negative is better.
    pub(crate) mean_percent: MeanPercent,
    /// The largest ratio of what is left of a line to its floor.
    pub(crate) worst_times_floor: f64,
    /// The deviation that each of three kinds of curve leaves of one irregular axis.
    pub(crate) irregular_curve: IrregularCurve,
    /// The curves that the calibration fitted, with their settings.
    pub(crate) curves: Vec<FittedCurve>,
    /// These figures beside those of the paper on such a gantry.
    pub(crate) published: Published,
}

/// The figures of the demo beside those of the paper.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Published {
    /// Peak to peak along the lines.
    pub(crate) lines: Vec<PublishedLine>,
    /// What is left of the mean readings at the targets.
    pub(crate) residuals: Vec<PublishedResidual>,
}

/// A line beside that of the paper, peak to peak.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct PublishedLine {
    /// The error that the line shows: `EXX`.
    pub(crate) error: &'static str,
    /// Where the other axes stand.
    pub(crate) line: String,
    /// On the machine as it is, µm.
    pub(crate) before_um: f64,
    /// On the corrected machine, µm.
    pub(crate) after_um: f64,
    /// What the paper prints as before, µm.
    pub(crate) paper_before_um: f64,
    /// What the paper prints as after, µm; null where it prints none.
    pub(crate) paper_after_um: Option<f64>,
}

/// What a method leaves of the mean readings at the targets, beside the paper.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct PublishedResidual {
    /// The error that was fitted.
    pub(crate) error: &'static str,
    /// The method, or `chosen`: the one that the automatic choice takes.
    pub(crate) method: String,
    /// The smallest residual, µm.
    pub(crate) min_um: f64,
    /// The largest residual, µm.
    pub(crate) max_um: f64,
    /// What the paper prints as the smallest, µm; null where it prints none.
    pub(crate) paper_min_um: Option<f64>,
    /// What the paper prints as the largest, µm; null where it prints none.
    pub(crate) paper_max_um: Option<f64>,
}

/// A fitted curve and its settings.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub(crate) struct FittedCurve {
    /// The error by its name, such as `EXX`.
    pub(crate) error: String,
    /// `forward` or `backward`; null: one curve for both directions.
    pub(crate) direction: Option<&'static str>,
    /// Kind of curve, as the machine file names it.
    pub(crate) curve: &'static str,
    /// Order of the local polynomials of moving least squares; null of other kinds.
    pub(crate) order: Option<usize>,
    /// Half width of the weight of moving least squares as a share of the range; null of other kinds.
    pub(crate) support: Option<f64>,
}

/// One measured line, peak to peak; straightness without its least-squares line.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Line {
    /// The error that the line shows: `EXX`.
    pub(crate) error: String,
    /// Where the other axes stand.
    pub(crate) line: String,
    /// On the machine as it is, µm.
    pub(crate) before_um: f64,
    /// On the corrected machine, µm.
    pub(crate) after_um: f64,
    /// The deviation that the noise of the measurement and the rounding of the correction leave even of a curve that
    /// is known perfectly, µm.
    pub(crate) floor_um: f64,
    /// The ratio of after to floor.
    pub(crate) times_floor: f64,
}

/// A squareness before and after.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Squareness {
    /// The squareness error by its name, such as `EC0Y`.
    pub(crate) error: String,
    /// On the machine as it is, µrad.
    pub(crate) before_urad: f64,
    /// On the corrected machine, µrad.
    pub(crate) after_urad: f64,
}

/// The range of the deviations along a body diagonal.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Diagonal {
    /// `PPP`, `NPP`, `PNP` or `PPN`.
    pub(crate) diagonal: &'static str,
    /// On the machine as it is, µm.
    pub(crate) before_um: f64,
    /// On the corrected machine, µm.
    pub(crate) after_um: f64,
}

/// Mean change in percent.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct MeanPercent {
    /// Of the positioning lines.
    pub(crate) positioning: f64,
    /// Of the straightness lines.
    pub(crate) straightness: f64,
    /// Of the body diagonals.
    pub(crate) diagonals: f64,
}

/// Peak to peak of truth minus curve over 61 points, by kind of curve.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct IrregularCurve {
    /// The fitted error by its name, such as `EXX`.
    pub(crate) error: &'static str,
    /// Left by a polynomial of order 6, µm.
    pub(crate) polynomial_um: f64,
    /// Left by moving least squares, µm.
    pub(crate) mls_um: f64,
    /// Left by the smoothing B-spline, µm.
    pub(crate) bspline_um: f64,
}

/// The document of `volcomp age`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Age {
    /// The machine file that was written.
    pub(crate) file: String,
    /// Months of work.
    pub(crate) months: f64,
    /// How hard it worked.
    pub(crate) load: f64,
    /// Which machine of its type it is.
    pub(crate) seed: u64,
    /// The errors that changed.
    pub(crate) errors: Vec<Aged>,
}

/// What wear made of an error.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Aged {
    /// The error.
    pub(crate) name: String,
    /// The unit of its numbers, `um` or `urad`.
    pub(crate) unit: &'static str,
    /// The same as people read it.
    #[serde(skip)]
    pub(crate) symbol: &'static str,
    /// The largest change of its mean over the travel.
    pub(crate) largest_change: f64,
    /// The largest size of its mean over the travel now.
    pub(crate) largest: f64,
    /// The reversal value in the middle of the travel, positive less negative direction; null where there is none.
    pub(crate) reversal: Option<f64>,
}

//! The JSON document of `volcomp fit`.

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;

/// The document of `volcomp fit`. A file in µm fills the keys that end in `_um`, one in µrad those in `_urad`.
#[derive(Debug, Default, Serialize, JsonSchema)]
pub(crate) struct Fit {
    /// The curve as it stands in the machine file.
    pub(crate) curve: Value,
    /// Readings minus curve, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) residual_um: Option<Spread>,
    /// Readings minus curve, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) residual_urad: Option<Spread>,
    /// Root mean square of the leave-one-out errors, µm; absent where a target cannot be predicted from the others.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) leave_one_out_um: Option<f64>,
    /// Root mean square of the leave-one-out errors, µrad; absent where a target cannot be predicted from the others.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) leave_one_out_urad: Option<f64>,
    /// The curve at the coordinates of `--at`.
    pub(crate) values: Vec<Point>,
    /// Whether the residual asked for with `--residual` is met; only with `--auto --residual`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) meets_required: Option<bool>,
    /// The orders and supports of moving least squares that the targets carry; only with `--scan`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) scan: Option<Vec<Trial>>,
    /// How the kind of curve was chosen; only with `--method auto`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) choice: Option<Choice>,
    /// How far the true curve may be from this one, with a probability of 95 % at each target by itself; only with `--method auto`, and
    /// not there where it is not known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) band: Option<Band>,
}

/// How a kind of curve was chosen.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Choice {
    /// The method chosen, with its settings.
    pub(crate) method: String,
    /// The rule by which it was chosen, in words.
    pub(crate) reason: String,
    /// Whether it leaves no more of the readings than the runs scatter; true where that is not known.
    pub(crate) follows: bool,
    /// All candidates, the simplest first.
    pub(crate) candidates: Vec<Candidate>,
}

/// A candidate of the choice.
#[derive(Debug, Serialize, JsonSchema)]
#[expect(
    clippy::struct_excessive_bools,
    reason = "each is a key of the document"
)]
pub(crate) struct Candidate {
    /// The method with its settings.
    pub(crate) method: String,
    /// The kind of curve without its settings.
    pub(crate) kind: &'static str,
    /// Number of coefficients that the readings determine.
    pub(crate) coefficients: f64,
    /// Root mean square of what the curve misses of the means of inner targets that are left out, µm; null where it cannot be known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) leave_one_out_um: Option<f64>,
    /// The same in µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) leave_one_out_urad: Option<f64>,
    /// Largest deviation of the mean reading of a target from the curve, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) largest_residual_um: Option<f64>,
    /// The same in µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) largest_residual_urad: Option<f64>,
    /// Whether it meets the residual asked for; true where none is.
    pub(crate) meets_required: bool,
    /// Whether it leaves no more of the readings than the runs scatter; true where that is not known.
    pub(crate) follows: bool,
    /// Whether it was put aside since its curve swings between targets.
    pub(crate) swings: bool,
    /// Whether it is the one chosen.
    pub(crate) chosen: bool,
}

/// A band of 95 % about the curve.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Band {
    /// What was resampled: `runs`, or the `residuals` of the only one.
    pub(crate) from: &'static str,
    /// Half of its width at each target and at places between neighbours; straight between these.
    pub(crate) half_widths: Vec<BandPoint>,
}

/// Half of the width of a band at one place.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub(crate) struct BandPoint {
    /// The place, mm or deg.
    pub(crate) at: f64,
    /// Half of the width, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) half_width_um: Option<f64>,
    /// Half of the width, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) half_width_urad: Option<f64>,
}

impl BandPoint {
    /// Half of the width in the unit of the file.
    pub(crate) fn half_width(&self) -> Option<f64> {
        self.half_width_um.or(self.half_width_urad)
    }
}

/// One order and support of moving least squares.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub(crate) struct Trial {
    /// Order of the local polynomial.
    pub(crate) order: usize,
    /// Half width of the weight as a share of the range.
    pub(crate) support: f64,
    /// Largest magnitude of a residual, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) largest_residual_um: Option<f64>,
    /// Largest magnitude of a residual, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) largest_residual_urad: Option<f64>,
    /// Root mean square of the leave-one-out errors, µm; absent where a target cannot be predicted from the others.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) leave_one_out_um: Option<f64>,
    /// Root mean square of the leave-one-out errors, µrad; absent where a target cannot be predicted from the others.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) leave_one_out_urad: Option<f64>,
    /// Whether the curve of this document is the one of this setting.
    pub(crate) shown: bool,
}

impl Trial {
    /// The leave-one-out error in the unit of the file; `None` where a target cannot be predicted from the others.
    pub(crate) fn leave_one_out(&self) -> Option<f64> {
        self.leave_one_out_um.or(self.leave_one_out_urad)
    }
}

/// The range and the size of the residuals, readings minus curve, in the unit of the key.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub(crate) struct Spread {
    /// The smallest residual, with its sign.
    pub(crate) min: f64,
    /// The largest residual, with its sign.
    pub(crate) max: f64,
    /// Root mean square of the residuals.
    pub(crate) rms: f64,
}

/// The curve at one coordinate.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub(crate) struct Point {
    /// The coordinate, mm or deg.
    pub(crate) at: f64,
    /// Value of the curve, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) value_um: Option<f64>,
    /// Value of the curve, µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) value_urad: Option<f64>,
    /// Whether the coordinate lies outside the measured range: the value is then the one at its end.
    pub(crate) outside_range: bool,
}

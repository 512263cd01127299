//! The JSON document of `volcomp report`; the report itself is the file that it wrote.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_report::{Check as ReportCheck, Verdict as Outcome};

/// The document of `volcomp report`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Report {
    /// The HTML file that was written.
    pub(crate) file: String,
    /// How the figures stand against the tolerances of `--tolerance`.
    pub(crate) verdict: Verdict,
    /// Every figure that has a tolerance.
    pub(crate) checks: Vec<Check>,
    /// How many error curves stand in the report.
    pub(crate) curves: usize,
    /// The warnings of the report, the gravest first.
    pub(crate) warnings: Vec<String>,
    /// The volumetric error over poses of all axes in the last state; null without two of the axes X, Y and Z.
    pub(crate) volumetric: Option<Volumetric>,
    /// The volumetric error before a compensation, or the only one that is known; null without two of the axes X, Y and Z.
    pub(crate) before: Option<Largest>,
    /// The volumetric error after a compensation; null without `--truth` or `--before`.
    pub(crate) after: Option<Largest>,
}

/// How all figures stand.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub(crate) enum Verdict {
    /// Every figure is within.
    Pass,
    /// One at least is beyond.
    Fail,
    /// None is beyond, and one at least is nearer to its limit than its uncertainty, or is not given by the measurements.
    Undecided,
    /// No tolerance is stated.
    None,
}

impl Verdict {
    /// The verdict as people read it.
    pub(crate) fn words(self) -> &'static str {
        match self {
            Self::Pass => "all stated tolerances are met",
            Self::Fail => "not all stated tolerances are met",
            Self::Undecided => "not every stated tolerance is decided",
            Self::None => "no tolerance stated",
        }
    }
}

/// A figure and its tolerance.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Check {
    /// The symbol of the figure.
    pub(crate) symbol: String,
    /// What it is of: an error and its file; empty where the symbol says it.
    pub(crate) of: String,
    /// The figure; null: the measurements do not give it.
    pub(crate) value: Option<f64>,
    /// The most that is allowed.
    pub(crate) limit: f64,
    /// `µm` or `µrad`.
    pub(crate) unit: String,
    /// The expanded uncertainty (k = 2) of the figure, of what is stated; null where nothing is.
    pub(crate) uncertainty: Option<f64>,
    /// `pass`, `fail`, `undecided` (nearer to the limit than the uncertainty) or `not_evaluated`: by ISO 14253-1 where an uncertainty is
    /// stated.
    pub(crate) outcome: &'static str,
}

/// The volumetric error over poses of all axes after one best-fit rigid-body alignment of the workpiece.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Volumetric {
    /// Largest error of the tool tip, µm.
    pub(crate) position_um: f64,
    /// Largest tilt of the tool axis, µrad.
    pub(crate) tilt_urad: f64,
    /// The pose of the largest error of the tip, mm and deg.
    pub(crate) worst_at: BTreeMap<String, f64>,
    /// The tool with which it is reached; empty: the one in the spindle.
    pub(crate) worst_tool: String,
}

/// How large the volumetric error is.
#[derive(Debug, Serialize, JsonSchema)]
#[expect(clippy::struct_field_names, reason = "the keys end in their unit")]
pub(crate) struct Largest {
    /// The largest, µm.
    pub(crate) max_um: f64,
    /// The root of the mean square, µm.
    pub(crate) rms_um: f64,
    /// The largest after alignment of the workpiece: where it lies is no error of the machine, µm.
    pub(crate) form_max_um: f64,
    /// The root of the mean square after alignment, µm.
    pub(crate) form_rms_um: f64,
}

impl From<&ReportCheck> for Check {
    fn from(check: &ReportCheck) -> Self {
        Self {
            symbol: check.symbol.clone(),
            of: check.of.to_string(),
            value: check.value,
            limit: check.limit,
            unit: check.unit.clone(),
            uncertainty: check.uncertainty,
            outcome: match check.outcome {
                Outcome::Pass => "pass",
                Outcome::Fail => "fail",
                Outcome::Undecided => "undecided",
                Outcome::NotEvaluated => "not_evaluated",
            },
        }
    }
}

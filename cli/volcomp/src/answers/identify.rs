//! The JSON document of `volcomp identify`.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_document::Note;
use volcomp_identify::{Figures, Identification};

use super::ByAxis;

/// The document of `volcomp identify`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Identify {
    /// The machine file that was written.
    pub(crate) file: String,
    /// What was found.
    #[serde(flatten)]
    pub(crate) found: Found,
    /// Warnings in words: what cannot be told apart, rows that do not fit, notes on the files.
    #[schemars(with = "Vec<String>")]
    pub(crate) warnings: Vec<Note>,
}

/// What was found from observations, and how far it can be trusted.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Found {
    /// Every unknown: those of the set-ups first, then the errors of the machine.
    pub(crate) parameters: Vec<Parameter>,
    /// How many combinations of the unknowns the observations determine.
    pub(crate) rank: usize,
    /// Identifiability score: smallest by largest singular value of the columns scaled to unit length; 0 where the rank is not full.
    pub(crate) score: f64,
    /// The same of the unknowns that are determined alone.
    pub(crate) score_of_determined: f64,
    /// Unknowns left at zero though nothing is missing: constants of curves and slopes of straightnesses that move the tool like
    /// location errors, other constants or the set-up.
    pub(crate) redundant: Vec<String>,
    /// Every combination of unknowns that moves nothing: names and weights.
    pub(crate) null: Vec<BTreeMap<String, f64>>,
    /// What is left of the rows that were fitted, µm.
    pub(crate) residual_um: RowResidual,
    /// What is left of rows that were left out of the fit, µm; null: not judged.
    pub(crate) left_out_um: Option<LeftOut>,
    /// What is left of the rows of observations with `judge = true`, µm; not there where there are none.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) judged_um: Option<Judged>,
    /// How many unknowns the fit has in effect; with penalties fewer than the rank.
    pub(crate) effective: f64,
    /// The pose that would help most; null where nothing is uncertain.
    pub(crate) next: Option<Next>,
}

/// One unknown.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Parameter {
    /// `EX0C`, `EXX legendre 2`, `tracker.csv:frame.x`.
    pub(crate) name: String,
    /// The value; 0 where it is not determined.
    pub(crate) value: f64,
    /// `um`, `urad`, `mm`, `deg` or `um_per_m`.
    pub(crate) unit: &'static str,
    /// Standard uncertainty (k = 1) in the same unit; null where it is not determined.
    pub(crate) uncertainty: Option<f64>,
    /// Whether the observations determine it.
    pub(crate) determined: bool,
    /// Unknowns left at zero with which it is mixed up: the value holds if these are zero.
    pub(crate) given_zero: Vec<String>,
}

/// What is left of fitted rows.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct RowResidual {
    /// Root mean square; of `points` and `sphere` the distance in three directions.
    pub(crate) rms: f64,
    /// The largest.
    pub(crate) max: f64,
}

/// What is left of rows that were left out of the fit.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct LeftOut {
    /// Root mean square.
    pub(crate) rms: f64,
    /// The largest.
    pub(crate) max: f64,
    /// In how many parts the poses were left out.
    pub(crate) folds: usize,
}

/// What is left of rows that are only predicted.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Judged {
    /// Root mean square.
    pub(crate) rms: f64,
    /// The largest.
    pub(crate) max: f64,
    /// How many rows.
    pub(crate) rows: usize,
}

/// What to measure next.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Next {
    /// Where the machine should stand, mm or deg by axis.
    pub(crate) pose: ByAxis,
    /// The row file whose set-up is to be used.
    pub(crate) file: String,
    /// What is to be observed there: points, sphere, distance, line or ball-row.
    pub(crate) kind: &'static str,
    /// The sphere, the ball or the target there; not there where there is nothing to choose.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) target: Option<String>,
    /// The tool in the spindle; not there for that of `[tool]`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) tool: Option<String>,
    /// The unknown that is least certain in its largest effect on the tip; one that is not determined yet, where there is any.
    pub(crate) parameter: String,
    /// How many times smaller its uncertainty is after the pose: 1 or more; null where it is not determined yet.
    pub(crate) improvement: Option<f64>,
}

impl Identify {
    /// The document of what was found and written to `file`.
    pub(crate) fn new(file: String, found: &Identification) -> Self {
        Self {
            file,
            found: found.into(),
            warnings: found.warnings.clone(),
        }
    }
}

impl From<&Identification> for Found {
    fn from(found: &Identification) -> Self {
        let parameters = found.parameters.iter().map(|p| Parameter {
            name: p.name.clone(),
            value: p.value,
            unit: p.unit,
            uncertainty: p.uncertainty,
            determined: p.determined,
            given_zero: p.given_zero.clone(),
        });
        let Figures { rms_um, max_um, .. } = found.residual;
        Self {
            parameters: parameters.collect(),
            rank: found.rank,
            score: found.score,
            score_of_determined: found.score_of_determined,
            redundant: found.redundant.clone(),
            null: found
                .null
                .iter()
                .map(|null| null.iter().cloned().collect())
                .collect(),
            residual_um: RowResidual {
                rms: rms_um,
                max: max_um,
            },
            left_out_um: found.left_out.map(|(figures, folds)| LeftOut {
                rms: figures.rms_um,
                max: figures.max_um,
                folds,
            }),
            judged_um: found.judged.map(|figures| Judged {
                rms: figures.rms_um,
                max: figures.max_um,
                rows: figures.rows,
            }),
            effective: found.degrees,
            next: found.next.as_ref().map(|next| Next {
                pose: next.pose.iter().copied().collect(),
                file: next.file.clone(),
                kind: next.kind.name(),
                target: next.target.clone(),
                tool: next.tool.clone(),
                parameter: next.parameter.clone(),
                improvement: next.improvement,
            }),
        }
    }
}

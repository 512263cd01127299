//! The JSON document of `volcomp check`.

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::commands::ByAxis;

/// The document of `volcomp check`: the machine as it is understood.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Check {
    /// The path of the machine file.
    pub(crate) file: String,
    /// Name of the machine.
    pub(crate) name: String,
    /// Structure code from the workpiece to the tool.
    pub(crate) structure: String,
    /// The chain as a drawing in text.
    pub(crate) sketch: String,
    /// The axes, in the order X Y Z A B C U V W.
    pub(crate) axes: Vec<Axis>,
    /// The tool that is in the spindle.
    pub(crate) tool: Tool,
    /// Names of the tools that can be put into the spindle with `--tool`.
    pub(crate) tools: Vec<String>,
    /// Workpiece origin at machine zero, mm in MCS.
    pub(crate) workpiece_origin_mm: [f64; 3],
    /// The errors that are there and not zero, axis by axis.
    pub(crate) errors: Vec<Size>,
    /// Errors that the machine file states as zero.
    #[schemars(with = "Vec<String>")]
    pub(crate) zero: Vec<ErrorName>,
    /// Errors that the machine file does not state: they count as zero.
    #[schemars(with = "Vec<String>")]
    pub(crate) not_stated: Vec<ErrorName>,
    /// Axes with assembly errors that are not zero.
    pub(crate) assembly: Vec<Assembly>,
    /// The thermal terms; null where there are none.
    pub(crate) thermal: Option<Thermal>,
    /// Where the errors come from; not there where the machine file does not tell it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) provenance: Option<Provenance>,
    /// The error at machine zero.
    pub(crate) home: Place,
    /// The error at every corner of the travels of X, Y and Z, other axes at 0.
    pub(crate) corners: Vec<Place>,
}

/// One axis of the machine.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Axis {
    /// The letter of the axis.
    #[schemars(with = "String")]
    pub(crate) name: AxisName,
    /// The kind of the axis: `linear` or `rotary`.
    pub(crate) kind: String,
    /// The side that the axis carries: `workpiece` or `tool`.
    pub(crate) carries: String,
    /// Unit of `travel` and `modulo`: `mm` or `deg`.
    pub(crate) unit: String,
    /// Lower and upper end of travel, mm or deg.
    pub(crate) travel: [f64; 2],
    /// Period that brings the coordinate into travel before curves are looked up, deg.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) modulo: Option<f64>,
    /// Unit direction in MCS.
    pub(crate) direction: [f64; 3],
    /// Point at machine zero, mm in MCS: on the line of a rotary axis; where a linear axis's errors are stated.
    pub(crate) point_mm: [f64; 3],
    /// Where the error motions of a rotary axis stay: `fixed` or `turning`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) motion_frame: Option<String>,
    /// The effect of a positive motion, in words.
    pub(crate) motion: String,
    /// A warning where the axis does not count along its letter's direction: a positive deviation is then a negative
    /// error, or several errors.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) signs: Option<String>,
}

/// The tool at machine zero.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Tool {
    /// The tool of `--tool`; null: the tool of `[tool]`.
    pub(crate) name: Option<String>,
    /// Tool tip, mm in MCS.
    pub(crate) tip_mm: [f64; 3],
    /// Unit direction from the tip to the spindle, in MCS.
    pub(crate) axis: [f64; 3],
}

/// One error and its size.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Size {
    /// Its name after ISO 230-1.
    #[schemars(with = "String")]
    pub(crate) name: ErrorName,
    /// Its name in words.
    pub(crate) meaning: String,
    /// The unit of the values: `um` (µm) or `urad` (µrad).
    pub(crate) unit: String,
    /// Smallest value over travel, in `unit`; a location error has the same smallest and largest value.
    pub(crate) smallest: f64,
    /// Largest value over travel, in `unit`.
    pub(crate) largest: f64,
    /// Where the value with the largest size stands, mm or deg; not there for a location error.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) at: Option<ByAxis>,
}

/// The six assembly errors of an axis.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Assembly {
    /// The letter of the axis.
    #[schemars(with = "String")]
    pub(crate) axis: AxisName,
    /// Displacements along X, Y and Z, µm.
    pub(crate) position_um: [f64; 3],
    /// Rotations about X, Y and Z, µrad.
    pub(crate) rotation_urad: [f64; 3],
}

/// The thermal terms in short.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Thermal {
    /// Temperature at which the curves hold, °C.
    pub(crate) reference_degc: f64,
    /// Names of the sensors.
    pub(crate) sensors: Vec<String>,
    /// Errors with an expansion term.
    #[schemars(with = "Vec<String>")]
    pub(crate) expansion: Vec<ErrorName>,
    /// Errors with a drift term.
    #[schemars(with = "Vec<String>")]
    pub(crate) drift: Vec<ErrorName>,
}

/// Where the errors of the machine come from.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Provenance {
    /// The version of volcomp that found them.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) version: Option<String>,
    /// Serial number of the machine that was measured.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) serial: Option<String>,
    /// The day that the person who calibrated has stated.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) date: Option<String>,
    /// What is known of each error.
    pub(crate) errors: Vec<Origin>,
}

/// Where one error comes from.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Origin {
    /// Its name after ISO 230-1.
    #[schemars(with = "String")]
    pub(crate) error: ErrorName,
    /// How it was found.
    pub(crate) method: String,
    /// The rule by which the method was taken.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) rule: Option<String>,
    /// Root mean square of the mean readings minus the curve, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) residual_um: Option<f64>,
    /// The same in µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) residual_urad: Option<f64>,
    /// Root mean square of what the curve misses of targets left out of its fit, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) leave_one_out_um: Option<f64>,
    /// The same in µrad.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) leave_one_out_urad: Option<f64>,
    /// The files with its readings.
    pub(crate) files: Vec<SourceFile>,
}

/// A file that an error was found from.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct SourceFile {
    /// Its name, as the calibration file had it.
    pub(crate) file: String,
    /// The SHA-256 that it had.
    pub(crate) sha256: String,
    /// What it is now: `same`, `different` or `not at hand`.
    pub(crate) state: &'static str,
    /// The number of runs that were used.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) runs: Option<usize>,
    /// The number of targets.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) targets: Option<usize>,
    /// Where the other axes stood, mm or deg, without those that stood at 0.
    pub(crate) at: std::collections::BTreeMap<String, f64>,
    /// The date of the test, as the file states it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) date: Option<String>,
}

/// The tool and its error at one position.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Place {
    /// Where the axes stand, mm or deg.
    pub(crate) at: ByAxis,
    /// Ideal tool tip from the workpiece origin, in workpiece axes, mm.
    pub(crate) tip_mm: [f64; 3],
    /// Actual minus ideal tool tip, in workpiece axes, µm.
    pub(crate) position_um: [f64; 3],
    /// Rotation of the tool, in workpiece axes, µrad.
    pub(crate) rotation_urad: [f64; 3],
    /// Axes that stand outside their travel there.
    #[schemars(with = "Vec<String>")]
    pub(crate) outside_travel: Vec<AxisName>,
}

//! What the form holds, as plain data.

use std::collections::BTreeMap;

use serde::{Deserialize, Serialize};
use volcomp_vocabulary::{AxisName, ErrorName};

/// A filled form.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Form {
    /// The name of the machine.
    #[serde(default)]
    pub name: String,
    /// How its axes are stacked.
    pub structure: StructureForm,
    /// Its axes, in any order.
    pub axes: Vec<AxisForm>,
    /// The tool tip at machine zero, mm.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub tip_mm: Option<[f64; 3]>,
    /// The axes that corrections may move; `None`: all of them.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub correct: Option<Vec<AxisName>>,
    /// Component errors that are typed.
    #[serde(default)]
    pub errors: Vec<ErrorForm>,
    /// Component errors from measurement files.
    #[serde(default)]
    pub uploads: Vec<Upload>,
}

/// How the axes are stacked: by a structure code, or by the type numbers of the generalised model.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(untagged, deny_unknown_fields)]
pub enum StructureForm {
    /// A structure code, such as `w X' b Y Z t`.
    Code {
        /// The code.
        code: String,
    },
    /// Type numbers.
    Type {
        /// 0 to 3: how many of X, Y, Z carry the workpiece.
        translational: u8,
        /// 0 none, 1 both carry the workpiece, 2 both carry the tool, 3 one each.
        #[serde(default)]
        rotary: u8,
        /// The rotary axes from the workpiece to the tool.
        #[serde(default)]
        rotary_axes: Vec<AxisName>,
    },
}

/// One axis.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct AxisForm {
    /// Its letter.
    pub axis: AxisName,
    /// Its travel, mm or deg.
    pub travel: [f64; 2],
    /// A point on the centre line of a rotary axis, mm; of a linear axis the point at which its errors are stated.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub point_mm: Option<[f64; 3]>,
    /// The period of a rotary axis, deg.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub modulo: Option<f64>,
}

/// A component error that is typed.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct ErrorForm {
    /// Its name, such as `EXX` or `EC0Y`.
    pub error: ErrorName,
    /// Its value, µm or µrad.
    pub value: CurveForm,
}

/// The value of an error: µm or µrad over mm or deg.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum CurveForm {
    /// One number.
    Number(f64),
    /// c0 + c1·q + c2·q² + …
    Poly(Vec<f64>),
    /// Straight lines between nodes `[q, value]`.
    Table(Vec<[f64; 2]>),
    /// The same, with cubics between the nodes.
    Cubic(Vec<[f64; 2]>),
}

/// A measurement file.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Upload {
    /// Which error motion it holds.
    pub error: ErrorName,
    /// Its name: only its ending counts (`.rtl`, `.rta` or `.csv`), and it stands in messages.
    pub name: String,
    /// Its text.
    pub text: String,
    /// The unit of the readings, where the file does not state one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub unit: Option<String>,
    /// Whether the instrument gave the motion of the workpiece's side.
    #[serde(default)]
    pub workpiece_side: bool,
    /// Where the other axes stood, mm or deg.
    #[serde(default, skip_serializing_if = "BTreeMap::is_empty")]
    pub at: BTreeMap<AxisName, f64>,
}

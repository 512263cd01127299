//! The JSON document of `volcomp nc`.

use schemars::JsonSchema;
use serde::Serialize;

/// The document of `volcomp nc`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Nc {
    /// The file that was written.
    pub(crate) file: String,
    /// The language of the program: `rs274`, `siemens` or `heidenhain`.
    pub(crate) dialect: String,
    /// Lines of the program that were read.
    pub(crate) lines: u64,
    /// Motions in them.
    pub(crate) motions: u64,
    /// Lines that were changed.
    pub(crate) changed: u64,
    /// Lines that were added, since a motion was split.
    pub(crate) added: u64,
    /// Whether the result is byte for byte that of `--strategy plain`; only with `--strategy floyd`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) same_as_plain: Option<bool>,
    /// Whether the program says where it ends (M2, M30 or a second percent sign).
    pub(crate) ended: bool,
    /// How far the tool is from where the program wants it; only with --verify.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) verified: Option<Verified>,
    /// What a user should know of the program, each once.
    pub(crate) notes: Vec<NcNote>,
}

/// A note on a program.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct NcNote {
    /// The line at which it was met first, counted from 1.
    pub(crate) line: usize,
    /// What it says.
    pub(crate) text: String,
}

/// The program and its result on a virtual machine.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Verified {
    /// Motions that were looked at; those that pass on without a correction are not among them.
    pub(crate) motions: u64,
    /// Places on them that were looked at.
    pub(crate) places: u64,
    /// With the original program.
    pub(crate) before: NcDeviation,
    /// With the compensated program.
    pub(crate) after: NcDeviation,
    /// Motions with whose result the tool is further off than before.
    pub(crate) further: NcFurther,
    /// Whether the features are judged after the best rigid alignment of the part by its own points; only with --inspect.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) best_fit: Option<bool>,
    /// The features of the part; only with --inspect.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub(crate) features: Vec<NcFeature>,
}

/// A feature of the part that the virtual machine cuts.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct NcFeature {
    /// Its name in the part file.
    pub(crate) name: String,
    /// How many points were looked at.
    pub(crate) points: usize,
    /// With the original program; null where nothing can be said.
    pub(crate) before: Option<NcFound>,
    /// With the compensated program; null where nothing can be said.
    pub(crate) after: Option<NcFound>,
    /// Why nothing can be said.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) reason: Option<String>,
}

/// What a measuring machine would find of a feature; null where the feature has none of it.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub(crate) struct NcFound {
    /// Form deviation about the feature of least squares, µm.
    pub(crate) form_um: Option<f64>,
    /// The same by the minimum zone, µm.
    pub(crate) minimum_zone_um: Option<f64>,
    /// How far its centre or axis is from where it belongs, µm.
    pub(crate) position_um: Option<f64>,
    /// Its direction against the one wanted, µrad.
    pub(crate) direction_urad: Option<f64>,
    /// Its radius minus the one wanted, µm.
    pub(crate) radius_um: Option<f64>,
    /// Coaxiality or concentricity to the datum feature as it was cut, µm.
    pub(crate) coaxiality_um: Option<f64>,
}

/// Motions with whose result the tool is further off than before by more than 0.01 µm, in the root mean square or in the largest deviation
/// of their places.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct NcFurther {
    /// How many there are.
    pub(crate) motions: u64,
    /// By how much at the most, µm.
    pub(crate) by_um: f64,
    /// The line of the original program of that one, counted from 1; null where there is none.
    pub(crate) line: Option<usize>,
}

/// How far the tool is from where the program wants it.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct NcDeviation {
    /// The largest distance, µm.
    pub(crate) max_um: f64,
    /// The root of the mean square over all places, µm.
    pub(crate) rms_um: f64,
    /// The largest distance across the path, µm: what is along the path does not count. At the ends of rapid motions the whole distance
    /// counts.
    pub(crate) across_max_um: f64,
    /// The root of the mean square across the path, µm.
    pub(crate) across_rms_um: f64,
    /// The line of the original program where the whole distance is largest, counted from 1.
    pub(crate) line: usize,
    /// The tip of the tool there, mm from the workpiece origin.
    pub(crate) tip_mm: [f64; 3],
    /// The root of the mean square after alignment of the part, µm: how it lies on the table is no error of it.
    pub(crate) form_rms_um: f64,
    /// The largest distance beside that motion, µm.
    pub(crate) form_max_um: f64,
}

/// The document of `volcomp nc --average`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct NcAverage {
    /// The file that was written.
    pub(crate) file: String,
    /// Each work offset with which the program cuts.
    pub(crate) offsets: Vec<AverageOffset>,
    /// How far the tool is from where the program wants it; only with --verify.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) verified: Option<Verified>,
}

/// A work offset with the mean correction in it.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct AverageOffset {
    /// `G54` to `G59.3`.
    pub(crate) work_offset: String,
    /// Places where the program cuts with it: the ends of lines and arcs, and holes.
    pub(crate) places: u64,
    /// The mean correction of X, Y and Z, µm.
    pub(crate) mean_um: [f64; 3],
    /// The offset with it, mm in machine coordinates.
    pub(crate) offset_mm: [f64; 3],
    /// The largest correction of a place, µm.
    pub(crate) before_max_um: f64,
    /// The root of the mean square of the corrections, µm.
    pub(crate) before_rms_um: f64,
    /// The largest difference of a place's correction from the mean, which stays uncorrected, µm.
    pub(crate) left_max_um: f64,
    /// The root of the mean square of these differences, µm.
    pub(crate) left_rms_um: f64,
}

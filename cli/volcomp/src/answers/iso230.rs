//! The JSON document of `volcomp iso230`. The keys end in `_um` for a file of lengths and in `_urad` for a file of
//! angles.

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_metrology::{Approach, DeviationUnit, Iso230Part2, OutlierHint, TargetRow};
use volcomp_vocabulary::{Direction, Um, Urad};

use super::quantity::{Decision, Quantity};

/// The document of `volcomp iso230`: the symbols of ISO 230-2, null where a value cannot be evaluated.
#[derive(Debug, Serialize, JsonSchema)]
#[serde(untagged)]
pub(crate) enum Iso230 {
    /// Of several files, in their order.
    Many {
        /// The evaluation of each.
        files: Vec<Iso230>,
    },
    /// Of a file of lengths.
    Length(Box<LengthEvaluation>),
    /// Of a file of angles.
    Angle(Box<AngleEvaluation>),
    /// A file that is refused, among others.
    Refused {
        /// The file as it was named in the call.
        file: String,
        /// Why it is refused.
        error: String,
    },
}

impl Iso230 {
    /// The document of an evaluation of readings in a unit.
    pub(crate) fn new(
        result: &Iso230Part2,
        unit: DeviationUnit,
        stated: Stated,
        notes: Vec<String>,
    ) -> Self {
        match unit {
            DeviationUnit::Um => {
                Self::Length(Box::new(LengthEvaluation::new(result, stated, notes)))
            }
            DeviationUnit::Urad => {
                Self::Angle(Box::new(AngleEvaluation::new(result, stated, notes)))
            }
        }
    }
}

/// What is stated beside the values of ISO 230-2.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Stated {
    /// The file as it was named in the call; only of several files.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) file: Option<String>,
    /// The edition of ISO 230-2.
    pub(crate) edition: u16,
    /// The quantities of every standard that was asked for, with uncertainty and tolerance.
    pub(crate) quantities: Vec<Quantity>,
    /// The measurement uncertainty, where anything was stated that it is made of.
    pub(crate) uncertainty: Option<Uncertainty>,
    /// How the file states that the readings were brought to 20 °C; null where a file of its kind cannot.
    pub(crate) material_compensation: Option<String>,
    /// What was decided on the tolerances; null without any.
    pub(crate) decision: Option<Decision>,
    /// Whether every quantity with a tolerance passes; null without tolerances.
    pub(crate) pass: Option<bool>,
}

/// The measurement uncertainty of a positioning test, expanded with k = 2.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Uncertainty {
    /// The length over which it is stated, m.
    pub(crate) length_m: f64,
    /// Runs in a direction.
    pub(crate) runs: usize,
    /// The contributions.
    pub(crate) contributions: Vec<Contribution>,
    /// What is not stated and therefore left out.
    pub(crate) left_out: Vec<String>,
}

/// A contribution to the uncertainty.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Contribution {
    /// `U_DEVICE`, `U_MISALIGNMENT`, `U_M`, `U_E` or `U_EVE`.
    pub(crate) symbol: &'static str,
    /// What it is.
    pub(crate) name: &'static str,
    /// Its size over the length, µm; null: left out.
    pub(crate) u_um: Option<f64>,
}

/// The documents of one unit: their types, and their keys, which end in the unit.
macro_rules! evaluation {
    (
        $unit:ident $key:literal, $evaluation:ident $target:ident $approach:ident $hint:ident,
        $a:ident $a_forward:ident $a_backward:ident $r:ident $r_forward:ident $r_backward:ident
        $e:ident $e_forward:ident $e_backward:ident $m:ident $b:ident $mean_b:ident,
        $mean:ident $s:ident $size:ident
    ) => {
        /// A positioning test evaluated by ISO 230-2.
        #[derive(Debug, Serialize, JsonSchema)]
        #[expect(non_snake_case, reason = "the symbols of ISO 230-2 are keys")]
        pub(crate) struct $evaluation {
            /// The unit of all values: the keys end in it.
            unit: &'static str,
            /// Bidirectional accuracy of positioning.
            #[schemars(with = "Option<f64>")]
            $a: Option<$unit>,
            /// Unidirectional accuracy of positioning, forward.
            #[schemars(with = "Option<f64>")]
            $a_forward: Option<$unit>,
            /// Unidirectional accuracy of positioning, backward.
            #[schemars(with = "Option<f64>")]
            $a_backward: Option<$unit>,
            /// Bidirectional repeatability of positioning.
            #[schemars(with = "Option<f64>")]
            $r: Option<$unit>,
            /// Unidirectional repeatability of positioning, forward.
            #[schemars(with = "Option<f64>")]
            $r_forward: Option<$unit>,
            /// Unidirectional repeatability of positioning, backward.
            #[schemars(with = "Option<f64>")]
            $r_backward: Option<$unit>,
            /// Bidirectional systematic positioning deviation.
            #[schemars(with = "Option<f64>")]
            $e: Option<$unit>,
            /// Unidirectional systematic positioning deviation, forward.
            #[schemars(with = "Option<f64>")]
            $e_forward: Option<$unit>,
            /// Unidirectional systematic positioning deviation, backward.
            #[schemars(with = "Option<f64>")]
            $e_backward: Option<$unit>,
            /// Range of the mean bidirectional positioning deviations.
            #[schemars(with = "Option<f64>")]
            $m: Option<$unit>,
            /// Reversal value of the axis: the largest size of those of the targets.
            #[schemars(with = "Option<f64>")]
            $b: Option<$unit>,
            /// Mean of the reversal values of the targets, with its sign.
            #[schemars(with = "Option<f64>")]
            $mean_b: Option<$unit>,
            /// The table by targets, ascending.
            targets: Vec<$target>,
            /// Runs and readings that differ from the others; nothing was left out.
            hints: Vec<$hint>,
            /// What is stated besides.
            #[serde(flatten)]
            stated: Stated,
            /// Notes in words on the file and its readings.
            notes: Vec<String>,
        }

        /// The evaluation at one target position.
        #[derive(Debug, Serialize, JsonSchema)]
        #[expect(non_snake_case, reason = "the symbols of ISO 230-2 are keys")]
        struct $target {
            /// The target position, mm or deg.
            target: f64,
            /// Its readings approached forward; null: none.
            forward: Option<$approach>,
            /// Its readings approached backward; null: none.
            backward: Option<$approach>,
            /// Mean bidirectional positioning deviation.
            #[schemars(with = "Option<f64>")]
            $mean: Option<$unit>,
            /// Reversal value: mean forward − mean backward.
            #[schemars(with = "Option<f64>")]
            $b: Option<$unit>,
            /// Bidirectional repeatability of positioning at the target.
            #[schemars(with = "Option<f64>")]
            $r: Option<$unit>,
        }

        /// The readings of one target in one direction.
        #[derive(Debug, Serialize, JsonSchema)]
        #[expect(non_snake_case, reason = "the symbols of ISO 230-2 are keys")]
        struct $approach {
            /// Number of readings of the target in the direction.
            n: usize,
            /// Mean unidirectional positioning deviation.
            #[schemars(with = "f64")]
            $mean: $unit,
            /// Estimator of the standard deviation; null with one reading.
            #[schemars(with = "Option<f64>")]
            $s: Option<$unit>,
            /// Unidirectional repeatability, 4 s.
            #[schemars(with = "Option<f64>")]
            $r: Option<$unit>,
        }

        /// A run or reading that differs from the others.
        #[derive(Debug, Serialize, JsonSchema)]
        struct $hint {
            /// The number of the run among those of its direction, from 1.
            run: u32,
            /// The direction of the run: `forward` or `backward`.
            direction: &'static str,
            /// The target, mm or deg; null: the whole run.
            target: Option<f64>,
            /// By how much it differs.
            #[schemars(with = "f64")]
            $size: $unit,
            /// The same in words.
            text: String,
        }

        impl $evaluation {
            fn new(result: &Iso230Part2, stated: Stated, notes: Vec<String>) -> Self {
                Self {
                    unit: $key,
                    $a: result.a.map($unit),
                    $a_forward: result.a_forward.map($unit),
                    $a_backward: result.a_backward.map($unit),
                    $r: result.r.map($unit),
                    $r_forward: result.r_forward.map($unit),
                    $r_backward: result.r_backward.map($unit),
                    $e: result.e.map($unit),
                    $e_forward: result.e_forward.map($unit),
                    $e_backward: result.e_backward.map($unit),
                    $m: result.m.map($unit),
                    $b: result.b.map($unit),
                    $mean_b: result.mean_b.map($unit),
                    targets: result.targets.iter().map($target::from).collect(),
                    hints: result.outlier_hints.iter().map($hint::from).collect(),
                    stated,
                    notes,
                }
            }
        }

        impl From<&TargetRow> for $target {
            fn from(row: &TargetRow) -> Self {
                Self {
                    target: row.target,
                    forward: row.forward.map(Into::into),
                    backward: row.backward.map(Into::into),
                    $mean: row.mean.map($unit),
                    $b: row.reversal.map($unit),
                    $r: row.repeatability.map($unit),
                }
            }
        }

        impl From<Approach> for $approach {
            fn from(approach: Approach) -> Self {
                Self {
                    n: approach.n,
                    $mean: $unit(approach.mean),
                    $s: approach.s.map($unit),
                    $r: approach.repeatability().map($unit),
                }
            }
        }

        impl From<&OutlierHint> for $hint {
            fn from(hint: &OutlierHint) -> Self {
                Self {
                    run: hint.run,
                    direction: Direction::name(hint.direction),
                    target: hint.target,
                    $size: $unit(hint.size),
                    text: hint.text.clone(),
                }
            }
        }
    };
}

evaluation!(
    Um "um", LengthEvaluation LengthTarget LengthApproach LengthHint,
    A_um A_forward_um A_backward_um R_um R_forward_um R_backward_um
    E_um E_forward_um E_backward_um M_um B_um mean_B_um,
    mean_um s_um size_um
);
evaluation!(
    Urad "urad", AngleEvaluation AngleTarget AngleApproach AngleHint,
    A_urad A_forward_urad A_backward_urad R_urad R_forward_urad R_backward_urad
    E_urad E_forward_urad E_backward_urad M_urad B_urad mean_B_urad,
    mean_urad s_urad size_urad
);

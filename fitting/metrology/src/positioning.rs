//! Positioning tests by ISO 230-2, ASME B5.54 and VDI/DGQ 3441: evaluation, requirements and measurement uncertainty.
//!
//! Results are in µm. [`Edition`] is the edition of ISO 230-2. The measurement uncertainty is that of ISO/TR 230-9 and
//! the annex of ISO 230-2:2006 and 2014, expanded with k = 2.

use volcomp_vocabulary::{AxisKind, AxisName, Direction};

use crate::measurement::{TargetReadings, mean};
use crate::text::LARGEST;
use crate::{
    DeviationUnit, Measurement, MetrologyError, OutlierHint, Reading, StandardQuantity, TargetUnit,
    axis_named, outlier_hints,
};

/// The results of ISO 230-2 for one direction of approach at one target, in the unit of the deviations.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Approach {
    /// Number of readings n.
    pub n: usize,
    /// Mean positioning deviation x̄_i↑ or x̄_i↓.
    pub mean: f64,
    /// Estimator of the standard deviation s_i↑ or s_i↓ (n − 1); `None` for one reading.
    pub s: Option<f64>,
    /// Unidirectional repeatability R_i↑ or R_i↓ = 4 s_i.
    pub repeatability: Option<f64>,
}

/// One line of the per-target table; values in the measurement's unit, `None` where they cannot be evaluated.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct TargetRow {
    /// Target position, mm or deg.
    pub target: f64,
    /// Readings approached forward (↑).
    pub forward: Option<Approach>,
    /// Readings approached backward (↓).
    pub backward: Option<Approach>,
    /// Reversal value B_i = x̄_i↑ − x̄_i↓.
    pub reversal: Option<f64>,
    /// Bidirectional repeatability R_i = max(2s↑ + 2s↓ + |B_i|, R_i↑, R_i↓).
    pub repeatability: Option<f64>,
    /// Mean bidirectional positioning deviation x̄_i.
    pub mean: Option<f64>,
}

/// Result of ISO 230-2, in the standard's symbols and the measurement's unit (µm or µrad).
///
/// With one run in each direction (n = 1) all R and A are `None`; with a single direction, so are
/// the bidirectional values and those of the other direction.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Iso230Part2 {
    /// Unit of all values; `None` if the file does not state it.
    pub unit: Option<DeviationUnit>,
    /// The per-target table, targets ascending.
    pub targets: Vec<TargetRow>,
    /// Bidirectional accuracy A = max(x̄ + 2s) − min(x̄ − 2s) over both directions.
    #[serde(rename = "A")]
    pub a: Option<f64>,
    /// Unidirectional accuracy A↑ of the forward approaches.
    #[serde(rename = "A_forward")]
    pub a_forward: Option<f64>,
    /// Unidirectional accuracy A↓ of the backward approaches.
    #[serde(rename = "A_backward")]
    pub a_backward: Option<f64>,
    /// Bidirectional repeatability R = max R_i.
    #[serde(rename = "R")]
    pub r: Option<f64>,
    /// Unidirectional repeatability R↑ of the forward approaches.
    #[serde(rename = "R_forward")]
    pub r_forward: Option<f64>,
    /// Unidirectional repeatability R↓ of the backward approaches.
    #[serde(rename = "R_backward")]
    pub r_backward: Option<f64>,
    /// Bidirectional systematic deviation E: the range of all x̄_i↑ and x̄_i↓.
    #[serde(rename = "E")]
    pub e: Option<f64>,
    /// Unidirectional systematic deviation E↑.
    #[serde(rename = "E_forward")]
    pub e_forward: Option<f64>,
    /// Unidirectional systematic deviation E↓.
    #[serde(rename = "E_backward")]
    pub e_backward: Option<f64>,
    /// Mean bidirectional positioning deviation M: the range of x̄_i.
    #[serde(rename = "M")]
    pub m: Option<f64>,
    /// Reversal value B = max |B_i|.
    #[serde(rename = "B")]
    pub b: Option<f64>,
    /// Mean reversal value B̄, signed.
    #[serde(rename = "mean_B")]
    pub mean_b: Option<f64>,
    /// Runs and readings that differ from the others; nothing is removed.
    pub outlier_hints: Vec<OutlierHint>,
}

/// Evaluates positioning readings by ISO 230-2. The editions from 1997 to 2014 have the same formulas.
///
/// # Errors
///
/// No readings, readings that are not finite, or a target that lacks readings in a direction that was measured.
pub fn evaluate(measurement: &Measurement) -> Result<Iso230Part2, MetrologyError> {
    check_readings(measurement)?;
    measurement.check_directions()?;
    let targets = measurement.by_target().iter().map(target_row).collect::<Vec<_>>();
    let forward = direction_summary(targets.iter().map(|row| row.forward));
    let backward = direction_summary(targets.iter().map(|row| row.backward));
    let both = direction_summary(targets.iter().flat_map(|row| [row.forward, row.backward]));
    let reversals: Option<Vec<f64>> = targets.iter().map(|row| row.reversal).collect();
    let means: Option<Vec<f64>> = targets.iter().map(|row| row.mean).collect();
    let repeatabilities: Option<Vec<f64>> = targets.iter().map(|row| row.repeatability).collect();
    Ok(Iso230Part2 {
        unit: measurement.unit,
        a: both.accuracy,
        a_forward: forward.accuracy,
        a_backward: backward.accuracy,
        r: repeatabilities.and_then(|r| largest(&r)),
        r_forward: forward.repeatability,
        r_backward: backward.repeatability,
        e: both.systematic,
        e_forward: forward.systematic,
        e_backward: backward.systematic,
        m: means.and_then(|x| range(&x)),
        b: reversals.as_ref().and_then(|b| largest(&b.iter().map(|b| b.abs()).collect::<Vec<_>>())),
        mean_b: reversals.and_then(|b| mean(&b)),
        outlier_hints: outlier_hints(measurement),
        targets,
    })
}

fn check_readings(measurement: &Measurement) -> Result<(), MetrologyError> {
    let refuse = |found: &str, expected: &str| {
        let name = measurement.name.as_str();
        Err(MetrologyError::readings(name, "readings", found, expected))
    };
    if measurement.readings.is_empty() {
        return refuse("none", "at least one reading");
    }
    let sound = |x: f64| x.abs() <= LARGEST;
    let unsound = |r: &&Reading| !sound(r.target) || !sound(r.deviation);
    match measurement.readings.iter().find(unsound) {
        Some(r) => refuse(
            &format!("deviation {} at target {}", r.deviation, r.target),
            "finite numbers, at most 1e12",
        ),
        None => Ok(()),
    }
}

fn target_row(readings: &TargetReadings) -> TargetRow {
    let [forward, backward] =
        Direction::BOTH.map(|direction| approach(&readings.deviations(direction)));
    let pair = forward.zip(backward);
    TargetRow {
        target: readings.target,
        forward,
        backward,
        reversal: pair.map(|(up, down)| up.mean - down.mean),
        repeatability: pair.and_then(|(up, down)| bidirectional_repeatability(&up, &down)),
        mean: pair.map(|(up, down)| f64::midpoint(up.mean, down.mean)),
    }
}

pub(crate) fn approach(deviations: &[f64]) -> Option<Approach> {
    let (n, mean) = (deviations.len(), mean(deviations)?);
    let sum_of_squares: f64 = deviations.iter().map(|x| (x - mean).powi(2)).sum();
    let s = (n > 1).then(|| (sum_of_squares / (n - 1) as f64).sqrt());
    Some(Approach { n, mean, s, repeatability: s.map(|s| 4.0 * s) })
}

fn bidirectional_repeatability(up: &Approach, down: &Approach) -> Option<f64> {
    let (s_up, s_down) = (up.s?, down.s?);
    let across = 2.0 * s_up + 2.0 * s_down + (up.mean - down.mean).abs();
    Some(across.max(4.0 * s_up).max(4.0 * s_down))
}

struct DirectionSummary {
    accuracy: Option<f64>,
    repeatability: Option<f64>,
    systematic: Option<f64>,
}

/// Accuracy A, largest repeatability 4 s_i and systematic deviation E over these approaches. All are `None` if an
/// approach is missing. A and 4 s_i are also `None` if an approach has no s.
fn direction_summary(approaches: impl Iterator<Item = Option<Approach>>) -> DirectionSummary {
    let all: Option<Vec<Approach>> = approaches.collect();
    let means = all.as_ref().map(|all| all.iter().map(|x| x.mean).collect::<Vec<_>>());
    let limits = all.as_ref().and_then(|all| {
        let limits = all.iter().map(|x| x.s.map(|s| [x.mean - 2.0 * s, x.mean + 2.0 * s]));
        limits.collect::<Option<Vec<_>>>()
    });
    let repeatabilities: Option<Vec<f64>> =
        all.and_then(|all| all.iter().map(|x| x.repeatability).collect());
    DirectionSummary {
        accuracy: limits.and_then(|limits| range(limits.as_flattened())),
        repeatability: repeatabilities.and_then(|r| largest(&r)),
        systematic: means.and_then(|x| range(&x)),
    }
}

fn largest(values: &[f64]) -> Option<f64> {
    values.iter().copied().reduce(f64::max)
}

fn range(values: &[f64]) -> Option<f64> {
    Some(largest(values)? - values.iter().copied().reduce(f64::min)?)
}

/// Edition of ISO 230-2. All three editions evaluate with limits of 2 s and the estimator s with n − 1. The edition of
/// 1988, with 3 s, is not supported.
#[derive(Debug, Clone, Copy, PartialEq, Eq, Default, serde::Serialize, serde::Deserialize)]
pub enum Edition {
    /// Second edition, 1997.
    Iso1997,
    /// Third edition, 2006. It adds an annex on the measurement uncertainty.
    Iso2006,
    /// Fourth edition, 2014. It replaces "deviation" and "value" by "error".
    #[default]
    Iso2014,
}

/// Symbol of a quantity, its name in 1997 and 2006, and its name in 2014.
type Names = (&'static str, [&'static str; 2]);

const NAMES: [Names; 12] = [
    ("A", ["bidirectional accuracy of positioning", "bidirectional positioning accuracy"]),
    (
        "A_forward",
        [
            "unidirectional accuracy of positioning, forward",
            "unidirectional positioning accuracy, forward",
        ],
    ),
    (
        "A_backward",
        [
            "unidirectional accuracy of positioning, backward",
            "unidirectional positioning accuracy, backward",
        ],
    ),
    (
        "R",
        ["bidirectional repeatability of positioning", "bidirectional positioning repeatability"],
    ),
    (
        "R_forward",
        [
            "unidirectional repeatability of positioning, forward",
            "unidirectional positioning repeatability, forward",
        ],
    ),
    (
        "R_backward",
        [
            "unidirectional repeatability of positioning, backward",
            "unidirectional positioning repeatability, backward",
        ],
    ),
    (
        "E",
        [
            "bidirectional systematic deviation of positioning",
            "bidirectional systematic positioning error",
        ],
    ),
    (
        "E_forward",
        [
            "unidirectional systematic deviation of positioning, forward",
            "unidirectional systematic positioning error, forward",
        ],
    ),
    (
        "E_backward",
        [
            "unidirectional systematic deviation of positioning, backward",
            "unidirectional systematic positioning error, backward",
        ],
    ),
    (
        "M",
        [
            "range of the mean bidirectional positional deviation",
            "range of the mean bidirectional positioning error",
        ],
    ),
    ("B", ["reversal value", "reversal error"]),
    ("mean_B", ["mean reversal value", "mean reversal error"]),
];

impl Edition {
    pub fn year(self) -> u16 {
        match self {
            Self::Iso1997 => 1997,
            Self::Iso2006 => 2006,
            Self::Iso2014 => 2014,
        }
    }

    /// Edition published in this year; `None` if the year has no supported edition.
    pub fn of_year(year: u16) -> Option<Self> {
        let all = [Self::Iso1997, Self::Iso2006, Self::Iso2014];
        all.into_iter().find(|edition| edition.year() == year)
    }

    /// Whether the edition has an annex on the measurement uncertainty, as the editions from 2006 on do.
    pub fn states_uncertainty(self) -> bool {
        self != Self::Iso1997
    }

    /// Symbols of the quantities, in their order. They are the same in every edition.
    pub fn symbols() -> [&'static str; 12] {
        NAMES.map(|(symbol, _)| symbol)
    }

    /// Quantities of an evaluation, with their names in this edition.
    pub fn quantities(self, result: &Iso230Part2) -> Vec<StandardQuantity> {
        let values = [
            result.a,
            result.a_forward,
            result.a_backward,
            result.r,
            result.r_forward,
            result.r_backward,
            result.e,
            result.e_forward,
            result.e_backward,
            result.m,
            result.b,
            result.mean_b,
        ];
        let names = usize::from(self == Self::Iso2014);
        (NAMES.iter().zip(values))
            .map(|((symbol, name), value)| StandardQuantity::new(symbol, name[names], value))
            .collect()
    }
}

/// Minimum positioning test that the standard requires for an axis.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
pub struct RequiredTest {
    /// Description of the axis, such as `linear axes up to 2000 mm`.
    pub axes: &'static str,
    /// Minimum number of targets.
    pub targets: usize,
    /// Minimum number of runs in each direction.
    pub runs: usize,
}

/// Maximum travel for which five runs are required, mm.
const SHORT_MM: f64 = 2000.0;
/// Number of targets per metre for a travel up to 2000 mm.
const TARGETS_PER_M: f64 = 5.0;
/// Mean spacing of the targets for a longer travel, mm.
const LONG_INTERVAL_MM: f64 = 250.0;
const RUNS: usize = 5;
/// Tolerance of a travel that exceeds a limit only by the rounding of its targets, mm or deg, and of a number of
/// targets.
const HAIR: f64 = 1e-6;

/// Minimum test for an axis of this kind with this travel, mm or deg. The editions from 1997 to 2014 have the same
/// requirements.
pub fn required_test(kind: AxisKind, travel: f64) -> RequiredTest {
    // The conversion saturates for large values and NaN.
    #[expect(
        clippy::cast_possible_truncation,
        clippy::cast_sign_loss,
        reason = "small and positive"
    )]
    let whole = |targets: f64| (targets - HAIR).ceil().max(0.0) as usize;
    match kind {
        AxisKind::Linear if travel <= SHORT_MM + HAIR => RequiredTest {
            axes: "linear axes up to 2000 mm",
            targets: whole(TARGETS_PER_M * travel / 1000.0).max(5),
            runs: RUNS,
        },
        AxisKind::Linear => RequiredTest {
            axes: "linear axes over 2000 mm",
            // The number of targets is one more than the number of intervals.
            targets: whole(travel / LONG_INTERVAL_MM).saturating_add(1),
            runs: 1,
        },
        AxisKind::Rotary if travel <= 360.0 + HAIR => RequiredTest {
            axes: "rotary axes up to 360°",
            targets: match travel {
                t if t <= 90.0 + HAIR => 3,
                t if t <= 180.0 + HAIR => 5,
                _ => 8,
            },
            runs: RUNS,
        },
        AxisKind::Rotary => RequiredTest {
            axes: "rotary axes over 360°",
            targets: whole(8.0 * travel / 360.0),
            runs: 1,
        },
    }
}

/// Kind of the axis: from the unit of the targets in the file, or else from the axis that the file names; `None` if the
/// file has neither.
pub fn axis_kind(measurement: &Measurement) -> Option<AxisKind> {
    let named = || measurement.metadata.axis.as_deref().and_then(axis_named);
    let stated = measurement.target_unit.map(TargetUnit::kind);
    stated.or_else(|| named().map(AxisName::kind))
}

/// Messages about fewer targets or runs than the standard requires; empty if there are enough.
pub fn shortfalls(measurement: &Measurement, kind: AxisKind, edition: Edition) -> Vec<String> {
    let targets = measurement.targets();
    let (Some(first), Some(last)) = (targets.first(), targets.last()) else {
        return Vec::new();
    };
    let asked = required_test(kind, last - first);
    let standard = format!("ISO 230-2:{}", edition.year());
    let mut said = Vec::new();
    if targets.len() < asked.targets {
        let unit = kind.coordinate_unit();
        said.push(format!(
            "{} over {} {unit}: {standard} asks for {} at least on {}",
            counted(targets.len(), "target"),
            last - first,
            asked.targets,
            asked.axes
        ));
    }
    let runs = Direction::BOTH.map(|direction| measurement.runs(direction).len());
    let fewest = runs.into_iter().filter(|runs| *runs > 0).min();
    let fewest = fewest.unwrap_or(0);
    if fewest < asked.runs {
        said.push(format!(
            "{} in a direction: {standard} asks for {} in each direction on {}",
            counted(fewest, "run"),
            asked.runs,
            asked.axes
        ));
    }
    if fewest < 2 {
        said.push(if asked.runs == 1 {
            format!(
                "one run in a direction, as {standard} asks for on {}: A and R need at least two and are not stated",
                asked.axes
            )
        } else {
            "A and R need at least two runs in a direction".to_owned()
        });
    }
    if runs.contains(&0) {
        said.push(format!(
            "only one direction was run: {standard} asks for both, and the bidirectional values are not stated"
        ));
    }
    said
}

/// Formats a count with its noun: `1 run`, `2 runs`.
pub(crate) fn counted(n: usize, noun: &str) -> String {
    format!("{n} {noun}{}", if n == 1 { "" } else { "s" })
}

/// Quantities of ASME B5.54-2005. This edition evaluates like ISO 230-2:1997, under different names. The names are from
/// memory, and not verified against the text of the standard. The edition of 1992 is not supported.
pub fn asme_b5_54(result: &Iso230Part2) -> Vec<StandardQuantity> {
    [
        ("A", "bidirectional positioning accuracy", result.a),
        ("A_forward", "unidirectional positioning accuracy, forward", result.a_forward),
        ("A_backward", "unidirectional positioning accuracy, backward", result.a_backward),
        ("R", "bidirectional repeatability", result.r),
        ("R_forward", "unidirectional repeatability, forward", result.r_forward),
        ("R_backward", "unidirectional repeatability, backward", result.r_backward),
        ("E", "bidirectional systematic deviation", result.e),
        ("B", "largest reversal", result.b),
        ("mean_B", "mean reversal", result.mean_b),
    ]
    .map(|(symbol, name, value)| StandardQuantity::new(symbol, name, value))
    .to_vec()
}

/// Results of VDI/DGQ 3441 at one target, in the unit of the deviations.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Vdi3441Target {
    /// Target position, mm or deg.
    pub target: f64,
    /// Mean of both directions x̄_j = (x̄_j↑ + x̄_j↓)/2.
    pub mean: f64,
    /// Reversal U_j = |x̄_j↑ − x̄_j↓|.
    pub u: f64,
    /// Scatter Ps_j = 6 s̄_j with s̄_j = (s_j↑ + s_j↓)/2.
    pub ps: f64,
}

/// Results of VDI/DGQ 3441 for an axis, in the unit of the deviations.
#[derive(Debug, Clone, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Vdi3441 {
    /// Results at the targets, by ascending target.
    pub targets: Vec<Vdi3441Target>,
    /// Positional uncertainty P = max(x̄_j + (U_j + Ps_j)/2) − min(x̄_j − (U_j + Ps_j)/2).
    pub p: f64,
    /// Position deviation Pa = max x̄_j − min x̄_j.
    pub pa: f64,
    /// Largest reversal U_max.
    pub u_max: f64,
    /// Mean reversal Ū.
    pub u_mean: f64,
    /// Largest scatter Ps_max.
    pub ps_max: f64,
    /// Mean scatter P̄s.
    pub ps_mean: f64,
}

/// Evaluates the results of [`evaluate`](crate::evaluate) by VDI/DGQ 3441.
///
/// `None` if a target lacks a direction or a standard deviation, because the guideline requires both directions and
/// several runs.
pub fn vdi_3441(result: &Iso230Part2) -> Option<Vdi3441> {
    let at = |row: &crate::TargetRow| {
        let (up, down) = (row.forward?, row.backward?);
        Some(Vdi3441Target {
            target: row.target,
            mean: row.mean?,
            u: row.reversal?.abs(),
            ps: 6.0 * f64::midpoint(up.s?, down.s?),
        })
    };
    let targets: Vec<Vdi3441Target> = result.targets.iter().map(at).collect::<Option<_>>()?;
    let largest = |of: fn(&Vdi3441Target) -> f64| {
        let all = targets.iter().map(of);
        all.reduce(f64::max)
    };
    let mean =
        |of: fn(&Vdi3441Target) -> f64| targets.iter().map(of).sum::<f64>() / targets.len() as f64;
    let half = |t: &Vdi3441Target| 0.5 * (t.u + t.ps);
    Some(Vdi3441 {
        p: largest(|t| t.mean + 0.5 * (t.u + t.ps))?
            + targets.iter().map(|t| half(t) - t.mean).reduce(f64::max)?,
        pa: largest(|t| t.mean)? + largest(|t| -t.mean)?,
        u_max: largest(|t| t.u)?,
        u_mean: mean(|t| t.u),
        ps_max: largest(|t| t.ps)?,
        ps_mean: mean(|t| t.ps),
        targets,
    })
}

/// Symbol and name of a quantity, and function that returns its value.
type Quantity = (&'static str, &'static str, fn(&Vdi3441) -> f64);

const QUANTITIES: [Quantity; 6] = [
    ("P", "positional uncertainty", |v| v.p),
    ("Pa", "position deviation", |v| v.pa),
    ("U_max", "largest reversal", |v| v.u_max),
    ("U_mean", "mean reversal", |v| v.u_mean),
    ("Ps_max", "largest scatter, 6 s", |v| v.ps_max),
    ("Ps_mean", "mean scatter, 6 s", |v| v.ps_mean),
];

impl Vdi3441 {
    /// Symbols of the six quantities, in the order of [`Self::quantities`].
    pub fn symbols() -> [&'static str; 6] {
        QUANTITIES.map(|(symbol, ..)| symbol)
    }

    /// Quantities with symbol and name. They have no values if the guideline could not be evaluated (`None`).
    pub fn quantities(evaluated: Option<&Self>) -> Vec<StandardQuantity> {
        QUANTITIES
            .map(|(symbol, name, value)| StandardQuantity::new(symbol, name, evaluated.map(value)))
            .to_vec()
    }
}

/// Conditions of the test. Unknown conditions (`None`) contribute nothing, and are listed in
/// [`PositioningUncertainty::left_out`].
#[derive(Debug, Clone, Copy, PartialEq, Default, serde::Serialize, serde::Deserialize)]
pub struct UncertaintyInputs {
    /// Expanded uncertainty (k = 2) of the instrument from its calibration, µm/m: the part that is proportional to the
    /// length.
    pub device_um_per_m: Option<f64>,
    /// Expanded uncertainty (k = 2) of the instrument from its calibration, µm: the constant part.
    pub device_um: Option<f64>,
    /// Range of the misalignment between beam and axis over the measured length, mm.
    pub misalignment_mm: Option<f64>,
    /// Range R(θ) of the error of the machine temperature, K.
    pub temperature_range_k: Option<f64>,
    /// Expansion coefficient α of the machine, µm/(m·K).
    pub expansion_um_per_m_k: Option<f64>,
    /// Range R(α) of the error of the expansion coefficient, µm/(m·K).
    pub expansion_range_um_per_m_k: Option<f64>,
    /// Difference of the machine temperature from 20 °C, K, with either sign.
    pub from_20_degc_k: Option<f64>,
    /// Environment variation E_VE, µm: range of a drift test that takes as long as the positioning test.
    pub environment_um: Option<f64>,
}

/// One contribution to the uncertainty, expanded with k = 2.
#[derive(Debug, Clone, Copy, PartialEq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Contribution {
    /// Symbol in plain letters: `U_DEVICE`.
    pub symbol: &'static str,
    /// Name of the contribution, with its formula.
    pub name: &'static str,
    /// Contribution over the length, µm; `None`: not stated and not included.
    pub u_um: Option<f64>,
}

/// Expanded uncertainties (k = 2) of the quantities of ISO 230-2, µm.
#[derive(Debug, Clone, PartialEq, serde::Serialize)]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct PositioningUncertainty {
    /// Measured length for which the uncertainties are stated, m.
    pub length_m: f64,
    /// Number of runs in each direction.
    pub runs: usize,
    /// The contributions in the order of the annex.
    pub contributions: Vec<Contribution>,
    /// U(A), also valid for U(A↑) and U(A↓).
    pub a_um: f64,
    /// U(E), also valid for U(E↑) and U(E↓).
    pub e_um: f64,
    /// U(M), of the mean bidirectional positioning deviation.
    pub m_um: f64,
    /// U(B), of the reversal value.
    pub b_um: f64,
    /// U(R), of the bidirectional repeatability.
    pub r_um: f64,
    /// U(R↑) and U(R↓), of the unidirectional repeatabilities.
    pub r_unidirectional_um: f64,
    /// Contributions that were not stated and are not included, one text each; empty if all were
    /// stated.
    pub left_out: Vec<String>,
}

/// Factor from a range R to the expanded uncertainty. A uniform distribution has the standard uncertainty R/(2√3), and
/// so the expanded uncertainty R/√3. The annex rounds this to 0.6 R, which is 4 % more.
const EXPANDED_OF_RANGE: f64 = 0.577_350_269_189_625_8;

/// Evaluates the uncertainty for a measured length (m) and this number of runs in each direction.
///
/// # Errors
/// A length or number of runs that is not above zero, or an input that is negative or not finite.
pub fn positioning_uncertainty(
    inputs: &UncertaintyInputs,
    length_m: f64,
    runs: usize,
) -> Result<PositioningUncertainty, MetrologyError> {
    check(inputs, length_m, runs)?;
    let device = match (inputs.device_um_per_m, inputs.device_um) {
        (None, None) => None,
        (per_m, fixed) => Some(per_m.unwrap_or(0.0) * length_m + fixed.unwrap_or(0.0)),
    };
    // A beam that is misaligned by r over the length L measures r²/(2L) too little, which is the range of a uniform
    // distribution. With r in mm and L in m the result is in µm.
    let misalignment = inputs.misalignment_mm.map(|r| EXPANDED_OF_RANGE * r * r / (2.0 * length_m));
    let temperature = (inputs.expansion_um_per_m_k.zip(inputs.temperature_range_k))
        .map(|(alpha, range)| EXPANDED_OF_RANGE * alpha * length_m * range);
    let expansion = (inputs.from_20_degc_k.zip(inputs.expansion_range_um_per_m_k))
        .map(|(difference, range)| EXPANDED_OF_RANGE * difference.abs() * length_m * range);
    let environment = inputs.environment_um.map(|e| EXPANDED_OF_RANGE * e);
    let contributions = vec![
        Contribution { symbol: "U_DEVICE", name: "instrument, by its calibration", u_um: device },
        Contribution {
            symbol: "U_MISALIGNMENT",
            name: "beam along the axis, R²/(2√3 L)",
            u_um: misalignment,
        },
        Contribution {
            symbol: "U_M",
            name: "temperature of the machine, α L R(θ)/√3",
            u_um: temperature,
        },
        Contribution {
            symbol: "U_E",
            name: "expansion coefficient, ΔT L R(α)/√3",
            u_um: expansion,
        },
        Contribution {
            symbol: "U_EVE", name: "environment variation, E_VE/√3", u_um: environment
        },
    ];
    // Contributions that are equal for all readings at a target cancel in B and R.
    let common: f64 =
        [device, misalignment, temperature, expansion].iter().flatten().map(|u| u * u).sum();
    let eve = environment.unwrap_or(0.0).powi(2);
    let n = runs as f64;
    Ok(PositioningUncertainty {
        length_m,
        runs,
        a_um: (common + (4.0 + 2.0 / n) * eve).sqrt(),
        e_um: (common + 2.0 / n * eve).sqrt(),
        m_um: (common + eve / n).sqrt(),
        b_um: (2.0 / n * eve).sqrt(),
        r_um: ((4.0 + 2.0 / n) * eve).sqrt(),
        r_unidirectional_um: 2.0 * eve.sqrt(),
        left_out: left_out(inputs, &contributions),
        contributions,
    })
}

impl PositioningUncertainty {
    /// Expanded uncertainty of the quantity with this symbol, µm. `None` if no uncertainty is defined for the symbol,
    /// or if no input to it is known.
    pub fn of(&self, symbol: &str) -> Option<f64> {
        let u = match symbol {
            "A" | "A_forward" | "A_backward" => self.a_um,
            "E" | "E_forward" | "E_backward" => self.e_um,
            "M" => self.m_um,
            "B" => self.b_um,
            "R" => self.r_um,
            "R_forward" | "R_backward" => self.r_unidirectional_um,
            _ => return None,
        };
        (u > 0.0).then_some(u)
    }
}

fn check(inputs: &UncertaintyInputs, length_m: f64, runs: usize) -> Result<(), MetrologyError> {
    let refuse = |what: &str, found: String, expected: &str| {
        MetrologyError::readings("measurement uncertainty", what, found, expected)
    };
    if !(length_m.is_finite() && length_m > 0.0) {
        let found = format!("{length_m} m");
        return Err(refuse("length", found, "a length above zero"));
    }
    if runs == 0 {
        return Err(refuse("runs", "0".into(), "at least one"));
    }
    let named = [
        ("instrument", inputs.device_um_per_m),
        ("instrument", inputs.device_um),
        ("misalignment", inputs.misalignment_mm),
        ("range of the temperature", inputs.temperature_range_k),
        ("expansion coefficient", inputs.expansion_um_per_m_k),
        ("range of the expansion coefficient", inputs.expansion_range_um_per_m_k),
        ("difference to 20 °C", inputs.from_20_degc_k.map(f64::abs)),
        ("environment variation", inputs.environment_um),
    ];
    for (what, value) in named {
        if let Some(value) = value
            && !(0.0..=crate::text::LARGEST).contains(&value)
        {
            let expected = "a finite number of at least 0";
            return Err(refuse(what, value.to_string(), expected));
        }
    }
    Ok(())
}

fn left_out(inputs: &UncertaintyInputs, contributions: &[Contribution]) -> Vec<String> {
    let lacking = |symbol: &str| -> Vec<&str> {
        let pairs: Vec<(&str, bool)> = match symbol {
            "U_DEVICE" => vec![("uncertainty of the instrument", false)],
            "U_MISALIGNMENT" => vec![("misalignment", false)],
            "U_M" => vec![
                ("expansion coefficient", inputs.expansion_um_per_m_k.is_some()),
                ("range of the temperature", inputs.temperature_range_k.is_some()),
            ],
            "U_E" => vec![
                ("difference to 20 °C", inputs.from_20_degc_k.is_some()),
                ("range of the expansion coefficient", inputs.expansion_range_um_per_m_k.is_some()),
            ],
            _ => vec![("environment variation", false)],
        };
        let lacking = pairs.into_iter().filter(|(_, stated)| !stated);
        lacking.map(|(name, _)| name).collect()
    };
    let open = contributions.iter().filter(|c| c.u_um.is_none());
    open.map(|c| format!("{}: {} not stated", c.symbol, lacking(c.symbol).join(" and "))).collect()
}

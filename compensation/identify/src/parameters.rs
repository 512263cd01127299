//! What was found of each unknown, in its unit, and the covariance of all.

use volcomp_kinematics::nalgebra::{DMatrix, Vector3};
use volcomp_vocabulary::{ErrorName, Um, Urad};

use crate::{
    identify::Fitted,
    params::{Param, Part},
    system::System,
    values::six_of,
};

/// What was found of one unknown.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
#[cfg_attr(feature = "schema", derive(schemars::JsonSchema))]
pub struct Parameter {
    /// The name: `EX0C`, `EXX legendre 2`, `tracker.csv:frame.x`.
    pub name: String,
    /// The error that it belongs to; `None` for a number of a set-up.
    #[cfg_attr(feature = "serde", serde(skip))]
    pub error: Option<ErrorName>,
    /// The value in `unit`; 0 where it is not determined.
    pub value: f64,
    /// `um`, `urad`, `mm`, `deg` or `um_per_m`.
    pub unit: &'static str,
    /// The standard uncertainty (k = 1) in `unit`; `None` where it is not determined.
    pub uncertainty: Option<f64>,
    /// Whether the observations determine it.
    pub determined: bool,
    /// The unknowns left at zero with which it is mixed up: its value holds if these are zero.
    pub given_zero: Vec<String>,
}

/// The unit of a key as people read it: `µm/m` of `um_per_m`.
pub fn unit_symbol(unit: &str) -> &str {
    match unit {
        "um" => Um::SYMBOL,
        "urad" => Urad::SYMBOL,
        "um_per_m" => "µm/m",
        other => other,
    }
}

/// The derivatives of the parameters as they are told by those of the search: diagonal but for frames, whose search
/// moves them about their middle.
pub(crate) fn told_by_searched(system: &System, fitted: &Fitted) -> DMatrix<f64> {
    let count = fitted.rank.kept.len();
    let mut told = DMatrix::zeros(count, count);
    for (row, &param) in fitted.rank.kept.iter().enumerate() {
        let (_, scale) = system.unit_of(param);
        let Some((frame, place)) = of_frame(system.params.at(param)) else {
            told[(row, row)] = scale;
            continue;
        };
        let frame_now = &fitted.solution.values.frames[frame];
        let arm = frame_now.pose.translation_mm - frame_now.middle_mm;
        let six = six_of(&frame_now.pose);
        for (column, &other) in fitted.rank.kept.iter().enumerate() {
            let Some((_, by)) = of_frame(system.params.at(other)).filter(|(of, _)| *of == frame)
            else {
                continue;
            };
            let mut turn = Vector3::zeros();
            let mut shift = Vector3::zeros();
            if by < 3 {
                shift[by] = 1.0;
            } else {
                turn[by - 3] = 1.0;
            }
            told[(row, column)] = if place < 3 {
                (shift + turn.cross(&arm))[place]
            } else {
                // ω = (R_z R_y e_x) da + (R_z e_y) db + e_z dc, solved for the rates of the angles.
                let (sb, cb) = six[4].sin_cos();
                let (sc, cc) = six[5].sin_cos();
                let along = cc * turn.x + sc * turn.y;
                let cosine = if cb.abs() < 1e-9 { 1e-9 } else { cb };
                let rates = [
                    along / cosine,
                    cc * turn.y - sc * turn.x,
                    turn.z + along * sb / cosine,
                ];
                rates[place - 3] * scale
            };
        }
    }
    told
}

/// Which frame a number that does not drift belongs to, and which of its six it is.
fn of_frame(param: Param) -> Option<(usize, usize)> {
    match param {
        Param::SetUp {
            part: Part::Frame(frame),
            place,
            order: 0,
        } => Some((frame, place)),
        _ => None,
    }
}

/// The covariance of what is determined, in the products of the units.
pub(crate) fn covariance_in_units(system: &System, fitted: &Fitted) -> DMatrix<f64> {
    let told = told_by_searched(system, fitted);
    &told * &fitted.solution.covariance * told.transpose()
}

/// Every unknown with what was found of it.
pub(crate) fn parameters(system: &System, fitted: &Fitted) -> Vec<Parameter> {
    let covariance = covariance_in_units(system, fitted);
    let values = &fitted.solution.values;
    let parameter = |(param, what): (usize, Param)| {
        let (unit, scale) = system.unit_of(param);
        let value = values.of(what) * scale;
        let place = fitted.rank.kept.iter().position(|kept| *kept == param);
        let mixed = |null: &&Vec<(usize, f64)>| null[1..].iter().any(|(c, _)| *c == param);
        Parameter {
            name: system.name(param),
            error: match what {
                Param::Coefficient(place) => Some(system.unknowns.coefficients[place].error),
                Param::SetUp { .. } => None,
            },
            value,
            unit,
            uncertainty: place.map(|place| covariance[(place, place)].max(0.0).sqrt()),
            determined: place.is_some(),
            given_zero: fitted
                .rank
                .null
                .iter()
                .filter(mixed)
                .map(|null| system.name(null[0].0))
                .collect(),
        }
    };
    system.params.iter().enumerate().map(parameter).collect()
}

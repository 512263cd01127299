//! The result of a thermal fit as a document.

use std::collections::BTreeMap;

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_fit::{ThermalEffect, ThermalSegment, ThermalSize};
use volcomp_metrology::DeviationUnit;
use volcomp_vocabulary::ErrorName;

use super::{
    Arguments, Channel, Judged,
    terms::{self, Expansion},
    verdict::Verdict,
};

/// Thermal terms of displacements.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct FitThermal {
    /// One entry for each fitted displacement.
    displacements: Vec<Displacement>,
    /// Share of the rows, the first ones, from which terms were found to be judged; the others were predicted. Of a single
    /// file only.
    #[serde(skip_serializing_if = "Option::is_none")]
    train: Option<f64>,
    /// The temperature columns, without `_degc`.
    sensors: Vec<String>,
}

/// One displacement, with values in its unit.
#[derive(Debug, Serialize, JsonSchema)]
struct Displacement {
    /// The name of the column in the file.
    name: String,
    /// The error that it is; null where the call does not name it, and the terms have a gap.
    error: Option<ErrorName>,
    /// The unit of the displacement.
    unit: DeviationUnit,
    /// Whether the terms predict better than no terms, and no worse than regression without time constants (`baseline`),
    /// within what the tests show.
    recommended: bool,
    /// Root mean square of the displacement itself where it is predicted.
    without_terms_rms: f64,
    /// Ridge regression on the temperatures as they are.
    baseline: Prediction,
    /// Regression on all sensors with many time constants, as a measure of what few terms lose; of a single file only.
    #[serde(skip_serializing_if = "Option::is_none")]
    dense: Option<Prediction>,
    /// Few terms with time constants. What the temperatures may have done between the rows is part of its errors, and of
    /// those in `left_out`.
    fit: Prediction,
    /// The error in each file that was left out; empty for a single file.
    left_out: Vec<LeftOut>,
    /// The numbers of the terms, found from all rows.
    numbers: Vec<Number>,
    /// The error of validation against the number of numbers, many first.
    sizes: Vec<ThermalSize>,
    /// The drift terms, found from all rows.
    drift: Vec<DriftTerm>,
    /// The expansion terms, found from all rows; only where an axis was moved.
    expansion: Vec<Expansion>,
    /// The temperatures and rates of the sensors of the terms.
    seen: Vec<Seen>,
    /// The constant that belongs to the terms.
    constant: f64,
    /// Range of the constants of the files and positions.
    constant_spread: f64,
    /// The terms as text for a machine file; where `error` is null each `error` in it is a gap to be filled in.
    toml: String,
}

/// How well a fit predicts rows that it was not found from, in the unit of the displacement.
#[derive(Debug, Serialize, JsonSchema)]
struct Prediction {
    /// Root mean square error of the prediction.
    rms: f64,
    /// The stretch with the largest error, of ten of equally many rows; of a single file only.
    worst_segment: Option<ThermalSegment>,
    /// Root mean square error by which penalty, time constants and sensors were chosen.
    forward_rms: f64,
    /// Ridge penalties of the models that are averaged.
    penalties: Vec<f64>,
    /// Time constants of the drift terms, s.
    lags_s: Vec<f64>,
    /// Sensors with a weight.
    sensors: Vec<String>,
}

/// One `[[thermal.drift]]` of a machine file.
#[derive(Debug, Serialize, JsonSchema)]
struct DriftTerm {
    /// Time constant of the first-order lag, s.
    lag_s: f64,
    /// Drift of each sensor by kelvin, in the unit of the displacement.
    sensors: BTreeMap<String, f64>,
}

/// The error in a file that was left out.
#[derive(Debug, Serialize, JsonSchema)]
struct LeftOut {
    /// The file as it was named in the call.
    file: String,
    /// Root mean square error, in the unit of the displacement.
    rms: f64,
}

/// One number of the terms.
#[derive(Debug, Serialize, JsonSchema)]
struct Number {
    /// Name of the sensor.
    sensor: String,
    /// Time constant of the lag, s; not there for an expansion.
    #[serde(skip_serializing_if = "Option::is_none")]
    lag_s: Option<f64>,
    /// The value.
    value: f64,
    /// Its standard uncertainty (k = 1).
    uncertainty: f64,
    /// The unit of both: `um_per_k`, `urad_per_k` or, of an expansion, `um_per_m_k`.
    unit: &'static str,
}

/// The range of a sensor in the tests.
#[derive(Debug, Serialize, JsonSchema)]
struct Seen {
    /// Name of the sensor.
    sensor: String,
    /// Lowest and highest temperature, °C.
    degc: [f64; 2],
    /// Fastest fall and rise, K/min, smoothed over ten minutes.
    k_per_min: [f64; 2],
}

pub(super) fn document(
    channels: &[Channel],
    sensors: &[String],
    arguments: &Arguments,
) -> FitThermal {
    let displacement = |channel: &Channel| displacement(channel, sensors, arguments);
    FitThermal {
        displacements: channels.iter().map(displacement).collect(),
        train: (arguments.data.len() == 1).then_some(arguments.train),
        sensors: sensors.to_vec(),
    }
}

fn displacement(channel: &Channel, sensors: &[String], arguments: &Arguments) -> Displacement {
    let name = |sensor: usize| sensors.get(sensor).cloned().unwrap_or_default();
    let prediction = |judged: &Judged| Prediction {
        rms: judged.rms,
        worst_segment: judged.worst,
        forward_rms: judged.validated,
        penalties: judged.penalties.clone(),
        lags_s: judged.lags_s.clone(),
        sensors: judged.sensors.iter().map(|sensor| name(*sensor)).collect(),
    };
    let found = &channel.terms;
    let number = |number: &volcomp_fit::ThermalNumber| {
        let (lag_s, scale, unit) = match number.effect {
            ThermalEffect::Drift { lag_s } if channel.is_angular() => {
                (Some(lag_s), 1.0, "urad_per_k")
            }
            ThermalEffect::Drift { lag_s } => (Some(lag_s), 1.0, "um_per_k"),
            ThermalEffect::Expansion => (None, 1e3, "um_per_m_k"),
        };
        Number {
            sensor: name(number.sensor),
            lag_s,
            value: number.value * scale,
            uncertainty: number.uncertainty * scale,
            unit,
        }
    };
    let left_out = arguments.data.iter().zip(&channel.left_out);
    let left_out = left_out.map(|(file, &rms)| LeftOut {
        file: file.display().to_string(),
        rms,
    });
    let seen = found.seen.iter().map(|seen| Seen {
        sensor: name(seen.sensor),
        degc: seen.degc,
        k_per_min: seen.k_per_min,
    });
    let (constant, constant_spread) = found.constant_at(arguments.reference);
    let (drift, expansion) = terms::terms(found, sensors);
    let drift = drift.into_iter();
    Displacement {
        name: channel.name.clone(),
        error: channel.error,
        unit: if channel.is_angular() {
            DeviationUnit::Urad
        } else {
            DeviationUnit::Um
        },
        recommended: channel.verdict() == Verdict::Good,
        without_terms_rms: channel.none,
        baseline: prediction(&channel.plain),
        dense: channel.dense.as_ref().map(prediction),
        fit: prediction(&channel.few),
        left_out: left_out.collect(),
        numbers: found.numbers.iter().map(number).collect(),
        sizes: found.path.clone(),
        drift: drift
            .map(|(lag_s, sensors)| DriftTerm { lag_s, sensors })
            .collect(),
        expansion,
        seen: seen.collect(),
        constant,
        constant_spread,
        toml: terms::toml(channel, sensors, arguments.reference),
    }
}

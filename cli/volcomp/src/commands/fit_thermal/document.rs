//! The result of a thermal fit as a document, and its terms as text for a machine file.

use std::{collections::BTreeMap, fmt::Write as _};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_document::{toml_key, toml_string};
use volcomp_fit::{
    ThermalEffect, ThermalNumber, ThermalPrediction, ThermalSize, ThermalTerms, ThermalVerdict,
};
use volcomp_metrology::DeviationUnit;
use volcomp_vocabulary::ErrorName;

use super::{Arguments, Channel};

/// What stands in place of an error that the call does not name.
const GAP: &str = "???";

/// Thermal terms of displacements.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct FitThermal<'a> {
    /// One entry for each fitted displacement.
    pub(super) displacements: Vec<Displacement<'a>>,
    /// Share of the rows, the first ones, from which terms were found to be judged; the others were predicted. Of a single
    /// file only.
    #[serde(skip_serializing_if = "Option::is_none")]
    train: Option<f64>,
    /// The temperature columns, without `_degc`.
    sensors: &'a [String],
}

/// One displacement, with values in its unit.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct Displacement<'a> {
    /// The name of the column in the file.
    name: &'a str,
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
    baseline: Prediction<'a>,
    /// Regression on all sensors with many time constants, as a measure of what few terms lose; of a single file only.
    #[serde(skip_serializing_if = "Option::is_none")]
    dense: Option<Prediction<'a>>,
    /// Few terms with time constants. What the temperatures may have done between the rows is part of its errors, and of
    /// those in `left_out`.
    fit: Prediction<'a>,
    /// The error in each file that was left out; empty for a single file.
    left_out: Vec<LeftOut>,
    /// The numbers of the terms, found from all rows.
    pub(super) numbers: Vec<Number>,
    /// The error of validation against the number of numbers, many first.
    sizes: &'a [ThermalSize],
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
    pub(super) toml: String,
}

/// How well a fit predicts rows that it was not found from.
#[derive(Debug, Serialize, JsonSchema)]
struct Prediction<'a> {
    #[serde(flatten)]
    found: &'a ThermalPrediction,
    /// Sensors with a weight.
    sensors: Vec<&'a str>,
}

/// One `[[thermal.expansion]]` of a machine file.
#[derive(Debug, Serialize, JsonSchema)]
struct Expansion {
    /// Name of the sensor.
    sensor: String,
    /// The expansion, µm/(m·K).
    um_per_m_k: f64,
    /// The coordinate at which nothing moves, mm.
    fixed_mm: f64,
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
pub(super) struct Number {
    /// Name of the sensor.
    pub(super) sensor: String,
    /// Time constant of the lag, s; not there for an expansion.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(super) lag_s: Option<f64>,
    /// The value.
    pub(super) value: f64,
    /// Its standard uncertainty (k = 1).
    pub(super) uncertainty: f64,
    /// The unit of both: `um_per_k`, `urad_per_k` or, of an expansion, `um_per_m_k`.
    pub(super) unit: &'static str,
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

impl<'a> FitThermal<'a> {
    pub(super) fn new(
        channels: &'a [Channel],
        sensors: &'a [String],
        arguments: &'a Arguments,
    ) -> Self {
        let displacement = |channel| displacement(channel, sensors, arguments);
        Self {
            displacements: channels.iter().map(displacement).collect(),
            train: (arguments.data.len() == 1).then_some(arguments.train),
            sensors,
        }
    }
}

fn displacement<'a>(
    channel: &'a Channel,
    sensors: &'a [String],
    arguments: &Arguments,
) -> Displacement<'a> {
    let name = |sensor: usize| sensors.get(sensor).cloned().unwrap_or_default();
    let judged = &channel.judged;
    let found = &judged.terms;
    let prediction = |found: &'a ThermalPrediction| Prediction {
        sensors: (found.sensors.iter())
            .filter_map(|sensor| Some(sensors.get(*sensor)?.as_str()))
            .collect(),
        found,
    };
    let number = |number: &ThermalNumber| {
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
    let left_out = arguments.data.iter().zip(&judged.left_out);
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
    let (drift, expansion) = terms(found, sensors);
    Displacement {
        name: &channel.name,
        error: channel.error,
        unit: if channel.is_angular() {
            DeviationUnit::Urad
        } else {
            DeviationUnit::Um
        },
        recommended: judged.verdict() == ThermalVerdict::Good,
        without_terms_rms: judged.none_rms,
        baseline: prediction(&judged.plain),
        dense: judged.dense.as_ref().map(prediction),
        fit: prediction(&judged.few),
        left_out: left_out.collect(),
        numbers: found.numbers.iter().map(number).collect(),
        sizes: &found.path,
        drift,
        expansion,
        seen: seen.collect(),
        constant,
        constant_spread,
        toml: toml(channel, sensors, arguments.reference),
    }
}

/// Drift by time constant, and expansions: what a sensor without a lag adds says where its expansion has its fixed point.
fn terms(found: &ThermalTerms, sensors: &[String]) -> (Vec<DriftTerm>, Vec<Expansion>) {
    let expansion_of = |sensor: usize| {
        let mut numbers = found.numbers.iter();
        let number = numbers.find(|n| n.sensor == sensor && n.effect == ThermalEffect::Expansion);
        number.filter(|number| number.value != 0.0)
    };
    let (mut drift, mut expansions): (Vec<DriftTerm>, Vec<Expansion>) = (Vec::new(), Vec::new());
    for number in &found.numbers {
        let Some(sensor) = sensors.get(number.sensor) else {
            continue;
        };
        let ThermalEffect::Drift { lag_s } = number.effect else {
            let without_lag = found.numbers.iter().find(|other| {
                other.sensor == number.sensor && other.effect == ThermalEffect::Drift { lag_s: 0.0 }
            });
            let fixed_mm = without_lag.map_or(0.0, |other| -other.value / number.value);
            expansions.push(Expansion {
                sensor: sensor.clone(),
                um_per_m_k: number.value * 1e3,
                fixed_mm: if fixed_mm.is_finite() { fixed_mm } else { 0.0 },
            });
            continue;
        };
        if lag_s == 0.0 && expansion_of(number.sensor).is_some() {
            continue;
        }
        let place = drift.iter().position(|known| known.lag_s == lag_s);
        let place = place.unwrap_or_else(|| {
            drift.push(DriftTerm {
                lag_s,
                sensors: BTreeMap::new(),
            });
            drift.len() - 1
        });
        drift[place].sensors.insert(sensor.clone(), number.value);
    }
    (drift, expansions)
}

/// The terms as `[[thermal.drift]]`, `[[thermal.expansion]]` and `[[thermal.seen]]`, and the constant that belongs to them.
/// Where nobody said which error they are of, a gap stands in its place, which no machine file takes.
fn toml(channel: &Channel, sensors: &[String], reference_degc: f64) -> String {
    let found = &channel.judged.terms;
    let (unit, symbol) = if channel.is_angular() {
        ("urad", "µrad")
    } else {
        ("um", "µm")
    };
    let (error, curve) = match channel.error {
        Some(error) => (error.to_string(), format!("the curve of {error}")),
        None => (GAP.to_owned(), "its curve".to_owned()),
    };
    let mut text = String::new();
    if channel.error.is_none() {
        // Writing to a string never fails.
        let _ = writeln!(
            text,
            "# Put the error that {} is in place of {GAP}.",
            channel.name
        );
    }
    let _ = writeln!(
        text,
        "# With {reference_degc} °C as [thermal] reference the constant\n# {:.3} {symbol} belongs to {curve}.",
        found.constant_at(reference_degc).0
    );
    let (drift, expansions) = terms(found, sensors);
    // Writing to a string never fails.
    for term in expansions {
        let _ = write!(
            text,
            "[[thermal.expansion]]\nerror = \"{error}\"\nsensor = {}\num_per_m_k = {:.6}\nfixed_mm = {:.3}\n",
            toml_string(&term.sensor),
            term.um_per_m_k,
            term.fixed_mm
        );
    }
    for DriftTerm { lag_s, sensors } in drift {
        let weights = sensors
            .iter()
            .map(|(name, k)| format!("{} = {k:.6}", toml_key(name)));
        let _ = write!(
            text,
            "[[thermal.drift]]\nerror = \"{error}\"\nsensors = {{ {} }}\n{unit}_per_k = 1.0\nlag_s = {lag_s:.1}\n",
            weights.collect::<Vec<_>>().join(", "),
        );
    }
    for seen in &found.seen {
        let Some(sensor) = sensors.get(seen.sensor) else {
            continue;
        };
        // Rounded outwards: what the tests had is not beyond them.
        let [low, high] = outwards(seen.degc, 1e2);
        let [fall, rise] = outwards(seen.k_per_min, 1e4);
        let _ = write!(
            text,
            "[[thermal.seen]]\nerror = \"{error}\"\nsensor = {}\ndegc = [{low:.2}, {high:.2}]\nk_per_min = [{fall:.4}, {rise:.4}]\n",
            toml_string(sensor)
        );
    }
    text
}

/// A range whose ends lie on whole parts of 1, and which is not empty.
fn outwards([low, high]: [f64; 2], parts: f64) -> [f64; 2] {
    let (low, high) = ((low * parts).floor(), (high * parts).ceil());
    [low / parts, high.max(low + 1.0) / parts]
}

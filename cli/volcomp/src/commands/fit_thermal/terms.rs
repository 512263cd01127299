//! The numbers that were found as terms of a machine file.

use std::{collections::BTreeMap, fmt::Write as _};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_document::{toml_key, toml_string};
use volcomp_fit::{ThermalEffect, ThermalTerms};

use super::Channel;

/// What stands in place of an error that the call does not name.
const GAP: &str = "???";

/// A lag, and for each sensor its weight, µm/K or µrad/K.
pub(super) type Drift = (f64, BTreeMap<String, f64>);

/// One `[[thermal.expansion]]` of a machine file.
#[derive(Debug, Serialize, JsonSchema)]
pub(super) struct Expansion {
    /// Name of the sensor.
    pub(super) sensor: String,
    /// The expansion, µm/(m·K).
    pub(super) um_per_m_k: f64,
    /// The coordinate at which nothing moves, mm.
    pub(super) fixed_mm: f64,
}

/// Drift by time constant, and expansions: what a sensor without a lag adds says where its expansion has its fixed point.
pub(super) fn terms(found: &ThermalTerms, sensors: &[String]) -> (Vec<Drift>, Vec<Expansion>) {
    let expansion_of = |sensor: usize| {
        let mut numbers = found.numbers.iter();
        let number = numbers.find(|n| n.sensor == sensor && n.effect == ThermalEffect::Expansion);
        number.filter(|number| number.value != 0.0)
    };
    let (mut drift, mut expansions): (Vec<Drift>, Vec<Expansion>) = (Vec::new(), Vec::new());
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
        let place = drift.iter().position(|(known, _)| *known == lag_s);
        let place = place.unwrap_or_else(|| {
            drift.push((lag_s, BTreeMap::new()));
            drift.len() - 1
        });
        drift[place].1.insert(sensor.clone(), number.value);
    }
    (drift, expansions)
}

/// The terms as `[[thermal.drift]]`, `[[thermal.expansion]]` and `[[thermal.seen]]`, and the constant that belongs to them.
/// Where nobody said which error they are of, a gap stands in its place, which no machine file takes.
pub(super) fn toml(channel: &Channel, sensors: &[String], reference_degc: f64) -> String {
    let found = &channel.terms;
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
    for (lag_s, weights) in drift {
        let weights = weights
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

//! `volcomp probe`: what a device says now.

use std::{fmt::Write, time::Duration};

use serde_json::{Map, Value, json};
use volcomp_devices::{Address, Probe, probe};
use volcomp_port::{Quality, Temperature};

use super::{Answer, table, table_text};
use crate::failure::Failure;

/// What a device says now: positions, temperatures, inputs
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// focas://HOST:8193, modbus://HOST?profile=NAME, modbus-rtu:///dev/ttyUSB0?profile=NAME, can://can0,
    /// gpio://?position=CHIP:LINES&correction=CHIP:LINES
    url: String,
    /// How long to wait for an answer, s
    #[arg(long, default_value_t = 3.0)]
    within: f64,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let address = Address::parse(&arguments.url).map_err(|e| Failure::Input(e.to_string()))?;
    let within = Duration::try_from_secs_f64(arguments.within)
        .ok()
        .filter(|within| *within <= Duration::from_secs(3600))
        .ok_or_else(|| {
            let found = arguments.within;
            Failure::Input(format!("--within: found {found}, expected 0 to 3600 s"))
        })?;
    // What a URL says is checked before a device is asked, so what is left is the device's.
    let found = probe(&address, within).map_err(|e| {
        let message = e.to_string();
        if e.remedy.starts_with("expected") || e.remedy.starts_with("correct") {
            Failure::Input(message)
        } else {
            Failure::Work(message)
        }
    })?;
    Ok(Answer {
        json: json(&found),
        text: text(&found),
        notes: Vec::new(),
    })
}

/// Good, uncertain or bad, and why.
fn quality(temperature: &Temperature) -> (&'static str, Option<String>) {
    match temperature.quality {
        Quality::Good => ("good", None),
        Quality::Uncertain(reason) => ("uncertain", Some(reason.to_string())),
        Quality::Bad(reason) => ("bad", Some(reason.to_string())),
    }
}

fn json(found: &Probe) -> Value {
    let mut json = json!({ "device": found.device });
    let positions = |rotary: bool| {
        let of_kind = found.positions.iter().filter(|p| p.rotary == rotary);
        let map: Map<String, Value> = of_kind.map(|p| (p.name.clone(), json!(p.value))).collect();
        (!map.is_empty()).then_some(map)
    };
    for (key, map) in [
        ("positions_mm", positions(false)),
        ("positions_deg", positions(true)),
    ] {
        if let Some(map) = map {
            json[key] = Value::Object(map);
        }
    }
    if !found.temperatures.is_empty() {
        let temperature = |(name, temperature): &(String, Temperature)| {
            let (quality, reason) = quality(temperature);
            let mut entry = json!({ "name": name, "degc": temperature.degc, "quality": quality });
            if let Some(reason) = reason {
                entry["reason"] = json!(reason);
            }
            entry
        };
        json["temperatures"] = found.temperatures.iter().map(temperature).collect();
    }
    if !found.inputs.is_empty() {
        json["inputs"] = json!(found.inputs);
    }
    for (name, value) in &found.facts {
        json[name] = match (value.parse::<bool>(), value.parse::<f64>()) {
            (Ok(flag), _) => json!(flag),
            (_, Ok(number)) => json!(number),
            _ => json!(value),
        };
    }
    json
}

fn text(found: &Probe) -> String {
    let mut text = format!("{}\n", found.device);
    let mut rows = table(&["", "", "", ""]);
    for position in &found.positions {
        let unit = if position.rotary { "deg" } else { "mm" };
        let value = format!("{:.4}", position.value);
        rows.add_row([&*position.name, &value, unit, ""]);
    }
    for (name, temperature) in &found.temperatures {
        let (quality, reason) = quality(temperature);
        let value = temperature
            .degc
            .map_or_else(|| "-".to_owned(), |t| format!("{t:.2}"));
        let reason = reason.map_or_else(|| quality.to_owned(), |why| format!("{quality}: {why}"));
        rows.add_row([name, &value, "degC", &reason]);
    }
    if !found.positions.is_empty() || !found.temperatures.is_empty() {
        let body = table_text(&rows);
        // The table's head is empty.
        text += body.trim_start_matches('\n');
    }
    if !found.inputs.is_empty() {
        let lines: String = found
            .inputs
            .iter()
            .map(|on| if *on { '1' } else { '0' })
            .collect();
        let _ = writeln!(text, "inputs, line 0 first: {lines}"); // writing to a String cannot fail
    }
    for (name, value) in &found.facts {
        let _ = writeln!(text, "{}: {value}", name.replace('_', " "));
    }
    text
}

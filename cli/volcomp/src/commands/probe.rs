//! `volcomp probe`: what a device says now, and which devices there are.

use std::{fmt::Write, time::Duration};

use comfy_table::CellAlignment;
use serde_json::{Map, Value, json};
use volcomp_devices::{Address, LocalDevices, Probe, ProbedPosition, list, probe};
use volcomp_port::{DeviceError, Quality, Temperature};
use volcomp_vocabulary::AxisKind;

use super::{Answer, table, table_text};
use crate::failure::Failure;

/// What a device says now: positions, temperatures, inputs; or which serial ports, CAN interfaces and GPIO lines there are
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// focas://HOST:8193, modbus://HOST?profile=NAME, modbus-rtu:///dev/ttyUSB0?profile=NAME, can://can0,
    /// gpio://?position=CHIP:LINES&correction=CHIP:LINES. A profile is the name of a shipped one or a file that
    /// ends in .toml
    #[arg(required_unless_present = "list")]
    url: Option<String>,
    /// How long to wait for an answer, s
    #[arg(long, default_value_t = 3.0)]
    within: f64,
    /// Lists the serial ports, CAN interfaces and GPIO chips with their lines that this computer has
    #[arg(long, conflicts_with = "url")]
    list: bool,
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let Some(url) = arguments.url.as_ref().filter(|_| !arguments.list) else {
        return Ok(listed(&list()));
    };
    let told = |e: DeviceError| {
        let message = e.to_string();
        if e.is_input() {
            Failure::Input(message)
        } else {
            Failure::Work(message)
        }
    };
    let address = Address::parse(url).map_err(told)?;
    let within = Duration::try_from_secs_f64(arguments.within)
        .ok()
        .filter(|within| *within <= Duration::from_secs(3600))
        .ok_or_else(|| {
            let found = arguments.within;
            Failure::Input(format!("--within: found {found}, expected 0 to 3600 s"))
        })?;
    let found = probe(&address, within).map_err(told)?;
    Ok(Answer {
        json: json(&found),
        text: text(&found),
        notes: Vec::new(),
    })
}

/// The serial ports, CAN interfaces and GPIO lines of this computer, as JSON and as a table.
fn listed(found: &LocalDevices) -> Answer {
    let mut rows = table(&["device", "what it is", "state"]);
    for column in rows.column_iter_mut() {
        column.set_cell_alignment(CellAlignment::Left);
    }
    for port in &found.serial_ports {
        let description = match &*port.description {
            "" => "serial port".to_owned(),
            usb => format!("serial port, {usb}"),
        };
        rows.add_row([&*port.device, &description, ""]);
    }
    for interface in &found.can_interfaces {
        let kind = match interface.mtu {
            Some(72) => "CAN interface, CAN FD",
            _ => "CAN interface",
        };
        let state = if interface.up { "up" } else { "down" };
        rows.add_row([&*interface.name, kind, state]);
    }
    for chip in &found.gpio_chips {
        let kind = format!("GPIO chip {}", chip.label);
        let state = match chip.lines.len() {
            0 => "no lines for this user".to_owned(),
            count => format!("{count} lines"),
        };
        rows.add_row([&*chip.name, kind.trim_end(), &state]);
        for line in &chip.lines {
            let direction = if line.output { "output" } else { "input" };
            let state = match &line.used_by {
                Some(program) => format!("{direction}, used by {program}"),
                None => direction.to_owned(),
            };
            let place = format!("{}:{}", chip.name, line.number);
            rows.add_row([&*place, &line.name, &state]);
        }
    }
    let is_empty = found == &LocalDevices::default();
    Answer {
        json: json!(found),
        text: if is_empty {
            "no serial port, CAN interface or GPIO chip was found\n".to_owned()
        } else {
            table_text(&rows)
        },
        notes: Vec::new(),
    }
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
    let positions = |kind: AxisKind| {
        let of_kind = found.positions.iter().filter(|p| p.at.kind() == kind);
        let entry = |p: &ProbedPosition| (p.name.clone(), json!(p.at.mm_or_deg()));
        let map: Map<String, Value> = of_kind.map(entry).collect();
        (!map.is_empty()).then_some(map)
    };
    for (key, map) in [
        ("positions_mm", positions(AxisKind::Linear)),
        ("positions_deg", positions(AxisKind::Rotary)),
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
        let unit = match position.at.kind() {
            AxisKind::Linear => "mm",
            AxisKind::Rotary => "deg",
        };
        let value = format!("{:.4}", position.at.mm_or_deg());
        rows.add_row([&*position.name, &value, unit, ""]);
    }
    for (name, temperature) in &found.temperatures {
        let (quality, reason) = quality(temperature);
        let value = temperature
            .degc
            .map_or_else(|| "-".to_owned(), |t| format!("{t:.2}"));
        let reason = reason.map_or_else(|| quality.to_owned(), |why| format!("{quality}: {why}"));
        rows.add_row([name, &value, "°C", &reason]);
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

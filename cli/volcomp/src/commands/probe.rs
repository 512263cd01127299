use std::{fmt::Write, time::Duration};

use comfy_table::CellAlignment;
use volcomp_devices::{Address, ControlFacts, Facts, LocalDevices, Probe, list, probe};
use volcomp_port::DeviceError;

use super::{Answer, table, table_text};
use crate::failure::Failure;

/// Request positions, temperatures and inputs of a device once, or list the serial ports, CAN interfaces and GPIO lines
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp probe --list
  volcomp --json probe focas://127.0.0.1:8193 --within 1")]
pub(crate) struct ProbeArguments {
    /// focas://HOST:8193, modbus://HOST?profile=NAME, modbus-rtu:///dev/ttyUSB0?profile=NAME, can://can0,
    /// gpio://?position=CHIP:LINES&correction=CHIP:LINES; a profile is the name of a shipped one or a .toml file
    #[arg(required_unless_present = "list")]
    url: Option<String>,
    /// Timeout for an answer, s: 0 to 3600
    #[arg(long, default_value_t = 3.0)]
    within: f64,
    /// List the serial ports, CAN interfaces, and GPIO chips with their lines
    #[arg(long, conflicts_with = "url")]
    list: bool,
}

pub(crate) fn run(arguments: &ProbeArguments) -> Result<Answer, Failure> {
    let Some(url) = arguments.url.as_ref().filter(|_| !arguments.list) else {
        return listed(&list());
    };
    let told = |e: DeviceError| {
        let message = e.to_string();
        if e.is_input() { Failure::Input(message) } else { Failure::Work(message) }
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
    Answer::new(&found, text(&found), Vec::new())
}

/// The serial ports, CAN interfaces and GPIO lines of this computer, as JSON and as a table.
fn listed(found: &LocalDevices) -> Result<Answer, Failure> {
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
    let is_empty = found.serial_ports.is_empty()
        && found.can_interfaces.is_empty()
        && found.gpio_chips.is_empty();
    let text = if is_empty {
        "no serial port, CAN interface or GPIO chip was found\n".to_owned()
    } else {
        table_text(&rows)
    };
    Answer::new(found, text, Vec::new())
}

fn text(found: &Probe) -> String {
    let mut text = format!("{}\n", found.device);
    let mut rows = table(&["", "", "", ""]);
    for (positions, unit) in [(&found.positions_mm, "mm"), (&found.positions_deg, "deg")] {
        for (name, at) in positions {
            rows.add_row([name, &format!("{at:.4}"), unit, ""]);
        }
    }
    for temperature in &found.temperatures {
        let quality = temperature.quality;
        let value = temperature.degc.map_or_else(|| "-".to_owned(), |t| format!("{t:.2}"));
        let reason = match &temperature.reason {
            Some(why) => format!("{quality}: {why}"),
            None => quality.to_owned(),
        };
        rows.add_row([&temperature.name, &value, "°C", &reason]);
    }
    if !rows.is_empty() {
        let body = table_text(&rows);
        // The table header is empty, so remove its line.
        text += body.trim_start_matches('\n');
    }
    if !found.inputs.is_empty() {
        let lines: String = found.inputs.iter().map(|on| if *on { '1' } else { '0' }).collect();
        let _ = writeln!(text, "inputs, line 0 first: {lines}");
    }
    if let Some(facts) = &found.facts {
        text += &told(facts);
    }
    text
}

fn told(facts: &Facts) -> String {
    match facts {
        Facts::Control(facts) => format!(
            "control: {}\nseries: {}\nversion: {}\nemergency stop: {}\nalarm: {}\n\
             {}round trip, median: {} µs\nround trip, longest: {} µs\n",
            facts.control,
            facts.series,
            facts.version,
            facts.emergency_stop,
            facts.alarm,
            shift_parameters(facts),
            facts.round_trip_p50_us,
            facts.round_trip_max_us
        ),
        Facts::Module(facts) => {
            let not_proven = match &facts.unproven[..] {
                [] => String::new(),
                parts => format!("not proven: {}\n", parts.join("; ")),
            };
            let untold = match facts.outputs_told {
                Some(false) => {
                    "levels of the outputs: not told by the module; outputs that carry no correction are\n\
                     switched off when a correction is written\n"
                }
                _ => "",
            };
            format!("profile: {}\n{not_proven}{untold}", facts.profile)
        }
        Facts::Bus(facts) => {
            let frames: Vec<String> = facts.frames.iter().map(ToString::to_string).collect();
            format!("frames: {}\nerrors: {}\n", frames.join(", "), facts.errors)
        }
    }
}

/// The parameters with the words from which the control reads its axis shifts, one per line.
fn shift_parameters(facts: &ControlFacts) -> String {
    match (facts.shift_in_use, facts.shift_words, &facts.shift_untold) {
        (Some(in_use), Some(first), _) => format!(
            "external zero point shift in use (parameter 1203#0): {in_use}\n\
             its words (parameter 1280): from R{first} on\n"
        ),
        (_, _, why) => format!(
            "external zero point shift (parameters 1203#0 and 1280): not readable: {}\n",
            why.as_deref().unwrap_or("no reason given")
        ),
    }
}

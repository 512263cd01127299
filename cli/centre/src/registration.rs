//! Which machines are registered: what of one is checked, wherever it comes from, before anything is stored.

use volcomp_fleet::is_public_nkey;
use volcomp_model::kinematics::Structure;

use crate::records::Machine;

/// The longest text of a machine, characters.
const LONGEST: usize = 500;
/// The longest time between two conditions or two whole states, s.
const LONGEST_INTERVAL_S: u32 = 86_400;
/// The longest time between two calibrations, days.
const LONGEST_DUE_DAYS: u32 = 36_500;

/// Why a machine is not registered.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{key}: found {found}, expected {expected}")]
pub struct NotRegistered {
    /// The key of the machine that is wrong.
    pub key: &'static str,
    pub found: String,
    pub expected: String,
}

/// Checks what is known of a machine: its axes are those of its structure in chain order, its texts are single lines, its
/// nkey is a public one, and its times make sense.
///
/// # Errors
/// The first that is wrong.
pub fn check(machine: &Machine) -> Result<(), NotRegistered> {
    let wrong = |key, found: String, expected: String| NotRegistered {
        key,
        found,
        expected,
    };
    let structure: Structure = machine.structure.parse().map_err(|error| {
        wrong(
            "structure",
            format!("{:?}", machine.structure),
            format!("a structure code: {error}"),
        )
    })?;
    if structure.axes() != machine.axes {
        let letters = |axes: &[volcomp_vocabulary::AxisName]| {
            let letters: Vec<String> = axes.iter().map(ToString::to_string).collect();
            letters.join(" ")
        };
        let expected = format!(
            "those of the structure in its order, {}",
            letters(structure.axes())
        );
        return Err(wrong("axes", letters(&machine.axes), expected));
    }
    if machine.serial.trim().is_empty() {
        let expected = "the serial number of the machine tool".to_owned();
        return Err(wrong("serial", format!("{:?}", machine.serial), expected));
    }
    for (key, text) in [
        ("serial", &machine.serial),
        ("address", &machine.address),
        ("control", &machine.control),
        ("note", &machine.note),
    ] {
        if text.chars().count() > LONGEST || text.contains(char::is_control) {
            let found: String = text.chars().take(80).collect();
            let expected = format!("one line of at most {LONGEST} characters");
            return Err(wrong(key, format!("{found:?}"), expected));
        }
    }
    if let Some(nkey) = machine.nkey.as_ref().filter(|nkey| !is_public_nkey(nkey)) {
        // What was found may be the seed, which belongs into no message.
        let found = format!("{} characters", nkey.chars().count());
        let expected =
            "the public nkey of the gateway's user, U and 55 letters and digits".to_owned();
        return Err(wrong("nkey", found, expected));
    }
    for (key, value, most, unit) in [
        ("condition_s", machine.condition_s, LONGEST_INTERVAL_S, "s"),
        ("telemetry_s", machine.telemetry_s, LONGEST_INTERVAL_S, "s"),
        ("due_days", machine.due_days, LONGEST_DUE_DAYS, "days"),
    ] {
        if let Some(found) = value.filter(|value| !(1..=most).contains(value)) {
            return Err(wrong(key, found.to_string(), format!("1 to {most} {unit}")));
        }
    }
    Ok(())
}

//! What the surroundings of a test mean for its readings.

use crate::{Environment, Quantity, StartEnd};

/// The temperature at which lengths are stated (ISO 1), °C.
pub const REFERENCE_DEGC: f64 = 20.0;

/// A material temperature that is farther from 20 °C than this is noted, K: at 11 µm/(m·K) steel is 11 µm/m longer, more
/// than a laser's own error and about that of a good scale.
pub const MATERIAL_WITHIN_K: f64 = 1.0;

/// Outside of these no machine is measured, °C.
const ROOM_DEGC: [f64; 2] = [-5.0, 60.0];
/// µm/(m·K): from Invar to plastics.
const COEFFICIENTS: [f64; 2] = [0.0, 100.0];

/// Notes on the surroundings of a test: material farther than 1 K from 20 °C or changing by more during the test, with
/// what hangs on the expansion coefficient, and values that no workshop has. The material matters to lengths along an axis
/// alone: of straightness and of angles only what no workshop has is noted.
pub fn environment_notes(environment: &Environment, quantity: Quantity) -> Vec<String> {
    let is_length = quantity == Quantity::Positioning;
    let mut notes = Vec::new();
    for (index, sensor) in environment.material_temperature.iter().enumerate() {
        let Some(degc) = sensor else { continue };
        let name = format!("material temperature {}", index + 1);
        let of_length = || {
            is_length
                .then(|| material(&name, degc, environment))
                .flatten()
        };
        notes.extend(room(&name, degc).or_else(of_length));
    }
    if let Some(air) = &environment.air_temperature {
        notes.extend(room("air temperature", air));
    }
    if let Some(coefficient) = &environment.expansion_coefficient {
        let [least, most] = COEFFICIENTS;
        let found = coefficient.start;
        if !(least..=most).contains(&found) {
            notes.push(format!(
                "the expansion coefficient is stated as {found} µm/(m·K), expected {least} to {most}: check its unit"
            ));
        }
    }
    notes
}

/// How the file states that the readings were brought to 20 °C, in one sentence.
pub fn material_compensation(environment: &Environment) -> String {
    let sensors = environment.material_temperature.iter().flatten().count();
    let coefficient = environment.expansion_coefficient.map(|c| c.start);
    match (coefficient, sensors) {
        (None, _) => "not stated: no expansion coefficient".to_owned(),
        (Some(0.0), _) => "none: the expansion coefficient is 0".to_owned(),
        (Some(coefficient), 0) => {
            format!("{coefficient} µm/(m·K) stated, but no material temperature")
        }
        (Some(coefficient), 1) => {
            format!("{coefficient} µm/(m·K) and one material temperature stated")
        }
        (Some(coefficient), several) => {
            format!("{coefficient} µm/(m·K) and {several} material temperatures stated")
        }
    }
}

fn room(name: &str, degc: &StartEnd) -> Option<String> {
    let [least, most] = ROOM_DEGC;
    let is_room = |value: f64| (least..=most).contains(&value);
    (!is_room(degc.start) || !is_room(degc.end)).then(|| {
        format!(
            "{name} is stated as {} to {} °C, expected {least} to {most} °C: check its unit and sensor",
            degc.start, degc.end
        )
    })
}

fn material(name: &str, degc: &StartEnd, environment: &Environment) -> Option<String> {
    let farthest = [degc.start, degc.end]
        .map(|value| value - REFERENCE_DEGC)
        .into_iter()
        .max_by(|a, b| a.abs().total_cmp(&b.abs()))?;
    let change = degc.end - degc.start;
    let mut odd = Vec::new();
    if farthest.abs() > MATERIAL_WITHIN_K {
        odd.push(format!("farther than {MATERIAL_WITHIN_K} K from 20 °C"));
    }
    if change.abs() > MATERIAL_WITHIN_K {
        odd.push(format!("changing by {change:.2} K during the test"));
    }
    if odd.is_empty() {
        return None;
    }
    let coefficient = environment.expansion_coefficient.map(|c| c.start);
    let hangs = match coefficient {
        Some(coefficient) if coefficient != 0.0 => format!(
            "with {coefficient} µm/(m·K) the material is {:.1} µm/m from its length at 20 °C; whether the readings were compensated for it the file does not say",
            coefficient * farthest
        ),
        Some(_) => {
            "the expansion coefficient is 0, so the readings are not brought to 20 °C".to_owned()
        }
        None => "no expansion coefficient is stated, so it is not known whether the readings are brought to 20 °C".to_owned(),
    };
    let [start, end] = [degc.start, degc.end].map(|degc| format!("{degc:.2}"));
    let span = if start == end {
        start
    } else {
        format!("{start} to {end}")
    };
    Some(format!(
        "{name} was {span} °C, {}: {hangs}",
        odd.join(" and ")
    ))
}

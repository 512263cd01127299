use volcomp_document::quoted;

use super::document::{Section, key_value};
use crate::number::Place;
use crate::{Environment, MetrologyError, StartEnd};

/// Reading that the file contains for a disconnected material sensor, °C.
pub(super) const NO_SENSOR_DEGC: f64 = -10.0;

pub(super) fn environment(
    section: Option<&Section<'_>>,
    file: &str,
) -> Result<Environment, MetrologyError> {
    let mut environment = Environment::default();
    for (line, text) in section.map(|s| s.lines.as_slice()).unwrap_or_default() {
        let Some((key, value)) = key_value(text) else {
            continue;
        };
        if key == "datetime" {
            environment.date_time = Some(value.to_owned()).filter(|v| !v.is_empty());
            continue;
        }
        let Some(field) = field_of(&mut environment, &key) else {
            continue;
        };
        *field = start_end(Place::new(file, *line), text, value)?;
    }
    let connected = |t: &StartEnd| t.start != NO_SENSOR_DEGC && t.end != NO_SENSOR_DEGC;
    for sensor in &mut environment.material_temperature {
        *sensor = sensor.filter(connected);
    }
    Ok(environment)
}

fn field_of<'e>(environment: &'e mut Environment, key: &str) -> Option<&'e mut Option<StartEnd>> {
    let [first, second, third] = &mut environment.material_temperature;
    match key {
        "airtemp" => Some(&mut environment.air_temperature),
        "airpress" => Some(&mut environment.air_pressure),
        "airhumid" => Some(&mut environment.air_humidity),
        "mattemp1" => Some(first),
        "mattemp2" => Some(second),
        "mattemp3" => Some(third),
        "expcoeff" => Some(&mut environment.expansion_coefficient),
        "envfactor" => Some(&mut environment.environment_factor),
        _ => None,
    }
}

fn start_end(
    place: Place<'_>,
    line: &str,
    value: &str,
) -> Result<Option<StartEnd>, MetrologyError> {
    let tokens: Vec<&str> = value.split_ascii_whitespace().collect();
    let (start, end, code) = match tokens[..] {
        [] => return Ok(None),
        [start, end] => (start, end, None),
        [start, end, code] => (start, end, Some(code)),
        _ => {
            return Err(place.malformed("ENVIRONMENT", quoted(line), "start, end and a unit code"));
        }
    };
    let unit_code = match code.map(|c| (c, c.parse::<i64>())) {
        None => None,
        Some((_, Ok(code))) => Some(code),
        Some((text, Err(_))) => {
            return Err(place.not_a_number("unit code", quoted(text), "a whole number"));
        }
    };
    Ok(Some(StartEnd {
        start: place.number("start", start)?,
        end: place.number("end", end)?,
        unit_code,
    }))
}

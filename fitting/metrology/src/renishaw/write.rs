use std::fmt::Write as _;

use super::RenishawKind;
use super::environment::NO_SENSOR_DEGC;
use crate::{DeviationUnit, Direction, Environment, Measurement, Quantity, Reading, StartEnd};

const TARGETS_PER_LINE: usize = 5;

/// Writes a Renishaw laser file: `.rta` for deviations in µrad, `.rts` for straightness, otherwise `.rtl`.
///
/// Lines end with CRLF. There is one pass per run, forward and backward in turn. Reverse runs are in the order of
/// travel (targets descending). `Run-count` is the number of passes, and the second flag is 1 for one direction only.
/// Targets and µm have six decimals, milliradian nine. The format has only complete runs: if a run lacks a target,
/// counts and rows differ, and [`parse_renishaw`](crate::parse_renishaw) rejects the file. Line breaks in texts become
/// blanks.
pub fn write_renishaw(measurement: &Measurement) -> String {
    let kind = match measurement.unit {
        Some(DeviationUnit::Urad) => RenishawKind::Angular,
        _ if measurement.quantity == Some(Quantity::Straightness) => RenishawKind::Straightness,
        _ => RenishawKind::Linear,
    };
    let targets = measurement.targets();
    let passes = passes(measurement);
    let mut lines = header(measurement, kind);
    lines.extend(target_data(measurement, &targets));
    lines.extend(user_text(measurement));
    lines.extend(["RUNS::".into(), format!("Run-count: {}", passes.len())]);
    lines.extend(deviations(&passes, &targets, kind));
    lines.extend(environment(&measurement.environment));
    lines.push("EOF::".into());
    lines.join("\r\n") + "\r\n"
}

/// Runs in the order of travel: forward 1, backward 1, forward 2, …
fn passes(measurement: &Measurement) -> Vec<Vec<Reading>> {
    let mut keys: Vec<(u32, Direction)> =
        measurement.readings.iter().map(|r| (r.run, r.direction)).collect();
    keys.sort_unstable();
    keys.dedup();
    let pass = |(run, direction): (u32, Direction)| {
        let of_pass =
            measurement.readings.iter().filter(|r| (r.run, r.direction) == (run, direction));
        let mut readings: Vec<Reading> = of_pass.copied().collect();
        readings.sort_by(|a, b| a.target.total_cmp(&b.target));
        if direction == Direction::Negative {
            readings.reverse();
        }
        readings
    };
    keys.into_iter().map(pass).collect()
}

fn header(measurement: &Measurement, kind: RenishawKind) -> Vec<String> {
    let meta = &measurement.metadata;
    vec![
        "HEADER::".into(),
        format!("File type  : {}", kind.file_type()),
        format!("Owner      : {}", one_line(meta.owner.as_ref())),
        format!("Version no : {}", one_line(meta.version.as_ref())),
    ]
}

fn target_data(measurement: &Measurement, targets: &[f64]) -> Vec<String> {
    let mut lines = vec![
        "TARGET DATA::".into(),
        "Filetype  : ISO".into(),
        format!("Target-count: {}", targets.len()),
        "Targets :".into(),
    ];
    for row in targets.chunks(TARGETS_PER_LINE) {
        let numbers: Vec<String> = row.iter().map(|t| format!("{t:.6}")).collect();
        lines.push(numbers.join("  "));
    }
    let both = Direction::BOTH.iter().all(|direction| measurement.has(*direction));
    lines.push(if both { "Flags: 0 0 2 0".into() } else { "Flags: 0 1 2 0".into() });
    lines
}

fn user_text(measurement: &Measurement) -> Vec<String> {
    let meta = &measurement.metadata;
    let texts = [
        ("Machine", &meta.machine),
        ("Serial No", &meta.serial),
        ("Date", &meta.date),
        ("By", &meta.by),
        ("Axis", &meta.axis),
        ("Location", &meta.location),
        ("TITLE", &meta.title),
    ];
    let line = |(key, text): (&str, &Option<String>)| format!("{key}:{}", one_line(text.as_ref()));
    std::iter::once("USER-TEXT::".to_owned()).chain(texts.into_iter().map(line)).collect()
}

fn one_line(text: Option<&String>) -> String {
    text.map(|t| t.replace(char::is_control, " ")).unwrap_or_default()
}

fn deviations(passes: &[Vec<Reading>], targets: &[f64], kind: RenishawKind) -> Vec<String> {
    let mut lines: Vec<String> = vec!["DEVIATIONS::".into(), "Run Target Data:".into()];
    for (pass, readings) in passes.iter().enumerate() {
        for reading in readings {
            let number = 1 + targets.partition_point(|t| *t < reading.target);
            let value = reading.deviation / kind.scale();
            let decimals = match kind {
                RenishawKind::Linear | RenishawKind::Straightness => 6,
                RenishawKind::Angular => 9,
            };
            lines.push(format!("{:>4} {number:>5} {value:>16.decimals$}", pass + 1));
        }
    }
    lines
}

fn environment(environment: &Environment) -> Vec<String> {
    let mut lines: Vec<String> = vec!["ENVIRONMENT::".into()];
    let mut add = |key: &str, value: Option<StartEnd>, decimals: usize| {
        let Some(StartEnd { start, end, unit_code }) = value else {
            return;
        };
        let mut line = format!("{key:<11}: {start:.decimals$} {end:.decimals$}");
        if let Some(code) = unit_code {
            // Writing to a String cannot fail.
            let _ = write!(line, " {code}");
        }
        lines.push(line);
    };
    add("Air temp", environment.air_temperature, 6);
    add("Air press", environment.air_pressure, 6);
    add("Air humid", environment.air_humidity, 6);
    let no_sensor = StartEnd { start: NO_SENSOR_DEGC, end: NO_SENSOR_DEGC, unit_code: Some(0) };
    for (key, sensor) in
        ["Mat temp 1", "Mat temp 2", "Mat temp 3"].iter().zip(environment.material_temperature)
    {
        add(key, Some(sensor.unwrap_or(no_sensor)), 6);
    }
    add("Env factor", environment.environment_factor, 8);
    add("Exp coeff", environment.expansion_coefficient, 6);
    lines.extend(
        environment
            .date_time
            .as_ref()
            .map(|t| format!("{:<11}: {}", "Date Time", one_line(Some(t)))),
    );
    lines
}

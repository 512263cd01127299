//! Whether files are of one machine, by the names and serial numbers that they state.

use volcomp_document::{InputError, Value};
use volcomp_metrology::{Measurement, Metadata};
use volcomp_model::Machine;

use crate::calibration_file::Line;

/// Whether two names of machines or serial numbers are of one machine: case and blanks at the ends are no difference.
fn is_same_name(one: &str, other: &str) -> bool {
    one.trim().eq_ignore_ascii_case(other.trim())
}

/// What is said of a file that states the name of another machine than the machine file.
pub(crate) fn other_machine(readings: &Measurement, machine: &Machine) -> Option<String> {
    let known = machine.name.trim();
    let stated = readings.metadata.machine.as_deref()?.trim();
    let is_other = !stated.is_empty() && !known.is_empty() && !is_same_name(stated, known);
    is_other.then(|| {
        format!(
            "it states the machine `{stated}`, and the machine file is of `{known}`: is it the right machine?"
        )
    })
}

/// Notes where measurement files state different machines or serial numbers. Each file by its name.
pub fn different_machines(files: &[(String, &Metadata)]) -> Vec<String> {
    let mut notes = Vec::new();
    for (what, is_serial) in [("machines", false), ("serial numbers", true)] {
        let mut found: Vec<(&str, &str)> = Vec::new();
        for (file, metadata) in files {
            let text = if is_serial {
                &metadata.serial
            } else {
                &metadata.machine
            };
            let text = text.as_deref().unwrap_or_default().trim();
            if !text.is_empty() && !found.iter().any(|(known, _)| is_same_name(known, text)) {
                found.push((text, file));
            }
        }
        if found.len() > 1 {
            let each = found
                .iter()
                .map(|(text, file)| format!("`{text}` ({file})"));
            let each: Vec<String> = each.collect();
            let each = each.join(", ");
            notes.push(format!(
                "the measurement files state different {what}: {each}"
            ));
        }
    }
    notes
}

/// The files of lines with what they say of themselves.
pub(crate) fn files_of(lines: &[Line]) -> Vec<(String, &Metadata)> {
    let file = |line: &Line| line.file.display().to_string();
    let lines = lines.iter();
    lines
        .map(|line| (file(line), &line.readings.metadata))
        .collect()
}

/// Refuses a file that states another serial number than the calibration file. `file` is the value that names the file.
pub(crate) fn refuse_serial(
    file: &Value<'_>,
    readings: &Measurement,
    serial: Option<&str>,
) -> Result<(), InputError> {
    let stated = readings.metadata.serial.as_deref().map(str::trim);
    match (stated.filter(|stated| !stated.is_empty()), serial) {
        (Some(stated), Some(expected)) if !is_same_name(stated, expected) => {
            Err(file.error(format!(
                "the file states the serial number `{stated}`, expected `{expected}`, the `serial` of this calibration file"
            )))
        }
        _ => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::line;

    /// Two programs write one machine in other cases; two machines are two.
    #[test]
    fn names_of_one_machine_are_compared_without_case() {
        let told = |names: [&str; 2]| {
            let mut lines = [line("EXX", |_| 0.0), line("EYY", |_| 0.0)];
            for (line, name) in lines.iter_mut().zip(names) {
                line.readings.metadata.machine = Some(name.to_owned());
                line.readings.metadata.serial = Some(name.to_owned());
            }
            different_machines(&files_of(&lines))
        };
        assert_eq!(told(["VMC-5 ", "vmc-5"]), [""; 0]);
        assert_eq!(told(["VMC-5", "VMC-6"]).len(), 2);
    }
}

//! One test under two names.

use volcomp_metrology::SeenReadings;

use crate::calibration_file::Line;

/// Notes on files with the same readings under two names: no two tests scatter alike.
pub(crate) fn same_readings(lines: &[Line]) -> Vec<String> {
    let mut seen = SeenReadings::default();
    let mut notes = Vec::new();
    for line in lines {
        // One file may be read for two errors.
        let other: Option<&&Line> = seen.before(&line.readings, line);
        if let Some(other) = other.filter(|other| other.file != line.file) {
            notes.push(format!(
                "{} ({}) has the same readings as {} ({}): is it one test under two names? No two tests scatter alike",
                line.file.display(),
                line.setup.error,
                other.file.display(),
                other.setup.error
            ));
        }
    }
    notes
}

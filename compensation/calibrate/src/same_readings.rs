//! One test under two names.

use std::collections::BTreeSet;

use volcomp_metrology::Reading;

use crate::calibration_file::Line;

/// Notes on files with the same readings under two names: no two tests scatter alike.
pub(crate) fn same_readings(lines: &[Line]) -> Vec<String> {
    let mut notes = Vec::new();
    for (place, line) in lines.iter().enumerate() {
        let sized = |line: &Line| -> Vec<_> {
            let readings = line.readings.readings.iter();
            let by_size = |of: &Reading| (of.target, of.run, of.direction, of.deviation.abs());
            readings.map(by_size).collect()
        };
        let own = sized(line);
        // Lines without deviations look alike, and so do few numbers.
        let differing: BTreeSet<u64> = own.iter().map(|of| of.3.to_bits()).collect();
        if differing.len() < 3 {
            continue;
        }
        let same = |other: &&Line| other.file != line.file && sized(other) == own;
        if let Some(other) = lines[..place].iter().find(same) {
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

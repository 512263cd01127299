//! The runs in `examples/thermal` are runs of the simulated machine: every fourth minute, and five of its sensors.

use std::{fmt::Write as _, fs, path::Path};

use crate::heat_network::run;

/// Name of each file, and seed of its run.
const RUNS: [(&str, u64); 4] =
    [("monday.csv", 1), ("tuesday.csv", 2), ("wednesday.csv", 3), ("thursday.csv", 4)];
/// Name of each column, and index of its sensor on the simulated machine.
const SENSORS: [(&str, usize); 5] =
    [("bearing", 0), ("head", 1), ("column", 2), ("bed", 3), ("room", 5)];
const EVERY: usize = 4;

/// Rows of a run: time (s), temperatures (°C), displacement (µm).
fn rows(seed: u64) -> Vec<Vec<f64>> {
    let record = run(seed).record;
    (0..record.len())
        .step_by(EVERY)
        .map(|row| {
            let degc = SENSORS.map(|(_, sensor)| record.degc[sensor][row]);
            let ends = [record.displacement[row]];
            [&[record.time_s[row]], &degc[..], &ends].concat()
        })
        .collect()
}

fn file(seed: u64) -> String {
    let mut text = "time_s".to_owned();
    for (name, _) in SENSORS {
        // Writing to a String cannot fail.
        let _ = write!(text, ",{name}_degc");
    }
    text += ",dz_um\n";
    for row in rows(seed) {
        let cells: Vec<String> = row[1..].iter().map(|cell| format!("{cell:.2}")).collect();
        let _ = writeln!(text, "{},{}", row[0], cells.join(","));
    }
    text
}

/// The shipped files equal the simulated runs. If the environment variable `VOLCOMP_WRITE` is set, the files are first
/// written.
#[test]
fn shipped_runs_are_those_of_the_simulated_machine() {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/thermal");
    for (name, seed) in RUNS {
        let path = folder.join(name);
        if std::env::var_os("VOLCOMP_WRITE").is_some() {
            fs::write(&path, file(seed)).unwrap();
        }
        let text = fs::read_to_string(&path).unwrap();
        let shipped = text.lines().skip(1).map(|line| {
            let cells = line.split(',').map(|cell| cell.parse::<f64>().unwrap());
            cells.collect::<Vec<f64>>()
        });
        let (shipped, expected): (Vec<_>, _) = (shipped.collect(), rows(seed));
        assert_eq!(shipped.len(), expected.len(), "{name}");
        for (shipped, expected) in shipped.iter().zip(&expected) {
            assert_eq!(shipped.len(), expected.len(), "{name}: {shipped:?}");
            let close = |(a, b): (&f64, &f64)| (a - b).abs() < 0.0051;
            assert!(shipped.iter().zip(expected).all(close), "{name}: {shipped:?} {expected:?}");
        }
    }
}

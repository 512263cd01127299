//! Evaluates a positioning test by ISO 230-2: a measurement file, or the readings below.
//!
//! `cargo run -p volcomp-metrology --example iso230_2 [-- FILE.rtl]`

use std::{error::Error, path::Path};

use volcomp_metrology::{evaluate, parse_csv, read_file};

/// Two runs in both directions; targets in mm, deviations in µm.
const READINGS: &[u8] = b"target,run,direction,deviation
0,1,+,1.0
500,1,+,4.0
1000,1,+,9.1
1000,1,-,11.0
500,1,-,6.0
0,1,-,2.0
0,2,+,1.2
500,2,+,4.4
1000,2,+,8.7
1000,2,-,11.4
500,2,-,6.4
0,2,-,2.2
";

fn main() -> Result<(), Box<dyn Error>> {
    let measurement = match std::env::args_os().nth(1) {
        Some(file) => read_file(Path::new(&file))?,
        None => parse_csv(READINGS, "readings.csv")?,
    };
    for note in &measurement.notes {
        println!("note: {note}");
    }
    let result = evaluate(&measurement)?;
    println!("target  mean forward  mean backward  reversal");
    let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.2}"));
    for row in &result.targets {
        println!(
            "{:6} {:>13} {:>14} {:>9}",
            row.target,
            number(row.forward.as_ref().map(|side| side.mean)),
            number(row.backward.as_ref().map(|side| side.mean)),
            number(row.reversal)
        );
    }
    // A quantity without a value could not be evaluated, for example a repeatability from one run.
    for (symbol, value) in [
        ("A, accuracy", result.a),
        ("R, repeatability", result.r),
        ("E, systematic deviation", result.e),
        ("M, mean deviation", result.m),
        ("B, reversal value", result.b),
    ] {
        println!("{symbol:24} {:>8} µm", number(value));
    }
    Ok(())
}

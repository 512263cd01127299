//! Durations for a large positioning test. A table of 10 000 targets and 10 runs (5 in each direction) is read and
//! evaluated by each standard, and a line is fitted to its means. Prints the times of several rounds.

use std::{error::Error, fmt::Write as _, time::Instant};

use volcomp_metrology::{
    Edition, ReferenceLine, asme_b5_54, evaluate, parse_csv, shortfalls, vdi_3441,
};
use volcomp_vocabulary::AxisKind;

const TARGETS: u32 = 10_000;
const RUNS: u32 = 5;
const ROUNDS: u32 = 5;

fn main() -> Result<(), Box<dyn Error>> {
    let mut text = "target mm,run,direction,deviation um\n".to_owned();
    for run in 1..=RUNS {
        for direction in ['+', '-'] {
            for k in 0..TARGETS {
                // A pseudorandom number that is the same in every call.
                let noise = f64::from((k * 7919 + run * 104_729) % 1000) * 1e-3;
                let side = if direction == '+' { 1.0 } else { -1.0 };
                let target = f64::from(k) * 0.8;
                let deviation = 5.0 * (target * 1e-3).sin() + side + noise;
                writeln!(text, "{target:.1},{run},{direction},{deviation:.3}")?;
            }
        }
    }
    println!("{TARGETS} targets, {} runs, {} bytes", 2 * RUNS, text.len());
    for round in 1..=ROUNDS {
        let start = Instant::now();
        let measurement = parse_csv(text.as_bytes(), "large.csv")?;
        let read = start.elapsed();
        let start = Instant::now();
        let result = evaluate(&measurement)?;
        let evaluated = start.elapsed();
        let start = Instant::now();
        let vdi = vdi_3441(&result).ok_or("both directions were run")?;
        let others = asme_b5_54(&result).len() + Edition::Iso2014.quantities(&result).len();
        let said = shortfalls(&measurement, AxisKind::Linear, Edition::Iso2014);
        let line = ReferenceLine::least_squares(&measurement.mean_curve())?;
        let rest = start.elapsed();
        println!(
            "round {round}: read {:.0} ms, ISO 230-2 {:.0} ms, the others and a line {:.0} ms; E {:.3} µm, P {:.3} µm, {others} values, {} notes, {:.4} µrad",
            read.as_secs_f64() * 1e3,
            evaluated.as_secs_f64() * 1e3,
            rest.as_secs_f64() * 1e3,
            result.e.unwrap_or_default(),
            vdi.p,
            said.len(),
            line.slope().0
        );
    }
    Ok(())
}

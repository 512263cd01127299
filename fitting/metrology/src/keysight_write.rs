//! Writes a text report as 5529 and 5530 lasers do.

use std::fmt::Write as _;

use crate::text_report::head_of;
use crate::{DeviationUnit, Direction, Measurement};

/// Decimals of targets, and of means and scatter in µm or µrad.
const DECIMALS: usize = 4;

/// Writes a text report in the order of the one published report of a 5529 laser: number, target, mean forward, reverse and of
/// both, twice the standard deviation forward and reverse, dead zone (reverse minus forward); CRLF, four decimals, the unit in
/// brackets in the heads.
///
/// The report has no place for single runs. Targets that were not approached from both sides have no dead zone, and are left
/// out; where that is all, [`parse_keysight_report`](crate::parse_keysight_report) refuses the text. The standard deviation of a
/// single run is written as 0.
pub fn write_keysight_report(measurement: &Measurement) -> String {
    let unit = match measurement.unit {
        Some(DeviationUnit::Urad) => "urad",
        _ => "microns",
    };
    let mut text = head_of(&measurement.metadata);
    // Writing to a String cannot fail.
    let _ = write!(
        text,
        "Error = Laser Reading (Reference) - Machine Reading (Command)\r\n\
         No.  Position   Forward mean   Reverse mean   System mean   2 sigma forward   2 sigma reverse   Dead zone ({unit})\r\n"
    );
    let readings = measurement.by_target();
    let both = readings.iter().filter_map(|at| {
        let [forward, reverse] = Direction::BOTH.map(|direction| at.deviations(direction));
        Some((at.target, scatter(&forward)?, scatter(&reverse)?))
    });
    for (index, (target, [forward, forward_2s], [reverse, reverse_2s])) in both.enumerate() {
        let system = f64::midpoint(forward, reverse);
        let _ = write!(text, "{:>3} {target:>12.DECIMALS$}", index + 1);
        for value in [
            forward,
            reverse,
            system,
            forward_2s,
            reverse_2s,
            reverse - forward,
        ] {
            let _ = write!(text, " {value:>14.DECIMALS$}");
        }
        text.push_str("\r\n");
    }
    text
}

/// The mean and twice the standard deviation, `None` without readings.
fn scatter(deviations: &[f64]) -> Option<[f64; 2]> {
    let mean = crate::measurement::mean(deviations)?;
    let squares: f64 = deviations.iter().map(|value| (value - mean).powi(2)).sum();
    let freedom = deviations.len().saturating_sub(1).max(1);
    Some([mean, 2.0 * (squares / freedom as f64).sqrt()])
}

//! Writes the position file of an API laser, `.pos`.

use std::fmt::Write as _;

use crate::text_report::head_of;
use crate::{Direction, Measurement};

const MM_PER_UM: f64 = 1e-3;

/// Writes the position file of an API laser (`.pos`): tables of targets and mean errors in mm, CRLF, seven decimals.
///
/// The file has no place for single runs: the means over the runs of a direction are written, and where both directions were
/// run their mean in front. Deviations are taken to be µm, as the format holds lengths alone.
pub fn write_pos(measurement: &Measurement) -> String {
    let [forward, backward] = Direction::BOTH.map(|direction| measurement.mean_curve_in(direction));
    let mut text = head_of(&measurement.metadata);
    let mut table = |name: &str, rows: &[(f64, f64)]| {
        // Writing to a String cannot fail.
        let _ = write!(text, "Position   \t{name} Avg Error\r\n");
        for (target, mean_um) in rows {
            let _ = write!(text, "{target:.4}\t{:.7}\r\n", mean_um * MM_PER_UM);
        }
    };
    if !forward.is_empty() && !backward.is_empty() {
        table("Bidirectional", &measurement.mean_curve());
    }
    for (name, rows) in [
        ("Forward Directional", &forward),
        ("Backward Directional", &backward),
    ] {
        if !rows.is_empty() {
            table(name, rows);
        }
    }
    text
}

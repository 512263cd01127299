//! What the rows of a file do not show: temperatures between them where they are far apart, and in gaps of the log.

use std::path::{Path, PathBuf};

use volcomp_fit::{ThermalGap, ThermalRecord, ThermalRun};

use super::{Channel, columns::Columns, verdict::NO_DIFFERENCE};
use crate::commands::fixed;

/// A note on the gaps of a file, for terms with some of these time constants, s.
pub(super) fn gaps(path: &Path, columns: &Columns, lags_s: &[f64]) -> Option<String> {
    let record = ThermalRecord {
        time_s: columns.time_s.clone(),
        ..ThermalRecord::default()
    };
    let gaps = record.gaps(lags_s);
    let length = |gap: &&ThermalGap| gap.to_s - gap.from_s;
    let longest = gaps.iter().max_by(|a, b| length(a).total_cmp(&length(b)))?;
    let rows = 0..record.len();
    let left_out = rows.filter(|row| gaps.iter().any(|gap| gap.left_out.contains(row)));
    let count = match gaps.len() {
        1 => "a gap in the log".to_owned(),
        many => format!("{many} gaps in the log, the longest"),
    };
    Some(format!(
        "{}: {count} from {} to {} s, where rows are usually {} s apart: what the temperatures did there is not known. The {} rows behind {} that the time constants (up to {} s) still let depend on it are left out",
        path.display(),
        longest.from_s,
        longest.to_s,
        fixed(record.usual_interval_s(), 0),
        left_out.count(),
        if gaps.len() == 1 { "it" } else { "them" },
        lags_s.iter().copied().fold(0.0, f64::max),
    ))
}

/// A note where the rows are so far apart that what the temperatures may have done between them can be seen in the error of the
/// prediction: where it makes that larger by a tenth.
pub(super) fn too_coarse(
    channel: &Channel,
    runs: &[ThermalRun],
    files: &[PathBuf],
) -> Option<String> {
    let lags = channel.terms.lags_s();
    let shortest_s = lags.into_iter().find(|lag| *lag > 0.0)?;
    let of = |run: &ThermalRun| channel.terms.rms_between_rows(run);
    let squares: f64 = runs.iter().map(|run| of(run).powi(2)).sum();
    let between = (squares / runs.len() as f64).sqrt();
    // The root mean square error of the rows alone.
    let rows = (channel.few.rms.powi(2) - between.powi(2)).max(0.0).sqrt();
    let unseen = ((1.0 + NO_DIFFERENCE).powi(2) - 1.0).sqrt() * rows;
    if between <= unseen {
        return None;
    }
    let (file, run) = files
        .iter()
        .zip(runs)
        .max_by(|a, b| of(a.1).total_cmp(&of(b.1)))?;
    let usual_s = run.record.usual_interval_s();
    // What a temperature is off a straight line grows with the square of the interval.
    let enough_s = rounded_down(usual_s * (unseen / between).sqrt());
    let unit = if channel.is_angular() { "µrad" } else { "µm" };
    Some(format!(
        "{}: the rows of {} are {} s apart, and the shortest time constant of the terms is {shortest_s} s: by how the temperatures bend from row to row, what they did between the rows adds about {} {unit} to what the terms miss on a machine that reads them in every cycle. It is counted in the error and in the uncertainties. Record the temperatures every {enough_s} s or more often, or choose from longer time constants (--lags)",
        channel.name,
        file.display(),
        fixed(usual_s, 0),
        fixed(between, 2),
    ))
}

/// The next lower of 1, 2 and 5 and their tens, hundreds and so on, s: at least 1.
fn rounded_down(seconds: f64) -> f64 {
    let ten = 10_f64.powf(seconds.max(1.0).log10().floor());
    let steps = [5.0, 2.0].into_iter().map(|step| step * ten);
    steps
        .into_iter()
        .find(|step| *step <= seconds)
        .unwrap_or(ten)
}

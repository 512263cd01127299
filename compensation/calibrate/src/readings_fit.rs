//! Fits a curve to the readings of one measurement; the kind of curve is chosen from the runs.

use volcomp_fit::{
    Band, BandOptions, Choice, Fit, FitError, FitOptions, Noise, band, band_of_means, band_places,
    choose,
};
use volcomp_metrology::{Measurement, Reading, RunAlignment, axis_kind};
use volcomp_vocabulary::{AxisKind, Direction};

use crate::repeated::mean_scatter;

/// A curve through the mean readings of a measurement, of an automatically chosen kind.
#[derive(Clone, Debug, PartialEq)]
pub struct ReadingsFit {
    /// The curve with its residuals at the mean readings.
    pub fit: Fit,
    /// The chosen kind and the scores of all kinds.
    pub choice: Choice,
    /// Pointwise 95 % confidence band; `None` if unknown.
    pub band: Option<Band>,
}

type Run = (Vec<f64>, Vec<f64>);

/// Chooses a curve from all runs of a measurement, by the same rule as a calibration, and fits it to the mean reading of each target.
/// `required` is the largest admissible residual, in the unit of the readings.
///
/// # Errors
/// Same as [`choose`].
pub fn fit_readings(
    measurement: &Measurement,
    required: Option<f64>,
) -> Result<ReadingsFit, FitError> {
    let (x, u): Run = measurement.mean_curve().into_iter().unzip();
    let incomplete = measurement.incomplete_runs();
    let mut runs = match incomplete {
        Some(_) => Vec::new(),
        None => whole_runs(measurement),
    };
    if runs.is_empty() {
        runs.push((x.clone(), u.clone()));
    }
    let options = FitOptions {
        required_residual: required,
        period: period(measurement),
        noise: incomplete.as_ref().and(noise_of_mean(measurement)),
    };
    let all = |of: fn(&Run) -> &Vec<f64>| -> Vec<f64> {
        runs.iter().flat_map(|run| of(run).iter().copied()).collect()
    };
    let (all_x, all_u) = (all(|run| &run.0), all(|run| &run.1));
    let choice = choose(&[(&all_x, &all_u)], &options)?;
    let mut fit = choice.method.fit(&x, &u)?;
    fit.meets_required = required.map(|residual| fit.max_abs() <= residual);
    let runs: Vec<(&[f64], &[f64])> = runs.iter().map(|(x, u)| (&x[..], &u[..])).collect();
    // There is no band if the method cannot be fitted to some of the runs.
    let places = band_places(&x);
    let options = BandOptions::default();
    let scatter = incomplete.and_then(|of| mean_scatter(&of, None, &options));
    let found = match scatter {
        Some(scatter) => band_of_means(choice.method, [&x, &u], &scatter, &places),
        None => band(choice.method, &runs, &places, &options),
    };
    let found = found.ok();
    let band = found.filter(|band| band.half_width.iter().all(|half| half.is_finite()));
    Ok(ReadingsFit { fit, choice, band })
}

/// The period of the targets, deg, for a rotary axis measured over a full turn. A calibration uses
/// the travel of the axis instead, which a file of readings does not state.
fn period(measurement: &Measurement) -> Option<f64> {
    if axis_kind(measurement) != Some(AxisKind::Rotary) {
        return None;
    }
    let targets = measurement.targets();
    let range = targets.last()? - targets.first()?;
    // For a full turn, the gap from the last target to the first target of the next turn must equal the other gaps.
    let gap = range / targets.len().checked_sub(1).filter(|gaps| *gaps > 0)? as f64;
    (range + gap >= FULL_TURN_DEG * (1.0 - 1e-9)).then_some(FULL_TURN_DEG)
}

const FULL_TURN_DEG: f64 = 360.0;

/// Averages both directions of each run at the targets that the run has in all directions, because differences between
/// directions are not scatter.
fn whole_runs(measurement: &Measurement) -> Vec<Run> {
    let ways = Direction::BOTH.into_iter().filter(|way| measurement.has(*way)).count();
    let mut readings: Vec<_> = measurement.readings.iter().collect();
    readings.sort_by(|a, b| (a.run.cmp(&b.run)).then(a.target.total_cmp(&b.target)));
    let by_run = readings.chunk_by(|a, b| a.run == b.run);
    let run = |readings: &[&Reading]| -> Run {
        let at_target = readings.chunk_by(|a, b| a.target == b.target);
        let mean = |at: &[&Reading]| {
            let mut directions: Vec<_> = at.iter().map(|reading| reading.direction).collect();
            directions.sort_unstable_by_key(|direction| *direction as usize);
            directions.dedup();
            let target = at.first()?.target;
            let sum: f64 = at.iter().map(|reading| reading.deviation).sum();
            (directions.len() == ways).then(|| (target, sum / at.len() as f64))
        };
        at_target.filter_map(mean).unzip()
    };
    by_run.map(run).filter(|(targets, _)| !targets.is_empty()).collect()
}

/// Scatter of the mean reading of a target, averaged over its directions, about the curve; `None` if no target was read twice.
pub fn noise_of_mean(measurement: &Measurement) -> Option<Noise> {
    let scatter = measurement.scatter_of_mean(RunAlignment::Line)?;
    let ways = Direction::BOTH.into_iter().filter(|way| measurement.has(*way));
    Some(Noise {
        deviation: scatter.deviation / (ways.count() as f64).sqrt(),
        freedom: scatter.freedom,
    })
}

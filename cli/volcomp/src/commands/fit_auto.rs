//! `volcomp fit --method auto`: the kind of curve that the readings themselves ask for, and its band.

use volcomp_fit::{
    BandOptions, BandSource, Choice, Fit, FitError, FitOptions, Noise, Score, band, band_places,
    choose,
};
use volcomp_metrology::{DeviationUnit, Measurement, axis_kind};
use volcomp_vocabulary::AxisKind;

use super::{fixed, table, table_text};
use crate::{
    answers::fit::{Band, BandPoint, Candidate, Choice as Document},
    table::to_the_left,
};

/// Targets and readings of a run.
type Run = (Vec<f64>, Vec<f64>);

/// A curve chosen, how it was chosen, and how far the true one may be from it.
pub(super) struct Auto {
    pub(super) fit: Fit,
    pub(super) choice: Choice,
    pub(super) band: Option<Band>,
}

/// Chooses by all runs, by the rule of `calibrate`; fits the means of the targets, `x` and `u`.
pub(super) fn auto(
    measurement: &Measurement,
    x: &[f64],
    u: &[f64],
    required: Option<f64>,
    unit: DeviationUnit,
) -> Result<Auto, FitError> {
    let mut runs = whole_runs(measurement);
    if runs.is_empty() {
        runs.push((x.to_vec(), u.to_vec()));
    }
    let options = FitOptions {
        required_residual: required,
        period: period(measurement),
        ..FitOptions::default()
    };
    let all = |of: fn(&Run) -> &Vec<f64>| -> Vec<f64> {
        runs.iter()
            .flat_map(|run| of(run).iter().copied())
            .collect()
    };
    let (all_x, all_u) = (all(|run| &run.0), all(|run| &run.1));
    let choice = choose(&[(&all_x, &all_u)], &options)?;
    let mut fit = choice.method.fit(x, u)?;
    fit.meets_required = required.map(|residual| fit.max_abs() <= residual);
    let runs: Vec<(&[f64], &[f64])> = runs.iter().map(|(x, u)| (&x[..], &u[..])).collect();
    // A method that the readings of some runs do not carry has no band.
    let places = band_places(x);
    let found = band(choice.method, &runs, &places, &BandOptions::default()).ok();
    let found = found.filter(|band| band.half_width.iter().all(|half| half.is_finite()));
    let is_angular = unit == DeviationUnit::Urad;
    let band = found.map(|band| Band {
        from: match band.source {
            BandSource::Runs => "runs",
            BandSource::Residuals => "residuals",
        },
        half_widths: (band.at.iter().zip(&band.half_width))
            .map(|(&at, &half)| BandPoint {
                at,
                half_width_um: (!is_angular).then_some(half),
                half_width_urad: is_angular.then_some(half),
            })
            .collect(),
    });
    Ok(Auto { fit, choice, band })
}

/// The period of the targets, deg: that of a rotary axis which was read all the way round. `calibrate` goes by the travel of the axis, which
/// a file of readings does not state.
fn period(measurement: &Measurement) -> Option<f64> {
    if axis_kind(measurement) != Some(AxisKind::Rotary) {
        return None;
    }
    let targets = measurement.targets();
    let range = targets.last()? - targets.first()?;
    // The step from the last target to the first of the next turn is one as between the others.
    let gap = range / targets.len().checked_sub(1).filter(|gaps| *gaps > 0)? as f64;
    (range + gap >= FULL_TURN_DEG * (1.0 - 1e-9)).then_some(FULL_TURN_DEG)
}

const FULL_TURN_DEG: f64 = 360.0;

/// Each run with the mean of its directions at each target that it read in all of them: what differs between directions is no
/// scatter.
fn whole_runs(measurement: &Measurement) -> Vec<Run> {
    let ways = volcomp_vocabulary::Direction::BOTH
        .into_iter()
        .filter(|way| measurement.has(*way))
        .count();
    let mut readings: Vec<_> = measurement.readings.iter().collect();
    readings.sort_by(|a, b| (a.run.cmp(&b.run)).then(a.target.total_cmp(&b.target)));
    let by_run = readings.chunk_by(|a, b| a.run == b.run);
    let run = |readings: &[&volcomp_metrology::Reading]| -> Run {
        let at_target = readings.chunk_by(|a, b| a.target == b.target);
        let mean = |at: &[&volcomp_metrology::Reading]| {
            let mut directions: Vec<_> = at.iter().map(|reading| reading.direction).collect();
            directions.sort_unstable_by_key(|direction| *direction as usize);
            directions.dedup();
            let target = at.first()?.target;
            let sum: f64 = at.iter().map(|reading| reading.deviation).sum();
            (directions.len() == ways).then(|| (target, sum / at.len() as f64))
        };
        at_target.filter_map(mean).unzip()
    };
    by_run
        .map(run)
        .filter(|(targets, _)| !targets.is_empty())
        .collect()
}

/// What the mean reading of a target scatters, from run to run; `None` of one run.
pub(super) fn noise_of_mean(measurement: &Measurement) -> Option<Noise> {
    let runs = whole_runs(measurement);
    let (x, u): (Vec<Vec<f64>>, Vec<Vec<f64>>) = runs.iter().cloned().unzip();
    Noise::of(&x.concat(), &u.concat()).map(|noise| noise.of_mean(runs.len()))
}

/// The choice as the document has it.
pub(super) fn document(choice: &Choice, unit: DeviationUnit) -> Document {
    let is_angular = unit == DeviationUnit::Urad;
    let candidate = |score: &Score| {
        let error = Some(score.leave_one_out_rms).filter(|error| error.is_finite());
        let residual = Some(score.largest_residual);
        Candidate {
            method: score.method.to_string(),
            kind: score.method.kind(),
            coefficients: score.coefficients,
            leave_one_out_um: error.filter(|_| !is_angular),
            leave_one_out_urad: error.filter(|_| is_angular),
            largest_residual_um: residual.filter(|_| !is_angular),
            largest_residual_urad: residual.filter(|_| is_angular),
            meets_required: score.meets_required,
            follows: score.follows,
            swings: score.swings,
            chosen: score.method == choice.method,
        }
    };
    Document {
        method: choice.method.to_string(),
        reason: choice.reason.to_string(),
        follows: choice.chosen().is_none_or(|score| score.follows),
        candidates: choice.scores.iter().map(candidate).collect(),
    }
}

/// The choice, the best candidate of each kind and the band as people read them.
pub(super) fn text(choice: &Choice, band: Option<&Band>, unit: DeviationUnit) -> String {
    let symbol = unit.to_string();
    let mut text = format!("\nchosen: {} ({})\n", choice.method, choice.reason);
    if let Some(band) = band {
        let halves = || band.half_widths.iter().filter_map(BandPoint::half_width);
        let from = if band.from == "runs" {
            "from the scatter of the runs"
        } else {
            "from the residuals of one run, in which nothing shows that changes from run to run"
        };
        text += &crate::table::folded(
            &format!(
                "95 % band: ±{} to ±{} {symbol} at and between the targets, {from}",
                fixed(halves().fold(f64::INFINITY, f64::min), 3),
                fixed(halves().fold(0.0, f64::max), 3),
            ),
            "",
        );
    }
    let error = format!("LOO error, {symbol}");
    let residual = "largest residual";
    let mut rows = table(&["best of each kind", "coefficients", &error, residual, ""]);
    to_the_left(&mut rows, &[4]);
    let mut best = choice.best_of_kinds();
    if let Some(chosen) = choice.chosen() {
        // The one chosen stands for its kind, also where a more complicated one of it is a little better.
        for score in &mut best {
            if score.method.kind() == chosen.method.kind() {
                *score = *chosen;
            }
        }
    }
    for score in best {
        let mut said = Vec::new();
        if score.method == choice.method {
            said.push("chosen");
        }
        if score.swings {
            said.push("swings between targets");
        }
        if !score.follows {
            said.push("does not follow the readings");
        }
        rows.add_row([
            score.method.to_string(),
            fixed(score.coefficients, 1),
            if score.leave_one_out_rms.is_finite() {
                fixed(score.leave_one_out_rms, 3)
            } else {
                "-".to_owned()
            },
            fixed(score.largest_residual, 3),
            said.join(", "),
        ]);
    }
    text + "\n" + &table_text(&rows)
}

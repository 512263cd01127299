//! Fits the lines of one error to one curve, or to one curve for each direction, and evaluates the fit.
//!
//! `fit_readings` fits the readings of a single measurement.

use volcomp_curve::{ErrorCurve, Field};
use volcomp_fit::{
    Band, BandOptions, Between, Choice, Fit, FitError, FitOptions, Method, Noise, band,
    band_of_means, band_places, choose,
};
use volcomp_kinematics::Joint;
use volcomp_kinematics::nalgebra::Vector3;
use volcomp_metrology::{Measurement, MotionKind, Reading, ReferenceLine, RunAlignment, axis_kind};
use volcomp_model::{Axis, Machine, ModelError, Source};
use volcomp_vocabulary::{AxisKind, Component, Direction, ErrorName, Um, Urad};

use crate::calibration_file::{CalibrationFile, lines_of};
use crate::curve_choice::CurveChoice;
use crate::error::CalibrateError;
use crate::profile::{Points, Profile, Repeated, files_of, mean_scatter};

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

pub(crate) type Run = (Vec<f64>, Vec<f64>);

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

/// Lines are aligned when no line moves by more than this in a round, µm or µrad.
const LINES_AGREE_UM: f64 = 1e-6;
/// Maximum number of alignment rounds; each at least halves the differences if lines share their targets.
const ROUNDS: usize = 40;

/// Maximum deviation of a mean reading from the curve in standard deviations; one reading in 370 exceeds it by chance.
const WITHIN_SIGMAS: f64 = 3.0;
const STEPS: usize = 120;

/// Scatter of a mean reading about a curve: the largest of all lines; `None` if the scatter of every line is unknown.
/// Offsets and slopes of the runs are removed first: they shift and rotate the curve, but do not affect its residuals.
fn noise_about_curve(profiles: &[Profile<'_>]) -> Option<Noise> {
    let noise = profiles.iter().filter_map(|profile| profile.scatter_of_mean(RunAlignment::Line));
    noise.reduce(|a, b| if b.deviation > a.deviation { b } else { a })
}

/// Fits of an error: one for both directions, or one for each direction, forward first.
#[derive(Clone)]
pub(crate) struct Branches {
    fits: Vec<(Direction, Fit)>,
    points: Vec<Points>,
    targets: Vec<f64>,
    method: Method,
    choice: Option<Choice>,
    noise: Option<Noise>,
    /// Repeated readings for each fit, from which its band is resampled; empty until the lines are
    /// aligned.
    repeated: Vec<Option<Repeated>>,
    /// Product of the factors of all calls of `scaled`.
    factor: f64,
}

impl Branches {
    /// Fits all lines of an error, each direction separately. Also returns the aligned lines.
    ///
    /// An instrument is zeroed for every line, and a straightness reference is aligned for every line. Constants
    /// between lines (for straightness also slopes) therefore carry no information: lines are moved onto the first one
    /// by their mean difference from the common curve.
    pub(crate) fn fit(
        error: ErrorName,
        choice: CurveChoice,
        period: Option<f64>,
        mut profiles: Vec<Profile<'_>>,
    ) -> Result<(Self, Vec<Profile<'_>>), CalibrateError> {
        let mut branches = Self::fit_once(error, choice, period, &profiles)?;
        for _ in 1..ROUNDS {
            // A single line needs no alignment.
            let Some((first, others)) = profiles.split_first().filter(|(_, o)| !o.is_empty())
            else {
                break;
            };
            let stays = branches.offset_of(first)?;
            let mut largest = 0.0_f64;
            let mut moved = vec![first.clone()];
            for profile in others {
                let line = branches.offset_of(profile)?;
                let line = ReferenceLine {
                    slope_um_per_mm: line.slope_um_per_mm - stays.slope_um_per_mm,
                    intercept_um: line.intercept_um - stays.intercept_um,
                };
                let by = profile.all().map(|(target, _)| line.value_um(*target).abs());
                largest = by.fold(largest, f64::max);
                moved.push(profile.clone().without_line(&line));
            }
            profiles = moved;
            if largest < LINES_AGREE_UM {
                break;
            }
            branches = Self::fit_once(error, choice, period, &profiles)?;
        }
        branches.repeated = branches.repeated_of(&profiles);
        Ok((branches, profiles))
    }

    fn fit_once(
        error: ErrorName,
        choice: CurveChoice,
        period: Option<f64>,
        profiles: &[Profile<'_>],
    ) -> Result<Self, CalibrateError> {
        let files = || files_of(profiles);
        let mut fits = Vec::new();
        let mut points = Vec::new();
        let failed = |source: FitError| CalibrateError::Fit { error, files: files(), source };
        let readings = |index: usize| {
            let points = profiles.iter().flat_map(|profile| &profile.points[index]);
            points.copied().unzip()
        };
        let both: [(Vec<f64>, Vec<f64>); 2] = [readings(0), readings(1)];
        let read = both.iter().filter(|(x, _)| !x.is_empty());
        let read: Vec<(&[f64], &[f64])> = read.map(|(x, u)| (&x[..], &u[..])).collect();
        let noise = noise_about_curve(profiles);
        // Maximum deviation of a curve from the mean readings, µm or µrad.
        let required = noise.map(|noise| WITHIN_SIGMAS * noise.deviation);
        if read.is_empty() {
            let files = files();
            return Err(CalibrateError::NoReadings { error, files });
        }
        let options = FitOptions { noise, period, ..FitOptions::default() };
        let settled = choice.settled(&read, required, &options);
        let (method, chosen) = settled.map_err(failed)?;
        let (choice, made) = chosen.unzip();
        let mut made = made.into_iter().flatten();
        for (direction, (x, u)) in Direction::BOTH.into_iter().zip(both) {
            if x.is_empty() {
                continue;
            }
            let fit = match made.next() {
                Some(fit) => fit,
                None => method.fit(&x, &u).map_err(failed)?,
            };
            tracing::debug!(
                "{error} {}: residual of {} is {:.3} rms, leave-one-out error {:.3}",
                direction.name(),
                fit.curve.kind(),
                fit.rms(),
                fit.leave_one_out_rms
            );
            fits.push((direction, fit));
            points.push(x.into_iter().zip(u).collect());
        }
        let all = profiles.iter().flat_map(Profile::all);
        let mut targets: Vec<f64> = all.map(|point| point.0).collect();
        targets.sort_by(f64::total_cmp);
        targets.dedup();
        Ok(Self { fits, points, targets, method, choice, noise, repeated: Vec::new(), factor: 1.0 })
    }

    /// Repeated readings for each fit: the runs of a single line ([`Profile::repeated_in`], which may return `None`), or the means of several lines.
    /// Lines from which a tilt was found are a single run: their differences went into the tilt, and no longer show their scatter. `None` if a line is
    /// the sum of the tilts of a bridge, whose errors add up along it.
    fn repeated_of(&self, profiles: &[Profile<'_>]) -> Vec<Option<Repeated>> {
        let of = |(direction, _): &(Direction, Fit)| {
            if let [profile] = profiles {
                return profile.repeated_in(*direction);
            }
            if profiles.iter().any(Profile::is_summed) {
                return None;
            }
            if let Some(run) = profiles.iter().find_map(|profile| profile.as_one_run.as_ref()) {
                let points = run[*direction as usize].iter().copied();
                return Some(Repeated::Runs(vec![points.unzip()]));
            }
            let points = profiles.iter().map(|p| &p.points[*direction as usize]);
            let read = points.filter(|points| !points.is_empty());
            let lines = read.map(|points| points.iter().copied().unzip());
            Some(Repeated::Runs(lines.collect()))
        };
        self.fits.iter().map(of).collect()
    }

    /// Mean difference of the readings of a measured line from the fitted curve: a straight line for straightness errors, a constant for all others.
    fn offset_of(&self, profile: &Profile<'_>) -> Result<ReferenceLine, CalibrateError> {
        let residuals: Points = self
            .fits
            .iter()
            .flat_map(|(direction, fit)| {
                let points = profile.points[*direction as usize].iter();
                points.map(|(target, value)| (*target, value - fit.curve.value(*target)))
            })
            .collect();
        if MotionKind::of(profile.line.setup.error) == MotionKind::Straightness {
            return profile.line_through(residuals);
        }
        let sum: f64 = residuals.iter().map(|(_, residual)| residual).sum();
        Ok(ReferenceLine {
            slope_um_per_mm: 0.0,
            intercept_um: sum / residuals.len().max(1) as f64,
        })
    }

    pub(crate) fn mean_at(&self, coordinate: f64) -> f64 {
        let values = self.fits.iter().map(|(_, fit)| fit.curve.value(coordinate));
        values.sum::<f64>() / self.fits.len() as f64
    }

    /// Scales the curves to (curve − `zero`) × `factor`, and the residuals by the factor.
    fn scaled(&self, factor: f64, zero: f64) -> Self {
        let mut scaled = self.clone();
        for (_, fit) in &mut scaled.fits {
            fit.curve = fit.curve.clone().offset(-zero).scaled(factor);
            for residual in &mut fit.residuals {
                *residual *= factor;
            }
            fit.leave_one_out_rms *= factor.abs();
            fit.inner_rms *= factor.abs();
        }
        scaled.factor *= factor;
        if let Some(noise) = &mut scaled.noise {
            noise.deviation *= factor.abs();
        }
        if let Some(choice) = &mut scaled.choice {
            for score in &mut choice.scores {
                score.leave_one_out_rms *= factor.abs();
                score.largest_residual *= factor.abs();
            }
        }
        for (_, reading) in scaled.points.iter_mut().flatten() {
            *reading = (*reading - zero) * factor;
        }
        scaled
    }

    pub(crate) fn fitted(&self, error: ErrorName) -> Vec<FittedCurve> {
        let reversal = self.reversal();
        let both = self.fits.len() == 2;
        let repeated = self.repeated.iter().cloned();
        let repeated = repeated.chain(std::iter::repeat(None));
        let each = self.fits.iter().zip(&self.points).zip(repeated);
        let row = |(((direction, fit), points), repeated): ((&(Direction, Fit), &Points), _)| {
            FittedCurve {
                error,
                direction: both.then_some(*direction),
                kind: fit.curve.kind(),
                readings: fit.residuals.len(),
                quality: if error.component.is_angular() {
                    Quality::Angle(quality(fit, reversal, Urad))
                } else {
                    Quality::Length(quality(fit, reversal, Um))
                },
                method: self.method,
                choice: self.choice.clone(),
                between: {
                    let (x, u): (Vec<f64>, Vec<f64>) = points.iter().copied().unzip();
                    Between::of(fit, &x, &u, self.noise)
                },
                resampled: Option::<Repeated>::map(repeated, |repeated| Resampled {
                    repeated,
                    targets: self.targets.clone(),
                    factor: self.factor,
                }),
                points: (points.iter().zip(&fit.residuals))
                    .map(|((x, u), residual)| [*x, *u, u - residual])
                    .collect(),
                sampled: sampled(fit, points),
            }
        };
        each.map(row).collect()
    }

    fn reversal(&self) -> Option<f64> {
        let [forward, backward] = &self.values_at_targets()[..] else {
            return None;
        };
        let differences = forward.iter().zip(backward).map(|(f, b)| f - b);
        differences.max_by(|a, b| a.abs().total_cmp(&b.abs()))
    }

    /// Values of each curve at the targets. At targets with readings, the values are computed from the residuals,
    /// because moving least squares are slow to evaluate again.
    fn values_at_targets(&self) -> Vec<Vec<f64>> {
        let of = |((_, fit), points): (&(Direction, Fit), &Points)| {
            let read = points.iter().zip(&fit.residuals);
            let mut known: Points = read.map(|((x, u), left)| (*x, u - left)).collect();
            known.sort_by(|a, b| a.0.total_cmp(&b.0));
            let at = |&target: &f64| {
                let place = known.binary_search_by(|(x, _)| x.total_cmp(&target)).ok();
                let value = place.and_then(|place| known.get(place));
                value.map_or_else(|| fit.curve.value(target), |(_, value)| *value)
            };
            self.targets.iter().map(at).collect()
        };
        self.fits.iter().zip(&self.points).map(of).collect()
    }

    /// A pair of curves if the error was fitted in both directions, else a single curve.
    fn into_curve(self) -> ErrorCurve {
        let mut fields = self.fits.into_iter().map(|(_, fit)| Field::Curve(fit.curve));
        match (fields.next(), fields.next()) {
            (Some(forward), Some(backward)) => ErrorCurve::Pair { forward, backward },
            (Some(single), None) => ErrorCurve::Single(single),
            // `fit_once` returns at least one fit.
            (None, _) => ErrorCurve::Single(Field::Curve(volcomp_curve::Curve::Constant(0.0))),
        }
    }
}

fn sampled(fit: &Fit, points: &Points) -> Vec<[f64; 2]> {
    let all = || points.iter().map(|(x, _)| *x);
    let (first, last) =
        (all().fold(f64::INFINITY, f64::min), all().fold(f64::NEG_INFINITY, f64::max));
    if first >= last {
        return all().take(1).map(|x| [x, fit.curve.value(x)]).collect();
    }
    (0..=STEPS)
        .map(|step| first + (last - first) * step as f64 / STEPS as f64)
        .map(|x| [x, fit.curve.value(x)])
        .collect()
}

fn quality<U>(fit: &Fit, reversal: Option<f64>, unit: fn(f64) -> U) -> FitQuality<U> {
    FitQuality {
        residual_min: unit(fit.min()),
        residual_max: unit(fit.max()),
        residual_rms: unit(fit.rms()),
        leave_one_out: (fit.leave_one_out_rms.is_finite()).then(|| unit(fit.leave_one_out_rms)),
        reversal: reversal.map(unit),
    }
}

/// The fitted curve of an error, for one direction of travel or for both.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct FittedCurve {
    /// The error that the curve describes.
    pub error: ErrorName,
    /// Direction of travel; `None` if one curve holds for both.
    pub direction: Option<Direction>,
    /// Kind of curve, as named in the machine file.
    pub kind: &'static str,
    /// Number of mean readings: targets times lines.
    pub readings: usize,
    /// Deviation of the readings from the curve.
    pub quality: Quality,
    /// Method by which the curve was fitted.
    pub method: Method,
    /// Candidate methods with their scores (both directions together), in the unit of the error; `None` if the
    /// calibration file sets the method.
    pub choice: Option<Choice>,
    /// Mean readings to which the curve was fitted, after subtracting effects that are not part of
    /// the error (Abbe error, the line of a straightness, the offset of each line): coordinate in
    /// mm or deg, reading and curve value there in the unit of the error.
    pub points: Vec<[f64; 3]>,
    /// Equidistant samples of the curve from its first to its last reading: coordinate and value.
    pub sampled: Vec<[f64; 2]>,
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(crate) between: Between,
    #[cfg_attr(feature = "serde", serde(skip))]
    pub(crate) resampled: Option<Resampled>,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Resampled {
    pub(crate) repeated: Repeated,
    pub(crate) targets: Vec<f64>,
    /// Factor by which the readings were multiplied for this curve.
    pub(crate) factor: f64,
}

impl FittedCurve {
    /// Whether the curve follows its readings to within their repeatability.
    pub fn follows(&self) -> bool {
        !self.between.is_not_followed()
    }

    /// 95 % confidence band at the targets and between them, from the readings alone, in the unit of the error; `None`
    /// if unknown. Each call resamples the band from the runs, which takes longer than the fit.
    pub fn band(&self) -> Option<Band> {
        let of = self.resampled.as_ref()?;
        // A method that cannot be fitted to some of the runs has no band.
        let mut band = of.repeated.band(self.method, &band_places(&of.targets)).ok()?;
        for half in &mut band.half_width {
            *half *= of.factor.abs();
        }
        let is_known = band.half_width.iter().all(|half| half.is_finite());
        is_known.then_some(band)
    }
}

/// Deviation of readings from their curve: lengths for a linear error, angles for an angular error.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub enum Quality {
    /// Quality of the fit of an error in µm.
    Length(FitQuality<Um>),
    /// Quality of the fit of an error in µrad.
    Angle(FitQuality<Urad>),
}

impl Quality {
    pub(crate) fn leave_one_out(&self) -> Option<f64> {
        match self {
            Self::Length(quality) => quality.leave_one_out.map(|Um(um)| um),
            Self::Angle(quality) => quality.leave_one_out.map(|Urad(urad)| urad),
        }
    }
}

/// Deviation of readings from their curve, in the unit of the error.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize))]
pub struct FitQuality<U> {
    /// Smallest value of reading minus curve.
    pub residual_min: U,
    /// Largest value of reading minus curve.
    pub residual_max: U,
    /// Root mean square of reading minus curve.
    pub residual_rms: U,
    /// Leave-one-out error: root mean square of each reading minus the curve fitted to all other readings; `None` if a
    /// reading cannot be predicted from the others.
    pub leave_one_out: Option<U>,
    /// Largest difference forward − backward of the curves over the targets, with its sign; `None` if one curve holds for both directions.
    pub reversal: Option<U>,
}

/// A fitted error with its curve for each direction, zero at the reference.
pub(crate) struct Fitted {
    pub(crate) error: ErrorName,
    pub(crate) branches: Branches,
    pub(crate) lines: Vec<FittedLine>,
}

impl Fitted {
    pub(crate) fn set_in(&self, machine: &mut Machine) -> Result<(), ModelError> {
        machine.set_error(self.error, self.branches.clone().into_curve())
    }
}

pub(crate) fn joint_of(machine: &Machine, error: ErrorName) -> Result<Joint, ModelError> {
    Ok(machine.chain().joints()[machine.index_of(error.axis)?])
}

/// Period of errors along an axis, deg; `None` if the axis covers less than a full turn, since the errors at both ends of its travel are then
/// unrelated.
fn period_of(axis: &Axis) -> Option<f64> {
    let [low, high] = axis.travel;
    let turns = axis.name.is_rotary() && high - low >= FULL_TURN_DEG * (1.0 - 1e-9);
    turns.then_some(FULL_TURN_DEG)
}

/// Fits the profiles of an error. Returns its curves, zero at the reference (a straightness has
/// already lost its constant with its line), and the aligned profiles. A positioning deviation
/// along an oblique axis gives one curve for each component of the direction of the axis.
pub(crate) fn fit<'a>(
    file: &CalibrationFile,
    error: ErrorName,
    profiles: Vec<Profile<'a>>,
) -> Result<(Vec<Fitted>, Vec<Profile<'a>>), CalibrateError> {
    let machine = &file.machine;
    let profiles = match machine.axis(error.axis) {
        Some(axis) => {
            let profiles = profiles.into_iter();
            profiles.map(|profile| profile.within_travel(axis)).collect()
        }
        None => profiles,
    };
    let choice = profiles.iter().find_map(|profile| profile.line.curve);
    let period = machine.axis(error.axis).and_then(period_of);
    let (branches, profiles) = Branches::fit(error, choice.unwrap_or_default(), period, profiles)?;
    let zero = if MotionKind::of(error) == MotionKind::Straightness {
        0.0
    } else {
        branches.mean_at(file.reference_at(machine.index_of(error.axis)?))
    };
    let mut fitted = Vec::new();
    for (filled, share) in shares(error, &joint_of(machine, error)?.direction) {
        if filled != error && lines_of(file, filled).next().is_some() {
            return Err(CalibrateError::Oblique {
                error,
                files: files_of(&profiles),
                axis: error.axis,
                other: filled,
            });
        }
        let lines = profiles.iter();
        let lines = lines.map(|profile| FittedLine::new(file, filled, profile, (share, zero)));
        fitted.push(Fitted {
            error: filled,
            branches: branches.scaled(share, zero),
            lines: lines.collect(),
        });
    }
    Ok((fitted, profiles))
}

/// Errors to which readings of `error` contribute, each with its factor: a positioning deviation p of the coordinate contributes δ = u·p (rotary:
/// ε = u·p), where u is the direction of the axis.
fn shares(error: ErrorName, direction: &Vector3<f64>) -> Vec<(ErrorName, f64)> {
    if MotionKind::of(error) != MotionKind::Positioning {
        return vec![(error, 1.0)];
    }
    let of_kind = |component: &Component| component.is_angular() == error.component.is_angular();
    let components = Component::ALL.into_iter().filter(of_kind);
    let shares = components.map(|component| {
        let name = ErrorName::motion(component, error.axis);
        (name, direction[component.mcs_index()])
    });
    shares.filter(|(_, share)| share.abs() > 1e-12).collect()
}

/// One measured line of an error, aligned with its curve.
#[derive(Clone, Debug, PartialEq)]
pub struct FittedLine {
    /// The error that the curve describes.
    pub error: ErrorName,
    /// Index of the line in [`CalibrationFile::measurements`]; `None` if its readings were computed from several other lines.
    pub line: Option<usize>,
    /// Files of the line's readings.
    pub sources: Vec<Source>,
    /// Targets (mm or deg, ascending) and mean readings (µm or µrad), forward and backward. The
    /// contributions of tilts and other axes are subtracted, and for a straightness its line. The
    /// readings are aligned with the first line of the error, and zero at the reference like the
    /// curve. Empty for a direction that was not run.
    pub points: [Vec<(f64, f64)>; 2],
    /// Factor from a difference of readings to a difference of the error: 1, or for an oblique axis the component of its direction.
    pub factor: f64,
}

impl FittedLine {
    pub(crate) fn new(
        file: &CalibrationFile,
        error: ErrorName,
        profile: &Profile<'_>,
        (factor, zero): (f64, f64),
    ) -> Self {
        let mut lines = file.measurements.iter();
        Self {
            error,
            line: lines.position(|line| std::ptr::eq(line, profile.line)),
            sources: profile.line.sources.clone(),
            factor,
            points: profile.points.each_ref().map(|points| {
                let points = points.iter();
                points.map(|(target, value)| (*target, (value - zero) * factor)).collect()
            }),
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use volcomp_metrology::TiltReading;
    use volcomp_vocabulary::AxisName;

    use super::*;
    use crate::calibration_file::Method as Reads;
    use crate::checks::Tilts;
    use crate::line_of_sight::ArtefactPoses;
    use crate::stages::{from_parallel_lines, linear};
    use crate::testing::{file, line, machine, name};
    use crate::varied::normal;

    /// Fits lines of EYX at these heights above the axis, mm. EYX is 0, and a roll of up to 10 µrad bends the lines
    /// apart. `roll` is the text of the machine file about the roll; `noise_um` is the noise of each reading.
    fn fitted_lines(
        heights: &[f64],
        roll: &str,
        curve: CurveChoice,
        mut noise_um: impl FnMut() -> f64,
    ) -> Branches {
        let lines = heights.iter().map(|height| {
            let mut line = line("EYX", |q| {
                let roll_urad = 0.04 * q - 4e-5 * q * q;
                noise_um() - roll_urad * height * 1e-3
            });
            line.setup.point_mcs = Some([0.0, 0.0, *height]);
            line.curve = Some(curve);
            line
        });
        let (file, known) = (file(lines.collect()), machine(roll));
        let angular = from_parallel_lines(&file, &known).unwrap();
        let tilts = Tilts {
            machine: &angular.tilted,
            noise_urad: &BTreeMap::new(),
            found_from: &angular.found_from,
        };
        let artefacts = ArtefactPoses::of(&known, &[], [AxisName::X, AxisName::Y], |_| None);
        let linear = linear(&file, &tilts, (tilts.machine, &artefacts), || ()).unwrap();
        let [fitted] = &linear.fitted[..] else { panic!("one error") };
        fitted.branches.clone()
    }

    fn band_of(branches: &Branches) -> Option<Band> {
        let [fitted] = &branches.fitted(name("EYX"))[..] else { panic!("one direction") };
        fitted.band()
    }

    /// Differences of parallel lines that are due to a roll do not widen the band. Where the roll was found from these differences, they do not show the
    /// noise either: a band from them would hold the curve of two lines nowhere.
    #[test]
    fn bands_of_parallel_lines_cover() {
        const ROLL: &str = "EAX = { poly = [0, 0.04, -4e-5] }";
        const TRIALS: u64 = 150;
        let cubic = CurveChoice::Polynomial { order: 3 };
        let table = CurveChoice::LinearTable;
        let five = [-400.0, -200.0, 0.0, 200.0, 400.0];
        for (heights, roll, curve, most) in [
            (&[0.0, 600.0][..], ROLL, table, 0.97),
            (&five, ROLL, table, 0.97),
            (&[0.0, 600.0], ROLL, cubic, 0.97),
            (&five, ROLL, cubic, 0.97),
            // The bands of single runs are wider, because one run cannot separate scatter from shape.
            (&[0.0, 600.0], "", table, 1.0),
            (&[400.0, 600.0], "", table, 1.0),
            (&five, "", table, 1.0),
            (&[0.0, 600.0], "", cubic, 1.0),
            (&[400.0, 600.0], "", cubic, 1.0),
        ] {
            let case = format!("{heights:?} {roll:?} {curve:?}");
            let exact = band_of(&fitted_lines(heights, roll, curve, || 0.0)).expect(&case);
            let widest = exact.half_width.into_iter().fold(0.0, f64::max);
            assert!(widest < 1e-9, "{case}: {widest}");
            let mut rng = ChaCha8Rng::seed_from_u64(7);
            let (mut inside, mut all) = (0, 0);
            for _ in 0..TRIALS {
                let branches = fitted_lines(heights, roll, curve, || normal(&mut rng));
                let band = band_of(&branches).expect(&case);
                let at_targets = band.at.iter().zip(&band.half_width);
                for (at, half) in at_targets.filter(|(at, _)| *at % 100.0 == 0.0) {
                    all += 1;
                    inside += u32::from(branches.mean_at(*at).abs() <= *half);
                }
            }
            let share = f64::from(inside) / f64::from(all);
            assert!((0.93..=most).contains(&share), "{case}: {share}");
        }
    }

    /// The errors of summed tilts grow along the line, so that their band would hold the ends of the curve with 85 % only.
    #[test]
    fn lines_of_a_bridge_have_no_band() {
        let joint = machine("").chain().joints()[0];
        let lines = [1.0, -1.0].map(|urad| {
            let mut line = line("EYX", |q| urad * q / 1000.0);
            line.setup.method = Reads::Angular { bridge_mm: 100.0, reading: TiltReading::Slope };
            line
        });
        let straight = lines.iter().map(|line| {
            let profile = Profile::new(line, &joint).unwrap();
            let reference = profile.reference_line().unwrap();
            profile.without_line(&reference)
        });
        let choice = CurveChoice::LinearTable;
        let found = Branches::fit(name("EYX"), choice, None, straight.collect());
        assert_eq!(band_of(&found.unwrap().0), None);
    }
}

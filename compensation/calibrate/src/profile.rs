//! Readings of a measured line: their means at the targets, and the repeated readings from which bands are resampled.

use std::collections::BTreeMap;
use std::path::PathBuf;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use volcomp_fit::{
    Band, BandOptions, FitError, MeanScatter, Noise, band, band_of_means, unevenness,
};
use volcomp_kinematics::Joint;
use volcomp_metrology::{
    AtTargets, IncompleteRuns, MetrologyError, MotionKind, ReferenceLine, RunAlignment,
    TiltReading, angular_method_um,
};
use volcomp_model::Axis;
use volcomp_vocabulary::{COORDINATE_ROUNDING, Direction, Urad, brought_into};

use crate::calibration_file::{Line, Method};
use crate::error::CalibrateError;
use crate::varied::normal;

/// (target in mm or deg, mean reading in µm or µrad), targets ascending.
pub(crate) type Points = Vec<(f64, f64)>;

/// Mean readings of one line, forward and backward; empty in a direction that was not run.
#[derive(Clone)]
pub(crate) struct Profile<'a> {
    pub(crate) line: &'a Line,
    pub(crate) points: [Points; 2],
    pub(crate) removed: Urad,
    /// If a tilt was found from this line and its parallel ones: see `Angular::found_from`.
    pub(crate) as_one_run: Option<[Points; 2]>,
}

impl<'a> Profile<'a> {
    /// Mean readings of a line along `joint`; for a bridge, the profile from the sum of its tilts.
    pub(crate) fn new(line: &'a Line, joint: &Joint) -> Result<Self, CalibrateError> {
        let checked = line.readings.check_lines_of_runs();
        checked.map_err(|source| wrong(line, source))?;
        let mut points = Direction::BOTH.map(|direction| line.readings.mean_curve_in(direction));
        if let Method::Angular { bridge_mm, reading } = line.setup.method {
            let name = line.setup.error;
            for branch in points.iter_mut().filter(|branch| !branch.is_empty()) {
                *branch = angular_method_um(name, reading, branch, bridge_mm)
                    .map_err(|source| wrong(line, source))?;
                // On a reversed axis, the same tilt raises the bridge in the opposite sense along the coordinate.
                let own = joint.direction[name.axis.mcs_index()];
                if reading == TiltReading::RightHand && own < 0.0 {
                    for (_, h) in branch.iter_mut() {
                        *h = -*h;
                    }
                }
            }
        }
        Ok(Self { line, points, removed: Urad(0.0), as_one_run: None })
    }

    /// The profile with its targets within the travel of a periodic axis, where its curve is evaluated. Targets outside
    /// the travel are moved by whole periods, and targets at the same position are averaged. If the targets cover a
    /// full turn and both ends of the travel are the same angle, an unmeasured end takes the reading of the other end.
    pub(crate) fn within_travel(mut self, axis: &Axis) -> Self {
        let Some(period) = axis.modulo else {
            return self;
        };
        let [low, high] = axis.travel;
        for branch in self.points.iter_mut().filter(|branch| !branch.is_empty()) {
            for (target, _) in branch.iter_mut() {
                *target = brought_into(axis.travel, period, *target);
            }
            *branch = means(std::mem::take(branch));
            let at = |end: f64| {
                let same = |(target, _): &&(f64, f64)| (target - end).abs() <= COORDINATE_ROUNDING;
                branch.iter().find(same).map(|(_, value)| *value)
            };
            let gaps = branch.windows(2).map(|pair| pair[1].0 - pair[0].0);
            let widest = gaps.fold(0.0, f64::max);
            let ends = match (branch.first(), branch.last()) {
                (Some((first, _)), Some((last, _))) => (first - low).max(high - last),
                _ => f64::INFINITY,
            };
            // The gap across the end of the turn must not be wider than the other gaps; a curve over part of a turn
            // stays open.
            let whole_turn = (high - low - period).abs() <= COORDINATE_ROUNDING
                && ends <= 1.5 * widest + COORDINATE_ROUNDING;
            match [at(low), at(high)] {
                [Some(value), None] if whole_turn => branch.push((high, value)),
                [None, Some(value)] if whole_turn => branch.insert(0, (low, value)),
                _ => {}
            }
        }
        self
    }

    /// Unevenness from target to target, each direction separately ([`unevenness`]); `None` for fewer than three targets.
    pub(crate) fn unevenness(&self) -> Option<f64> {
        let branches = self.points.iter();
        branches.filter_map(|points| unevenness(points)).reduce(f64::max)
    }

    /// Whether the readings are the sum of the tilts of a bridge.
    pub(crate) fn is_summed(&self) -> bool {
        self.line.setup.method != Method::Direct
    }

    /// Scatter of a mean reading; `None` if the scatter is unknown, or if the readings are tilts of a bridge, which are
    /// summed.
    pub(crate) fn scatter_of_mean(&self, alignment: RunAlignment) -> Option<Noise> {
        if self.is_summed() {
            return None;
        }
        let scatter = self.line.readings.scatter_of_mean(alignment)?;
        Some(Noise { deviation: scatter.deviation, freedom: scatter.freedom })
    }

    /// Standard deviation of a mean reading after removing the alignment of each run: its offset, and for straightness also its slope.
    pub(crate) fn noise_of_shape(&self) -> Option<f64> {
        let alignment = if MotionKind::of(self.line.setup.error) == MotionKind::Straightness {
            RunAlignment::Line
        } else {
            RunAlignment::Offset
        };
        self.scatter_of_mean(alignment).map(|noise| noise.deviation)
    }

    /// Targets and readings of every run in a direction, adjusted to the mean readings of this profile. `None` for
    /// tilts of a bridge, which are summed, and for targets that were moved into the travel.
    pub(crate) fn repeated_in(&self, direction: Direction) -> Option<Repeated> {
        if self.is_summed() {
            return None;
        }
        let readings = &self.line.readings;
        let means = readings.mean_curve_in(direction);
        let points = &self.points[direction as usize];
        if means.len() != points.len() || means.iter().zip(points).any(|(a, b)| a.0 != b.0) {
            return None;
        }
        if let Some(runs) = readings.incomplete_runs() {
            return Some(Repeated::Incomplete {
                runs: Box::new(runs),
                direction,
                means: points.iter().copied().unzip(),
            });
        }
        let mut runs: BTreeMap<_, Run> = BTreeMap::new();
        let in_direction = readings.readings.iter();
        for reading in in_direction.filter(|r| r.direction == direction) {
            let place = means.partition_point(|mean| mean.0 < reading.target);
            let (mean, point) = (means.get(place)?, points.get(place)?);
            let (x, u) = runs.entry(reading.run).or_default();
            x.push(reading.target);
            u.push(reading.deviation - mean.1 + point.1);
        }
        Some(Repeated::Runs(runs.into_values().collect()))
    }

    /// Points of both directions, forward first.
    pub(crate) fn all(&self) -> impl Iterator<Item = &(f64, f64)> {
        self.points.iter().flatten()
    }

    /// Reference line of the stated kind through the mean of all runs at each target.
    pub(crate) fn reference_line(&self) -> Result<ReferenceLine, CalibrateError> {
        let points = means(self.all().copied().collect());
        ReferenceLine::of(self.line.reference_line, &points)
            .map_err(|source| wrong(self.line, source))
    }

    /// Least-squares line through points of this profile; points at the same target are averaged to one point.
    pub(crate) fn line_through(&self, points: Points) -> Result<ReferenceLine, CalibrateError> {
        ReferenceLine::least_squares(&means(points)).map_err(|source| wrong(self.line, source))
    }

    /// The profile minus a line, intercept included.
    pub(crate) fn without_line(mut self, line: &ReferenceLine) -> Self {
        for branch in &mut self.points {
            *branch = line.removed_from(branch);
        }
        self.removed = self.removed + line.slope();
        self
    }
}

pub(crate) fn files_of(profiles: &[Profile<'_>]) -> Vec<PathBuf> {
    let files = profiles.iter().map(|profile| profile.line.file.clone());
    files.collect()
}

fn means(mut points: Points) -> Points {
    points.sort_by(|a, b| a.0.total_cmp(&b.0));
    let runs = points.chunk_by(|a, b| a.0 == b.0);
    runs.filter_map(|runs| {
        let sum: f64 = runs.iter().map(|(_, value)| value).sum();
        Some((runs.first()?.0, sum / runs.len() as f64))
    })
    .collect()
}

fn wrong(line: &Line, source: MetrologyError) -> CalibrateError {
    CalibrateError::Profile {
        error: line.setup.error,
        file: line.file.clone(),
        source: Box::new(source),
    }
}

/// Targets, mm or deg, and readings, µm or µrad.
pub(crate) type Run = (Vec<f64>, Vec<f64>);

/// Repeated readings to which a curve was fitted.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum Repeated {
    /// Complete runs, each with all targets; or the mean readings of several lines.
    Runs(Vec<Run>),
    /// Runs of which some lack targets, and the mean readings (`means`) of one direction.
    Incomplete { runs: Box<IncompleteRuns>, direction: Direction, means: Run },
}

impl Repeated {
    /// 95 % confidence band of the curve that a method fits to the means.
    pub(crate) fn band(
        &self,
        method: volcomp_fit::Method,
        places: &[f64],
    ) -> Result<Band, FitError> {
        let options = BandOptions::default();
        match self {
            Self::Runs(runs) => {
                let runs: Vec<(&[f64], &[f64])> =
                    runs.iter().map(|(x, u)| (&x[..], &u[..])).collect();
                band(method, &runs, places, &options)
            }
            Self::Incomplete { runs, direction, means: (x, u) } => {
                match mean_scatter(runs, Some(*direction), &options) {
                    Some(scatter) => band_of_means(method, [x, u], &scatter, places),
                    // Readings without any repetition are those of a single run.
                    None => band(method, &[(x, u)], places, &options),
                }
            }
        }
    }
}

/// Scatter of means for runs that lack targets, for [`band_of_means`]: of the means in `direction`, or, for `None`, of
/// the averages of both directions. `None` if no reading was repeated.
pub fn mean_scatter(
    runs: &IncompleteRuns,
    direction: Option<Direction>,
    options: &BandOptions,
) -> Option<MeanScatter> {
    let means = |shifts: &AtTargets| match direction {
        Some(direction) => shifts[direction as usize].clone(),
        None => over_directions(shifts),
    };
    let directions = direction.map_or(Direction::BOTH.to_vec(), |direction| vec![direction]);
    let freedom = runs.scatter()?.freedom;
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let mut sample = || means(&runs.shifted_by_noise(&mut || normal(&mut rng)));
    let first = sample();
    let count = MeanScatter::samples_for(first.len(), options);
    let more = (1..count).map(|_| sample());
    Some(MeanScatter {
        samples: std::iter::once(first).chain(more).collect(),
        of_runs: runs.shifts_by_lines().map(means).collect(),
        run_freedom: runs.freedom_of_lines(&directions) as f64,
        freedom,
    })
}

fn over_directions([forward, backward]: &AtTargets) -> Vec<f64> {
    if forward.is_empty() || backward.is_empty() {
        return [&forward[..], backward].concat();
    }
    let both = forward.iter().zip(backward);
    both.map(|(a, b)| f64::midpoint(*a, *b)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::{line, machine};

    /// Tilts of 2 µrad of a bridge of 100 mm raise the profile by 0.2 µm at each step.
    #[test]
    fn tilts_of_a_bridge_add_up() {
        let mut level = line("EYX", |_| 2.0);
        level.setup.method = Method::Angular { bridge_mm: 100.0, reading: TiltReading::RightHand };
        let joint = machine("").chain().joints()[0];
        let profile = Profile::new(&level, &joint).unwrap();
        for (target, height) in profile.all() {
            assert!((height - 0.002 * target).abs() < 1e-12, "{height} at {target}");
        }
        let line = profile.reference_line().unwrap();
        let flat = profile.without_line(&line);
        assert!(flat.all().all(|(_, height)| height.abs() < 1e-12));
        assert!((flat.removed - Urad(2.0)).abs() < Urad(1e-9));
    }
}

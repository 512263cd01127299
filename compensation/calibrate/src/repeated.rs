//! Repeated readings to which a curve was fitted; the band of the curve is resampled from them.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use volcomp_fit::{Band, BandOptions, FitError, MeanScatter, Method, band, band_of_means};
use volcomp_metrology::{AtTargets, IncompleteRuns};
use volcomp_vocabulary::Direction;

use crate::varied::normal;

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
    pub(crate) fn band(&self, method: Method, places: &[f64]) -> Result<Band, FitError> {
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

//! The numbers that a thermal search may choose, as columns of a regression with sums of products.

use std::ops::Range;

use nalgebra::DMatrix;

use super::{
    features::split,
    lagged::{bent, lagged},
    ridge::ridge_weights,
    runs::ThermalRun,
};

/// The most rows of a stretch that go into the sums: neighbouring rows are nearly equal, and more of them change nothing.
const MOST_ROWS: usize = 400;
/// Columns of the sums before those of the numbers: 1 and the displacement.
const BEFORE: usize = 2;

/// What a number multiplies.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum ThermalEffect {
    /// The temperature of the sensor, with a first-order lag of a time constant, s; 0 is no lag.
    Drift {
        /// The time constant, s.
        lag_s: f64,
    },
    /// The temperature of the sensor times the position of the axis, mm: an expansion.
    Expansion,
}

/// A sensor and what of it counts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Column {
    pub(super) sensor: usize,
    pub(super) effect: ThermalEffect,
}

/// What a temperature does between two rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Between {
    /// It goes along a straight line.
    Straight,
    /// It bends as its slopes from interval to interval say.
    Bent,
}

impl Column {
    /// Its values in the rows of a run: 0 in the first.
    pub(super) fn values(&self, run: &ThermalRun, between: Between) -> Vec<f64> {
        let record = &run.record;
        let degc = &record.degc[self.sensor];
        let difference: Vec<f64> = degc.iter().map(|t| t - degc[0]).collect();
        match self.effect {
            ThermalEffect::Drift { lag_s } => {
                let mut found = lagged(&record.time_s, &difference, lag_s);
                if between == Between::Bent {
                    let bent = bent(&record.time_s, &difference, lag_s);
                    for (found, bent) in found.iter_mut().zip(bent) {
                        *found += bent;
                    }
                }
                found
            }
            ThermalEffect::Expansion => {
                let positions = run.position_mm.iter();
                difference
                    .iter()
                    .zip(positions)
                    .map(|(t, q)| t * q)
                    .collect()
            }
        }
    }
}

/// Sums of products over a stretch of a run, one for each position in it: Σ z zᵀ with z = (1, displacement, columns), all
/// counted from the start of the run at that position.
#[derive(Clone)]
pub(super) struct Stretch {
    pub(super) run: usize,
    /// Place of the position among those of the run, and its sums.
    groups: Vec<(usize, DMatrix<f64>)>,
}

/// The stretches of a run: those among `rows` that no gap leaves out for the time constants `lags_s`, in equal parts.
pub(super) fn stretches(
    run: &ThermalRun,
    index: usize,
    columns: &[Column],
    between: Between,
    rows: &Range<usize>,
    lags_s: &[f64],
    parts: usize,
) -> Vec<Stretch> {
    let (positions, places) = run.places();
    let mut values = vec![run.record.displacement.clone()];
    values.extend(columns.iter().map(|column| column.values(run, between)));
    // Every position has its own zero.
    let known = run.record.known_rows(&(0..run.record.len()), lags_s);
    let zero_rows = ThermalRun::zero_rows(&known, &places, positions.len());
    let zeros: Vec<Vec<f64>> = zero_rows
        .iter()
        .map(|rows| {
            let mean = |values: &Vec<f64>| {
                rows.iter().map(|row| values[*row]).sum::<f64>() / rows.len().max(1) as f64
            };
            values.iter().map(mean).collect()
        })
        .collect();
    let sums = |stretch: &[usize]| {
        let step = stretch.len().div_ceil(MOST_ROWS * positions.len()).max(1);
        let mut groups = Vec::new();
        for (place, zero) in zeros.iter().enumerate() {
            let of_place = stretch.iter().copied().filter(|row| places[*row] == place);
            let taken: Vec<usize> = of_place.step_by(step).collect();
            if taken.is_empty() {
                continue;
            }
            let z = DMatrix::from_fn(taken.len(), 1 + values.len(), |row, column| {
                match column.checked_sub(1) {
                    None => 1.0,
                    Some(column) => values[column][taken[row]] - zero[column],
                }
            });
            groups.push((place, z.tr_mul(&z)));
        }
        Stretch { run: index, groups }
    };
    let rows: Vec<usize> = known.into_iter().filter(|row| rows.contains(row)).collect();
    split(&rows, parts).map(sums).collect()
}

/// Sums of several stretches: of each position of each run, and all of them about the mean of each.
pub(super) struct Sums {
    groups: Vec<((usize, usize), DMatrix<f64>)>,
    centred: DMatrix<f64>,
    rows: f64,
}

impl Sums {
    pub(super) fn of<'a>(stretches: impl Iterator<Item = &'a Stretch>) -> Option<Self> {
        let mut groups: Vec<((usize, usize), DMatrix<f64>)> = Vec::new();
        for stretch in stretches {
            for (place, sums) in &stretch.groups {
                let key = (stretch.run, *place);
                match groups.iter_mut().find(|(known, _)| *known == key) {
                    Some((_, sum)) => *sum += sums,
                    None => groups.push((key, sums.clone())),
                }
            }
        }
        let size = groups.first()?.1.nrows();
        let mut centred = DMatrix::zeros(size, size);
        let mut rows = 0.0;
        for (_, sums) in &groups {
            let count = sums[(0, 0)];
            let means = sums.row(0) / count;
            centred += sums - means.transpose() * &means * count;
            rows += count;
        }
        Some(Self {
            groups,
            centred,
            rows,
        })
    }

    /// Ridge regression on some columns, scaled to unit variance: a weight for each; `None` where nothing moves.
    pub(super) fn ridge(&self, columns: &[usize], penalty: f64) -> Option<Vec<f64>> {
        let covariance = |i: usize, j: usize| self.centred[(i, j)] / self.rows;
        let plan: Vec<usize> = columns.iter().map(|column| BEFORE + column).collect();
        ridge_weights(covariance, &plan, penalty)
    }

    /// The mean over the rows of a position of what some weights leave; `None` where the position is not there.
    fn offset(&self, key: (usize, usize), v: &[(usize, f64)]) -> Option<f64> {
        let (_, sums) = self.groups.iter().find(|(known, _)| *known == key)?;
        Some(v.iter().map(|&(i, a)| a * sums[(0, i)]).sum::<f64>() / sums[(0, 0)])
    }

    /// The offset of each position of each run: what some weights leave in the mean, counted from its start.
    pub(super) fn offsets(&self, columns: &[usize], weights: &[f64]) -> Vec<((usize, usize), f64)> {
        let v = error_of(columns, weights);
        let keys = self.groups.iter().map(|(key, _)| *key);
        keys.filter_map(|key| Some((key, self.offset(key, &v)?)))
            .collect()
    }

    /// Mean square of the errors in a stretch of weights that were fitted on these sums. What the weights leave in the
    /// mean is known where the position was part of the fit; elsewhere it is that of the start of its run.
    pub(super) fn error_in(&self, stretch: &Stretch, columns: &[usize], weights: &[f64]) -> f64 {
        let v = error_of(columns, weights);
        let (mut sum, mut rows) = (0.0, 0.0);
        for (place, sums) in &stretch.groups {
            let offset = self.offset((stretch.run, *place), &v).unwrap_or(0.0);
            let product =
                |&(i, a): &(usize, f64)| v.iter().map(|&(j, b)| a * b * sums[(i, j)]).sum::<f64>();
            let count = sums[(0, 0)];
            let mean = v.iter().map(|&(i, a)| a * sums[(0, i)]).sum::<f64>() / count;
            sum += v.iter().map(product).sum::<f64>() + count * offset * (offset - 2.0 * mean);
            rows += count;
        }
        (sum / rows).max(0.0)
    }
}

/// Displacement less the weighted columns, as a linear form of z.
fn error_of(columns: &[usize], weights: &[f64]) -> Vec<(usize, f64)> {
    let weighted = columns.iter().zip(weights);
    [(1, 1.0)]
        .into_iter()
        .chain(weighted.map(|(column, weight)| (BEFORE + column, -weight)))
        .collect()
}

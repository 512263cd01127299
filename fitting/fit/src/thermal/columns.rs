//! Columns of the regressions: first-order lags of temperatures with their moments, and candidate coefficients with
//! their sums of squares.

use std::ops::Range;

use nalgebra::{Cholesky, DMatrix, DVector};
use volcomp_curve::first_order_lag_of_ramp;

use super::record::{ThermalRecord, ThermalRun};

/// First-order lag of a signal over time, which starts at the first value of the signal. The signal is linear between
/// rows, and the lag is integrated in closed form. The result has the length of the shorter input.
pub(super) fn lagged(time_s: &[f64], signal: &[f64], lag_s: f64) -> Vec<f64> {
    let mut state: Option<(f64, f64, f64)> = None;
    let step = |(&time, &input): (&f64, &f64)| {
        let (time_before, from, value) = state.unwrap_or((time, input, input));
        let value = first_order_lag_of_ramp(value, from, input, time - time_before, lag_s);
        state = Some((time, input, value));
        value
    };
    time_s.iter().zip(signal).map(step).collect()
}

/// Correction for a signal that is curved between its rows: its lag minus the lag of the linearly interpolated signal,
/// in each row.
///
/// The curvature x″ is the difference of the slopes of two intervals divided by the time between their middles. Of the
/// two values, with the previous and with the next interval, the smaller is used, because the beginning or end of
/// heating curves only one of them. Over an interval h, the signal lies x″·t·(h − t)/2 below the straight line. With p
/// = h/lag and k = exp(−p), the lag of this difference is −x″·h²/2·((1 + k)/p − 2·(1 − k)/p²), which decays by k in
/// each later interval. Without a lag it is 0, because the signal is known in the rows. Changes that begin and end
/// within one interval are invisible in the rows.
pub(super) fn bent(time_s: &[f64], signal: &[f64], lag_s: f64) -> Vec<f64> {
    let rows = time_s.len().min(signal.len());
    let mut found = vec![0.0; rows];
    if lag_s.is_nan() || lag_s <= 0.0 {
        return found;
    }
    // Slope of the interval that ends in a row, and time of the middle of that interval.
    let slope = |row: usize| {
        let step_s = time_s[row] - time_s[row - 1];
        ((signal[row] - signal[row - 1]) / step_s, time_s[row] - 0.5 * step_s)
    };
    for row in 1..rows {
        // Change of slope to a neighbouring interval. The first interval has no predecessor, and the last no successor.
        let against = |beside: usize| {
            let ((own, own_s), (other, other_s)) = (slope(row), slope(beside));
            (own - other) / (own_s - other_s)
        };
        let beside = [row - 1, row + 1].into_iter();
        let beside = beside.filter(|beside| (1..rows).contains(beside));
        let least = beside.map(against).min_by(|a, b| a.abs().total_cmp(&b.abs()));
        let bends = least.unwrap_or(0.0);
        let step_s = time_s[row] - time_s[row - 1];
        let own = -0.5 * bends * step_s * step_s * below_line(step_s / lag_s);
        found[row] = (-step_s / lag_s).exp() * found[row - 1] + own;
    }
    found
}

/// (1 + k)/p − 2·(1 − k)/p² with k = exp(−p). This is the lag of t·(1 − t) at the end of a step from 0 to 1 whose
/// length is `p` time constants.
fn below_line(p: f64) -> f64 {
    // In short steps the two parts cancel. The first terms of the series are exact to 1e-10 there.
    if p < 1e-3 {
        return p / 6.0 - p * p / 12.0;
    }
    (1.0 + (-p).exp()) / p + 2.0 * (-p).exp_m1() / (p * p)
}

/// Number of columns of the moments before the features. These columns are the constant 1 and the displacement.
pub(super) const BEFORE: usize = 2;

/// Splits rows into `parts` stretches of nearly equal length.
pub(super) fn split(rows: &[usize], parts: usize) -> impl Iterator<Item = &[usize]> {
    let end = move |part: usize| rows.len() * part / parts.max(1);
    (0..parts).map(move |part| &rows[end(part)..end(part + 1)])
}

/// Temperature of every sensor with every lag, relative to the first row: `columns[lag × sensors + sensor]`.
pub(super) struct Features {
    pub(super) sensors: usize,
    pub(super) lags: usize,
    pub(super) start_degc: Vec<f64>,
    columns: Vec<Vec<f64>>,
}

impl Features {
    pub(super) fn new(record: &ThermalRecord, lags_s: &[f64]) -> Self {
        let start_degc: Vec<f64> = record.degc.iter().map(|column| column[0]).collect();
        let column = |lag_s: f64, sensor: usize| {
            let difference: Vec<f64> =
                record.degc[sensor].iter().map(|t| t - start_degc[sensor]).collect();
            lagged(&record.time_s, &difference, lag_s)
        };
        let sensors = record.degc.len();
        let columns =
            lags_s.iter().flat_map(|&lag_s| (0..sensors).map(move |sensor| (lag_s, sensor)));
        Self {
            columns: columns.map(|(lag_s, sensor)| column(lag_s, sensor)).collect(),
            sensors,
            lags: lags_s.len(),
            start_degc,
        }
    }

    /// Moments Σ z zᵀ over every `stride`-th row, with z = (1, displacement, features).
    pub(super) fn moments(
        &self,
        record: &ThermalRecord,
        rows: &[usize],
        stride: usize,
    ) -> DMatrix<f64> {
        let rows: Vec<usize> = rows.iter().copied().step_by(stride).collect();
        let entry = |row: usize, column: usize| match column {
            0 => 1.0,
            1 => record.displacement[rows[row]],
            _ => self.columns[column - BEFORE][rows[row]],
        };
        let z = DMatrix::from_fn(rows.len(), BEFORE + self.columns.len(), entry);
        z.tr_mul(&z)
    }
}

/// Maximum number of rows of a stretch in the sums. Neighbouring rows are nearly equal, so more rows do not change the
/// result.
const MAX_ROWS: usize = 400;

/// Quantity that a coefficient of a term multiplies.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum ThermalEffect {
    /// Temperature of the sensor with a first-order lag.
    Drift {
        /// Time constant, s; 0 for no lag.
        lag_s: f64,
    },
    /// Temperature of the sensor times the axis position (mm), which describes thermal expansion.
    Expansion,
}

/// A sensor, and the effect of its temperature.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Column {
    pub(super) sensor: usize,
    pub(super) effect: ThermalEffect,
}

/// Assumption about the temperature between two rows.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Between {
    Straight,
    /// The temperature is curved, according to the change of slope from interval to interval.
    Bent,
}

impl Column {
    /// Values in all rows of a run, relative to the first row.
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
                difference.iter().zip(positions).map(|(t, q)| t * q).collect()
            }
        }
    }
}

/// Sums of products over a stretch of a run, one matrix for each position of the axis: Σ z zᵀ with z = (1,
/// displacement, columns). All values are relative to the start of the run at that position.
#[derive(Clone)]
pub(super) struct Stretch {
    pub(super) run: usize,
    /// Index of each position in the run, and the sums for that position.
    groups: Vec<(usize, DMatrix<f64>)>,
}

/// Sums over `parts` equal stretches of `rows`. Rows that a gap excludes for the time constants `lags_s` are omitted.
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
        let step = stretch.len().div_ceil(MAX_ROWS * positions.len()).max(1);
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

/// Sums of several stretches: by run and position, and for all stretches together about the mean of each position.
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
        Some(Self { groups, centred, rows })
    }

    /// Ridge regression on these columns, scaled to unit variance. Returns one weight per column; `None` if all columns
    /// are constant.
    pub(super) fn ridge(&self, columns: &[usize], penalty: f64) -> Option<Vec<f64>> {
        let covariance = |i: usize, j: usize| self.centred[(i, j)] / self.rows;
        let plan: Vec<usize> = columns.iter().map(|column| BEFORE + column).collect();
        ridge_weights(covariance, &plan, penalty)
    }

    /// Mean error of the weights `v` over the rows of a position; `None` if the sums lack the position.
    fn offset(&self, key: (usize, usize), v: &[(usize, f64)]) -> Option<f64> {
        let (_, sums) = self.groups.iter().find(|(known, _)| *known == key)?;
        Some(v.iter().map(|&(i, a)| a * sums[(0, i)]).sum::<f64>() / sums[(0, 0)])
    }

    /// Offset of each position of each run: the mean error of the weights at that position, relative to the start of
    /// the run.
    pub(super) fn offsets(&self, columns: &[usize], weights: &[f64]) -> Vec<((usize, usize), f64)> {
        let v = error_of(columns, weights);
        let keys = self.groups.iter().map(|(key, _)| *key);
        keys.filter_map(|key| Some((key, self.offset(key, &v)?))).collect()
    }

    /// Mean square error in a stretch, by weights that were fitted to these sums. The offset of a position is that of
    /// the fit. If the position was not part of the fit, its offset is that at the start of the run.
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

/// Error (displacement minus weighted columns) as a linear form of z.
fn error_of(columns: &[usize], weights: &[f64]) -> Vec<(usize, f64)> {
    let weighted = columns.iter().zip(weights);
    [(1, 1.0)]
        .into_iter()
        .chain(weighted.map(|(column, weight)| (BEFORE + column, -weight)))
        .collect()
}

pub(super) struct Ridge {
    pub(super) weights: Vec<f64>,
    pub(super) constant: f64,
}

impl Ridge {
    /// Sum of squared errors over the rows of these moments.
    pub(super) fn squared_error(&self, moments: &DMatrix<f64>, plan: &[usize]) -> f64 {
        // The error is v·z with v = (−constant, 1, −weights).
        let v: Vec<(usize, f64)> = [(0, -self.constant), (1, 1.0)]
            .into_iter()
            .chain(plan.iter().copied().zip(self.weights.iter().map(|w| -w)))
            .collect();
        let product =
            |&(i, a): &(usize, f64)| v.iter().map(|&(j, b)| a * b * moments[(i, j)]).sum::<f64>();
        v.iter().map(product).sum::<f64>().max(0.0)
    }
}

/// Ridge regression from moments, with features scaled to unit variance. A constant feature gets the weight 0.
pub(super) fn ridge(moments: &DMatrix<f64>, plan: &[usize], penalty: f64) -> Option<Ridge> {
    let rows = moments[(0, 0)];
    let mean = |column: usize| moments[(0, column)] / rows;
    let covariance = |a: usize, b: usize| moments[(a, b)] / rows - mean(a) * mean(b);
    let weights = ridge_weights(covariance, plan, penalty)?;
    let constant =
        mean(1) - weights.iter().zip(plan).map(|(w, &column)| w * mean(column)).sum::<f64>();
    Some(Ridge { weights, constant })
}

/// Weights of a ridge regression of the displacement (column 1) on the columns in `plan`, from the covariance of any
/// two columns; `None` if all columns are constant.
fn ridge_weights(
    covariance: impl Fn(usize, usize) -> f64,
    plan: &[usize],
    penalty: f64,
) -> Option<Vec<f64>> {
    // A column with a standard deviation below 1e-4 (K for temperatures) counts as constant.
    let scales: Vec<f64> = plan
        .iter()
        .map(|&c| covariance(c, c).max(0.0).sqrt())
        .map(|s| if s > 1e-4 { 1.0 / s } else { 0.0 })
        .collect();
    if scales.iter().all(|scale| *scale == 0.0) {
        return None;
    }
    let correlation = DMatrix::from_fn(plan.len(), plan.len(), |i, j| {
        covariance(plan[i], plan[j]) * scales[i] * scales[j] + if i == j { penalty } else { 0.0 }
    });
    let right = DVector::from_fn(plan.len(), |i, _| covariance(plan[i], 1) * scales[i]);
    let solved = Cholesky::new(correlation)?.solve(&right);
    Some(solved.iter().zip(&scales).map(|(w, s)| w * s).collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Reference: the lag of a signal, integrated in 20,000 steps per interval by the explicit midpoint rule.
    fn fine(signal: impl Fn(f64) -> f64, time_s: &[f64], lag_s: f64) -> Vec<f64> {
        let mut value = signal(time_s[0]);
        let mut found = vec![value];
        for pair in time_s.windows(2) {
            let step_s = (pair[1] - pair[0]) / 2e4;
            for step in 0..20_000 {
                let middle = signal(pair[0] + (f64::from(step) + 0.5) * step_s);
                let half = value + 0.5 * step_s / lag_s * (middle - value);
                value += step_s / lag_s * (middle - half);
            }
            found.push(value);
        }
        found
    }

    /// For linear signals and rows 10 to 900 s apart, the lag equals that of a fine simulation.
    #[test]
    fn straight_lines_are_integrated_exactly() {
        let time_s = [0.0, 30.0, 90.0, 390.0, 400.0, 1300.0, 1600.0];
        let degc = [20.0, 22.0, 21.0, 25.0, 25.5, 19.0, 23.0];
        let line = |t: f64| {
            let row = time_s.partition_point(|s| *s < t).clamp(1, 6);
            let share = (t - time_s[row - 1]) / (time_s[row] - time_s[row - 1]);
            degc[row - 1] + share * (degc[row] - degc[row - 1])
        };
        for lag_s in [5.0, 120.0, 600.0, 5400.0] {
            let expected = fine(line, &time_s, lag_s);
            for (found, expected) in lagged(&time_s, &degc, lag_s).iter().zip(&expected) {
                assert!((found - expected).abs() < 1e-5, "{lag_s}: {found} {expected}");
            }
        }
        assert_eq!(lagged(&time_s, &degc, 0.0), degc);
    }

    /// A parabola has constant curvature, so its deviation from the straight lines between rows is found exactly.
    #[test]
    fn a_parabola_is_found_from_its_rows() {
        let time_s: Vec<f64> = [0, 300, 600, 650, 1200, 2400].map(f64::from).to_vec();
        let parabola = |t: f64| 20.0 + 1e-2 * t - 3e-6 * t * t;
        let degc: Vec<f64> = time_s.iter().map(|t| parabola(*t)).collect();
        // The first and the last interval have only one neighbour, which suffices for a parabola.
        for lag_s in [60.0, 600.0, 5400.0] {
            let straight = lagged(&time_s, &degc, lag_s);
            let bends = bent(&time_s, &degc, lag_s);
            for ((straight, bends), expected) in
                straight.iter().zip(&bends).zip(fine(parabola, &time_s, lag_s))
            {
                let found = straight + bends;
                assert!((found - expected).abs() < 1e-5, "{lag_s}: {found} {expected}");
            }
            assert!(bends[5] > 0.1, "{bends:?}");
        }
        assert_eq!(bent(&time_s, &degc, 0.0), [0.0; 6]);
        let short = below_line(1e-3 * (1.0 - 1e-12));
        assert!((short - below_line(1e-3)).abs() < 1e-9, "{short}");
    }
}

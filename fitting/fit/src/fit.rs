use nalgebra::{DMatrix, DVector};
use volcomp_curve::Curve;

use crate::readings::{self, Target};

/// A fitted curve with its errors.
#[derive(Clone, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct Fit {
    pub curve: Curve,
    /// Reading minus curve, in the order of the readings.
    pub residuals: Vec<f64>,
    /// Leave-one-out error: root mean square error of predicting each reading by a curve that was fitted without the
    /// readings of its target. It is never less than the RMS residual, because no curve predicts the differences
    /// between readings of one target.
    ///
    /// Support, knots and smoothing parameter are those of the whole fit. A table predicts only its inner targets. The
    /// error is infinite if a target cannot be predicted from the others.
    #[cfg_attr(feature = "serde", serde(with = "crate::serialised"))]
    pub leave_one_out_rms: f64,
    /// Leave-one-out RMS of the inner targets. The first and the last target are omitted, because the curve is never
    /// evaluated beyond them and some kinds of curve cannot predict them.
    #[cfg_attr(feature = "serde", serde(with = "crate::serialised"))]
    pub inner_rms: f64,
    /// Whether the largest deviation of a mean reading is within the required residual; `None` if none is required.
    pub meets_required: Option<bool>,
}

impl Fit {
    /// `missed` are the leave-one-out errors of the mean readings, each with the index of its target. It is empty if no
    /// target can be left out.
    pub(crate) fn new(
        curve: Curve,
        x: &[f64],
        u: &[f64],
        missed: impl Iterator<Item = (usize, f64)>,
    ) -> Self {
        // Each abscissa is evaluated once, because runs repeat their targets and moving least squares are slow to
        // evaluate.
        let mut places = x.to_vec();
        places.sort_by(f64::total_cmp);
        places.dedup();
        let known: Vec<[f64; 2]> = places.into_iter().map(|x| [x, curve.value(x)]).collect();
        Self::of_values(curve, &known, x, u, missed)
    }

    /// Like [`new`](Self::new), for a curve whose values at the targets are known. `known` are pairs of target and
    /// value, with ascending targets.
    pub(crate) fn of_values(
        curve: Curve,
        known: &[[f64; 2]],
        x: &[f64],
        u: &[f64],
        missed: impl Iterator<Item = (usize, f64)>,
    ) -> Self {
        let at = |x: f64| {
            let place = known.binary_search_by(|[place, _]| place.total_cmp(&x));
            // The search distinguishes 0 and −0, which are the same abscissa.
            place.map_or_else(|_| curve.value(x), |place| known[place][1])
        };
        let residuals = x.iter().zip(u).map(|(&x, &u)| u - at(x));
        let missed: Vec<(usize, f64)> = missed.collect();
        let last = known.len().saturating_sub(1);
        let inner = missed.iter().filter(|(place, _)| (1..last).contains(place));
        Self {
            residuals: residuals.collect(),
            curve,
            inner_rms: over_readings(x, u, inner.copied()),
            leave_one_out_rms: over_readings(x, u, missed.iter().copied()),
            meets_required: None,
        }
    }

    pub(crate) fn least_squares(curve: Curve, x: &[f64], u: &[f64], solution: &Solution) -> Self {
        let errors = solution.residuals.iter().zip(&solution.leverages);
        let missed = errors.map(|(&e, &h)| left_out(e, h)).enumerate();
        Self::new(curve, x, u, missed)
    }

    /// Smallest residual, in the unit of the readings.
    pub fn min(&self) -> f64 {
        self.residuals.iter().copied().fold(f64::INFINITY, f64::min)
    }

    /// Largest residual, in the unit of the readings.
    pub fn max(&self) -> f64 {
        self.residuals.iter().copied().fold(f64::NEG_INFINITY, f64::max)
    }

    /// Largest magnitude of a residual, in the unit of the readings.
    pub fn max_abs(&self) -> f64 {
        self.min().abs().max(self.max().abs())
    }

    /// Root mean square of the residuals, in the unit of the readings.
    pub fn rms(&self) -> f64 {
        rms(self.residuals.iter().copied())
    }
}

/// Root mean square over the readings of targets, from the leave-one-out errors of their means; infinite if no target
/// can be left out.
fn over_readings(x: &[f64], u: &[f64], missed: impl Iterator<Item = (usize, f64)>) -> f64 {
    let targets = readings::counted(x, u);
    let (mut sum, mut count) = (0.0, 0.0);
    for (place, error) in missed {
        if let Some(target) = targets.get(place) {
            sum += target.count * error * error + target.squares;
            count += target.count;
        }
    }
    if count > 0.0 { (sum / count).sqrt() } else { f64::INFINITY }
}

pub(crate) fn rms(errors: impl Iterator<Item = f64>) -> f64 {
    let (sum, count) = errors.fold((0.0, 0_u32), |(sum, count), e| (sum + e * e, count + 1));
    (sum / f64::from(count)).sqrt()
}

/// Error of predicting a reading from the other readings, `e / (1 − h)`, from its residual `e` and its entry `h` on the
/// diagonal of the hat matrix (Allen, Technometrics 16, 1974). Infinite for h = 1.
pub(crate) fn left_out(residual: f64, leverage: f64) -> f64 {
    let freedom = 1.0 - leverage;
    if freedom > 1e-9 { residual / freedom } else { f64::INFINITY }
}

/// Criteria by which an automatic choice compares candidates: whether a candidate meets the required residual, and its
/// leave-one-out RMS.
#[derive(Clone, Copy)]
pub(crate) struct Judged {
    pub(crate) meets: bool,
    pub(crate) leave_one_out_rms: f64,
}

impl Judged {
    /// Whether this candidate replaces `best`, the best candidate up to now. A candidate that meets the required
    /// residual is preferred. Otherwise the smaller leave-one-out RMS decides, if the difference exceeds the rounding
    /// of readings of this magnitude.
    pub(crate) fn beats(self, best: Option<Self>, magnitude: f64) -> bool {
        let Some(best) = best else { return true };
        match (self.meets, best.meets) {
            (true, false) => true,
            (false, true) => false,
            _ => self.leave_one_out_rms < best.leave_one_out_rms - 1e-9 * magnitude,
        }
    }
}

pub(crate) struct Solution {
    pub(crate) coefficients: Vec<f64>,
    /// Diagonal of the hat matrix for the mean reading of each target, weighted by its number of readings.
    pub(crate) leverages: Vec<f64>,
    /// Mean reading minus curve, for each target.
    pub(crate) residuals: Vec<f64>,
}

/// Least-squares fit to the mean readings of targets, by Householder QR. Each mean is weighted by its number of
/// readings, so the coefficients equal those of a fit to all readings, and the leverages describe the effect of leaving
/// a target out with all its readings. One factorisation gives the solutions for all leading columns.
pub(crate) struct Nested {
    q: DMatrix<f64>,
    r: DMatrix<f64>,
    /// Qᵀ times the right-hand side.
    turned: DVector<f64>,
    roots: Vec<f64>,
    means: Vec<f64>,
}

impl Nested {
    /// Factorises `matrix`, which has one row for each target and one column for each function.
    pub(crate) fn new(mut matrix: DMatrix<f64>, targets: &[Target]) -> Self {
        let roots: Vec<f64> = targets.iter().map(|t| t.count.sqrt()).collect();
        for (mut row, &root) in matrix.row_iter_mut().zip(&roots) {
            row *= root;
        }
        let means: Vec<f64> = targets.iter().map(|t| t.mean).collect();
        let right = DVector::from_iterator(
            means.len(),
            means.iter().zip(&roots).map(|(mean, root)| mean * root),
        );
        let qr = matrix.qr();
        let (q, r) = (qr.q(), qr.r());
        let turned = q.tr_mul(&right);
        Self { q, r, turned, roots, means }
    }

    /// Solution with the first `columns` columns; `None` if these columns are linearly dependent, or more than there
    /// are targets.
    pub(crate) fn solution(&self, columns: usize) -> Option<Solution> {
        if columns > self.r.nrows() || columns > self.r.ncols() || columns == 0 {
            return None;
        }
        let r = self.r.view((0, 0), (columns, columns));
        let diagonal = r.diagonal().abs();
        if diagonal.min() <= 1e-13 * diagonal.max() {
            return None;
        }
        let coefficients = r.solve_upper_triangular(&self.turned.rows(0, columns))?;
        let q = self.q.columns(0, columns);
        let fitted = q * self.turned.rows(0, columns);
        let left = fitted.iter().zip(&self.roots).zip(&self.means);
        Some(Solution {
            coefficients: coefficients.as_slice().to_vec(),
            leverages: q.row_iter().map(|row| row.norm_squared()).collect(),
            residuals: left.map(|((fit, root), mean)| mean - fit / root).collect(),
        })
    }
}

//! Whether what is left of the rows of a file follows their order: a jump where something was shifted between two rows, or
//! a drift.
//!
//! Something that changed is one more unknown of the rows from there on. By how much it makes what is left smaller follows
//! from the equations at hand, since they are nearly straight: the part of its columns that is normal to those of all
//! unknowns (the change-point form of the test of R. L. Brown, J. Durbin and J. M. Evans, Journal of the Royal Statistical
//! Society B 37, 1975).

use std::ops::Range;

use volcomp_kinematics::nalgebra::{DMatrix, DVector};

use crate::{
    basis::legendre,
    changed::{Changed, What, effects},
    design::design,
    identify::Fitted,
    judge::median,
    left::of_unit_length,
    observations::{Observation, Observations},
    prepared::Rows,
    rank::independent,
    solve::squares_by_chance,
    span::Span,
    system::System,
    values::Values,
};

/// Fewer rows before or after it are slips, no change.
const LEAST_ROWS: usize = 4;
/// Beyond this a shift is no error of a machine, mm (of usual machine tools): what is found with it is worth nothing.
const ABSURD_MM: f64 = 1.0;
/// A shift is refused where it explains this share of what is left of its file.
const EXPLAINS_ALL: f64 = 0.9;
/// A change is noted where it explains this share of what is left of its file, or leaves no more than was stated.
const EXPLAINS: f64 = 0.5;
/// By chance a change of one number makes the squares smaller by the sum of both less often than once in ten million times, and one
/// of more numbers by so much more for each. Some ten thousand are looked at.
const BY_CHANCE: f64 = 25.0;
const BY_CHANCE_EACH: f64 = 5.0;
/// A row counts with so many times what is usual in its file at the most, so that slips make no change.
const CLIPPED: f64 = 5.0;
/// Of unit length; what is left of a column beside the unknowns is no more theirs where it is longer.
const TOLD_APART: f64 = 1e-4;
/// So many changes are looked for.
const MOST: usize = 3;
/// The highest order of a drift that is tried.
const MOST_DRIFT: usize = 2;

/// The jump that is no error of a machine, if there is one, before the errors are found (`values` are set-ups alone).
pub(crate) fn absurd_jump(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    values: &Values,
) -> Option<Changed> {
    let kept = independent(&design(system, rows, values).jacobian).kept;
    // The surest alone: two at once are rows of another sphere, not a shift.
    let found = changes(system, observations, rows, values, &kept)
        .into_iter()
        .next()?;
    let absurd_mm = Span::of(&system.machine, rows.iter()).limit_mm(ABSURD_MM);
    let is_absurd = found.size_mm > absurd_mm && found.left_mm < absurd_mm;
    (found.is_jump() && is_absurd && found.explains > EXPLAINS_ALL).then_some(found)
}

/// Notes on jumps and drifts in what is left.
pub(crate) fn in_order(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    fitted: &Fitted,
) -> Vec<String> {
    let values = &fitted.solution.values;
    let found = changes(system, observations, rows, values, &fitted.rank.kept);
    found.iter().map(ToString::to_string).collect()
}

/// What is left of the equations beside the unknowns.
struct Left {
    /// An orthonormal basis of the columns of the unknowns.
    basis: DMatrix<f64>,
    /// The part of the residuals that is normal to it.
    residuals: DVector<f64>,
    /// The same where no row counts more than is usual.
    clipped: DVector<f64>,
}

impl Left {
    fn freedom(&self) -> f64 {
        self.basis.nrows() as f64 - self.basis.ncols() as f64
    }

    /// By how much less the squares may be by chance: how sure a change is that explains `gain` with so many numbers. Rows
    /// that scatter less than was stated count as stated.
    fn sureness(&self, residuals: &DVector<f64>, gain: f64, numbers: usize) -> f64 {
        let freedom = self.freedom() - numbers as f64 - 1.0;
        if freedom < LEAST_ROWS as f64 {
            return 0.0;
        }
        let left = (residuals.norm_squared() - gain).max(freedom);
        freedom * (gain / left).ln_1p()
    }

    /// Takes more columns for those of unknowns.
    fn with(&mut self, columns: &DMatrix<f64>) {
        let mut all: Vec<DVector<f64>> = self.basis.column_iter().map(Into::into).collect();
        for column in columns.column_iter() {
            let mut normal: DVector<f64> = column.into();
            let before = normal.norm();
            for one in &all {
                let part = one.dot(&normal);
                normal.axpy(-part, one, 1.0);
            }
            let length = normal.norm();
            if length > TOLD_APART.sqrt() * before {
                normal /= length;
                for residuals in [&mut self.residuals, &mut self.clipped] {
                    let part = normal.dot(residuals);
                    residuals.axpy(-part, &normal, 1.0);
                }
                all.push(normal);
            }
        }
        if !all.is_empty() {
            self.basis = DMatrix::from_columns(&all);
        }
    }
}

/// Sums over the rows that changed.
struct Sums {
    squares: DMatrix<f64>,
    with_basis: DMatrix<f64>,
    with_residuals: DVector<f64>,
    with_clipped: DVector<f64>,
}

/// How much less is left with a change.
struct Gain {
    all: f64,
    clipped: f64,
    numbers: usize,
    by: DVector<f64>,
}

impl Sums {
    fn new(columns: usize, basis: usize) -> Self {
        Self {
            squares: DMatrix::zeros(columns, columns),
            with_basis: DMatrix::zeros(basis, columns),
            with_residuals: DVector::zeros(columns),
            with_clipped: DVector::zeros(columns),
        }
    }

    /// Adds the equations of a row, whose columns these are.
    fn add(&mut self, columns: &DMatrix<f64>, left: &Left, own: &Range<usize>) {
        let (first, count) = (own.start, own.len());
        self.squares += columns.transpose() * columns;
        self.with_basis += left.basis.rows(first, count).transpose() * columns;
        self.with_residuals += columns.transpose() * left.residuals.rows(first, count);
        self.with_clipped += columns.transpose() * left.clipped.rows(first, count);
    }

    fn gain(&self) -> Option<Gain> {
        let count = self.squares.ncols();
        let lengths = self.squares.diagonal().map(f64::sqrt);
        if lengths.iter().any(|length| *length <= 0.0) {
            return None;
        }
        let scale = |vector: &DVector<f64>| vector.component_div(&lengths);
        let mut normal = &self.squares - self.with_basis.transpose() * &self.with_basis;
        for row in 0..count {
            for column in 0..count {
                normal[(row, column)] /= lengths[row] * lengths[column];
            }
        }
        let [all, clipped] = [&self.with_residuals, &self.with_clipped].map(scale);
        let eigen = normal.symmetric_eigen();
        let mut found = Gain {
            all: 0.0,
            clipped: 0.0,
            numbers: 0,
            by: DVector::zeros(count),
        };
        for (vector, &value) in eigen.eigenvectors.column_iter().zip(&eigen.eigenvalues) {
            if value > TOLD_APART {
                let part = vector.dot(&all);
                found.all += part * part / value;
                found.clipped += vector.dot(&clipped).powi(2) / value;
                found.numbers += 1;
                found.by -= vector * (part / value);
            }
        }
        found.by = scale(&found.by);
        (found.numbers > 0).then_some(found)
    }
}

/// A change with its columns in all equations.
struct Found {
    score: f64,
    changed: Changed,
    columns: DMatrix<f64>,
}

/// The changes of all files, the surest first.
fn changes(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    values: &Values,
    kept: &[usize],
) -> Vec<Changed> {
    let equations = system.plain_equations(rows, values, false);
    let jacobian = of_unit_length(equations.jacobian.select_columns(kept));
    if jacobian.nrows() <= jacobian.ncols() + LEAST_ROWS {
        return Vec::new();
    }
    let own_of = |rows: &Range<usize>| -> Range<usize> {
        let last = rows
            .end
            .checked_sub(1)
            .and_then(|l| equations.places.get(l));
        let first = equations.places.get(rows.start);
        match (first, last) {
            (Some(first), Some(last)) => first.0..last.0 + last.1,
            _ => 0..0,
        }
    };
    // Each row as it is, and as slips count.
    let mut clipped = equations.residuals.clone();
    for (_, own) in observations.fitted() {
        let size = |row: usize| {
            let (first, count) = equations.places[row];
            equations.residuals.rows(first, count).norm()
        };
        let sizes: Vec<f64> = own.clone().map(size).collect();
        let most = CLIPPED * median(&sizes);
        for (row, size) in own.zip(sizes) {
            if size > most {
                let (first, count) = equations.places[row];
                clipped.rows_mut(first, count).scale_mut(most / size);
            }
        }
    }
    let mut left = Left {
        basis: DMatrix::zeros(jacobian.nrows(), 0),
        residuals: equations.residuals.clone(),
        clipped,
    };
    let jacobian_rows = jacobian.nrows();
    let basis = jacobian.qr().q();
    for residuals in [&mut left.residuals, &mut left.clipped] {
        *residuals -= &basis * (basis.transpose() * &*residuals);
    }
    left.basis = basis;
    // From which side an axis came is known of no row before it first moved.
    left.with(&of_unit_length(
        equations.sides.columns(jacobian_rows, false),
    ));
    let effects = effects(system, observations, rows, values, &equations);
    let mut found: Vec<Changed> = Vec::new();
    while found.len() < MOST {
        let mut best: Option<Found> = None;
        for (file, (observation, own)) in observations.fitted().enumerate() {
            let of_file = effects.iter().filter(|effect| effect.file == file);
            let mut all: Vec<Found> = Vec::new();
            for effect in of_file {
                let places = &equations.places[own.clone()];
                let search = Search {
                    left: &left,
                    observation,
                    places,
                    all: own_of(&own),
                    what: &effect.what,
                    columns: &effect.columns,
                };
                all.extend(search.jump());
                all.extend((1..=MOST_DRIFT).filter_map(|order| search.drift(order)));
            }
            let Some(mut of_file) = surest(all) else {
                continue;
            };
            of_file.changed.look_alike(&system.machine, observation);
            if best.as_ref().is_none_or(|b| of_file.score > b.score) {
                best = Some(of_file);
            }
        }
        let Some(best) = best else { break };
        left.with(&best.columns);
        found.push(best.changed);
    }
    found
}

/// The change that explains most, with others that do so as well.
fn surest(mut all: Vec<Found>) -> Option<Found> {
    /// Others explain it as well where they leave no more than so many times what it leaves.
    const ALIKE: f64 = 1.5;
    all.sort_by(|a, b| b.score.total_cmp(&a.score));
    let mut all = all.into_iter();
    let mut best = all.next()?;
    let is_alike = |other: &Found| {
        other.changed.is_jump() == best.changed.is_jump()
            && 1.0 - other.changed.explains <= ALIKE * (1.0 - best.changed.explains)
    };
    let mut others: Vec<What> = Vec::new();
    for other in all.filter(is_alike) {
        let what = other.changed.what;
        if what.kind() != best.changed.what.kind() && others.iter().all(|o| o.kind() != what.kind())
        {
            others.push(what);
        }
    }
    best.changed.or = others;
    Some(best)
}

/// Where one thing that may have changed in a file is looked for.
struct Search<'a> {
    left: &'a Left,
    observation: &'a Observation,
    /// The equations of the file's rows.
    places: &'a [(usize, usize)],
    all: Range<usize>,
    what: &'a What,
    /// How it moves the equations of the file.
    columns: &'a DMatrix<f64>,
}

impl Search<'_> {
    fn of_row(&self, row: usize) -> (Range<usize>, DMatrix<f64>) {
        let (first, count) = self.places[row];
        let columns = self.columns.rows(first - self.all.start, count);
        (first..first + count, columns.into_owned())
    }

    /// The row from which on it was another, if there is one.
    fn jump(&self) -> Option<Found> {
        let count = self.columns.ncols();
        let is_moved: Vec<bool> = (0..self.places.len())
            .map(|row| self.of_row(row).1.amax() > 0.0)
            .collect();
        let moved = is_moved.iter().filter(|moved| **moved).count();
        let mut sums = Sums::new(count, self.left.basis.ncols());
        let mut after = 0;
        let mut best: Option<(f64, usize, Gain)> = None;
        for row in (0..self.places.len()).rev() {
            let (own, columns) = self.of_row(row);
            if !is_moved[row] {
                continue;
            }
            sums.add(&columns, self.left, &own);
            after += 1;
            if after < LEAST_ROWS || after + LEAST_ROWS > moved {
                continue;
            }
            let Some(gain) = sums.gain() else { continue };
            let sure = self
                .left
                .sureness(&self.left.residuals, gain.all, gain.numbers);
            if best.as_ref().is_none_or(|(most, ..)| sure > *most) {
                best = Some((sure, row, gain));
            }
        }
        let (_, row, gain) = best?;
        let mut columns = DMatrix::zeros(self.left.basis.nrows(), count);
        for place in row..self.places.len() {
            let (own, of_row) = self.of_row(place);
            columns.rows_mut(own.start, own.len()).copy_from(&of_row);
        }
        // The row at which it begins is one more number.
        let more = 2.0 * (self.places.len() as f64).ln();
        self.found(Some(row), 0, &gain, columns, more)
    }

    /// A drift of this order.
    fn drift(&self, order: usize) -> Option<Found> {
        let rows = &self.observation.rows;
        let count = self.columns.ncols() * order;
        let times = rows.iter().map(|row| row.time);
        let [low, high] = times.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], t| {
            [low.min(t), high.max(t)]
        });
        if high <= low || rows.len() < 2 * LEAST_ROWS {
            return None;
        }
        let mut sums = Sums::new(count, self.left.basis.ncols());
        let mut columns = DMatrix::zeros(self.left.basis.nrows(), count);
        for (place, row) in rows.iter().enumerate() {
            let (own, of_row) = self.of_row(place);
            let polynomials = legendre(2.0 * (row.time - low) / (high - low) - 1.0, order);
            let mut with = DMatrix::zeros(own.len(), count);
            for (k, polynomial) in polynomials[1..=order].iter().enumerate() {
                let part = &of_row * *polynomial;
                with.columns_mut(k * of_row.ncols(), of_row.ncols())
                    .copy_from(&part);
            }
            sums.add(&with, self.left, &own);
            columns.rows_mut(own.start, own.len()).copy_from(&with);
        }
        let gain = sums.gain()?;
        self.found(None, order, &gain, columns, 0.0)
    }

    /// What was found, where it is sure and explains enough.
    fn found(
        &self,
        row: Option<usize>,
        order: usize,
        gain: &Gain,
        columns: DMatrix<f64>,
        more: f64,
    ) -> Option<Found> {
        let left = self.left;
        let sure = left.sureness(&left.residuals, gain.all, gain.numbers);
        let clipped = left.sureness(&left.clipped, gain.clipped, gain.numbers);
        let numbers = gain.numbers as f64;
        if sure.min(clipped) < BY_CHANCE + BY_CHANCE_EACH * numbers {
            return None;
        }
        let with_basis = left.basis.transpose() * &columns;
        let then = &left.residuals + (&columns - &left.basis * with_basis) * &gain.by;
        let [before, after] = [&left.residuals, &then].map(|residuals| {
            residuals
                .rows(self.all.start, self.all.len())
                .norm_squared()
        });
        let explains = 1.0 - after / before.max(f64::MIN_POSITIVE);
        let freedom = left.freedom() - numbers;
        let as_stated = then.norm_squared() < squares_by_chance(freedom);
        if explains < EXPLAINS && !as_stated {
            return None;
        }
        let what = self.what.by(&gain.by, order);
        let sizes = |equations: &DVector<f64>| -> Vec<f64> {
            let rows = self.observation.rows.iter().zip(self.places);
            rows.map(|(row, &(first, count))| {
                equations.rows(first, count).norm() * row.uncertainty_mm
            })
            .collect()
        };
        let size_mm = sizes(&(&columns * &gain.by))
            .into_iter()
            .fold(0.0, f64::max);
        let squares: f64 = sizes(&then).iter().map(|size| size * size).sum();
        let at = row.unwrap_or(0);
        Some(Found {
            score: sure - numbers * (left.basis.nrows() as f64).ln() - more,
            changed: Changed {
                file: self.observation.file.clone(),
                line: self.observation.rows.get(at).map_or(0, |row| row.line),
                row,
                order,
                what,
                or: Vec::new(),
                size_mm,
                left_mm: (squares / self.places.len().max(1) as f64).sqrt(),
                explains,
                ordered_by: Vec::new(),
            },
            columns,
        })
    }
}

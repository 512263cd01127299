//! One fit: selection of the distinguishable unknowns, the search for them, and cross-validation residuals.
//!
//! Distinguishability is decided on the ideal experiment: the same poses on a machine without errors, with readings
//! that fit it exactly. Unknowns that are separated only by the errors of the real machine are not distinguishable.
//!
//! The residuals are those of rows that are left out. Let J = QR be the equations of all rows, and Q₁ and r₁ the parts
//! of Q and of the residuals r that belong to these rows. Without these rows the unknowns θ change by R⁻¹x with x = −(I
//! − Q₁ᵀQ₁)⁻¹(Qᵀr − Q₁ᵀr₁), which needs only a small factorisation. The formula holds for unpenalised least squares, if
//! the other rows still determine all unknowns and the equations are linear within the step. Otherwise the caller fits
//! the other rows.

use volcomp_kinematics::nalgebra::{DMatrix, DVector, Vector3};
use volcomp_kinematics::{REACHED_WITHIN_MM, State};

use crate::equation::{Equations, bar, in_mm};
use crate::error::IdentifyError;
use crate::observations::{MachinePose, Observations, Row, RowReading};
use crate::params::{Param, Values};
use crate::rank::{
    LEAST_SHARE, Rank, independent, independent_without, inverse, of_unit_length, triangle,
};
use crate::solve::{Exactness, Solution, solve, spread};
use crate::system::{Rows, System};

/// Selects the distinguishable unknowns. Two kinds of unknowns are fixed at zero: the columns `without`, and reversal
/// values that affect only rows with an unknown approach direction.
pub(crate) fn distinguishable(system: &System, design: &Equations, without: &[usize]) -> Rank {
    let rank = independent_without(&design.jacobian, without);
    if !design.sides.has_unknown() {
        return rank;
    }
    let (reversals, others): (Vec<usize>, Vec<usize>) =
        (rank.kept.iter()).partition(|column| system.is_reversal(**column));
    let jacobian = &design.jacobian;
    let sides = design.sides.columns(jacobian.nrows(), true);
    let columns_of = |columns: &[usize]| jacobian.select_columns(columns);
    let all = [columns_of(&others), sides, columns_of(&reversals)];
    let columns: Vec<DVector<f64>> =
        all.iter().flat_map(|matrix| matrix.column_iter().map(Into::into)).collect();
    let place_of = |place: usize| {
        let after = place.checked_sub(others.len() + all[1].ncols());
        others.get(place).or_else(|| after.and_then(|after| reversals.get(after))).copied()
    };
    let with_sides = independent(&DMatrix::from_columns(&columns));
    let mixed = with_sides.null.iter().filter_map(|null| {
        let listed = null.iter();
        let mut own: Vec<(usize, f64)> = listed
            .filter_map(|&(place, weight)| place_of(place).map(|column| (column, weight)))
            .collect();
        let length = own.iter().map(|(_, w)| w * w).sum::<f64>().sqrt();
        for (_, weight) in &mut own {
            *weight /= length;
        }
        place_of(null[0].0).is_some_and(|first| system.is_reversal(first)).then_some(own)
    });
    let mixed: Vec<Vec<(usize, f64)>> = mixed.collect();
    if mixed.is_empty() {
        return rank;
    }
    // Columns that are already fixed at zero remain fixed.
    let left: Vec<&Vec<(usize, f64)>> = rank.null.iter().chain(&mixed).collect();
    let mut others = jacobian.clone();
    for null in &left {
        others.column_mut(null[0].0).fill(0.0);
    }
    let mut rest = independent_without(&others, without);
    for null in &mut rest.null {
        if let Some(own) = left.iter().find(|own| own[0].0 == null[0].0) {
            null.clone_from(own);
        }
    }
    rest
}

pub(crate) struct Fitted {
    pub(crate) solution: Solution,
    pub(crate) rank: Rank,
    /// Unknowns excluded from `rank` only because noise hides them.
    pub(crate) uncertain: Vec<Uncertain>,
}

pub(crate) fn fit(
    system: &System,
    observations: &Observations,
    rows: &Rows,
    values: Values,
) -> Result<Fitted, IdentifyError> {
    let design = design(system, rows, &values, system.params.len());
    let rank = distinguishable(system, &design, &[]);
    if rank.kept.len() > design.jacobian.nrows()
        || (rank.kept.len() == design.jacobian.nrows() && !rank.null.is_empty())
    {
        return Err(IdentifyError::TooFew {
            poses: rows.poses().1,
            numbers: design.jacobian.nrows(),
            unknowns: system.params.len(),
            rank: rank.kept.len(),
        });
    }
    let mut values = values;
    let is_penalised =
        |rank: &Rank| (rank.kept.iter()).any(|&column| system.group(column).is_some());
    let mut rank = rank;
    let mut uncertain: Vec<Uncertain> = Vec::new();
    // A penalty bounds the size of an unknown, so that noise cannot leave it undetermined.
    if !is_penalised(&rank) {
        let jacobian = system.equations(rows, &values).jacobian;
        while let Some(one) = Uncertain::among(system, &rank.kept, &jacobian) {
            uncertain.push(one);
            let without: Vec<usize> = uncertain.iter().map(|of| of.param).collect();
            rank = distinguishable(system, &design, &without);
        }
    }
    // The search starts with zero for unknowns that are fixed at zero.
    for left in rank.left_at_zero() {
        if let Param::Coefficient(coefficient) = system.params.at(left) {
            values.coefficients[coefficient] = 0.0;
        }
    }
    let solution = solve(
        system,
        rows,
        values,
        &rank.kept,
        observations.robust,
        is_penalised(&rank),
        Exactness::Full,
    )?;
    Ok(Fitted { solution, rank, uncertain })
}

/// Equations of the ideal experiment, with the derivatives by the first `columns` parameters.
pub(crate) fn design(system: &System, rows: &Rows, values: &Values, columns: usize) -> Equations {
    let ideal: Vec<Row> = rows.iter().map(|row| ideal_row(system, row, values)).collect();
    system.equations_in(columns, &system.prepare(ideal.iter()), values, true)
}

/// A row with the linear axes moved to where the ideal machine would measure its sphere or ball; other rows are unchanged.
fn ideal_row(system: &System, row: &Row, values: &Values) -> Row {
    let mut ideal = row.clone();
    let centre = match &row.reading {
        RowReading::Sphere { centre, .. } => values.points[*centre][0],
        RowReading::Ball { origin, tilts, distance, axes, .. } => {
            // The point is on the nominal bar. At a point off the bar, a rotation of the bar and a rotation of the
            // machine would be distinguishable.
            let along = bar(axes, tilts.map(|tilt| values.numbers[tilt][0])).along;
            values.points[*origin][0] + along * values.numbers[*distance][0]
        }
        _ => return ideal,
    };
    // The linear axes move as close to the point as they can: a machine with fewer than three linear axes may not reach
    // it.
    let _ = bring(system, &mut ideal.pose, centre);
    ideal
}

/// Moves the linear axes until the tip of the ideal machine is at a point, mm in workpiece axes. Returns whether the
/// tip reached the point.
pub(crate) fn bring(system: &System, pose: &mut MachinePose, to: Vector3<f64>) -> bool {
    let chain = system.machine.chain();
    let tip_mm = pose.tip_mm;
    let tip = |state: &State| {
        let pose = MachinePose { state: *state, tip_mm };
        pose.ideal_tip_mm(chain)
    };
    chain.bring(&mut pose.state, |_| true, &to, tip) <= REACHED_WITHIN_MM
}

/// Maximum size of a machine error, mm and mrad. If noise alone gives an unknown a larger standard uncertainty, the
/// value of the unknown would be noise, and harmful if applied.
pub(crate) const LARGEST: f64 = 1.0;

#[derive(Clone, Copy, Debug)]
pub(crate) struct Uncertain {
    pub(crate) param: usize,
    /// Standard uncertainty that the unknown would have if it were kept, µm, µrad or the unit of the set-up.
    pub(crate) uncertainty: f64,
}

impl Uncertain {
    /// Selects the next kept unknown to fix at zero; `None` if all are sufficiently certain. `jacobian` has the
    /// derivatives of all readings, each divided by its uncertainty. Of several similarly uncertain unknowns the last
    /// one is selected.
    pub(crate) fn among(system: &System, kept: &[usize], jacobian: &DMatrix<f64>) -> Option<Self> {
        let own = jacobian.select_columns(kept);
        let lengths: Vec<f64> = own.column_iter().map(|column| column.norm()).collect();
        let inverse = inverse(&triangle(of_unit_length(own)))?;
        let uncertain = |place: usize| {
            let param = kept[place];
            let inside = inverse.row(place).norm() / lengths[place];
            Self { param, uncertainty: inside * system.unit_of(param).1 }
        };
        let found: Vec<Self> =
            (0..kept.len()).map(uncertain).filter(|of| of.is_hidden(system)).collect();
        let most = found.iter().map(|of| of.uncertainty).fold(0.0, f64::max);
        found.into_iter().rfind(|of| of.uncertainty >= LEAST_SHARE * most)
    }

    /// Whether the unknown is an error of the machine with an uncertainty above [`LARGEST`].
    fn is_hidden(&self, system: &System) -> bool {
        let is_error = matches!(system.params.at(self.param), Param::Coefficient(_));
        is_error && self.uncertainty > 1e3 * LARGEST
    }

    pub(crate) fn words(self, system: &System) -> String {
        let (symbol, largest) = match system.unit_of(self.param).0 {
            "urad" => ("µrad", "mrad"),
            _ => ("µm", "mm"),
        };
        format!(
            "{} is not determined: with the stated noise its standard uncertainty would be {:.0} {symbol}, more than {LARGEST} {largest}, the largest error of a real machine: it is left at zero",
            system.name(self.param),
            self.uncertainty
        )
    }
}

/// Maximum difference, within the step, between the residuals of the equations and of the linearised equations, mm.
const LINEAR_WITHIN_MM: f64 = 1e-7;

pub(crate) struct Folds<'a> {
    system: &'a System,
    rows: &'a Rows,
    fitted: &'a Fitted,
    equations: Equations,
    q: DMatrix<f64>,
    /// Inverse of the triangular factor, R⁻¹.
    root: DMatrix<f64>,
}

impl<'a> Folds<'a> {
    /// Factorises the equations of all rows. `None` with penalties, robust weights, unknown approach directions, or unknowns that noise hides.
    pub(crate) fn new(system: &'a System, rows: &'a Rows, fitted: &'a Fitted) -> Option<Self> {
        if fitted.solution.counts_residuals || !fitted.uncertain.is_empty() {
            return None;
        }
        let mut equations = system.plain_equations(rows, &fitted.solution.values, false);
        if equations.sides.len() > 0 {
            return None;
        }
        let jacobian = equations.jacobian.select_columns(&fitted.rank.kept);
        equations.jacobian = DMatrix::zeros(0, 0);
        let root = inverse(&triangle(jacobian.clone()))?;
        Some(Self { q: jacobian * &root, system, rows, fitted, equations, root })
    }

    /// Residuals, mm, of the rows that are left out; `None` if the other rows do not determine all unknowns, or if the equations are not linear.
    pub(crate) fn left_out(&self, is_left: impl Fn(usize) -> bool) -> Option<Vec<Vector3<f64>>> {
        let (system, rank) = (self.system, &self.fitted.rank);
        let places = self.equations.places.iter().enumerate();
        let own: Vec<usize> = places
            .filter(|(row, _)| is_left(*row))
            .flat_map(|(_, &(first, count))| first..first + count)
            .collect();
        let (all, q) = (&self.equations.residuals, self.q.select_rows(&own));
        let residuals = all.select_rows(&own);
        let count = rank.kept.len();
        // Information matrix of the other rows, in coordinates in which the information matrix of all rows is the
        // identity.
        let others = DMatrix::identity(count, count) - q.transpose() * &q;
        let others_root = inverse(&others.cholesky()?.unpack().transpose())?;
        // Lower bound of the smallest eigenvalue: the other rows retain at least this fraction of the information about
        // every unknown.
        let share = 1.0 / others_root.norm_squared();
        if !rank.is_independent_with(share) {
            return None;
        }
        let root = &self.root * &others_root;
        let is_hidden = |(place, &param): (usize, &usize)| {
            let uncertainty = root.row(place).norm() * system.unit_of(param).1;
            Uncertain { param, uncertainty }.is_hidden(system)
        };
        if rank.kept.iter().enumerate().any(is_hidden) {
            return None;
        }
        let gradient = self.q.tr_mul(all) - q.tr_mul(&residuals);
        let step = -(&others_root * others_root.tr_mul(&gradient));
        let by = spread(&(&self.root * &step), &rank.kept, system.params.len(), 1.0);
        let values = self.fitted.solution.values.moved(&system.params, &by);
        let left = self.rows.only(is_left);
        let mut equations = system.equations_in(0, &left, &values, false);
        let found = in_mm(&left, &equations);
        let linear = residuals + q * step;
        equations.residuals.rows_mut(0, own.len()).copy_from(&linear);
        let linear = in_mm(&left, &equations);
        let is_linear = |(a, b): (&Vector3<f64>, &Vector3<f64>)| (a - b).norm() <= LINEAR_WITHIN_MM;
        found.iter().zip(&linear).all(is_linear).then_some(found)
    }
}

#[cfg(test)]
mod tests {
    use std::fmt::Write as _;
    use std::path::Path;

    use super::{fit, *};
    use crate::observations::Observations;
    use crate::params::Values;
    use crate::start::start;

    const MACHINE: &str = "structure = \"w b X Y Z C t\"
    axes.X.travel = [0.0, 2000.0]
    axes.Y.travel = [0.0, 1000.0]
    axes.Z.travel = [0.0, 700.0]
    axes.C.travel = [-180.0, 180.0]
    ";
    const POSES: u32 = 80;
    const FOLDS: usize = 4;

    /// A target 250 mm from the axis C, with errors of some 10 µm; `c_deg` turns the axis C at a row.
    fn observations(keys: &str, c_deg: impl Fn(u32) -> f64) -> Observations {
        let mut text = String::from("X,Y,Z,C,x,y,z\n");
        for k in 1..=POSES {
            let at = |travel: f64, step: f64| travel * (f64::from(k) * step).fract();
            let q = [at(2000.0, 0.618), at(1000.0, 0.755), at(700.0, 0.57)];
            let c = c_deg(k);
            let (sin, cos) = c.to_radians().sin_cos();
            let noise = |step: f64| 0.005 * (f64::from(k) * step).sin();
            let seen = [
                q[0] + 250.0 * cos + 0.03 * (q[0] / 400.0).sin() + noise(12.9),
                q[1] + 250.0 * sin + 2e-5 * q[0] + noise(78.2),
                q[2] + 0.02 * (q[2] / 200.0).cos() + noise(37.7),
            ];
            for number in q.iter().chain(&[c]).chain(&seen[..2]) {
                let _ = write!(text, "{number:?},"); // writing to a String cannot fail
            }
            let _ = writeln!(text, "{:?}", seen[2]);
        }
        let keys = format!(
            "machine = \"machine.toml\"\n{keys}\nunknown = [\"EC0Y\", \"EA0Z\", \"EB0Z\", \"EA0C\", \"EB0C\", {{ error = \"EXX\", legendre = 3 }}, {{ error = \"ECX\", legendre = 2 }}, {{ error = \"EZZ\", legendre = 3 }}]\n[[observation]]\nkind = \"points\"\nfile = \"rows.csv\"\ntarget = \"unknown\"\nuncertainty_um = 5.0\n"
        );
        let read = |path: &Path| {
            let is_machine = path.ends_with("machine.toml");
            Ok(if is_machine { MACHINE } else { &text }.to_owned())
        };
        Observations::parse(&keys, Path::new("o.toml"), &read).expect("observations")
    }

    fn fitted(observations: &Observations) -> (System, Rows, Values, Fitted) {
        let system = System::new(observations).expect("a system");
        let rows = system.prepare(observations.fitted_rows());
        let values = start(&system, observations, &rows).expect("start values");
        let fitted = fit(&system, observations, &rows, values.clone()).expect("a fit");
        (system, rows, values, fitted)
    }

    #[test]
    fn residuals_of_rows_left_out_are_those_of_a_fit_to_the_others() {
        let observations = observations("", |k| 360.0 * (f64::from(k) * 0.819).fract() - 180.0);
        let (system, rows, values, all) = fitted(&observations);
        let folds = Folds::new(&system, &rows, &all).expect("least squares");
        let of_all = system.residuals(&rows, &all.solution.values);
        for fold in 0..FOLDS {
            let found = folds.left_out(|row| row % FOLDS == fold).expect("determined");
            let others = rows.only(|row| row % FOLDS != fold);
            let left = rows.only(|row| row % FOLDS == fold);
            let refitted = fit(&system, &observations, &others, values.clone()).expect("a fit");
            let expected = system.residuals(&left, &refitted.solution.values);
            assert_eq!(found.len(), expected.len());
            let largest = |other: &[Vector3<f64>]| {
                let differences = expected.iter().zip(other).map(|(a, b)| (a - b).norm());
                differences.fold(0.0, f64::max)
            };
            assert!(largest(&found) < 1e-7, "{fold}: {}", largest(&found));
            let own: Vec<Vector3<f64>> = of_all.iter().skip(fold).step_by(FOLDS).copied().collect();
            assert!(largest(&own) > 1e-4, "{fold}: {}", largest(&own));
        }
    }

    #[test]
    fn rows_that_alone_determine_an_unknown_are_not_left_out_of_the_factorisation() {
        let turned = |k: u32| if k % 4 == 1 { f64::from(k) } else { 0.0 };
        let observations = observations("", turned);
        let (system, rows, _, all) = fitted(&observations);
        let folds = Folds::new(&system, &rows, &all).expect("least squares");
        // Row indices start at 0, numbers of poses at 1.
        assert!(folds.left_out(|row| row % FOLDS == 0).is_none());
        assert!(folds.left_out(|row| row % FOLDS == 1).is_some());
    }

    #[test]
    fn penalties_and_robust_weights_need_a_fit() {
        for keys in ["robust = true", "penalty = \"auto\""] {
            let turned = |k| 360.0 * (f64::from(k) * 0.819).fract() - 180.0;
            let (system, rows, _, all) = fitted(&observations(keys, turned));
            assert!(Folds::new(&system, &rows, &all).is_none(), "{keys}");
        }
    }
}

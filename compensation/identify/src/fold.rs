//! Cross-validation residuals of rows left out of a fit, from the factorisation of the fit to all rows.
//!
//! Let J = QR be the equations of all rows, and Q₁ and r₁ the parts of Q and of the residuals r that belong to the rows
//! to be left out. Without these rows the unknowns θ change by R⁻¹x with x = −(I − Q₁ᵀQ₁)⁻¹(Qᵀr − Q₁ᵀr₁), which needs
//! only a small factorisation. The formula holds for unpenalised least squares, if the other rows still determine all
//! unknowns and the equations are linear within the step. Otherwise the caller fits the other rows.

use volcomp_kinematics::nalgebra::{DMatrix, Vector3};

use crate::{
    equation::{Equations, in_mm},
    fit::{Fitted, Uncertain},
    solve::spread,
    system::{Rows, System},
    triangle::{inverse, triangle},
};

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
    use std::{fmt::Write as _, path::Path};

    use super::*;
    use crate::{fit::fit, observations::Observations, params::Values, start::start};

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

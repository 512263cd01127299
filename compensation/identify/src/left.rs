//! What would be left of all rows if something about them were another, as far as the equations are straight.

use volcomp_kinematics::nalgebra::{DMatrix, DVector};

use crate::{identify::Fitted, prepared::Rows, solve::squares_by_chance, system::System};

/// With the cause a part of what is left without it is left, where chance does not explain the former either.
pub(crate) const BETTER: f64 = 0.25;
/// Other causes are as good where they leave no more than so many times what the best leaves.
const ALIKE: f64 = 1.5;
/// So many causes are named.
const SHOWN: usize = 3;

/// The squares of what would be left, as far as the equations are straight: a quadratic form in what is changed.
pub(crate) struct Left {
    pub(crate) now: f64,
    /// The scalar products of the changes with what is left, and with each other, beside the unknowns.
    with_rest: DVector<f64>,
    with_others: DMatrix<f64>,
    freedom: f64,
}

impl Left {
    /// Of changes of the residuals of all equations.
    pub(crate) fn new(
        system: &System,
        rows: &Rows,
        fitted: &Fitted,
        changes: &[&DVector<f64>],
    ) -> Self {
        let equations = system.equations(rows, &fitted.solution.values);
        let basis = of_unit_length(equations.jacobian.select_columns(&fitted.rank.kept));
        let basis = basis.qr().q();
        let normal = |vector: &DVector<f64>| vector - &basis * (basis.transpose() * vector);
        let residuals = normal(&equations.residuals);
        let changes: Vec<DVector<f64>> = changes.iter().map(|change| normal(change)).collect();
        Self {
            now: residuals.norm_squared(),
            with_rest: DVector::from_fn(changes.len(), |k, _| residuals.dot(&changes[k])),
            with_others: DMatrix::from_fn(changes.len(), changes.len(), |a, b| {
                changes[a].dot(&changes[b])
            }),
            freedom: fitted.solution.freedom.max(1.0),
        }
    }

    /// What is left with these changes together.
    pub(crate) fn of(&self, set: &[usize]) -> f64 {
        let mut squares = self.now;
        for &one in set {
            squares += 2.0 * self.with_rest[one];
            squares += set
                .iter()
                .map(|&other| self.with_others[(one, other)])
                .sum::<f64>();
        }
        squares.max(0.0)
    }

    /// The squares that what was stated leaves, and chance.
    fn by_chance(&self) -> f64 {
        squares_by_chance(self.freedom)
    }

    /// Whether so little is left that the changes explain what was left.
    pub(crate) fn is_good(&self, left: f64) -> bool {
        left < BETTER * BETTER * self.now || left < self.by_chance()
    }

    /// Those of some sets that are good, and nearly as good as the best.
    pub(crate) fn good(&self, sets: Vec<Vec<usize>>) -> Vec<Vec<usize>> {
        let with = sets.into_iter().map(|set| (self.of(&set), set));
        let mut good: Vec<(f64, Vec<usize>)> = with
            .filter(|(left, set)| !set.is_empty() && self.is_good(*left))
            .collect();
        good.sort_by(|a, b| a.0.total_cmp(&b.0));
        let Some(&(best, _)) = good.first() else {
            return Vec::new();
        };
        // Where the best leaves no more than was stated, the others are to leave no more, too.
        let most = if best < self.by_chance() {
            self.by_chance()
        } else {
            ALIKE * ALIKE * best
        };
        let alike = good.into_iter().filter(|(left, _)| *left <= most);
        alike.map(|(_, set)| set).take(SHOWN).collect()
    }
}

/// Columns brought to the length 1; a column of zeros stays.
pub(crate) fn of_unit_length(mut columns: DMatrix<f64>) -> DMatrix<f64> {
    for mut column in columns.column_iter_mut() {
        let length = column.norm();
        if length > 0.0 {
            column /= length;
        }
    }
    columns
}

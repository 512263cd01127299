//! One fit: selection of the distinguishable unknowns, and the search for them.
//!
//! Distinguishability is decided on the ideal experiment: the same poses on a machine without errors, with readings
//! that fit it exactly. Unknowns that are separated only by the errors of the real machine are not distinguishable.

use volcomp_kinematics::{
    REACHED_WITHIN_MM, State,
    nalgebra::{DMatrix, DVector, Vector3},
};

use crate::{
    equation::{Equations, bar},
    error::IdentifyError,
    observations::{MachinePose, Observations, Row, RowReading},
    params::{Param, Values},
    rank::{LEAST_SHARE, Rank, independent, independent_without, of_unit_length},
    solve::{Exactness, Solution, solve},
    system::{Rows, System},
    triangle::{inverse, triangle},
};

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
    pub(crate) fn is_hidden(&self, system: &System) -> bool {
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

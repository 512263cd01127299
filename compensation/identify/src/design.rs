//! The ideal experiment: the same poses on a machine without errors, with readings that fit it exactly. What cannot be
//! told apart there is told apart by the errors of the real one only in appearance.

use volcomp_kinematics::{REACHED_WITHIN_MM, State, nalgebra::Vector3};

use crate::{
    equation::bar,
    observations::{Row, Seen, Stand},
    prepared::Rows,
    system::{Equations, System},
    values::Values,
};

/// The equations of the ideal experiment.
pub(crate) fn design(system: &System, rows: &Rows, values: &Values) -> Equations {
    let ideal: Vec<Row> = rows
        .iter()
        .map(|row| ideal_row(system, row, values))
        .collect();
    system.plain_equations(&system.prepare(ideal.iter()), values, true)
}

/// A row on a sphere or a ball with the linear axes where the ideal machine would have stood.
fn ideal_row(system: &System, row: &Row, values: &Values) -> Row {
    let mut ideal = row.clone();
    let centre = match &row.seen {
        Seen::Sphere { centre, .. } => values.points[*centre][0],
        Seen::Ball {
            origin,
            tilts,
            distance,
            axes,
            ..
        } => {
            // On the bar as it lies: beside it, turning the bar and turning the machine would not be the same.
            let along = bar(axes, tilts.map(|tilt| values.numbers[tilt][0])).along;
            values.points[*origin][0] + along * values.numbers[*distance][0]
        }
        _ => return ideal,
    };
    // As near as the linear axes can: a machine with fewer than three of them stays beside it.
    let _ = bring(system, &mut ideal.stand, centre);
    ideal
}

/// Moves the linear axes until the tip of the ideal machine is at a point, mm in workpiece axes. Whether they could.
pub(crate) fn bring(system: &System, stand: &mut Stand, to: Vector3<f64>) -> bool {
    let chain = system.machine.chain();
    let tip_mm = stand.tip_mm;
    let tip = |state: &State| {
        let stand = Stand {
            state: *state,
            tip_mm,
        };
        stand.ideal_tip_mm(chain)
    };
    chain.bring(&mut stand.state, |_| true, &to, tip) <= REACHED_WITHIN_MM
}

//! By how much the coordinates of linear axes would have to be shifted in all rows of some files for them to fit.

use std::ops::Range;

use volcomp_kinematics::nalgebra::{DMatrix, DVector};
use volcomp_vocabulary::AxisKind;

use crate::{
    error::Cause,
    observations::{Observations, Row},
    rank::independent,
    start::start,
    system::System,
};

/// A step in mm that is small beside what bends, and large beside rounding.
const STEP_MM: f64 = 1e-3;
/// A shift changes where trackers stand, and this the shift: so often it is found anew.
const ROUNDS: usize = 4;
/// A shift that is smaller is none beside what is looked for, mm.
const NONE_MM: f64 = 0.1;

/// The shift of the rows of these places that leaves least beside the set-ups; `None` where there is none. A shift that the set-ups
/// take up is 0.
pub(crate) fn shifted(
    system: &System,
    observations: &Observations,
    rows: &[Row],
    places: &[Range<usize>],
) -> Option<Cause> {
    let machine = &system.machine;
    let axes = machine.axes().iter().enumerate();
    let linear: Vec<usize> = axes
        .filter(|(_, axis)| axis.name.kind() == AxisKind::Linear)
        .map(|(place, _)| place)
        .collect();
    let with = |shift: &DVector<f64>| {
        let mut rows = rows.to_vec();
        for row in places.iter().cloned().flatten() {
            for (axis, by) in linear.iter().zip(shift) {
                rows[row].stand.state.q[*axis] += by;
            }
        }
        rows
    };
    let mut shift = DVector::zeros(linear.len());
    for _ in 0..ROUNDS {
        let now = system.prepare(with(&shift).iter());
        let values = start(system, observations, &now).ok()?;
        let here = system.plain_equations(&now, &values, false);
        let set_up = here.jacobian.columns(0, system.params.setup());
        let mut columns: Vec<DVector<f64>> = set_up.column_iter().map(Into::into).collect();
        for axis in 0..linear.len() {
            let mut moved = shift.clone();
            moved[axis] += STEP_MM;
            let there =
                system.plain_equations(&system.prepare(with(&moved).iter()), &values, false);
            columns.push((there.residuals - &here.residuals) / STEP_MM);
        }
        let first = columns.len() - linear.len();
        let columns = DMatrix::from_columns(&columns);
        // What comes first is kept where two move all alike: the set-up.
        let kept = independent(&columns).kept;
        let solution = columns
            .select_columns(&kept)
            .svd(true, true)
            .solve(&-here.residuals, f64::MIN_POSITIVE)
            .ok()?;
        for (place, by) in kept.iter().zip(&solution) {
            if *place >= first {
                shift[*place - first] += by;
            }
        }
    }
    let large = linear
        .iter()
        .zip(&shift)
        .filter(|(_, by)| by.abs() > NONE_MM);
    #[expect(
        clippy::cast_possible_truncation,
        reason = "µm of a machine, and saturating"
    )]
    let shifts: Vec<_> = large
        .map(|(axis, by)| (machine.axes()[*axis].name, (by * 1e3).round() as i64))
        .collect();
    (!shifts.is_empty()).then_some(Cause::Shifted(shifts))
}

#[cfg(test)]
mod tests {
    use volcomp_model::Machine;

    use super::*;
    use crate::{
        causes::with_cause,
        observations::{Seen, Stand},
    };

    #[test]
    fn a_shift_moves_the_axes_that_it_names() {
        let machine = "structure = \"w b X Y Z t\"\naxes.X.travel = [0, 500]\naxes.Y.travel = [0, 500]\naxes.Z.travel = [0, 500]\n";
        let machine = Machine::parse(machine, "machine").expect("a machine");
        let row = Row {
            line: 2,
            stand: Stand {
                state: machine.state(&[]).expect("a state"),
                tip_mm: machine.chain().tool_tip_mm(),
            },
            seen: Seen::Sphere {
                centre: 0,
                offset_mm: volcomp_kinematics::nalgebra::Vector3::zeros(),
            },
            run: None,
            time: 0.0,
            uncertainty_mm: 1e-3,
        };
        let axes = [
            volcomp_vocabulary::AxisName::X,
            volcomp_vocabulary::AxisName::Z,
        ];
        let cause = Cause::Shifted(vec![(axes[0], -12_500), (axes[1], 80_000)]);
        let moved = with_cause(&row, &cause, &machine);
        assert_eq!(moved.stand.state.q[..3], [-12.5, 0.0, 80.0]);
    }
}

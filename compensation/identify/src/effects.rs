//! By how much each coefficient moves the tip in the workspace: a measure in which µm and µrad can be compared.

use volcomp_kinematics::{
    State,
    nalgebra::{DVector, Vector3},
};
use volcomp_vocabulary::{AxisKind, Displacement};

use crate::{
    observations::{Row, Seen, Stand},
    system::System,
    values::Values,
};

/// Shares of the travel, and of one turn of an axis that turns all the way round: of linear axes the ends and the middle; of rotary
/// axes at uneven distances, so that no wave of a Fourier series is zero at all of them.
const LINEAR: [f64; 3] = [0.0, 0.5, 1.0];
const ROTARY: [f64; 4] = [0.0, 0.27, 0.53, 0.81];

/// The largest displacement of the tip, mm, by one unit (mm or rad) of every parameter over a grid of the travels; 0 for
/// set-ups.
pub(crate) fn largest_effects(system: &System, values: &Values) -> DVector<f64> {
    let machine = &system.machine;
    let mut states = vec![State::default()];
    for (place, axis) in machine.axes().iter().enumerate() {
        let [low, high] = axis.all_poses();
        let shares: &[f64] = match axis.name.kind() {
            AxisKind::Linear => &LINEAR,
            AxisKind::Rotary => &ROTARY,
        };
        let at = |share: &f64| {
            let at = low + share * (high - low);
            Displacement::from_coordinate(axis.name.kind(), at).mm_or_rad()
        };
        let with = |state: &State| {
            let mut states = vec![*state; shares.len()];
            for (state, share) in states.iter_mut().zip(shares) {
                state.q[place] = at(share);
            }
            states
        };
        states = states.iter().flat_map(with).collect();
    }
    let mut tips = vec![machine.chain().tool_tip_mm()];
    tips.extend(
        machine
            .tools()
            .keys()
            .filter_map(|name| machine.tip_of(name).ok()),
    );
    let poses = states
        .iter()
        .flat_map(|state| tips.iter().map(move |tip_mm| (*state, *tip_mm)));
    let rows: Vec<Row> = poses
        .map(|(state, tip_mm)| Row {
            line: 0,
            stand: Stand { state, tip_mm },
            // What is seen there is not asked for.
            seen: Seen::Line {
                direction: Vector3::x(),
                offset: 0,
                slope: 0,
                deviation_mm: 0.0,
            },
            run: None,
            time: 0.0,
            uncertainty_mm: 1.0,
        })
        .collect();
    let mut largest = DVector::zeros(system.params.len());
    for row in &system.prepare(rows.iter()).0 {
        for (coefficient, moved) in system.moved_by(&row.stand, values) {
            let size: &mut f64 = &mut largest[system.params.setup() + coefficient];
            *size = size.max(moved.norm());
        }
    }
    largest
}

//! Rows with what of them does not change while the parameters do.

use std::collections::BTreeMap;

use volcomp_kinematics::{ErrorMotion, ErrorSource, nalgebra::Vector3};
use volcomp_model::Temperatures;
use volcomp_vocabulary::{Direction, Displacement, MAX_AXES};

use crate::{
    coefficients::Role,
    derivatives::{Errors, component_of},
    observations::{Row, Seen, Stand},
    system::System,
};

/// Coordinates that differ by less are those of one pose, mm or deg.
const SAME_POSE: f64 = 1e-6;

/// A pose with what of it does not change while the parameters do.
#[derive(Clone, Debug)]
pub(crate) struct PreparedStand {
    pub(crate) stand: Stand,
    /// Coordinates, mm or deg; of an axis with a `modulo` within one turn from 0.
    within_turn: [f64; MAX_AXES],
    /// The errors that are known, unknown location errors as zero.
    pub(crate) known: Errors,
    /// Axis, component, coefficient and what one unit of it makes.
    pub(crate) terms: Vec<(usize, usize, usize, f64)>,
    /// The axes of which it is not known from which side they came.
    pub(crate) sides: Vec<UnknownSide>,
}

/// An axis of which it is not known from which side it came, and what more its errors are where it came in the positive direction.
#[derive(Clone, Debug)]
pub(crate) struct UnknownSide {
    pub(crate) axis: usize,
    /// Of the errors that are known.
    pub(crate) known: ErrorMotion,
    /// Component and coefficient of each unknown reversal value, of which it is half.
    pub(crate) unknown: Vec<(usize, usize)>,
}

/// The cells of a grid over the coordinates in which a pose of the same coordinates may be: one, and more where one is nearly at
/// the border. Poses in no common cell differ.
#[expect(
    clippy::cast_possible_truncation,
    reason = "a number beyond all cells is in the last one"
)]
fn cells(at: &[f64; MAX_AXES]) -> Vec<[i64; MAX_AXES]> {
    /// Cells are much wider than what makes another pose, so that few poses are near a border.
    const WIDTH: f64 = 1e3 * SAME_POSE;
    /// Coordinates are round numbers as a rule: borders are none.
    const BORDER: f64 = 0.381_966;
    let mut cells = vec![[0; MAX_AXES]];
    for (axis, at) in at.iter().enumerate() {
        let [low, high] =
            [-1.0, 1.0].map(|side| ((at + side * SAME_POSE) / WIDTH + BORDER).floor() as i64);
        for cell in &mut cells {
            cell[axis] = low;
        }
        if high != low {
            let mut others = cells.clone();
            for cell in &mut others {
                cell[axis] = high;
            }
            cells.extend(others);
        }
    }
    cells
}

/// A row with its poses and, mm, the tip of the ideal machine.
#[derive(Clone, Debug)]
pub(crate) struct PreparedRow {
    pub(crate) row: Row,
    pub(crate) stand: PreparedStand,
    pub(crate) from: Option<PreparedStand>,
    pub(crate) ideal_mm: Vector3<f64>,
}

/// The rows of a system, prepared.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rows(pub(crate) Vec<PreparedRow>);

impl Rows {
    pub(crate) fn len(&self) -> usize {
        self.0.len()
    }

    pub(crate) fn get(&self, place: usize) -> &Row {
        &self.0[place].row
    }

    pub(crate) fn iter(&self) -> impl Iterator<Item = &Row> {
        self.0.iter().map(|row| &row.row)
    }

    /// At which pose the machine stood in each row, counted from 0, and how many poses there are. Rows whose axes stand
    /// within 1e-6 mm or deg are of one pose, and so are those a turn of a `modulo` apart.
    pub(crate) fn poses(&self) -> (Vec<usize>, usize) {
        let mut poses: Vec<&[f64; MAX_AXES]> = Vec::new();
        let mut near: BTreeMap<[i64; MAX_AXES], Vec<usize>> = BTreeMap::new();
        let mut pose_of = Vec::with_capacity(self.len());
        for row in &self.0 {
            let at = &row.stand.within_turn;
            let is_same = |place: &usize| {
                let mut both = poses[*place].iter().zip(at);
                both.all(|(a, b)| (a - b).abs() < SAME_POSE)
            };
            let cells = cells(at);
            let known = cells.iter().filter_map(|cell| near.get(cell)).flatten();
            let same = known.copied().filter(is_same).min();
            let place = same.unwrap_or(poses.len());
            pose_of.push(place);
            if same.is_none() {
                poses.push(at);
                for cell in cells {
                    near.entry(cell).or_default().push(place);
                }
            }
        }
        (pose_of, poses.len())
    }

    /// Only these rows.
    pub(crate) fn only(&self, keep: impl Fn(usize) -> bool) -> Self {
        let kept = self.0.iter().enumerate().filter(|(place, _)| keep(*place));
        Self(kept.map(|(_, row)| row.clone()).collect())
    }
}

impl System {
    /// Prepares rows: their known errors and the modes at their coordinates.
    pub(crate) fn prepare<'r>(&self, rows: impl Iterator<Item = &'r Row>) -> Rows {
        let prepared = rows.map(|row| PreparedRow {
            row: row.clone(),
            stand: self.prepare_stand(&row.stand),
            from: match &row.seen {
                Seen::Pair { from, .. } => Some(self.prepare_stand(from)),
                _ => None,
            },
            ideal_mm: row.stand.ideal_tip_mm(self.machine.chain()),
        });
        Rows(prepared.collect())
    }

    fn prepare_stand(&self, stand: &Stand) -> PreparedStand {
        let source = self.machine.source(&Temperatures::default());
        let mut known = Errors::default();
        for axis in 0..self.machine.axes().len() {
            known.motion[axis] = source.error_motion(axis, &stand.state);
            known.location[axis] = source.location(axis);
            known.assembly[axis] = source.assembly(axis);
        }
        for &(axis, component, _) in &self.unknowns.locations {
            *component_of(&mut known.location[axis], component) = 0.0;
        }
        let at = self.machine.curve_coordinates(&stand.state);
        let modes: Vec<Vec<f64>> = self
            .unknowns
            .curves
            .iter()
            .map(|u| {
                u.modes
                    .as_ref()
                    .map_or_else(Vec::new, |m| m.values(at[u.axis]))
            })
            .collect();
        let products: Vec<Vec<f64>> = self
            .unknowns
            .curves
            .iter()
            .zip(&modes)
            .map(|(u, own)| {
                u.products
                    .as_ref()
                    .map_or_else(Vec::new, |p| p.values(own, at[p.axis()]))
            })
            .collect();
        let mut terms = Vec::new();
        for (place, coefficient) in self.unknowns.coefficients.iter().enumerate() {
            let axis = self.unknowns.curves[coefficient.curve].axis;
            let value = match coefficient.role {
                Role::Location => continue,
                Role::Mode(mode) => modes[coefficient.curve][mode],
                Role::Product(place) => products[coefficient.curve][place],
                Role::Reversal => 0.5 * stand.state.approach[axis].map_or(0.0, Direction::sign),
            };
            if value != 0.0 {
                terms.push((axis, coefficient.error.component.index(), place, value));
            }
        }
        let mut within_turn = [0.0; MAX_AXES];
        let axes = self.machine.axes().iter().zip(&stand.state.q);
        for ((axis, &q), place) in axes.zip(&mut within_turn) {
            let at = Displacement::new(axis.name.kind(), q).mm_or_deg();
            let turns = axis
                .modulo
                .map_or(0.0, |turn| turn * ((at + SAME_POSE) / turn).floor());
            *place = at - turns;
        }
        let mut prepared = PreparedStand {
            stand: *stand,
            within_turn,
            known,
            terms,
            sides: self.unknown_sides(stand),
        };
        self.follow(&mut prepared);
        prepared
    }

    /// The axes of a pose of which it is not known from which side they came.
    fn unknown_sides(&self, stand: &Stand) -> Vec<UnknownSide> {
        let source = self.machine.source(&Temperatures::default());
        let axes = 0..self.machine.axes().len();
        axes.filter(|axis| stand.state.approach[*axis].is_none())
            .map(|axis| {
                let mut forward = stand.state;
                forward.approach[axis] = Some(Direction::Positive);
                let [from, to] = [&stand.state, &forward].map(|at| source.error_motion(axis, at));
                let listed = self.unknowns.coefficients.iter().enumerate();
                let own = listed.filter(|(_, coefficient)| {
                    coefficient.role == Role::Reversal
                        && self.unknowns.curves[coefficient.curve].axis == axis
                });
                UnknownSide {
                    axis,
                    known: ErrorMotion {
                        linear_mm: to.linear_mm - from.linear_mm,
                        angular_rad: to.angular_rad - from.angular_rad,
                    },
                    unknown: own
                        .map(|(place, coefficient)| (coefficient.error.component.index(), place))
                        .collect(),
                }
            })
            .collect()
    }
}

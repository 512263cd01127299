//! The unknowns and their machine, and the rows of observations prepared for the search.
//!
//! The part of each row that does not depend on the parameters is computed once.
//!
//! Followers are errors of the machine that change with an unknown, because they were fitted to readings that contain
//! the unknown (variable projection: G. H. Golub, V. Pereyra, SIAM Journal on Numerical Analysis 10, 1973).

use std::collections::BTreeMap;

use volcomp_kinematics::{ErrorMotion, ErrorSource, State, nalgebra::Vector3};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::{Component, Direction, Displacement, MAX_AXES};

use crate::checks::check;
use crate::coefficients::{Coefficient, Role, Unknowns, micro};
use crate::derivatives::{Errors, component_of};
use crate::error::IdentifyError;
use crate::observations::{MachinePose, Observations, Part, Row, RowReading, SetUp};
use crate::params::{self, Param, Parameter, Params, Values};

#[derive(Clone, Debug)]
pub(crate) struct System {
    pub(crate) machine: Machine,
    pub(crate) params: Params,
    pub(crate) unknowns: Unknowns,
    pub(crate) groups: usize,
    pub(crate) setup: SetUp,
    /// Dependences of known errors on unknowns: index of the coefficient of the unknown, and its follower.
    followers: Vec<(usize, Follower)>,
    /// Location errors that follow an unknown: axis, component, index of the coefficient, and change per unit of the
    /// coefficient.
    pub(crate) following_locations: Vec<(usize, usize, usize, f64)>,
}

impl System {
    /// Whether the coefficient of a column is fixed at zero by convention if the observations do not determine it; see
    /// [`Unknowns::is_convention`]. `None` for a column of a set-up.
    pub(crate) fn is_convention(&self, column: usize) -> Option<bool> {
        match self.params.at(column) {
            Param::Coefficient(place) => Some(self.unknowns.is_convention(place)),
            Param::SetUp { .. } => None,
        }
    }

    pub(crate) fn is_reversal(&self, column: usize) -> bool {
        matches!(self.params.at(column), Param::Coefficient(place)
            if self.unknowns.coefficients[place].role == Role::Reversal)
    }

    pub(crate) fn new(observations: &Observations) -> Result<Self, IdentifyError> {
        check(observations)?;
        let mut machine = observations.machine.clone();
        let unknowns = Unknowns::new(observations, &mut machine)?;
        // If curves have penalties, the drifts of set-ups have penalties as well.
        let drifts = if unknowns.groups > 0 { DRIFT_GROUPS } else { 0 };
        Ok(Self {
            machine,
            params: Params::new(&observations.setup, unknowns.coefficients.len()),
            groups: unknowns.groups + drifts,
            unknowns,
            setup: observations.setup.clone(),
            followers: Vec::new(),
            following_locations: Vec::new(),
        })
    }

    pub(crate) fn start(&self) -> Values {
        let stated = |c: &Coefficient| match c.role {
            Role::Location => {
                let value = self.machine.locations().get(&c.error);
                value.map_or(0.0, |value| value / micro(c.error.component))
            }
            _ => 0.0,
        };
        let coefficients = self.unknowns.coefficients.iter().map(stated);
        Values::stated(&self.setup, coefficients.collect())
    }

    pub(crate) fn group(&self, param: usize) -> Option<(usize, f64)> {
        match self.params.at(param) {
            Param::Coefficient(coefficient) => self.unknowns.coefficients[coefficient].group,
            Param::SetUp { order: 0, .. } => None,
            Param::SetUp { part, place, order } => {
                let first = match part {
                    Part::Frame(_) => 0,
                    Part::Point(_) => 6,
                    Part::Number(_) => 9,
                };
                let weight = (order as f64).powi(2);
                let is_penalised = self.groups > self.unknowns.groups;
                is_penalised.then_some((self.unknowns.groups + first + place, weight))
            }
        }
    }

    pub(crate) fn name(&self, param: usize) -> String {
        match self.params.at(param) {
            Param::Coefficient(coefficient) => self.unknowns.coefficients[coefficient].name.clone(),
            Param::SetUp { part, place, order } => params::name_of(&self.setup, part, place, order),
        }
    }

    /// Unit of a parameter in results, and the factor from mm or rad to this unit.
    pub(crate) fn unit_of(&self, param: usize) -> (&'static str, f64) {
        match self.params.at(param) {
            Param::Coefficient(coefficient) => {
                let component = self.unknowns.coefficients[coefficient].error.component;
                (component.unit(), micro(component))
            }
            Param::SetUp { part, place, order } => params::unit_of(&self.setup, part, place, order),
        }
    }
}

/// Number of penalty groups of drifts: six components of frames, three of points, one of numbers.
const DRIFT_GROUPS: usize = 10;

/// Coordinates that differ by less belong to one pose, mm or deg.
const SAME_POSE: f64 = 1e-6;

#[derive(Clone, Debug)]
pub(crate) struct PreparedPose {
    pub(crate) pose: MachinePose,
    /// Coordinates, mm or deg; the coordinate of an axis with a `modulo` is within one turn, from 0.
    within_turn: [f64; MAX_AXES],
    /// Known errors, mm and rad; unknown location errors count as zero.
    pub(crate) known: Errors,
    /// Effects of the coefficients at this pose: axis, component, coefficient, and error per unit of the coefficient.
    pub(crate) terms: Vec<(usize, usize, usize, f64)>,
    pub(crate) sides: Vec<UnknownSide>,
}

/// An axis whose approach direction is unknown, and the change of its errors from the mean of both directions if the
/// axis approached in the positive direction.
#[derive(Clone, Debug)]
pub(crate) struct UnknownSide {
    pub(crate) axis: usize,
    pub(crate) known: ErrorMotion,
    /// Component and coefficient of each unknown reversal value, half of which is added.
    pub(crate) unknown: Vec<(usize, usize)>,
}

/// Grid cells that may contain a pose with the same coordinates: one cell, or more if a coordinate is close to a
/// border. Poses without a common cell differ.
#[expect(clippy::cast_possible_truncation, reason = "a number beyond all cells is in the last one")]
fn cells(at: &[f64; MAX_AXES]) -> Vec<[i64; MAX_AXES]> {
    /// Width of a cell: much larger than the tolerance on a pose, so that few poses are close to a border.
    const WIDTH: f64 = 1e3 * SAME_POSE;
    /// Offset of the borders in cells: coordinates are usually round numbers, which must not lie on a border.
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

/// A row with its prepared poses and the tip of the ideal machine, mm.
#[derive(Clone, Debug)]
pub(crate) struct PreparedRow {
    pub(crate) row: Row,
    pub(crate) pose: PreparedPose,
    pub(crate) from: Option<PreparedPose>,
    pub(crate) ideal_mm: Vector3<f64>,
}

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

    /// Index of the pose of each row, from 0, and the number of poses. Rows whose axes agree within 1e-6 mm or deg
    /// share a pose; whole turns of an axis with `modulo` do not matter.
    pub(crate) fn poses(&self) -> (Vec<usize>, usize) {
        let mut poses: Vec<&[f64; MAX_AXES]> = Vec::new();
        let mut near: BTreeMap<[i64; MAX_AXES], Vec<usize>> = BTreeMap::new();
        let mut pose_of = Vec::with_capacity(self.len());
        for row in &self.0 {
            let at = &row.pose.within_turn;
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

    pub(crate) fn only(&self, keep: impl Fn(usize) -> bool) -> Self {
        let kept = self.0.iter().enumerate().filter(|(place, _)| keep(*place));
        Self(kept.map(|(_, row)| row.clone()).collect())
    }
}

impl System {
    pub(crate) fn prepare<'r>(&self, rows: impl Iterator<Item = &'r Row>) -> Rows {
        let prepared = rows.map(|row| PreparedRow {
            row: row.clone(),
            pose: self.prepare_pose(&row.pose),
            from: match &row.reading {
                RowReading::Pair { from, .. } => Some(self.prepare_pose(from)),
                _ => None,
            },
            ideal_mm: row.pose.ideal_tip_mm(self.machine.chain()),
        });
        Rows(prepared.collect())
    }

    fn prepare_pose(&self, pose: &MachinePose) -> PreparedPose {
        let source = self.machine.source(&Temperatures::default());
        let mut known = Errors::default();
        for axis in 0..self.machine.axes().len() {
            known.motion[axis] = source.error_motion(axis, &pose.state);
            known.location[axis] = source.location(axis);
            known.assembly[axis] = source.assembly(axis);
        }
        for &(axis, component, _) in &self.unknowns.locations {
            *component_of(&mut known.location[axis], component) = 0.0;
        }
        let at = self.machine.curve_coordinates(&pose.state);
        let modes: Vec<Vec<f64>> = self
            .unknowns
            .curves
            .iter()
            .map(|u| u.modes.as_ref().map_or_else(Vec::new, |m| m.values(at[u.axis])))
            .collect();
        let products: Vec<Vec<f64>> = self
            .unknowns
            .curves
            .iter()
            .zip(&modes)
            .map(|(u, own)| {
                u.products.as_ref().map_or_else(Vec::new, |p| p.values(own, at[p.axis()]))
            })
            .collect();
        let mut terms = Vec::new();
        for (place, coefficient) in self.unknowns.coefficients.iter().enumerate() {
            let axis = self.unknowns.curves[coefficient.curve].axis;
            let value = match coefficient.role {
                Role::Location => continue,
                Role::Mode(mode) => modes[coefficient.curve][mode],
                Role::Product(place) => products[coefficient.curve][place],
                Role::Reversal => 0.5 * pose.state.approach[axis].map_or(0.0, Direction::sign),
            };
            if value != 0.0 {
                terms.push((axis, coefficient.error.component.index(), place, value));
            }
        }
        let mut within_turn = [0.0; MAX_AXES];
        let axes = self.machine.axes().iter().zip(&pose.state.q);
        for ((axis, &q), place) in axes.zip(&mut within_turn) {
            let at = Displacement::new(axis.name.kind(), q).mm_or_deg();
            let turns = axis.modulo.map_or(0.0, |turn| turn * ((at + SAME_POSE) / turn).floor());
            *place = at - turns;
        }
        let mut prepared = PreparedPose {
            pose: *pose,
            within_turn,
            known,
            terms,
            sides: self.unknown_sides(pose),
        };
        self.follow(&mut prepared);
        prepared
    }

    fn unknown_sides(&self, pose: &MachinePose) -> Vec<UnknownSide> {
        let source = self.machine.source(&Temperatures::default());
        let axes = 0..self.machine.axes().len();
        axes.filter(|axis| pose.state.approach[*axis].is_none())
            .map(|axis| {
                let mut forward = pose.state;
                forward.approach[axis] = Some(Direction::Positive);
                let [from, to] = [&pose.state, &forward].map(|at| source.error_motion(axis, at));
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

/// Linear dependence of the known errors of a machine on one unknown.
#[derive(Clone, Debug)]
pub struct Follower {
    parameter: String,
    /// Value of the unknown with which the machine of the observations was built, in the unit of the parameter.
    value: f64,
    /// A machine, and the same machine with the unknown increased by `by`, in the unit of the parameter.
    machines: [Machine; 2],
    by: f64,
}

impl Follower {
    /// Creates a follower of an unknown error. The present value of the unknown is the value with which the machine of
    /// the observations was built. `machines` are a machine, and the same machine with the unknown increased by `by`,
    /// in the unit of the parameter.
    ///
    /// # Errors
    /// [`IdentifyError::NotFollowing`] for a number of a set-up, for a change that is not finite or is 0, and for
    /// machines with different structures.
    pub fn new(
        parameter: &Parameter,
        machines: [Machine; 2],
        by: f64,
    ) -> Result<Self, IdentifyError> {
        let refused = |why| IdentifyError::NotFollowing { parameter: parameter.name.clone(), why };
        if parameter.error.is_none() {
            return Err(refused("it is a number of a set-up, expected an error of the machine"));
        }
        if !by.is_finite() || by == 0.0 {
            return Err(refused("expected a change that is a number and not 0"));
        }
        if machines[0].chain().structure() != machines[1].chain().structure() {
            return Err(refused("expected two machines of one structure"));
        }
        Ok(Self { parameter: parameter.name.clone(), value: parameter.value, machines, by })
    }

    /// Name of the unknown among the parameters.
    pub fn parameter(&self) -> &str {
        &self.parameter
    }

    /// Returns this follower for a machine that was built with another value of the unknown, in the unit of the parameter.
    #[must_use]
    pub fn with_value(self, value: f64) -> Self {
        Self { value, ..self }
    }

    /// Change of an error per unit of the unknown: three linear and three angular components.
    fn rate(&self, of: impl Fn(&Machine) -> ErrorMotion) -> [f64; 6] {
        let [from, to] = [&self.machines[0], &self.machines[1]].map(of);
        let (linear, angular) = (
            (to.linear_mm - from.linear_mm) / self.by,
            (to.angular_rad - from.angular_rad) / self.by,
        );
        std::array::from_fn(|k| if k < 3 { linear[k] } else { angular[k - 3] })
    }
}

impl System {
    /// Adds errors that follow the unknowns. Fails for a follower of a name that is not an unknown, or with machines of
    /// another structure.
    pub(crate) fn followed_by(mut self, followers: &[Follower]) -> Result<Self, IdentifyError> {
        let none = Temperatures::default();
        for follower in followers {
            let mut unknowns = self.unknowns.coefficients.iter();
            let Some(coefficient) = unknowns.position(|c| c.name == follower.parameter) else {
                return Err(IdentifyError::NotFollowing {
                    parameter: follower.parameter.clone(),
                    why: "it is not an unknown of the observations",
                });
            };
            if follower.machines[0].chain().structure() != self.machine.chain().structure() {
                return Err(IdentifyError::NotFollowing {
                    parameter: follower.parameter.clone(),
                    why: "its machines have another structure than that of the observations",
                });
            }
            let scale = micro(self.unknowns.coefficients[coefficient].error.component);
            let follower = Follower {
                value: follower.value / scale,
                by: follower.by / scale,
                ..follower.clone()
            };
            for axis in 0..self.machine.axes().len() {
                let rate = follower.rate(|machine| machine.source(&none).location(axis));
                for (component, rate) in rate.into_iter().enumerate() {
                    if rate != 0.0 && !self.is_unknown(axis, component, true) {
                        let by = (axis, component, coefficient, rate);
                        self.following_locations.push(by);
                    }
                }
            }
            self.followers.push((coefficient, follower));
        }
        Ok(self)
    }

    /// Removes the contribution of the followed unknowns from the known errors of a prepared pose, and adds a term for each follower.
    pub(crate) fn follow(&self, pose: &mut PreparedPose) {
        let none = Temperatures::default();
        let state: State = pose.pose.state;
        for (coefficient, follower) in &self.followers {
            for axis in 0..self.machine.axes().len() {
                let motion = |machine: &Machine| machine.source(&none).error_motion(axis, &state);
                for (component, rate) in follower.rate(motion).into_iter().enumerate() {
                    if rate != 0.0 && !self.is_unknown(axis, component, false) {
                        let known = component_of(&mut pose.known.motion[axis], component);
                        *known -= rate * follower.value;
                        let term = (axis, component, *coefficient, rate);
                        pose.terms.push(term);
                    }
                }
            }
        }
        for &(axis, component, coefficient, rate) in &self.following_locations {
            let mut followers = self.followers.iter();
            let own = followers.find(|(of, _)| *of == coefficient);
            let value = own.map_or(0.0, |(_, follower)| follower.value);
            *component_of(&mut pose.known.location[axis], component) -= rate * value;
        }
    }

    fn is_unknown(&self, axis: usize, component: usize, location: bool) -> bool {
        self.unknowns.curves.iter().any(|unknown| {
            unknown.axis == axis
                && unknown.error.location == location
                && Component::ALL.get(component) == Some(&unknown.error.component)
        })
    }
}

//! The equations: parameters, residuals and their derivatives.

use volcomp_curve::{Curve, ErrorCurve, Field};
use volcomp_kinematics::{
    ErrorMotion, ErrorSource, Pose,
    nalgebra::{DMatrix, DVector, Matrix3, Vector3},
    rotation_from_vector,
};
use volcomp_model::{Machine, Temperatures};
use volcomp_vocabulary::{Component, Direction, ErrorName};

use crate::{
    basis::{Modes, legendre},
    derivatives::{Errors, Tip, tip},
    error::IdentifyError,
    observations::{Observations, Row, Seen, Stand},
};

/// Takes the Jacobian, a column, and how one unit of its parameter moves the tip.
type Put<'p> = &'p mut dyn FnMut(&mut DMatrix<f64>, usize, Vector3<f64>);

/// What one parameter is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Param {
    /// A small displacement of a frame along an axis (0 to 2, mm) or rotation about one (3 to 5, rad).
    Frame { frame: usize, place: usize },
    /// The same, growing with a Legendre polynomial of the time.
    FrameDrift {
        frame: usize,
        order: usize,
        place: usize,
    },
    /// A coordinate of a point, mm.
    Point { point: usize, place: usize },
    /// The same, growing with a Legendre polynomial of the time.
    PointDrift {
        point: usize,
        order: usize,
        place: usize,
    },
    /// A number.
    Number { number: usize },
    /// The same, growing with a Legendre polynomial of the time.
    NumberDrift { number: usize, order: usize },
    /// A coefficient of an error.
    Coefficient { coefficient: usize },
}

/// A coefficient of an error: mm or rad inside, µm or µrad outside.
#[derive(Clone, Debug)]
pub(crate) struct Coefficient {
    pub(crate) name: String,
    pub(crate) error: ErrorName,
    /// Which curve it belongs to, by the place in [`System::unknown`].
    pub(crate) curve: usize,
    pub(crate) role: Role,
    /// The group whose penalty holds it down, and its weight there.
    pub(crate) group: Option<(usize, f64)>,
    /// What is kept first.
    rank: usize,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    Location,
    Mode(usize),
    Reversal,
}

/// An unknown error with its modes.
#[derive(Clone, Debug)]
pub(crate) struct UnknownCurve {
    pub(crate) error: ErrorName,
    pub(crate) axis: usize,
    pub(crate) modes: Option<Modes>,
}

/// A frame with its drift: the pose of the tracker in workpiece axes.
#[derive(Clone, Debug)]
pub(crate) struct Frame {
    pub(crate) pose: Pose,
    /// The point about which it turns, mm in workpiece axes: the middle of what it saw.
    pub(crate) middle_mm: Vector3<f64>,
    pub(crate) drift: Vec<[f64; 6]>,
}

/// The values of all parameters.
#[derive(Clone, Debug)]
pub(crate) struct Values {
    pub(crate) frames: Vec<Frame>,
    pub(crate) points: Vec<(Vector3<f64>, Vec<Vector3<f64>>)>,
    pub(crate) numbers: Vec<(f64, Vec<f64>)>,
    pub(crate) coefficients: Vec<f64>,
}

/// A pose with what of it does not change while the parameters do.
#[derive(Clone, Debug)]
struct PreparedStand {
    stand: Stand,
    /// The errors that are known, unknown location errors as zero.
    known: Errors,
    /// Axis, component, coefficient and what one unit of it makes.
    terms: Vec<(usize, usize, usize, f64)>,
}

#[derive(Clone, Debug)]
struct PreparedRow {
    row: Row,
    stand: PreparedStand,
    from: Option<PreparedStand>,
    ideal_mm: Vector3<f64>,
}

/// The equations of some rows.
#[derive(Clone, Debug)]
pub(crate) struct System {
    pub(crate) machine: Machine,
    pub(crate) params: Vec<Param>,
    pub(crate) coefficients: Vec<Coefficient>,
    pub(crate) unknown: Vec<UnknownCurve>,
    pub(crate) groups: usize,
    /// The first of the groups of the drifts, where penalties are chosen.
    drift_groups: Option<usize>,
    locations: Vec<(usize, usize, usize)>,
    setup: crate::observations::SetUp,
}

/// The rows of a system, prepared.
#[derive(Clone, Debug, Default)]
pub(crate) struct Rows(Vec<PreparedRow>);

/// Residuals (one to three for each row) and their derivatives, both divided by the uncertainty.
pub(crate) struct Equations {
    /// Residuals in units of their uncertainty.
    pub(crate) residuals: DVector<f64>,
    /// Their derivatives by every parameter.
    pub(crate) jacobian: DMatrix<f64>,
    /// For each row its first equation and how many it has.
    pub(crate) places: Vec<(usize, usize)>,
}

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

    /// Only these rows.
    pub(crate) fn only(&self, keep: impl Fn(usize) -> bool) -> Self {
        let kept = self.0.iter().enumerate().filter(|(place, _)| keep(*place));
        Self(kept.map(|(_, row)| row.clone()).collect())
    }
}

/// Drifts of frames in six components, of points in three, of numbers.
const DRIFT_GROUPS: usize = 10;

fn unit(place: usize) -> Vector3<f64> {
    let mut vector = Vector3::zeros();
    vector[place] = 1.0;
    vector
}

impl System {
    /// The parameters of the observations, in the order in which they are kept where some cannot be told apart:
    /// set-ups, location errors, constants, then modes by rising order.
    pub(crate) fn new(observations: &Observations) -> Result<Self, IdentifyError> {
        let mut machine = observations.machine.clone();
        let mut unknown = Vec::new();
        let mut coefficients: Vec<Coefficient> = Vec::new();
        let mut groups = 0;
        for (place, item) in observations.unknown.iter().enumerate() {
            let error = item.error;
            let axis = machine.index_of(error.axis)?;
            let add = |name: String, role, rank, group| Coefficient {
                name,
                error,
                curve: place,
                role,
                group,
                rank,
            };
            let modes = match item.basis {
                Some(basis) if !error.location => {
                    Some(Modes::new(basis, observations.range_of(axis, basis)))
                }
                _ => None,
            };
            if error.location {
                coefficients.push(add(error.to_string(), Role::Location, 0, None));
            }
            if let Some(modes) = &modes {
                let group = groups;
                let is_penalised = item.penalised && modes.len() > 1;
                groups += usize::from(is_penalised);
                for (mode, &weight) in modes.weights().iter().enumerate() {
                    let name = format!("{error} {}", modes.label(mode));
                    let group = (is_penalised && weight > 0.0).then_some((group, weight));
                    let rank = 1 + 2 * modes.order(mode);
                    coefficients.push(add(name, Role::Mode(mode), rank, group));
                }
                // Found anew; a reversal value that is not asked for stays.
                let reversal = match machine.error(error) {
                    Some(ErrorCurve::Reversal { reversal, .. }) if !item.reversal => *reversal,
                    _ => 0.0,
                };
                machine.set_error(error, constant(0.0, reversal))?;
            }
            if item.reversal {
                coefficients.push(add(format!("{error} reversal"), Role::Reversal, 2, None));
                if modes.is_none() {
                    machine.set_error(error, without_reversal(machine.error(error)))?;
                }
            }
            unknown.push(UnknownCurve { error, axis, modes });
        }
        // A set-up drifts as much as the observations say, too.
        let drift_groups = (groups > 0).then_some(groups);
        if groups > 0 {
            groups += DRIFT_GROUPS;
        }
        coefficients.sort_by_key(|coefficient| coefficient.rank);
        let mut locations = Vec::new();
        for (place, coefficient) in coefficients.iter().enumerate() {
            if coefficient.role == Role::Location {
                let axis = unknown[coefficient.curve].axis;
                locations.push((axis, coefficient.error.component.index(), place));
            }
        }
        let params = params(&observations.setup, coefficients.len());
        Ok(Self {
            machine,
            params,
            coefficients,
            unknown,
            groups,
            drift_groups,
            locations,
            setup: observations.setup.clone(),
        })
    }

    /// Parameters of the set-up stand before those of the errors.
    pub(crate) fn setup_params(&self) -> usize {
        self.params.len() - self.coefficients.len()
    }

    /// Prepares rows: their known errors and the modes at their coordinates.
    pub(crate) fn prepare<'r>(&self, rows: impl Iterator<Item = &'r Row>) -> Rows {
        let prepared = rows.map(|row| PreparedRow {
            row: row.clone(),
            stand: self.prepare_stand(&row.stand),
            from: match &row.seen {
                Seen::Pair { from, .. } => Some(self.prepare_stand(from)),
                _ => None,
            },
            ideal_mm: self
                .machine
                .chain()
                .ideal_pose(&row.stand.state)
                .transform_point(&row.stand.tip_mm)
                - self.machine.chain().workpiece_origin_mm(),
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
        for &(axis, component, _) in &self.locations {
            *component_of(&mut known.location[axis], component) = 0.0;
        }
        let at = self.machine.curve_coordinates(&stand.state);
        let modes: Vec<Vec<f64>> = self
            .unknown
            .iter()
            .map(|u| {
                u.modes
                    .as_ref()
                    .map_or_else(Vec::new, |m| m.values(at[u.axis]))
            })
            .collect();
        let mut terms = Vec::new();
        for (place, coefficient) in self.coefficients.iter().enumerate() {
            let axis = self.unknown[coefficient.curve].axis;
            let value = match coefficient.role {
                Role::Location => continue,
                Role::Mode(mode) => modes[coefficient.curve][mode],
                Role::Reversal => 0.5 * stand.state.approach[axis].map_or(0.0, Direction::sign),
            };
            if value != 0.0 {
                terms.push((axis, coefficient.error.component.index(), place, value));
            }
        }
        PreparedStand {
            stand: *stand,
            known,
            terms,
        }
    }

    /// The values at the start: what the files state, the middle of the frames at zero.
    pub(crate) fn start(&self) -> Values {
        let frames = self.setup.frames.iter().map(|frame| Frame {
            pose: pose_of(&frame.value.unwrap_or_default()),
            middle_mm: Vector3::zeros(),
            drift: vec![[0.0; 6]; frame.drift],
        });
        let points = self.setup.points.iter().map(|point| {
            let value = Vector3::from(point.value.unwrap_or_default());
            (value, vec![Vector3::zeros(); point.drift])
        });
        let numbers = self.setup.numbers.iter();
        let stated = |c: &Coefficient| match c.role {
            Role::Location => {
                let value = self.machine.locations().get(&c.error);
                value.map_or(0.0, |value| value / micro(c.error.component))
            }
            _ => 0.0,
        };
        Values {
            frames: frames.collect(),
            points: points.collect(),
            numbers: numbers
                .map(|n| (n.value.unwrap_or_default(), vec![0.0; n.drift]))
                .collect(),
            coefficients: self.coefficients.iter().map(stated).collect(),
        }
    }

    /// The residuals and their derivatives. `design`: the derivatives of the ideal machine with readings that fit it
    /// exactly, from which it is judged what can be told apart.
    pub(crate) fn equations(&self, rows: &Rows, values: &Values, design: bool) -> Equations {
        let mut places = Vec::with_capacity(rows.len());
        let mut count = 0;
        for row in &rows.0 {
            let of_row = match row.row.seen {
                Seen::Point { .. } | Seen::Sphere { .. } => 3,
                _ => 1,
            };
            places.push((count, of_row));
            count += of_row;
        }
        let mut equations = Equations {
            residuals: DVector::zeros(count),
            jacobian: DMatrix::zeros(count, self.params.len()),
            places,
        };
        for (place, row) in rows.0.iter().enumerate() {
            self.row(
                row,
                values,
                design,
                equations.places[place].0,
                &mut equations,
            );
        }
        equations
    }

    /// The residuals alone of every row, mm: three numbers, or one and two zeros.
    pub(crate) fn residuals(&self, rows: &Rows, values: &Values) -> Vec<Vector3<f64>> {
        let equations = self.equations(rows, values, false);
        let places = equations.places.iter().zip(&rows.0);
        places
            .map(|(&(first, count), row)| {
                let mut residual = Vector3::zeros();
                for k in 0..count {
                    residual[k] = equations.residuals[first + k] * row.row.uncertainty_mm;
                }
                residual
            })
            .collect()
    }

    fn tip_at(
        &self,
        stand: &PreparedStand,
        values: &Values,
        offset: &Vector3<f64>,
        design: bool,
    ) -> Tip {
        let mut errors = Errors::default();
        if !design {
            errors = stand.known;
            for &(axis, component, coefficient, value) in &stand.terms {
                *component_of(&mut errors.motion[axis], component) +=
                    value * values.coefficients[coefficient];
            }
            for &(axis, component, coefficient) in &self.locations {
                *component_of(&mut errors.location[axis], component) =
                    values.coefficients[coefficient];
            }
        }
        let chain = self.machine.chain();
        let mut tip = tip(
            chain,
            &errors,
            &stand.stand.state,
            &(stand.stand.tip_mm + offset),
        );
        tip.position_mm -= chain.workpiece_origin_mm();
        tip
    }

    #[expect(clippy::too_many_lines, reason = "one arm for each kind")]
    fn row(
        &self,
        row: &PreparedRow,
        values: &Values,
        design: bool,
        first: usize,
        equations: &mut Equations,
    ) {
        let weight = 1.0 / row.row.uncertainty_mm;
        let time = row.row.time;
        let setup = self.setup_params();
        let Equations {
            residuals,
            jacobian,
            ..
        } = equations;
        let target = match &row.row.seen {
            Seen::Point { target, .. } => *target,
            _ => None,
        };
        let offset = target.map_or_else(Vector3::zeros, |place| point_at(values, place, time));
        let tip = self.tip_at(&row.stand, values, &offset, design);
        // How one unit of each coefficient moves the tip.
        let mut by_coefficient = |stand: &PreparedStand, tip: &Tip, put: Put<'_>| {
            for &(axis, component, coefficient, value) in &stand.terms {
                let moved = tip.by_motion[axis][component] * value;
                put(jacobian, setup + coefficient, moved);
            }
            for &(axis, component, coefficient) in &self.locations {
                put(
                    jacobian,
                    setup + coefficient,
                    tip.by_location[axis][component],
                );
            }
        };
        match &row.row.seen {
            Seen::Point { frame, at_mm, .. } => {
                let place = &values.frames[*frame];
                let still = place.pose.transform_point(at_mm);
                let seen = if design {
                    tip.position_mm
                } else {
                    drifted(place, &still, time)
                };
                let lever = if design { seen } else { still } - place.middle_mm;
                let residual = tip.position_mm - seen;
                by_coefficient(&row.stand, &tip, &mut |jacobian, column, moved| {
                    for k in 0..3 {
                        jacobian[(first + k, column)] += moved[k] * weight;
                    }
                });
                for k in 0..3 {
                    residuals[first + k] = residual[k] * weight;
                }
                let polynomials = legendre(time, place.drift.len());
                // What has drifted turns what it displaces; the ideal does not drift.
                let drifts = place
                    .drift
                    .iter()
                    .filter(|_| !design)
                    .zip(&polynomials[1..]);
                let turn = drifts.fold(Vector3::zeros(), |sum: Vector3<f64>, (six, polynomial)| {
                    sum + Vector3::new(six[3], six[4], six[5]) * *polynomial
                });
                for (column, param) in self.params.iter().take(setup).enumerate() {
                    let moved = match *param {
                        Param::Frame { frame: of, place } if of == *frame => {
                            let still = frame_motion(place, &lever);
                            -still - turn.cross(&still)
                        }
                        Param::FrameDrift {
                            frame: of,
                            order,
                            place,
                        } if of == *frame => -frame_motion(place, &lever) * polynomials[order],
                        Param::PointDrift {
                            point,
                            order,
                            place,
                        } if Some(point) == target => {
                            let column: Vector3<f64> = tip.rotation.column(place).into();
                            column * legendre(time, order)[order]
                        }
                        Param::Point { point, place } if Some(point) == target => {
                            tip.rotation.column(place).into()
                        }
                        _ => continue,
                    };
                    for k in 0..3 {
                        jacobian[(first + k, column)] = moved[k] * weight;
                    }
                }
            }
            Seen::Sphere { centre, offset_mm } => {
                let residual = tip.position_mm - point_at(values, *centre, time) - offset_mm;
                by_coefficient(&row.stand, &tip, &mut |jacobian, column, moved| {
                    for k in 0..3 {
                        jacobian[(first + k, column)] += moved[k] * weight;
                    }
                });
                for k in 0..3 {
                    residuals[first + k] = residual[k] * weight;
                    self.set_point(jacobian, first + k, *centre, &-unit(k), time, weight);
                }
            }
            Seen::Distance {
                point,
                dead,
                length_mm,
            } => {
                let reach = tip.position_mm - point_at(values, *point, time);
                let along = reach.try_normalize(1e-9).unwrap_or_else(Vector3::z);
                residuals[first] =
                    (reach.norm() - number_at(values, *dead, time) - length_mm) * weight;
                by_coefficient(&row.stand, &tip, &mut |jacobian, column, moved| {
                    jacobian[(first, column)] += along.dot(&moved) * weight;
                });
                self.set_point(jacobian, first, *point, &-along, time, weight);
                self.set_number(jacobian, first, *dead, -weight, time);
            }
            Seen::Pair {
                dead, length_mm, ..
            } => {
                let Some(from) = &row.from else { return };
                let other = self.tip_at(from, values, &Vector3::zeros(), design);
                let reach = tip.position_mm - other.position_mm;
                let along = reach.try_normalize(1e-9).unwrap_or_else(Vector3::z);
                residuals[first] =
                    (reach.norm() - number_at(values, *dead, time) - length_mm) * weight;
                for (stand, tip, sign) in [(&row.stand, &tip, weight), (from, &other, -weight)] {
                    by_coefficient(stand, tip, &mut |jacobian, column, moved| {
                        jacobian[(first, column)] += along.dot(&moved) * sign;
                    });
                }
                self.set_number(jacobian, first, *dead, -weight, time);
            }
            Seen::Line {
                direction,
                offset,
                slope,
                deviation_mm,
            } => {
                let place = direction.dot(&row.ideal_mm);
                let displacement = direction.dot(&(tip.position_mm - row.ideal_mm));
                let line =
                    number_at(values, *offset, time) + number_at(values, *slope, time) * place;
                residuals[first] = (displacement - line - deviation_mm) * weight;
                by_coefficient(&row.stand, &tip, &mut |jacobian, column, moved| {
                    jacobian[(first, column)] += direction.dot(&moved) * weight;
                });
                self.set_number(jacobian, first, *offset, -weight, time);
                self.set_number(jacobian, first, *slope, -weight * place, time);
            }
        }
    }

    fn set_point(
        &self,
        jacobian: &mut DMatrix<f64>,
        row: usize,
        of: usize,
        moved: &Vector3<f64>,
        time: f64,
        weight: f64,
    ) {
        for (column, param) in self.params.iter().take(self.setup_params()).enumerate() {
            match *param {
                Param::Point { point, place } if point == of => {
                    jacobian[(row, column)] = moved[place] * weight;
                }
                Param::PointDrift {
                    point,
                    order,
                    place,
                } if point == of => {
                    jacobian[(row, column)] = moved[place] * weight * legendre(time, order)[order];
                }
                _ => {}
            }
        }
    }

    fn set_number(
        &self,
        jacobian: &mut DMatrix<f64>,
        row: usize,
        of: usize,
        moved: f64,
        time: f64,
    ) {
        for (column, param) in self.params.iter().take(self.setup_params()).enumerate() {
            match *param {
                Param::Number { number } if number == of => jacobian[(row, column)] = moved,
                Param::NumberDrift { number, order } if number == of => {
                    jacobian[(row, column)] = moved * legendre(time, order)[order];
                }
                _ => {}
            }
        }
    }

    /// The value that a penalty holds down; 0 for what none does.
    pub(crate) fn coefficient_value(&self, values: &Values, param: usize) -> f64 {
        match self.params[param] {
            Param::Coefficient { coefficient } => values.coefficients[coefficient],
            Param::FrameDrift {
                frame,
                order,
                place,
            } => values.frames[frame].drift[order - 1][place],
            Param::PointDrift {
                point,
                order,
                place,
            } => values.points[point].1[order - 1][place],
            Param::NumberDrift { number, order } => values.numbers[number].1[order - 1],
            Param::Frame { .. } | Param::Point { .. } | Param::Number { .. } => 0.0,
        }
    }

    /// The group and the weight of a parameter in the penalty.
    pub(crate) fn group(&self, param: usize) -> Option<(usize, f64)> {
        let drift = |place: usize, order: usize| {
            let weight = (order as f64).powi(2);
            self.drift_groups.map(|first| (first + place, weight))
        };
        match self.params[param] {
            Param::Coefficient { coefficient } => self.coefficients[coefficient].group,
            Param::FrameDrift { order, place, .. } => drift(place, order),
            Param::PointDrift { order, place, .. } => drift(6 + place, order),
            Param::NumberDrift { order, .. } => drift(9, order),
            Param::Frame { .. } | Param::Point { .. } | Param::Number { .. } => None,
        }
    }

    /// Values moved by a step in the parameters.
    pub(crate) fn moved(&self, values: &Values, step: &DVector<f64>) -> Values {
        let mut moved = values.clone();
        let mut turns = vec![[0.0; 6]; moved.frames.len()];
        for (param, &by) in self.params.iter().zip(step) {
            match *param {
                Param::Frame { frame, place } => turns[frame][place] += by,
                Param::FrameDrift {
                    frame,
                    order,
                    place,
                } => {
                    moved.frames[frame].drift[order - 1][place] += by;
                }
                Param::Point { point, place } => moved.points[point].0[place] += by,
                Param::PointDrift {
                    point,
                    order,
                    place,
                } => {
                    moved.points[point].1[order - 1][place] += by;
                }
                Param::Number { number } => moved.numbers[number].0 += by,
                Param::NumberDrift { number, order } => moved.numbers[number].1[order - 1] += by,
                Param::Coefficient { coefficient } => moved.coefficients[coefficient] += by,
            }
        }
        for (frame, six) in moved.frames.iter_mut().zip(turns) {
            let turn = rotation_from_vector(&Vector3::new(six[3], six[4], six[5]));
            let shift = Vector3::new(six[0], six[1], six[2]);
            frame.pose = Pose {
                rotation: turn * frame.pose.rotation,
                translation_mm: frame.middle_mm
                    + turn * (frame.pose.translation_mm - frame.middle_mm)
                    + shift,
            };
        }
        moved
    }

    /// The unit of a number of the set-up in answers.
    pub(crate) fn unit_of_number(&self, number: usize) -> (&'static str, f64) {
        let kind = self.setup.number_kinds.get(number);
        kind.map_or(("mm", 1.0), |kind| kind.unit())
    }

    /// The name of a parameter.
    pub(crate) fn name(&self, param: usize) -> String {
        const SIX: [&str; 6] = ["x", "y", "z", "a", "b", "c"];
        let setup = &self.setup;
        match self.params[param] {
            Param::Frame { frame, place } => {
                format!("{}.{}", setup.frames[frame].name, SIX[place])
            }
            Param::FrameDrift {
                frame,
                order,
                place,
            } => {
                format!("{}.{} drift {order}", setup.frames[frame].name, SIX[place])
            }
            Param::Point { point, place } => {
                format!("{}.{}", setup.points[point].name, SIX[place])
            }
            Param::PointDrift {
                point,
                order,
                place,
            } => {
                format!("{}.{} drift {order}", setup.points[point].name, SIX[place])
            }
            Param::Number { number } => setup.numbers[number].name.clone(),
            Param::NumberDrift { number, order } => {
                format!("{} drift {order}", setup.numbers[number].name)
            }
            Param::Coefficient { coefficient } => self.coefficients[coefficient].name.clone(),
        }
    }
}

/// The parameters of the set-ups and of so many coefficients.
fn params(setup: &crate::observations::SetUp, coefficients: usize) -> Vec<Param> {
    let mut params = Vec::new();
    let mut drifts = Vec::new();
    for (frame, quantity) in setup.frames.iter().enumerate() {
        if quantity.unknown {
            params.extend((0..6).map(|place| Param::Frame { frame, place }));
        }
        for order in 1..=quantity.drift {
            drifts.extend((0..6).map(|place| Param::FrameDrift {
                frame,
                order,
                place,
            }));
        }
    }
    for (number, quantity) in setup.numbers.iter().enumerate() {
        if quantity.unknown {
            params.push(Param::Number { number });
        }
        drifts.extend((1..=quantity.drift).map(|order| Param::NumberDrift { number, order }));
    }
    for (point, quantity) in setup.points.iter().enumerate() {
        if quantity.unknown {
            params.extend((0..3).map(|place| Param::Point { point, place }));
        }
        for order in 1..=quantity.drift {
            drifts.extend((0..3).map(|place| Param::PointDrift {
                point,
                order,
                place,
            }));
        }
    }
    params.extend(drifts);
    params.extend((0..coefficients).map(|coefficient| Param::Coefficient { coefficient }));
    params
}

/// How a point at a lever moves with one unit of a displacement (0 to 2) or a rotation (3 to 5).
fn frame_motion(place: usize, lever_mm: &Vector3<f64>) -> Vector3<f64> {
    if place < 3 {
        unit(place)
    } else {
        unit(place - 3).cross(lever_mm)
    }
}

/// A point seen from a frame that has drifted, mm in workpiece axes.
fn drifted(frame: &Frame, still_mm: &Vector3<f64>, time: f64) -> Vector3<f64> {
    let polynomials = legendre(time, frame.drift.len());
    let lever = still_mm - frame.middle_mm;
    let mut seen = *still_mm;
    for (six, polynomial) in frame.drift.iter().zip(&polynomials[1..]) {
        let turn = Vector3::new(six[3], six[4], six[5]);
        seen += (Vector3::new(six[0], six[1], six[2]) + turn.cross(&lever)) * *polynomial;
    }
    seen
}

fn point_at(values: &Values, place: usize, time: f64) -> Vector3<f64> {
    let (point, drift) = &values.points[place];
    let polynomials = legendre(time, drift.len());
    let moved = drift.iter().zip(&polynomials[1..]);
    moved.fold(*point, |sum, (by, polynomial)| sum + by * *polynomial)
}

fn number_at(values: &Values, place: usize, time: f64) -> f64 {
    let (number, drift) = &values.numbers[place];
    let polynomials = legendre(time, drift.len());
    let moved = drift.iter().zip(&polynomials[1..]);
    moved.fold(*number, |sum, (by, polynomial)| sum + by * polynomial)
}

/// One of the six components of an error motion.
pub(crate) fn component_of(motion: &mut ErrorMotion, component: usize) -> &mut f64 {
    if component < 3 {
        &mut motion.linear_mm[component]
    } else {
        &mut motion.angular_rad[component - 3]
    }
}

/// µm or µrad for one mm or rad of a component.
pub(crate) fn micro(component: Component) -> f64 {
    if component.is_angular() { 1e6 } else { 1e3 }
}

fn constant(value: f64, reversal: f64) -> ErrorCurve {
    let mean = Field::Curve(Curve::Constant(value));
    if reversal == 0.0 {
        ErrorCurve::Single(mean)
    } else {
        ErrorCurve::Reversal { mean, reversal }
    }
}

/// A curve whose reversal value is found anew.
fn without_reversal(curve: Option<&ErrorCurve>) -> ErrorCurve {
    match curve {
        Some(ErrorCurve::Single(field) | ErrorCurve::Reversal { mean: field, .. }) => {
            ErrorCurve::Single(field.clone())
        }
        Some(pair) => pair.clone(),
        None => constant(0.0, 0.0),
    }
}

/// A frame from x, y, z (mm) and a, b, c (deg): turned about X by a, then about the fixed Y by b, then about the
/// fixed Z by c.
pub(crate) fn pose_of(six: &[f64; 6]) -> Pose {
    let [a, b, c] = [six[3], six[4], six[5]].map(f64::to_radians);
    let about = |place: usize, angle: f64| rotation_from_vector(&(unit(place) * angle));
    Pose {
        rotation: about(2, c) * about(1, b) * about(0, a),
        translation_mm: Vector3::new(six[0], six[1], six[2]),
    }
}

/// The inverse of [`pose_of`].
pub(crate) fn six_of(pose: &Pose) -> [f64; 6] {
    let r: &Matrix3<f64> = &pose.rotation;
    let t = &pose.translation_mm;
    let b = (-r[(2, 0)]).atan2(r[(0, 0)].hypot(r[(1, 0)]));
    let a = r[(2, 1)].atan2(r[(2, 2)]);
    let c = r[(1, 0)].atan2(r[(0, 0)]);
    [
        t.x,
        t.y,
        t.z,
        a.to_degrees(),
        b.to_degrees(),
        c.to_degrees(),
    ]
}

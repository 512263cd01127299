//! Samples the errors of a machine as the tables of a control's format.

use volcomp_kinematics::{ErrorSource, State};
use volcomp_model::{Axis, Machine, Temperatures};
use volcomp_vocabulary::{
    AxisName, Component, CorrectionLimit, Direction, Displacement, ErrorName, PerAxis, brought_into,
};

use super::table::{AxisTable, Content, ErrorTable, ErrorTables, ZERO_BELOW, from_file_unit};
use super::text::{ExchangeError, Format};

const MAX_NODES: f64 = 10_000.0;

/// Options for computing tables from a machine.
#[derive(Clone, Debug, PartialEq)]
pub struct TableOptions {
    /// Node spacing along a linear axis, mm.
    pub step_mm: f64,
    /// Node spacing along a rotary axis, deg.
    pub step_deg: f64,
    /// Reference position of the axes that a table does not cover, mm or deg; axes without an entry: 0 or the nearest end of travel.
    pub at: Vec<(AxisName, f64)>,
    /// Maximum table value; larger values are rejected.
    pub limit: CorrectionLimit,
}

impl Default for TableOptions {
    /// Nodes every 50 mm and 15 deg, the other axes at 0 or the nearest end of travel, a limit of 250 µm and 250 µrad.
    fn default() -> Self {
        Self { step_mm: 50.0, step_deg: 15.0, at: Vec::new(), limit: CorrectionLimit::default() }
    }
}

impl TableOptions {
    /// Middle of the travel of each linear axis, in whole steps from 0 or the nearest end of travel, mm; rotary axes are left out.
    pub fn in_the_middle(&self, machine: &Machine) -> Vec<(AxisName, f64)> {
        let linear = machine.axes().iter().filter(|axis| !axis.name.is_rotary());
        let middle = |axis: &Axis| {
            let from = axis.nearest_zero();
            let steps = (f64::midpoint(axis.travel[0], axis.travel[1]) - from) / self.step_mm;
            let at = from + self.step_mm * steps.round();
            // If the step is longer than the travel, the result may be outside it.
            (axis.name, if axis.may_stand_at(at) { at } else { from })
        };
        linear.map(middle).collect()
    }

    /// Reference position of each axis, mm or deg, in the order of the chain.
    ///
    /// # Errors
    /// An axis does not exist, or its position is beyond its travel.
    pub fn reference(&self, machine: &Machine) -> Result<Vec<(AxisName, f64)>, ExchangeError> {
        machine.state(&self.at)?;
        let stands = |axis: &Axis| {
            let stated = self.at.iter().find(|(name, _)| *name == axis.name);
            let at = stated.map_or_else(|| axis.nearest_zero(), |(_, at)| *at);
            if axis.may_stand_at(at) {
                return Ok((axis.name, at));
            }
            let [low, high] = axis.travel;
            let expected = format!("{low} to {high}, its travel");
            Err(ExchangeError::option(format!("--at {}", axis.name), &at, expected))
        };
        machine.axes().iter().map(stands).collect()
    }
}

/// Samples a machine as tables of this format, at these temperatures and with the current tool.
///
/// For axis tables, the sum of the tables equals the model's correction at the nodes on every line through the reference position. The
/// table of one axis over another is zero at the reference position, by the mean of both directions.
///
/// # Errors
/// A step that is not positive or does not divide a turn; a reference position outside the travel or, for an axis with modulo, not at a
/// possible node of the format; a value beyond the limit.
pub fn sampled(
    machine: &Machine,
    temperatures: &Temperatures,
    options: &TableOptions,
    format: Format,
) -> Result<Content, ExchangeError> {
    for (what, step) in [("--step", options.step_mm), ("--step-deg", options.step_deg)] {
        if !(step > 0.0 && step.is_finite()) {
            return Err(ExchangeError::option(what, &step, "a number above 0"));
        }
    }
    let lines = Lines {
        machine,
        temperatures,
        options,
        format,
        reference: machine.state(&options.reference(machine)?)?,
    };
    let content = if format.holds_errors() {
        Content::Errors(lines.error_tables()?)
    } else {
        Content::Axes(lines.axis_tables()?)
    };
    match content.first_refused(|value| options.limit.allows(value)) {
        Some(entry) => Err(ExchangeError::BeyondLimit {
            limit: options.limit.of(entry.value.kind()),
            what: entry.what,
            found: entry.value,
        }),
        None => Ok(content),
    }
}

/// Table positions along each axis, mm or deg, in the order of the chain.
pub(super) fn positions(
    machine: &Machine,
    options: &TableOptions,
    format: Format,
) -> Result<Vec<Vec<f64>>, ExchangeError> {
    let lines = Lines {
        machine,
        temperatures: &Temperatures::new(),
        options,
        format,
        reference: machine.state(&options.reference(machine)?)?,
    };
    let along = |(index, axis): (usize, &Axis)| {
        let nodes = lines.nodes(axis, index)?;
        Ok(nodes.iter().map(Node::at).collect())
    };
    machine.axes().iter().enumerate().map(along).collect()
}

enum Node {
    Within(f64),
    /// A node outside the travel: extrapolated from the previous node through the end of travel, so that interpolation yields the model's value at
    /// the end.
    Beyond {
        inner: f64,
        end: f64,
        at: f64,
    },
}

impl Node {
    fn at(&self) -> f64 {
        match self {
            Self::Within(at) | Self::Beyond { at, .. } => *at,
        }
    }

    fn values<const N: usize>(&self, of: impl Fn(f64) -> [f64; N]) -> [f64; N] {
        match *self {
            Self::Within(at) => of(at),
            Self::Beyond { inner, end, at } => {
                let (near, far) = (of(inner), of(end));
                let share = (at - inner) / (end - inner);
                core::array::from_fn(|place| near[place] + share * (far[place] - near[place]))
            }
        }
    }
}

struct Lines<'a> {
    machine: &'a Machine,
    temperatures: &'a Temperatures,
    options: &'a TableOptions,
    format: Format,
    reference: State,
}

impl Lines<'_> {
    /// Nodes along an axis, mm or deg: whole steps from the reference position, which is itself a node.
    fn nodes(&self, axis: &Axis, index: usize) -> Result<Vec<Node>, ExchangeError> {
        let [low, high] = axis.travel;
        let (option, step) = if axis.name.is_rotary() {
            ("--step-deg", self.options.step_deg)
        } else {
            ("--step", self.options.step_mm)
        };
        if (high - low) / step > MAX_NODES {
            let what = format!("{option}, axis {}", axis.name);
            let travel = high - low;
            let expected = format!("a travel of {travel} in at most {MAX_NODES} steps");
            return Err(ExchangeError::option(what, &step, expected));
        }
        if let Some(period) = axis.modulo {
            let parts = (period / step).round();
            if (parts * step - period).abs() > 1e-9 * period || parts < 1.0 {
                let what = format!("{option}, axis {} with modulo", axis.name);
                let expected = format!("a whole part of {period}");
                return Err(ExchangeError::option(what, &step, expected));
            }
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "below MAX_NODES"
            )]
            let parts = parts as u32;
            let first = low + self.first_beyond(axis, index, step)?;
            return Ok((0..=parts)
                .map(|part| Node::Within(first + step * f64::from(part)))
                .collect());
        }
        let at = Displacement::new(axis.name.kind(), self.reference.q[index]).mm_or_deg();
        let whole = |length: f64| (length / step - 1e-9).ceil().max(0.0);
        let (below, above) = (whole(at - low), whole(high - at));
        #[expect(clippy::cast_possible_truncation, reason = "below MAX_NODES")]
        let (first, last) = (-(below as i32), above as i32);
        let last = if first == last { last + 1 } else { last };
        let within = |node: f64| node >= low - 1e-9 && node <= high + 1e-9;
        let node = |steps: i32| {
            let place = at + step * f64::from(steps);
            if within(place) {
                return Node::Within(place);
            }
            let (inner, end) =
                if place > high { (place - step, high) } else { (place + step, low) };
            if (end - inner).abs() < 1e-6 * step {
                // The axis has no travel, so its single value applies.
                return Node::Beyond { inner: end, end: end + step.copysign(place - end), at: end };
            }
            Node::Beyond { inner, end, at: place }
        };
        Ok((first..=last).map(node).collect())
    }

    /// Distance, mm or deg, from the lower end of travel to the first node of a turn, such that the reference position is a node. Formats other
    /// than CSV are rejected if it is not 0, because no control is known to accept tables that begin within a turn. Formats of component errors
    /// do not depend on a reference position.
    fn first_beyond(&self, axis: &Axis, index: usize, step: f64) -> Result<f64, ExchangeError> {
        if self.format.holds_errors() {
            return Ok(0.0);
        }
        let at = Displacement::new(axis.name.kind(), self.reference.q[index]).mm_or_deg();
        let low = axis.travel[0];
        let beyond = (at - low).rem_euclid(step);
        if beyond < 1e-9 * step || step - beyond < 1e-9 * step {
            return Ok(0.0);
        }
        if self.format == Format::Csv {
            return Ok(beyond);
        }
        let expected = format!(
            "whole steps of {step} from {low}, where the nodes of this format begin: else the tables are not zero there"
        );
        let what = format!("--at {}, an axis with modulo", axis.name);
        Err(ExchangeError::option(what, &at, expected))
    }

    fn axis_tables(&self) -> Result<Vec<AxisTable>, ExchangeError> {
        let machine = self.machine;
        let options = machine.correction_options();
        let correctors = options.correctors(machine.chain());
        let correction = |state: &State| -> PerAxis<f64> {
            machine.correction_at(state, self.temperatures, &options).delta
        };
        let standing = correction(&self.reference);
        let mut tables = Vec::new();
        for (input, axis) in machine.axes().iter().enumerate() {
            let nodes = self.nodes(axis, input)?;
            let along = |direction: Direction| -> Vec<PerAxis<f64>> {
                let of = |at: f64| {
                    let mut state = self.reference;
                    // Nodes over a turn may be outside the travel; the equivalent position within it is used.
                    let at = match axis.modulo {
                        Some(period) if at > axis.travel[1] => {
                            brought_into(axis.travel, period, at)
                        }
                        _ => at,
                    };
                    state.q[input] = from_file_unit(axis.name, at);
                    state.approach[input] = Some(direction);
                    correction(&state).0
                };
                nodes.iter().map(|node| PerAxis(node.values(of))).collect()
            };
            let [forward, backward] = Direction::BOTH.map(along);
            let positions = positions_of(axis, &nodes);
            for (output, other) in machine.axes().iter().enumerate() {
                if !correctors.contains(output) {
                    continue;
                }
                let base = if output == input { 0.0 } else { standing[output] };
                let values = |found: &[PerAxis<f64>]| -> Vec<f64> {
                    let of = |delta: &PerAxis<f64>| base - delta[output] + 0.0;
                    found.iter().map(of).collect()
                };
                let (mut forward, mut backward) = (values(&forward), values(&backward));
                let differ = |(a, b): (&f64, &f64)| (a - b).abs() > ZERO_BELOW;
                let has_reversal = forward.iter().zip(&backward).any(differ);
                if axis.modulo.is_some() {
                    close(&mut forward);
                    close(&mut backward);
                }
                let table = AxisTable {
                    input: axis.name,
                    output: other.name,
                    positions: positions.clone(),
                    forward,
                    backward: has_reversal.then_some(backward),
                    modulo: axis.modulo.is_some(),
                };
                if !table.is_zero() {
                    tables.push(table);
                }
            }
        }
        tables.sort_by_key(|table| (table.input.index(), table.output.index()));
        Ok(tables)
    }

    fn error_tables(&self) -> Result<ErrorTables, ExchangeError> {
        let source = self.machine.source(self.temperatures);
        let mut found = ErrorTables::default();
        for (index, axis) in self.machine.axes().iter().enumerate() {
            let nodes = self.nodes(axis, index)?;
            let of = |at: f64| {
                let mut state = self.reference;
                state.q[index] = from_file_unit(axis.name, at);
                let motion = source.error_motion(index, &state);
                let (linear, angular) = (motion.linear_mm, motion.angular_rad);
                [linear.x, linear.y, linear.z, angular.x, angular.y, angular.z]
            };
            let values: Vec<[f64; 6]> = nodes.iter().map(|node| node.values(of)).collect();
            for component in Component::ALL {
                let mut values: Vec<f64> =
                    values.iter().map(|six| six[component.index()] + 0.0).collect();
                if values.iter().all(|value| value.abs() < 1e-12) {
                    continue;
                }
                if axis.modulo.is_some() {
                    close(&mut values);
                }
                found.curves.push(ErrorTable {
                    name: ErrorName::motion(component, axis.name),
                    positions: positions_of(axis, &nodes),
                    values,
                });
            }
        }
        let location = |(name, value): (&ErrorName, &f64)| {
            let value = Displacement::from_micro(name.component.kind(), *value);
            (*name, value.mm_or_rad())
        };
        found.locations = self.machine.locations().iter().map(location).collect();
        Ok(found)
    }
}

/// Positions of nodes, mm or rad.
fn positions_of(axis: &Axis, nodes: &[Node]) -> Vec<f64> {
    let at = |node: &Node| from_file_unit(axis.name, node.at());
    nodes.iter().map(at).collect()
}

/// Copies the first value to the last node, which is the same position on a full turn.
fn close(values: &mut [f64]) {
    if let [first, .., last] = values {
        *last = *first;
    }
}

//! Errors that an uncertainty does not include because the observations do not determine them, and their effect on the
//! tool.

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_identify::{Identification, Observations, UndeterminedError, machine_with};
use volcomp_kinematics::{Form, State, nalgebra::Vector3};
use volcomp_model::{Machine, MapGrid, Temperatures};

use super::fixed;
use crate::failure::Failure;

/// An error that the observations do not determine and an uncertainty does not include, and its
/// effect on the tool for a plausible size.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub(crate) struct NotCounted {
    /// Name of the unknown, such as `ECZ legendre 1`.
    pub(crate) unknown: String,
    /// Size for which the effect is stated.
    pub(crate) size: f64,
    /// The unit of the size: `um` or `urad`.
    pub(crate) unit: &'static str,
    /// Displacement of the tool by an error of this size, µm; for a map the maximum over its nodes.
    pub(crate) moves_um: f64,
    /// Rotation of the tool by an error of this size, µrad; for a map the maximum over its nodes.
    pub(crate) turns_urad: f64,
}

/// Size of an undetermined error for which its effect is reported, µm or µrad.
const EXAMPLE: f64 = 10.0;
/// Effects on the tool below this are not printed, µm.
const NOTHING_UM: f64 = 5e-4;

/// The errors that the observations do not determine. For each of them there is a machine in which it is [`EXAMPLE`]
/// larger, and the other errors are adjusted so that the observations stay the same.
pub(crate) struct Open {
    found: Machine,
    others: Vec<(UndeterminedError, Machine)>,
}

impl Open {
    pub(crate) fn nothing(found: Machine) -> Self {
        Self { found, others: Vec::new() }
    }

    pub(crate) fn new(
        observations: &Observations,
        found: &Identification,
        machine: &Machine,
    ) -> Result<Self, Failure> {
        let with = |by: &dyn Fn(&str) -> f64| -> Result<Machine, Failure> {
            let parameters = found.parameters.iter();
            let values: Vec<(String, f64)> =
                parameters.map(|of| (of.name.clone(), of.value + by(&of.name))).collect();
            let mut made = machine_with(observations, &values)?;
            made.use_tool_of(machine)?;
            Ok(made)
        };
        let other = |open: &UndeterminedError| {
            let moved = |name: &str| {
                let own = open.moves.iter().find(|(moved, _)| moved == name);
                own.map_or(0.0, |(_, by)| EXAMPLE * by)
            };
            Ok((open.clone(), with(&moved)?))
        };
        Ok(Self {
            found: with(&|_| 0.0)?,
            others: found.undetermined.iter().map(other).collect::<Result<_, Failure>>()?,
        })
    }

    /// The largest effect of each error on the tool over these states, largest first.
    pub(crate) fn at(&self, states: &[State]) -> Vec<NotCounted> {
        let place = |machine: &Machine, state: &State| {
            let error = machine.error_at(state, Form::Exact, &Temperatures::default());
            (error.position_mm, error.rotation_rad)
        };
        let found: Vec<_> = (states.iter()).map(|state| place(&self.found, state)).collect();
        let effect = |(open, machine): &(UndeterminedError, Machine)| {
            let longest = |of: &dyn Fn((Vector3<f64>, Vector3<f64>)) -> Vector3<f64>| {
                let pairs = states.iter().zip(&found);
                let moved =
                    pairs.map(|(state, found)| (of(place(machine, state)) - of(*found)).norm());
                moved.fold(0.0, f64::max)
            };
            NotCounted {
                unknown: open.name.clone(),
                size: EXAMPLE,
                unit: open.unit,
                moves_um: 1e3 * longest(&|(position, _)| position),
                turns_urad: 1e6 * longest(&|(_, rotation)| rotation),
            }
        };
        let mut effects: Vec<NotCounted> = self.others.iter().map(effect).collect();
        effects.sort_by(|a, b| b.moves_um.total_cmp(&a.moves_um));
        effects
    }
}

/// States on a grid over all axes, with at most five nodes per axis, ends included.
pub(crate) fn all_over(machine: &Machine, grid: &MapGrid) -> Result<Vec<State>, Failure> {
    const MOST: usize = 5;
    let mut places = vec![grid.others.clone()];
    for (axis, nodes) in grid.axes.iter().zip(&grid.nodes_mm) {
        let last = nodes.len().saturating_sub(1);
        let mut own: Vec<usize> = (0..MOST).map(|k| k * last / (MOST - 1)).collect();
        own.dedup();
        let own = nodes.iter().enumerate().filter(|(node, _)| own.contains(node));
        let with = |place: &Vec<_>| {
            own.clone().map(|(_, at)| [&place[..], &[(*axis, *at)]].concat()).collect::<Vec<_>>()
        };
        places = places.iter().flat_map(with).collect();
    }
    let states = places.iter().map(|place| Ok(machine.state(place)?));
    states.collect()
}

/// Describes the errors that an uncertainty does not include; empty if none of them moves the tool.
pub(crate) fn words(not_counted: &[NotCounted], place: &str) -> String {
    const SHOWN: usize = 6;
    let moving: Vec<&NotCounted> =
        not_counted.iter().filter(|of| of.moves_um >= NOTHING_UM).collect();
    if moving.is_empty() {
        return String::new();
    }
    let mut told: Vec<String> = moving.iter().take(SHOWN).map(|of| of.words()).collect();
    if moving.len() > SHOWN {
        told.push(format!("{} more that move it by less", moving.len() - SHOWN));
    }
    format!(
        "the observations do not determine these errors, and the uncertainty does not count them; {place} they move the tool by: {}",
        told.join(", ")
    )
}

impl NotCounted {
    /// Text such as `ECZ legendre 1 2.70 µm per 10 µrad`.
    pub(crate) fn words(&self) -> String {
        let symbol = if self.unit == "urad" { "µrad" } else { "µm" };
        format!("{} {} µm per {} {symbol}", self.unknown, fixed(self.moves_um, 3), self.size)
    }
}

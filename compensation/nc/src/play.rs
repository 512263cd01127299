//! Play: an axis whose carriage stands still at first where its drive goes back.
//!
//! A reversal value has a sign. Where the carriage lags, after motion in the positive direction it is behind where it is after
//! motion in the other one: that is lost motion, and the carriage is anywhere between the two flanks, where it was left. Where
//! the sign is the other one the carriage runs ahead, as with a control that adds more at a turn than the axis loses; then the
//! error is one of two, as the direction says.

use std::sync::Arc;

use volcomp_model::{
    Machine,
    curve::ErrorCurve,
    vocabulary::{Component, Direction, ErrorName, TURNED_AFTER, TURNED_AFTER_ROTARY},
};

use crate::coordinates::{Axes, AxisPlaces, is_rotary, name_of};

/// The play of an axis is looked at in so many places of its travel.
const NODES: u32 = 33;
/// An axis with play that goes back by less, mm and deg, is not taken for turned: words round to that, and it is the most that
/// the carriage is off by then.
const LEAST: [f64; 2] = [5e-4, 1e-5];

/// The curves of an axis in its own direction, each with the share of it along the axis.
#[derive(Clone, Debug)]
struct Own {
    place: usize,
    curves: Vec<(ErrorCurve, f64)>,
    /// mm or deg for each unit of the curves.
    scale: f64,
}

/// The play of the axes of a machine.
#[derive(Clone, Debug, Default)]
pub(crate) struct Play {
    /// Of the axes that have any, somewhere.
    axes: Axes<Option<Arc<Own>>>,
    pub(crate) any: bool,
}

impl Play {
    pub(crate) fn of(machine: &Machine, places: &AxisPlaces) -> Self {
        let axes: Axes<Option<Arc<Own>>> = std::array::from_fn(|axis| {
            let own = own(machine, axis, places)?;
            let travel = machine.axis(name_of(axis)?)?.travel;
            own.is_anywhere(travel, machine.axes().len())
                .then(|| Arc::new(own))
        });
        Self {
            any: axes.iter().any(Option::is_some),
            axes,
        }
    }

    /// Whether the carriage of an axis lags.
    pub(crate) fn has(&self, axis: usize) -> bool {
        self.axes[axis].is_some()
    }

    /// How far the two flanks of an axis are from one another at these coordinates (of the model's chain), mm or deg; 0 where it has no play.
    pub(crate) fn lost(&self, axis: usize, coordinates: &[f64]) -> f64 {
        let own = self.axes[axis].as_deref();
        own.map_or(0.0, |own| own.lost(coordinates))
    }

    /// Travel against its direction after which an axis counts as turned, mm or deg.
    pub(crate) fn turned_after(&self, axis: usize) -> f64 {
        match (self.has(axis), is_rotary(axis)) {
            (true, rotary) => LEAST[usize::from(rotary)],
            (false, true) => TURNED_AFTER_ROTARY.0,
            (false, false) => TURNED_AFTER.0,
        }
    }
}

impl Own {
    fn lost(&self, coordinates: &[f64]) -> f64 {
        let value = |direction: Direction| -> f64 {
            let along = self.curves.iter().map(|(curve, share)| {
                share * curve.value(self.place, coordinates, Some(direction))
            });
            along.sum()
        };
        let lost = value(Direction::Negative) - value(Direction::Positive);
        self.scale * lost.max(0.0)
    }

    fn is_anywhere(&self, [low, high]: [f64; 2], axes: usize) -> bool {
        let mut coordinates = vec![0.0; axes];
        (0..NODES).any(|node| {
            coordinates[self.place] = low + (high - low) * f64::from(node) / f64::from(NODES - 1);
            self.lost(&coordinates) > 0.0
        })
    }
}

/// The bidirectional curves of an axis along its own direction.
fn own(machine: &Machine, axis: usize, places: &AxisPlaces) -> Option<Own> {
    const LINEAR: [Component; 3] = [Component::EX, Component::EY, Component::EZ];
    const ANGULAR: [Component; 3] = [Component::EA, Component::EB, Component::EC];
    let (name, place) = (name_of(axis)?, places.of_axis(axis)?);
    let direction = machine.chain().joints()[place].direction;
    let components = if is_rotary(axis) { ANGULAR } else { LINEAR };
    let curves = components.into_iter().zip(direction.iter());
    let curves = curves.filter_map(|(component, share)| {
        let curve = machine.error(ErrorName::motion(component, name))?;
        let counts = *share != 0.0 && !matches!(curve, ErrorCurve::Single(_));
        counts.then(|| (curve.clone(), *share))
    });
    let curves: Vec<_> = curves.collect();
    (!curves.is_empty()).then_some(Own {
        place,
        curves,
        scale: if is_rotary(axis) {
            1e-6_f64.to_degrees()
        } else {
            1e-3
        },
    })
}

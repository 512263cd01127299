//! Tables over a rotary axis: they hold 0 to 360 deg, and nothing else.

use core::f64::consts::TAU;
use std::borrow::Cow;

use volcomp_vocabulary::{AxisName, Direction, brought_into};

use super::super::{AxisTable, Written};
use super::DECIMALS;

/// Angles that are nearer to each other are one, rad.
const SAME_RAD: f64 = 1e-8;

/// Why a table is left out whose positions no control of the maker takes.
const WITHIN_A_TURN: &str = "a table over a rotary axis holds 0 to 360 deg";

/// Why a table of a turn is left out that does not begin at 0 deg.
const IN_TWO: &str = "a table over a rotary axis holds 0 to 360 deg, and its two ends, which are one position there, deviate differently";

/// Tables as the maker's controls hold them.
#[derive(Default)]
pub(super) struct Held<'a> {
    pub(super) tables: Vec<Cow<'a, AxisTable>>,
    /// The axes whose tables were brought from elsewhere to 0 … 360 deg.
    wrapped: Vec<AxisName>,
    beyond: Vec<&'a AxisTable>,
    in_two: Vec<&'a AxisTable>,
}

impl<'a> Held<'a> {
    /// The tables over each axis, all of them or none.
    pub(super) fn of(tables: impl IntoIterator<Item = &'a AxisTable>) -> Self {
        let all: Vec<&AxisTable> = tables.into_iter().collect();
        let over = |input: AxisName| all.iter().copied().filter(move |of| of.input == input);
        let mut held = Self::default();
        for &table in &all {
            let input = table.input;
            if over(input).all(is_within_a_turn) {
                held.tables.push(Cow::Borrowed(table));
            } else if !over(input).all(is_turn) {
                held.beyond.push(table);
            } else if !over(input).all(closes) {
                held.in_two.push(table);
            } else {
                held.tables.push(Cow::Owned(wrapped(table)));
                if !held.wrapped.contains(&input) {
                    held.wrapped.push(input);
                }
            }
        }
        held
    }

    /// What is not as in the tables that were given.
    pub(super) fn tell(&self, written: &mut Written) {
        written.leave_out(WITHIN_A_TURN, &self.beyond);
        written.leave_out(IN_TWO, &self.in_two);
        if !self.wrapped.is_empty() {
            let axes: Vec<String> = self.wrapped.iter().map(ToString::to_string).collect();
            written.notes.push(format!(
                "written from 0 to 360 deg, as a table over a rotary axis holds no others: at a negative position the control has to take the value \
                 a turn further on, which is unproven: {}",
                axes.join(", ")
            ));
        }
    }
}

fn is_within_a_turn(table: &AxisTable) -> bool {
    let positions = &table.positions;
    !table.input.is_rotary()
        || (positions.first().is_none_or(|at| *at >= -SAME_RAD)
            && positions.last().is_none_or(|at| *at <= TAU + SAME_RAD))
}

fn is_turn(table: &AxisTable) -> bool {
    super::is_turn(table.input, &table.positions)
}

/// Whether the ends are one to the last decimal of a file.
fn closes(table: &AxisTable) -> bool {
    let half_a_digit = 0.5 * 10.0_f64.powi(-i32::try_from(DECIMALS).unwrap_or(0));
    let mut of_both = [Some(&table.forward), table.backward.as_ref()]
        .into_iter()
        .flatten();
    of_both.all(|values| {
        let ends = values.first().zip(values.last());
        ends.is_none_or(|(a, b)| table.output_at_edge(a - b).abs() <= half_a_digit)
    })
}

/// A table of a whole turn from 0 to 360 deg: at its own nodes where one of them stands at 0 or the distances differ, otherwise in the same
/// steps from 0.
fn wrapped(table: &AxisTable) -> AxisTable {
    let turn = AxisTable {
        modulo: true,
        ..table.clone()
    };
    let mut positions: Vec<f64> = if let Some(spacing) = table.spacing() {
        // Whole steps from 0: those that are nodes already come out as they are, but for rounding.
        let inner = 1..table.positions.len().saturating_sub(1);
        inner.map(|place| spacing * place as f64).collect()
    } else {
        let each = table.positions.iter();
        each.map(|at| brought_into([0.0, TAU], TAU, *at)).collect()
    };
    positions.extend([0.0, TAU]);
    positions.sort_by(f64::total_cmp);
    positions.dedup_by(|next, before| *next - *before < SAME_RAD);
    if let Some(last) = positions.last_mut() {
        *last = TAU;
    }
    let along = |direction: Direction| -> Vec<f64> {
        let mut values: Vec<f64> = positions
            .iter()
            .map(|at| turn.deviation(*at, Some(direction)))
            .collect();
        if let [first, .., last] = values.as_mut_slice() {
            *last = *first;
        }
        values
    };
    let forward = along(Direction::Positive);
    let backward = table.backward.is_some().then(|| along(Direction::Negative));
    AxisTable {
        positions,
        forward,
        backward,
        ..turn
    }
}

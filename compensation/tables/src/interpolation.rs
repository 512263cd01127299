//! The look-up, in whole numbers that a control's program has: no intermediate value leaves the range of a DINT.

use volcomp_vocabulary::Direction;

use crate::{GRID_AXES, HEADER_WORDS, Header, OUTPUTS, header::FURTHEST};

/// Where a machine stands, as its control tells it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Position {
    /// The coordinate of each axis of the grid, in its steps.
    pub steps: [i32; GRID_AXES],
    /// The direction in which each axis came; `None`: not known, the mean of both holds.
    pub directions: [Option<Direction>; GRID_AXES],
}

/// The values of a map at a position, in parts of the output's steps: linear between the lines, the value at the end of the
/// grid beyond it. `words` are those of the whole map, head and all; a map that is too short gives 0.
pub(crate) fn look_up(header: &Header, words: &[u16], position: &Position) -> [i32; OUTPUTS] {
    let axes = header.grid.count().min(GRID_AXES);
    let outputs = header.outputs.count().min(OUTPUTS);
    let (mut cell, mut rest) = ([0_usize; GRID_AXES], [0_i32; GRID_AXES]);
    for axis in 0..axes {
        let lines = &header.lines[axis];
        let steps = position.steps[axis].clamp(-FURTHEST, FURTHEST);
        let last = i32::from(lines.count) - 2;
        let beyond = (steps - lines.origin).max(0);
        let at = (beyond / lines.pitch()).min(last);
        let part = i32::from(lines.part);
        let within = (beyond - at * lines.pitch() + part / 2) / part;
        cell[axis] = usize::try_from(at).unwrap_or(0);
        rest[axis] = within.min(i32::from(lines.parts));
    }
    let mut values = [0; OUTPUTS];
    for (output, value) in values.iter_mut().enumerate().take(outputs) {
        let mut corner = [0_i32; 1 << GRID_AXES];
        for (number, corner) in corner.iter_mut().enumerate().take(1 << axes) {
            let mut node = 0;
            for (axis, cell) in cell.iter().enumerate().take(axes) {
                node = node * usize::from(header.lines[axis].count) + cell + (number >> axis & 1);
            }
            let word = words.get(HEADER_WORDS + node * outputs + output);
            // Above zero, since controls do not agree on how they divide what is below.
            *corner = i32::from(word.copied().unwrap_or(0).cast_signed()) + 32768;
        }
        for (axis, rest) in rest.iter().enumerate().take(axes) {
            let parts = i32::from(header.lines[axis].parts);
            for number in 0..1 << (axes - 1 - axis) {
                let [low, high] = [corner[2 * number], corner[2 * number + 1]];
                let sum = low * (parts - rest) + high * rest;
                corner[number] = (sum + parts / 2) / parts;
            }
        }
        *value = corner[0] - 32768;
        for axis in 0..axes {
            let half = i32::from(header.reversal[axis][output]);
            *value += match position.directions[axis] {
                Some(Direction::Positive) => half,
                Some(Direction::Negative) => -half,
                None => 0,
            };
        }
    }
    values
}

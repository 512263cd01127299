//! How far a map is from the field that it was made from.

use volcomp_model::halton;
use volcomp_vocabulary::Direction;

use crate::{Field, GRID_AXES, Map, OUTPUTS, Position, sample::directions_of};

/// The most positions between the lines that are looked at.
const MOST: usize = 400_000;
/// Positions spread over the work space besides those.
const SPREAD: u32 = 20_000;

/// The error of a map: the length of the difference between what a control looks up and the field. The step of the output is
/// not in it: what is applied is rounded to it, by 0.6 of a step at the most.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Misfit {
    /// The largest, mm.
    pub max_mm: f64,
    /// Root of the mean square, mm.
    pub rms_mm: f64,
    /// Where the largest is: mm or deg along the axes of the grid.
    pub at: [f64; GRID_AXES],
    /// In which directions the axes came there.
    pub directions: [Option<Direction>; GRID_AXES],
    /// How many positions were looked at.
    pub positions: usize,
}

/// Sums up errors.
#[derive(Default)]
struct Sum {
    found: Misfit,
    squares: f64,
}

impl Sum {
    fn look(&mut self, map: &Map, field: &impl Field, position: &Position) {
        let lines = &map.header().lines;
        let at =
            core::array::from_fn(|axis| lines[axis].coordinate(f64::from(position.steps[axis])));
        let wanted = field.correction_mm(&at, &position.directions);
        let looked_up = map.correction_mm(position);
        let outputs = map.header().outputs.count();
        let squares = (0..OUTPUTS.min(outputs)).map(|o| (looked_up[o] - wanted[o]).powi(2));
        let square: f64 = squares.sum();
        self.squares += square;
        self.found.positions += 1;
        if square.sqrt() > self.found.max_mm {
            self.found.max_mm = square.sqrt();
            self.found.at = at;
            self.found.directions = position.directions;
        }
    }
}

/// The error of a map within these travels (mm or deg): on its lines and in the middle between them, in every direction of approach,
/// and at positions spread over the work space.
pub(crate) fn of(map: &Map, field: &impl Field, travels: &[[f64; 2]]) -> Misfit {
    let axes = travels.len();
    let lines = &map.header().lines;
    let directions: Vec<_> = directions_of(field, axes).collect();
    // As the control has them: whole steps within the travel.
    let ends: Vec<[i32; 2]> = (0..axes)
        .map(|axis| {
            let step = lines[axis].coordinate(1.0);
            let [low, high] = travels[axis].map(|end| end / step);
            [steps(low.ceil()), steps(high.floor())]
        })
        .collect();
    let counts: Vec<usize> = lines[..axes]
        .iter()
        .map(|l| 2 * usize::from(l.count) - 1)
        .collect();
    let all: usize = counts.iter().product();
    let stride = (all * directions.len()).div_ceil(MOST);
    let mut sum = Sum::default();
    for number in (0..all).step_by(stride.max(1)) {
        let mut position = Position::default();
        let mut rest = number;
        for axis in 0..axes {
            let half = i32::try_from(rest % counts[axis]).unwrap_or(0);
            rest /= counts[axis];
            let pitch = lines[axis].pitch();
            let at = lines[axis].origin + half / 2 * pitch + half % 2 * (pitch / 2);
            position.steps[axis] = at.max(ends[axis][0]).min(ends[axis][1]);
        }
        for directions in &directions {
            position.directions = *directions;
            sum.look(map, field, &position);
        }
    }
    for number in 1..=SPREAD {
        let mut position = Position {
            directions: directions[number as usize % directions.len()],
            ..Position::default()
        };
        for (axis, [low, high]) in ends.iter().copied().enumerate() {
            let share = halton(number, axis);
            let at = f64::from(low) + share * (f64::from(high) - f64::from(low));
            position.steps[axis] = steps(at);
        }
        sum.look(map, field, &position);
    }
    let mean = sum.squares / sum.found.positions as f64;
    sum.found.rms_mm = mean.sqrt();
    sum.found
}

/// The largest change of an output from line to line along one axis, mm for each mm or deg.
pub(crate) fn steepest(map: &Map) -> f64 {
    let header = map.header();
    let (axes, outputs) = (header.grid.count(), header.outputs.count());
    let values = &map.words()[crate::HEADER_WORDS..];
    let mut steepest = 0.0_f64;
    for axis in 0..axes {
        let lines = &header.lines[axis];
        let pitch = lines.coordinate(f64::from(lines.pitch()));
        let behind = header.lines[axis + 1..axes].iter();
        let step = behind.fold(outputs, |step, lines| step * usize::from(lines.count));
        for (place, word) in values.iter().enumerate() {
            let line = place / step % usize::from(lines.count);
            let Some(next) = values
                .get(place + step)
                .filter(|_| line + 1 < lines.count.into())
            else {
                continue;
            };
            let parts = f64::from(next.cast_signed()) - f64::from(word.cast_signed());
            let step_mm = f64::from(header.output_step_nm[place % outputs]) * 1e-6;
            let slope = parts / f64::from(header.scale) * step_mm / pitch;
            steepest = steepest.max(slope.abs());
        }
    }
    steepest
}

#[expect(
    clippy::cast_possible_truncation,
    reason = "within the travel, which was checked"
)]
fn steps(number: f64) -> i32 {
    number.round() as i32
}

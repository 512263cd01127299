//! The arc of a block: its centre, by ways, as a place or by a radius, and how far it turns.

use crate::{
    NcError,
    coordinates::Axes,
    dialect::Dialect,
    given::{Given, whole},
    interpret::Interpreter,
    modal::Code,
    motion::Arc,
};

/// By so much the radii at the ends of an arc may differ, mm: more LinuxCNC refuses unless it is told to, and other controls let far less pass.
const MOST_SPIRAL_MM: f64 = 0.127;

impl Interpreter {
    /// The arc of a block that ends at `end`.
    pub(crate) fn arc(&self, code: Code, given: &Given<'_>, end: &Axes) -> Result<Arc, NcError> {
        let axes = self.modal.plane.axes();
        let [first, second, _] = axes;
        let (from, to) = (self.program_position(), self.frame.to_program(end));
        let (start, end) = ([from[first], from[second]], [to[first], to[second]]);
        let letters = self.modal.plane.centre_letters();
        let unit = self.modal.unit_mm;
        let mut ways = [None; 2];
        for (way, letter) in ways.iter_mut().zip(letters) {
            *way = given.letter(letter)?.map(|value| value * unit);
        }
        let clockwise = code == 20;
        let radius = given.letter(b'R')?.map(|radius| radius * unit);
        let (centre, by_radius) = match (radius, ways) {
            (Some(_), [Some(_), _] | [_, Some(_)]) => {
                return Err(given.refused("an arc with a radius R and a centre"));
            }
            (Some(radius), _) => (
                centre_of(start, end, radius, clockwise).map_err(|what| given.refused(what))?,
                true,
            ),
            (None, [None, None]) if self.modal.pole.is_some() => {
                (self.modal.pole.unwrap_or_default(), false)
            }
            (None, [None, None]) => {
                return Err(given.refused(if self.dialect == Dialect::Heidenhain {
                    "an arc without a radius and without a pole (CC) whose place is known: name X and Y before a CC that is relative to them"
                } else {
                    "an arc without a centre and without a radius R"
                }));
            }
            (None, ways) => {
                let centre = std::array::from_fn(|i| {
                    let base = if given.centre_is_absolute(letters[i], &self.modal) {
                        0.0
                    } else {
                        start[i]
                    };
                    base + ways[i].unwrap_or(0.0)
                });
                (centre, false)
            }
        };
        let [begins, ends] = [start, end].map(|at| (at[0] - centre[0]).hypot(at[1] - centre[1]));
        if (begins - ends).abs() > MOST_SPIRAL_MM {
            return Err(given.refused(&format!(
                "an arc with a radius of {begins:.3} mm where it begins and of {ends:.3} mm where it ends"
            )));
        }
        let angle = |at: [f64; 2]| (at[1] - centre[1]).atan2(at[0] - centre[0]);
        let mut turns_by = angle(end) - angle(start);
        let whole_turn = 2.0 * std::f64::consts::PI;
        // An end that is the beginning is a full turn.
        if clockwise {
            while turns_by > -1e-12 {
                turns_by -= whole_turn;
            }
        } else {
            while turns_by < 1e-12 {
                turns_by += whole_turn;
            }
        }
        if let Some(turns) = given.letter(b'P')? {
            let turns = whole(turns, 100_000).filter(|turns| *turns > 0);
            let more = turns
                .ok_or_else(|| given.refused("an arc with a P that is no number of turns"))?
                - 1;
            turns_by += f64::from(more) * whole_turn.copysign(turns_by);
        }
        Ok(Arc {
            axes,
            centre,
            turns_by,
            by_radius,
        })
    }
}

/// By so much the radius of a half circle may be short by its rounding, mm, as LinuxCNC takes it.
const ROUNDED_MM: f64 = 0.00127;

/// The centre of an arc by its radius: a negative one means the longer way.
pub(crate) fn centre_of(
    start: [f64; 2],
    end: [f64; 2],
    radius: f64,
    clockwise: bool,
) -> Result<[f64; 2], &'static str> {
    let way = [end[0] - start[0], end[1] - start[1]];
    let chord = way[0].hypot(way[1]);
    if chord == 0.0 || radius == 0.0 {
        return Err("an arc with a radius R whose end is its beginning");
    }
    let rest = radius * radius - 0.25 * chord * chord;
    // A half circle whose numbers are rounded.
    let short = 0.5 * chord - radius.abs();
    if rest < 0.0 && short > (1e-4 * radius.abs()).max(ROUNDED_MM) {
        return Err("an arc whose radius R is too small for its end");
    }
    let height = rest.max(0.0).sqrt();
    // To the left of the way for the shorter one counterclockwise.
    let side = if (radius > 0.0) == clockwise {
        -1.0
    } else {
        1.0
    };
    let normal = [-way[1] / chord, way[0] / chord];
    Ok(std::array::from_fn(|i| {
        0.5 * (start[i] + end[i]) + side * height * normal[i]
    }))
}

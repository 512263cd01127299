//! The parts in which an arc is written: each of them still an arc.

use std::f64::consts::{FRAC_PI_4, PI};

use crate::{
    NcError,
    bow::{Bow, sag_of},
    contour::Contour,
    coordinates::Axes,
    line::Line,
    motion::Arc,
    notes::Note,
    number::of_steps,
    rewrite::Rewriter,
    straight::{MOST_PARTS, too_many_parts},
    turns::Turns,
    words::each,
};

/// Errors that are straight within a part of an arc leave a deviation from its circle that is 0 at both ends and in the
/// middle and has one bend between each two of these: it is nowhere larger than so many times what it is at the quarters.
const BETWEEN_QUARTERS: f64 = 1.15;
/// In so many equal parts a turn is looked at for axes that turn, and an arc of many turns at the most.
const LOOKED_AT: u32 = 64;
const MOST_LOOKED_AT: f64 = 4096.0;
/// An axis of the plane that goes by half of this beside its turning point is taken for standing.
const HARDLY_MM: f64 = 5e-4;
/// Parts of an arc that are shorter than so many steps of its words are not split any further.
const SHORTEST_IN_STEPS: f64 = 20.0;
/// And an axis that turns does not make shorter ones.
const SHORTEST_TURN_IN_STEPS: f64 = 100.0;

/// A part of an arc that stays one arc: where it begins and ends, from 0 to 1 of the whole arc.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Stretch {
    pub(crate) from: f64,
    pub(crate) to: f64,
}

impl Stretch {
    /// The angle it turns by, rad, without its sign.
    pub(crate) fn turns(self, arc: &Arc) -> f64 {
        (self.to - self.from) * arc.turns_by.abs()
    }

    /// Whole turns before its last one, which may be whole itself.
    pub(crate) fn more_turns(self, arc: &Arc) -> f64 {
        (self.turns(arc) / (2.0 * PI) - 1e-9).floor().max(0.0)
    }

    pub(crate) fn middle(self) -> f64 {
        0.5 * (self.from + self.to)
    }

    /// Whether it is so near to a whole turn, or more, that no circle goes through its beginning, middle and end.
    pub(crate) fn is_whole(self, arc: &Arc) -> bool {
        self.turns(arc) > 1.9 * PI
    }
}

/// A place in the plane of an arc.
pub(crate) fn in_plane(arc: &Arc, at: &Axes) -> [f64; 2] {
    let [first, second, _] = arc.axes;
    [at[first], at[second]]
}

/// The same with a correction.
pub(crate) fn shifted(arc: &Arc, at: &Axes, delta: &Axes) -> [f64; 2] {
    let [first, second, _] = arc.axes;
    [at[first] + delta[first], at[second] + delta[second]]
}

/// A part of less than a turn as it is programmed.
pub(crate) fn programmed(arc: &Arc, [from, to]: [&Axes; 2], part: Stretch) -> Bow {
    let [start, end] = [part.from, part.to].map(|share| in_plane(arc, &arc.place(from, to, share)));
    let radius = |at: [f64; 2]| (at[0] - arc.centre[0]).hypot(at[1] - arc.centre[1]);
    Bow {
        start,
        end,
        sag: sag_of(0.5 * (radius(start) + radius(end)), part.turns(arc)),
        clockwise: arc.turns_by < 0.0,
    }
}

impl Rewriter {
    /// One step of the words of lengths, mm.
    pub(crate) fn step_mm(&self) -> f64 {
        let unit = self.interpreter.modal.unit_mm;
        of_steps(1, self.numerals(0, None).decimals) * unit
    }

    /// A part of less than a turn through its corrected beginning, middle and end. Where the correction bends more than the arc
    /// does, it keeps at least half of its own bend and at most twice it: it never turns over.
    pub(crate) fn corrected(&self, arc: &Arc, ends: [&Axes; 2], part: Stretch) -> Bow {
        let programmed = programmed(arc, ends, part);
        let [start, middle, end] = [part.from, part.middle(), part.to].map(|share| {
            let at = arc.place(ends[0], ends[1], share);
            in_plane(arc, &self.delta_in_program(&at))
        });
        let normal = programmed.normal();
        let bend: f64 = (0..2)
            .map(|i| normal[i] * (middle[i] - 0.5 * (start[i] + end[i])))
            .sum();
        let sag = programmed.sag;
        Bow {
            start: std::array::from_fn(|i| programmed.start[i] + start[i]),
            end: std::array::from_fn(|i| programmed.end[i] + end[i]),
            sag: (sag + bend).clamp(0.5 * sag, 2.0 * sag),
            ..programmed
        }
    }

    /// The parts in which an arc is written.
    ///
    /// # Errors
    /// More of them than a motion may have.
    pub(crate) fn stretches(
        &mut self,
        arc: &Arc,
        [from, to]: [&Axes; 2],
        line: Line<'_>,
    ) -> Result<Vec<Stretch>, NcError> {
        let mut stretches = Vec::new();
        self.turns = self.turns_of_arc(arc, [from, to]);
        if self.contour != Contour::None {
            let whole = Stretch { from: 0.0, to: 1.0 };
            if !self.fits(arc, [from, to], whole) {
                self.interpreter.notes.add(Note::ContourWhole, line.number);
            }
            return Ok(vec![whole]);
        }
        let mut open = self.turn_to_turn();
        let sides = self.corrector.sides();
        let mut next = 0;
        let (radius, _) = arc.start(from);
        let shortest = SHORTEST_IN_STEPS * self.step_mm();
        while let Some(stretch) = open.pop() {
            self.turn_up_to(&mut next, stretch.from);
            let is_short = stretch.turns(arc) * radius < shortest;
            if stretches.len() + open.len() >= MOST_PARTS {
                return Err(too_many_parts(line));
            }
            if is_short || self.fits(arc, [from, to], stretch) {
                stretches.push(stretch);
            } else {
                let middle = stretch.middle();
                open.push(Stretch {
                    from: middle,
                    ..stretch
                });
                open.push(Stretch {
                    to: middle,
                    ..stretch
                });
            }
        }
        self.corrector.put_back(sides);
        Ok(stretches)
    }

    /// Where axes turn on an arc.
    fn turns_of_arc(&self, arc: &Arc, [from, to]: [&Axes; 2]) -> Turns {
        if !self.corrector.is_bidirectional() {
            return Turns::default();
        }
        let frame = &self.interpreter.frame;
        let steps = f64::from(LOOKED_AT) * (arc.turns_by.abs() / (2.0 * PI)).max(1.0);
        #[expect(
            clippy::cast_possible_truncation,
            clippy::cast_sign_loss,
            reason = "a few thousand at the most"
        )]
        let steps = steps.ceil().min(MOST_LOOKED_AT) as u32;
        let place = |share: f64| match share {
            0.0 => frame.to_machine(from),
            1.0 => frame.to_machine(to),
            _ => frame.to_machine(&arc.place(from, to, share)),
        };
        let carriages = self.corrector.carriages(steps, place);
        let mut found = self.corrector.turns(steps, carriages);
        // No part is so short that what takes up the play makes another arc of it; beside its turning point an axis hardly moves.
        let (radius, _) = arc.start(from);
        let shortest = (SHORTEST_TURN_IN_STEPS * self.step_mm()).max((HARDLY_MM * radius).sqrt());
        let shortest = shortest / (radius * arc.turns_by.abs());
        found.keep_before(1.0 - shortest);
        let mut passed = 0.0;
        for turn in &mut found.turns {
            if turn.share - passed < shortest {
                turn.share = passed;
            }
            passed = turn.share;
        }
        found
    }

    /// The parts of an arc in which no axis turns, the first one last.
    fn turn_to_turn(&self) -> Vec<Stretch> {
        let mut parts = vec![Stretch { from: 0.0, to: 1.0 }];
        for turn in &self.turns.turns {
            let Some(last) = parts.last_mut() else { break };
            if turn.share > last.from {
                last.to = turn.share;
                parts.push(Stretch {
                    from: turn.share,
                    to: 1.0,
                });
            }
        }
        parts.reverse();
        parts
    }

    /// Whether a part of an arc stays an arc: the one through its corrected beginning, middle and end is nowhere further from where
    /// it belongs than the tolerance. What errors that are straight within the part leave is largest near the quarters, where it is
    /// looked at; what curves add is bounded by their derivatives.
    fn fits(&self, arc: &Arc, [from, to]: [&Axes; 2], part: Stretch) -> bool {
        let tolerance = self.corrector.split_beyond_mm();
        let [first, second, _] = arc.axes;
        let turns = part.turns(arc);
        let is_whole = part.is_whole(arc);
        let eighths = (turns / FRAC_PI_4).ceil().clamp(4.0, 4096.0);
        let count = if is_whole { eighths } else { 4.0 };
        let mut shares = (0..).map(f64::from).map(|place| place / count);
        let place = |share: f64| {
            let at = arc.place(from, to, part.from + share * (part.to - part.from));
            (at, self.delta_in_program(&at))
        };
        let places: Vec<_> = shares
            .by_ref()
            .take_while(|share| *share <= 1.0)
            .map(|share| (share, place(share)))
            .collect();
        let (Some((_, start)), Some((_, end))) = (places.first(), places.last()) else {
            return false;
        };
        // The box of all places of the part, and how far the correction may be from a straight one within it.
        let frame = &self.interpreter.frame;
        let (radius, _) = arc.start(from);
        let bulge = radius * (1.0 - (0.5 * turns / count).cos());
        let boxed = |turned: bool, of: &dyn Fn(&Axes) -> Axes| {
            let [mut low, mut high] = [of(&start.0); 2];
            for (_, (at, _)) in &places {
                let at = of(at);
                low = each(|axis| low[axis].min(at[axis]));
                high = each(|axis| high[axis].max(at[axis]));
            }
            for axis in 0..3 {
                if turned || axis == first || axis == second {
                    low[axis] -= bulge;
                    high[axis] += bulge;
                }
            }
            (low, high)
        };
        let (low, high) = boxed(false, &|at| *at);
        let bulge_mm = self.bulge_mm(&low, &high);
        // The corners of a turned box are not those of the box about the turned arc.
        let turned = frame.rotation_deg != 0.0 || frame.tip.is_some();
        let (low, high) = boxed(turned, &|at| frame.to_machine(at));
        let curved = self.corrector.bound_mm(&low, &high, bulge_mm);
        if 2.0 * curved > tolerance {
            return false;
        }
        let off_plane = |share: f64, delta: &Axes| {
            let away: f64 = (0..9)
                .filter(|axis| *axis != first && *axis != second)
                .map(|axis| {
                    (delta[axis] - start.1[axis] - share * (end.1[axis] - start.1[axis])).powi(2)
                })
                .sum();
            away.sqrt()
        };
        let circles = (!is_whole).then(|| {
            // The programmed circle, too: its numbers are rounded, and that is not for a correction to mend.
            [
                self.corrected(arc, [from, to], part),
                programmed(arc, [from, to], part),
            ]
            .map(|bow| (bow.centre(), bow.radius()))
        });
        let mut largest = 0.0_f64;
        for (share, (at, delta)) in &places {
            let off = if let Some([corrected, programmed]) = circles {
                let off = |(centre, radius): ([f64; 2], f64), [x, y]: [f64; 2]| {
                    (x - centre[0]).hypot(y - centre[1]) - radius
                };
                (off(corrected, shifted(arc, at, delta)) - off(programmed, in_plane(arc, at))).abs()
            } else {
                // A whole circle keeps its radius: it is shifted as its beginning is.
                let of_start = &start.1;
                (delta[first] - of_start[first]).hypot(delta[second] - of_start[second])
            };
            largest = largest.max(off).max(off_plane(*share, delta));
        }
        BETWEEN_QUARTERS * largest + 2.0 * curved <= tolerance
    }
}

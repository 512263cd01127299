//! Arcs with their correction: still arcs where the circle through three corrected places fits, else parts of them.

use crate::{
    arc::centre_through,
    block::Block,
    coordinates::Axes,
    motion::{Arc, Move},
    rewrite::Rewriter,
    words::{Number, Written, each},
};

/// A smooth function that is 0 at both ends and in the middle, and has no third bend, is nowhere larger than so many times what it is at
/// its quarters.
const BETWEEN_QUARTERS: f64 = 1.15;
/// An arc is looked at by so many quarters at the most.
const MOST_QUARTERS: u32 = 4096;
/// Smaller parts of an arc are not split any further, rad.
const SMALLEST: f64 = 1e-3;

/// A part of an arc that stays one arc.
#[derive(Clone, Copy, Debug)]
struct Part {
    /// Where it begins and ends, from 0 to 1 of the whole arc.
    from: f64,
    to: f64,
}

impl Rewriter {
    /// An arc; whether its line stays as it is.
    #[expect(
        clippy::too_many_lines,
        reason = "the words of one arc, one after the other"
    )]
    #[expect(
        clippy::too_many_arguments,
        reason = "the line and all that is known of it"
    )]
    pub(crate) fn arc(
        &mut self,
        motion: &Move,
        arc: &Arc,
        block: &Block,
        line: &[u8],
        end: &[u8],
        number: usize,
        out: &mut Vec<u8>,
    ) -> bool {
        let frame = self.interpreter.frame.clone();
        let [first, second, _] = arc.axes;
        let from = frame.to_program(&motion.from);
        let to = frame.to_program(&motion.to);
        let known = [first, second]
            .iter()
            .all(|axis| self.interpreter.known[*axis]);
        let (radius, _) = arc.start(&from);
        if !known || radius == 0.0 {
            self.carried = [0.0; 9];
            return self.edits.is_empty();
        }
        let mut parts = Vec::new();
        let mut open = self.turn_to_turn(arc, &from);
        let sides = self.corrector.sides();
        while let Some(part) = open.pop() {
            let end_of_part = frame.to_machine(&arc.place(&from, &to, part.to));
            self.corrector.goes(&end_of_part);
            let turns = (part.to - part.from) * arc.turns_by.abs();
            if turns < SMALLEST || self.fits(arc, [&from, &to], part) {
                parts.push(part);
            } else {
                let middle = 0.5 * (part.from + part.to);
                open.push(Part {
                    from: middle,
                    ..part
                });
                open.push(Part { to: middle, ..part });
            }
        }
        self.corrector.put_back(sides);
        let splits = parts.len() > 1;
        let unit = self.interpreter.modal.unit_mm;
        let letters = self.interpreter.modal.plane.centre_letters();
        let centre_absolute = self.interpreter.modal.centre_absolute;
        let centre_decimals = self.decimals.of(0, unit);
        let mut carried = frame.way_to_program(&self.carried);
        let mut before = from;
        for (place, part) in parts.iter().enumerate() {
            let at = arc.place(&from, &to, part.to);
            self.corrector.goes(&frame.to_machine(&at));
            let middle = arc.place(&from, &to, 0.5 * (part.from + part.to));
            let shifted =
                |delta: &Axes, at: &Axes| [at[first] + delta[first], at[second] + delta[second]];
            let delta_middle = self.delta_in_program(&middle);
            let delta = self.delta_in_program(&at);
            let start = [
                before[first] + carried[first],
                before[second] + carried[second],
            ];
            let mut numbers = [None; 9];
            for axis in 0..9 {
                let word = motion.words[axis].and_then(|place| block.words.get(place));
                if word.is_none() && !self.corrector.has(axis) {
                    continue;
                }
                let in_plane = axis == first || axis == second;
                let mut written = word.map(|word| Written {
                    decimals: word.decimals.unwrap_or(0),
                    anew: splits,
                });
                if written.is_none() && splits && in_plane {
                    // Each part needs its end.
                    written = Some(Written {
                        decimals: 0,
                        anew: true,
                    });
                }
                let ways = [&before, &at];
                let way = self.on_its_way(
                    axis,
                    ways,
                    &delta,
                    &carried,
                    motion.incremental,
                    written,
                    number,
                );
                (numbers[axis], carried[axis]) = way.word();
            }
            let end_at = shifted(&carried, &at);
            // The circle through what is commanded, and the middle as it is to be.
            let centre = if is_whole((part.to - part.from) * arc.turns_by.abs()) {
                // It is shifted as its beginning is.
                let shift: [f64; 2] =
                    std::array::from_fn(|i| start[i] - before[[first, second][i]]);
                Some([arc.centre[0] + shift[0], arc.centre[1] + shift[1]])
            } else {
                // As far from the programmed centre as the circle through the corrected places is from that through the
                // programmed ones, which may not meet the centre for their rounding.
                let plain = [&before, &middle, &at].map(|at| [at[first], at[second]]);
                let corrected = centre_through(start, shifted(&delta_middle, &middle), end_at);
                let plain = centre_through(plain[0], plain[1], plain[2]);
                corrected.zip(plain).map(|(corrected, plain)| {
                    std::array::from_fn(|i| arc.centre[i] + corrected[i] - plain[i])
                })
            };
            let centre = centre.unwrap_or(arc.centre);
            let mut others: Vec<(u8, Number)> = Vec::new();
            if arc.by_radius {
                let size = (start[0] - centre[0]).hypot(start[1] - centre[1]);
                let half_chord = 0.5 * (end_at[0] - start[0]).hypot(end_at[1] - start[1]);
                let size = size.max(half_chord);
                let longer = (part.to - part.from) * arc.turns_by.abs() > std::f64::consts::PI;
                let size = if longer { -size } else { size };
                let word = block.words.iter().position(|word| word.letter == b'R');
                let written = word.and_then(|place| block.words.get(place)?.value);
                let size = match written.filter(|_| !splits) {
                    // As much larger as the arc is, whatever rounding its radius has.
                    Some(written) => {
                        let plain =
                            (before[first] - arc.centre[0]).hypot(before[second] - arc.centre[1]);
                        written * unit + written.signum() * (size.abs() - plain)
                    }
                    None => size,
                };
                self.other_word(
                    b'R',
                    word,
                    size / unit,
                    centre_decimals,
                    place,
                    splits,
                    block,
                    &mut others,
                );
            } else {
                for (i, letter) in letters.into_iter().enumerate() {
                    let base = if centre_absolute { 0.0 } else { start[i] };
                    let value = (centre[i] - base) / unit;
                    let word = block.words.iter().position(|word| word.letter == letter);
                    self.other_word(
                        letter,
                        word,
                        value,
                        centre_decimals,
                        place,
                        splits,
                        block,
                        &mut others,
                    );
                }
            }
            if splits
                && place == 0
                && let Some(turns) = block.words.iter().position(|word| word.letter == b'P')
            {
                self.edits.removed.push(turns);
            }
            let feed = splits
                .then(|| self.feed_of_part(part.to - part.from))
                .flatten();
            self.write_part(place, &numbers, &motion.words, feed, block, line, end, out);
            for (letter, number) in others {
                out.push(b' ');
                out.push(letter);
                number.write(out);
            }
            before = at;
        }
        self.carried = frame.way_to_machine(&carried);
        !splits && self.edits.is_empty()
    }

    /// A word of the centre or the radius: of the first part in the line itself, of the others behind their coordinates.
    #[expect(clippy::too_many_arguments, reason = "the word and where it goes")]
    fn other_word(
        &mut self,
        letter: u8,
        word: Option<usize>,
        value: f64,
        decimals: u8,
        place: usize,
        splits: bool,
        block: &Block,
        others: &mut Vec<(u8, Number)>,
    ) {
        let written = word.and_then(|place| block.words.get(place));
        let before = written.map_or(0.0, |word| word.value.unwrap_or(0.0));
        let of_word = written.and_then(|word| word.decimals).unwrap_or(0);
        let half = 0.5 * crate::number::of_steps(1, decimals);
        let changes = (value - before).abs() >= half;
        if !changes && !splits {
            return;
        }
        let Some(number) = Number::nearest(value, decimals.max(of_word)) else {
            return;
        };
        match (place, word) {
            (0, Some(word)) => self.edits.replaced.push((word, number)),
            (0, None) if changes => self.edits.added.push((letter, number)),
            (0, None) => {}
            _ => others.push((letter, number)),
        }
    }

    /// The parts of an arc in which no axis changes its direction, the first one last: the whole arc where that changes nothing.
    fn turn_to_turn(&self, arc: &Arc, from: &Axes) -> Vec<Part> {
        let mut parts = vec![Part { from: 0.0, to: 1.0 }];
        if !self.corrector.is_bidirectional() {
            return parts;
        }
        let quarter = std::f64::consts::FRAC_PI_2;
        let (_, start) = arc.start(from);
        let turned = self.interpreter.frame.rotation_deg.to_radians();
        // The first quarter beyond the beginning, in the coordinates of the machine.
        let begins = (start + turned) / quarter;
        let sign = arc.turns_by.signum();
        let next = if sign > 0.0 {
            (begins + 1e-9).floor() + 1.0
        } else {
            (begins - 1e-9).ceil() - 1.0
        };
        for place in 0..MOST_QUARTERS {
            let share = (next + sign * f64::from(place) - begins) * quarter / arc.turns_by;
            let Some(last) = parts.last_mut().filter(|_| share < 1.0 - 1e-9) else {
                break;
            };
            last.to = share;
            parts.push(Part {
                from: share,
                to: 1.0,
            });
        }
        parts.reverse();
        parts
    }

    fn delta_in_program(&self, at: &Axes) -> Axes {
        let machine = self.interpreter.frame.to_machine(at);
        let delta = self.corrector.delta(&machine);
        self.interpreter.frame.way_to_program(&delta)
    }

    /// Whether a part of an arc stays an arc: the one through its corrected beginning, middle and end is nowhere further from where
    /// it belongs than the tolerance. What errors that are straight within the part leave is largest near the quarters, where it is
    /// looked at; what curves add is bounded by their derivatives.
    fn fits(&self, arc: &Arc, [from, to]: [&Axes; 2], part: Part) -> bool {
        let tolerance = self.corrector.split_beyond_mm();
        let [first, second, _] = arc.axes;
        let turns = (part.to - part.from) * arc.turns_by.abs();
        let is_whole = is_whole(turns);
        let eighths = (turns / std::f64::consts::FRAC_PI_4)
            .ceil()
            .clamp(4.0, 4096.0);
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
        let [mut low, mut high] = [start.0; 2];
        for (_, (at, _)) in &places {
            low = each(|axis| low[axis].min(at[axis]));
            high = each(|axis| high[axis].max(at[axis]));
        }
        let (radius, _) = arc.start(from);
        let bulge = radius * (1.0 - (0.5 * turns / count).cos());
        for axis in [first, second] {
            low[axis] -= bulge;
            high[axis] += bulge;
        }
        let frame = &self.interpreter.frame;
        let curved = self
            .corrector
            .bound_mm(&frame.to_machine(&low), &frame.to_machine(&high));
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
        let shifted =
            |(at, delta): &(Axes, Axes)| [at[first] + delta[first], at[second] + delta[second]];
        let circle = if is_whole {
            None
        } else {
            let middle = &places[places.len() / 2].1;
            // The programmed circle, too: its numbers are rounded, and that is not for a correction to mend.
            let plain = |(at, _): &(Axes, Axes)| [at[first], at[second]];
            let circle = |of: &dyn Fn(&(Axes, Axes)) -> [f64; 2]| {
                let centre = centre_through(of(start), of(middle), of(end))?;
                let [x, y] = of(start);
                Some((centre, (x - centre[0]).hypot(y - centre[1])))
            };
            let Some(both) = circle(&shifted).zip(circle(&plain)) else {
                return false;
            };
            Some(both)
        };
        let mut largest = 0.0_f64;
        for (share, place) in &places {
            let in_plane = if let Some((corrected, plain)) = circle {
                let off = |(centre, radius): ([f64; 2], f64), [x, y]: [f64; 2]| {
                    (x - centre[0]).hypot(y - centre[1]) - radius
                };
                (off(corrected, shifted(place)) - off(plain, [place.0[first], place.0[second]]))
                    .abs()
            } else {
                // A whole circle keeps its radius: it is shifted as its beginning is.
                let (delta, of_start) = (&place.1, &start.1);
                (delta[first] - of_start[first]).hypot(delta[second] - of_start[second])
            };
            largest = largest.max(in_plane).max(off_plane(*share, &place.1));
        }
        BETWEEN_QUARTERS * largest + 2.0 * curved <= tolerance
    }
}

/// Whether an arc is so near to a whole turn, or more, that no circle goes through its beginning, middle and end.
fn is_whole(turns: f64) -> bool {
    turns > 1.9 * std::f64::consts::PI
}

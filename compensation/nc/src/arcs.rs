//! Arcs with their correction: still arcs where the circle through three corrected places fits, else parts of them.

use crate::{
    arc::centre_through,
    block::Word,
    coordinates::Axes,
    edits::write_word,
    legs::{Leg, Writes},
    line::{Line, end_of_more},
    motion::{Arc, Move},
    number::of_steps,
    rewrite::{Part, Rewriter, words_of},
    words::{Number, each},
};

/// Errors that are straight within a part of an arc leave a deviation from its circle that is 0 at both ends and in the
/// middle and has one bend between each two of these: it is nowhere larger than so many times what it is at the quarters.
const BETWEEN_QUARTERS: f64 = 1.15;
/// An arc is looked at by so many quarters at the most.
const MOST_QUARTERS: u32 = 4096;
/// Smaller parts of an arc are not split any further, rad.
const SMALLEST: f64 = 1e-3;

/// A part of an arc that stays one arc: where it begins and ends, from 0 to 1 of the whole arc.
#[derive(Clone, Copy, Debug)]
struct Stretch {
    from: f64,
    to: f64,
}

impl Stretch {
    /// The angle it turns by, rad, without its sign.
    fn turns(self, arc: &Arc) -> f64 {
        (self.to - self.from) * arc.turns_by.abs()
    }
}

/// The circle of a part as it is written, in the coordinates of the program, mm.
#[derive(Clone, Copy, Debug)]
struct Circle {
    /// The commanded beginning and end in the plane, and the centre.
    start: [f64; 2],
    end: [f64; 2],
    centre: [f64; 2],
    /// The programmed radius there.
    radius: f64,
    /// The part turns by more than half a turn.
    is_longer: bool,
}

impl Rewriter {
    /// An arc.
    pub(crate) fn arc(&mut self, motion: &Move, arc: &Arc, line: Line<'_>, out: &mut Vec<u8>) {
        let frame = self.interpreter.frame.clone();
        let [first, second, _] = arc.axes;
        let [from, to] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
        let known = [first, second]
            .into_iter()
            .all(|axis| self.interpreter.known[axis]);
        let (radius, _) = arc.start(&from);
        if !known || radius == 0.0 {
            self.is_uncorrected(motion);
            return;
        }
        let stretches = self.stretches(arc, [&from, &to]);
        let splits = stretches.len() > 1;
        if let Some(first) = stretches.first() {
            let sets_out = frame.to_machine(&arc.place(&from, &to, first.to));
            self.take_up(motion, arc, &sets_out, line, out);
        }
        let mut carried = frame.moved_in_program(&motion.from, &self.carried);
        let mut before = from;
        for (place, stretch) in stretches.iter().enumerate() {
            let at = arc.place(&from, &to, stretch.to);
            let machine = frame.to_machine(&at);
            self.corrector.goes(&machine);
            let middle = arc.place(&from, &to, 0.5 * (stretch.from + stretch.to));
            let delta_middle = self.delta_in_program(&middle);
            let in_plane = |at: &Axes| [at[first], at[second]];
            let shifted =
                |delta: &Axes, at: &Axes| [at[first] + delta[first], at[second] + delta[second]];
            let start = shifted(&carried, &before);
            let writes = each(|axis| match splits {
                // Each part needs its end.
                true if axis == first || axis == second => Writes::Always,
                true => Writes::Anew,
                false => Writes::IfChanged,
            });
            let leg = Leg {
                motion,
                line,
                from: before,
                to: at,
                at: machine,
                writes,
            };
            let words = self.words_to(&leg, &mut carried);
            let end = shifted(&carried, &at);
            // The circle through what is commanded, and the middle as it is to be.
            let centre = if is_whole(stretch.turns(arc)) {
                // It is shifted as its beginning is.
                let shift: [f64; 2] = std::array::from_fn(|i| start[i] - in_plane(&before)[i]);
                Some([arc.centre[0] + shift[0], arc.centre[1] + shift[1]])
            } else {
                // As far from the programmed centre as the circle through the corrected places is from that through the
                // programmed ones, which may not meet the centre for their rounding.
                let corrected = centre_through(start, shifted(&delta_middle, &middle), end);
                let plain = centre_through(in_plane(&before), in_plane(&middle), in_plane(&at));
                corrected.zip(plain).map(|(corrected, plain)| {
                    std::array::from_fn(|i| arc.centre[i] + (corrected[i] - plain[i]))
                })
            };
            let [x, y] = in_plane(&before);
            let circle = Circle {
                start,
                end,
                centre: centre.unwrap_or(arc.centre),
                radius: (x - arc.centre[0]).hypot(y - arc.centre[1]),
                is_longer: stretch.turns(arc) > std::f64::consts::PI,
            };
            let others = self.words_of_circle(arc, &circle, line, splits.then_some(place));
            let turns = line.place_of(b'P').filter(|_| splits && place == 0);
            self.edits.removed.extend(turns);
            let share = stretch.to - stretch.from;
            let feed = splits.then(|| self.feed_of_part(share)).flatten();
            let part = Part {
                place,
                share: stretch.to,
                numbers: &words.numbers,
                words: &motion.words,
                feed,
            };
            self.write_part(&part, line, out);
            for word in others {
                write_word(word, out);
            }
            before = at;
        }
        self.carried = frame.moved_in_machine(&to, &carried);
        self.is_settled = true;
    }

    /// Where the axes lack a correction at the beginning of an arc that sets out for this place of theirs, a line before it takes
    /// that up: only where nothing else that the line of the arc says comes too late for it.
    fn take_up(
        &mut self,
        motion: &Move,
        arc: &Arc,
        sets_out: &Axes,
        line: Line<'_>,
        out: &mut Vec<u8>,
    ) {
        let is_arc = |word: &Word| word.letter == b'G' && matches!(word.value, Some(2.0 | 3.0));
        let words = &line.block.words;
        let says_more = |word: &Word| matches!(word.letter, b'G' | b'M' | b'T') && !is_arc(word);
        if words.iter().any(says_more) || !line.block.assignments.is_empty() {
            return;
        }
        let turns = self.corrector.goes(sets_out);
        if !self.lacks_correction(motion, turns) {
            return;
        }
        let frame = self.interpreter.frame.clone();
        let from = frame.to_program(&motion.from);
        let stays = Move {
            words: [None; 9],
            to: motion.from,
            ..motion.clone()
        };
        let leg = Leg {
            motion: &stays,
            line,
            from,
            to: from,
            at: motion.from,
            writes: [Writes::IfChanged; 9],
        };
        let mut carried = frame.moved_in_program(&motion.from, &self.carried);
        let words = self.words_to(&leg, &mut carried);
        self.carried = frame.moved_in_machine(&from, &carried);
        let feed = self.feed_of_part(0.0);
        self.begin_line(line, out);
        out.extend_from_slice(b"G1");
        for word in words_of(&words.numbers, feed) {
            write_word(word, out);
        }
        out.extend_from_slice(end_of_more(line.end));
        self.ends_part(0.0);
        // From now on G1 is what coordinates alone stand for.
        if !line.block.words.iter().any(is_arc) {
            let code = if arc.turns_by < 0.0 { 2.0 } else { 3.0 };
            let number = Number::nearest(code, 0);
            self.edits.added.extend(number.map(|number| (b'G', number)));
        }
        // The time that F stands for is that of the arc alone.
        if feed.is_some() && line.place_of(b'F').is_none() {
            let whole = self.feed_of_part(1.0);
            self.edits.added.extend(whole.map(|feed| (b'F', feed)));
        }
    }

    /// The parts in which an arc is written.
    fn stretches(&mut self, arc: &Arc, [from, to]: [&Axes; 2]) -> Vec<Stretch> {
        let frame = self.interpreter.frame.clone();
        let mut stretches = Vec::new();
        let mut open = self.turn_to_turn(arc, from);
        let sides = self.corrector.sides();
        while let Some(stretch) = open.pop() {
            let end = frame.to_machine(&arc.place(from, to, stretch.to));
            self.corrector.goes(&end);
            if stretch.turns(arc) < SMALLEST || self.fits(arc, [from, to], stretch) {
                stretches.push(stretch);
            } else {
                let middle = 0.5 * (stretch.from + stretch.to);
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
        stretches
    }

    /// The centre or the radius of a part of an arc (`part`: which one, where there are several): its words in the line itself,
    /// and those that stand behind the coordinates of a line of its own.
    fn words_of_circle(
        &mut self,
        arc: &Arc,
        circle: &Circle,
        line: Line<'_>,
        part: Option<usize>,
    ) -> Vec<(u8, Number)> {
        let modal = &self.interpreter.modal;
        let unit = modal.unit_mm;
        let (letters, absolute) = (modal.plane.centre_letters(), modal.centre_absolute);
        let Circle {
            start, end, centre, ..
        } = *circle;
        let mut values = Vec::new();
        if arc.by_radius {
            let size = (start[0] - centre[0]).hypot(start[1] - centre[1]);
            let half_chord = 0.5 * (end[0] - start[0]).hypot(end[1] - start[1]);
            let size = size.max(half_chord);
            let word = line.word(line.place_of(b'R')).and_then(|word| word.value);
            let size = match word.filter(|_| part.is_none()) {
                // As much larger as the arc is, whatever rounding its radius has.
                Some(written) => written * unit + written.signum() * (size - circle.radius),
                None if circle.is_longer => -size,
                None => size,
            };
            values.push((b'R', size / unit));
        } else {
            for (i, letter) in letters.into_iter().enumerate() {
                let base = if absolute { 0.0 } else { start[i] };
                values.push((letter, (centre[i] - base) / unit));
            }
        }
        let decimals = self.decimals.of(0, unit);
        let half = 0.5 * of_steps(1, decimals);
        let mut others = Vec::new();
        for (letter, value) in values {
            let place = line.place_of(letter);
            let word = line.word(place);
            let before = word.and_then(|word| word.value).unwrap_or(0.0);
            let of_word = word.and_then(|word| word.decimals).unwrap_or(0);
            let changes = (value - before).abs() >= half;
            if !changes && part.is_none() {
                continue;
            }
            let Some(number) = Number::nearest(value, decimals.max(of_word)) else {
                continue;
            };
            if part.is_some_and(|part| part > 0) {
                others.push((letter, number));
            } else if changes || place.is_some() {
                self.edits.set(letter, place, number);
            }
        }
        others
    }

    /// The parts of an arc in which no axis changes its direction, the first one last: the whole arc where that changes nothing.
    fn turn_to_turn(&self, arc: &Arc, from: &Axes) -> Vec<Stretch> {
        let mut parts = vec![Stretch { from: 0.0, to: 1.0 }];
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
            parts.push(Stretch {
                from: share,
                to: 1.0,
            });
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
        let curved = self.corrector.bound_mm(
            &frame.to_machine(&low),
            &frame.to_machine(&high),
            self.bulge_mm(&low, &high),
        );
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

//! The circle of an arc as its words say it: by R or by its centre, and what a control reads from them.

use std::f64::consts::PI;

use crate::{
    arc_words::centre_of,
    coordinates::Axes,
    edits::Edits,
    given::centre_is_absolute,
    line::Line,
    motion::Arc,
    number::half_step,
    rewrite::Rewriter,
    stretches::{Stretch, in_plane, programmed, shifted},
    words::Number,
};

/// What a control makes of an arc by its radius may be so many steps off in its middle, else the arc gets a centre.
const OFF_BY_RADIUS: f64 = 1.0;
/// The same by its centre, whose two words are rounded.
const OFF_BY_CENTRE: f64 = 3.0;

/// A part of an arc between the places that its words lead to.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Written<'a> {
    pub(crate) arc: &'a Arc,
    /// The beginning and the end of the whole arc, in the coordinates of the program.
    pub(crate) ends: [&'a Axes; 2],
    pub(crate) part: Stretch,
    /// Which part it is, where there are several.
    pub(crate) place: Option<usize>,
    /// The corrections with which it begins and ends, in these coordinates.
    pub(crate) carried: [&'a Axes; 2],
}

impl Written<'_> {
    /// Where the axes begin and end, in the plane.
    fn commanded(&self) -> [[f64; 2]; 2] {
        let places = [self.part.from, self.part.to]
            .map(|share| self.arc.place(self.ends[0], self.ends[1], share));
        std::array::from_fn(|i| shifted(self.arc, &places[i], self.carried[i]))
    }
}

/// The words of a circle.
#[derive(Clone, Debug, Default)]
pub(crate) struct CircleWords {
    /// What the line of the program gets.
    replaced: Vec<(u8, Option<usize>, Number)>,
    removed: Vec<usize>,
    /// What stands behind the coordinates of a line of its own.
    pub(crate) others: Vec<(u8, Number)>,
}

impl CircleWords {
    /// The numbers of the centre, which stand in a line of their own.
    pub(crate) fn take_centre(&mut self, letters: [u8; 2]) -> [Option<Number>; 2] {
        let found = letters.map(|letter| {
            let replaced = self.replaced.iter().find(|(of, ..)| *of == letter);
            let replaced = replaced.map(|(.., number)| *number);
            let others = self.others.iter().find(|(of, _)| *of == letter);
            replaced.or(others.map(|(_, number)| *number))
        });
        self.replaced.retain(|(of, ..)| !letters.contains(of));
        self.others.retain(|(of, _)| !letters.contains(of));
        found
    }

    /// Whether it has a radius.
    pub(crate) fn has_radius(&self) -> bool {
        let in_line = self.replaced.iter().any(|(letter, ..)| *letter == b'R');
        in_line || self.others.iter().any(|(letter, _)| *letter == b'R')
    }

    /// Whether the radius of the line goes.
    pub(crate) fn lets_radius_go(&self) -> bool {
        !self.removed.is_empty()
    }

    pub(crate) fn edit(&self, edits: &mut Edits) {
        for (letter, place, number) in &self.replaced {
            edits.set(*letter, *place, *number);
        }
        edits.removed.extend(&self.removed);
    }
}

impl Rewriter {
    /// The words of the circle of a part of an arc; `None`: with these ends a control would not do what is meant.
    pub(crate) fn circle(&self, written: &Written<'_>, line: Line<'_>) -> Option<CircleWords> {
        let (arc, part) = (written.arc, written.part);
        let [start, end] = written.commanded();
        let begins = in_plane(arc, &arc.place(written.ends[0], written.ends[1], part.from));
        let ends = in_plane(arc, &arc.place(written.ends[0], written.ends[1], part.to));
        let middle = middle_of(begins, ends, arc.centre, arc.turns_by < 0.0);
        // How far the circle goes from where it is programmed: its centre, its middle and its radius.
        let (centre_by, middle_by, radius_by);
        if part.is_whole(arc) {
            let by = std::array::from_fn(|i| start[i] - begins[i]);
            (centre_by, middle_by, radius_by) = (by, by, 0.0);
        } else {
            let plain = programmed(arc, written.ends, part);
            let bow = self.corrected(arc, written.ends, part).between(start, end);
            let way = |to: [f64; 2], from: [f64; 2]| -> [f64; 2] {
                std::array::from_fn(|i| to[i] - from[i])
            };
            centre_by = way(bow.centre(), plain.centre());
            middle_by = way(bow.middle(), plain.middle());
            radius_by = bow.radius() - plain.radius();
        }
        let wanted: [f64; 2] = std::array::from_fn(|i| middle[i] + middle_by[i]);
        let is_good = |centre: [f64; 2], most_steps: f64| {
            let found = middle_of(start, end, centre, arc.turns_by < 0.0);
            (found[0] - wanted[0]).hypot(found[1] - wanted[1]) <= most_steps * self.step_mm()
        };
        if arc.by_radius
            && let Some((mut words, radius)) = self.by_radius(written, radius_by, line)
            && let Ok(centre) = centre_of(start, end, radius, arc.turns_by < 0.0)
            && is_good(centre, OFF_BY_RADIUS)
        {
            add_turns(written, line, &mut words);
            return Some(words);
        }
        let centre = std::array::from_fn(|i| arc.centre[i] + centre_by[i]);
        let (mut words, centre) = self.by_centre(written, start, centre, line)?;
        add_turns(written, line, &mut words);
        is_good(centre, OFF_BY_CENTRE).then_some(words)
    }

    /// The words of an arc that is moved as a whole: its radius stays, its centre is this one.
    pub(crate) fn circle_about(
        &self,
        arc: &Arc,
        start: [f64; 2],
        centre: [f64; 2],
        line: Line<'_>,
    ) -> CircleWords {
        if arc.by_radius {
            return CircleWords::default();
        }
        let written = Written {
            arc,
            ends: [&[0.0; 9]; 2],
            part: Stretch { from: 0.0, to: 1.0 },
            place: None,
            carried: [&[0.0; 9]; 2],
        };
        let words = self.by_centre(&written, start, centre, line);
        words.map(|(words, _)| words).unwrap_or_default()
    }

    /// R, and the radius that it says, mm.
    fn by_radius(
        &self,
        written: &Written<'_>,
        radius_by: f64,
        line: Line<'_>,
    ) -> Option<(CircleWords, f64)> {
        let unit = self.interpreter.modal.unit_mm;
        let place = line.place_of(b'R');
        let word = line.word(place)?;
        let sign = match written.place {
            // A half circle may be written either way.
            None => word.value?.signum(),
            Some(_) if written.part.turns(written.arc) > PI => -1.0,
            Some(_) => 1.0,
        };
        // As much larger as the arc is, whatever rounding its radius has.
        let size = word.value?.abs() + radius_by / unit;
        let mut words = CircleWords::default();
        let said = self.word(written, (b'R', sign * size), place, line, &mut words)?;
        Some((words, said * unit))
    }

    /// The centre along both axes, and where these words say that it is, mm.
    fn by_centre(
        &self,
        written: &Written<'_>,
        start: [f64; 2],
        centre: [f64; 2],
        line: Line<'_>,
    ) -> Option<(CircleWords, [f64; 2])> {
        let modal = &self.interpreter.modal;
        let unit = modal.unit_mm;
        let mut words = CircleWords::default();
        let mut said = [0.0; 2];
        if written.arc.by_radius && written.place.unwrap_or(0) == 0 {
            words.removed.extend(line.place_of(b'R'));
        }
        for (i, letter) in modal.plane.centre_letters().into_iter().enumerate() {
            let place = line.place_of(letter);
            let manner = line.word(place).map(|word| word.manner);
            let base = if centre_is_absolute(manner, modal) {
                0.0
            } else {
                start[i]
            };
            let value = (letter, (centre[i] - base) / unit);
            said[i] = base + unit * self.word(written, value, place, line, &mut words)?;
        }
        Some((words, said))
    }

    /// One word, and the value that it has then: in the line of the program it changes only if its number does.
    fn word(
        &self,
        written: &Written<'_>,
        (letter, value): (u8, f64),
        place: Option<usize>,
        line: Line<'_>,
        words: &mut CircleWords,
    ) -> Option<f64> {
        let word = line.word(place);
        let numerals = self.numerals(0, word);
        let said = self.pole_along(letter);
        let before = word.and_then(|word| word.value).or(said).unwrap_or(0.0);
        let changes = (value - before).abs() >= half_step(numerals.decimals);
        let is_missing = letter != b'R' && written.arc.by_radius;
        if !changes && written.place.is_none() && !is_missing {
            return Some(before);
        }
        let of_word = word.and_then(|word| word.decimals).unwrap_or(0);
        let number = numerals.nearest(value, of_word)?;
        if written.place.is_some_and(|part| part > 0) {
            words.others.push((letter, number));
        } else if changes || place.is_some() || is_missing {
            words.replaced.push((letter, place, number));
        } else {
            return Some(before);
        }
        Some(number.value())
    }
}

/// The number of turns of a part, where the arc is in several.
fn add_turns(written: &Written<'_>, line: Line<'_>, words: &mut CircleWords) {
    let Some(part) = written.place else {
        return;
    };
    let place = line.place_of(b'P');
    let turns = written.part.more_turns(written.arc) + 1.0;
    let number = Number::nearest(turns, 0).filter(|_| turns > 1.0);
    match number {
        Some(number) if part > 0 => words.others.push((b'P', number)),
        Some(number) => words.replaced.push((b'P', place, number)),
        None if part == 0 => words.removed.extend(place),
        None => {}
    }
}

/// The middle of the last turn of an arc about a centre, as a control reads it.
fn middle_of(start: [f64; 2], end: [f64; 2], centre: [f64; 2], clockwise: bool) -> [f64; 2] {
    let polar = |at: [f64; 2]| {
        let way = [at[0] - centre[0], at[1] - centre[1]];
        (way[0].hypot(way[1]), way[1].atan2(way[0]))
    };
    let ((from_radius, from), (to_radius, to)) = (polar(start), polar(end));
    let sign = if clockwise { -1.0 } else { 1.0 };
    let mut turns = sign * (sign * (to - from)).rem_euclid(2.0 * PI);
    // An end that is the beginning is a full turn.
    if (end[0] - start[0]).hypot(end[1] - start[1]) < 1e-9 {
        turns = sign * 2.0 * PI;
    }
    let angle = from + 0.5 * turns;
    let radius = 0.5 * (from_radius + to_radius);
    [
        centre[0] + radius * angle.cos(),
        centre[1] + radius * angle.sin(),
    ]
}

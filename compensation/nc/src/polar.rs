//! Arcs about a pole that stands in a block of its own, and polar coordinates: LP, CP, C and CC of HEIDENHAIN controls.
//!
//! The pole is a place. With a correction each arc has a centre of its own, and gets a pole before it where the one that the control
//! has is another. Polar coordinates about such a pole would lead elsewhere: they are written as X and Y.

use crate::{
    NcError,
    block::{Manner, POLAR},
    circle::CircleWords,
    coordinates::Axes,
    given::Given,
    interpret::Interpreter,
    legs::{Words, Writes},
    line::Line,
    motion::{Arc, Move},
    notes::Note,
    number::of_steps,
    rewrite::Rewriter,
    script::{NewWord, Shape},
    words::Number,
};

const NO_POLE: &str = "polar coordinates without a pole (CC) whose place is known";

/// When X and Y of a motion in polar coordinates are written.
pub(crate) fn polar_writes(keeps: bool) -> Writes {
    if keeps { Writes::Never } else { Writes::Always }
}

impl Interpreter {
    /// Where polar coordinates lead, in the coordinates of the program, mm; `None`: the block has none.
    pub(crate) fn polar_end(
        &self,
        given: &Given<'_>,
        before: &Axes,
    ) -> Result<Option<[f64; 2]>, NcError> {
        let [distance, angle] = POLAR.map(|letter| given.block.word(letter));
        if distance.is_none() && angle.is_none() {
            return Ok(None);
        }
        if given.places[0].is_some() || given.places[1].is_some() {
            return Err(given.refused("X or Y beside polar coordinates"));
        }
        let pole = self.modal.pole.ok_or_else(|| given.refused(NO_POLE))?;
        let from = [before[0] - pole[0], before[1] - pole[1]];
        let unit = self.modal.unit_mm;
        let mut radius = from[0].hypot(from[1]);
        if let Some(value) = given.letter(POLAR[0])? {
            let is_way = distance.is_some_and(|word| word.manner == Manner::Incremental);
            radius = value * unit + if is_way { radius } else { 0.0 };
        }
        let start_deg = from[1].atan2(from[0]).to_degrees();
        let mut angle_deg = start_deg;
        if let Some(value) = given.letter(POLAR[1])? {
            let is_way = angle.is_some_and(|word| word.manner == Manner::Incremental);
            angle_deg = value + if is_way { start_deg } else { 0.0 };
            if is_way && distance.is_none() && (value / 360.0).fract() == 0.0 {
                // Whole turns end where they begin, to the last digit.
                return Ok(Some([before[0], before[1]]));
            }
        }
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        Ok(Some([pole[0] + radius * cos, pole[1] + radius * sin]))
    }

    /// It is known where a motion ends whose polar coordinates are both places.
    pub(crate) fn knows_polar(&mut self, given: &Given<'_>) {
        let is_place = |letter: u8| {
            let word = given.block.word(letter);
            word.is_some_and(|word| word.manner != Manner::Incremental)
        };
        if POLAR.into_iter().all(is_place) {
            self.known[..2].fill(true);
        }
    }
}

impl Rewriter {
    /// The pole that the control has along the axis of a letter of the centre, in the unit of its word.
    pub(crate) fn pole_along(&self, letter: u8) -> Option<f64> {
        let place = match letter {
            b'I' => 0,
            b'J' => 1,
            _ => return None,
        };
        self.pole
            .map(|pole| pole[place] / self.interpreter.modal.unit_mm)
    }

    /// Whether a motion in polar coordinates needs no correction in their plane, at any of these places and where it begins.
    pub(crate) fn keeps_polar(&self, places: &[Axes], carried: &Axes) -> bool {
        let unit_mm = self.interpreter.modal.unit_mm;
        let half_mm = 0.5 * unit_mm * of_steps(1, self.decimals.of(0, unit_mm));
        let is_small = |by: &Axes| by[..2].iter().all(|by| by.abs() < half_mm);
        self.has_pole_of_program()
            && is_small(carried)
            && places.iter().all(|at| is_small(&self.delta_in_program(at)))
    }

    /// Whether the pole that the control has is that of the program.
    fn has_pole_of_program(&self) -> bool {
        match (self.pole, self.interpreter.modal.pole) {
            (Some(said), Some(pole)) => (0..2).all(|i| (said[i] - pole[i]).abs() < 1e-9),
            (said, pole) => said == pole,
        }
    }

    /// A block has said the pole: along axes whose coordinate is relative to where the tool is, that is with its correction.
    pub(crate) fn takes_pole(&mut self, relative: [bool; 2]) {
        let interpreter = &self.interpreter;
        let carried = interpreter
            .frame
            .moved_in_program(&interpreter.position, &self.carried);
        self.pole = interpreter.modal.pole.map(|pole| {
            std::array::from_fn(|i| pole[i] + if relative[i] { carried[i] } else { 0.0 })
        });
    }

    /// How an arc is written, and the line with its centre that must stand before it, if any.
    pub(crate) fn shape_of_arc(
        &mut self,
        keeps_polar: bool,
        arc: &Arc,
        circle: &mut CircleWords,
        line: Line<'_>,
    ) -> (Shape, Vec<u8>) {
        if !line.script.is_heidenhain() {
            return (Shape::Centre, Vec::new());
        }
        let centre = circle.take_centre([b'I', b'J']);
        if keeps_polar {
            return (Shape::AsItIs, Vec::new());
        }
        let keeps_radius = arc.by_radius && !circle.lets_radius_go() && centre == [None; 2];
        if circle.has_radius() || keeps_radius {
            return (Shape::Radius, Vec::new());
        }
        let unit = self.interpreter.modal.unit_mm;
        let before = self.pole;
        let numbers = std::array::from_fn(|i| {
            let said = before.map(|pole| pole[i] / unit).unwrap_or_default();
            let decimals = self.decimals.of(0, unit);
            centre[i].or(Number::nearest(said, decimals))
        });
        let [Some(x), Some(y)] = numbers else {
            return (Shape::Centre, Vec::new());
        };
        let changes = |i: usize, number: Number| {
            centre[i].is_some()
                && before.is_none_or(|pole| (unit * number.value() - pole[i]).abs() > 1e-9)
        };
        if !changes(0, x) && !changes(1, y) {
            return (Shape::Centre, Vec::new());
        }
        self.pole = Some([unit * x.value(), unit * y.value()]);
        (Shape::Centre, pole_line([x, y], line))
    }

    /// An arc that passes on goes about the pole of the program.
    pub(crate) fn puts_pole_back(&mut self, line: Line<'_>, out: &mut Vec<u8>) {
        let Some(pole) = self.interpreter.modal.pole else {
            return;
        };
        if !line.script.is_heidenhain() || self.has_pole_of_program() {
            return;
        }
        let unit = self.interpreter.modal.unit_mm;
        let [Some(x), Some(y)] = pole.map(|at| Number::shortest(at / unit, 6)) else {
            return;
        };
        out.extend_from_slice(&pole_line([x, y], line));
        out.extend_from_slice(line.more);
        self.counts.added += 1;
        self.pole = Some(pole);
        self.edits.write(line, out);
    }

    /// The line of the program gets the word for the way in which its motion is written.
    pub(crate) fn goes_as(&mut self, shape: Shape, line: Line<'_>) {
        let keyword = line.block.keyword.clone();
        if shape == Shape::AsItIs || keyword.is_empty() {
            return;
        }
        let length = line.script.keyword(shape).len();
        if length < keyword.len() {
            // LP, CP and CR become L and C.
            let rest = keyword.start + length..keyword.end;
            self.edits.ranges.push((rest, None));
        }
        let polar = POLAR.into_iter().filter_map(|letter| line.place_of(letter));
        self.edits.removed.extend(polar);
    }

    /// A note where an arc gets the coordinate of an axis that it did not have.
    pub(crate) fn notes_superposed(&mut self, words: &Words, motion: &Move, line: Line<'_>) {
        let is_new = |axis: usize| words.numbers[axis].is_some() && motion.words[axis].is_none();
        if line.script.is_heidenhain() && (2..9).any(is_new) {
            self.interpreter.notes.add(Note::Superposed, line.number);
        }
    }
}

/// `CC X+1.000 Y+2.000`.
fn pole_line(centre: [Number; 2], line: Line<'_>) -> Vec<u8> {
    let mut text = b"CC".to_vec();
    for word in [b'X', b'Y'].into_iter().zip(centre) {
        line.script.write_word(&NewWord::plain(word), &mut text);
    }
    text
}

//! Polar coordinates: LP, CP, C and CC of HEIDENHAIN controls, whose pole stands in a block of its own, @ and ^ of LinuxCNC, and G16 of
//! FANUC controls, under which X and Y are the distance from zero and the angle.
//!
//! The pole is a place. With a correction each arc has a centre of its own, and gets a pole before it where the one that the control
//! has is another. Polar coordinates about such a pole would lead elsewhere: they are written as X and Y.

use crate::{
    NcError,
    block::{Manner, Word},
    circle::CircleWords,
    codes::Codes,
    coordinates::Axes,
    dialect::Dialect,
    given::Given,
    interpret::Interpreter,
    legs::Writes,
    line::Line,
    modal::Plane,
    motion::{Arc, Move, Polar},
    notes::Note,
    number::of_steps,
    rewrite::Rewriter,
    script::{NewWord, Shape},
    words::Number,
};

const NO_POLE: &str = "polar coordinates without a pole (CC) whose place is known: name X and Y before a CC that is relative to them";

/// When X and Y of a motion in polar coordinates are written.
pub(crate) fn polar_writes(keeps: bool) -> Writes {
    if keeps { Writes::Never } else { Writes::Always }
}

impl Interpreter {
    /// Whether the X and Y words of a block are polar coordinates: those of motions are, under G16.
    pub(crate) fn takes_polar(&self, codes: &Codes) -> bool {
        let says_no_place = codes.not_modal().is_some() || codes.rotation() == Some(680);
        self.modal.polar.is_some() && !codes.in_machine && !says_no_place
    }

    /// # Errors
    /// What a control makes of polar coordinates is not known here.
    pub(crate) fn check_polar(&self, codes: &Codes, given: &Given<'_>) -> Result<(), NcError> {
        let under_g16 = self.modal.polar.is_some();
        if given.polar.is_none() && !under_g16 {
            return Ok(());
        }
        if self.modal.plane != Plane::Xy && (given.polar.is_some() || given.names_axes()) {
            return Err(given.refused("polar coordinates outside the plane of X and Y (G17)"));
        }
        if self.dialect != Dialect::Rs274 || given.polar.is_none() {
            return Ok(());
        }
        if codes.in_machine {
            return Err(given.refused("polar coordinates that are machine coordinates (G53)"));
        }
        let motion = codes.motion().or(self.modal.motion);
        let is_arc = matches!(motion, Some(20 | 30));
        if is_arc && under_g16 && (given.has(b'I') || given.has(b'J')) {
            return Err(given.refused(
                "an arc with a centre under G16, which controls read in different ways: write it with R",
            ));
        }
        if under_g16 && self.is_way(given.polar_word(0)) {
            return Err(given.refused(
                "a distance under G16 in G91, which controls count from different places: write it in G90",
            ));
        }
        Ok(())
    }

    /// The polar coordinates of a block, if it has any.
    pub(crate) fn polar_of(&self, given: &Given<'_>) -> Option<Polar> {
        let words = given.polar?;
        let says_place = |of: usize| {
            let word = given.polar_word(of);
            word.is_some() && !self.is_way(word)
        };
        // Under G16 they count from what was said before, not from the place of the tool.
        let from_here = self.modal.polar.is_none() && !(says_place(0) && says_place(1));
        Some(Polar { words, from_here })
    }

    /// Whether a word of polar coordinates is a way from where the tool is.
    fn is_way(&self, word: Option<&Word>) -> bool {
        word.is_some_and(|word| match word.manner {
            Manner::Incremental => true,
            Manner::Modal => !self.modal.absolute,
            Manner::Absolute | Manner::Shortest => false,
        })
    }

    /// Where polar coordinates lead, in the coordinates of the program, mm; `None`: the block has none.
    pub(crate) fn polar_end(
        &self,
        given: &Given<'_>,
        before: &Axes,
    ) -> Result<Option<[f64; 2]>, NcError> {
        if given.polar.is_none() {
            return Ok(None);
        }
        if given.places[0].is_some() || given.places[1].is_some() {
            return Err(given.refused("X or Y beside polar coordinates"));
        }
        if let Some(polar) = self.modal.polar {
            let [Some(radius), Some(angle_deg)] = self.said(polar, given)? else {
                return Err(given.refused(
                    "polar coordinates under G16 before both the distance and the angle have been said",
                ));
            };
            let (sin, cos) = angle_deg.to_radians().sin_cos();
            return Ok(Some([radius * cos, radius * sin]));
        }
        let pole = match self.dialect {
            // Those of LinuxCNC, @ and ^, are about the zero of the coordinates that hold.
            Dialect::Rs274 => [0.0; 2],
            _ => self.modal.pole.ok_or_else(|| given.refused(NO_POLE))?,
        };
        let from = [before[0] - pole[0], before[1] - pole[1]];
        let [distance, angle] = [0, 1].map(|of| given.polar_word(of));
        let needs_angle = angle.is_none_or(|_| self.is_way(angle));
        if self.dialect == Dialect::Rs274 && needs_angle && from == [0.0; 2] {
            return Err(given.refused("polar coordinates whose angle counts from a tool at zero"));
        }
        let unit = self.modal.unit_mm;
        let mut radius = from[0].hypot(from[1]);
        if let Some(word) = distance {
            let is_way = self.is_way(distance);
            radius = given.value_of(word)? * unit + if is_way { radius } else { 0.0 };
        }
        let start_deg = from[1].atan2(from[0]).to_degrees();
        let mut angle_deg = start_deg;
        if let Some(word) = angle {
            let value = given.value_of(word)?;
            let is_way = self.is_way(angle);
            angle_deg = value + if is_way { start_deg } else { 0.0 };
            if is_way && distance.is_none() && (value / 360.0).fract() == 0.0 {
                // Whole turns end where they begin, to the last digit.
                return Ok(Some([before[0], before[1]]));
            }
        }
        let (sin, cos) = angle_deg.to_radians().sin_cos();
        Ok(Some([pole[0] + radius * cos, pole[1] + radius * sin]))
    }

    /// The distance (mm) and the angle (deg) under G16, once a block has said its own.
    fn said(
        &self,
        [mut distance, mut angle]: [Option<f64>; 2],
        given: &Given<'_>,
    ) -> Result<[Option<f64>; 2], NcError> {
        if let Some(word) = given.polar_word(0) {
            distance = Some(given.value_of(word)? * self.modal.scale(0));
        }
        if let Some(word) = given.polar_word(1) {
            let value = given.value_of(word)?;
            angle = if self.is_way(Some(word)) {
                angle.map(|angle| angle + value)
            } else {
                Some(value)
            };
        }
        Ok([distance, angle])
    }

    /// A motion has ended that polar coordinates led: where is known if both are places.
    pub(crate) fn ends_polar(&mut self, given: &Given<'_>) -> Result<(), NcError> {
        let is_place = |of: usize| {
            given
                .polar_word(of)
                .is_some_and(|word| !self.is_way(Some(word)))
        };
        let is_known = is_place(0) && is_place(1);
        if let Some(polar) = self.modal.polar {
            self.modal.polar = Some(self.said(polar, given)?);
        }
        if is_known || self.modal.polar.is_some() {
            self.is_named(0);
            self.is_named(1);
        }
        Ok(())
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

    /// Whether a motion is in polar coordinates that need no correction in their plane, at any of these places and where it begins.
    pub(crate) fn keeps_polar(&self, motion: &Move, places: &[Axes], carried: &Axes) -> bool {
        let Some(polar) = motion.polar else {
            return false;
        };
        let unit_mm = self.interpreter.modal.unit_mm;
        let half_mm = 0.5 * unit_mm * of_steps(1, self.numerals(0, None).decimals);
        let is_small = |by: &Axes| by[..2].iter().all(|by| by.abs() < half_mm);
        // What counts from where the tool is goes on with what it is off there.
        let begins = if polar.from_here {
            carried[..2].iter().all(|by| by.abs() < 1e-9)
        } else {
            is_small(carried)
        };
        begins
            && self.has_pole_of_program()
            && !self.polar_is_off
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
            let shape = if keeps_polar {
                Shape::AsItIs
            } else {
                Shape::Centre
            };
            return (shape, Vec::new());
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

    /// The line of the program gets the word for the way in which its motion is written, and loses its polar coordinates where
    /// that is by X and Y.
    pub(crate) fn goes_as(&mut self, shape: Shape, polar: Option<Polar>, line: Line<'_>) {
        if shape == Shape::AsItIs {
            return;
        }
        let keyword = line.block.keyword.clone();
        let length = line.script.keyword(shape).len();
        if length < keyword.len() {
            // LP, CP and CR become L and C.
            let rest = keyword.start + length..keyword.end;
            self.edits.ranges.push((rest, None));
        }
        let Some(polar) = polar else { return };
        self.edits.removed.extend(polar.words.into_iter().flatten());
        if self.interpreter.modal.polar.is_none() {
            return;
        }
        // The control reads X and Y as places from here on, until the program says G16 again.
        let is_g16 = |word: &Word| word.letter == b'G' && word.value == Some(16.0);
        let place = line.block.words.iter().position(is_g16);
        if let Some(code) = Number::nearest(15.0, 0)
            && (place.is_some() || !self.polar_is_off)
        {
            self.edits.set(b'G', place, code);
        }
        self.polar_is_off = true;
    }

    /// A note where an arc gets the coordinate of an axis that it did not have.
    pub(crate) fn notes_superposed(
        &mut self,
        words: &Axes<Option<Number>>,
        motion: &Move,
        line: Line<'_>,
    ) {
        // A helix in polar coordinates gets X and Y, and an arc that had none a further word.
        let is_new = |axis: usize| {
            words[axis].is_some() && (motion.words[axis].is_none() || motion.polar.is_some())
        };
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

//! Executes blocks as RS-274 does: in the order of its rules, whatever the order of the words.

use std::collections::HashMap;

use crate::{
    NcError,
    block::{Block, Parameter, Word},
    codes::{Codes, Refusal, UnknownCode, text},
    coordinates::{Axes, Frame, axis_of, is_rotary},
    fault::Fault,
    modal::{Code, FeedMode, Modal, Plane, SYSTEMS, Sticky},
    motion::{Arc, Move, Path},
    notes::{Note, Notes},
    parameters::{Parameters, Value},
};

/// What a block did.
#[derive(Clone, Debug, Default, PartialEq)]
pub(crate) struct Outcome {
    pub(crate) motion: Option<Move>,
    /// How often its motion is done, one after the other.
    pub(crate) repeats: u32,
    /// Its axis words say where the axes stand (G92, G10 L20): they are the words at these places.
    pub(crate) presets: Option<Axes<Option<usize>>>,
    /// The program ends here.
    pub(crate) ends: bool,
    /// M98 or M99.
    pub(crate) calls: Option<Code>,
}

/// State: everything that a program has set, and where its axes are.
#[derive(Clone, Debug)]
pub(crate) struct Interpreter {
    pub(crate) modal: Modal,
    pub(crate) frame: Frame,
    /// Where the axes are, in the coordinates of the machine, mm and deg, and whether that is known.
    pub(crate) position: Axes,
    pub(crate) known: Axes<bool>,
    pub(crate) parameters: Parameters,
    /// The offset of each tool.
    pub(crate) tools: HashMap<u32, Axes>,
    pub(crate) notes: Notes,
}

impl Interpreter {
    pub(crate) fn new(modal: Modal, position: Axes, known: Axes<bool>) -> Self {
        Self {
            frame: modal.frame(),
            modal,
            position,
            known,
            parameters: Parameters::default(),
            tools: HashMap::new(),
            notes: Notes::default(),
        }
    }

    /// Where the axes are, in the coordinates of the program.
    pub(crate) fn program_position(&self) -> Axes {
        self.frame.to_program(&self.position)
    }

    /// A named parameter that the control provides.
    pub(crate) fn provided(&self, name: &str) -> Option<Value> {
        let truth = |truth: bool| Some(Some(f64::from(u8::from(truth))));
        let modal = &self.modal;
        if let [b'_', letter] = name.as_bytes()
            && let Some(axis) = axis_of(letter.to_ascii_uppercase())
        {
            let at = self.program_position()[axis] / modal.scale(axis);
            return Some(self.known[axis].then_some(at));
        }
        match name {
            "_metric" => truth(modal.unit_mm == 1.0),
            "_imperial" => truth(modal.unit_mm != 1.0),
            "_absolute" => truth(modal.absolute),
            "_incremental" => truth(!modal.absolute),
            "_feed" => Some(modal.feed),
            "_coord_system" => Some(Some(
                [
                    540.0, 550.0, 560.0, 570.0, 580.0, 590.0, 591.0, 592.0, 593.0,
                ][modal.system.min(8)],
            )),
            "_current_tool" | "_selected_tool" => Some(modal.tool.map(f64::from)),
            "_motion_mode" => Some(modal.motion.map(f64::from)),
            // Of the machine, and set by it.
            _ if name.starts_with("_ini[")
                || name.starts_with("_hal[")
                || matches!(
                    name,
                    "_vmajor"
                        | "_vminor"
                        | "_line"
                        | "_rpm"
                        | "_task"
                        | "_value"
                        | "_value_returned"
                        | "_remote_call"
                ) =>
            {
                Some(None)
            }
            _ => None,
        }
    }

    /// A numbered parameter that the control provides.
    pub(crate) fn numbered(&self, number: u32) -> Option<Value> {
        let place = |first: u32| Some((number - first) as usize);
        let (list, axis): (&Axes, _) = match number {
            5161..=5169 => (&self.modal.homes[0], place(5161)?),
            5181..=5189 => (&self.modal.homes[1], place(5181)?),
            5211..=5219 => (&self.modal.shift, place(5211)?),
            5220 => return Some(Some(self.modal.system as f64 + 1.0)),
            5221..=5390 => {
                let (system, axis) = (place(5221)? / 20, place(5221)? % 20);
                let offset = self.modal.offsets.get(system)?;
                if axis == 9 {
                    return Some(Some(offset.rotation_deg));
                }
                let at = *offset.offset.get(axis)?;
                return Some(Some(at / self.length_unit(axis)));
            }
            5400 => return Some(self.modal.tool.map(f64::from)),
            5401..=5409 => (&self.modal.tool_offset, place(5401)?),
            5420..=5428 => {
                let axis = place(5420)?;
                let at = self.program_position()[axis] / self.modal.scale(axis);
                return Some(self.known[axis].then_some(at));
            }
            _ => return None,
        };
        let at = *list.get(axis)?;
        Some(Some(at / self.length_unit(axis)))
    }

    fn length_unit(&self, axis: usize) -> f64 {
        if is_rotary(axis) {
            1.0
        } else {
            self.modal.unit_mm
        }
    }

    /// Executes a block that was read; `line` is counted from 1.
    pub(crate) fn execute(&mut self, block: &Block, line: usize) -> Result<Outcome, NcError> {
        let codes = Codes::of(block).map_err(|refusal| refused(refusal, block, line))?;
        let words = axis_words(block, line)?;
        let mut outcome = Outcome {
            repeats: 1,
            ends: codes.ends,
            calls: codes.calls,
            ..Outcome::default()
        };
        self.switch(&codes, block, &words, line)?;
        let uses_words = self.not_modal(&codes, block, &words, line, &mut outcome)?;
        if !uses_words && codes.calls.is_none() {
            self.motion(&codes, block, &words, line, &mut outcome)?;
        } else if let Some(motion) = codes.motion() {
            self.set_motion(motion);
        }
        for assignment in &block.assignments {
            let value = assignment.value;
            match &assignment.parameter {
                Parameter::Named(name) => self.parameters.set_named(name, value),
                Parameter::Numbered(number) => self.parameters.set_numbered(*number, value),
            }
        }
        Ok(outcome)
    }

    /// What a block switches, besides its motion.
    fn switch(
        &mut self,
        codes: &Codes,
        block: &Block,
        words: &Axes<Option<usize>>,
        line: usize,
    ) -> Result<(), NcError> {
        let modal = &mut self.modal;
        match codes.feed() {
            Some(930) => modal.feed_mode = FeedMode::InverseTime,
            Some(940) => modal.feed_mode = FeedMode::PerMinute,
            Some(950) => modal.feed_mode = FeedMode::PerRevolution,
            _ => {}
        }
        if let Some(feed) = block.word(b'F') {
            modal.feed = feed.value;
        }
        if let Some(tool) = block.word(b'T').and_then(|tool| tool.value) {
            modal.tool = whole(tool, 99_999);
        }
        match codes.plane() {
            Some(170) => modal.plane = Plane::Xy,
            Some(180) => modal.plane = Plane::Zx,
            Some(190) => modal.plane = Plane::Yz,
            _ => {}
        }
        match codes.units() {
            Some(200) => modal.unit_mm = 25.4,
            Some(210) => modal.unit_mm = 1.0,
            _ => {}
        }
        match codes.diameter() {
            Some(70) => modal.diameter = true,
            Some(80) => modal.diameter = false,
            _ => {}
        }
        match codes.radius() {
            Some(400) => modal.radius = None,
            Some(code) => modal.radius = Some(code),
            None => {}
        }
        match codes.distance() {
            Some(900) => modal.absolute = true,
            Some(910) => modal.absolute = false,
            _ => {}
        }
        match codes.centre() {
            Some(901) => modal.centre_absolute = true,
            Some(911) => modal.centre_absolute = false,
            _ => {}
        }
        match codes.comes_back() {
            Some(980) => modal.comes_back = true,
            Some(990) => modal.comes_back = false,
            _ => {}
        }
        if let Some(code) = codes.tool_length() {
            self.tool_length(code, block, words, line)?;
        }
        if let Some(code) = codes.work_offset() {
            let systems = [540, 550, 560, 570, 580, 590, 591, 592, 593];
            self.modal.system = systems.iter().position(|of| *of == code).unwrap_or(0);
        }
        match codes.rotation() {
            Some(680) => {
                let angle = given(block, b'R', line)?
                    .ok_or_else(|| not_compensated(line, "G68 without an angle R"))?;
                let place = |axis: usize| -> Result<f64, NcError> {
                    let value = word_value(block, words[axis], line)?;
                    Ok(value.map_or(0.0, |value| value * self.modal.scale(axis)))
                };
                if self.modal.plane != Plane::Xy {
                    return Err(not_compensated(
                        line,
                        "a rotation in another plane than X Y (G17)",
                    ));
                }
                self.modal.rotation = Some((angle, [place(0)?, place(1)?]));
            }
            Some(690) => self.modal.rotation = None,
            _ => {}
        }
        if codes.tool_length().is_some()
            || codes.work_offset().is_some()
            || codes.rotation().is_some()
        {
            self.frame = self.modal.frame();
        }
        Ok(())
    }

    fn tool_length(
        &mut self,
        code: Code,
        block: &Block,
        words: &Axes<Option<usize>>,
        line: usize,
    ) -> Result<(), NcError> {
        if code == 490 {
            self.modal.tool_offset = [0.0; 9];
            return Ok(());
        }
        if code == 431 {
            for axis in 0..9 {
                if let Some(value) = word_value(block, words[axis], line)? {
                    self.modal.tool_offset[axis] = value * self.modal.scale(axis);
                }
            }
            return Ok(());
        }
        let number = given(block, b'H', line)?.and_then(|number| whole(number, 99_999));
        let number = number.or(self.modal.tool).unwrap_or(0);
        let offset = self.tools.get(&number).copied();
        if offset.is_none() && number != 0 {
            self.notes.add(Note::NoToolLength(number), line);
        }
        let offset = offset.unwrap_or([0.0; 9]);
        for axis in 0..9 {
            let before = if code == 432 {
                self.modal.tool_offset[axis]
            } else {
                0.0
            };
            self.modal.tool_offset[axis] = before + offset[axis];
        }
        Ok(())
    }

    /// Codes that hold for their block only. Whether the axis words are theirs.
    fn not_modal(
        &mut self,
        codes: &Codes,
        block: &Block,
        words: &Axes<Option<usize>>,
        line: usize,
        outcome: &mut Outcome,
    ) -> Result<bool, NcError> {
        match codes.not_modal() {
            Some(100) => self.set_table(block, words, line, outcome)?,
            Some(code @ (280 | 300)) => {
                self.go_home(usize::from(code == 300), block, words, line, outcome)?;
            }
            Some(code @ (281 | 301)) => {
                if self.known != [true; 9] {
                    self.notes.add(Note::HomeUnknown, line);
                }
                self.modal.homes[usize::from(code == 301)] = self.position;
            }
            Some(920) => {
                self.modal.shifted = true;
                self.frame = self.modal.frame();
                for axis in 0..9 {
                    if let Some(value) = word_value(block, words[axis], line)? {
                        // Where the axis is, the program reads this value from now on.
                        let at = self.program_position()[axis] - value * self.modal.scale(axis);
                        self.modal.shift[axis] += at;
                        self.frame = self.modal.frame();
                    }
                }
                outcome.presets = Some(*words);
            }
            Some(520) => {
                for axis in 0..9 {
                    if let Some(value) = word_value(block, words[axis], line)? {
                        self.modal.shift[axis] = value * self.modal.scale(axis);
                    }
                }
                self.modal.shifted = true;
            }
            Some(921) => (self.modal.shift, self.modal.shifted) = ([0.0; 9], false),
            Some(922) => self.modal.shifted = false,
            Some(923) => self.modal.shifted = true,
            _ => {
                let are_taken = codes.tool_length() == Some(431) || codes.rotation().is_some();
                return Ok(are_taken);
            }
        }
        self.frame = self.modal.frame();
        Ok(codes.not_modal() != Some(40))
    }

    /// G10.
    fn set_table(
        &mut self,
        block: &Block,
        words: &Axes<Option<usize>>,
        line: usize,
        outcome: &mut Outcome,
    ) -> Result<(), NcError> {
        let number = |letter: u8| -> Result<Option<u32>, NcError> {
            Ok(given(block, letter, line)?.and_then(|value| whole(value, 99_999)))
        };
        let (kind, place) = (number(b'L')?, number(b'P')?);
        match kind {
            Some(2 | 20) => {
                let system = match place {
                    Some(0) | None => self.modal.system,
                    Some(system) if system as usize <= SYSTEMS => system as usize - 1,
                    Some(_) => {
                        return Err(not_compensated(
                            line,
                            "G10 with a P that is no work offset, 1 to 9",
                        ));
                    }
                };
                if let Some(angle) = given(block, b'R', line)? {
                    self.modal.offsets[system].rotation_deg = angle;
                }
                for axis in 0..9 {
                    let Some(value) = word_value(block, words[axis], line)? else {
                        continue;
                    };
                    let value = value * self.modal.scale(axis);
                    if kind == Some(2) {
                        self.modal.offsets[system].offset[axis] = value;
                        continue;
                    }
                    // The offset with which the axis is where it is at this value.
                    let mut before = self.modal.clone();
                    before.system = system;
                    let at = before.frame().to_program(&self.position);
                    let mut way = [0.0; 9];
                    way[axis] = at[axis] - value;
                    let way = before.frame().way_to_machine(&way);
                    for (offset, way) in self.modal.offsets[system].offset.iter_mut().zip(way) {
                        *offset += way;
                    }
                }
                if kind == Some(20) {
                    outcome.presets = Some(*words);
                }
            }
            Some(1) => {
                let Some(tool) = place else {
                    return Err(not_compensated(
                        line,
                        "G10 L1 without the number of a tool P",
                    ));
                };
                let mut offset = self.tools.get(&tool).copied().unwrap_or([0.0; 9]);
                for axis in 0..9 {
                    if let Some(value) = word_value(block, words[axis], line)? {
                        offset[axis] = value * self.modal.scale(axis);
                    }
                }
                self.tools.insert(tool, offset);
            }
            _ => return Err(not_compensated(line, "G10 with another L than 1, 2 or 20")),
        }
        Ok(())
    }

    /// G28 and G30: over the place that the words name to the place of the machine that is set.
    fn go_home(
        &mut self,
        which: usize,
        block: &Block,
        words: &Axes<Option<usize>>,
        line: usize,
        outcome: &mut Outcome,
    ) -> Result<(), NcError> {
        for axis in 0..9 {
            word_value(block, words[axis], line)?;
        }
        let all = words.iter().all(Option::is_none);
        let from = self.position;
        for (axis, word) in words.iter().enumerate() {
            if all || word.is_some() {
                self.position[axis] = self.modal.homes[which][axis];
                self.known[axis] = true;
            }
        }
        outcome.motion = Some(Move {
            path: Path::Other,
            from,
            to: self.position,
            words: if all { [Some(usize::MAX); 9] } else { *words },
            incremental: false,
            in_machine: true,
        });
        Ok(())
    }

    fn set_motion(&mut self, code: Code) {
        let is_cycle = |code: Code| (730..900).contains(&code);
        if self.modal.motion.is_none_or(|before| !is_cycle(before)) || !is_cycle(code) {
            self.modal.sticky = Sticky::default();
        }
        self.modal.motion = (code != 800).then_some(code);
    }

    fn motion(
        &mut self,
        codes: &Codes,
        block: &Block,
        words: &Axes<Option<usize>>,
        line: usize,
        outcome: &mut Outcome,
    ) -> Result<(), NcError> {
        if block.word(b'@').is_some() || block.word(b'^').is_some() {
            return Err(not_compensated(line, "polar coordinates (@ and ^)"));
        }
        if let Some(code) = codes.motion() {
            self.set_motion(code);
        }
        let has_words = words.iter().any(Option::is_some);
        let has_centre = || {
            block
                .words
                .iter()
                .any(|word| matches!(word.letter, b'I' | b'J' | b'K'))
        };
        let Some(code) = self.modal.motion else {
            if has_words {
                return Err(not_compensated(
                    line,
                    "axis words without a motion that takes them",
                ));
            }
            return Ok(());
        };
        let is_whole_circle = matches!(code, 20 | 30) && codes.motion().is_some() && has_centre();
        if !(has_words || is_whole_circle || code == 50) {
            return Ok(());
        }
        let incremental = !self.modal.absolute;
        let from = self.position;
        let path = match code {
            // Arcs and cycles are made below, once their ends are known.
            0 | 730..=890 => Path::Rapid,
            10 | 20 | 30 => Path::Line,
            _ => {
                self.notes.add(Note::PassedOn(text(code)), line);
                Path::Other
            }
        };
        let end = self.end(block, words, codes.in_machine, incremental, line)?;
        let mut motion = Move {
            path,
            from,
            to: end,
            words: *words,
            incremental: incremental && !codes.in_machine,
            in_machine: codes.in_machine,
        };
        if matches!(code, 20 | 30) {
            motion.path = Path::Arc(self.arc(code, block, &end, line)?);
        } else if (730..=890).contains(&code) {
            self.hole(block, words, line, &mut motion, outcome)?;
        } else if (380..=389).contains(&code) {
            for (axis, word) in words.iter().enumerate() {
                if word.is_some() {
                    self.known[axis] = false;
                }
            }
            self.position = motion.to;
            outcome.motion = Some(motion);
            return Ok(());
        }
        for (axis, word) in words.iter().enumerate() {
            self.known[axis] |= word.is_some() && !motion.incremental;
        }
        if code != 331 {
            self.position = motion.to;
        }
        outcome.motion = Some(motion);
        Ok(())
    }

    /// Where the words of a motion lead, in the coordinates of the machine.
    fn end(
        &self,
        block: &Block,
        words: &Axes<Option<usize>>,
        in_machine: bool,
        incremental: bool,
        line: usize,
    ) -> Result<Axes, NcError> {
        if in_machine {
            let mut end = self.position;
            for axis in 0..9 {
                if let Some(value) = word_value(block, words[axis], line)? {
                    end[axis] = value * self.modal.scale(axis);
                }
            }
            return Ok(end);
        }
        let before = self.program_position();
        let mut end = before;
        for axis in 0..9 {
            if let Some(value) = word_value(block, words[axis], line)? {
                let value = value * self.modal.scale(axis);
                end[axis] = if incremental {
                    before[axis] + value
                } else {
                    value
                };
            }
        }
        let to = self.frame.to_machine(&end);
        // What is not named stays where it is, to the last digit.
        let turns = self.frame.rotation_deg != 0.0 && (words[0].is_some() || words[1].is_some());
        Ok(std::array::from_fn(|axis| {
            if words[axis].is_some() || axis < 2 && turns {
                to[axis]
            } else {
                self.position[axis]
            }
        }))
    }

    /// The arc of a block that ends at `end`.
    fn arc(&self, code: Code, block: &Block, end: &Axes, line: usize) -> Result<Arc, NcError> {
        let axes = self.modal.plane.axes();
        let [first, second, _] = axes;
        let (from, to) = (self.program_position(), self.frame.to_program(end));
        let (start, end) = ([from[first], from[second]], [to[first], to[second]]);
        let letters = self.modal.plane.centre_letters();
        let unit = self.modal.unit_mm;
        let mut ways = [None; 2];
        for (way, letter) in ways.iter_mut().zip(letters) {
            *way = given(block, letter, line)?.map(|value| value * unit);
        }
        let clockwise = code == 20;
        let radius = given(block, b'R', line)?.map(|radius| radius * unit);
        let (centre, by_radius) = match (radius, ways) {
            (Some(_), [Some(_), _] | [_, Some(_)]) => {
                return Err(not_compensated(line, "an arc with a radius R and a centre"));
            }
            (Some(radius), _) => (
                centre_of(start, end, radius, clockwise)
                    .map_err(|what| not_compensated(line, what))?,
                true,
            ),
            (None, [None, None]) => {
                return Err(not_compensated(
                    line,
                    "an arc without a centre and without a radius R",
                ));
            }
            (None, ways) => {
                let centre = std::array::from_fn(|i| {
                    let base = if self.modal.centre_absolute {
                        0.0
                    } else {
                        start[i]
                    };
                    base + ways[i].unwrap_or(0.0)
                });
                (centre, false)
            }
        };
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
        if let Some(turns) = given(block, b'P', line)? {
            let turns = whole(turns, 100_000).filter(|turns| *turns > 0);
            let more = turns.ok_or_else(|| {
                not_compensated(line, "an arc with a P that is no number of turns")
            })? - 1;
            turns_by += f64::from(more) * whole_turn.copysign(turns_by);
        }
        Ok(Arc {
            axes,
            centre,
            turns_by,
            by_radius,
        })
    }

    /// A canned cycle.
    fn hole(
        &mut self,
        block: &Block,
        words: &Axes<Option<usize>>,
        line: usize,
        motion: &mut Move,
        outcome: &mut Outcome,
    ) -> Result<(), NcError> {
        let [_, _, depth] = self.modal.plane.axes();
        let before = self.program_position();
        let unit = self.modal.unit_mm;
        let incremental = motion.incremental;
        let clearance = match given(block, b'R', line)? {
            Some(value) if incremental => Some(before[depth] + value * unit),
            Some(value) => Some(value * unit),
            None => self.modal.sticky.clearance,
        };
        let bottom = match (word_value(block, words[depth], line)?, clearance) {
            (Some(value), Some(clearance)) if incremental => Some(clearance + value * unit),
            (Some(value), _) if !incremental => Some(value * unit),
            _ => self.modal.sticky.bottom,
        };
        let (Some(bottom), Some(clearance)) = (bottom, clearance) else {
            return Err(not_compensated(
                line,
                "a cycle without its depth or its plane R",
            ));
        };
        self.modal.sticky.bottom = Some(bottom);
        self.modal.sticky.clearance = Some(clearance);
        let repeats = match given(block, b'L', line)? {
            Some(repeats) => whole(repeats, 100_000)
                .filter(|repeats| *repeats > 0)
                .ok_or_else(|| {
                    not_compensated(line, "a cycle with an L that is no number of holes")
                })?,
            None => 1,
        };
        outcome.repeats = repeats;
        motion.path = Path::Hole { bottom, clearance };
        let mut end = self.frame.to_program(&motion.to);
        if incremental {
            for axis in 0..9 {
                if axis != depth && words[axis].is_some() {
                    let way = end[axis] - before[axis];
                    end[axis] = before[axis] + f64::from(repeats) * way;
                }
            }
        }
        end[depth] = if self.modal.comes_back {
            before[depth].max(clearance)
        } else {
            clearance
        };
        motion.to = self.frame.to_machine(&end);
        Ok(())
    }
}

/// The words of the axes; each letter once.
fn axis_words(block: &Block, line: usize) -> Result<Axes<Option<usize>>, NcError> {
    let mut words = [None; 9];
    let mut seen = 0_u32;
    for (place, word) in block.words.iter().enumerate() {
        if let Some(axis) = axis_of(word.letter) {
            words[axis] = Some(place);
        }
        let letter = word.letter;
        if letter.is_ascii_uppercase() && letter != b'G' && letter != b'M' {
            let bit = 1 << (letter - b'A');
            if seen & bit != 0 {
                let name = char::from(letter).to_string();
                return Err(NcError::Block {
                    line,
                    fault: Fault::Twice {
                        found: name.clone(),
                        other: name,
                    },
                });
            }
            seen |= bit;
        }
    }
    Ok(words)
}

/// The value of the word at a place, in its own unit.
fn word_value(block: &Block, place: Option<usize>, line: usize) -> Result<Option<f64>, NcError> {
    let word = place.and_then(|place| block.words.get(place));
    word.map(|word| value_of(word, line)).transpose()
}

/// The value of the word with a letter.
fn given(block: &Block, letter: u8, line: usize) -> Result<Option<f64>, NcError> {
    block
        .word(letter)
        .map(|word| value_of(word, line))
        .transpose()
}

fn value_of(word: &Word, line: usize) -> Result<f64, NcError> {
    word.value.ok_or(NcError::OnlyAtMachine {
        line,
        word: char::from(word.letter),
    })
}

/// A whole number up to the largest.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "the range was looked at before"
)]
fn whole(value: f64, most: u32) -> Option<u32> {
    let rounded = value.round();
    let is_whole = (value - rounded).abs() < 1e-3 && (0.0..=f64::from(most)).contains(&rounded);
    is_whole.then_some(rounded as u32)
}

/// The centre of an arc by its radius: a negative one means the longer way.
fn centre_of(
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
    if rest < 0.0 && radius.abs() * (1.0 + 1e-4) < 0.5 * chord {
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

fn not_compensated(line: usize, what: &str) -> NcError {
    NcError::NotCompensated {
        line,
        what: what.to_owned(),
    }
}

fn refused(refusal: Refusal, block: &Block, line: usize) -> NcError {
    match refusal {
        Refusal::Fault(fault) => NcError::Block { line, fault },
        Refusal::Unknown(UnknownCode(code)) => NcError::UnknownCode {
            line,
            code: text(code),
        },
        Refusal::NoCode(place) => match block.words.get(place) {
            Some(word) if word.value.is_none() => NcError::OnlyAtMachine {
                line,
                word: char::from(word.letter),
            },
            word => NcError::NotCompensated {
                line,
                what: format!(
                    "{} with a number that is no code",
                    word.map_or('G', |word| char::from(word.letter))
                ),
            },
        },
    }
}

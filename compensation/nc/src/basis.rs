//! On what the place of an axis rests. What the set-up does not state is taken as zero; a place that was named under such an offset or
//! length is known in the coordinates of the program as long as the same ones are in force, and under no others: a word that is added
//! there would lead to a made-up place.

use crate::{
    coordinates::{Axes, LETTERS},
    interpret::Interpreter,
    legs::AxisWay,
    modal::{Plane, SYSTEMS},
    motion::{Move, Path},
    notes::Note,
    number::half_step,
    rewrite::Rewriter,
    setup::{SetUp, name_of_offset},
};

/// What lies between program and machine along an axis and is not stated: a number for the work offset, the length of the tool and the
/// shift; 0 where it is stated.
pub(crate) type Basis = [u32; 3];

/// The place is stated in the coordinates of the machine.
const OF_MACHINE: Basis = [0; 3];
/// The place rests on something that no work offset, length or shift stands for: a home that is not stated.
const ASSUMED: Basis = [u32::MAX >> 1; 3];
/// A code that is not known has had the words of the axis, whose place may have been reached, without a correction.
const UNCLAIMED: Basis = [u32::MAX >> 2; 3];
/// What was set where nobody knew where the axis stood: machine coordinates would be made up.
const LOST: u32 = 1 << 31;

/// State: on what the places of the axes rest.
#[derive(Clone, Debug)]
pub(crate) struct Rests {
    places: Axes<Basis>,
    offsets: Vec<Axes<u32>>,
    tool: u32,
    shift: Axes<u32>,
    /// Axes that the program has named under a stated zero ([`Interpreter::rests_on_stated_zero`]).
    named: Axes<bool>,
    /// Axes with a G92 shift from a position that was not named so: that position defines zero, not the work offset.
    from_elsewhere: Axes<bool>,
    /// Work offsets that the program has set (G10).
    set: [bool; SYSTEMS],
    /// Whether the places of G28 and G30 are known, and on what they rest.
    homes: [Axes<(bool, Basis)>; 2],
    /// Numbers that nothing has yet.
    next: u32,
}

impl Rests {
    /// At the beginning of a program.
    pub(crate) fn new(setup: &SetUp) -> Self {
        let number = |(system, number): (usize, u32)| match setup.offset(system) {
            Some(_) => [0; 9],
            None => [number; 9],
        };
        let offsets: Vec<_> = (0..SYSTEMS).zip(1..).map(number).collect();
        Self {
            places: [OF_MACHINE; 9],
            next: offsets.len().try_into().unwrap_or(LOST >> 1),
            offsets,
            tool: 0,
            shift: [0; 9],
            named: [false; 9],
            from_elsewhere: [false; 9],
            set: [false; SYSTEMS],
            homes: setup.states_homes().map(|stated| {
                stated.map(|stated| (true, if stated { OF_MACHINE } else { ASSUMED }))
            }),
        }
    }

    /// Another length of the tool holds: that of a tool that the set-up does not state, or one that is known.
    pub(crate) fn takes_tool(&mut self, unstated: Option<u32>) {
        self.tool = unstated.map_or(0, |tool| tool.saturating_add(1));
    }

    /// The length of a tool that the set-up does not state holds.
    pub(crate) fn has_unstated_tool(&self) -> bool {
        self.tool != 0
    }

    /// The shift of all axes is stated from now on: it is none.
    pub(crate) fn shift_is_zero(&mut self) {
        (self.shift, self.from_elsewhere) = ([0; 9], [false; 9]);
    }

    /// The shift of an axis is stated from now on.
    pub(crate) fn shift_is_stated(&mut self, axis: usize) {
        (self.shift[axis], self.from_elsewhere[axis]) = (0, false);
    }

    /// A work offset is stated along an axis from now on.
    pub(crate) fn offset_is_stated(&mut self, system: usize, axis: usize) {
        if let Some(offset) = self.offsets.get_mut(system) {
            offset[axis] = 0;
        }
        self.is_set(system);
    }

    /// The program sets a work offset (G10).
    fn is_set(&mut self, system: usize) {
        if let Some(set) = self.set.get_mut(system) {
            *set = true;
        }
    }

    fn new_number(&mut self, known: bool) -> u32 {
        self.next += 1;
        self.next | if known { 0 } else { LOST }
    }
}

impl Interpreter {
    /// On what a place rests that the program names now.
    fn basis(&self, axis: usize) -> Basis {
        let (rests, modal) = (&self.rests, &self.modal);
        // The length is along Z, or along an axis that only a lathe or another plane knows.
        let has_length = axis == 2 || axis < 3 && modal.plane != Plane::Xy;
        [
            rests.offsets.get(modal.system).map_or(0, |of| of[axis]),
            if has_length { rests.tool } else { 0 },
            if modal.shifted { rests.shift[axis] } else { 0 },
        ]
    }

    /// Whether the coordinate of an axis in the program is known, so that a word with it leads to where it stands.
    #[inline]
    pub(crate) fn says_place(&self, axis: usize) -> bool {
        self.known[axis] && self.rests.places[axis] == self.basis(axis)
    }

    /// Whether the active work offset of the set-up file defines the zero of the program: no G10 and no G92 shift from another position replaces it.
    pub(crate) fn rests_on_stated_zero(&self) -> bool {
        let is_set = self.rests.set[self.modal.system.min(SYSTEMS - 1)];
        let is_elsewhere = self.modal.shifted && self.rests.from_elsewhere.contains(&true);
        !is_set && !is_elsewhere
    }

    /// The program has named the place of an axis.
    pub(crate) fn is_named(&mut self, axis: usize) {
        let basis = self.basis(axis);
        self.rests.places[axis] = basis;
        self.rests.named[axis] = self.rests_on_stated_zero();
        self.known[axis] = basis.iter().all(|number| number & LOST == 0);
    }

    /// An axis is at a place that was stated in the coordinates of the machine.
    pub(crate) fn is_at_machine_place(&mut self, axis: usize) {
        self.rests.places[axis] = OF_MACHINE;
        self.rests.named[axis] = false;
        self.known[axis] = true;
    }

    /// The machine coordinate of an axis is taken as known, but not its coordinate in the program.
    pub(crate) fn is_assumed(&mut self, axis: usize) {
        self.rests.places[axis] = ASSUMED;
        self.rests.named[axis] = false;
    }

    /// The program coordinates of X, Y and Z are unknown: many machines stay at the place where they change tools.
    pub(crate) fn forget_positions(&mut self) {
        for axis in 0..3 {
            self.is_assumed(axis);
        }
    }

    /// A code that is not known has the words of these axes: it may have moved any of them.
    pub(crate) fn may_have_moved(&mut self, named: &Axes<bool>) {
        for (axis, named) in named.iter().enumerate() {
            self.is_assumed(axis);
            if *named {
                self.rests.places[axis] = UNCLAIMED;
                self.known[axis] = false;
            }
        }
    }

    /// Whether a code that is not known has had the words of an axis, which was not named since.
    pub(crate) fn is_unclaimed(&self, axis: usize) -> bool {
        self.rests.places[axis] == UNCLAIMED
    }

    /// The place of G28 or G30 is where the axes are.
    pub(crate) fn stores_home(&mut self, which: usize) {
        self.modal.homes[which] = self.position;
        self.rests.homes[which] =
            std::array::from_fn(|axis| (self.known[axis], self.rests.places[axis]));
    }

    /// An axis is at the place of G28 or G30; whether the set-up or G28.1 has said where that is.
    pub(crate) fn is_at_home(&mut self, which: usize, axis: usize) -> bool {
        self.position[axis] = self.modal.homes[which][axis];
        let (known, basis) = self.rests.homes[which][axis];
        (self.known[axis], self.rests.places[axis]) = (known, basis);
        self.rests.named[axis] = false;
        known && basis != ASSUMED
    }

    /// The axes whose places a coordinate along an axis mixes.
    fn mixed_with(&self, axis: usize) -> std::ops::Range<usize> {
        if axis < 2 && self.frame.rotation_deg != 0.0 {
            0..2
        } else {
            axis..axis + 1
        }
    }

    /// G92 has said where axes are: the shift along them rests on what the places do.
    pub(crate) fn shift_is_from_place(&mut self, axis: usize, line: usize) {
        let known = self.mixed_with(axis).all(|axis| self.known[axis]);
        if !(self.mixed_with(axis)).all(|axis| self.rests.named[axis]) && self.machine_has(axis) {
            self.rests.from_elsewhere[axis] = true;
        }
        if !known {
            self.rests.shift[axis] = self.rests.new_number(false);
            self.notes.add(Note::NoStart, line);
        } else if self.rests.places[axis] != self.basis(axis) {
            self.rests.shift[axis] = self.rests.new_number(true);
        }
        self.rests.places[axis] = self.basis(axis);
    }

    /// G10 L20 has said where axes are under a work offset.
    pub(crate) fn offset_is_from_place(&mut self, system: usize, axis: usize, line: usize) {
        let mixed = self.mixed_with(axis);
        let known = mixed.clone().all(|axis| self.known[axis]);
        self.rests.is_set(system);
        if !known {
            self.notes.add(Note::NoStart, line);
        }
        for axis in mixed {
            let [_, tool, shift] = self.basis(axis);
            let place = self.rests.places[axis];
            let is_exact = known && place == OF_MACHINE && [tool, shift] == [0; 2];
            let stays = known && system == self.modal.system && place == self.basis(axis);
            if !stays && let Some(offset) = self.rests.offsets.get(system).copied() {
                let mut offset = offset;
                offset[axis] = if is_exact {
                    0
                } else {
                    self.rests.new_number(known)
                };
                self.rests.offsets[system] = offset;
            }
        }
        if system == self.modal.system {
            self.rests.places[axis] = self.basis(axis);
        }
    }

    /// The work offset that holds, if it is not stated and zero was taken.
    pub(crate) fn unstated_offset(&self) -> Option<String> {
        let system = self.modal.system;
        let offset = self.rests.offsets.get(system)?;
        let number = u32::try_from(system).ok()? + 1;
        offset.contains(&number).then(|| name_of_offset(system))
    }
}

impl Rewriter {
    /// Whether a word may be added for an axis that a block does not name; a note where it is left out.
    pub(crate) fn may_add(&mut self, axis: usize, way: &AxisWay, line: usize) -> bool {
        if way.incremental || self.interpreter.says_place(axis) {
            return true;
        }
        let needed = (way.delta - way.carried) / self.interpreter.modal.scale(axis);
        if way.written.is_none() && needed.abs() >= half_step(way.numerals.decimals) {
            let note = Note::LeftOut(char::from(LETTERS[axis]));
            self.interpreter.notes.add(note, line);
        }
        false
    }

    /// Notes a motion that passes on as it is, or in one part, since it is in machine coordinates or begins where nobody knows.
    pub(crate) fn note_unknown(&mut self, motion: &Move, line: usize) {
        if motion.in_machine || matches!(motion.path, Path::Home(_)) {
            self.interpreter.notes.add(Note::InMachine, line);
            return;
        }
        let of_plane = match motion.path {
            Path::Line => None,
            Path::Arc(arc) => Some([arc.axes[0], arc.axes[1]]),
            _ => return,
        };
        let is_unknown = |axis: &usize| {
            of_plane.is_none_or(|of| of.contains(axis))
                && !(motion.known[*axis] && self.interpreter.known[*axis])
        };
        let Some(axis) = self.corrector.axes().find(is_unknown) else {
            return;
        };
        let matters = match motion.path {
            Path::Line => {
                let in_program = self.ends_of(motion);
                let ends = [&motion.from, &motion.to];
                let frame = &self.interpreter.frame;
                let [from, to] = &in_program;
                !(self.corrector).is_straight_in(frame, &mut self.seen, ends, [from, to])
            }
            _ => self.corrector.at(&motion.to).delta != [0.0; 9],
        };
        if matters {
            let note = Note::NotSplit(char::from(LETTERS[axis]));
            self.interpreter.notes.add(note, line);
        }
    }

    /// Notes what a correction rests on that nobody has stated, once a motion is written.
    pub(crate) fn notes_unstated(&mut self, line: usize) {
        if self.carried != [0.0; 9]
            && let Some(name) = self.interpreter.unstated_offset()
        {
            self.interpreter.notes.add(Note::NoOffset(name), line);
        }
    }
}

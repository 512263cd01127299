//! The holes of a block with a canned cycle, and where the tool is behind them.

use crate::{
    NcError,
    control::Control,
    coordinates::LETTERS,
    given::{Given, whole},
    interpret::{Interpreter, Outcome},
    modal::Sticky,
    motion::{Move, Path},
    notes::Note,
    words::each,
};

impl Interpreter {
    /// The hole of a block, or the row of them; false: there is none, and the cycle is stored for the next block.
    pub(crate) fn hole(
        &mut self,
        given: &Given<'_>,
        motion: &mut Move,
        outcome: &mut Outcome,
    ) -> Result<bool, NcError> {
        let (letter, may_store) = self.repeats_by();
        let [_, _, depth] = self.modal.plane.axes();
        let before = self.program_position();
        let [of_r, of_depth] =
            [b'R', LETTERS[depth]].map(|letter| self.modal.height_scale(letter, depth));
        let incremental = motion.incremental[depth];
        let is_known = self.says_place(depth);
        let sticky = &mut self.modal.sticky;
        sticky.initial_is_known.get_or_insert(is_known);
        let initial = *sticky.initial.get_or_insert(before[depth]);
        if let Some(value) = given.letter(b'R')? {
            sticky.clearance = Some(value * of_r);
            sticky.incremental[1] = incremental;
        }
        if let Some(value) = given.axis(depth)? {
            sticky.depth = Some(value * of_depth);
            sticky.incremental[0] = incremental;
        }
        let (Some(way), Some(clearance)) = (sticky.depth, sticky.clearance) else {
            return Err(given.refused("a cycle without its depth or its plane R"));
        };
        let is_fanuc_like = self.control.is_some_and(Control::is_fanuc_like);
        if is_fanuc_like && sticky.incremental != [incremental; 2] {
            return Err(given.refused(
                "a cycle whose depth or plane R was given under the other of G90 and G91: LinuxCNC reads the number anew, whether this control does was found in no manual: write both into this block",
            ));
        }
        let [clearance, bottom] = if incremental {
            [initial + clearance, initial + clearance + way]
        } else {
            [clearance, way]
        };
        if letter == b'K' && given.has(b'L') {
            return Err(given.refused(
                "a cycle with L, which FANUC controls read as the number of holes in the format of series 10 and 11 only: write K",
            ));
        }
        if letter != b'K' && given.has(b'K') {
            return Err(given.refused(
                "a cycle with K, which some controls read as the number of holes: write L, or each hole in a line of its own",
            ));
        }
        let repeats = match given.letter(letter)? {
            Some(repeats) => whole(repeats, 100_000)
                .filter(|repeats| *repeats > 0 || may_store)
                .ok_or_else(|| {
                    let letter = char::from(letter);
                    given.refused(&format!(
                        "a cycle with {letter} that is not a number of holes"
                    ))
                })?,
            None => 1,
        };
        if repeats == 0 {
            // Whether the control goes to the place of the hole is not known.
            for axis in (0..9).filter(|axis| *axis != depth) {
                let in_plane = axis < 2 && given.polar.is_some();
                if given.places[axis].is_some() || in_plane {
                    self.is_assumed(axis);
                }
            }
            return Ok(false);
        }
        motion.path = Path::Hole {
            bottom,
            clearance,
            depth,
        };
        let mut end = self.frame.to_program(&motion.to);
        end[depth] = if self.modal.comes_back {
            initial.max(clearance)
        } else {
            clearance
        };
        motion.to = self.frame.to_machine(&end);
        if !incremental {
            // Each of them is the same hole.
            return Ok(true);
        }
        let way = each(|axis| match given.places[axis] {
            Some(_) if axis != depth => end[axis] - before[axis],
            _ => 0.0,
        });
        for _ in 1..repeats {
            let from = self.frame.to_machine(&end);
            if given.polar.is_some() {
                self.ends_polar(given)?;
            }
            if let Some(place) = self.polar_end(given, &end)? {
                end[..2].copy_from_slice(&place);
            }
            for (end, way) in end.iter_mut().zip(way) {
                *end += way;
            }
            outcome.row.push(Move {
                from,
                to: self.frame.to_machine(&end),
                wraps: [0.0; 9],
                ..motion.clone()
            });
        }
        Ok(true)
    }

    /// The tool is in the plane R of a hole, or where it was before the first one, which may be unknown.
    pub(crate) fn is_behind_hole(
        &mut self,
        clearance: f64,
        depth: usize,
        by_ways: bool,
        line: usize,
    ) {
        let Sticky {
            initial,
            initial_is_known,
            ..
        } = self.modal.sticky;
        if self.modal.comes_back && initial_is_known != Some(true) {
            // Ways lead back to a place that is as unknown as it was.
            self.known[depth] &= by_ways;
        } else if !by_ways {
            self.is_named(depth);
        }
        if !self.modal.says_return && initial.is_some_and(|initial| initial > clearance) {
            // LinuxCNC begins with G99, FANUC controls with G98.
            self.is_assumed(depth);
            let note = Note::ReturnPlane(char::from(LETTERS[depth]));
            self.notes.add(note, line);
        }
    }
}

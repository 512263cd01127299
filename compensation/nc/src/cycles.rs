//! Cycles that pass on as they are: where they leave the axes.

use crate::{
    NcError,
    interpret::{Interpreter, Outcome},
    line::Line,
    motion::Path,
    notes::Note,
    parameters::Value,
    rewrite::Rewriter,
};

/// A cycle that passes on as it is.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Cycle {
    pub(crate) name: String,
    /// It only moves along the tool, and ends at this place (RTP), in the unit of the program.
    pub(crate) drills_to: Option<Value>,
}

impl Interpreter {
    /// What a cycle that passes on leaves behind it: where the axes are.
    fn after_cycle(&mut self, cycle: &Cycle, line: usize) -> [bool; 9] {
        self.notes.add(Note::PassedOn(cycle.name.clone()), line);
        let [_, _, depth] = self.modal.plane.axes();
        let mut moved = [false; 9];
        let Some(ends) = cycle.drills_to else {
            // It may end anywhere.
            for axis in 0..3 {
                moved[axis] = true;
                self.known[axis] = false;
            }
            return moved;
        };
        moved[depth] = true;
        let mut at = self.program_position();
        match ends {
            Some(_) => self.is_named(depth),
            None => self.known[depth] = false,
        }
        if let Some(ends) = ends {
            at[depth] = ends * self.modal.scale(depth);
            let at = self.frame.to_machine(&at);
            let takes_along = self.frame.tip.is_some();
            for axis in 0..3 {
                if axis == depth || takes_along {
                    self.position[axis] = at[axis];
                }
            }
        }
        moved
    }
}

impl Rewriter {
    /// What cycles that pass on leave: their axes carry no correction.
    pub(crate) fn after_cycles(
        &mut self,
        outcome: &Outcome,
        line: Line<'_>,
    ) -> Result<(), NcError> {
        let each = self.interpreter.modal.each_motion.clone();
        let each = each.filter(|_| outcome.motion.is_some());
        if let (Some(cycle), Some(motion)) = (&each, &outcome.motion)
            && matches!(motion.path, Path::Arc(_))
        {
            return Err(NcError::NotCompensated {
                line: line.number,
                what: format!("an arc behind which {} is done (MCALL)", cycle.name),
            });
        }
        for cycle in each.iter().chain(&outcome.cycle) {
            self.notes_zero(line.number);
            let before = self.interpreter.position;
            let frame = self.interpreter.frame.clone();
            let mut carried = frame.moved_in_program(&before, &self.carried);
            let moved = self.interpreter.after_cycle(cycle, line.number);
            for (carried, moved) in carried.iter_mut().zip(moved) {
                if moved {
                    *carried = 0.0;
                }
            }
            let at = self.interpreter.position;
            self.corrector.goes(&at);
            self.carried = frame.moved_in_machine(&frame.to_program(&at), &carried);
            self.unsettles();
        }
        Ok(())
    }
}

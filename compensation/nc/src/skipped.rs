//! Blocks that the operator may have skipped (a slash before them): what follows must be right whether they are executed or not.

use crate::{
    NcError, block::Begins, codes::Codes, given::Given, interpret::Interpreter, motion::Move,
    notes::Note,
};

impl Interpreter {
    /// # Errors
    /// The block may be skipped, and switches what the coordinates behind it mean.
    pub(crate) fn check_skipped(
        &mut self,
        codes: &Codes,
        given: &Given<'_>,
    ) -> Result<(), NcError> {
        if given.block.begins != Begins::Slash {
            return Ok(());
        }
        let switches = [
            codes.plane(),
            codes.units(),
            codes.diameter(),
            codes.radius(),
            codes.distance(),
            codes.centre(),
            codes.tool_length(),
            codes.work_offset(),
            codes.rotation(),
            codes.polar(),
            codes.comes_back(),
            codes.feed(),
            // A dwell switches nothing.
            codes.not_modal().filter(|code| *code != 40),
        ];
        let block = given.block;
        if switches.iter().any(Option::is_some)
            || codes.centre_point.is_some()
            || codes.ends
            || codes.changes_tool
            || given.has(b'T')
            || !block.assignments.is_empty()
            || !block.commands.is_empty()
        {
            return Err(given.refused(
                "a block that may be skipped (/) and switches what follows (offsets, planes, units, G90, G91, G98, G99, the tool and its length, the mode of the feed, a parameter, the end of the program): what follows can be corrected for one of the two only. Take the slash away, or the block",
            ));
        }
        self.notes.add(Note::MayBeSkipped, given.line);
        Ok(())
    }

    /// Where the axes of a motion that may be skipped stand behind it is not known.
    pub(crate) fn may_not_have_moved(&mut self, motion: &Move) {
        let takes_along = self.frame.tip.is_some();
        for axis in 0..9 {
            let in_plane = axis < 2 && motion.polar.is_some();
            if motion.words[axis].is_some() || in_plane || axis < 3 && takes_along {
                self.known[axis] = false;
            }
        }
    }
}

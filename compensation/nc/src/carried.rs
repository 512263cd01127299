//! The correction that the axes of the machine carry from one block to the next.

use crate::{
    coordinates::Axes,
    motion::{Move, Path},
    rewrite::Rewriter,
};

/// Whether the correction that the axes carry is the one that belongs to where they are.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Settled {
    Yes,
    No,
    /// It is not, since an axis has turned.
    Turned,
}

impl Rewriter {
    /// Whether any of these axes carries a correction, so that the control has another place for it.
    pub(crate) fn carries(&self, axes: &Axes<bool>) -> bool {
        if *axes == [false; 9] {
            return false;
        }
        let interpreter = &self.interpreter;
        let frame = &interpreter.frame;
        let carried = frame.moved_in_program(&interpreter.position, &self.carried);
        (0..9).any(|axis| axes[axis] && carried[axis].abs() > 1e-9)
    }

    /// A motion has been written: the axes have done what they do on it.
    pub(crate) fn has_moved(&mut self, motion: &Move) {
        let turns = std::mem::take(&mut self.turns);
        if self.corrector.is_bidirectional() {
            self.corrector.reaches(&turns.furthest);
        }
        self.settled = if self.corrector.goes(&motion.to) {
            Settled::Turned
        } else {
            Settled::Yes
        };
    }

    /// The correction that the axes carry may be that of another place, or of another tool.
    pub(crate) fn unsettles(&mut self) {
        if self.settled == Settled::Yes {
            self.settled = Settled::No;
        }
    }

    /// A motion that passes on as it is: its axes carry no correction afterwards, but those whose words are ways.
    pub(crate) fn is_uncorrected(&mut self, motion: &Move) {
        self.corrector.goes(&motion.to);
        self.settled = Settled::No;
        let frame = &self.interpreter.frame;
        let mut carried = if motion.in_machine {
            self.carried
        } else {
            frame.moved_in_program(&motion.from, &self.carried)
        };
        for axis in 0..9 {
            if motion.words[axis].is_some() && !motion.incremental[axis] {
                carried[axis] = match motion.path {
                    Path::Home(which) => self.carried_at_home[which][axis],
                    _ => 0.0,
                };
            }
        }
        self.carried = if motion.in_machine {
            carried
        } else {
            frame.moved_in_machine(&frame.to_program(&motion.to), &carried)
        };
    }
}

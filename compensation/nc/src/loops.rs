//! Loops as LinuxCNC keeps them: what a loop that was left early leaves behind, and what it would do to another loop. No program means
//! that, so that one in which it matters is refused.

use std::collections::HashMap;

use crate::flow::{Flow, Keyword};

/// What a loop does next.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Next {
    Again,
    Passed,
}

/// How often a loop is still to be done.
#[derive(Clone, Copy, Debug)]
struct Count {
    /// The pass that is being done among them.
    left: u64,
    /// The loop was left before its end, and goes on with the count that it had.
    is_old: bool,
}

/// State: the loops that have begun. Lines are counted from 0.
#[derive(Clone, Debug, Default)]
pub(crate) struct Loops {
    /// The loops with a count that are being done, or were left before their end.
    counts: HashMap<usize, Count>,
    /// The `break` that is in force until a loop `do` … `while` has ended: that ends after the pass that it does.
    breaks: Option<usize>,
    /// The `continue` of a loop `do` … `while` that is in force until the end of another loop has been passed by: that is done once more.
    continues: Option<usize>,
    /// Some loops are written out, so that the control does not come to their ends: what is in force may stay so.
    pub(crate) some_are_written_out: bool,
}

const WAS_LEFT: &str = "this loop was left before its last pass (by break, continue, return or M99), and LinuxCNC goes on with the number of passes that was left then: write it as while … endwhile";

impl Loops {
    /// A loop with a count begins at a line.
    pub(crate) fn repeats(
        &mut self,
        flow: &Flow,
        begin: usize,
        times: u64,
    ) -> Result<Next, String> {
        let before = self.counts.get(&begin);
        let left = before.map_or(times, |before| times.min(before.left - 1));
        if left == 0 && times > 0 {
            return Err(WAS_LEFT.to_owned());
        }
        if left == 0 {
            return self.is_passed_by(flow, begin);
        }
        let is_old = before.is_some();
        self.counts.insert(begin, Count { left, is_old });
        Ok(Next::Again)
    }

    /// A pass of a loop with a count has been done.
    pub(crate) fn has_repeated(&mut self, flow: &Flow, begin: usize) -> Result<Next, String> {
        match self.counts.get_mut(&begin) {
            Some(count) if count.left > 1 => {
                count.left -= 1;
                Ok(Next::Again)
            }
            Some(Count { is_old: true, .. }) => Err(WAS_LEFT.to_owned()),
            _ => {
                self.counts.remove(&begin);
                self.is_passed_by(flow, begin)
            }
        }
    }

    /// The condition of a loop `while` does not hold, or the passes of one with a count are done: it is passed by to its end.
    pub(crate) fn is_passed_by(&mut self, flow: &Flow, begin: usize) -> Result<Next, String> {
        let is_repeat = flow.keyword(begin) == Some(Keyword::Repeat);
        if let Some(of) = self.continues.filter(|_| is_repeat) {
            return Err(format!(
                "LinuxCNC does all passes of this loop once more, since the continue of line {} in a loop do … while is in force until then: write that loop as while … endwhile",
                of + 1
            ));
        }
        self.passes_breaks(flow, begin, begin);
        self.ends_continue();
        Ok(Next::Passed)
    }

    /// `break` at a line in the loop that begins at another.
    pub(crate) fn breaks(&mut self, flow: &Flow, line: usize, begin: usize) -> Result<(), String> {
        if flow.keyword(begin) == Some(Keyword::Do) {
            self.ends_break();
            return Ok(());
        }
        if let Some(of) = self.continues {
            return Err(format!(
                "LinuxCNC goes on with the loop here, since the continue of line {} in a loop do … while is in force until a loop has ended: write that loop as while … endwhile",
                of + 1
            ));
        }
        self.breaks = Some(line);
        Ok(())
    }

    /// `continue` at a line in the loop that begins at another.
    pub(crate) fn continues(&mut self, flow: &Flow, line: usize, begin: usize) {
        self.passes_breaks(flow, begin, line);
        if flow.keyword(begin) == Some(Keyword::Do) {
            self.continues = Some(line);
        } else {
            self.ends_continue();
        }
    }

    /// The end of a loop `do` … `while`, whose condition holds or not.
    pub(crate) fn do_while(&mut self, holds: bool) -> Result<Next, String> {
        if !holds {
            self.ends_break();
            return Ok(Next::Passed);
        }
        match self.breaks {
            Some(of) => Err(format!(
                "LinuxCNC ends this loop here, whatever its condition is, since the break of line {} is in force until the end of a loop do … while: write this loop as while … endwhile",
                of + 1
            )),
            None => Ok(Next::Again),
        }
    }

    /// Lines behind one of a loop are passed by: a `break` of this loop among them counts all the same.
    fn passes_breaks(&mut self, flow: &Flow, begin: usize, line: usize) {
        if let Some(passed) = flow.break_behind(begin, line) {
            self.breaks = Some(passed);
        }
    }

    fn ends_break(&mut self) {
        if !self.some_are_written_out {
            self.breaks = None;
        }
    }

    fn ends_continue(&mut self) {
        if !self.some_are_written_out {
            self.continues = None;
        }
    }
}

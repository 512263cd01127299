//! What is written of a program with O-words: its lines with what each becomes, or, where a line becomes different things from time to
//! time, what calls or repeats it, pass by pass.

use std::io::Write;

use crate::{
    NcError,
    flow::{Flow, Keyword, program_line},
    line::{end_of_more, write_comment},
    subroutines::Listing,
};

/// What is done with lines as they are executed.
pub(crate) trait Sink {
    /// A line is executed, and this is written instead of it.
    fn executed(&mut self, place: usize, text: &[u8]) -> Result<(), NcError>;
    /// The main program is at this line.
    fn at(&mut self, place: usize) -> Result<(), NcError>;
}

/// What each line becomes, and which become different things from time to time.
pub(crate) struct Recorded<'r, 't> {
    lines: &'r Listing<'t>,
    texts: Vec<Option<Vec<u8>>>,
    conflicts: Vec<bool>,
}

impl<'r, 't> Recorded<'r, 't> {
    pub(crate) fn new(lines: &'r Listing<'t>) -> Self {
        Self {
            lines,
            texts: vec![None; lines.lines.len()],
            conflicts: vec![false; lines.lines.len()],
        }
    }

    /// Whether a line becomes different things from time to time.
    pub(crate) fn has_conflicts(&self) -> bool {
        self.conflicts.contains(&true)
    }

    /// Writes the program with what each line always becomes.
    pub(crate) fn write(&self, output: &mut impl Write) -> Result<(), NcError> {
        for (place, (line, end)) in self.lines.lines[..self.lines.own].iter().enumerate() {
            let text = self.texts[place].as_deref();
            output.write_all(text.unwrap_or(line))?;
            output.write_all(end)?;
        }
        Ok(())
    }
}

impl Sink for Recorded<'_, '_> {
    fn executed(&mut self, place: usize, text: &[u8]) -> Result<(), NcError> {
        match &self.texts[place] {
            Some(before) if before != text => self.conflicts[place] = true,
            Some(_) => {}
            None => {
                // A line of another file stays as it is: other programs call it, too.
                let may_change = place < self.lines.own;
                self.conflicts[place] |= !may_change && text != self.lines.lines[place].0;
                self.texts[place] = Some(text.to_vec());
            }
        }
        Ok(())
    }

    fn at(&mut self, _: usize) -> Result<(), NcError> {
        Ok(())
    }
}

/// Writes the program; what the main program calls or repeats is held until it is known whether a line with a conflict is in it.
pub(crate) struct Unrolled<'a, W> {
    lines: &'a Listing<'a>,
    flow: &'a Flow,
    recorded: &'a Recorded<'a, 'a>,
    output: &'a mut W,
    /// The next line of the text that is to be written.
    next: usize,
    /// Where what is executed now begins and ends in the main program.
    open: Option<[usize; 2]>,
    /// What was executed since it began.
    pending: Vec<u8>,
    conflicts: bool,
}

impl<'a, W: Write> Unrolled<'a, W> {
    pub(crate) fn new(flow: &'a Flow, recorded: &'a Recorded<'a, 'a>, output: &'a mut W) -> Self {
        Self {
            lines: recorded.lines,
            flow,
            recorded,
            output,
            next: 0,
            open: None,
            pending: Vec::new(),
            conflicts: false,
        }
    }

    /// The lines of the text up to this one, as they are, or with what they always become.
    fn write_to(&mut self, end: usize) -> Result<(), NcError> {
        while self.next < end.min(self.lines.own) {
            let (line, end_of_line) = self.lines.lines[self.next];
            let always = self.recorded.texts[self.next].as_deref();
            let text = always.filter(|_| !self.recorded.conflicts[self.next]);
            self.output.write_all(text.unwrap_or(line))?;
            self.output.write_all(end_of_line)?;
            self.next += 1;
        }
        Ok(())
    }

    /// What was executed has ended: it stays as it is, or is written out with the original as comments.
    fn close(&mut self) -> Result<(), NcError> {
        let Some([begin, end]) = self.open.take() else {
            return Ok(());
        };
        self.write_to(begin)?;
        if self.conflicts {
            for (line, end_of_line) in &self.lines.lines[begin..=end.min(self.lines.own - 1)] {
                // Of the comments that controls know only ( ) is one on those that have M98: there ; ends a block.
                let of_program = program_line(line).is_some();
                if of_program {
                    let mut comment = Vec::new();
                    write_comment(line, &mut comment);
                    self.output.write_all(&comment)?;
                } else {
                    self.output.write_all(b";")?;
                    self.output.write_all(line)?;
                }
                self.output.write_all(end_of_more(end_of_line))?;
            }
            self.output.write_all(&self.pending)?;
            self.next = end + 1;
        } else {
            self.write_to(end + 1)?;
        }
        self.pending.clear();
        self.conflicts = false;
        Ok(())
    }

    /// The rest of the program.
    pub(crate) fn finish(&mut self) -> Result<(), NcError> {
        self.close()?;
        self.write_to(self.lines.own)
    }
}

impl<W: Write> Sink for Unrolled<'_, W> {
    fn at(&mut self, place: usize) -> Result<(), NcError> {
        if self
            .open
            .is_some_and(|[begin, end]| (begin..=end).contains(&place))
        {
            return Ok(());
        }
        self.close()?;
        let Some(statement) = self.flow.statements.get(&place) else {
            return Ok(());
        };
        let end = match statement.keyword {
            Keyword::Call | Keyword::CallProgram { .. } => Some(place),
            Keyword::If => Some(self.flow.end_of_if(place)),
            Keyword::While | Keyword::Do | Keyword::Repeat => Some(self.flow.partner(place)),
            _ => None,
        };
        self.open = end.map(|end| [place, end]);
        Ok(())
    }

    fn executed(&mut self, place: usize, text: &[u8]) -> Result<(), NcError> {
        if self.open.is_some() {
            let end = self.lines.lines[place].1;
            self.pending.extend_from_slice(text);
            self.pending.extend_from_slice(end_of_more(end));
            self.conflicts |= self.recorded.conflicts[place];
        }
        Ok(())
    }
}

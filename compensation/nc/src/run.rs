//! Executes a program with O-words, line by line in execution order. If the same line needs different corrections at
//! different times, the call, loop or `if` block that contains it is unrolled.

use std::io::Write;

use crate::{
    NcError,
    block::Scanner,
    expression::Expressions,
    flow::{Flow, Keyword, Listing, Loops, Next, Statement, o_line, program_line},
    line::{end_of_more, write_comment},
    parameters::{HAS_RETURNED, RETURNED, Value},
    rewrite::{ComputedValues, Rewriter},
};

const MAX_CALL_DEPTH: usize = 100;

struct Run<'r, 't> {
    lines: &'r Listing<'t>,
    flow: &'r Flow,
    most: u64,
    rewriter: Rewriter,
    calls: Vec<Call>,
    loops: Loops,
}

#[derive(Clone, Copy, Debug)]
struct Call {
    back: usize,
    /// Start of a program called by number, and remaining executions; `None` for an O-word call, which has local parameters.
    program: Option<(usize, u64)>,
    /// Index of the file that defines the called subroutine; 0 is the program.
    file: usize,
}

/// Executes the lines and writes them with their corrections. Returns the final state, and whether the program ended explicitly.
pub(crate) fn run(
    rewriter: Rewriter,
    lines: &Listing<'_>,
    most: u64,
    output: &mut impl Write,
) -> Result<(Rewriter, bool), NcError> {
    let flow = Flow::new(lines)?;
    let mut before = rewriter.clone();
    let mut recorded = Replacements::new(lines);
    let (after, ends) = Run::new(rewriter, lines, &flow, most).move_to(&mut recorded)?;
    if recorded.conflicts.contains(&true) {
        // An unrolled call returns no value to the control, so values that depend on it are written as numbers.
        before.computed = ComputedValues::ReturnedAsNumbers;
        recorded = Replacements::new(lines);
        Run::new(before.clone(), lines, &flow, most).move_to(&mut recorded)?;
    } else {
        recorded.write(output)?;
        return Ok((after, ends));
    }
    // Last run: unroll the calls, loops and `if` blocks that execute a line with a conflict.
    let mut unrolled = Run::new(before, lines, &flow, most);
    unrolled.rewriter.computed = ComputedValues::AllAsNumbers;
    unrolled.loops.some_are_written_out = true;
    let mut written = UnrollingWriter::new(&flow, &recorded, output);
    let (after, ends) = unrolled.move_to(&mut written)?;
    written.finish()?;
    Ok((after, ends))
}

impl<'r, 't> Run<'r, 't> {
    fn new(rewriter: Rewriter, lines: &'r Listing<'t>, flow: &'r Flow, most: u64) -> Self {
        Self { lines, flow, most, rewriter, calls: Vec::new(), loops: Loops::default() }
    }

    fn move_to(mut self, sink: &mut impl LineSink) -> Result<(Rewriter, bool), NcError> {
        let (mut at, mut executed) = (0, 0_u64);
        let mut text = Vec::new();
        loop {
            if let Some(call) = self.calls.last()
                && (at >= self.lines.lines.len() || self.lines.file_of(at).0 != call.file)
            {
                return Err(self.lines.wrong(at - 1, "the subprogram ends here without M99"));
            }
            let Some((line, end)) = self.lines.lines.get(at) else {
                break;
            };
            executed += 1;
            if executed > self.most {
                return Err(self.lines.wrong(at, format!("more than {} blocks are executed (a loop without an end?); --max-blocks allows more", self.most)));
            }
            if self.calls.is_empty() {
                if at >= self.lines.own {
                    // The program has ended.
                    break;
                }
                sink.at(at)?;
            }
            if let Some(statement) = self.flow.statements.get(&at) {
                at = self.follow(at, statement, line)?;
                continue;
            }
            if o_line(line).is_some() {
                // Program number.
                at += 1;
                continue;
            }
            let (_, file) = self.lines.file_of(at);
            if file.is_some() && line.trim_ascii_start().starts_with(b"%") {
                at += 1;
                continue;
            }
            text.clear();
            // Notes about a line of another file refer to the calling line of the program.
            let place = match (file, self.calls.first()) {
                (Some(_), Some(call)) => call.back - 1,
                _ => at,
            };
            let number = self.lines.first + place;
            let ends = self.rewriter.line(line, end, number, &mut text);
            let ends = ends.map_err(|error| match file {
                Some(_) => self.lines.at(at, error),
                None => error,
            })?;
            sink.executed(at, &text)?;
            if ends {
                return Ok((self.rewriter, true));
            }
            at += 1;
        }
        Ok((self.rewriter, false))
    }

    /// Executes a line with an O-word; returns the line to execute next.
    fn follow(&mut self, at: usize, statement: &Statement, line: &[u8]) -> Result<usize, NcError> {
        let flow = self.flow;
        match statement.keyword {
            // A subroutine is skipped unless called.
            Keyword::Sub => Ok(flow.partner(at) + 1),
            Keyword::Call => self.call(at, statement, line),
            Keyword::EndSub | Keyword::Return => self.end_sub(at, statement, line),
            Keyword::CallProgram { number, times } => self.call_program(at, number, times),
            Keyword::EndProgram => self.end_program(at),
            Keyword::While => {
                let next = if self.holds(at, statement, line)? {
                    Ok(Next::Again)
                } else {
                    self.loops.is_passed_by(flow, at)
                };
                self.loop_goes_on(at, at, flow.partner(at), next)
            }
            Keyword::EndWhile => Ok(flow.partner(at)),
            Keyword::Do | Keyword::EndIf => Ok(at + 1),
            Keyword::DoWhile => {
                let holds = self.holds(at, statement, line)?;
                let next = self.loops.do_while(holds);
                self.loop_goes_on(at, flow.partner(at), at, next)
            }
            Keyword::If => {
                let mut branch = at;
                let (mut statement, mut line) = (statement, line);
                loop {
                    let goes = match statement.keyword {
                        Keyword::If | Keyword::ElseIf => self.holds(branch, statement, line)?,
                        _ => true,
                    };
                    if goes {
                        return Ok(branch + 1);
                    }
                    let next = flow.next_branch.get(&branch);
                    let Some((next, of_next)) =
                        next.and_then(|next| Some((*next, flow.statements.get(next)?)))
                    else {
                        return Ok(branch + 1);
                    };
                    (branch, statement, line) = (next, of_next, self.lines.lines[next].0);
                }
            }
            // An earlier branch was executed.
            Keyword::ElseIf | Keyword::Else => Ok(flow.end_of_if(at) + 1),
            Keyword::Repeat => {
                let times = self.number(at, statement, line)?.round_ties_even().max(0.0);
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "not below zero; too many are stopped by the number of blocks"
                )]
                let next = self.loops.repeats(flow, at, times as u64);
                self.loop_goes_on(at, at, flow.partner(at), next)
            }
            Keyword::EndRepeat => {
                let begin = flow.partner(at);
                let next = self.loops.has_repeated(flow, begin);
                self.loop_goes_on(at, begin, at, next)
            }
            Keyword::Break | Keyword::Continue => {
                let Some(begin) = flow.loop_around(at, &statement.name) else {
                    return Err(self.lines.wrong(
                        at,
                        format!("there is no loop o{} around this line", statement.name),
                    ));
                };
                if flow.keyword(begin) == Some(Keyword::Repeat) {
                    let what = "break and continue of a loop with a count (repeat), which LinuxCNC refuses: write it as while … endwhile";
                    return Err(self.lines.wrong(at, what));
                }
                if statement.keyword == Keyword::Break {
                    let breaks = self.loops.breaks(flow, at, begin);
                    breaks.map_err(|what| self.lines.wrong(at, what))?;
                    return Ok(flow.partner(begin) + 1);
                }
                self.loops.continues(flow, at, begin);
                let is_while = flow.keyword(begin) == Some(Keyword::While);
                Ok(if is_while { begin } else { flow.partner(begin) })
            }
        }
    }

    /// The next line of a loop: its first line, or the line after its end.
    fn loop_goes_on(
        &self,
        at: usize,
        begin: usize,
        end: usize,
        next: Result<Next, String>,
    ) -> Result<usize, NcError> {
        match next.map_err(|what| self.lines.wrong(at, what))? {
            Next::Again => Ok(begin + 1),
            Next::Passed => Ok(end + 1),
        }
    }

    fn call_program(&mut self, at: usize, number: u32, times: u64) -> Result<usize, NcError> {
        let Some(begin) = self.flow.program(number, self.lines.file_of(at).0) else {
            return Err(self.lines.wrong(
                at,
                format!("the program O{number} is neither in this file nor in a file such as O{number:04} or {number}.nc in a folder of --subroutines"),
            ));
        };
        if times == 0 {
            return Ok(at + 1);
        }
        self.deeper(at)?;
        self.calls.push(Call {
            back: at + 1,
            program: Some((begin, times)),
            file: self.lines.file_of(begin).0,
        });
        Ok(begin)
    }

    fn end_sub(&mut self, at: usize, statement: &Statement, line: &[u8]) -> Result<usize, NcError> {
        let value = self.values(at, statement, line)?.first().copied();
        let Some(Call { back, program: None, .. }) = self.calls.pop() else {
            return Err(self.lines.wrong(at, "a return outside a subroutine"));
        };
        let parameters = &mut self.rewriter.interpreter.parameters;
        parameters.leave();
        let has_returned = f64::from(u8::from(value.is_some()));
        parameters.set_named(HAS_RETURNED, Some(has_returned));
        parameters.set_named(RETURNED, value.unwrap_or(Some(0.0)));
        Ok(back)
    }

    /// The line to continue at when a numbered program ends: its start if it is repeated.
    fn end_program(&mut self, at: usize) -> Result<usize, NcError> {
        match self.calls.last_mut() {
            Some(Call {
                program: Some((begin, left)),
                ..
            }) if *left > 1 => {
                *left -= 1;
                Ok(*begin)
            }
            Some(Call {
                back,
                program: Some(_),
                ..
            }) => {
                let back = *back;
                self.calls.pop();
                Ok(back)
            }
            _ => Err(self.lines.wrong(at, "M99 in the main program would repeat it endlessly: expected at the end of a subprogram called by M98")),
        }
    }

    fn deeper(&self, at: usize) -> Result<(), NcError> {
        if self.calls.len() >= MAX_CALL_DEPTH {
            return Err(self
                .lines
                .wrong(at, format!("more than {MAX_CALL_DEPTH} subroutines call one another")));
        }
        Ok(())
    }

    fn call(&mut self, at: usize, statement: &Statement, line: &[u8]) -> Result<usize, NcError> {
        let Some(begin) = self.flow.sub(&statement.name, self.lines.file_of(at).0) else {
            return Err(self.lines.wrong(
                at,
                format!(
                    "the subroutine o<{name}> is neither in this program nor as {name}.ngc in a folder of --subroutines",
                    name = statement.name
                ),
            ));
        };
        self.deeper(at)?;
        let arguments = self.values(at, statement, line)?;
        self.rewriter.interpreter.parameters.enter(&arguments);
        self.calls.push(Call { back: at + 1, program: None, file: self.lines.file_of(begin).0 });
        Ok(begin + 1)
    }

    fn values(&self, at: usize, statement: &Statement, line: &[u8]) -> Result<Vec<Value>, NcError> {
        let values = self.values_of(statement, line);
        values.map_err(|error| self.lines.at(at, error))
    }

    /// Values of the statement; errors do not contain the line number yet.
    fn values_of(&self, statement: &Statement, line: &[u8]) -> Result<Vec<Value>, NcError> {
        let expressions = Expressions::new(&self.rewriter.interpreter);
        let mut scanner = Scanner::new(line);
        scanner.go_to(statement.rest);
        let mut values = Vec::new();
        while scanner.peek() == Some(b'[') {
            let read = expressions
                .read(&mut scanner)
                .map_err(|fault| NcError::Block { line: 0, fault })?;
            values.extend(read.map(|(value, _)| value));
        }
        let reads = expressions.reads.get();
        if self.rewriter.computed != ComputedValues::Kept && reads.returned {
            return Err(NcError::not_compensated(
                0,
                "#<_value> is read here, but the call that returned it is corrected differently on each execution",
            ));
        }
        if self.rewriter.carries(&reads.axes) {
            return Err(NcError::not_compensated(
                0,
                "the position of an axis is read here (#5420 to #5428, #<_x> to #<_w>), which contains the correction at the control",
            ));
        }
        Ok(values)
    }

    fn number(&self, at: usize, statement: &Statement, line: &[u8]) -> Result<f64, NcError> {
        match self.values(at, statement, line)?.first() {
            Some(Some(value)) => Ok(*value),
            Some(None) => Err(self
                .lines
                .wrong(at, "which lines are executed after this one is only known at the machine")),
            None => Err(self.lines.wrong(at, "expected a value in [ ] here")),
        }
    }

    fn holds(&self, at: usize, statement: &Statement, line: &[u8]) -> Result<bool, NcError> {
        Ok(self.number(at, statement, line)? != 0.0)
    }
}

trait LineSink {
    fn executed(&mut self, place: usize, text: &[u8]) -> Result<(), NcError>;
    /// Called when the main program reaches this line.
    fn at(&mut self, place: usize) -> Result<(), NcError>;
}

struct Replacements<'r, 't> {
    lines: &'r Listing<'t>,
    texts: Vec<Option<Vec<u8>>>,
    conflicts: Vec<bool>,
}

impl<'r, 't> Replacements<'r, 't> {
    pub(crate) fn new(lines: &'r Listing<'t>) -> Self {
        Self {
            lines,
            texts: vec![None; lines.lines.len()],
            conflicts: vec![false; lines.lines.len()],
        }
    }

    pub(crate) fn write(&self, output: &mut impl Write) -> Result<(), NcError> {
        for (place, (line, end)) in self.lines.lines[..self.lines.own].iter().enumerate() {
            let text = self.texts[place].as_deref();
            output.write_all(text.unwrap_or(line))?;
            output.write_all(end)?;
        }
        Ok(())
    }
}

impl LineSink for Replacements<'_, '_> {
    fn executed(&mut self, place: usize, text: &[u8]) -> Result<(), NcError> {
        match &self.texts[place] {
            Some(before) if before != text => self.conflicts[place] = true,
            Some(_) => {}
            None => {
                // Lines of other files must not change: other programs may call them.
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

/// Writes the program. The output of a call, a loop or an `if` block of the main program is buffered to its end. It is
/// unrolled if a line needs different text in different executions, or if a line of another file would change;
/// otherwise it is copied.
struct UnrollingWriter<'a, W> {
    lines: &'a Listing<'a>,
    flow: &'a Flow,
    recorded: &'a Replacements<'a, 'a>,
    output: &'a mut W,
    next: usize,
    /// First and last line of the call, loop or `if` block being executed.
    open: Option<[usize; 2]>,
    pending: Vec<u8>,
    conflicts: bool,
}

impl<'a, W: Write> UnrollingWriter<'a, W> {
    pub(crate) fn new(
        flow: &'a Flow,
        recorded: &'a Replacements<'a, 'a>,
        output: &'a mut W,
    ) -> Self {
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

    /// Ends a call, a loop or an `if` block: copies it, or writes it unrolled after its original lines as comments.
    fn close(&mut self) -> Result<(), NcError> {
        let Some([begin, end]) = self.open.take() else {
            return Ok(());
        };
        self.write_to(begin)?;
        if self.conflicts {
            for (line, end_of_line) in &self.lines.lines[begin..=end.min(self.lines.own - 1)] {
                // Controls with M98 accept only comments in ( ); there a ; ends the block.
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

    fn finish(&mut self) -> Result<(), NcError> {
        self.close()?;
        self.write_to(self.lines.own)
    }
}

impl<W: Write> LineSink for UnrollingWriter<'_, W> {
    fn at(&mut self, place: usize) -> Result<(), NcError> {
        if self.open.is_some_and(|[begin, end]| (begin..=end).contains(&place)) {
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

//! A whole program, line by line: constant memory, whatever its length.

use std::io::{BufRead, Write};

use crate::{
    Counts, Decimals, NcError, Notes, correction::Corrector, interpret::Interpreter,
    rewrite::Rewriter, scan::Scanner, setup::SetUp,
};

/// A longer line is refused.
pub const LONGEST_LINE: usize = 1 << 20;

/// What was done to a program.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Summary {
    /// Lines, motions and changes.
    pub counts: Counts,
    /// What a user should know, each once.
    pub notes: Notes,
    /// Whether the program ended by itself, by M2, M30 or a percent sign.
    pub ended: bool,
}

/// Reads a program and writes it with the correction in its coordinates. Every byte that is no changed coordinate comes out
/// as it went in. `seen` is called now and then with the bytes that were read so far; what it returns as an error ends
/// the work.
///
/// # Errors
/// Lines that cannot be read or compensated, each with its number, and what reading and writing say. What was written
/// before is no whole program.
pub fn compensate(
    input: &mut impl BufRead,
    output: &mut impl Write,
    corrector: &Corrector,
    setup: &SetUp,
    decimals: Decimals,
    mut seen: impl FnMut(u64) -> Result<(), NcError>,
) -> Result<Summary, NcError> {
    let (position, known) = setup.start();
    let mut interpreter = Interpreter::new(setup.modal(), position, known);
    interpreter.tools = setup.tools();
    let mut rewriter = Rewriter::new(interpreter, corrector.clone(), decimals);
    let (mut text, mut out) = (Vec::new(), Vec::new());
    let (mut number, mut bytes) = (0, 0_u64);
    let mut ended = false;
    let mut percents = 0;
    while read_line(input, &mut text, number + 1)? {
        number += 1;
        bytes += text.len() as u64;
        if number % 4096 == 0 {
            seen(bytes)?;
        }
        let (line, end) = text.split_at(length_of(&text));
        if ended {
            output.write_all(&text)?;
            continue;
        }
        if let Some(column) = line.iter().position(|byte| *byte == 0) {
            return Err(NcError::Binary {
                line: number,
                column: column + 1,
                byte: 0,
            });
        }
        if let Some(what) = program_number(line) {
            if what == Numbered::Flow {
                return Err(NcError::Flow {
                    line: number,
                    what: "O-words that call, repeat or choose are not followed yet: write the program without them, or compensate it at the machine".to_owned(),
                });
            }
            rewriter.counts.lines += 1;
            output.write_all(&text)?;
            continue;
        }
        out.clear();
        let went = rewriter.line(line, end, number, &mut out)?;
        output.write_all(&out)?;
        output.write_all(end)?;
        percents += usize::from(rewriter.is_percent());
        ended = went.ends || percents == 2;
    }
    seen(bytes)?;
    Ok(Summary {
        counts: rewriter.counts,
        notes: rewriter.interpreter.notes,
        ended,
    })
}

/// What an O at the beginning of a line is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Numbered {
    /// The number of the program.
    Program,
    /// A call, a loop or a condition.
    Flow,
}

/// Whether a line begins with an O, and what that is.
fn program_number(line: &[u8]) -> Option<Numbered> {
    let mut scanner = Scanner::new(line);
    if scanner.takes(b'/') {
        scanner.peek();
    }
    if scanner.takes(b'N') {
        scanner.number();
    }
    if !scanner.takes(b'O') {
        return None;
    }
    let is_number = scanner.number().is_some();
    let is_all = matches!(scanner.peek(), None | Some(b'(' | b';'));
    Some(if is_number && is_all {
        Numbered::Program
    } else {
        Numbered::Flow
    })
}

/// A line with its end; false: there is none any more.
fn read_line(input: &mut impl BufRead, text: &mut Vec<u8>, number: usize) -> Result<bool, NcError> {
    text.clear();
    loop {
        let buffer = match input.fill_buf() {
            Ok(buffer) => buffer,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error.into()),
        };
        if buffer.is_empty() {
            return Ok(!text.is_empty());
        }
        let found = buffer.iter().position(|byte| *byte == b'\n');
        let taken = found.map_or(buffer.len(), |place| place + 1);
        text.extend_from_slice(&buffer[..taken]);
        input.consume(taken);
        if text.len() > LONGEST_LINE {
            return Err(NcError::LongLine {
                line: number,
                most: LONGEST_LINE,
            });
        }
        if found.is_some() {
            return Ok(true);
        }
    }
}

/// How long a line is without its end of line.
fn length_of(text: &[u8]) -> usize {
    let line = text.strip_suffix(b"\n").unwrap_or(text);
    line.strip_suffix(b"\r").unwrap_or(line).len()
}

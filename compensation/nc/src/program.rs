//! Compensates a whole program, line by line, in constant memory.

use std::{
    io::{self, BufRead, Read, Write},
    thread,
};

use memchr::memchr2;
use volcomp_model::{Machine, Temperatures, vocabulary::CorrectionLimit};

use crate::{
    Counts, Decimals, NcError, Notes,
    control::Dialect,
    correction::Corrector,
    error::Fault,
    flow::{Listing, OLine, load, o_line, program_line},
    line::{
        Ends, MAX_BYTES_IN_MEMORY, check_length, check_line, goes_on, is_trailer, leader_of,
        length_of, lines_of, split_lines,
    },
    motion::{MotionReceiver, motion_queue},
    rewrite::{Rewriter, Strategy},
    run::run,
    setup::SetUp,
};

/// Output buffer size, bytes.
const PIECE: usize = 64 << 10;

/// Result of compensating a program.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Summary {
    /// Number of lines, motions and changes.
    pub counts: Counts,
    /// Notes for the user, each once.
    pub notes: Notes,
    /// True if the program has an explicit end (M2, M30 or a percent sign), not only an end of file.
    pub ended: bool,
    /// Motions whose numbers differ from those of [`Strategy::Plain`]; if 0, the result is the same, byte for byte.
    pub rounded_otherwise: u64,
    /// Ends of the parts that each motion was split into, as fractions (0 to 1) of the motion,
    /// concatenated over all motions. Empty unless [`Job::keep_shares`] is set.
    pub shares: Vec<f64>,
}

/// Options of a compensation.
#[derive(Clone, Copy, Debug)]
pub struct Job<'a> {
    pub corrector: &'a Corrector,
    /// Set-up that the program relies on but does not contain.
    pub setup: &'a SetUp,
    /// Language of the program.
    pub dialect: Dialect,
    /// Number of decimals of coordinates.
    pub decimals: Decimals,
    /// Rounding of the numbers of split lines.
    pub strategy: Strategy,
    /// Maximum number of executed lines of a program with O-words.
    pub most_blocks: u64,
    /// Maximum correction of an axis: a program that needs more is rejected. If rotary axes are corrected, the limit is always
    /// [`CorrectionLimit::LARGEST`]: near singular poses their corrections are large, and linear axes follow them.
    pub limit: CorrectionLimit,
    /// Record [`Summary::shares`]: 8 bytes per part of a motion.
    pub keep_shares: bool,
}

impl<'a> Job<'a> {
    /// Creates a job with default decimals, the default limit (250 µm, 250 µrad) and at most ten million blocks.
    #[must_use]
    pub fn new(corrector: &'a Corrector, setup: &'a SetUp) -> Self {
        Self {
            corrector,
            setup,
            dialect: Dialect::Rs274,
            decimals: Decimals::default(),
            strategy: Strategy::Plain,
            most_blocks: 10_000_000,
            limit: CorrectionLimit::default(),
            keep_shares: false,
        }
    }
}

/// Reads a program and writes it with the correction in its coordinates. Every byte that is not part of a changed coordinate is copied
/// unchanged. `seen` is called from time to time with the number of bytes read so far; an error that it returns stops the work. A program
/// with O-words is executed; other programs are streamed.
///
/// # Errors
/// Lines that cannot be read or compensated, each with its number, and errors of reading and writing. The output written before an error is
/// not a complete program.
pub fn compensate(
    input: &mut impl BufRead,
    output: &mut impl Write,
    job: Job<'_>,
    seen: impl FnMut(u64) -> Result<(), NcError>,
) -> Result<Summary, NcError> {
    let mut rewriter =
        Rewriter::new(job.setup, job.corrector.clone(), job.decimals, job.dialect, job.limit)?;
    rewriter.strategy = job.strategy;
    rewriter.shares = job.keep_shares.then(Vec::new);
    execute(input, output, rewriter, job.most_blocks, seen)
}

pub(crate) fn execute(
    input: &mut impl BufRead,
    output: &mut impl Write,
    rewriter: Rewriter,
    most_blocks: u64,
    mut seen: impl FnMut(u64) -> Result<(), NcError>,
) -> Result<Summary, NcError> {
    let mut stream = Stream {
        rewriter,
        number: 0,
        leader: 0,
        has_begun: false,
        ends: Ends::default(),
        percents: 0,
        ended: false,
        written: Vec::with_capacity(PIECE),
    };
    let mut text = Vec::new();
    let mut bytes = 0_u64;
    let read = loop {
        match read_line(input, &mut text, stream.number + 1) {
            Ok(true) => {}
            Ok(false) => break Ok(None),
            Err(error) => break Err(error),
        }
        bytes += text.len() as u64;
        let next = match stream.line(&text) {
            Ok(next) => next,
            Err(error) => break Err(error),
        };
        if next == Next::Followed {
            text.drain(..stream.leader);
            break Ok(Some(text));
        }
        if stream.written.len() >= PIECE - PIECE / 8 {
            output.write_all(&stream.written)?;
            stream.written.clear();
        }
        if stream.number.is_multiple_of(4096) {
            seen(bytes)?;
        }
    };
    output.write_all(&stream.written)?;
    let Stream { rewriter, number, percents, ended, .. } = stream;
    let Some(text) = read? else {
        seen(bytes)?;
        return Ok(summary(rewriter, ended));
    };
    // From here on the order of execution differs from the order of the lines.
    let rest = read_rest(input, text, number)?;
    let mut lines = split_lines(&rest);
    let by_percent = end_by_percent(&lines, percents);
    let trailer = lines.iter().rev().take_while(|(line, _)| is_trailer(line));
    let not_read = lines.split_off(by_percent.unwrap_or(lines.len() - trailer.count()));
    let files = load(&lines, &rewriter.folders)?;
    let lines = Listing::new(lines, number, &files)?;
    let (after, ends) = run(rewriter, &lines, most_blocks, output)?;
    for (line, end) in not_read {
        output.write_all(line)?;
        output.write_all(end)?;
    }
    seen(bytes + rest.len() as u64)?;
    Ok(summary(after, ends || by_percent.is_some()))
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Next {
    Line,
    /// This line is the first with flow control: it and all later ones are executed, not streamed.
    Followed,
}

struct Stream {
    rewriter: Rewriter,
    /// Number of bytes before the program in the last line read.
    leader: usize,
    has_begun: bool,
    ends: Ends,
    /// Number of lines read so far.
    number: usize,
    /// Number of percent signs in these lines.
    percents: usize,
    ended: bool,
    written: Vec<u8>,
}

impl Stream {
    fn line(&mut self, text: &[u8]) -> Result<Next, NcError> {
        let (line, end) = text.split_at(length_of(text));
        self.number += 1;
        let next = self.line_and_end(text, line, end);
        self.number += lines_of(end) - 1;
        next
    }

    fn line_and_end(&mut self, text: &[u8], line: &[u8], end: &[u8]) -> Result<Next, NcError> {
        let mut line = line;
        self.leader = 0;
        if !self.has_begun {
            self.leader = leader_of(line);
            self.written.extend_from_slice(&line[..self.leader]);
            line = &line[self.leader..];
            self.has_begun = self.leader == 0 || !line.is_empty();
        }
        let (rewriter, written) = (&mut self.rewriter, &mut self.written);
        if self.ended {
            rewriter.after_end(&text[self.leader..], written);
            return Ok(Next::Line);
        }
        self.ends.check(line, end, self.number)?;
        if rewriter.interpreter.dialect == Dialect::Heidenhain
            && !matches!(end, b"" | b"\n" | b"\r\n")
        {
            // Block renumbering does not support such line ends.
            return Err(NcError::Block {
                line: self.number,
                fault: Fault::Character { column: line.len() + 1, found: '\r' },
            });
        }
        if is_trailer(line) {
            written.extend_from_slice(line);
            written.extend_from_slice(end);
            return Ok(Next::Line);
        }
        if rewriter.fast_line(line, self.number, written).is_some() {
            written.extend_from_slice(end);
            return Ok(Next::Line);
        }
        check_line(line, self.number)?;
        if rewriter.interpreter.dialect == Dialect::Rs274 && !rewriter.interpreter.is_printer() {
            match o_line(line) {
                Some(OLine::Program(_)) => {
                    rewriter.counts.lines += 1;
                    written.extend_from_slice(line);
                    written.extend_from_slice(end);
                    return Ok(Next::Line);
                }
                Some(_) => return Ok(Next::Followed),
                None if program_line(line).is_some() => return Ok(Next::Followed),
                None => {}
            }
        }
        let begins = written.len();
        let ends = rewriter.line(line, end, self.number, written);
        if ends.is_err() {
            // A rejected line writes nothing.
            written.truncate(begins);
        }
        let ends = ends?;
        written.extend_from_slice(end);
        self.percents += usize::from(rewriter.is_percent());
        self.ended = ends || self.percents == 2;
        Ok(Next::Line)
    }
}

fn summary(rewriter: Rewriter, ended: bool) -> Summary {
    Summary {
        counts: rewriter.counts,
        notes: rewriter.interpreter.notes,
        ended,
        rounded_otherwise: rewriter.rounded_otherwise,
        shares: rewriter.shares.unwrap_or_default(),
    }
}

fn read_rest(
    input: &mut impl BufRead,
    mut text: Vec<u8>,
    number: usize,
) -> Result<Vec<u8>, NcError> {
    let left = u64::try_from(MAX_BYTES_IN_MEMORY).unwrap_or(u64::MAX);
    input.take(left + 1).read_to_end(&mut text)?;
    if text.len() > MAX_BYTES_IN_MEMORY {
        let what = format!(
            "a program with O-words is held in memory, up to {} MiB; this one is longer",
            MAX_BYTES_IN_MEMORY >> 20
        );
        return Err(NcError::not_compensated(number, what));
    }
    Ok(text)
}

/// Number of lines up to the second percent sign of the program, where reading ends; `before` percent signs precede
/// these lines. `None` if there is no second one.
fn end_by_percent(lines: &[(&[u8], &[u8])], before: usize) -> Option<usize> {
    let is_percent = |(line, _): &(&[u8], &[u8])| line.trim_ascii_start().starts_with(b"%");
    let percents = lines.iter().enumerate().filter(|(_, line)| is_percent(line));
    let last = percents.map(|(place, _)| place).nth(1_usize.saturating_sub(before));
    last.map(|place| place + 1)
}

/// Reads a line with its terminator; returns false at the end of the input.
fn read_line(input: &mut impl BufRead, text: &mut Vec<u8>, number: usize) -> Result<bool, NcError> {
    text.clear();
    // Length of the line without its terminator, once the terminator is found.
    let mut length = None;
    loop {
        let buffer = match input.fill_buf() {
            Ok(buffer) => buffer,
            Err(error) if error.kind() == std::io::ErrorKind::Interrupted => continue,
            Err(error) => return Err(error.into()),
        };
        let Some(first) = buffer.first() else {
            return Ok(!text.is_empty());
        };
        let taken = match length {
            Some(length) if !goes_on(&text[length..], *first) => return Ok(true),
            Some(_) => 1,
            None => {
                let found = memchr2(b'\n', b'\r', buffer);
                length = found.map(|place| text.len() + place);
                found.map_or(buffer.len(), |place| place + 1)
            }
        };
        text.extend_from_slice(&buffer[..taken]);
        input.consume(taken);
        check_length(text, number)?;
    }
}

/// Executes programs in parallel, each with its set-up, on a machine without errors, so that no line changes. `take` receives their
/// motions. Returns the result of `take`, and the error of the first failed run.
pub(crate) fn run_in_parallel<T>(
    machine: &Machine,
    temperatures: &Temperatures,
    (dialect, most_blocks): (Dialect, u64),
    programs: Vec<(&mut (dyn BufRead + Send), &SetUp)>,
    take: impl FnOnce(&[MotionReceiver]) -> T,
) -> Result<(T, Option<NcError>), NcError> {
    let ideal = Corrector::without_errors(machine, temperatures)?;
    thread::scope(|scope| {
        let (mut runs, mut motions) = (Vec::new(), Vec::new());
        for (mut program, setup) in programs {
            let (to, from) = motion_queue();
            motions.push(from);
            let (decimals, limit) = (Decimals::default(), CorrectionLimit::default());
            let rewriter = Rewriter::new(setup, ideal.clone(), decimals, dialect, limit);
            runs.push(scope.spawn(move || {
                let mut rewriter = rewriter?;
                rewriter.motion_sender = Some(to);
                // Mixed decimal notation is rejected only when a program is compensated.
                rewriter.interpreter.points.may_mix = true;
                execute(&mut program, &mut io::sink(), rewriter, most_blocks, |_| Ok(()))
            }));
        }
        let taken = take(&motions);
        // Disconnects senders that are still running.
        drop(motions);
        let is_end = |error: &NcError| matches!(error, NcError::Io(error) if error.kind() == io::ErrorKind::BrokenPipe);
        let mut failed = None;
        for run in runs {
            match run.join() {
                Ok(Err(error)) if failed.is_none() && !is_end(&error) => failed = Some(error),
                Ok(_) => {}
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        Ok((taken, failed))
    })
}

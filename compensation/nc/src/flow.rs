//! O-words: the order of execution of lines, in the program and in the subroutine files that it calls.

use std::{
    collections::{BTreeMap, HashMap},
    fs::File,
    io::Read as _,
    ops::Range,
    path::{Path, PathBuf},
};

use crate::{
    NcError,
    block::Scanner,
    line::{Ends, MAX_BYTES_IN_MEMORY, check_line, leader_of, split_lines},
};

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Keyword {
    Sub,
    EndSub,
    Return,
    Call,
    While,
    EndWhile,
    Do,
    DoWhile,
    If,
    ElseIf,
    Else,
    EndIf,
    Repeat,
    EndRepeat,
    Break,
    Continue,
    /// M98: call of a subprogram by number.
    CallProgram {
        number: u32,
        times: u64,
    },
    /// M99: end of a subprogram.
    EndProgram,
}

/// Keywords of O-words. Longer ones precede their prefixes.
const KEYWORDS: [(&str, Keyword); 15] = [
    ("ENDWHILE", Keyword::EndWhile),
    ("ENDREPEAT", Keyword::EndRepeat),
    ("ENDSUB", Keyword::EndSub),
    ("ENDIF", Keyword::EndIf),
    ("ELSEIF", Keyword::ElseIf),
    ("ELSE", Keyword::Else),
    ("CONTINUE", Keyword::Continue),
    ("BREAK", Keyword::Break),
    ("RETURN", Keyword::Return),
    ("REPEAT", Keyword::Repeat),
    ("WHILE", Keyword::While),
    ("CALL", Keyword::Call),
    ("SUB", Keyword::Sub),
    ("IF", Keyword::If),
    ("DO", Keyword::Do),
];

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Statement {
    pub(crate) name: String,
    pub(crate) keyword: Keyword,
    /// Byte offset at which conditions and arguments begin.
    pub(crate) rest: usize,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) enum OLine {
    /// Program number of a FANUC control; `None` if it is not a valid number.
    Program(Option<u32>),
    Statement(Statement),
    Wrong(&'static str),
}

/// Parses a line that begins with an O, a colon (its form in ISO code) or a program name in angle brackets; `None` for other lines.
pub(crate) fn o_line(line: &[u8]) -> Option<OLine> {
    let mut scanner = Scanner::new(line);
    let may_be_skipped = scanner.takes(b'/');
    if scanner.takes(b'N') {
        scanner.number();
    }
    if scanner.peek() == Some(b'<') && !may_be_skipped {
        // Program name of newer FANUC controls.
        let is_name = scanner.takes(b'<') && scanner.name().is_ok();
        let what = "expected nothing but a comment after the name of a program";
        return match is_end(&mut scanner) {
            _ if !is_name => None,
            true => Some(OLine::Program(None)),
            false => Some(OLine::Wrong(what)),
        };
    }
    // ISO code has a colon where EIA code has an O.
    let colon = scanner.peek() == Some(b':');
    if !scanner.takes(b'O') && !scanner.takes(b':') {
        return None;
    }
    if may_be_skipped {
        return Some(OLine::Wrong(
            "an O-word in a block that may be skipped (/): the following lines can be corrected for one of the two cases only: remove the slash or the block",
        ));
    }
    let name = if scanner.takes(b'<') && !colon {
        match scanner.name() {
            Ok(name) => name,
            Err(_) => return Some(OLine::Wrong("the name of this O-word does not end with >")),
        }
    } else if let Some((number, 0)) = scanner.number() {
        // Program number followed by a name: `O0001<NAME>`.
        let before = scanner.clone();
        if scanner.takes(b'<') && scanner.name().is_err() {
            scanner = before;
        }
        if is_end(&mut scanner) {
            return Some(OLine::Program(program_number(number)));
        }
        if colon {
            return Some(OLine::Wrong(
                "expected nothing but a comment after the number of a program",
            ));
        }
        format!("{number}")
    } else {
        return Some(OLine::Wrong(
            "an O-word with a computed name is not supported; expected a number, or a name between < and >",
        ));
    };
    let keyword = KEYWORDS.into_iter().find(|(letters, _)| scanner.takes_all(letters));
    let Some((_, keyword)) = keyword else {
        return Some(OLine::Wrong(
            "expected a word such as sub, call, while, if or repeat after the name of an O-word",
        ));
    };
    Some(OLine::Statement(Statement { name, keyword, rest: scanner.at() }))
}

/// True if nothing or only a comment is left of the line.
fn is_end(scanner: &mut Scanner<'_>) -> bool {
    matches!(scanner.peek(), None | Some(b'(' | b';'))
}

fn program_number(number: f64) -> Option<u32> {
    let is_number = (0.0..1e8).contains(&number) && number.fract() == 0.0;
    is_number.then(|| format!("{number:.0}").parse().ok()).flatten()
}

/// Parses a line that is only a subprogram call (`M98 P1000 L3`, or `M98 P31000` for three calls of 1000, as FANUC controls read more than
/// four digits) or its end (`M99`). `None` for other lines.
pub(crate) fn program_line(line: &[u8]) -> Option<Statement> {
    /// The digits before the four of the program number are the repeat count.
    const TIMES: u32 = 10_000;
    let mut scanner = Scanner::new(line);
    if scanner.takes(b'N') {
        scanner.number();
    }
    if !scanner.takes(b'M') {
        return None;
    }
    let (code, 0) = scanner.number()? else {
        return None;
    };
    let (mut called, mut times) = (None, None);
    loop {
        let letter = match scanner.peek() {
            None | Some(b'(' | b';') => break,
            Some(letter) => letter,
        };
        let of = match letter {
            b'P' | b'p' if called.is_none() => &mut called,
            b'L' | b'l' if times.is_none() => &mut times,
            _ => return None,
        };
        scanner.next();
        let (number, 0) = scanner.number()? else {
            return None;
        };
        *of = Some(program_number(number)?);
    }
    let keyword = match (code, called, times) {
        (98.0, Some(number), None) if number >= TIMES => {
            Keyword::CallProgram { number: number % TIMES, times: u64::from(number / TIMES) }
        }
        (98.0, Some(number), times) => {
            Keyword::CallProgram { number, times: times.map_or(1, u64::from) }
        }
        (99.0, None, None) => Keyword::EndProgram,
        _ => return None,
    };
    Some(Statement { name: String::new(), keyword, rest: scanner.at() })
}

/// The O-words of a program, with matched starts and ends. Lines are counted from 0.
#[derive(Clone, Debug, Default)]
pub(crate) struct Flow {
    pub(crate) statements: HashMap<usize, Statement>,
    /// Start line of each block statement by its end line, and the reverse.
    partner: HashMap<usize, usize>,
    /// For `if` and `elseif`: line of the next branch, or of the end.
    pub(crate) next_branch: HashMap<usize, usize>,
    /// Start of each subroutine, by file (0 is the program) and name.
    subs: HashMap<(usize, String), usize>,
    programs: HashMap<(usize, u32), usize>,
    files: Vec<(usize, PathBuf, Range<usize>)>,
}

impl Flow {
    /// Matches the O-words of a program and of the files that it calls.
    pub(crate) fn new(lines: &Listing<'_>) -> Result<Self, NcError> {
        let mut flow = Self::default();
        let mut open: Vec<(usize, usize)> = Vec::new();
        let mut in_file = 0;
        for (place, (line, _)) in lines.lines.iter().enumerate() {
            let (file, _) = lines.file_of(place);
            if file != in_file {
                Self::all_have_ended(&open, lines)?;
                in_file = file;
            }
            let mut statement = match o_line(line) {
                Some(OLine::Statement(statement)) => statement,
                Some(OLine::Wrong(what)) => return Err(lines.wrong(place, what)),
                Some(OLine::Program(number)) => {
                    if let Some(number) = number
                        && flow.programs.insert((file, number), place).is_some()
                    {
                        return Err(
                            lines.wrong(place, format!("the program O{number} is defined twice"))
                        );
                    }
                    continue;
                }
                None => match program_line(line) {
                    Some(statement) => statement,
                    None => continue,
                },
            };
            let name = statement.name.clone();
            let opened = open
                .last()
                .and_then(|(at, _)| flow.statements.get(at))
                .filter(|opened| opened.name == name)
                .map(|opened| opened.keyword);
            if statement.keyword == Keyword::While && opened == Some(Keyword::Do) {
                statement.keyword = Keyword::DoWhile;
            }
            let needs = match statement.keyword {
                Keyword::EndSub => Some(Keyword::Sub),
                Keyword::EndWhile => Some(Keyword::While),
                Keyword::DoWhile => Some(Keyword::Do),
                Keyword::ElseIf | Keyword::Else | Keyword::EndIf => Some(Keyword::If),
                Keyword::EndRepeat => Some(Keyword::Repeat),
                _ => None,
            };
            if let Some(needs) = needs {
                let Some((begin, branch)) = open.last_mut().filter(|_| opened == Some(needs))
                else {
                    return Err(lines.wrong(place, format!(
                        "o{name} ends or continues a block here that did not begin before or that contains an unfinished one"
                    )));
                };
                if needs == Keyword::If {
                    flow.next_branch.insert(*branch, place);
                    *branch = place;
                }
                if !matches!(statement.keyword, Keyword::ElseIf | Keyword::Else) {
                    flow.partner.insert(*begin, place);
                    flow.partner.insert(place, *begin);
                    open.pop();
                }
            }
            match statement.keyword {
                Keyword::Sub => {
                    if !open.is_empty() {
                        return Err(lines.wrong(
                            place,
                            format!("the subroutine o{name} begins inside an unfinished block"),
                        ));
                    }
                    if flow.subs.insert((file, name.clone()), place).is_some() {
                        return Err(
                            lines.wrong(place, format!("the subroutine o{name} is defined twice"))
                        );
                    }
                    open.push((place, place));
                }
                Keyword::While | Keyword::Do | Keyword::If | Keyword::Repeat => {
                    open.push((place, place));
                }
                _ => {}
            }
            flow.statements.insert(place, statement);
        }
        Self::all_have_ended(&open, lines)?;
        for (file, path, places) in lines.files() {
            flow.files.push((file, path.to_owned(), places));
        }
        Ok(flow)
    }

    fn all_have_ended(open: &[(usize, usize)], lines: &Listing<'_>) -> Result<(), NcError> {
        let Some((begin, _)) = open.last() else {
            return Ok(());
        };
        Err(lines.wrong(*begin, "the block that begins here does not end in the program"))
    }

    /// Line of the matching end or start.
    pub(crate) fn partner(&self, line: usize) -> usize {
        self.partner.get(&line).copied().unwrap_or(line)
    }

    /// Line of the start of a subroutine that a file calls. The subroutine is defined in this file, in the program, or
    /// in its own file; `None` if it is in none of them.
    pub(crate) fn sub(&self, name: &str, file: usize) -> Option<usize> {
        let own = (self.files.iter()).filter(|(_, path, _)| is_file_of(path, name));
        let files = [file, 0].into_iter().chain(own.map(|(file, ..)| *file));
        let mut found = files.filter_map(|file| self.subs.get(&(file, name.to_owned())));
        found.next().copied()
    }

    pub(crate) fn program(&self, number: u32, file: usize) -> Option<usize> {
        let numbered = [file, 0].map(|file| self.programs.get(&(file, number)).copied());
        if let Some(begin) = numbered.into_iter().flatten().next() {
            return Some(begin + 1);
        }
        // A separate file may lack the program number.
        let mut own =
            (self.files.iter()).filter(|(_, path, _)| is_file_of(path, &number_name(number)));
        let (file, _, places) = own.next()?;
        let begin = self.programs.get(&(*file, number));
        Some(begin.map_or(places.start, |begin| begin + 1))
    }

    pub(crate) fn end_of_if(&self, mut branch: usize) -> usize {
        while let Some(next) = self.next_branch.get(&branch) {
            branch = *next;
        }
        branch
    }

    pub(crate) fn keyword(&self, line: usize) -> Option<Keyword> {
        Some(self.statements.get(&line)?.keyword)
    }

    fn break_behind(&self, begin: usize, line: usize) -> Option<usize> {
        let name = &self.statements.get(&begin)?.name;
        (line + 1..self.partner(begin)).find(|at| {
            let statement = self.statements.get(at);
            statement.is_some_and(|of| of.keyword == Keyword::Break && of.name == *name)
        })
    }

    pub(crate) fn loop_around(&self, line: usize, name: &str) -> Option<usize> {
        (0..line).rev().find(|at| {
            self.statements.get(at).is_some_and(|statement| {
                statement.name == name
                    && matches!(statement.keyword, Keyword::While | Keyword::Do | Keyword::Repeat)
                    && self.partner(*at) > line
            })
        })
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Next {
    Again,
    Passed,
}

#[derive(Clone, Copy, Debug)]
struct Count {
    /// Remaining passes, including the active one.
    left: u64,
    /// Set if the count remains from an earlier execution of the loop, which was left early; LinuxCNC continues with
    /// this count.
    is_old: bool,
}

/// State: the active loops. Lines are counted from 0.
#[derive(Clone, Debug, Default)]
pub(crate) struct Loops {
    /// Counted loops that are active or were left early.
    counts: HashMap<usize, Count>,
    /// Line of a `break` that LinuxCNC keeps pending: the next `do` … `while` loop then ends after its current pass.
    breaks: Option<usize>,
    /// Line of a `continue` in a `do` … `while` loop that LinuxCNC keeps pending: the next loop skipped to its end is then repeated.
    continues: Option<usize>,
    /// Set if some loops are unrolled: the control does not reach their ends, so a `break` or `continue` may stay pending.
    pub(crate) some_are_written_out: bool,
}

const WAS_LEFT: &str = "this loop was left before its last pass (by break, continue, return or M99), and LinuxCNC continues with the number of passes left then: write it as while … endwhile";

impl Loops {
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

    /// Skips a loop to its end: the `while` condition is false, or all counted passes are complete.
    pub(crate) fn is_passed_by(&mut self, flow: &Flow, begin: usize) -> Result<Next, String> {
        let is_repeat = flow.keyword(begin) == Some(Keyword::Repeat);
        if let Some(of) = self.continues.filter(|_| is_repeat) {
            return Err(format!(
                "LinuxCNC repeats all passes of this loop, since the continue of line {} in a loop do … while is active until then: write that loop as while … endwhile",
                of + 1
            ));
        }
        self.passes_breaks(flow, begin, begin);
        self.ends_continue();
        Ok(Next::Passed)
    }

    pub(crate) fn breaks(&mut self, flow: &Flow, line: usize, begin: usize) -> Result<(), String> {
        if flow.keyword(begin) == Some(Keyword::Do) {
            self.ends_break();
            return Ok(());
        }
        if let Some(of) = self.continues {
            return Err(format!(
                "LinuxCNC continues the loop here, since the continue of line {} in a loop do … while is active until a loop has ended: write that loop as while … endwhile",
                of + 1
            ));
        }
        self.breaks = Some(line);
        Ok(())
    }

    pub(crate) fn continues(&mut self, flow: &Flow, line: usize, begin: usize) {
        self.passes_breaks(flow, begin, line);
        if flow.keyword(begin) == Some(Keyword::Do) {
            self.continues = Some(line);
        } else {
            self.ends_continue();
        }
    }

    /// Executes the end of a `do` … `while` loop; `holds` is the value of its condition.
    pub(crate) fn do_while(&mut self, holds: bool) -> Result<Next, String> {
        if !holds {
            self.ends_break();
            return Ok(Next::Passed);
        }
        match self.breaks {
            Some(of) => Err(format!(
                "LinuxCNC ends this loop here, whatever its condition is, since the break of line {} is active until the end of a loop do … while: write this loop as while … endwhile",
                of + 1
            )),
            None => Ok(Next::Again),
        }
    }

    /// Skips the lines after `line`; a `break` of this loop among the skipped lines becomes pending.
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

#[derive(Clone, Debug)]
pub(crate) struct SubFile {
    pub(crate) path: PathBuf,
    pub(crate) text: Vec<u8>,
}

/// The lines of the executed program, followed by those of the files that it calls.
#[derive(Clone, Debug)]
pub(crate) struct Listing<'t> {
    pub(crate) lines: Vec<(&'t [u8], &'t [u8])>,
    /// Number of the first line in its file.
    pub(crate) first: usize,
    pub(crate) own: usize,
    files: Vec<(&'t Path, usize)>,
}

impl<'t> Listing<'t> {
    /// Lists the lines of a program, numbered from `first`, and the lines of the files.
    pub(crate) fn new(
        own: Vec<(&'t [u8], &'t [u8])>,
        first: usize,
        files: &'t [SubFile],
    ) -> Result<Self, NcError> {
        let mut ends = Ends::default();
        for (place, (line, end)) in own.iter().enumerate() {
            check_line(line, first + place)?;
            ends.check(line, end, first + place)?;
        }
        let mut lines = Self { own: own.len(), lines: own, first, files: Vec::new() };
        for file in files {
            lines.files.push((&file.path, lines.lines.len()));
            for (place, line) in split_lines(&file.text).into_iter().enumerate() {
                check_line(line.0, place + 1).map_err(|error| error.in_file(&file.path))?;
                lines.lines.push(line);
            }
        }
        Ok(lines)
    }

    /// File of a line: 0 is the program; otherwise also the path and the index of the file's first line.
    pub(crate) fn file_of(&self, place: usize) -> (usize, Option<(&'t Path, usize)>) {
        let file = self.files.partition_point(|(_, begins)| *begins <= place);
        (file, file.checked_sub(1).map(|at| self.files[at]))
    }

    /// Files by index from 1: path and range of lines.
    pub(crate) fn files(&self) -> impl Iterator<Item = (usize, &'t Path, std::ops::Range<usize>)> {
        let ends = self.files.iter().skip(1).map(|(_, begins)| *begins);
        let ends = ends.chain([self.lines.len()]);
        let files = self.files.iter().zip(ends).enumerate();
        files.map(|(place, (&(path, begins), end))| (place + 1, path, begins..end))
    }

    pub(crate) fn wrong(&self, place: usize, what: impl Into<String>) -> NcError {
        self.at(place, NcError::not_compensated(0, what))
    }

    /// Adds the line to an error, and the file if it is not the program.
    pub(crate) fn at(&self, place: usize, error: NcError) -> NcError {
        match self.file_of(place).1 {
            Some((path, begins)) => error.at_line(place - begins + 1).in_file(path),
            None => error.at_line(self.first + place),
        }
    }
}

/// Names that a file calls and defines; numbered programs are named O and the number.
#[derive(Default)]
struct Names {
    called: Vec<String>,
    defined: Vec<String>,
}

impl Names {
    fn of<'t>(lines: impl Iterator<Item = &'t [u8]>) -> Self {
        let mut names = Self::default();
        for line in lines {
            match o_line(line) {
                Some(OLine::Program(Some(number))) => names.defined.push(number_name(number)),
                Some(OLine::Statement(Statement { name, keyword, .. })) => match keyword {
                    Keyword::Sub => names.defined.push(name),
                    Keyword::Call => names.called.push(name),
                    _ => {}
                },
                Some(_) => {}
                None => {
                    if let Some(Statement {
                        keyword: Keyword::CallProgram { number, .. }, ..
                    }) = program_line(line)
                    {
                        names.called.push(number_name(number));
                    }
                }
            }
        }
        names
    }
}

/// Internal name of a numbered program. The blank distinguishes it from O-word names.
fn number_name(number: u32) -> String {
    format!("O {number}")
}

/// File names a subroutine may have, in lower case.
fn file_names(called: &str) -> Vec<String> {
    let Some(number) = called.strip_prefix("O ") else {
        return vec![format!("{called}.ngc").to_lowercase()];
    };
    let begins = [
        format!("o{number:0>4}"),
        format!("o{number}"),
        format!("{number:0>4}"),
        number.to_owned(),
    ];
    let ends = ["", ".nc", ".ngc", ".tap"];
    (begins.iter()).flat_map(|begin| ends.map(|end| format!("{begin}{end}"))).collect()
}

fn is_file_of(path: &Path, called: &str) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    name.is_some_and(|name| file_names(called).contains(&name.to_lowercase()))
}

/// Loads the files with the subroutines that the program calls, recursively: for each name the first file in folder order. Names without a
/// file are skipped.
pub(crate) fn load(own: &[(&[u8], &[u8])], folders: &[PathBuf]) -> Result<Vec<SubFile>, NcError> {
    let mut found: BTreeMap<String, PathBuf> = BTreeMap::new();
    for folder in folders {
        let in_folder = |error| NcError::from(error).in_file(folder);
        for entry in std::fs::read_dir(folder).map_err(in_folder)? {
            let path = entry.map_err(in_folder)?.path();
            if let Some(name) = path.file_name().and_then(|name| name.to_str())
                && path.is_file()
            {
                found.entry(name.to_lowercase()).or_insert(path);
            }
        }
    }
    let mut files: Vec<SubFile> = Vec::new();
    let main = Names::of(own.iter().map(|(line, _)| *line));
    let mut called: Vec<String> = main.called;
    let mut size = 0;
    while let Some(name) = called.pop() {
        let is_there =
            main.defined.contains(&name) || files.iter().any(|file| is_file_of(&file.path, &name));
        let path = file_names(&name).into_iter().find_map(|file| found.get(&file));
        let Some(path) = path.filter(|_| !is_there) else {
            continue;
        };
        let left = (MAX_BYTES_IN_MEMORY - size) as u64 + 1;
        let mut text = Vec::new();
        let read = File::open(path).and_then(|file| file.take(left).read_to_end(&mut text));
        read.map_err(|error| NcError::from(error).in_file(path))?;
        size += text.len();
        if size > MAX_BYTES_IN_MEMORY {
            let what = format!(
                "the files of subroutines are longer than {} MiB",
                MAX_BYTES_IN_MEMORY >> 20
            );
            return Err(NcError::not_compensated(1, what).in_file(path));
        }
        text.drain(..leader_of(&text));
        let of_file = Names::of(split_lines(&text).into_iter().map(|(line, _)| line));
        let others = of_file.called.into_iter();
        called.extend(others.filter(|name| !of_file.defined.contains(name)));
        files.push(SubFile { path: path.clone(), text });
    }
    Ok(files)
}

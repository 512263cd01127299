//! O-words: which line is executed after which, in the program and in the files with subroutines that it calls.

use std::{
    collections::{BTreeMap, HashMap},
    ops::Range,
    path::{Path, PathBuf},
};

use crate::{
    NcError,
    block::Scanner,
    line_ends::{Ends, MOST_IN_MEMORY, check_line, leader_of, split_lines},
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
    /// The end of a loop that begins with `do`.
    DoWhile,
    If,
    ElseIf,
    Else,
    EndIf,
    Repeat,
    EndRepeat,
    Break,
    Continue,
    /// M98: a subprogram by its number.
    CallProgram {
        number: u32,
        times: u64,
    },
    /// M99: its end.
    EndProgram,
}

/// Longer ones before those with which they begin.
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
    /// Where its conditions and arguments begin, bytes from the beginning of the line.
    pub(crate) rest: usize,
}

/// What a line that begins with an O is.
#[derive(Clone, Debug, PartialEq)]
pub(crate) enum OLine {
    /// The number of a program, as FANUC controls have it; `None` where it is none.
    Program(Option<u32>),
    Statement(Statement),
    /// It cannot be read.
    Wrong(&'static str),
}

/// What a line is that begins with an O; `None`: it does not.
pub(crate) fn o_line(line: &[u8]) -> Option<OLine> {
    let mut scanner = Scanner::new(line);
    let may_be_skipped = scanner.takes(b'/');
    if scanner.takes(b'N') {
        scanner.number();
    }
    if scanner.peek() == Some(b'<') && !may_be_skipped {
        // The name of a program, as newer FANUC controls have it.
        let is_name = scanner.takes(b'<') && scanner.name().is_ok();
        let what = "expected nothing but a comment after the name of a program";
        return match is_end(&mut scanner) {
            _ if !is_name => None,
            true => Some(OLine::Program(None)),
            false => Some(OLine::Wrong(what)),
        };
    }
    // A colon is what the ISO code has for the O of the EIA code.
    let colon = scanner.peek() == Some(b':');
    if !scanner.takes(b'O') && !scanner.takes(b':') {
        return None;
    }
    if may_be_skipped {
        return Some(OLine::Wrong(
            "an O-word in a block that may be skipped (/): what follows can be corrected for one of the two only. Take the slash away, or the block",
        ));
    }
    let name = if scanner.takes(b'<') && !colon {
        match scanner.name() {
            Ok(name) => name,
            Err(_) => return Some(OLine::Wrong("the name of this O-word does not end with >")),
        }
    } else if let Some((number, 0)) = scanner.number() {
        // O0001<NAME>
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
            "an O-word whose name is computed is not followed; expected a number, or a name between < and >",
        ));
    };
    let keyword = KEYWORDS
        .into_iter()
        .find(|(letters, _)| scanner.takes_all(letters));
    let Some((_, keyword)) = keyword else {
        return Some(OLine::Wrong(
            "expected a word such as sub, call, while, if or repeat after the name of an O-word",
        ));
    };
    Some(OLine::Statement(Statement {
        name,
        keyword,
        rest: scanner.at(),
    }))
}

/// Nothing but a comment is left.
fn is_end(scanner: &mut Scanner<'_>) -> bool {
    matches!(scanner.peek(), None | Some(b'(' | b';'))
}

/// A number of a program, which is whole and has up to eight digits.
fn program_number(number: f64) -> Option<u32> {
    let is_number = (0.0..1e8).contains(&number) && number.fract() == 0.0;
    is_number
        .then(|| format!("{number:.0}").parse().ok())
        .flatten()
}

/// A line that is nothing but a call of a subprogram (`M98 P1000 L3`, or `M98 P31000` for three times 1000, as FANUC controls read
/// more than four digits), or its end (`M99`). `None`: it is another line.
pub(crate) fn program_line(line: &[u8]) -> Option<Statement> {
    /// Behind the four digits of the program stands how often it is called.
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
        (98.0, Some(number), None) if number >= TIMES => Keyword::CallProgram {
            number: number % TIMES,
            times: u64::from(number / TIMES),
        },
        (98.0, Some(number), times) => Keyword::CallProgram {
            number,
            times: times.map_or(1, u64::from),
        },
        (99.0, None, None) => Keyword::EndProgram,
        _ => return None,
    };
    Some(Statement {
        name: String::new(),
        keyword,
        rest: scanner.at(),
    })
}

/// A program with O-words whose beginnings and ends were found. Lines are counted from 0.
#[derive(Clone, Debug, Default)]
pub(crate) struct Flow {
    pub(crate) statements: HashMap<usize, Statement>,
    /// The line at which what begins or ends at a line ends or begins.
    partner: HashMap<usize, usize>,
    /// For an `if` and an `elseif`, the line of the next branch, or of the end.
    pub(crate) next_branch: HashMap<usize, usize>,
    /// Where each subroutine begins, by its file, 0 being the program, and its name.
    subs: HashMap<(usize, String), usize>,
    /// Where each program with a number begins.
    programs: HashMap<(usize, u32), usize>,
    /// The files that the program calls: their places from 1, and their lines.
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
                            lines.wrong(place, format!("the program O{number} stands twice"))
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
                        "o{name} ends or goes on here what did not begin before, or what lies in it has not ended"
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
                            format!(
                                "the subroutine o{name} begins in something that has not ended"
                            ),
                        ));
                    }
                    if flow.subs.insert((file, name.clone()), place).is_some() {
                        return Err(
                            lines.wrong(place, format!("the subroutine o{name} stands twice"))
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
        Err(lines.wrong(*begin, "what begins here does not end in the program"))
    }

    /// Where what begins at a line ends, or what ends there begins.
    pub(crate) fn partner(&self, line: usize) -> usize {
        self.partner.get(&line).copied().unwrap_or(line)
    }

    /// Where a subroutine begins that a line of this file calls: in the same file, in the program, or in a file of its own.
    pub(crate) fn sub(&self, name: &str, file: usize) -> Option<usize> {
        let own = (self.files.iter()).filter(|(_, path, _)| is_file_of(path, name));
        let files = [file, 0].into_iter().chain(own.map(|(file, ..)| *file));
        let mut found = files.filter_map(|file| self.subs.get(&(file, name.to_owned())));
        found.next().copied()
    }

    /// The first line of the program of this number that a line of this file calls.
    pub(crate) fn program(&self, number: u32, file: usize) -> Option<usize> {
        let numbered = [file, 0].map(|file| self.programs.get(&(file, number)).copied());
        if let Some(begin) = numbered.into_iter().flatten().next() {
            return Some(begin + 1);
        }
        // A file of its own may do without the number in it.
        let mut own =
            (self.files.iter()).filter(|(_, path, _)| is_file_of(path, &number_name(number)));
        let (file, _, places) = own.next()?;
        let begin = self.programs.get(&(*file, number));
        Some(begin.map_or(places.start, |begin| begin + 1))
    }

    /// The end of the `if` to which a branch belongs.
    pub(crate) fn end_of_if(&self, mut branch: usize) -> usize {
        while let Some(next) = self.next_branch.get(&branch) {
            branch = *next;
        }
        branch
    }

    pub(crate) fn keyword(&self, line: usize) -> Option<Keyword> {
        Some(self.statements.get(&line)?.keyword)
    }

    /// The first `break` behind a line that belongs to the loop which begins at `begin`.
    fn break_behind(&self, begin: usize, line: usize) -> Option<usize> {
        let name = &self.statements.get(&begin)?.name;
        (line + 1..self.partner(begin)).find(|at| {
            let statement = self.statements.get(at);
            statement.is_some_and(|of| of.keyword == Keyword::Break && of.name == *name)
        })
    }

    /// Where the loop of this name begins in which a line lies.
    pub(crate) fn loop_around(&self, line: usize, name: &str) -> Option<usize> {
        (0..line).rev().find(|at| {
            self.statements.get(at).is_some_and(|statement| {
                statement.name == name
                    && matches!(
                        statement.keyword,
                        Keyword::While | Keyword::Do | Keyword::Repeat
                    )
                    && self.partner(*at) > line
            })
        })
    }
}

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

#[derive(Clone, Debug)]
pub(crate) struct SubFile {
    pub(crate) path: PathBuf,
    pub(crate) text: Vec<u8>,
}

/// A program that is executed: its lines, and behind them those of the files that it calls.
#[derive(Clone, Debug)]
pub(crate) struct Listing<'t> {
    /// Each line and its end.
    pub(crate) lines: Vec<(&'t [u8], &'t [u8])>,
    /// The number of the first one in its file.
    pub(crate) first: usize,
    /// How many of them are the program's own.
    pub(crate) own: usize,
    /// The other files, in their order, and where the lines of each begin.
    files: Vec<(&'t Path, usize)>,
}

impl<'t> Listing<'t> {
    /// The lines of a program, the first of which has this number, and those of the files.
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
        let mut lines = Self {
            own: own.len(),
            lines: own,
            first,
            files: Vec::new(),
        };
        for file in files {
            lines.files.push((&file.path, lines.lines.len()));
            for (place, line) in split_lines(&file.text).into_iter().enumerate() {
                check_line(line.0, place + 1).map_err(|error| error.in_file(&file.path))?;
                lines.lines.push(line);
            }
        }
        Ok(lines)
    }

    /// Which file a line is in: 0 is the program, and its path and first line where it is another.
    pub(crate) fn file_of(&self, place: usize) -> (usize, Option<(&'t Path, usize)>) {
        let file = self.files.partition_point(|(_, begins)| *begins <= place);
        (file, file.checked_sub(1).map(|at| self.files[at]))
    }

    /// The files by their places from 1: the path, and the lines of it.
    pub(crate) fn files(&self) -> impl Iterator<Item = (usize, &'t Path, std::ops::Range<usize>)> {
        let ends = self.files.iter().skip(1).map(|(_, begins)| *begins);
        let ends = ends.chain([self.lines.len()]);
        let files = self.files.iter().zip(ends).enumerate();
        files.map(|(place, (&(path, begins), end))| (place + 1, path, begins..end))
    }

    /// What is wrong at a line.
    pub(crate) fn wrong(&self, place: usize, what: impl Into<String>) -> NcError {
        self.at(place, NcError::not_compensated(0, what))
    }

    /// An error at a line, with its file where that is not the program.
    pub(crate) fn at(&self, place: usize, error: NcError) -> NcError {
        match self.file_of(place).1 {
            Some((path, begins)) => error.at_line(place - begins + 1).in_file(path),
            None => error.at_line(self.first + place),
        }
    }
}

/// What a file calls and what stands in it, by name; the programs with a number are called O and the number.
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
                        keyword: Keyword::CallProgram { number, .. },
                        ..
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

/// How a program with a number is called in the list of names: no O-word has a blank in its name.
fn number_name(number: u32) -> String {
    format!("O {number}")
}

/// The names that a file with this subroutine may have, in small letters.
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
    (begins.iter())
        .flat_map(|begin| ends.map(|end| format!("{begin}{end}")))
        .collect()
}

/// Whether a subroutine of this name is looked for in a file.
fn is_file_of(path: &Path, called: &str) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    name.is_some_and(|name| file_names(called).contains(&name.to_lowercase()))
}

/// The files in which what a program calls, and what these call, stands: of each name the first one in the order of the folders. What is in
/// no file is left out.
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
        let path = file_names(&name)
            .into_iter()
            .find_map(|file| found.get(&file));
        let Some(path) = path.filter(|_| !is_there) else {
            continue;
        };
        let mut text = std::fs::read(path).map_err(|error| NcError::from(error).in_file(path))?;
        text.drain(..leader_of(&text));
        size += text.len();
        if size > MOST_IN_MEMORY {
            let what = format!(
                "the files of subroutines are longer than {} MiB",
                MOST_IN_MEMORY >> 20
            );
            return Err(NcError::not_compensated(1, what).in_file(path));
        }
        let of_file = Names::of(split_lines(&text).into_iter().map(|(line, _)| line));
        let others = of_file.called.into_iter();
        called.extend(others.filter(|name| !of_file.defined.contains(name)));
        files.push(SubFile {
            path: path.clone(),
            text,
        });
    }
    Ok(files)
}

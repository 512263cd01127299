//! O-words: which line is executed after which. They are matched once, before anything is executed.

use std::{collections::HashMap, ops::Range, path::PathBuf};

use crate::{
    NcError,
    scan::Scanner,
    subroutines::{Listing, is_file_of, is_file_of_number},
};

/// What an O-word does.
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

/// A line with an O-word.
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
            let wrong = |what: String| lines.at(place, NcError::Flow { line: 0, what });
            let (file, _) = lines.file_of(place);
            if file != in_file {
                Self::all_have_ended(&open, lines)?;
                in_file = file;
            }
            let mut statement = match o_line(line) {
                Some(OLine::Statement(statement)) => statement,
                Some(OLine::Wrong(what)) => return Err(wrong(what.to_owned())),
                Some(OLine::Program(number)) => {
                    if let Some(number) = number
                        && flow.programs.insert((file, number), place).is_some()
                    {
                        return Err(wrong(format!("the program O{number} stands twice")));
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
                    return Err(wrong(format!(
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
                        return Err(wrong(format!(
                            "the subroutine o{name} begins in something that has not ended"
                        )));
                    }
                    if flow.subs.insert((file, name.clone()), place).is_some() {
                        return Err(wrong(format!("the subroutine o{name} stands twice")));
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
        let what = "what begins here does not end in the program".to_owned();
        Err(lines.at(*begin, NcError::Flow { line: 0, what }))
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
        let mut own = (self.files.iter()).filter(|(_, path, _)| is_file_of_number(path, number));
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

    /// What the O-word of a line does.
    pub(crate) fn keyword(&self, line: usize) -> Option<Keyword> {
        Some(self.statements.get(&line)?.keyword)
    }

    /// The first `break` behind a line that belongs to the loop which begins at `begin`.
    pub(crate) fn break_behind(&self, begin: usize, line: usize) -> Option<usize> {
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

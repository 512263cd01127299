//! Subroutines in files of their own: which files a program needs, and the lines of all of them behind its own.

use std::{
    collections::BTreeMap,
    path::{Path, PathBuf},
};

use crate::{
    NcError,
    flow::{Keyword, OLine, Statement, o_line, program_line},
    line_ends::{Ends, leader_of, split_lines},
    program::{MOST_IN_MEMORY, check_line},
};

/// A file with subroutines.
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
pub(crate) fn is_file_of(path: &Path, called: &str) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    name.is_some_and(|name| file_names(called).contains(&name.to_lowercase()))
}

/// The same for a program with a number.
pub(crate) fn is_file_of_number(path: &Path, number: u32) -> bool {
    is_file_of(path, &number_name(number))
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
            return Err(NcError::Flow { line: 1, what }.in_file(path));
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

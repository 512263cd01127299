//! The languages of programs, and which of them a file is in.
//!
//! A language is a reader, which makes a [`Block`] of a line, and a writer of words, its [`Script`](crate::script::Script). What a block
//! means is the same for all of them: its words have the letters and the codes that RS-274 has for it.

use std::path::Path;

use crate::{
    NcError, block::Block, control::read_increments, control_lines, expression::Expressions,
    fault::Fault, heidenhain, interpret::Interpreter, siemens,
};

/// The language of a program.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[non_exhaustive]
pub enum Dialect {
    /// RS-274 (G-code) as LinuxCNC and FANUC controls read it.
    #[default]
    Rs274,
    /// The language of SINUMERIK controls.
    Siemens,
    /// The conversational language of HEIDENHAIN controls.
    Heidenhain,
}

/// What reading a line leaves besides its block.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Reads {
    /// It reads the place of an axis, which is the corrected one at the control.
    pub(crate) axes: crate::coordinates::Axes<bool>,
    /// It reads what a subroutine returned.
    pub(crate) returned: bool,
}

impl Dialect {
    /// The language in which files with this name are written: SINUMERIK for `.mpf` and `.spf`, HEIDENHAIN for `.h`,
    /// otherwise RS-274.
    #[must_use]
    pub fn of_file(path: &Path) -> Self {
        let extension = path.extension().and_then(|extension| extension.to_str());
        match extension.map(str::to_ascii_lowercase).as_deref() {
            Some("mpf" | "spf") => Self::Siemens,
            Some("h") => Self::Heidenhain,
            _ => Self::Rs274,
        }
    }

    /// Its name, as `--dialect` of `volcomp nc` has it.
    #[must_use]
    pub fn name(self) -> &'static str {
        match self {
            Self::Rs274 => "rs274",
            Self::Siemens => "siemens",
            Self::Heidenhain => "heidenhain",
        }
    }

    /// Reads a line without its end.
    pub(crate) fn read(
        self,
        block: &mut Block,
        text: &[u8],
        number: usize,
        interpreter: &Interpreter,
    ) -> Result<Reads, NcError> {
        let fault = |fault| NcError::Block {
            line: number,
            fault,
        };
        match self {
            Self::Rs274 => {
                if let Some(control) = interpreter.control
                    && control_lines::read(control, block, text).map_err(fault)?
                {
                    return Ok(Reads::default());
                }
                let expressions = Expressions::new(interpreter);
                block
                    .read(text, &expressions)
                    .map_err(|of| fault(corner(text, &of).or_else(|| hint(text)).unwrap_or(of)))?;
                read_increments(block, text, interpreter).map_err(fault)?;
                Ok(Reads {
                    axes: expressions.axes_read(),
                    returned: expressions.has_read_returned(),
                })
            }
            Self::Siemens => {
                siemens::read(block, text, interpreter).map_err(fault)?;
                Ok(Reads::default())
            }
            Self::Heidenhain => {
                heidenhain::read(block, text, interpreter).map_err(fault)?;
                Ok(Reads::default())
            }
        }
    }
}

const MACRO: &str =
    "that is the macro language of FANUC controls; only O-words as LinuxCNC has them are executed";
const SIEMENS: &str = "that is the language of SINUMERIK controls: --dialect siemens";
const HEIDENHAIN: &str =
    "that is the conversational language of HEIDENHAIN controls: --dialect heidenhain";

/// With what a line of another language begins, behind the number of its block.
const OTHERS: [(&str, &str); 31] = [
    ("IF", MACRO),
    ("WHILE", MACRO),
    ("GOTO", MACRO),
    ("DO", MACRO),
    ("BEGIN PGM", HEIDENHAIN),
    ("END PGM", HEIDENHAIN),
    ("BLK FORM", HEIDENHAIN),
    ("TOOL CALL", HEIDENHAIN),
    ("TOOL DEF", HEIDENHAIN),
    ("CYCL", HEIDENHAIN),
    ("L X", HEIDENHAIN),
    ("L Y", HEIDENHAIN),
    ("L Z", HEIDENHAIN),
    ("LP", HEIDENHAIN),
    ("CC", HEIDENHAIN),
    ("CR", HEIDENHAIN),
    ("LBL", HEIDENHAIN),
    ("FN", HEIDENHAIN),
    ("END", MACRO),
    ("TRANS", SIEMENS),
    ("ATRANS", SIEMENS),
    ("ROT", SIEMENS),
    ("AROT", SIEMENS),
    ("TRAORI", SIEMENS),
    ("TRAFOOF", SIEMENS),
    ("DEF", SIEMENS),
    ("MSG", SIEMENS),
    ("MCALL", SIEMENS),
    ("CYCLE", SIEMENS),
    ("PROC", SIEMENS),
    ("R", SIEMENS),
];
/// What stands only in lines of SINUMERIK.
const IN_SIEMENS: [&str; 5] = ["=IC(", "=AC(", "=DC(", "CR=", "SUPA"];

/// Why a comma cannot be read, where it is that of a corner.
fn corner(text: &[u8], fault: &Fault) -> Option<Fault> {
    let Fault::Character { column, found: ',' } = *fault else {
        return None;
    };
    let letter = (text.get(column..)?.iter()).find(|byte| !byte.is_ascii_whitespace())?;
    let why = match letter.to_ascii_uppercase() {
        b'R' => "a rounded corner is a motion of its own",
        b'C' => "a bevelled corner is a motion of its own",
        b'A' => "a line by its direction",
        _ => return None,
    };
    Some(Fault::NotFollowed {
        column,
        found: format!(",{}", char::from(*letter).to_ascii_uppercase()),
        why,
    })
}

/// Why a line that RS-274 does not know cannot be read, where it plainly is of another language.
fn hint(text: &[u8]) -> Option<Fault> {
    let text = String::from_utf8_lossy(text).to_ascii_uppercase();
    let text = text.trim_start().trim_start_matches('/').trim_start();
    let is_number = |c: char| c.is_ascii_digit() || c == ' ';
    let rest = text.strip_prefix('N').unwrap_or(text);
    let rest = rest.trim_start_matches(is_number);
    let begins = |word: &str| {
        let Some(behind) = rest.strip_prefix(word) else {
            return false;
        };
        match word {
            // R1=5, as no word of RS-274 is written.
            "R" => behind.trim_start_matches(is_number).starts_with('='),
            _ => word.starts_with("L ") || !behind.starts_with(|c: char| c.is_ascii_alphabetic()),
        }
    };
    let begin = OTHERS.into_iter().find(|(word, _)| begins(word));
    let within = || IN_SIEMENS.into_iter().find(|word| text.contains(word));
    let (found, why) = begin.or_else(|| Some((within()?, SIEMENS)))?;
    Some(Fault::NotFollowed {
        column: 1,
        found: found.trim().to_owned(),
        why,
    })
}

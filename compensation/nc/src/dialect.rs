//! The languages of programs, and which of them a file is in.
//!
//! A language is a reader, which makes a [`Block`] of a line, and a writer of words, its [`Script`](crate::script::Script). What a block
//! means is the same for all of them: its words have the letters and the codes that RS-274 has for it.

use std::path::Path;

use crate::{
    NcError, block::Block, expression::Expressions, heidenhain, interpret::Interpreter, siemens,
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
                let expressions = Expressions::new(interpreter);
                block.read(text, &expressions).map_err(fault)?;
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

//! RS-274 lines, and additional syntax of controls and printers.
//!
//! The behaviour of Marlin and Klipper is taken from their sources: a line is one command, and its arguments are not RS-274 words (`M117 Z
//! is 5`, `G28 X Y`).

use crate::{
    block::{Assignment, Block, BlockStart, Command, Manner, Parameter, Scanner, Word},
    codes::{Codes, is_cycle},
    control::{Control, DecimalPoints, INCREMENTS},
    error::{Column, Fault},
    expression::Expressions,
    interpreter::Interpreter,
    number::plain,
};

impl Block {
    /// Parses a line; `line` has no terminator and no O-words, which are read elsewhere.
    pub(crate) fn read(&mut self, line: &[u8], expressions: &Expressions<'_>) -> Result<(), Fault> {
        self.clear();
        let mut scanner = Scanner::new(line);
        let mut end = 0;
        match scanner.peek() {
            Some(b'/') => {
                scanner.next();
                self.begins = BlockStart::Slash;
                self.skip = scanner.at() - 1..scanner.at();
                end = scanner.at();
            }
            Some(b'%') => {
                self.begins = BlockStart::Percent;
                self.end = line.len();
                return Ok(());
            }
            _ => {}
        }
        self.end = end;
        while let Some(byte) = scanner.peek() {
            let (at, column) = (scanner.at(), scanner.column());
            scanner.next();
            match byte {
                b'(' => skip_comment(&mut scanner, column)?,
                b';' => break,
                b'#' => {
                    self.assignment(at, &mut scanner, expressions)?;
                    self.end = scanner.at();
                }
                b'A'..=b'Z' | b'@' | b'^' | b'$' => {
                    scanner.peek();
                    let from = scanner.at();
                    let read = expressions.read(&mut scanner)?;
                    let Some((value, decimals)) = read else {
                        return Err(column.no_number(byte));
                    };
                    self.end = scanner.at();
                    let text = from..scanner.at();
                    self.push(byte, at, text, value, Manner::Modal, decimals);
                }
                other => {
                    return Err(column.character(other));
                }
            }
        }
        Ok(())
    }

    pub(crate) fn clear(&mut self) {
        self.words.clear();
        self.assignments.clear();
        self.commands.clear();
        self.begins = BlockStart::Nothing;
        self.skip = 0..0;
        self.number = None;
        self.keyword = 0..0;
        self.comma = None;
        self.last_in_increments = None;
        self.end = 0;
    }

    /// Reads `#12 = 3` or `#<name> = 3` after the `#`.
    fn assignment(
        &mut self,
        at: usize,
        scanner: &mut Scanner<'_>,
        expressions: &Expressions<'_>,
    ) -> Result<(), Fault> {
        let parameter = if scanner.takes(b'<') {
            Some(Parameter::Named(scanner.name()?))
        } else {
            let number = expressions.parameter_number(scanner, 0)?;
            number.map(Parameter::Numbered)
        };
        let column = scanner.column();
        if !scanner.takes(b'=') {
            return Err(column.malformed("expected = after a parameter that begins a word"));
        }
        scanner.peek();
        let (column, from) = (scanner.column(), scanner.at());
        let read = expressions
            .read(scanner)?
            .ok_or(column.malformed("expected the value of the parameter after ="))?;
        let parameter = parameter
            .ok_or(column.malformed("only the machine knows which parameter is set here"))?;
        self.assignments.push(Assignment {
            parameter,
            value: read.0,
            all: at..scanner.at(),
            text: from..scanner.at(),
        });
        Ok(())
    }

    pub(crate) fn word(&self, letter: u8) -> Option<&Word> {
        self.words.iter().rev().find(|word| word.letter == letter)
    }
}

fn skip_comment(scanner: &mut Scanner<'_>, column: Column) -> Result<(), Fault> {
    let rest = &scanner.bytes()[scanner.at()..];
    let Some(length) = rest.iter().position(|byte| *byte == b')') else {
        return Err(column.malformed("the comment that begins here does not end in its line"));
    };
    scanner.go_to(scanner.at() + length + 1);
    Ok(())
}

/// Checks the end of a block on FANUC and Haas controls, where a semicolon ends the block instead of beginning a
/// comment. `rest` is the text after the last word, from column `from` on. Errors: anything but comments follows the
/// semicolon.
pub(crate) fn check_end_of_block(rest: &[u8], from: usize) -> Result<(), Fault> {
    let (mut in_comment, mut ended) = (false, false);
    for (place, byte) in rest.iter().enumerate() {
        match byte {
            b')' => in_comment = false,
            _ if in_comment => {}
            b'(' => in_comment = true,
            b';' => ended = true,
            b' ' | b'\t' => {}
            _ if ended => {
                return Err(Column(from + place + 1).malformed(
                    "found words after a semicolon, which ends a block on this control: write them into a separate line, or a comment in parentheses",
                ));
            }
            _ => {}
        }
    }
    Ok(())
}

const MACRO: &str =
    "that is the macro language of FANUC controls; only O-words as LinuxCNC has them are executed";

const SIEMENS: &str = "that is the language of SINUMERIK controls: --dialect siemens";

const HEIDENHAIN: &str =
    "that is the conversational language of HEIDENHAIN controls: --dialect heidenhain";

/// Line beginnings, after the block number, that identify another language.
const OTHERS: [(&str, &str); 3] = [
    (HEIDENHAIN, "BEGIN PGM,END PGM,BLK FORM,TOOL CALL,TOOL DEF,CYCL,L X,L Y,L Z,LP,CC,CR,LBL,FN"),
    (MACRO, "IF,WHILE,GOTO,DO,END"),
    (SIEMENS, "TRANS,ATRANS,ROT,AROT,TRAORI,TRAFOOF,DEF,MSG,MCALL,CYCLE,PROC,R"),
];

/// Text that only occurs in SINUMERIK lines.
const IN_SIEMENS: [&str; 5] = ["=IC(", "=AC(", "=DC(", "CR=", "SUPA"];

pub(crate) fn corner(text: &[u8], fault: &Fault) -> Option<Fault> {
    let Fault::Character { column, found: ',' } = *fault else {
        return None;
    };
    let letter = (text.get(column..)?.iter()).find(|byte| !byte.is_ascii_whitespace())?;
    let letter = letter.to_ascii_uppercase();
    let why = match letter {
        b'R' => "a rounded corner is a separate motion",
        b'C' => "a chamfer is a separate motion",
        b'A' => "a line by its direction",
        _ => return None,
    };
    Some(Column(column).not_followed(&format!(",{}", char::from(letter)), why))
}

/// The fault for a line that RS-274 cannot read but is clearly in another language.
pub(crate) fn hint(text: &[u8]) -> Option<Fault> {
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
            // R1=5 is not an RS-274 word.
            "R" => behind.trim_start_matches(is_number).starts_with('='),
            _ => word.starts_with("L ") || !behind.starts_with(|c: char| c.is_ascii_alphabetic()),
        }
    };
    let mut others =
        (OTHERS.iter()).flat_map(|(why, words)| words.split(',').map(move |word| (word, *why)));
    let begin = others.find(|(word, _)| begins(word));
    let within = || IN_SIEMENS.into_iter().find(|word| text.contains(word));
    let (found, why) = begin.or_else(|| Some((within()?, SIEMENS)))?;
    Some(Column(1).not_followed(found.trim(), why))
}

/// Converts coordinates in least increments to program units. Errors: coordinates both with and without a decimal point, if the meaning on the
/// control is not stated.
pub(crate) fn read_increments(
    block: &mut Block,
    text: &[u8],
    interpreter: &Interpreter,
) -> Result<(), Fault> {
    let DecimalPoints { means_increments, may_mix, last_in_increments } = interpreter.points;
    if !means_increments {
        return Ok(());
    }
    let has = |codes: &[f64]| {
        let mut words = block.words.iter();
        words.any(|word| word.letter == b'G' && word.value.is_some_and(|of| codes.contains(&of)))
    };
    if has(&[4.0]) {
        // The time of a dwell.
        return Ok(());
    }
    let unit_mm = match (has(&[20.0]), has(&[21.0])) {
        (true, _) => 25.4,
        (_, true) => 1.0,
        _ => interpreter.modal.unit_mm,
    };
    // Contradictory codes are rejected when the block is interpreted.
    let codes = Codes::of(block, interpreter.control, 0).ok();
    if codes.as_ref().is_some_and(|codes| codes.with_arguments().is_some()) {
        // The words of an unknown M code have an unknown meaning.
        return Ok(());
    }
    let drills = codes.is_some_and(|codes| {
        let motion = codes.motion.or(interpreter.modal.motion);
        motion.is_some_and(is_cycle)
    });
    let names_axes = (block.words.iter()).any(|word| b"XYZABCUVW".contains(&word.letter));
    let (is_table, is_rotation) = (has(&[10.0]), has(&[68.0]));
    // Under G16 Y is an angle.
    let is_polar = !has(&[15.0]) && (has(&[16.0]) || interpreter.modal.polar.is_some());
    let mut last = last_in_increments;
    for word in &mut block.words {
        let is_coordinate = match word.letter {
            b'X' | b'Y' | b'Z' | b'A' | b'B' | b'C' | b'U' | b'V' | b'W' | b'I' | b'J' => true,
            // In a cycle K is the repeat count.
            b'K' => !drills,
            b'R' => names_axes || is_table,
            _ => false,
        };
        let (Some(value), Some(_), true) = (word.value, word.decimals, is_coordinate) else {
            continue;
        };
        let without_point = !text[word.text.clone()].contains(&b'.');
        if value != 0.0 {
            if !may_mix && last.is_some_and(|last| last != without_point) {
                return Err(Fault::MixedPoints {
                    column: word.at + 1,
                    word: String::from_utf8_lossy(&text[word.at..word.text.end]).into_owned(),
                    without_point,
                });
            }
            last = Some(without_point);
        } else if last != Some(true) {
            // Zero is the same in both forms.
            continue;
        }
        if !without_point {
            continue;
        }
        let is_angle = match word.letter {
            b'A' | b'B' | b'C' => true,
            b'R' => is_rotation,
            b'Y' => is_polar && unit_mm == 1.0,
            _ => false,
        };
        let decimals = INCREMENTS.of(if is_angle { 3 } else { 0 }, unit_mm);
        word.value = Some(value / 10_f64.powi(i32::from(decimals)));
        word.decimals = Some(decimals);
        word.in_increments = true;
    }
    if is_polar
        && unit_mm != 1.0
        && block.words.iter().any(|word| word.letter == b'Y' && word.in_increments)
    {
        return Err(Column(1).not_followed(
            "an angle without a decimal point under G16 in inches",
            "its least increment is unknown: write it with a point",
        ));
    }
    block.last_in_increments = last;
    Ok(())
}

/// M codes of printers that move no axis and do not change the meaning of coordinates: pairs of first and last code.
const HARMLESS_M: [u16; 94] = [
    0, 1, 3, 5, 7, 11, 16, 17, 20, 34, 42, 43, 73, 73, 75, 78, 80, 81, 85, 85, 100, 100, 104, 115,
    117, 123, 126, 129, 140, 141, 143, 143, 145, 145, 149, 150, 154, 155, 163, 166, 190, 193, 200,
    205, 207, 209, 211, 211, 220, 221, 226, 226, 250, 250, 255, 256, 260, 261, 280, 282, 300, 306,
    309, 309, 355, 355, 380, 381, 400, 400, 403, 407, 412, 414, 430, 430, 485, 486, 500, 500, 503,
    504, 569, 569, 572, 572, 575, 575, 592, 593, 900, 900, 906, 919,
];

/// Printer G codes executed as in RS-274.
const WORDS_G: [f64; 21] = [
    0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 17.0, 18.0, 19.0, 20.0, 21.0, 53.0, 54.0, 55.0, 56.0, 57.0, 58.0,
    59.0, 90.0, 91.0, 92.0,
];

/// Filament retraction and recovery without coordinates.
const HARMLESS_G: [f64; 2] = [10.0, 11.0];

/// Codes whose motions are not in the program: homing, probing, parking, cleaning, restoring a position.
const MOVES_G: [f64; 17] = [
    12.0, 26.0, 27.0, 28.0, 29.0, 30.0, 31.0, 32.0, 33.0, 34.0, 35.0, 38.0, 42.0, 60.0, 61.0, 76.0,
    80.0,
];

/// Klipper commands that move no axis and do not change the meaning of coordinates.
const HARMLESS_COMMANDS: &str = "ECHO EXCLUDE_OBJECT EXCLUDE_OBJECT_DEFINE EXCLUDE_OBJECT_END EXCLUDE_OBJECT_RESET EXCLUDE_OBJECT_START \
    GET_POSITION GET_RETRACTION HELP QUERY_ENDSTOPS QUERY_FILAMENT_SENSOR RESPOND SAVE_GCODE_STATE \
    SET_DISPLAY_GROUP SET_DISPLAY_TEXT SET_EXTRUDER_ROTATION_DISTANCE SET_FAN_SPEED SET_FILAMENT_SENSOR \
    SET_GCODE_VARIABLE SET_HEATER_TEMPERATURE SET_IDLE_TIMEOUT SET_INPUT_SHAPER SET_LED SET_LED_TEMPLATE \
    SET_PIN SET_PRESSURE_ADVANCE SET_PRINT_STATS_INFO SET_RETRACTION SET_SERVO SET_STEPPER_ENABLE \
    SET_TEMPERATURE_FAN_TARGET SET_VELOCITY_LIMIT STATUS TEMPERATURE_WAIT TURN_OFF_HEATERS";

/// Reads a line that does not consist of G-code words; returns false for a line of G-code words.
pub(crate) fn read_control_line(
    control: Control,
    block: &mut Block,
    text: &[u8],
) -> Result<bool, Fault> {
    block.clear();
    match control {
        Control::Marlin | Control::Klipper => of_printer(block, text),
        Control::Grbl => of_grbl(block, text),
        _ => Ok(false),
    }
}

fn of_printer(block: &mut Block, text: &[u8]) -> Result<bool, Fault> {
    let mut scanner = Scanner::new(text);
    if scanner.takes(b'N') && scanner.number().is_none() {
        scanner = Scanner::new(text);
    }
    let Some(first) = scanner.peek() else {
        return Ok(false);
    };
    let (at, column) = (scanner.at(), scanner.column());
    let name = name_at(&text[at..]);
    if name.len() > 1 {
        return command(block, &name, column);
    }
    if !matches!(first, b'G' | b'M' | b'T') {
        return Ok(false);
    }
    // A blank ends the number: text may follow (M117).
    let digits = text[at + 1..].iter();
    let digits = digits.take_while(|byte| byte.is_ascii_digit() || **byte == b'.');
    let end = at + 1 + digits.count();
    let found = || String::from_utf8_lossy(&text[at..end]).into_owned();
    let Some((number, ..)) = plain(&text[at + 1..end], b'.') else {
        // A letter alone, as in `Tx` of Prusa.
        block.commands.push(Command::MayMove(found()));
        return Ok(true);
    };
    match first {
        b'G' if WORDS_G.contains(&number) => return Ok(false),
        b'G' if HARMLESS_G.contains(&number) => {}
        b'G' if MOVES_G.contains(&number.trunc()) => {
            if number == 28.0 {
                let words = text[end..].split(|byte| *byte == b';').next();
                let names = |byte: &u8| b"XYZxyz".contains(byte);
                let all = !words.unwrap_or_default().iter().any(names);
                block.commands.push(Command::Homes { all });
            }
            block.commands.push(Command::MayMove(found()));
        }
        b'G' => {
            return Err(
                column.not_followed(&found(), "it is unknown for printers and may move an axis")
            );
        }
        b'M' if number == 82.0 || number == 83.0 => {
            block.commands.push(Command::Extrudes { relative: number == 83.0 });
        }
        b'M' if (HARMLESS_M.chunks(2))
            .any(|ends| f64::from(ends[0]) <= number && number <= f64::from(ends[1])) => {}
        _ => block.commands.push(Command::MayMove(found())),
    }
    Ok(true)
}

/// Reads a Klipper command: a name with named arguments.
fn command(block: &mut Block, name: &str, column: Column) -> Result<bool, Fault> {
    let refused = match name {
        "SET_GCODE_OFFSET" => {
            Some("it shifts the coordinates: state them in the set-up file as [work_offset.G54]")
        }
        "RESTORE_GCODE_STATE" => Some("it restores coordinates that were saved elsewhere"),
        _ => None,
    };
    if let Some(why) = refused {
        return Err(column.not_followed(name, why));
    }
    if !HARMLESS_COMMANDS.split(' ').any(|of| of == name) {
        block.commands.push(Command::MayMove(name.to_owned()));
    }
    Ok(true)
}

/// Command name at the start of a text, in upper case; its first two characters are letters or underscores. Empty if
/// the text begins with no such name.
fn name_at(text: &[u8]) -> String {
    let of_name = |byte: &&u8| byte.is_ascii_alphanumeric() || **byte == b'_';
    let name: String = (text.iter().take_while(of_name))
        .map(|byte| char::from(byte.to_ascii_uppercase()))
        .collect();
    let is_letter = |byte: u8| byte.is_ascii_alphabetic() || byte == b'_';
    match name.as_bytes() {
        [first, second, ..] if is_letter(*first) && is_letter(*second) => name,
        _ => String::new(),
    }
}

/// Reads settings and commands of Grbl: `$H`, `$X`, `$100=80`.
fn of_grbl(block: &mut Block, text: &[u8]) -> Result<bool, Fault> {
    let mut scanner = Scanner::new(text);
    if scanner.peek() != Some(b'$') {
        return Ok(false);
    }
    let column = scanner.column();
    scanner.next();
    let letter = scanner.peek();
    let is_scale = (scanner.number()).is_some_and(|(number, _)| (100.0..110.0).contains(&number));
    match letter {
        Some(b'J') => {
            return Err(column.not_followed("$J", "a jog moves the axes: write G1 or G0"));
        }
        // `$H` homes; `$RST` restores settings.
        Some(letter @ (b'H' | b'R')) => {
            block.commands.push(Command::MayMove(format!("${}", char::from(letter))));
        }
        _ if is_scale => block.commands.push(Command::MayMove("$100 to $109".to_owned())),
        _ => {}
    }
    Ok(true)
}

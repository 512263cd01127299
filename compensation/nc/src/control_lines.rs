//! Lines that a control has besides G-code words: commands of printers, settings of Grbl. They pass on as they are.
//!
//! What Marlin and Klipper make of a line is from their sources: a line is one command, and its arguments are no words of RS-274
//! (`M117 Z is 5`, `G28 X Y`).

use crate::{
    block::Block, command::Command, control::Control, fault::Fault, number::plain, scan::Scanner,
};

/// M codes of printers that neither move an axis nor change what coordinates mean, from the first to the last of each range.
const HARMLESS_M: [[u32; 2]; 47] = [
    [0, 1],
    [3, 5],
    [7, 11],
    [16, 17],
    [20, 34],
    [42, 43],
    [73, 73],
    [75, 78],
    [80, 81],
    [85, 85],
    [100, 100],
    [104, 115],
    [117, 123],
    [126, 129],
    [140, 141],
    [143, 143],
    [145, 145],
    [149, 150],
    [154, 155],
    [163, 166],
    [190, 193],
    [200, 205],
    [207, 209],
    [211, 211],
    [220, 221],
    [226, 226],
    [250, 250],
    [255, 256],
    [260, 261],
    [280, 282],
    [300, 306],
    [309, 309],
    [355, 355],
    [380, 381],
    [400, 400],
    [403, 407],
    [412, 414],
    [430, 430],
    [485, 486],
    [500, 500],
    [503, 504],
    [569, 569],
    [572, 572],
    [575, 575],
    [592, 593],
    [900, 900],
    [906, 919],
];
/// G codes of printers that are executed as those of RS-274 are.
const WORDS_G: [f64; 21] = [
    0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 17.0, 18.0, 19.0, 20.0, 21.0, 53.0, 54.0, 55.0, 56.0, 57.0, 58.0,
    59.0, 90.0, 91.0, 92.0,
];
/// Those that retract the filament without a coordinate.
const HARMLESS_G: [f64; 2] = [10.0, 11.0];
/// Those whose motions are not in the program: homing, probing, parking, cleaning, a saved position.
const MOVES_G: [f64; 17] = [
    12.0, 26.0, 27.0, 28.0, 29.0, 30.0, 31.0, 32.0, 33.0, 34.0, 35.0, 38.0, 42.0, 60.0, 61.0, 76.0,
    80.0,
];
/// Commands of Klipper that neither move an axis nor change what coordinates mean.
const HARMLESS_COMMANDS: [&str; 35] = [
    "ECHO",
    "EXCLUDE_OBJECT",
    "EXCLUDE_OBJECT_DEFINE",
    "EXCLUDE_OBJECT_END",
    "EXCLUDE_OBJECT_RESET",
    "EXCLUDE_OBJECT_START",
    "GET_POSITION",
    "GET_RETRACTION",
    "HELP",
    "QUERY_ENDSTOPS",
    "QUERY_FILAMENT_SENSOR",
    "RESPOND",
    "SAVE_GCODE_STATE",
    "SET_DISPLAY_GROUP",
    "SET_DISPLAY_TEXT",
    "SET_EXTRUDER_ROTATION_DISTANCE",
    "SET_FAN_SPEED",
    "SET_FILAMENT_SENSOR",
    "SET_GCODE_VARIABLE",
    "SET_HEATER_TEMPERATURE",
    "SET_IDLE_TIMEOUT",
    "SET_INPUT_SHAPER",
    "SET_LED",
    "SET_LED_TEMPLATE",
    "SET_PIN",
    "SET_PRESSURE_ADVANCE",
    "SET_PRINT_STATS_INFO",
    "SET_RETRACTION",
    "SET_SERVO",
    "SET_STEPPER_ENABLE",
    "SET_TEMPERATURE_FAN_TARGET",
    "SET_VELOCITY_LIMIT",
    "STATUS",
    "TEMPERATURE_WAIT",
    "TURN_OFF_HEATERS",
];

/// Reads a line that does not consist of G-code words; false if it does.
pub(crate) fn read(control: Control, block: &mut Block, text: &[u8]) -> Result<bool, Fault> {
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
    let Some((number, ..)) = plain(&text[at + 1..end]) else {
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
            return Err(Fault::NotFollowed {
                column,
                found: found(),
                why: "it is not known for printers, and might move an axis",
            });
        }
        b'M' if number == 82.0 || number == 83.0 => {
            block.commands.push(Command::Extrudes {
                relative: number == 83.0,
            });
        }
        b'M' if (HARMLESS_M.iter())
            .any(|[first, last]| (f64::from(*first)..=f64::from(*last)).contains(&number)) => {}
        _ => block.commands.push(Command::MayMove(found())),
    }
    Ok(true)
}

/// A command of Klipper: a name, and arguments with names.
fn command(block: &mut Block, name: &str, column: usize) -> Result<bool, Fault> {
    let refused = match name {
        "SET_GCODE_OFFSET" => {
            Some("it shifts the coordinates: state them in the set-up file as [work_offset.G54]")
        }
        "RESTORE_GCODE_STATE" => Some("it brings back coordinates that were saved elsewhere"),
        _ => None,
    };
    if let Some(why) = refused {
        return Err(Fault::NotFollowed {
            column,
            found: name.to_owned(),
            why,
        });
    }
    if !HARMLESS_COMMANDS.contains(&name) {
        block.commands.push(Command::MayMove(name.to_owned()));
    }
    Ok(true)
}

/// The name of a command in capital letters, where a text begins with one: two letters or underscores at least.
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

/// Settings and commands of Grbl: `$H`, `$X`, `$100=80`.
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
            return Err(Fault::NotFollowed {
                column,
                found: "$J".to_owned(),
                why: "a jog moves the axes: write G1 or G0",
            });
        }
        // Homing; steps for each mm; settings as they were delivered.
        Some(letter @ (b'H' | b'R')) => block
            .commands
            .push(Command::MayMove(format!("${}", char::from(letter)))),
        _ if is_scale => block
            .commands
            .push(Command::MayMove("$100 to $109".to_owned())),
        _ => {}
    }
    Ok(true)
}

use super::{Options, World};
use crate::{
    answers::function,
    frame::{Command, Kind, Target, number_bytes, parse_commands, push_block},
    parameters::{SHIFT_FIRST, SHIFT_IN_USE, UNIT_NUMBERS},
    pmc::PmcArea,
};

const LENGTH: i16 = 2;
const NUMBER: i16 = 3;
const PROTECTED: i16 = 7;
const NO_FUNCTION: i16 = 1;

/// Builds the payload of the response to a request to open a session.
pub(super) fn opened(options: &Options) -> Vec<u8> {
    let (length, count_at) =
        if options.version < 3 { (16 + 8 * 10, 8) } else { (40 + 32 * 10, 10) };
    let mut payload = vec![0; length];
    payload[count_at + 1] = 10;
    payload
}

pub(super) fn answer(payload: &[u8], options: &Options, world: &mut World) -> (Kind, Vec<u8>) {
    let negative =
        |code: i16| (Kind::Negative, [&[0; 2], &code.to_be_bytes()[..], &[0, 1, 0, 0]].concat());
    let Ok(commands) = parse_commands(payload) else {
        return negative(-17);
    };
    let mixed = commands.windows(2).any(|pair| pair[0].target != pair[1].target);
    let packed = commands.len() > 1;
    if (options.refuses_mix && mixed) || (options.one_command && packed) {
        return negative(-17);
    }
    let mut answer = Vec::new();
    answer.extend(u16::try_from(commands.len()).unwrap_or(0).to_be_bytes());
    for command in &commands {
        let (error, data) = match answer_one(command, options, world) {
            Ok(data) => (0, data),
            Err(Refusal::Command(error)) => (error, Vec::new()),
            Err(Refusal::Frame) => return negative(-17),
        };
        if push_block(&mut answer, command, error, &data).is_err() {
            return negative(-17);
        }
    }
    (Kind::Answer, answer)
}

enum Refusal {
    /// Rejects only the command, with this return code.
    Command(i16),
    /// Rejects the whole frame, as for a parameter number that does not exist.
    Frame,
}

type CommandResult = Result<Vec<u8>, Refusal>;

fn answer_one(command: &Command<'_>, options: &Options, world: &mut World) -> CommandResult {
    match (command.target, command.function) {
        (Target::Cnc, function::SYSTEM) => Ok(system(options, world)),
        (Target::Cnc, function::STATUS) => Ok(status(world)),
        (Target::Cnc, function::AXIS_NAMES) => Ok(axis_names(options, world)),
        (Target::Cnc, function::POSITIONS) => positions(command, options, world),
        (Target::Cnc, function::ALARMS) => Ok(alarms(world)),
        (Target::Cnc, function::READ_MACRO) => Ok(read_macro(command, world)),
        (Target::Cnc, READ_MACRO_NUMBERS) => read_macro_numbers(command, world),
        (Target::Cnc, function::WRITE_MACRO) => write_macro(command, world),
        (Target::Cnc, function::READ_OFFSET) => {
            let number = command.args[0];
            let of = |slot| world.offsets.get(&(number, slot)).copied().unwrap_or(0.0);
            Ok(slots((0..world.axes.len()).map(of), options))
        }
        (Target::Cnc, function::WRITE_OFFSET) => write_offset(command, world),
        (Target::Cnc, function::READ_PARAMETER) => parameter(command, options, world),
        (Target::Pmc, function::READ_PMC) => read_pmc(command, options, world),
        (Target::Pmc, function::WRITE_PMC) => write_pmc(command, options, world),
        _ => Err(Refusal::Command(NO_FUNCTION)),
    }
}

const READ_MACRO_NUMBERS: u16 = 0x15;

fn system(options: &Options, world: &World) -> Vec<u8> {
    let slots = u16::try_from(options.slots).unwrap_or(u16::MAX);
    let kind: &[u8; 4] = match options.version {
        2 => b"16 M",
        3 => b" 0 M",
        _ => b"31 M",
    };
    let mut data = vec![0x06, 0x62];
    data.extend(slots.to_be_bytes());
    data.extend(kind);
    data.extend(b"D4G328.0");
    data.extend(format!("{:02}", world.axes.len().min(99)).bytes());
    data
}

fn status(world: &World) -> Vec<u8> {
    let emergency = u16::from(world.emergency_stop());
    let alarm = u16::from(!world.alarms.is_empty());
    let words = [1, 3, 1, 0, emergency, alarm, 0];
    words.into_iter().flat_map(u16::to_be_bytes).collect()
}

fn axis_names(options: &Options, world: &World) -> Vec<u8> {
    let name = |letter: &char| [u8::try_from(*letter).unwrap_or(b'?'), 0, 0, 0];
    let mut data: Vec<u8> = world.axes.iter().flat_map(name).collect();
    data.resize(4 * options.slots.max(world.axes.len()), 0);
    data
}

/// Encodes numbers with three decimals in slots, and fills the unused slots with garbage or 0.
fn slots(values: impl Iterator<Item = f64>, options: &Options) -> Vec<u8> {
    let mut data: Vec<u8> = values.flat_map(|value| number_bytes(value, 3)).collect();
    let mut garbage = 0x5eed_u32;
    while data.len() < 8 * options.slots {
        garbage = garbage.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
        let [a, ..] = garbage.to_be_bytes();
        data.push(if options.garbage { a } else { 0 });
    }
    data
}

fn positions(command: &Command<'_>, options: &Options, world: &mut World) -> CommandResult {
    let positions = world.positions();
    match command.args {
        [1 | 4 | 0, -1, ..] if options.one_axis => Err(Refusal::Command(NUMBER)),
        [1 | 4 | 0, -1, ..] => Ok(slots(positions.into_iter(), options)),
        [1 | 4 | 0, axis, ..] => {
            let index = usize::try_from(axis - 1).map_err(|_| Refusal::Command(NUMBER))?;
            let position = positions.get(index).ok_or(Refusal::Command(NUMBER))?;
            Ok(number_bytes(*position, 3).to_vec())
        }
        _ => Err(Refusal::Command(NO_FUNCTION)),
    }
}

fn alarms(world: &World) -> Vec<u8> {
    let record = |(number, text): &(i32, String)| {
        let mut record = Vec::new();
        let length = i32::try_from(text.len().min(64)).unwrap_or(0);
        for word in [*number, 6, 0, length] {
            record.extend(word.to_be_bytes());
        }
        record.extend(text.bytes().take(64));
        record.resize(80, 0);
        record
    };
    world.alarms.iter().flat_map(record).collect()
}

fn read_macro(command: &Command<'_>, world: &World) -> Vec<u8> {
    let [first, count, ..] = command.args;
    let value = |number| world.macros.get(&number).copied().unwrap_or(f64::NAN);
    let numbers = first..first.saturating_add(count.clamp(0, 100));
    numbers.flat_map(|n| value(n).to_be_bytes()).collect()
}

fn read_macro_numbers(command: &Command<'_>, world: &World) -> CommandResult {
    let [first, last, ..] = command.args;
    let value = |number| match world.macros.get(&number) {
        Some(value) => number_bytes(*value, 6),
        None => [0, 0, 0, 0, 0, 10, 0xff, 0xff],
    };
    if !(first..first.saturating_add(100)).contains(&last) {
        return Err(Refusal::Command(NUMBER));
    }
    Ok((first..=last).flat_map(value).collect())
}

fn write_macro(command: &Command<'_>, world: &mut World) -> CommandResult {
    let bytes = command.data.first_chunk().ok_or(Refusal::Command(LENGTH))?;
    world.macros.insert(command.args[0], f64::from_be_bytes(*bytes));
    Ok(Vec::new())
}

fn write_offset(command: &Command<'_>, world: &mut World) -> CommandResult {
    let [number, _, axis, ..] = command.args;
    let slot = usize::try_from(axis - 1).map_err(|_| Refusal::Command(NUMBER))?;
    let mantissa = command.data.first_chunk().ok_or(Refusal::Command(LENGTH))?;
    if slot >= world.axes.len() {
        return Err(Refusal::Command(NUMBER));
    }
    let value = f64::from(i32::from_be_bytes(*mantissa)) / 1000.0;
    world.offsets.insert((number, slot), value);
    Ok(Vec::new())
}

fn parameter(command: &Command<'_>, options: &Options, world: &World) -> CommandResult {
    let number = command.args[0];
    let of = |slot| world.parameters.get(&(number, slot)).copied();
    let is_set = world.parameters.keys().any(|(known, _)| *known == number);
    let default = if is_set { Some(0.0) } else { known_parameter(number, world) };
    // In captures, an unknown number makes the control reject the whole frame.
    let default = default.ok_or(Refusal::Frame)?;
    let mut data = number.to_be_bytes().to_vec();
    data.extend([0, 0, 0, 2]);
    let values = (0..world.axes.len()).map(|slot| of(slot).unwrap_or(default));
    data.extend(slots(values, options));
    Ok(data)
}

/// Value of a parameter that determines the unit of positions or the source of the shifts; `None` for other parameters.
fn known_parameter(number: i32, world: &World) -> Option<f64> {
    if UNIT_NUMBERS.contains(&number) {
        // The control is metric and reports positions in mm.
        return Some(0.0);
    }
    if !world.reports_shift_source {
        return None;
    }
    let in_r = world.shift.area == PmcArea::R;
    match number {
        SHIFT_IN_USE => Some(if in_r { 1.0 } else { 0.0 }),
        SHIFT_FIRST => {
            let first = if in_r { world.shift.first } else { 0 };
            u32::try_from(first).ok().map(f64::from)
        }
        _ => None,
    }
}

/// Parses the arguments of a PMC command: area, first byte, bytes per point, total number of bytes.
fn pmc_range(
    command: &Command<'_>,
    options: &Options,
) -> Result<(PmcArea, usize, usize, usize), Refusal> {
    let [first, last, area, width, _] = command.args;
    let area = usize::try_from(area).ok().and_then(|area| PmcArea::ALL.get(area));
    let area = *area.ok_or(Refusal::Command(NUMBER))?;
    let width = match width {
        0 => 1,
        1 => 2,
        2 => 4,
        _ => return Err(Refusal::Command(NUMBER)),
    };
    let at = usize::try_from(first).map_err(|_| Refusal::Command(NUMBER))?;
    let bytes = usize::try_from(last - first + 1).map_err(|_| Refusal::Command(NUMBER))?;
    if bytes == 0 || bytes % width != 0 || bytes > 2048 {
        return Err(Refusal::Command(LENGTH));
    }
    if options.one_point && bytes > width {
        return Err(Refusal::Command(NUMBER));
    }
    Ok((area, at, width, bytes))
}

/// Swaps the byte order of each point, because memory is little-endian and the protocol is big-endian.
fn swap_points(bytes: &[u8], width: usize) -> Vec<u8> {
    let points = bytes.chunks(width);
    points.flat_map(|point| point.iter().rev().copied()).collect()
}

fn read_pmc(command: &Command<'_>, options: &Options, world: &mut World) -> CommandResult {
    let (area, at, width, bytes) = pmc_range(command, options)?;
    let memory = world.read(area, at, bytes);
    memory.map(|bytes| swap_points(&bytes, width)).ok_or(Refusal::Command(NUMBER))
}

fn write_pmc(command: &Command<'_>, options: &Options, world: &mut World) -> CommandResult {
    let (area, at, width, bytes) = pmc_range(command, options)?;
    if command.data.len() != bytes {
        return Err(Refusal::Command(LENGTH));
    }
    if options.write_protected {
        return Err(Refusal::Command(PROTECTED));
    }
    // The manufacturer's simulated control rejects writes to the machine's outputs.
    if area == PmcArea::Y || !world.write(area, at, &swap_points(command.data, width)) {
        return Err(Refusal::Command(NUMBER));
    }
    Ok(Vec::new())
}

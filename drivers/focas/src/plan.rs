//! Packs the reads and writes of a cycle into frames, in the form that the control accepts.

use volcomp_vocabulary::AxisKind;

use crate::{
    answers::function,
    config::FocasConfig,
    frame::{Command, FrameError, Request, Target},
    pmc::{BarrierArea, PmcAddress, Width},
};

/// How the commands of a read or write are distributed over frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    /// All commands in one frame.
    OneFrame,
    /// Commands for the control and commands for the PMC in separate frames.
    ByTarget,
    /// Every command in a separate frame.
    OneByOne,
}

/// Request forms that a control accepts in a cycle. They are determined at every connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Abilities {
    pub packing: Packing,
    /// Whether a command may address a range of PMC memory. If `false`, it may address only one point.
    pub ranges: bool,
    /// Whether one command can read the positions of all axes. If `false`, it can read only one.
    pub all_axes: bool,
}

impl Abilities {
    /// Abilities of most controls. With them, a cycle takes the fewest exchanges.
    pub(crate) const ALL: Self = Self { packing: Packing::OneFrame, ranges: true, all_axes: true };
}

/// A corrected or read-only axis, with its index in the control. Corrected axes come first in every list.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlannedAxis {
    pub(crate) slot: usize,
    pub(crate) kind: AxisKind,
    /// Displacement by one count, mm or rad.
    pub(crate) count: f64,
}

/// Consecutive words that are read or written together: the shifts of adjacent axes, or words of a frame or report.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Run {
    pub(crate) first: usize,
    pub(crate) count: usize,
}

impl Run {
    /// Byte range of a slot's shift within the run; `None` if the run does not contain the slot.
    pub(crate) fn bytes_of(self, slot: usize, width: Width) -> Option<std::ops::Range<usize>> {
        let index = slot.checked_sub(self.first).filter(|i| *i < self.count)?;
        let bytes = usize::from(width.bytes());
        Some(index * bytes..(index + 1) * bytes)
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) enum ReadItem {
    Positions,
    /// Position of the axis in this slot.
    PositionOf(usize),
    Status,
    Shifts(Run),
    Heartbeat(PmcAddress),
    Referenced(PmcAddress),
    Report(Run),
}

#[derive(Clone, Copy, Debug)]
pub(crate) enum WriteItem {
    Shifts(Run),
    Heartbeat(PmcAddress),
    Sequence(PmcAddress),
    Frame(Run),
}

#[derive(Debug)]
pub(crate) struct Exchange<T> {
    pub(crate) request: Request,
    pub(crate) parts: Vec<T>,
}

impl ReadItem {
    pub(crate) fn is_position(self) -> bool {
        matches!(self, Self::Positions | Self::PositionOf(_))
    }

    fn target(self) -> Target {
        match self {
            Self::Positions | Self::PositionOf(_) | Self::Status => Target::Cnc,
            Self::Shifts(_) | Self::Heartbeat(_) | Self::Referenced(_) | Self::Report(_) => {
                Target::Pmc
            }
        }
    }

    pub(crate) fn words(self, config: &FocasConfig) -> String {
        match self {
            Self::Positions => "reading the positions of all axes".to_owned(),
            Self::PositionOf(slot) => format!("reading the position of axis {}", slot + 1),
            Self::Status => "reading the status".to_owned(),
            Self::Shifts(run) => {
                let [first, last, ..] = shift_args(config, run, 0);
                let area = config.shift.first.area;
                format!("reading the shifts at {area:?}{first} to {area:?}{last}")
            }
            Self::Report(run) => {
                let area = report_area(config).area;
                let [first, last, ..] = word_args(report_area(config), run, 0);
                format!("reading the report of the barrier at {area:?}{first} to {area:?}{last}")
            }
            Self::Heartbeat(address) => format!("reading the heartbeat at {address}"),
            Self::Referenced(address) => {
                format!("reading at {address} which axes are referenced")
            }
        }
    }

    fn command(self, config: &FocasConfig) -> Command<'static> {
        let (function, args) = match self {
            Self::Positions => (function::POSITIONS, [config.positions.code(), -1, 0, 0, 0]),
            Self::PositionOf(slot) => {
                let axis = i32::try_from(slot + 1).unwrap_or(i32::MAX);
                (function::POSITIONS, [config.positions.code(), axis, 0, 0, 0])
            }
            Self::Status => (function::STATUS, [0; 5]),
            Self::Shifts(run) => (function::READ_PMC, shift_args(config, run, 0)),
            Self::Report(run) => (function::READ_PMC, word_args(report_area(config), run, 0)),
            Self::Heartbeat(address) | Self::Referenced(address) => {
                (function::READ_PMC, byte_args(address, 0))
            }
        };
        Command { target: self.target(), path: config.path, function, args, data: &[] }
    }
}

/// Runs of shift words for the corrected axes. Adjacent slots share a run if the control accepts `ranges`.
pub(crate) fn runs(config: &FocasConfig, axes: &[PlannedAxis], ranges: bool) -> Vec<Run> {
    let corrected = axes.iter().take(config.axes.len());
    let mut slots: Vec<usize> = corrected.map(|axis| axis.slot).collect();
    slots.sort_unstable();
    let mut runs: Vec<Run> = Vec::new();
    for slot in slots {
        match runs.last_mut() {
            Some(run) if ranges && run.first + run.count == slot => run.count += 1,
            _ => runs.push(Run { first: slot, count: 1 }),
        }
    }
    runs
}

/// Commands that read the positions of the axes: one command for all axes if the control accepts it (`all_axes`),
/// otherwise one for each axis.
pub(crate) fn positions(axes: &[PlannedAxis], all_axes: bool) -> Vec<ReadItem> {
    if all_axes {
        vec![ReadItem::Positions]
    } else {
        let each = axes.iter().map(|axis| ReadItem::PositionOf(axis.slot));
        each.collect()
    }
}

/// Reads of the words that contain the applied correction: the shifts, or the report of the barrier. Adjacent words
/// share a read if the control accepts `ranges`.
pub(crate) fn words(config: &FocasConfig, axes: &[PlannedAxis], ranges: bool) -> Vec<ReadItem> {
    if config.barrier.is_none() {
        let runs = runs(config, axes, ranges).into_iter();
        return runs.map(ReadItem::Shifts).collect();
    }
    let words = in_runs(BarrierArea::report_words(config.axes.len()), ranges);
    words.into_iter().map(ReadItem::Report).collect()
}

/// Runs that cover the first `words` words: a single run if the control accepts `ranges`, otherwise one run for each
/// word.
fn in_runs(words: usize, ranges: bool) -> Vec<Run> {
    let run = |first, count| Run { first, count };
    if ranges { vec![run(0, words)] } else { (0..words).map(|word| run(word, 1)).collect() }
}

pub(crate) fn bytes(config: &FocasConfig) -> Vec<ReadItem> {
    // The heartbeat is read only if this driver writes it.
    let writes = config.barrier.is_none() && !config.axes.is_empty();
    let heartbeat = config.heartbeat.filter(|_| writes).map(ReadItem::Heartbeat);
    let referenced = config.referenced.map(ReadItem::Referenced);
    heartbeat.into_iter().chain(referenced).collect()
}

/// Frames of the read in a cycle. Positions come first, so that their time is the most certain.
pub(crate) fn reads(
    config: &FocasConfig,
    axes: &[PlannedAxis],
    abilities: Abilities,
) -> Result<Vec<Exchange<ReadItem>>, FrameError> {
    let mut items = positions(axes, abilities.all_axes);
    items.push(ReadItem::Status);
    let of_control = items.len();
    items.extend(words(config, axes, abilities.ranges));
    items.extend(bytes(config));
    let frames: Vec<&[ReadItem]> = match abilities.packing {
        Packing::OneFrame => vec![&items[..]],
        Packing::ByTarget => vec![&items[..of_control], &items[of_control..]],
        Packing::OneByOne => items.chunks(1).collect(),
    };
    frames.into_iter().map(|items| read(config, items)).collect()
}

pub(crate) fn read(
    config: &FocasConfig,
    items: &[ReadItem],
) -> Result<Exchange<ReadItem>, FrameError> {
    let commands: Vec<Command<'_>> = items.iter().map(|item| item.command(config)).collect();
    Ok(Exchange { request: Request::new(&commands)?, parts: items.to_vec() })
}

/// Frames of the write in a cycle: shifts, heartbeat, sequence byte; or, with a barrier, its frame, which ends with the
/// checksum.
pub(crate) fn writes(
    config: &FocasConfig,
    axes: &[PlannedAxis],
    abilities: Abilities,
) -> Result<Vec<Exchange<WriteItem>>, FrameError> {
    let mut parts: Vec<WriteItem> = Vec::new();
    if config.barrier.is_some() {
        let words = in_runs(BarrierArea::frame_words(config.axes.len()), abilities.ranges);
        parts.extend(words.into_iter().map(WriteItem::Frame));
    } else if !config.axes.is_empty() {
        let runs = runs(config, axes, abilities.ranges).into_iter();
        parts.extend(runs.map(WriteItem::Shifts));
        parts.extend(config.heartbeat.map(WriteItem::Heartbeat));
        parts.extend(config.sequence.map(WriteItem::Sequence));
    }
    let together = match abilities.packing {
        Packing::OneFrame | Packing::ByTarget => parts.len(),
        Packing::OneByOne => 1,
    };
    parts.chunks(together.max(1)).map(|parts| write(config, parts)).collect()
}

fn write(config: &FocasConfig, parts: &[WriteItem]) -> Result<Exchange<WriteItem>, FrameError> {
    // Placeholder data, which every cycle overwrites: four bytes for each axis. No control has more than 32 axes.
    let room = [0_u8; 4 * 32];
    let mut commands = Vec::new();
    for part in parts {
        let (args, length) = match *part {
            WriteItem::Shifts(run) => {
                let length = run.count * usize::from(config.shift.width.bytes());
                (shift_args(config, run, length), length)
            }
            WriteItem::Frame(run) => {
                let length = run.count * usize::from(Width::Word.bytes());
                (word_args(frame_area(config), run, length), length)
            }
            WriteItem::Heartbeat(address) | WriteItem::Sequence(address) => {
                (byte_args(address, 1), 1)
            }
        };
        commands.push(Command {
            target: Target::Pmc,
            path: config.path,
            function: function::WRITE_PMC,
            args,
            data: room.get(..length).ok_or(FrameError("more than 32 axes"))?,
        });
    }
    Ok(Exchange { request: Request::new(&commands)?, parts: parts.to_vec() })
}

fn shift_args(config: &FocasConfig, run: Run, written: usize) -> [i32; 5] {
    run_args(config.shift.first, config.shift.width, run, written)
}

fn word_args(first: PmcAddress, run: Run, written: usize) -> [i32; 5] {
    run_args(first, Width::Word, run, written)
}

/// Arguments of a PMC command: first byte, last byte, area, width, length of the written data.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_possible_wrap,
    reason = "words and their bytes are counted in tens"
)]
fn run_args(from: PmcAddress, width: Width, run: Run, written: usize) -> [i32; 5] {
    let bytes = i32::from(width.bytes());
    let first = i32::from(from.at) + run.first as i32 * bytes;
    let last = first + run.count as i32 * bytes - 1;
    [first, last, from.area as i32, width.code(), written as i32]
}

/// First byte of the report. Without a barrier no report is requested, and the first byte of the shift words is
/// returned as a placeholder.
fn report_area(config: &FocasConfig) -> PmcAddress {
    config.barrier.map_or(config.shift.first, |barrier| barrier.report)
}

fn frame_area(config: &FocasConfig) -> PmcAddress {
    config.barrier.map_or(config.shift.first, |barrier| barrier.frame)
}

fn byte_args(address: PmcAddress, written: i32) -> [i32; 5] {
    let at = i32::from(address.at);
    [at, at, address.area as i32, Width::Byte.code(), written]
}

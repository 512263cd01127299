//! The exchanges of a cycle: what is asked and what is written, packed into frames as the control accepts them.

use volcomp_vocabulary::AxisKind;

use crate::{
    answers::function,
    config::FocasConfig,
    frame::{Broken, Command, Request, Target},
    pmc::{BarrierArea, PmcAddress, Width},
};

/// How commands are packed into frames.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Packing {
    /// All commands of a read in one frame.
    OneFrame,
    /// Commands for the control and commands for the PMC in frames of their own.
    ByTarget,
    /// Every command in a frame of its own.
    OneByOne,
}

/// In which form a control accepts the requests of a cycle. Found out at every connection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Abilities {
    /// How commands may be packed into frames.
    pub packing: Packing,
    /// Whether a command may name a range of PMC memory, not only one point.
    pub ranges: bool,
    /// Whether the positions of all axes can be asked for at once, not only axis by axis.
    pub all_axes: bool,
}

impl Abilities {
    /// The abilities that most controls have and that need the fewest exchanges.
    pub(crate) const ALL: Self = Self {
        packing: Packing::OneFrame,
        ranges: true,
        all_axes: true,
    };
}

/// An axis that is corrected or only read, as the control has it. In every list those that are corrected come first.
#[derive(Clone, Copy, Debug)]
pub(crate) struct PlannedAxis {
    /// The place among the control's axes, from 0.
    pub(crate) slot: usize,
    pub(crate) kind: AxisKind,
    /// How far one count moves it, mm or rad.
    pub(crate) count: f64,
}

/// Neighbouring words that are asked for and written together: the shifts of slots, or words of a frame or a report.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Run {
    pub(crate) first: usize,
    pub(crate) count: usize,
}

impl Run {
    /// Where the shift of a slot stands in the bytes of the run; `None` outside it.
    pub(crate) fn bytes_of(self, slot: usize, width: Width) -> Option<std::ops::Range<usize>> {
        let index = slot.checked_sub(self.first).filter(|i| *i < self.count)?;
        let bytes = usize::from(width.bytes());
        Some(index * bytes..(index + 1) * bytes)
    }
}

/// The value that a command of a read asks for.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Ask {
    /// The positions of all axes.
    Positions,
    /// The position of the axis in this slot.
    PositionOf(usize),
    Status,
    Shifts(Run),
    Heartbeat(PmcAddress),
    Referenced(PmcAddress),
    /// Words of the barrier's report.
    Report(Run),
}

/// The content of a command of a write.
#[derive(Clone, Copy, Debug)]
pub(crate) enum Part {
    Shifts(Run),
    Heartbeat(PmcAddress),
    Sequence(PmcAddress),
    /// Words of the frame for the barrier.
    Frame(Run),
}

/// A frame of a cycle, and what its commands are for, in their order.
#[derive(Debug)]
pub(crate) struct Exchange<T> {
    pub(crate) request: Request,
    pub(crate) parts: Vec<T>,
}

impl Ask {
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

    /// The question in words, for messages.
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
                (
                    function::POSITIONS,
                    [config.positions.code(), axis, 0, 0, 0],
                )
            }
            Self::Status => (function::STATUS, [0; 5]),
            Self::Shifts(run) => (function::READ_PMC, shift_args(config, run, 0)),
            Self::Report(run) => (function::READ_PMC, word_args(report_area(config), run, 0)),
            Self::Heartbeat(address) | Self::Referenced(address) => {
                (function::READ_PMC, byte_args(address, 0))
            }
        };
        Command {
            target: self.target(),
            path: config.path,
            function,
            args,
            data: &[],
        }
    }
}

/// The slots of the axes that are corrected in runs: neighbours together where ranges are accepted.
pub(crate) fn runs(config: &FocasConfig, axes: &[PlannedAxis], ranges: bool) -> Vec<Run> {
    let corrected = axes.iter().take(config.axes.len());
    let mut slots: Vec<usize> = corrected.map(|axis| axis.slot).collect();
    slots.sort_unstable();
    let mut runs: Vec<Run> = Vec::new();
    for slot in slots {
        match runs.last_mut() {
            Some(run) if ranges && run.first + run.count == slot => run.count += 1,
            _ => runs.push(Run {
                first: slot,
                count: 1,
            }),
        }
    }
    runs
}

/// The commands that read the positions of the axes: one for all axes, or one for each.
pub(crate) fn positions(axes: &[PlannedAxis], all_axes: bool) -> Vec<Ask> {
    if all_axes {
        vec![Ask::Positions]
    } else {
        let each = axes.iter().map(|axis| Ask::PositionOf(axis.slot));
        each.collect()
    }
}

/// The words with what is applied: the shifts, or the report of the barrier, together where ranges are accepted.
pub(crate) fn words(config: &FocasConfig, axes: &[PlannedAxis], ranges: bool) -> Vec<Ask> {
    if config.barrier.is_none() {
        let runs = runs(config, axes, ranges).into_iter();
        return runs.map(Ask::Shifts).collect();
    }
    let words = in_runs(BarrierArea::report_words(config.axes.len()), ranges);
    words.into_iter().map(Ask::Report).collect()
}

/// So many words from the first on: in one run where ranges are accepted.
fn in_runs(words: usize, ranges: bool) -> Vec<Run> {
    let run = |first, count| Run { first, count };
    if ranges {
        vec![run(0, words)]
    } else {
        (0..words).map(|word| run(word, 1)).collect()
    }
}

/// The bytes of PMC memory that are read besides.
pub(crate) fn bytes(config: &FocasConfig) -> Vec<Ask> {
    // Who only reads does not mind who writes.
    let writes = config.barrier.is_none() && !config.axes.is_empty();
    let heartbeat = config.heartbeat.filter(|_| writes).map(Ask::Heartbeat);
    let referenced = config.referenced.map(Ask::Referenced);
    heartbeat.into_iter().chain(referenced).collect()
}

/// The frames of a read. Positions are asked for first, so that their time is known best.
pub(crate) fn reads(
    config: &FocasConfig,
    axes: &[PlannedAxis],
    abilities: Abilities,
) -> Result<Vec<Exchange<Ask>>, Broken> {
    let mut asks = positions(axes, abilities.all_axes);
    asks.push(Ask::Status);
    let of_control = asks.len();
    asks.extend(words(config, axes, abilities.ranges));
    asks.extend(bytes(config));
    let frames: Vec<&[Ask]> = match abilities.packing {
        Packing::OneFrame => vec![&asks[..]],
        Packing::ByTarget => vec![&asks[..of_control], &asks[of_control..]],
        Packing::OneByOne => asks.chunks(1).collect(),
    };
    frames.into_iter().map(|asks| read(config, asks)).collect()
}

/// One frame that asks for these things.
pub(crate) fn read(config: &FocasConfig, asks: &[Ask]) -> Result<Exchange<Ask>, Broken> {
    let commands: Vec<Command<'_>> = asks.iter().map(|ask| ask.command(config)).collect();
    Ok(Exchange {
        request: Request::new(&commands)?,
        parts: asks.to_vec(),
    })
}

/// The frames of a write: shifts, then the heartbeat, then the sequence; or the frame for the barrier, whose checksum
/// is last.
pub(crate) fn writes(
    config: &FocasConfig,
    axes: &[PlannedAxis],
    abilities: Abilities,
) -> Result<Vec<Exchange<Part>>, Broken> {
    let mut parts: Vec<Part> = Vec::new();
    if config.barrier.is_some() {
        let words = in_runs(
            BarrierArea::frame_words(config.axes.len()),
            abilities.ranges,
        );
        parts.extend(words.into_iter().map(Part::Frame));
    } else if !config.axes.is_empty() {
        let runs = runs(config, axes, abilities.ranges).into_iter();
        parts.extend(runs.map(Part::Shifts));
        parts.extend(config.heartbeat.map(Part::Heartbeat));
        parts.extend(config.sequence.map(Part::Sequence));
    }
    let together = match abilities.packing {
        Packing::OneFrame | Packing::ByTarget => parts.len(),
        Packing::OneByOne => 1,
    };
    parts
        .chunks(together.max(1))
        .map(|parts| write(config, parts))
        .collect()
}

fn write(config: &FocasConfig, parts: &[Part]) -> Result<Exchange<Part>, Broken> {
    // Replaced in every cycle; no control has more than 32 axes.
    let room = [0_u8; 4 * 32];
    let mut commands = Vec::new();
    for part in parts {
        let (args, length) = match *part {
            Part::Shifts(run) => {
                let length = run.count * usize::from(config.shift.width.bytes());
                (shift_args(config, run, length), length)
            }
            Part::Frame(run) => {
                let length = run.count * usize::from(Width::Word.bytes());
                (word_args(frame_area(config), run, length), length)
            }
            Part::Heartbeat(address) | Part::Sequence(address) => (byte_args(address, 1), 1),
        };
        commands.push(Command {
            target: Target::Pmc,
            path: config.path,
            function: function::WRITE_PMC,
            args,
            data: room.get(..length).ok_or(Broken("more than 32 axes"))?,
        });
    }
    Ok(Exchange {
        request: Request::new(&commands)?,
        parts: parts.to_vec(),
    })
}

fn shift_args(config: &FocasConfig, run: Run, written: usize) -> [i32; 5] {
    run_args(config.shift.first, config.shift.width, run, written)
}

fn word_args(first: PmcAddress, run: Run, written: usize) -> [i32; 5] {
    run_args(first, Width::Word, run, written)
}

/// First and last byte, area, width, and the length of what is written.
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

/// Where the report lies; the words of the shifts where there is no barrier, which nobody asks for then.
fn report_area(config: &FocasConfig) -> PmcAddress {
    config
        .barrier
        .map_or(config.shift.first, |barrier| barrier.report)
}

fn frame_area(config: &FocasConfig) -> PmcAddress {
    config
        .barrier
        .map_or(config.shift.first, |barrier| barrier.frame)
}

fn byte_args(address: PmcAddress, written: i32) -> [i32; 5] {
    let at = i32::from(address.at);
    [at, at, address.area as i32, Width::Byte.code(), written]
}

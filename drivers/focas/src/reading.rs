//! Executes the read of a cycle: sends its requests and decodes the responses. This module does not allocate.

use std::time::{Duration, Instant};

use volcomp_port::{ControllerState, Fault, MOST_WORDS, Snapshot, Words};
use volcomp_vocabulary::{Displacement, PerChannel};

use crate::{
    answers::{slot, status},
    config::FocasConfig,
    frame::{Block, FrameError},
    plan::{Exchange, PlannedAxis, ReadItem, Run},
    pmc::{BarrierArea, Width, count},
    return_code::ReturnCode,
    session::Session,
};

pub(crate) struct Reading {
    pub(crate) snapshot: Snapshot,
    /// Value of the heartbeat at the control; `None` if the heartbeat is not read.
    pub(crate) heartbeat: Option<u8>,
}

#[derive(Clone, Copy, Debug)]
pub(crate) enum Applied {
    /// The shifts of the axes, as words of this width.
    Shifts(Width),
    /// The report of a barrier, with this number of words.
    Report(usize),
}

impl Applied {
    pub(crate) fn of(config: &FocasConfig) -> Self {
        match config.barrier {
            None => Self::Shifts(config.shift.width),
            Some(_) => Self::Report(BarrierArea::report_words(config.axes.len())),
        }
    }
}

/// Sends the frames of a read one after the other. All of them share the deadline.
pub(crate) fn read(
    session: &mut Session,
    exchanges: &[Exchange<ReadItem>],
    axes: &[PlannedAxis],
    applied: Applied,
    deadline: Instant,
) -> Result<Reading, Fault> {
    let begun = Instant::now();
    let (width, report) = match applied {
        Applied::Shifts(width) => (width, None),
        Applied::Report(words) => {
            let empty = [0; MOST_WORDS];
            (Width::Word, Words::new(empty.get(..words).unwrap_or(&empty)))
        }
    };
    let mut reading = Reading {
        snapshot: Snapshot {
            positions: PerChannel::ZERO,
            taken: begun,
            state_taken: begun,
            correction_taken: begun,
            uncertainty: Duration::ZERO,
            state: ControllerState { referenced: true, ..ControllerState::default() },
            applied: report.is_none().then_some(PerChannel::ZERO),
            report,
        },
        heartbeat: None,
    };
    // The time of the positions is the middle between the first request and the last response with positions.
    let mut positions_since = None;
    for exchange in exchanges {
        let sent = Instant::now();
        let blocks = session.exchange(&exchange.request, deadline)?;
        let answered = Instant::now();
        for (block, item) in blocks.zip(&exchange.parts) {
            take(&mut reading, *item, data(block)?, axes, width)?;
        }
        if exchange.parts.iter().any(|item| item.is_position()) {
            let since = *positions_since.get_or_insert(sent);
            let half = answered.duration_since(since) / 2;
            reading.snapshot = reading.snapshot.at(since + half);
            reading.snapshot.uncertainty = half;
        }
    }
    Ok(reading)
}

/// Data of a block. Fails if the control rejected the command.
pub(crate) fn data(block: Result<Block<'_>, FrameError>) -> Result<&[u8], Fault> {
    let block = block?;
    match block.error {
        0 => Ok(block.data),
        code => Err(ReturnCode(code).into()),
    }
}

fn take(
    reading: &mut Reading,
    item: ReadItem,
    data: &[u8],
    axes: &[PlannedAxis],
    width: Width,
) -> Result<(), FrameError> {
    let snapshot = &mut reading.snapshot;
    let coordinate = |axis: &PlannedAxis, place: usize| {
        let value = slot(data, place)?;
        Ok(Displacement::from_coordinate(axis.kind, value).mm_or_rad())
    };
    match item {
        ReadItem::Status => {
            let found = status(data)?;
            snapshot.state.alarm = found.alarm != 0;
            snapshot.state.emergency_stop = found.emergency != 0;
        }
        ReadItem::Positions => {
            for (position, axis) in snapshot.positions.iter_mut().zip(axes) {
                *position = coordinate(axis, axis.slot)?;
            }
        }
        ReadItem::PositionOf(slot) => {
            for (position, axis) in snapshot.positions.iter_mut().zip(axes) {
                if axis.slot == slot {
                    *position = coordinate(axis, 0)?;
                }
            }
        }
        ReadItem::Shifts(run) => {
            let applied = snapshot.applied.get_or_insert(PerChannel::ZERO);
            shifts(data, width, axes, run, applied)?;
        }
        ReadItem::Report(run) => {
            let words = snapshot.report.as_mut().map(Words::as_mut_slice);
            let words = words.and_then(|words| words.get_mut(run.first..run.first + run.count));
            decode_words(data, words.unwrap_or_default())?;
        }
        ReadItem::Heartbeat(_) => {
            reading.heartbeat = Some(*data.first().ok_or(FrameError("no byte of the heartbeat"))?);
        }
        ReadItem::Referenced(_) => {
            let bits = *data.first().ok_or(FrameError("no byte of referenced axes"))?;
            // A byte covers eight axes. Further axes count as not referenced, which is the safe side.
            let referenced = |axis: &PlannedAxis| axis.slot < 8 && bits >> axis.slot & 1 == 1;
            snapshot.state.referenced = axes.iter().all(referenced);
        }
    }
    Ok(())
}

fn decode_words(data: &[u8], words: &mut [u16]) -> Result<(), FrameError> {
    if data.len() != 2 * words.len() {
        return Err(FrameError("another number of report words than requested"));
    }
    for (word, bytes) in words.iter_mut().zip(data.chunks_exact(2)) {
        *word = u16::from_be_bytes([bytes[0], bytes[1]]);
    }
    Ok(())
}

fn shifts(
    data: &[u8],
    width: Width,
    axes: &[PlannedAxis],
    run: Run,
    applied: &mut PerChannel<f64>,
) -> Result<(), FrameError> {
    for (applied, axis) in applied.iter_mut().zip(axes) {
        if let Some(bytes) = run.bytes_of(axis.slot, width) {
            let count = data.get(bytes).and_then(|bytes| count(bytes, width));
            *applied = count.ok_or(FrameError("fewer shifts than requested"))? * axis.count;
        }
    }
    Ok(())
}

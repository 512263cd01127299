//! The read of a cycle: sends its requests and decodes the responses, without allocating.
//!
//! It also finds the forms of the requests that the control accepts in a cycle.

use std::time::{Duration, Instant};

use volcomp_port::{ControllerState, Fault, MOST_WORDS, Snapshot, Words};
use volcomp_vocabulary::{Displacement, PerChannel};

use crate::{
    answers::{slot, status},
    config::FocasConfig,
    error::{FocasError, ReturnCode},
    frame::{Block, FrameError},
    plan::{self, Abilities, Exchange, Packing, PlannedAxis, ReadItem, Run},
    pmc::{BarrierArea, Width, count},
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

/// Finds the request forms that the control accepts in a cycle. Sends only read requests. The form with the fewest
/// exchanges is tried first; if it is rejected, each ability is tried separately.
///
/// Errors: a request that is rejected in every form, with the control's return code.
pub(crate) fn find_abilities(
    session: &mut Session,
    config: &FocasConfig,
    axes: &[PlannedAxis],
) -> Result<Abilities, FocasError> {
    let mut probe = FormProbe { session, config, axes };
    if probe.accepts_all(Abilities::ALL)? {
        return Ok(Abilities::ALL);
    }
    probe.require(ReadItem::Status)?;
    let all_axes = probe.accepts(ReadItem::Positions)?;
    if !all_axes {
        probe.require_all(plan::positions(axes, false))?;
    }
    let mut ranges = true;
    for item in plan::words(config, axes, true) {
        ranges &= probe.accepts(item)?;
    }
    if !ranges {
        probe.require_all(plan::words(config, axes, false))?;
    }
    probe.require_all(plan::bytes(config))?;
    let mut found = Abilities { packing: Packing::OneByOne, ranges, all_axes };
    for packing in [Packing::OneFrame, Packing::ByTarget] {
        let packed = Abilities { packing, ..found };
        if probe.accepts_all(packed)? {
            found = packed;
            break;
        }
    }
    Ok(found)
}

struct FormProbe<'a> {
    session: &'a mut Session,
    config: &'a FocasConfig,
    axes: &'a [PlannedAxis],
}

impl FormProbe<'_> {
    fn accepts_all(&mut self, abilities: Abilities) -> Result<bool, FocasError> {
        let exchanges = plan::reads(self.config, self.axes, abilities)?;
        let request = "reading all that a cycle needs";
        self.refusal(&exchanges, request).map(|refused| refused.is_none())
    }

    fn accepts(&mut self, item: ReadItem) -> Result<bool, FocasError> {
        self.refusal_of(item).map(|refused| refused.is_none())
    }

    fn require(&mut self, item: ReadItem) -> Result<(), FocasError> {
        self.refusal_of(item)?.map_or(Ok(()), Err)
    }

    fn require_all(&mut self, items: impl IntoIterator<Item = ReadItem>) -> Result<(), FocasError> {
        items.into_iter().try_for_each(|item| self.require(item))
    }

    fn refusal_of(&mut self, item: ReadItem) -> Result<Option<FocasError>, FocasError> {
        let exchange = plan::read(self.config, &[item])?;
        self.refusal(&[exchange], &item.words(self.config))
    }

    /// Sends read requests. Returns `None` if the control answers all of them. If it rejects one or returns less data
    /// than requested, returns this error. Any other failure, such as a busy control, is an `Err`.
    fn refusal(
        &mut self,
        exchanges: &[Exchange<ReadItem>],
        request: &str,
    ) -> Result<Option<FocasError>, FocasError> {
        let deadline = Instant::now() + self.config.at_most;
        let applied = Applied::of(self.config);
        let Err(fault) = read(self.session, exchanges, self.axes, applied, deadline) else {
            return Ok(None);
        };
        let error = FocasError::in_request(request, fault);
        let busy = matches!(error, FocasError::Refused { code, .. } if code == ReturnCode::BUSY);
        let refused = match fault {
            Fault::Refused { .. } => !busy,
            Fault::Protocol(_) => !self.session.is_dead(),
            _ => false,
        };
        if refused { Ok(Some(error)) } else { Err(error) }
    }
}

//! The controller of a control with digital lines.
//!
//! It tracks the positions of the axes, and puts the corrections on its output lines.

use std::time::{Duration, Instant};

use volcomp_port::{
    Axis, Controller, ControllerState, Description, DeviceError, DigitalIo, Fault, Heartbeat,
    InputLevels, ShownStates, Snapshot,
};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, PerChannel};

use crate::{
    wiring::Wiring,
    words::{CorrectionWord, PositionWord, Unwrapper},
};

/// A control that reports positions on digital lines and receives corrections on other lines. Axes that share lines are
/// read and corrected while the control selects them. Writing returns [`Fault::Unfinished`] until all axes have the
/// requested correction.
///
/// If only the low bits of a position are transmitted and the word is not read for too long, the position becomes
/// unknown and reading fails. Then move the axis to its reference and create a new controller.
///
/// The lines carry no state of the control. The description says so, and the configuration must accept it. Snapshots
/// report that the axes are referenced and that no alarm is active. A second gateway on the same lines is not detected,
/// and only the control can monitor the lines.
pub struct DigitalController<D> {
    io: D,
    wiring: Wiring,
    coherence: Coherence,
    axes: Vec<DigitalAxis>,
    description: Description,
    readings: Vec<Option<AxisReading>>,
    /// Index of the axis that the control selected last.
    selected: usize,
    outputs: Outputs,
    wrote: bool,
    saturated: u32,
}

#[derive(Clone, Copy)]
struct AxisReading {
    position: f64,
    taken: Instant,
    unwrapper: Option<Unwrapper>,
}

impl<D: DigitalIo> DigitalController<D> {
    /// Creates a controller on digital lines.
    ///
    /// # Errors
    /// A wiring that does not fit the port or the words.
    pub fn new(
        io: D,
        channel: impl Into<String>,
        wiring: Wiring,
        coherence: Coherence,
        axes: Vec<DigitalAxis>,
    ) -> Result<Self, DeviceError> {
        let device = io.device().to_owned();
        let words: Vec<_> = axes.iter().map(|a| (a.position, a.correction)).collect();
        let refused =
            |what: String| DeviceError::option(&*device, what, "correct the configuration");
        wiring
            .check(io.inputs(), io.outputs(), axes.len(), &words)
            .map_err(|e| refused(e.to_string()))?;
        if coherence == Coherence::Strobe && wiring.strobe.is_none() {
            return Err(refused("no strobe line is named".to_owned()));
        }
        let axis = |axis: &DigitalAxis| Axis {
            name: axis.name,
            includes_correction: axis.includes_correction,
            resolution: axis.correction.step,
            largest: Some(Displacement::new(axis.correction.step.kind(), axis.correction.limit())),
        };
        let readings = match coherence {
            Coherence::Latched => 1,
            Coherence::TwoAgree | Coherence::Strobe => 2,
        };
        let description = Description {
            channel: channel.into(),
            axes: axes.iter().map(axis).collect(),
            reads: Vec::new(),
            heartbeat: Heartbeat::Unwatched,
            barrier: false,
            tells_applied: false,
            shown: ShownStates::NONE,
            sees_other_gateways: false,
            // A cycle has the readings of a position and one write.
            shortest_cycle: io.shortest_cycle() * (readings + 1),
            device: device.clone(),
        };
        description.check().map_err(|e| refused(e.to_string()))?;
        for axis in &axes {
            axis.check().map_err(&refused)?;
        }
        Ok(Self {
            readings: vec![None; axes.len()],
            io,
            wiring,
            coherence,
            axes,
            description,
            selected: 0,
            outputs: Outputs::new(),
            wrote: false,
            saturated: 0,
        })
    }

    /// Corrections of the last confirmed writes, by axis, mm or rad; `None` for an axis that was not written yet. With
    /// a latch, these are the corrections on the lines when the latch toggled. A failed write does not change them.
    pub fn sent(&self) -> &PerChannel<Option<f64>> {
        self.outputs.taken()
    }

    /// Number of corrections that exceeded the range of their word.
    pub fn saturated(&self) -> u32 {
        self.saturated
    }

    fn has_all(&self, corrections: &PerChannel<f64>) -> bool {
        let requested = self.axes.iter().zip(corrections);
        requested.zip(self.outputs.taken()).all(|((axis, requested), taken)| {
            let sent = axis.correction.encode(*requested).sent;
            *taken == Some(sent)
        })
    }

    /// Updates the sent corrections from the levels that the device has confirmed.
    fn note(&mut self) {
        self.outputs.note(&self.io, &self.wiring, &self.axes, self.wrote);
    }

    fn look(&mut self, deadline: Instant) -> Result<(), Fault> {
        let InputLevels { levels, taken } =
            read_coherent(&mut self.io, &self.wiring, self.coherence, deadline)?;
        let input = self.wiring.position_input(levels);
        let index = usize::try_from(input.axis).unwrap_or(usize::MAX);
        let Some((axis, reading)) = self.axes.get(index).zip(self.readings.get_mut(index)) else {
            return Err(Fault::Protocol("the selected axis is not configured"));
        };
        let mut unwrapper = None;
        if let Some(low) = &axis.low_bits {
            // Reading keeps failing from now on, because the age of the last known position only grows.
            let is_lost = |reading: &AxisReading| {
                taken.saturating_duration_since(reading.taken) >= low.within(&axis.position)
            };
            if reading.as_ref().is_some_and(is_lost) {
                return Err(Fault::Protocol(
                    "a position of low bits was not read for too long: it must be referenced again",
                ));
            }
            let begun = reading.and_then(|reading| reading.unwrapper);
            unwrapper = Some(begun.unwrap_or_else(|| {
                Unwrapper::new(axis.position, input.word, low.from.mm_or_rad())
            }));
        }
        let coded = match &mut unwrapper {
            Some(unwrapper) => unwrapper.follow(input.word),
            None => axis.position.decode(input.word),
        };
        *reading = Some(AxisReading { position: coded.position, taken, unwrapper });
        self.selected = index;
        Ok(())
    }
}

impl<D: DigitalIo> Controller for DigitalController<D> {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, deadline: Instant) -> Result<Snapshot, Fault> {
        let begun = Instant::now();
        self.look(deadline)?;
        self.note();
        while self.readings.iter().any(Option::is_none) {
            if Instant::now() >= deadline {
                return Err(Fault::TimedOut);
            }
            self.look(deadline)?;
        }
        let mut positions = PerChannel::ZERO;
        let mut oldest = Instant::now();
        for (position, reading) in positions.iter_mut().zip(self.readings.iter().flatten()) {
            *position = reading.position;
            oldest = oldest.min(reading.taken);
        }
        Ok(Snapshot {
            positions,
            taken: oldest,
            state_taken: oldest,
            correction_taken: oldest,
            uncertainty: begun.elapsed().max(Duration::from_nanos(1)),
            // The lines carry no state. The description says so, and the configuration has accepted it.
            state: ControllerState { referenced: true, ..ControllerState::default() },
            // The correction on the lines. The lines do not show whether the control applies it.
            applied: self.outputs.carried(),
            report: None,
        })
    }

    /// Writes the correction of the selected axis. The other axes follow when the control selects them. Until all axes
    /// are written, the call returns [`Fault::Unfinished`]. With a latch each correction takes two calls: the first
    /// writes the word, the second toggles the latch.
    fn apply(&mut self, corrections: &PerChannel<f64>, deadline: Instant) -> Result<(), Fault> {
        if Instant::now() >= deadline {
            return Err(Fault::TimedOut);
        }
        let index = self.selected;
        let Some(axis) = self.axes.get(index) else {
            return Err(Fault::NotConnected);
        };
        let correction = axis.correction.encode(corrections[index]);
        self.saturated = self.saturated.wrapping_add(u32::from(correction.saturated));
        let number = u32::try_from(index).unwrap_or(0);
        let written =
            self.outputs.write(&mut self.io, &self.wiring, (correction.word, number), deadline);
        self.wrote |= written.is_ok();
        self.note();
        written?;
        if self.axes.len() > 1 && !self.has_all(corrections) {
            return Err(Fault::Unfinished);
        }
        Ok(())
    }
}

#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct DigitalAxis {
    /// Letter of the axis, which also determines whether it is linear or rotary.
    pub name: AxisName,
    pub position: PositionWord,
    /// Tracking parameters if the word encodes only the low bits of the position; `None` if it encodes the whole
    /// position.
    pub low_bits: Option<LowBits>,
    pub correction: CorrectionWord,
    /// Whether reported positions contain the correction.
    pub includes_correction: bool,
}

/// Tracking of a position whose word has only the low bits. The position stays known if the axis moves less than half
/// the range of the word between two readings.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct LowBits {
    /// Position of the axis at the first reading, such as its reference position.
    pub from: Displacement,
    /// Maximum speed of the axis, as the travel in one second: a length for a linear axis, an angle for a rotary axis.
    pub most_per_s: Displacement,
}

impl LowBits {
    /// Maximum time between two readings of the word. After a longer time the position is unknown.
    fn within(&self, word: &PositionWord) -> Duration {
        let seconds = 0.5 * word.range() / self.most_per_s.mm_or_rad();
        Duration::try_from_secs_f64(seconds).unwrap_or(Duration::ZERO)
    }
}

impl DigitalAxis {
    /// Creates an axis with the published words: a position of 15 bits of 1/32 mm from 0 to 1024 mm, and a correction
    /// of 8 bits of 1 µm. These steps are lengths. For a rotary axis, set angular steps, or
    /// [`DigitalController::new`](crate::DigitalController::new) rejects the axis.
    pub fn published(name: AxisName) -> Self {
        Self {
            name,
            position: PositionWord::PUBLISHED,
            low_bits: None,
            correction: CorrectionWord::PUBLISHED,
            includes_correction: false,
        }
    }

    /// Checks that all position settings have the quantity of the axis (length or angle). The check of the description
    /// covers the correction step.
    fn check(&self) -> Result<(), String> {
        let (kind, position) = (self.name.kind(), self.position);
        let known = self.low_bits.map_or(position.zero, |low| low.from);
        if let Some(LowBits { most_per_s, .. }) = self.low_bits
            && !(most_per_s.kind() == kind && most_per_s.mm_or_rad() > 0.0)
        {
            return Err(format!(
                "axis {}: found that it moves at most {most_per_s} in a second, expected more than 0 and the unit of its positions",
                self.name
            ));
        }
        if position.is_of(kind) && known.kind() == kind {
            return Ok(());
        }
        Err(format!(
            "axis {}: found a position step of {} from {} on, expected {}",
            self.name,
            position.step,
            known,
            match kind {
                AxisKind::Linear => "lengths, since the axis is linear",
                AxisKind::Rotary => "angles, since the axis is rotary",
            }
        ))
    }
}

/// Time within which the latch may toggle after a new word, as a multiple of the time until the deadline of the word's
/// write. The write takes at most one such time until it fails. The other two are longer than one cycle, so that the
/// next call can still toggle the latch.
const LATCHED_WITHIN: u32 = 3;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Latching {
    /// The control has received the last correction, and the latch has not changed since then.
    Taken,
    /// The word was written with these levels. The latch toggles once the device has confirmed them.
    Settling(u64),
    /// The latch was toggled, giving these levels. No other line changes until the device has confirmed them.
    Turned(u64),
}

struct Outputs {
    latching: Latching,
    /// Time until which the latch may be toggled for the last written word.
    latched_by: Instant,
    /// Last confirmed level of the latch, as a bit at the position of its line.
    seen_latch: Option<u64>,
    /// Whether the device currently reports its output levels.
    is_reported: bool,
    taken: PerChannel<Option<f64>>,
    /// Correction that the control last received, if there is only one axis.
    carried: Option<PerChannel<f64>>,
}

impl Outputs {
    fn new() -> Self {
        Self {
            latching: Latching::Taken,
            latched_by: Instant::now(),
            seen_latch: None,
            is_reported: false,
            taken: PerChannel::from_fn(|_| None),
            carried: None,
        }
    }

    /// Corrections on the lines at the last confirmed write, by axis, mm or rad; `None` for an axis that was not
    /// written yet.
    fn taken(&self) -> &PerChannel<Option<f64>> {
        &self.taken
    }

    /// Correction on the lines now, also before the first write. NaN if the word on the lines encodes no correction;
    /// the guard then does not overwrite it. `None` if the device does not report its output levels, or if there are
    /// several axes.
    fn carried(&self) -> Option<PerChannel<f64>> {
        self.carried.filter(|_| self.is_reported)
    }

    /// Writes the word of an axis. With a latch, a correction takes two writes: first the word, and after its
    /// confirmation the latch alone. While the level of the latch is unknown nothing is written, because the latch
    /// could toggle together with the word. While the levels of unused outputs are unknown nothing is written, unless
    /// the device cannot report them. Errors: see [`DigitalIo::write`].
    fn write(
        &mut self,
        io: &mut impl DigitalIo,
        wiring: &Wiring,
        (word, axis): (u32, u32),
        deadline: Instant,
    ) -> Result<(), Fault> {
        let confirmed = io.confirmed();
        let has_others = wiring.leaves_outputs(io.outputs());
        let now = Instant::now();
        let word = wiring.levels(word, axis);
        let (levels, next) = match confirmed {
            Some(confirmed) => self.next(wiring, word, confirmed, now),
            None if wiring.latch.is_some() => {
                return Err(Fault::Unsupported(
                    "a latch while the module does not report its level",
                ));
            }
            None if has_others && io.reports_outputs() => {
                return Err(Fault::Unsupported(
                    "writing while the levels of other outputs are unknown",
                ));
            }
            None => (word, Latching::Taken),
        };
        // A word that is sent again keeps its time limit.
        let is_resent = now <= self.latched_by
            && matches!(
                (self.latching, next),
                (Latching::Settling(a), Latching::Settling(b)) if (a ^ b) & wiring.used_outputs() == 0
            );
        if !is_resent && matches!(next, Latching::Settling(_)) {
            let within = deadline.saturating_duration_since(now).saturating_mul(LATCHED_WITHIN);
            self.latched_by = now.checked_add(within).unwrap_or(deadline);
        }
        // A write that fails may have been sent nevertheless.
        self.latching = next;
        io.write(levels, deadline)
    }

    /// The levels to write next, and the state after that write. Unused lines keep the levels that the device has
    /// confirmed. After the time limit the requested word replaces the unconfirmed one: the control may be at zero by
    /// then, and the earlier word would be a step.
    fn next(&self, wiring: &Wiring, word: u64, confirmed: u64, now: Instant) -> (u64, Latching) {
        let bit = wiring.latch_bit();
        let others = confirmed & !wiring.used_outputs();
        if bit == 0 {
            return (word | others, Latching::Taken);
        }
        // The unconfirmed word is sent again. If another word B were sent instead, an older reading that equals B could
        // confirm B while the unconfirmed word is still in transit.
        if let Latching::Settling(levels) = self.latching
            && now <= self.latched_by
            && confirmed != levels
            && (confirmed ^ levels) & bit == 0
        {
            let levels = levels & wiring.used_outputs() | others;
            return (levels, Latching::Settling(levels));
        }
        let turned = match self.latching {
            _ if now > self.latched_by => None,
            Latching::Settling(levels) if confirmed == levels => Some(levels ^ bit),
            Latching::Turned(levels) if confirmed ^ levels == bit => Some(levels),
            _ => None,
        };
        if let Some(levels) = turned {
            return (levels, Latching::Turned(levels));
        }
        let levels = word | others | confirmed & bit;
        (levels, Latching::Settling(levels))
    }

    /// Updates the state from the levels that the device has confirmed. `wrote` is true if anything was written since
    /// the start.
    fn note(&mut self, io: &impl DigitalIo, wiring: &Wiring, axes: &[DigitalAxis], wrote: bool) {
        let confirmed = io.confirmed();
        self.is_reported = confirmed.is_some();
        let Some(levels) = confirmed else {
            return;
        };
        if !self.is_received(wiring, levels) {
            return;
        }
        let (word, axis) = wiring.control_inputs(levels);
        let index = usize::try_from(axis).unwrap_or(usize::MAX);
        let Some(axis) = axes.get(index) else {
            return;
        };
        let correction = axis.correction.decode(word);
        if axes.len() == 1 {
            let mut carried = PerChannel::ZERO;
            carried[index] = correction.unwrap_or(f64::NAN);
            self.carried = Some(carried);
        }
        if wrote {
            self.taken[index] = correction;
        }
    }

    /// Whether the control has received the word in these confirmed levels. With a latch the control receives a word at
    /// each edge, also at an edge that the device causes, for example by a loss of its supply. If outputs fall without
    /// an edge, the control receives nothing.
    fn is_received(&mut self, wiring: &Wiring, levels: u64) -> bool {
        let bit = wiring.latch_bit();
        if bit == 0 {
            return true;
        }
        let has_edge = match self.seen_latch.replace(levels & bit) {
            Some(before) => before != levels & bit,
            // The levels that are found at the start count as received.
            None => self.latching == Latching::Taken,
        };
        let Latching::Turned(turned) = self.latching else {
            return has_edge;
        };
        // The device lost its outputs while the latch was being toggled. The order of both is unknown, so the outputs
        // count as received.
        let is_lost = (turned ^ levels) & wiring.used_outputs() & !bit != 0;
        if is_lost || turned == levels {
            self.latching = Latching::Taken;
        }
        has_edge || is_lost
    }
}

/// Condition on which a position word counts as coherent, that is, with all bits from one instant.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub enum Coherence {
    /// Two consecutive readings agree. Both can be wrong if the lines are skewed for longer than one reading, or if a
    /// port returns the same image until its next exchange (Modbus). In these cases use Gray code, a parity or a
    /// strobe.
    TwoAgree,
    /// Two consecutive readings agree, and the strobe is 1 in both.
    Strobe,
    /// A single reading suffices, because the port latches its inputs together.
    Latched,
}

/// Reads the inputs until the word is coherent. Returns the levels, with unused lines set to 0, and the time of the
/// reading.
///
/// # Errors
/// [`Fault::TimedOut`] if no word was stable before the deadline, or a fault of the port.
pub fn read_coherent(
    io: &mut impl DigitalIo,
    wiring: &Wiring,
    coherence: Coherence,
    deadline: Instant,
) -> Result<InputLevels, Fault> {
    let used = wiring.used_inputs();
    let mut before = None;
    loop {
        let InputLevels { levels, taken } = io.read(deadline)?;
        let levels = levels & used;
        let agrees = coherence == Coherence::Latched || before == Some(levels);
        if agrees && wiring.position_input(levels).valid {
            return Ok(InputLevels { levels, taken });
        }
        before = Some(levels);
        if Instant::now() >= deadline {
            return Err(Fault::TimedOut);
        }
    }
}

use std::time::{Duration, Instant};

use volcomp_port::{
    Axis, Controller, ControllerState, Description, DeviceError, DigitalIo, Fault, Heartbeat,
    InputLevels, ShownStates, Snapshot,
};

use volcomp_vocabulary::{Displacement, PerChannel};

use crate::{
    axis::DigitalAxis,
    coherent::{Coherence, read_coherent},
    outputs::Outputs,
    wiring::Wiring,
    words::Unwrapper,
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
            // For each axis: the readings and one write.
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

//! Simulated digital lines with a control behind them, for simulations, examples and tests.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use volcomp_port::{DigitalIo, Fault, InputLevels};

use crate::{controller::DigitalAxis, wiring::Wiring};

/// Decoded levels of the lines to a control.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PanelWord {
    /// Level of the latch line, which toggles when the other lines have settled; `false` without a latch.
    pub latch: bool,
    pub axis: usize,
    /// Correction in counts; `None` if the word is invalid.
    pub counts: Option<i32>,
}

/// Digital lines of a control, simulated in memory. Clones share the lines: pass one clone to a
/// [`DigitalController`](crate::DigitalController), and use the other as the control.
#[derive(Clone)]
pub struct Panel(Arc<Mutex<PanelState>>);

struct PanelState {
    wiring: Wiring,
    axes: Vec<DigitalAxis>,
    /// Positions of the axes, mm or rad.
    positions: Vec<f64>,
    selected: usize,
    outputs: u64,
    takes: Box<dyn FnMut(PanelWord) + Send>,
}

impl Panel {
    /// Creates lines with this wiring to a control with these axes. All levels are 0 and the first axis is selected.
    pub fn new(wiring: Wiring, axes: Vec<DigitalAxis>) -> Self {
        Self(Arc::new(Mutex::new(PanelState {
            wiring,
            positions: vec![0.0; axes.len()],
            axes,
            selected: 0,
            outputs: 0,
            takes: Box::new(|_| {}),
        })))
    }

    fn state(&self) -> MutexGuard<'_, PanelState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets a callback that receives the decoded levels after every write.
    pub fn on_write(&self, takes: impl FnMut(PanelWord) + Send + 'static) {
        self.state().takes = Box::new(takes);
    }

    /// Moves the axis with this index to a position, mm or rad, and selects it. Does nothing if there is no such axis.
    pub fn shows(&self, axis: usize, position: f64) {
        let mut state = self.state();
        if let Some(place) = state.positions.get_mut(axis) {
            *place = position;
            state.selected = axis;
        }
    }

    /// Sets the levels of the lines to the control, as if another program had left them.
    pub fn left_at(&self, levels: u64) {
        self.state().outputs = levels;
    }

    pub fn levels(&self) -> u64 {
        self.state().outputs
    }

    pub fn word(&self) -> PanelWord {
        self.state().word()
    }

    /// Correction on the lines to the control, mm or rad; `None` if the word is invalid or there is no such axis.
    pub fn correction(&self) -> Option<f64> {
        let state = self.state();
        let (word, axis) = state.wiring.control_inputs(state.outputs);
        let axis = state.axes.get(usize::try_from(axis).ok()?)?;
        axis.correction.decode(word)
    }
}

impl PanelState {
    #[expect(clippy::cast_possible_truncation, reason = "a word on lines has at most 32 bits")]
    fn word(&self) -> PanelWord {
        let (word, axis) = self.wiring.control_inputs(self.outputs);
        let axis = usize::try_from(axis).unwrap_or(usize::MAX);
        let correction = self.axes.get(axis).map(|axis| axis.correction);
        PanelWord {
            latch: self.outputs & self.wiring.latch_bit() != 0,
            axis,
            counts: correction.and_then(|correction| {
                let steps = correction.decode(word)? / correction.step.mm_or_rad();
                Some(steps.round() as i32)
            }),
        }
    }
}

impl DigitalIo for Panel {
    fn device(&self) -> &'static str {
        "panel"
    }

    fn inputs(&self) -> u32 {
        64
    }

    fn outputs(&self) -> u32 {
        64
    }

    fn shortest_cycle(&self) -> Duration {
        Duration::from_micros(50)
    }

    fn read(&mut self, _deadline: Instant) -> Result<InputLevels, Fault> {
        let state = self.state();
        let (axis, position) = (state.axes[state.selected], state.positions[state.selected]);
        let outside = Fault::Protocol("a position is outside the range of its word");
        let word = axis.position.encode(position).ok_or(outside)?;
        let number = u32::try_from(state.selected).unwrap_or(u32::MAX);
        Ok(InputLevels::now(state.wiring.control_outputs(word, number, true)))
    }

    fn write(&mut self, levels: u64, _deadline: Instant) -> Result<(), Fault> {
        let mut state = self.state();
        state.outputs = levels;
        let word = state.word();
        (state.takes)(word);
        Ok(())
    }

    fn confirmed(&self) -> Option<u64> {
        Some(self.state().outputs)
    }
}

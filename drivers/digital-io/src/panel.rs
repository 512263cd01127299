//! A control behind simulated lines, for simulations, examples and tests.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use volcomp_port::{DigitalIo, Fault, InputLevels};

use crate::{axis::DigitalAxis, wiring::Wiring};

/// The content of the lines to a control.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PanelWord {
    /// Level of the latch line, which toggles once the others have settled; `false` without one.
    pub latch: bool,
    /// Index of the axis that the word is for.
    pub axis: usize,
    /// The correction word, counts; `None` if it is invalid.
    pub counts: Option<i32>,
}

/// The lines of a control, with access to the control's end. Clones share the lines: pass one to a [`DigitalController`](crate::DigitalController)
/// and use the other to inspect and move the control.
#[derive(Clone)]
pub struct Panel(Arc<Mutex<Inside>>);

struct Inside {
    wiring: Wiring,
    axes: Vec<DigitalAxis>,
    /// Positions of the axes, mm or rad.
    positions: Vec<f64>,
    /// Index of the selected axis.
    shown: usize,
    outputs: u64,
    takes: Box<dyn FnMut(PanelWord) + Send>,
}

impl Panel {
    /// Lines of this wiring to a control with these axes, all at 0, the first one selected.
    pub fn new(wiring: Wiring, axes: Vec<DigitalAxis>) -> Self {
        Self(Arc::new(Mutex::new(Inside {
            wiring,
            positions: vec![0.0; axes.len()],
            axes,
            shown: 0,
            outputs: 0,
            takes: Box::new(|_| {}),
        })))
    }

    fn inside(&self) -> MutexGuard<'_, Inside> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Sets a callback that receives the content of the lines after every write.
    pub fn on_write(&self, takes: impl FnMut(PanelWord) + Send + 'static) {
        self.inside().takes = Box::new(takes);
    }

    /// Moves the axis at this index to a position, mm or rad, and selects it. No effect if there is no such axis.
    pub fn shows(&self, axis: usize, position: f64) {
        let mut inside = self.inside();
        if let Some(place) = inside.positions.get_mut(axis) {
            *place = position;
            inside.shown = axis;
        }
    }

    /// Sets the levels of the lines to the control, as if left by another program.
    pub fn left_at(&self, levels: u64) {
        self.inside().outputs = levels;
    }

    /// The levels of the lines to the control.
    pub fn levels(&self) -> u64 {
        self.inside().outputs
    }

    /// The content of the lines to the control.
    pub fn word(&self) -> PanelWord {
        self.inside().word()
    }

    /// The correction on the lines to the control, mm or rad; `None` if the word is invalid or there is no such axis.
    pub fn correction(&self) -> Option<f64> {
        let inside = self.inside();
        let (word, axis) = inside.wiring.control_inputs(inside.outputs);
        let axis = inside.axes.get(usize::try_from(axis).ok()?)?;
        axis.correction.decode(word)
    }
}

impl Inside {
    #[expect(
        clippy::cast_possible_truncation,
        reason = "a word on lines has at most 32 bits"
    )]
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
        let inside = self.inside();
        let (axis, position) = (inside.axes[inside.shown], inside.positions[inside.shown]);
        let outside = Fault::Protocol("a position is outside the range of its word");
        let word = axis.position.encode(position).ok_or(outside)?;
        let number = u32::try_from(inside.shown).unwrap_or(u32::MAX);
        Ok(InputLevels::now(
            inside.wiring.control_outputs(word, number, true),
        ))
    }

    fn write(&mut self, levels: u64, _deadline: Instant) -> Result<(), Fault> {
        let mut inside = self.inside();
        inside.outputs = levels;
        let word = inside.word();
        (inside.takes)(word);
        Ok(())
    }

    fn confirmed(&self) -> Option<u64> {
        Some(self.inside().outputs)
    }
}

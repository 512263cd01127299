//! A control behind lines in memory: for simulations, examples and tests.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use volcomp_port::{DigitalIo, Fault, InputLevels};

use crate::{axis::DigitalAxis, wiring::Wiring};

/// What the lines to a control carry.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "serde", derive(serde::Serialize, serde::Deserialize))]
pub struct PanelWord {
    /// The level of the line that turns when the others have settled; `false` without one.
    pub latch: bool,
    /// The place of the axis that the word is for.
    pub axis: usize,
    /// The word, counts of the correction; `None`: one that says nothing.
    pub counts: Option<i32>,
}

/// The lines of a control, and the control's end of them. Clones are the same lines: the one goes to a
/// [`DigitalController`](crate::DigitalController), the other is looked at and moved.
#[derive(Clone)]
pub struct Panel(Arc<Mutex<Inside>>);

struct Inside {
    wiring: Wiring,
    axes: Vec<DigitalAxis>,
    /// Where the axes are, mm or rad.
    positions: Vec<f64>,
    /// The axis that is shown.
    shown: usize,
    outputs: u64,
    takes: Box<dyn FnMut(PanelWord) + Send>,
}

impl Panel {
    /// Lines of this wiring to a control with these axes, which stand at 0 and of which the first is shown.
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

    /// Calls this with what the lines carry after every write.
    pub fn on_write(&self, takes: impl FnMut(PanelWord) + Send + 'static) {
        self.inside().takes = Box::new(takes);
    }

    /// The axis at this place stands at a position, mm or rad, and is the one that is shown. Without effect for a place
    /// where no axis is.
    pub fn shows(&self, axis: usize, position: f64) {
        let mut inside = self.inside();
        if let Some(place) = inside.positions.get_mut(axis) {
            *place = position;
            inside.shown = axis;
        }
    }

    /// The lines to the control have these levels, as another program has left them.
    pub fn left_at(&self, levels: u64) {
        self.inside().outputs = levels;
    }

    /// The levels of the lines to the control.
    pub fn levels(&self) -> u64 {
        self.inside().outputs
    }

    /// What the lines to the control carry.
    pub fn word(&self) -> PanelWord {
        self.inside().word()
    }

    /// The correction that the lines to the control carry, mm or rad; `None`: a word that says nothing, or an axis that is
    /// not there.
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

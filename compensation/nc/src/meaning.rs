//! What gives the words of a line their meaning: a line that is put before another one is read before the codes of that one.

use std::mem::swap;

use crate::{
    block::Block,
    coordinates::{Axes, Frame},
    interpret::Interpreter,
    modal::{FeedMode, Modal},
};

/// What coordinates and F mean.
#[derive(Clone, Debug)]
pub(crate) struct Meaning {
    frame: Frame,
    unit_mm: f64,
    diameter: bool,
    absolute: bool,
    polar: Option<[Option<f64>; 2]>,
    feed_mode: FeedMode,
    feed: Option<f64>,
    known: Axes<bool>,
}

impl Meaning {
    /// What holds before a block that may be an arc.
    pub(crate) fn before(interpreter: &Interpreter, block: &Block) -> Option<Self> {
        let modal = &interpreter.modal;
        let says_arc = (block.words.iter())
            .any(|word| word.letter == b'G' && matches!(word.value, Some(2.0 | 3.0)));
        let is_arc = matches!(modal.motion, Some(20 | 30)) || says_arc;
        is_arc.then(|| Self {
            frame: interpreter.frame.clone(),
            unit_mm: modal.unit_mm,
            diameter: modal.diameter,
            absolute: modal.absolute,
            polar: modal.polar,
            feed_mode: modal.feed_mode,
            feed: modal.feed,
            known: interpreter.known,
        })
    }

    /// Whether a straight motion can be written before a block with what holds behind its codes: the control reads coordinates in the plane
    /// in the same way then, and has a feed, or gets that of the block.
    pub(crate) fn takes_straight(&self, after: &Modal, has_feed: bool) -> bool {
        let has_other_feed = match (self.feed_mode, self.feed) {
            (FeedMode::InverseTime, None) => true,
            (mode, None) => has_feed && mode != after.feed_mode,
            (_, Some(_)) => false,
        };
        self.polar.is_some() == after.polar.is_some() && !has_other_feed
    }

    /// Whether no feed has been said.
    pub(crate) fn lacks_feed(&self) -> bool {
        self.feed.is_none()
    }

    /// Puts this meaning in the place of the one that holds, which it gets.
    pub(crate) fn swap(&mut self, interpreter: &mut Interpreter) {
        let modal = &mut interpreter.modal;
        swap(&mut self.frame, &mut interpreter.frame);
        swap(&mut self.unit_mm, &mut modal.unit_mm);
        swap(&mut self.diameter, &mut modal.diameter);
        swap(&mut self.absolute, &mut modal.absolute);
        swap(&mut self.polar, &mut modal.polar);
        swap(&mut self.feed_mode, &mut modal.feed_mode);
        swap(&mut self.feed, &mut modal.feed);
        swap(&mut self.known, &mut interpreter.known);
    }
}

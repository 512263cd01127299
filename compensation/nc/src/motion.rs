//! Motions of the axes that a block commands, and the queue of executed motions to another thread.

use std::{
    cell::RefCell,
    mem::take,
    sync::{
        self, Mutex, PoisonError,
        mpsc::{Receiver, RecvError, SendError, SyncSender, sync_channel},
    },
    vec::IntoIter,
};

use crate::coordinates::{Axes, Frame};

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Path {
    Rapid,
    Line,
    Arc(Arc),
    /// A drilling cycle at the end of the motion: down to `bottom` and back along the axis normal to the plane. Program coordinates, mm.
    Hole {
        bottom: f64,
        clearance: f64,
        /// The axis normal to the plane.
        depth: usize,
    },
    /// A motion to the position of G28 (0) or G30 (1), first to the intermediate point `through`, machine coordinates.
    Home {
        which: usize,
        through: Axes,
    },
    /// A spline, or one of its control points (G5, G5.1, G5.2). Its other points are relative to its ends, or are in further blocks.
    Spline,
    /// A motion that is copied unchanged: probing, threading.
    Other,
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Arc {
    /// The two axes of the arc's plane, and the axis of a helix.
    pub(crate) axes: [usize; 3],
    pub(crate) centre: [f64; 2],
    /// Angle, rad, positive counterclockwise.
    pub(crate) turns_by: f64,
    pub(crate) by_radius: bool,
}

/// Position half-way down a hole: its correction is used for the axes other than the depth.
pub(crate) fn half_deep(hole: &Axes, depth: usize, [bottom, clearance]: [f64; 2]) -> Axes {
    at_height(hole, depth, 0.5 * (bottom + clearance))
}

/// Position of the tool in a hole with the depth axis at `height`, mm.
pub(crate) fn at_height(hole: &Axes, depth: usize, height: f64) -> Axes {
    let mut at = *hole;
    at[depth] = height;
    at
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Polar {
    pub(crate) words: [Option<usize>; 2],
    pub(crate) from_here: bool,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Move {
    pub(crate) path: Path,
    /// Start of the motion, machine coordinates, mm and deg; `to` is its end.
    pub(crate) from: Axes,
    pub(crate) to: Axes,
    pub(crate) words: Axes<Option<usize>>,
    pub(crate) incremental: Axes<bool>,
    /// The words are machine coordinates (G53, G28).
    pub(crate) in_machine: bool,
    pub(crate) polar: Option<Polar>,
    pub(crate) known: Axes<bool>,
    pub(crate) arrives_from_unknown: Axes<bool>,
    /// Whole turns, deg, that were added to the start position of a rotary axis to get `from`.
    pub(crate) wraps: Axes,
}

impl Move {
    /// Machine coordinates at which the motion stops: the intermediate point, if any, and the end.
    pub(crate) fn stops(&self) -> impl Iterator<Item = &Axes> {
        let through = match &self.path {
            Path::Home { through, .. } => Some(through),
            _ => None,
        };
        through.into_iter().chain([&self.to])
    }

    /// True if the motion cuts and its coordinates are not machine coordinates.
    pub(crate) fn cuts(&self) -> bool {
        !self.in_machine && matches!(self.path, Path::Line | Path::Arc(_) | Path::Hole { .. })
    }
}

impl Arc {
    /// Radius, mm, and angle, rad, of the start point about the centre.
    pub(crate) fn start(&self, from: &Axes) -> (f64, f64) {
        let [first, second, _] = self.axes;
        let way = [from[first] - self.centre[0], from[second] - self.centre[1]];
        (way[0].hypot(way[1]), way[1].atan2(way[0]))
    }

    /// Position at a fraction (0 to 1) of the arc, in program coordinates. Other axes move in
    /// proportion. The radius changes linearly from start to end, as in controls that tolerate
    /// rounding.
    pub(crate) fn place(&self, from: &Axes, to: &Axes, part: f64) -> Axes {
        let [first, second, _] = self.axes;
        let (radius, angle) = self.start(from);
        let end = (to[first] - self.centre[0]).hypot(to[second] - self.centre[1]);
        let radius = radius + part * (end - radius);
        let (sin, cos) = (angle + part * self.turns_by).sin_cos();
        let mut place: Axes =
            std::array::from_fn(|axis| from[axis] + part * (to[axis] - from[axis]));
        if part < 1.0 {
            place[first] = self.centre[0] + radius * cos;
            place[second] = self.centre[1] + radius * sin;
        }
        place
    }
}

#[derive(Clone, Debug)]
pub(crate) struct ExecutedMotion {
    pub(crate) line: usize,
    pub(crate) motion: Move,
    /// Start and end in program coordinates.
    pub(crate) in_program: [Axes; 2],
    pub(crate) frame: Frame,
    pub(crate) tool: Axes,
    pub(crate) system: usize,
    /// Set if the motion, or the cycle at its end, cuts in a work offset that the set-up file states.
    pub(crate) cuts_from_stated_zero: bool,
    /// True if the positions of all linear axes of the machine (X, Y, Z) are known.
    pub(crate) known: bool,
    pub(crate) in_inches: bool,
}

/// Capacity of the queue, in batches; a full queue blocks the sender.
const WAITING: usize = 16;
/// Number of motions in a batch. Motions are sent in batches because waking a thread takes longer than executing a line.
const BATCH: usize = 64;

/// Sends executed motions. Clones append to the same batch, which is sent when it is full or the last clone is dropped.
#[derive(Clone, Debug)]
pub(crate) struct MotionSender(sync::Arc<Mutex<Batch>>);

#[derive(Debug)]
struct Batch {
    to: SyncSender<Vec<ExecutedMotion>>,
    motions: Vec<ExecutedMotion>,
}

#[derive(Debug)]
pub(crate) struct MotionReceiver {
    from: Receiver<Vec<ExecutedMotion>>,
    batch: RefCell<IntoIter<ExecutedMotion>>,
}

pub(crate) fn motion_queue() -> (MotionSender, MotionReceiver) {
    let (to, from) = sync_channel(WAITING);
    let motions = Vec::new();
    let sender = MotionSender(sync::Arc::new(Mutex::new(Batch { to, motions })));
    let batch = RefCell::default();
    (sender, MotionReceiver { from, batch })
}

impl MotionSender {
    /// # Errors
    /// The receiver no longer exists.
    pub(crate) fn send(&self, made: ExecutedMotion) -> Result<(), SendError<Vec<ExecutedMotion>>> {
        let batch = &mut *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        batch.motions.push(made);
        if batch.motions.len() < BATCH {
            return Ok(());
        }
        let next = Vec::with_capacity(BATCH);
        batch.to.send(std::mem::replace(&mut batch.motions, next))
    }
}

impl Drop for Batch {
    fn drop(&mut self) {
        let last = take(&mut self.motions);
        if !last.is_empty() {
            // If the receiver no longer exists, the batch is not needed.
            let _ = self.to.send(last);
        }
    }
}

impl MotionReceiver {
    /// The next motion; waits until a motion is sent.
    ///
    /// # Errors
    /// All motions were received, and the sender no longer exists.
    pub(crate) fn recv(&self) -> Result<ExecutedMotion, RecvError> {
        let mut batch = self.batch.borrow_mut();
        if let Some(next) = batch.next() {
            return Ok(next);
        }
        *batch = self.from.recv()?.into_iter();
        // A batch is never empty.
        batch.next().ok_or(RecvError)
    }
}

//! What a block makes the axes do.

use crate::coordinates::{Axes, Frame};

/// How a motion goes from its beginning to its end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Path {
    Rapid,
    Line,
    Arc(Arc),
    /// A cycle at its end: the tool goes down to `bottom` there and back, in the coordinates of the program, mm, along the
    /// axis normal to the plane.
    Hole {
        bottom: f64,
        clearance: f64,
        /// The axis normal to the plane.
        depth: usize,
    },
    /// To the place of G28 or G30.
    Home(usize),
    /// A spline, or a control point of one (G5, G5.1, G5.2): its other points are ways from its ends, or other such blocks.
    Spline,
    /// Something that is passed on as it is: a probing move, a thread.
    Other,
}

/// An arc or a helix, in the coordinates of the program, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Arc {
    /// The two axes of its plane, and the one along which a helix rises.
    pub(crate) axes: [usize; 3],
    pub(crate) centre: [f64; 2],
    /// The angle it turns by, rad, positive counterclockwise.
    pub(crate) turns_by: f64,
    /// It is written with a radius.
    pub(crate) by_radius: bool,
}

/// Where a hole is half as deep as it gets: across its depth, its correction is that of this place.
pub(crate) fn half_deep(hole: &Axes, depth: usize, [bottom, clearance]: [f64; 2]) -> Axes {
    at_height(hole, depth, 0.5 * (bottom + clearance))
}

/// Where a hole has this height, mm.
pub(crate) fn at_height(hole: &Axes, depth: usize, height: f64) -> Axes {
    let mut at = *hole;
    at[depth] = height;
    at
}

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Polar {
    /// The places of the distance and of the angle in the block.
    pub(crate) words: [Option<usize>; 2],
    /// They count from where the tool is.
    pub(crate) from_here: bool,
}

#[derive(Clone, Debug, PartialEq)]
pub(crate) struct Move {
    pub(crate) path: Path,
    /// The coordinates of the axes of the machine before and after, mm and deg.
    pub(crate) from: Axes,
    pub(crate) to: Axes,
    /// The place of the word of each axis in the block.
    pub(crate) words: Axes<Option<usize>>,
    /// Whose words are ways, not places.
    pub(crate) incremental: Axes<bool>,
    /// Its words are the coordinates of the machine (G53, G28).
    pub(crate) in_machine: bool,
    /// Where polar coordinates say its place in the plane.
    pub(crate) polar: Option<Polar>,
    /// Of which axes it is known where they are before.
    pub(crate) known: Axes<bool>,
    /// Whole turns by which `from` is another number for where a rotary axis was before, deg.
    pub(crate) wraps: Axes,
}

impl Move {
    /// Whether it cuts with the work offset in force.
    pub(crate) fn cuts(&self) -> bool {
        !self.in_machine && matches!(self.path, Path::Line | Path::Arc(_) | Path::Hole { .. })
    }
}

impl Arc {
    /// The radius at the beginning, and the angle there, rad.
    pub(crate) fn start(&self, from: &Axes) -> (f64, f64) {
        let [first, second, _] = self.axes;
        let way = [from[first] - self.centre[0], from[second] - self.centre[1]];
        (way[0].hypot(way[1]), way[1].atan2(way[0]))
    }

    /// The place at a part of the arc from 0 to 1, in the coordinates of the program. What else moves goes by the same part. The
    /// radius goes from that of the beginning to that of the end, as a control takes it that allows for rounding.
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

/// A motion that a program makes.
#[derive(Clone, Debug)]
pub(crate) struct Made {
    pub(crate) line: usize,
    pub(crate) motion: Move,
    /// What its coordinates mean.
    pub(crate) frame: Frame,
    /// What the control adds for the tool.
    pub(crate) tool: Axes,
    pub(crate) system: usize,
    /// It cuts, alone or by a cycle at its end, and the set-up file defines its zero.
    pub(crate) cuts_from_stated_zero: bool,
    /// It is known where X, Y and Z stand, as far as the machine has them.
    pub(crate) known: bool,
    pub(crate) in_inches: bool,
}

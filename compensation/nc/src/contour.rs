//! Contours whose control compensates the radius of the tool (G41, G42): what may not be done to their elements.

use crate::{coordinates::Axes, motion::Move, rewrite::Rewriter, words::each};

/// Whether the control compensates the radius of the tool.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Contour {
    None,
    /// It begins or ends to do so with this motion, which must stay one.
    Switches,
    /// It does: each motion in the plane is an element of the contour, which gets no others and is not split. At an inside corner the control
    /// ends an element early by up to the radius of the tool, which parts may be shorter than.
    Follows,
}

impl Rewriter {
    /// Whether a motion leads elsewhere in the plane of arcs and of the tool's radius.
    pub(crate) fn moves_in_plane(&self, motion: &Move) -> bool {
        let [from, to] = self.ends_of(motion);
        let [first, second, _] = self.interpreter.modal.plane.axes();
        // A turned or tilted frame brings back what stands still to some 1e-12 mm.
        let moves = |axis: usize| (to[axis] - from[axis]).abs() > 1e-9;
        moves(first) || moves(second)
    }

    /// Axes that keep the correction that they have: while the control compensates the radius of the tool, it takes each motion in the plane, of
    /// however few µm, for an element of the contour, and so turns the tool about its corner. A motion without a way in the plane gets none.
    pub(crate) fn keeps_in_plane(&self, motion: &Move) -> Axes<bool> {
        let compensates = self.switches_radius || self.interpreter.modal.radius.is_some();
        if !compensates || self.moves_in_plane(motion) {
            return [false; 9];
        }
        let [first, second, _] = self.interpreter.modal.plane.axes();
        each(|axis| axis == first || axis == second)
    }
}

//! Arcs: places on them.

use crate::{coordinates::Axes, motion::Arc};

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

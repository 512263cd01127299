//! How far the correction on a straight way may be from the straight line between those at its ends: bounds from the derivatives of curves
//! and levers.

use crate::{
    coordinates::{Axes, Frame, is_rotary},
    correction::{Corrector, Seen},
};

/// A part of the tolerance that no rounding carries over it.
const SURELY: f64 = 1.0 - 1e-9;

impl Corrector {
    /// Whether a straight line in a frame may be written as one: `ends` are those of the axes, `in_program` those of the program.
    #[inline]
    pub(crate) fn is_straight_in(
        &self,
        frame: &Frame,
        seen: &mut Seen,
        [from, to]: [&Axes; 2],
        in_program: [&Axes; 2],
    ) -> bool {
        let bulge_mm = self.bulge_in_frame_mm(frame, in_program[0], in_program[1]);
        // A control that moves the centre point of the tool keeps it where it is whatever the rotary axes do.
        let coupled_mm = if frame.tip.is_some() {
            0.0
        } else {
            self.coupled_mm(seen, from, to)
        };
        self.is_straight(from, to, bulge_mm, coupled_mm)
    }

    /// Whether the correction on the way between two places is nowhere further than the tolerance from the straight line
    /// between those at its ends: by the derivatives of the curves. `bulge_mm` is how far the axes may be from the straight
    /// way, `coupled_mm` what rotary corrections add ([`coupled_mm`](Self::coupled_mm)).
    fn is_straight(&self, from: &Axes, to: &Axes, bulge_mm: f64, coupled_mm: f64) -> bool {
        let mut share = 0.0;
        for axis in self.places.axes_of_machine() {
            let way = (to[axis] - from[axis]).abs();
            if way > 0.0 {
                share += way / self.tool.unsplit[axis];
            }
        }
        let off_mm = bulge_mm * self.tool.steepness + coupled_mm;
        if share <= 1.0 {
            // Within its ways the bound grows no faster than the share: where this one is met, the nearer one is.
            let is_near = share * self.split_beyond_mm + off_mm <= SURELY * self.split_beyond_mm;
            if is_near || bulge_mm == 0.0 && coupled_mm == 0.0 {
                return true;
            }
        }
        self.bound_mm(from, to, bulge_mm) + coupled_mm <= self.split_beyond_mm
    }

    /// A bound (mm) of the distance between the correction on the way and the straight line between those at its ends.
    pub(crate) fn bound_mm(&self, from: &Axes, to: &Axes, bulge_mm: f64) -> f64 {
        let [from, to] = [from, to].map(|at| self.state(at));
        self.tool.compiled.chord_bound_mm(&from, &to) + bulge_mm * self.tool.steepness
    }

    /// A bound (mm) of what the tip is off on the way since the corrections of rotary axes change along it, while the linear axes
    /// follow them as they have to at its two ends: the product of two changes, and the bend of the levers. Near a singular
    /// pose the corrections of rotary axes are many times the errors.
    pub(crate) fn coupled_mm(&self, seen: &mut Seen, from: &Axes, to: &Axes) -> f64 {
        if self.tool.compiled.correctors().rotary().is_empty() {
            return 0.0;
        }
        let reach_mm = self.tool.reach_mm;
        let way_mm: f64 = (0..9)
            .filter(|axis| !is_rotary(*axis) && self.has(*axis))
            .map(|axis| (to[axis] - from[axis]).abs())
            .sum();
        let rotary = (3..6).filter(|axis| self.has(*axis));
        let turned: f64 = rotary
            .clone()
            .map(|axis| (to[axis] - from[axis]).abs().to_radians())
            .sum();
        let [before, after] = [from, to].map(|at| seen.at(self, at).delta);
        let (mut change, mut largest) = (0.0, 0.0);
        for axis in rotary {
            change += (after[axis] - before[axis]).abs().to_radians();
            largest += before[axis].abs().max(after[axis].abs()).to_radians();
        }
        let lever_change = way_mm + turned * reach_mm;
        let lever_bend = turned * (2.0 * way_mm + turned * reach_mm);
        0.25 * lever_change * change + 0.125 * lever_bend * largest
    }

    /// How far the axes are from their straight way where a frame leads the centre point of the tool straight between two places
    /// of the program, mm.
    #[inline]
    pub(crate) fn bulge_in_frame_mm(&self, frame: &Frame, from: &Axes, to: &Axes) -> f64 {
        let Some(tip) = &frame.tip else {
            return 0.0;
        };
        let turned = tip.tip().turned(from, to);
        let way: f64 = (0..3).map(|axis| (to[axis] - from[axis]).powi(2)).sum();
        self.bulge_mm(turned, way.sqrt())
    }

    /// How far the linear axes may be from their straight way (mm) while the centre point of the tool goes straight and the
    /// rotary axes turn by `turned` rad: by the second derivative of a turning lever.
    pub(crate) fn bulge_mm(&self, turned: f64, way_mm: f64) -> f64 {
        let reach_mm = self.tool.reach_mm;
        0.125 * turned * (turned * reach_mm + 2.0 * way_mm)
    }
}

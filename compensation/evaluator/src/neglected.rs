//! Bound of the residual of first-order corrections, for many corrections of one machine.

use arrayvec::ArrayVec;

use volcomp_vocabulary::{AxisKind, Component, MAX_AXES, PerAxis};

use crate::machine::CompiledMachine;

/// Bound of the position error that remains after first-order corrections. The bound is precomputed once for a machine
/// and evaluated for each correction.
#[derive(Clone, Debug, PartialEq)]
pub struct Neglected {
    axes: ArrayVec<Share, MAX_AXES>,
    tilts: f64,
    reach_mm: f64,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Share {
    is_rotary: bool,
    /// Maximum change of the position error per mm or rad of the axis, mm.
    slope_mm: f64,
    /// Maximum displacement by the errors of the axis, mm.
    linear_mm: f64,
}

impl CompiledMachine {
    /// Precomputes the bound for the current thermal terms.
    pub fn neglected(&self) -> Neglected {
        let reach_mm = self.reach_mm();
        let mut tilts = 0.0;
        let mut axes = ArrayVec::new();
        for (index, axis) in self.axes.iter().enumerate().take(MAX_AXES) {
            let is_rotary = axis.joint.kind == AxisKind::Rotary;
            let per_unit = if is_rotary { 180.0 / core::f64::consts::PI } else { 1.0 };
            let slopes = |angular: bool| -> f64 {
                let components = Component::ALL.into_iter();
                let components = components.filter(|component| component.is_angular() == angular);
                components.map(|component| axis.slope_bound(component) * per_unit).sum()
            };
            let (linear, angular) = (slopes(false), slopes(true));
            let [linear_mm, angular_rad] = axis.size_bounds();
            tilts += angular_rad
                + self.location[index].angular_rad.norm()
                + self.assembly[index].angular_rad.norm();
            axes.push(Share {
                is_rotary,
                slope_mm: linear + angular * reach_mm + tilts,
                linear_mm,
            });
        }
        Neglected { axes, tilts, reach_mm }
    }
}

impl Neglected {
    /// Bound, mm, of the position error that remains after the first-order correction `delta` (mm, rad in chain order):
    /// the errors change along the correction, and tilts have a second-order part.
    pub fn mm(&self, delta: &PerAxis<f64>) -> f64 {
        let (mut bound, mut turned) = (0.0, 0.0);
        for (axis, delta) in self.axes.iter().zip(delta) {
            let size = libm::fabs(*delta);
            bound += size * axis.slope_mm;
            if axis.is_rotary {
                turned += size;
                bound += size * (axis.linear_mm + size * self.reach_mm);
            }
        }
        bound + (self.tilts + turned) * (self.tilts + turned) * self.reach_mm
    }

    /// Bound, mm, of the position error that remains after the correction `second`, which was computed with the errors
    /// at the state corrected by `first` (mm, rad in chain order). The errors change only along `second` − `first`;
    /// `first` itself contributes to second order only.
    pub fn there_mm(&self, first: &PerAxis<f64>, second: &PerAxis<f64>) -> f64 {
        let mut between = *second;
        let (mut turned, mut moved_mm) = (0.0, 0.0);
        for (index, axis) in self.axes.iter().enumerate() {
            between[index] -= first[index];
            let size = libm::fabs(second[index]);
            if axis.is_rotary {
                turned += size;
            } else {
                moved_mm += size;
            }
        }
        self.mm(&between) + turned * (turned * self.reach_mm + moved_mm)
    }
}

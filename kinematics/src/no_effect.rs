use nalgebra::Vector3;
use volcomp_vocabulary::{AxisKind, Component, ErrorName};

use crate::{
    chain::Joint,
    error::{InsteadConstant, NoEffect},
};

/// The axis of the machine coordinate system, 0 to 2 for X, Y, Z, along which a unit vector lies, and whether it points in the positive
/// direction; `None` if it is along none of the three.
pub fn along_machine_axis(direction: &Vector3<f64>) -> Option<(usize, bool)> {
    let place = direction.iter().position(|u| u.abs() > 1.0 - 1e-12)?;
    Some((place, direction[place] > 0.0))
}

impl Joint {
    /// Why a location error of this axis in a component has no effect; `None` if it has one.
    pub fn no_effect(&self, component: Component) -> Option<NoEffect> {
        let place = component.mcs_index();
        let along = along_machine_axis(&self.direction);
        let along_itself = along.is_some_and(|(along, _)| along == place);
        let instead =
            InsteadConstant { error: ErrorName::motion(component, self.name), side: self.side };
        match (self.kind, component.is_angular()) {
            (AxisKind::Linear, false) => Some(NoEffect::OffsetOfLinearAxis(instead)),
            (AxisKind::Rotary, _) if along_itself => Some(NoEffect::AlongRotaryAxis(instead)),
            (AxisKind::Linear, true) if along_itself => Some(NoEffect::AboutLinearAxis(instead)),
            _ => None,
        }
    }
}

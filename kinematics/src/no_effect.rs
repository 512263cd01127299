use nalgebra::Vector3;
use volcomp_vocabulary::{AxisKind, Component, ErrorName};

use crate::{
    chain::Joint,
    error::{InsteadConstant, NoEffect},
};

/// The machine axis (0, 1 or 2 for X, Y or Z) to which a unit vector is parallel, and whether the vector points in its
/// positive direction. `None` if the vector is parallel to none of the three.
pub fn along_machine_axis(direction: &Vector3<f64>) -> Option<(usize, bool)> {
    let place = direction.iter().position(|u| u.abs() > 1.0 - 1e-12)?;
    Some((place, direction[place] > 0.0))
}

impl Joint {
    /// Why a location error of this axis with this component has no effect; `None` if it has an effect.
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

//! The rule which location errors move nothing.

use volcomp_vocabulary::{AxisKind, Component, ErrorName};

use crate::{
    chain::Joint,
    error::{InsteadConstant, NoEffect},
};

/// A location error is along or about the axis itself when this share of its direction is.
const ALONG_ITSELF: f64 = 1.0 - 1e-12;

impl Joint {
    /// Why a location error of this axis in a component moves nothing; `None` where it moves something.
    pub fn no_effect(&self, component: Component) -> Option<NoEffect> {
        let place = component.mcs_index();
        let along_itself = self.direction[place].abs() > ALONG_ITSELF;
        let instead = InsteadConstant {
            error: ErrorName::motion(component, self.name),
            side: self.side,
        };
        match (self.kind, component.is_angular()) {
            (AxisKind::Linear, false) => Some(NoEffect::OffsetOfLinearAxis(instead)),
            (AxisKind::Rotary, _) if along_itself => Some(NoEffect::AlongRotaryAxis(instead)),
            (AxisKind::Linear, true) if along_itself => Some(NoEffect::AboutLinearAxis(instead)),
            _ => None,
        }
    }
}

//! How large each error is over travel, and which are zero or not stated.

use volcomp_model::{Component, ErrorName, Machine};
use volcomp_vocabulary::{AxisKind, AxisName};

use super::{Size, text::meaning};

/// The errors of a machine by what is known of them.
pub(super) struct Sizes {
    pub(super) there: Vec<Size>,
    pub(super) zero: Vec<ErrorName>,
    pub(super) not_stated: Vec<ErrorName>,
}

/// Every error motion of every axis and the location errors that ISO 230-1 names, axis by axis.
pub(super) fn sizes(machine: &Machine, axes: &[AxisName]) -> Sizes {
    let mut sizes = Sizes {
        there: Vec::new(),
        zero: Vec::new(),
        not_stated: Vec::new(),
    };
    for &axis in axes {
        for component in Component::ALL {
            let name = ErrorName::motion(component, axis);
            match machine.range_of(name) {
                Some(range) => sizes.take(Size {
                    name,
                    meaning: meaning(name),
                    unit: component.unit(),
                    smallest: range.smallest,
                    largest: range.largest,
                    at: Some(range.at.into_iter().collect()),
                }),
                None => sizes.not_stated.push(name),
            }
        }
        for component in Component::ALL {
            let name = ErrorName::location(component, axis);
            match machine.locations().get(&name) {
                Some(&value) => sizes.take(Size {
                    name,
                    meaning: meaning(name),
                    unit: component.unit(),
                    smallest: value,
                    largest: value,
                    at: None,
                }),
                None if is_expected(name, axes) => sizes.not_stated.push(name),
                None => {}
            }
        }
    }
    sizes
}

impl Sizes {
    fn take(&mut self, size: Size) {
        if size.smallest == 0.0 && size.largest == 0.0 {
            self.zero.push(size.name);
        } else {
            self.there.push(size);
        }
    }
}

/// Whether a machine with these axes usually has the location error: squareness between X, Y and Z, shift and tilt
/// of the line of a rotary axis.
fn is_expected(name: ErrorName, axes: &[AxisName]) -> bool {
    match name.axis.kind() {
        AxisKind::Rotary => name.component.mcs_index() != name.axis.mcs_index(),
        AxisKind::Linear => {
            let reference = match (name.component, name.axis) {
                (Component::EC, AxisName::Y) | (Component::EB, AxisName::Z) => AxisName::X,
                (Component::EA, AxisName::Z) => AxisName::Y,
                _ => return false,
            };
            axes.contains(&reference)
        }
    }
}

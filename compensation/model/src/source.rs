//! The errors of a machine as an error source for kinematics.

use volcomp_kinematics::{ErrorMotion, ErrorSource, State};
use volcomp_vocabulary::{Component, ErrorName, MAX_AXES};

use crate::{machine::Machine, thermal::Temperatures};

/// The errors of a machine at steady temperatures: an [`ErrorSource`] in mm and rad over curves in
/// µm and µrad.
#[derive(Clone, Debug)]
pub struct MachineErrors<'a> {
    machine: &'a Machine,
    /// Offset (µm or µrad) and slope (per mm) that the thermal terms add.
    thermal: [[[f64; 2]; 6]; MAX_AXES],
    location: [ErrorMotion; MAX_AXES],
}

impl<'a> MachineErrors<'a> {
    pub(crate) fn new(machine: &'a Machine, temperatures: &Temperatures) -> Self {
        let mut thermal = [[[0.0; 2]; 6]; MAX_AXES];
        let mut location = [ErrorMotion::ZERO; MAX_AXES];
        for index in 0..machine.axes().len() {
            thermal[index] = machine.thermal_of(index, temperatures);
            location[index] = machine.location_of(index);
        }
        Self {
            machine,
            thermal,
            location,
        }
    }
}

impl Machine {
    /// Offset (µm or µrad) and slope (per mm) that the thermal terms add to each error motion of an axis.
    pub(crate) fn thermal_of(&self, axis: usize, temperatures: &Temperatures) -> [[f64; 2]; 6] {
        let name = self.axes()[axis].name;
        let direction = self.chain().joints()[axis].direction;
        Component::ALL.map(|component| {
            let error = ErrorName::motion(component, name);
            self.thermal()
                .offset_and_slope(error, &direction, temperatures)
        })
    }
}

impl ErrorSource for MachineErrors<'_> {
    fn error_motion(&self, axis: usize, state: &State) -> ErrorMotion {
        if axis >= self.machine.axes().len() {
            return ErrorMotion::ZERO;
        }
        let coordinates = self.machine.curve_coordinates(state);
        let branch = state.approach[axis];
        let mut six = [0.0; 6];
        for (component, value) in six.iter_mut().enumerate() {
            let [offset, slope] = self.thermal[axis][component];
            *value = offset + slope * coordinates[axis];
            if let Some(curve) = self.machine.curve(axis, component) {
                *value += curve.value(axis, &coordinates[..], branch);
            }
        }
        ErrorMotion::from_um_urad(six)
    }

    fn location(&self, axis: usize) -> ErrorMotion {
        self.location.get(axis).copied().unwrap_or_default()
    }

    fn assembly(&self, axis: usize) -> ErrorMotion {
        ErrorMotion::from_um_urad(self.machine.assembly(axis))
    }
}

//! What the machine file asks for over the travels: how large the correction of each axis becomes.

use volcomp_kinematics::State;
use volcomp_model::ModelError;
use volcomp_runtime::PathPlan;
use volcomp_vocabulary::{AxisName, Displacement, PerAxis};

use super::Plan;
use crate::documents::{ByAxis, round};

/// What the machine file asks of a path within the travels, µm and µrad.
pub(super) struct Needs {
    /// The largest correction of each axis that corrects, without what temperatures add.
    pub(super) up_to: ByAxis,
    /// How much more temperatures may add to it with each kelvin of the sensors; empty without thermal terms.
    pub(super) per_k: ByAxis,
}

/// What a machine file asks of each path.
pub(super) fn of_paths(plan: &Plan) -> Result<Vec<Needs>, ModelError> {
    let kelvin = plan.machine.each_kelvin()?;
    let largest = |path: &PathPlan, of: &dyn Fn(&State) -> PerAxis<f64>| -> ByAxis {
        let all = plan
            .machine
            .largest_within_travels(&path.correctors, &path.fixed, of);
        all.into_iter().map(micro).collect()
    };
    let of_path = |path: &PathPlan| {
        let correction = |state: &State| plan.model.correction_of(state, &path.correctors).delta;
        let mut needs = Needs {
            up_to: if path.only_thermal {
                ByAxis::new()
            } else {
                largest(path, &correction)
            },
            per_k: kelvin.as_ref().map_or_else(ByAxis::new, |kelvin| {
                largest(path, &|state| kelvin.change(state, &path.correctors))
            }),
        };
        needs.per_k.retain(|_, most| *most > 0.0);
        needs
    };
    Ok(plan.paths.iter().map(of_path).collect())
}

fn micro((name, most): (AxisName, Displacement)) -> (AxisName, f64) {
    (name, round((most.um_or_urad() * 10.0).ceil() / 10.0))
}

//! Plans of controllers without a barrier whose rotary axes do not correct.

use volcomp_port::{Axis, Clock, Controller, Description};
use volcomp_runtime::{AxisSettings, Model, PathPlan, PlanError, WithoutBarrier};
use volcomp_vocabulary::{AxisName, Displacement, Um, Urad};

use crate::rig::{NAMES, PERIOD, alone, control, guard, machine};

/// The plan for a control of the five-axis machine whose rotary axes have steps of so many µrad.
fn plan(
    step_urad: f64,
    barrier: bool,
    rotary: Option<AxisSettings<Urad>>,
) -> Result<PathPlan, PlanError> {
    let mut description: Description = control([0.0; 5], &Clock::manual()).description().clone();
    let of = |name: &AxisName| Axis {
        name: *name,
        includes_correction: false,
        resolution: Displacement::from_micro(
            name.kind(),
            if name.is_rotary() { step_urad } else { 1.0 },
        ),
        largest: None,
    };
    let machine = machine();
    description.axes = NAMES.iter().map(of).collect();
    description.barrier = barrier;
    let mut guard = guard();
    guard.rotary = rotary;
    guard.rotary_step = Um(5.0);
    // As shipped.
    guard.without_barrier = WithoutBarrier::default();
    let model = Model::new(&machine, guard.fading).expect("compiles");
    let mut settings = alone();
    settings.barrier = barrier.then_some(volcomp_runtime::BarrierSettings {
        machine: 1,
        scan: std::time::Duration::from_millis(2),
    });
    PathPlan::new(description, &model, &guard, &settings, PERIOD)
}

/// Rotary axes in steps of 0.01 degrees are not corrected, since half a step moves the tip too far: they need no limits.
#[test]
fn rotary_axes_that_are_too_coarse_to_correct_need_no_limits_without_a_barrier() {
    let step_urad = 0.01_f64.to_radians() * 1e6;
    let stated = AxisSettings::new(Urad(250.0), Urad(500.0));
    for barrier in [true, false] {
        for rotary in [Some(stated), None] {
            let plan = plan(step_urad, barrier, rotary);
            let told = plan
                .as_ref()
                .map(|plan| plan.left_out.len())
                .map_err(ToString::to_string);
            assert_eq!(
                told,
                Ok(2),
                "barrier {barrier}, limits {}",
                rotary.is_some()
            );
        }
    }
}

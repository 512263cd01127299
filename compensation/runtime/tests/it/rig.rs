//! A five-axis machine with a control that names its axes in another order, at one position.

use std::{path::Path, sync::Arc, time::Duration};

use volcomp_model::Machine;
use volcomp_port::{Axis, Clock, Controller, simulated};
use volcomp_runtime::{
    Asked, AxisSettings, ControlPath, Cycle, GuardSettings, Model, PathPlan, PathSettings, Report,
    Sensors, WithoutBarrier,
    guard::{Limits, Request},
};
use volcomp_vocabulary::{AxisName, Displacement, PerChannel, Um, Urad};

pub(crate) const PERIOD: Duration = Duration::from_millis(4);
pub(crate) const NAMES: [AxisName; 5] = [
    AxisName::Z,
    AxisName::B,
    AxisName::X,
    AxisName::C,
    AxisName::Y,
];

/// The five-axis machine of the examples.
pub(crate) fn machine() -> Machine {
    let file = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples/five-axis.toml");
    Machine::read(&file).expect("shipped")
}

pub(crate) fn guard() -> GuardSettings {
    let mut guard = GuardSettings::new(AxisSettings::new(Um(250.0), Um(500.0)));
    guard.rotary = Some(AxisSettings::new(Urad(250.0), Urad(500.0)));
    // The simulated control has no barrier.
    guard.without_barrier = WithoutBarrier {
        linear: Um(2000.0),
        rotary: Urad(2000.0),
    };
    guard
}

/// A control that stands at a place, coordinates in mm and deg in the order of [`NAMES`].
pub(crate) fn control(place: [f64; 5], clock: &Clock) -> simulated::SimulatedController {
    control_of(place, clock, &NAMES)
}

/// The same control, which writes only the axes named; the others stand where the settings say.
fn control_of(
    place: [f64; 5],
    clock: &Clock,
    names: &[AxisName],
) -> simulated::SimulatedController {
    let mut to = PerChannel::ZERO;
    for (to, name) in to.iter_mut().zip(names) {
        let at = NAMES.iter().zip(place).find(|(known, _)| *known == name);
        let (name, at) = at.expect("one of the machine");
        *to = Displacement::from_coordinate(name.kind(), at).mm_or_rad();
    }
    let machine = simulated::Machine {
        axes: names
            .iter()
            .map(|&name| Axis {
                name,
                includes_correction: false,
                resolution: Displacement::new(name.kind(), 1e-8),
                largest: None,
            })
            .collect(),
        program: vec![simulated::Move {
            to,
            feed_per_s: 1.0,
            dwell: Duration::from_secs(3600),
        }],
        acceleration_per_s2: 1.0,
        sensors: Vec::new(),
        truth: Arc::new(|_, _| PerChannel::ZERO),
        clock: clock.clone(),
    };
    machine.start().0
}

/// Settings for a control that nobody else reaches.
pub(crate) fn alone() -> PathSettings {
    PathSettings {
        watch: Duration::ZERO,
        ..PathSettings::default()
    }
}

/// A cycle at a place, and its time.
pub(crate) struct Rig {
    pub(crate) cycle: Cycle,
    /// The limits of its path as they were planned.
    pub(crate) limits: Limits,
    pub(crate) clock: Clock,
}

impl Rig {
    pub(crate) fn at(place: [f64; 5]) -> Self {
        Self::writing(place, &NAMES)
    }

    /// With a control that writes only the axes named; the others are fixed at the place.
    pub(crate) fn writing(place: [f64; 5], names: &[AxisName]) -> Self {
        Self::of(&machine(), &guard(), place, names)
    }

    /// The same with another machine and other settings.
    pub(crate) fn of(
        machine: &Machine,
        guard: &GuardSettings,
        place: [f64; 5],
        names: &[AxisName],
    ) -> Self {
        let clock = Clock::manual();
        let model = Model::new(machine, guard.fading).expect("compiles");
        let control = control_of(place, &clock, names);
        let described = control.description().clone();
        let others = NAMES
            .iter()
            .zip(place)
            .filter(|(name, _)| !names.contains(name) && model.index_of(**name).is_some());
        let settings = PathSettings {
            fixed: others
                .map(|(&name, at)| (name, Displacement::from_coordinate(name.kind(), at)))
                .collect(),
            ..alone()
        };
        let plan = PathPlan::new(described, &model, guard, &settings, PERIOD);
        let plan = plan.expect("fits");
        let path = ControlPath::new(Box::new(control), &plan).expect("fits");
        let sensors = Sensors::new(Vec::new(), guard.temperatures);
        let cycle = Cycle::new(
            Box::new(model),
            vec![path],
            guard.hand_back,
            sensors,
            PERIOD,
        );
        Self {
            cycle: cycle.expect("one path").with_start(clock.start()),
            clock,
            limits: plan.limits,
        }
    }

    /// One cycle.
    pub(crate) fn step(&mut self, request: Option<Request>) -> Report {
        self.clock.advance(PERIOD);
        let asked = Asked {
            request,
            ..Asked::default()
        };
        self.cycle
            .run(self.clock.now(), &asked, &mut || Duration::ZERO);
        *self.cycle.report()
    }

    pub(crate) fn run(&mut self, cycles: u32) -> Report {
        (1..cycles).for_each(|_| {
            self.step(None);
        });
        self.step(None)
    }
}

//! Two ways to one control, the second of which writes fewer axes than the first.

use std::time::Duration;

use volcomp_port::{Clock, Description, Fault, Snapshot};
use volcomp_runtime::{
    AxisSettings, Cycle, GuardSettings, PathSettings, PlanError, Report,
    guard::{ControlTimeOut, Reasons, Request, State},
};
use volcomp_vocabulary::{AxisName, PerChannel, Um};

use crate::{
    rig::{PERIOD, alone, referenced, without_barrier},
    ways::{AXES, Plant, Ways, three_axes},
};

/// Z needs +20 µm at X 10 mm.
const ERRORS: &str = "EZX = { poly = [-25, 0.5] }";
/// So long after its last write the first way goes to zero, and so long it takes.
const TIME_OUT: ControlTimeOut = ControlTimeOut {
    after: Duration::from_millis(200),
    to_zero: Duration::from_millis(100),
};

/// The control: its words, when they were written last, and whether the first way is away.
#[derive(Default)]
struct Control {
    words: PerChannel<f64>,
    written: Duration,
    first_is_away: bool,
}

fn is_first(way: &Description) -> bool {
    way.axes.len() == AXES.len()
}

impl Control {
    fn answers(&self, way: &Description) -> Result<(), Fault> {
        if is_first(way) && self.first_is_away {
            return Err(Fault::TimedOut);
        }
        Ok(())
    }
}

impl Plant for Control {
    fn read(&mut self, way: &Description, clock: &Clock) -> Result<Snapshot, Fault> {
        self.answers(way)?;
        let applied = way.tells_applied.then_some(self.words);
        Ok(referenced(
            PerChannel::leading([10.0]),
            clock.now(),
            applied,
        ))
    }

    fn apply(
        &mut self,
        way: &Description,
        corrections: &PerChannel<f64>,
        clock: &Clock,
    ) -> Result<(), Fault> {
        self.answers(way)?;
        let count = way.axes.len();
        self.words[..count].copy_from_slice(&corrections[..count]);
        if is_first(way) {
            self.written = clock.elapsed();
        }
        Ok(())
    }
}

/// The first way goes to zero by itself where it has a time-out.
fn cycle(
    axes: [&[AxisName]; 2],
    time_out: Option<ControlTimeOut>,
    ways: &Ways<Control>,
) -> Result<Cycle, PlanError> {
    let mut guard = GuardSettings::new(AxisSettings::new(Um(30.0), Um(500.0)));
    guard.ramp = Duration::from_millis(200);
    let model = three_axes(ERRORS, &guard);
    let paths = axes.map(|axes| {
        let others = AXES.iter().filter(|name| !axes.contains(name));
        let time_out = time_out.filter(|_| axes.len() == AXES.len());
        let description = Description {
            reads: others.copied().collect(),
            tells_applied: time_out.is_none(),
            ..without_barrier("control", axes)
        };
        let settings = PathSettings {
            time_out,
            ..alone()
        };
        ways.path(description, &model, &guard, &settings)
    });
    ways.cycle(model, &guard, paths.into())
}

/// The words of Z stayed at 20 µm for good, and 0 µm was shown.
#[test]
fn a_path_whose_axes_another_does_not_write_must_go_to_zero_by_itself() {
    let ways = Ways::to(Control::default(), Clock::manual());
    let made = |axes, time_out| cycle(axes, time_out, &ways);
    let few = &AXES[..2];
    for axes in [[&AXES[..], few], [few, &AXES[..]]] {
        let refused = made(axes, None).map(|_| ()).expect_err("Z would be left");
        assert!(
            matches!(
                refused,
                PlanError::LeavesAxis {
                    axis: AxisName::Z,
                    ..
                }
            ),
            "{refused}"
        );
        assert!(made(axes, Some(TIME_OUT)).is_ok(), "it goes to zero");
    }
    let other_order = [AxisName::Z, AxisName::X, AxisName::Y];
    assert!(made([&AXES, &other_order], None).is_ok());
}

/// The first way holds 20 µm on Z when it falls silent; the second writes X and Y.
#[test]
fn fewer_axes_take_over_once_the_others_are_at_zero() {
    let ways = Ways::to(Control::default(), Clock::manual());
    let mut cycle = cycle([&AXES, &AXES[..2]], Some(TIME_OUT), &ways).expect("fits");
    let mut reports: Vec<Report> = Vec::new();
    for number in 0..1500 {
        ways.clock.advance(PERIOD);
        {
            let mut plant = ways.plant();
            plant.first_is_away = number >= 1000;
            let silent = ways.clock.elapsed().saturating_sub(plant.written);
            if silent > TIME_OUT.after + TIME_OUT.to_zero {
                plant.words[2] = 0.0;
            }
        }
        let report = ways.run(&mut cycle, (number == 50).then_some(Request::Arm));
        let word = ways.plant().words[2];
        assert!(
            report.active == 0 || word == 0.0,
            "cycle {number}: {word} mm are left on Z"
        );
        reports.push(report);
    }
    assert!((reports[999].correction[2] - 0.020).abs() < 0.001);
    let waits = reports[1050].reasons;
    assert!(waits.contains(Reasons::OTHER_CHANNEL_UNKNOWN), "{waits:?}");
    let last = &reports[1499];
    assert_eq!((last.state, last.active), (State::Compensating, 1));
}

//! Three axes behind a barrier, and a second way that writes two of them: it takes over when nothing is left on the third.

use std::time::Duration;

use volcomp_port::{Clock, Description, Fault, Snapshot, Words};
use volcomp_runtime::{
    AxisSettings, BarrierSettings, ControlPath, GuardSettings, Model, PathSettings,
    guard::{
        ControlTimeOut, Request, State,
        barrier::{Barrier, REPORT_WORDS},
    },
};
use volcomp_vocabulary::{PerChannel, Um};

use crate::{
    rig::{PERIOD, alone, referenced, without_barrier},
    ways::{AXES, Plant, Ways, barrier_of_three_axes, three_axes},
};

/// Z needs 120 µm.
const ERRORS: &str = "EZZ = -120";
const SCAN: Duration = Duration::from_millis(2);

/// The control: its barrier, its mailbox, and what it shows.
struct Control {
    barrier: Barrier,
    mailbox: Option<Vec<u16>>,
    first_is_away: bool,
    stop: bool,
}

impl Plant for Control {
    fn read(&mut self, way: &Description, clock: &Clock) -> Result<Snapshot, Fault> {
        let mut snapshot = referenced(PerChannel::leading([10.0]), clock.now(), None);
        if !way.barrier {
            snapshot.state.emergency_stop = self.stop;
            return Ok(snapshot);
        }
        if self.first_is_away {
            return Err(Fault::TimedOut);
        }
        let mut words = [0; REPORT_WORDS];
        let length = self.barrier.report().encode(&mut words);
        snapshot.report = Words::new(&words[..length]);
        Ok(snapshot)
    }

    fn post(&mut self, _: &Description, frame: &Words) -> Result<(), Fault> {
        if self.first_is_away {
            return Err(Fault::TimedOut);
        }
        self.mailbox = Some(frame.as_slice().to_vec());
        Ok(())
    }

    fn apply(&mut self, _: &Description, _: &PerChannel<f64>, _: &Clock) -> Result<(), Fault> {
        Ok(())
    }
}

fn way(first: bool, ways: &Ways<Control>, model: &Model) -> ControlPath {
    let guard = guard();
    let axes = if first { &AXES[..] } else { &AXES[..2] };
    let description = Description {
        barrier: first,
        tells_applied: first,
        reads: (AXES.iter().filter(|name| !axes.contains(name)).copied()).collect(),
        ..without_barrier("control", axes)
    };
    let settings = PathSettings {
        barrier: first.then_some(BarrierSettings {
            machine: 1,
            scan: SCAN,
        }),
        // The way of X and Y goes to zero by itself, too.
        time_out: (!first).then_some(ControlTimeOut {
            after: Duration::from_millis(200),
            to_zero: Duration::from_millis(100),
        }),
        proves: false,
        ..alone()
    };
    ways.path(description, model, &guard, &settings)
}

fn guard() -> GuardSettings {
    let mut guard = GuardSettings::new(AxisSettings::new(Um(150.0), Um(500.0)));
    guard.ramp = Duration::from_millis(200);
    guard.zero_after = Duration::from_secs(3);
    guard
}

/// The most that Z has, counts, while the second way writes, and whether it did. The first one is cut off from cycle 1500 on;
/// an emergency stop, which the second shows, lasts until cycle `stop_until`.
fn left_on_z(real_scan: Duration, time_out_scans: u16, stop_until: i32) -> (i16, bool) {
    let control = Control {
        barrier: barrier_of_three_axes(25, time_out_scans),
        mailbox: None,
        first_is_away: false,
        stop: false,
    };
    let ways = Ways::to(control, Clock::manual());
    let guard = guard();
    let model = three_axes(ERRORS, &guard);
    let paths = [true, false].map(|first| way(first, &ways, &model));
    let mut cycle = ways.cycle(model, &guard, paths.into()).expect("fits");
    let mut scanned = Duration::ZERO;
    let (mut most, mut taken_over) = (0, false);
    for number in 0..4000 {
        ways.clock.advance(PERIOD);
        let mut control = ways.plant();
        control.first_is_away = number >= 1500;
        control.stop = (1500..stop_until).contains(&number);
        while scanned + real_scan <= ways.clock.elapsed() {
            scanned += real_scan;
            let (mailbox, stop) = (control.mailbox.clone(), control.stop);
            let mailboxes: Vec<&[u16]> = mailbox.as_deref().into_iter().collect();
            control.barrier.scan(&mailboxes, stop);
        }
        drop(control);
        let report = ways.run(&mut cycle, (number == 700).then_some(Request::Arm));
        assert!(number != 1499 || report.state == State::Compensating);
        if report.active == 1 {
            taken_over = true;
            most = most.max(ways.plant().barrier.memory().applied[2]);
        }
    }
    (most, taken_over)
}

/// A control whose scans are longer than configured, and yet accepted, had 120 µm on Z when the second way took over.
#[test]
fn a_slow_control_is_at_zero_when_fewer_axes_take_over() {
    let found = left_on_z(Duration::from_micros(2450), 1000, 0);
    assert_eq!(found, (0, true));
}

/// A barrier holds in a stop; the time until it is taken for zero ran on, and 112 µm were left on Z.
#[test]
fn a_stop_does_not_count_until_fewer_axes_take_over() {
    assert_eq!(left_on_z(SCAN, 100, 2500), (0, true));
}

//! The guard over digital lines: corrections that reach the axes.

use std::{
    sync::{Arc, Mutex},
    time::{Duration, Instant},
};

use volcomp_digital_io::{Coherence, DigitalAxis, DigitalController, Panel, Wiring};
use volcomp_guard::{
    AxisLimits, CorrectionReport, Guard, Inputs, Limits, Output, ReadBack, Reading, Reasons,
    Request, RequestedCorrection, State,
};
use volcomp_port::Controller;
use volcomp_vocabulary::{AxisKind, AxisName, MAX_AXES, PerChannel};

const PERIOD: Duration = Duration::from_millis(4);
const GOAL: f64 = 0.025;

fn limits(count: usize) -> Limits {
    let axis = AxisLimits {
        kind: AxisKind::Linear,
        limit: 0.030,
        warn: 0.030,
        slew_per_s: 0.5,
        accel_per_s2: f64::INFINITY,
        resolution: 0.001,
        includes_correction: false,
    };
    Limits {
        axes: [axis; MAX_AXES],
        count,
        period: PERIOD,
        hold: Duration::from_millis(200),
        zero_after: Duration::from_millis(500),
        ramp: Duration::from_millis(80),
        test_shift: PerChannel::ZERO,
        read_back_cycles: 1,
        only_thermal: false,
    }
}

/// A guard that corrects axes through a simulated panel.
struct Rig {
    panel: Panel,
    controller: DigitalController<Panel>,
    limits: Limits,
    guard: Guard,
    read_back: ReadBack,
    now: Duration,
}

impl Rig {
    fn new(wiring: Wiring, names: &[AxisName]) -> Self {
        let axes: Vec<_> = names.iter().copied().map(DigitalAxis::published).collect();
        let panel = Panel::new(wiring.clone(), axes.clone());
        let coherence = Coherence::Latched;
        let controller = DigitalController::new(panel.clone(), "lines", wiring, coherence, axes);
        let limits = limits(names.len());
        Self {
            panel,
            controller: controller.unwrap(),
            guard: Guard::new(limits).unwrap(),
            limits,
            read_back: ReadBack::no_read_back(None),
            now: Duration::ZERO,
        }
    }

    /// Runs one cycle; `None` until every axis was selected once.
    fn cycle(&mut self, request: Option<Request>) -> Option<Output> {
        self.now += PERIOD;
        let now = self.now;
        let snapshot = self.controller.read(Instant::now()).ok()?;
        let applied = snapshot.applied.map_or(CorrectionReport::Missing, CorrectionReport::Values);
        self.read_back.receive(now, now, &applied, &self.limits);
        let requested = PerChannel::from_fn(|i| if i < self.limits.count { GOAL } else { 0.0 });
        let out = self.guard.cycle(&Inputs {
            now,
            reading: Some(Reading { taken: now, positions: snapshot.positions }),
            read_back: *self.read_back.status(),
            requested: Some(RequestedCorrection::linear(requested)),
            request,
            ..Inputs::default()
        });
        if out.write {
            let soon = Instant::now() + Duration::from_secs(1);
            let written = self.controller.apply(&out.correction, soon);
            self.read_back.sent(now, &out.correction, written.is_ok());
        }
        Some(out)
    }
}

/// The last word before disarming is latched: the control is at 0 and no step exceeds 2 µm. Without the last edge, 0
/// would be reported while the control keeps 1 to 3 µm, and in motion the control would then accept two slews at once.
#[test]
fn the_last_word_is_latched() {
    let wiring = Wiring { latch: Some(8), ..Wiring::published() };
    for disarmed_in in 150..170 {
        let mut rig = Rig::new(wiring.clone(), &[AxisName::X]);
        // Level of the latch, the correction that the control applies, and its largest step, µm.
        let control = Arc::new(Mutex::new((false, 0_i32, 0_i32)));
        let takes = Arc::clone(&control);
        rig.panel.on_write(move |word| {
            let (latch, applied, largest) = &mut *takes.lock().unwrap();
            if word.latch != *latch {
                let to = word.counts.unwrap();
                *largest = (to - *applied).abs().max(*largest);
                (*latch, *applied) = (word.latch, to);
            }
        });
        let mut state = State::Disarmed;
        for cycle in 0..400 {
            let request = match cycle {
                30 => Some(Request::Arm),
                _ if cycle == disarmed_in => Some(Request::Disarm),
                _ => None,
            };
            state = rig.cycle(request).unwrap().state;
        }
        let (_, applied, largest) = *control.lock().unwrap();
        assert_eq!((state, applied), (State::Disarmed, 0), "{disarmed_in}");
        assert!((1..=2).contains(&largest), "{largest} µm in one step");
    }
}

/// With axes that share lines in turn, no step exceeds 2 µm, because only the selected axis counts as written.
#[test]
fn axes_that_share_lines_do_not_step() {
    let wiring = Wiring { select: vec![15], echo: vec![8], ..Wiring::published() };
    let mut rig = Rig::new(wiring, &[AxisName::X, AxisName::Y]);
    let mut applied = [0_i32; 2];
    let mut largest = 0;
    for cycle in 0..3000 {
        // The control selects each axis for 60 ms, and accepts corrections of the selected one only.
        let shows = cycle / 15 % 2;
        rig.panel.shows(shows, 100.0);
        let request = (cycle == 30).then_some(Request::Arm);
        let out = rig.cycle(request);
        let word = rig.panel.word();
        if word.axis == shows {
            let to = word.counts.unwrap();
            largest = largest.max((to - applied[shows]).abs());
            applied[shows] = to;
        }
        if cycle == 2999 {
            let out = out.unwrap();
            assert_eq!(out.state, State::Compensating, "{:?}", out.reasons);
        }
    }
    assert_eq!(applied, [25, 25]);
    assert!((1..=2).contains(&largest), "{largest} µm in one step");
}

/// The device loses its outputs for a moment and reports them as off. The control is then at 0 if it saw an edge of the
/// latch, and keeps its correction if not. In both cases no step exceeds 2 µm when the device is back.
#[test]
fn lines_that_were_off_for_a_moment_do_not_step() {
    let wiring = Wiring { latch: Some(8), ..Wiring::published() };
    for lost_in in 150..160 {
        let mut rig = Rig::new(wiring.clone(), &[AxisName::X]);
        // The latch, the correction that the control applies, and its largest step, µm.
        let control = Arc::new(Mutex::new((false, 0_i32, 0_i32)));
        let takes = Arc::clone(&control);
        rig.panel.on_write(move |word| {
            let (latch, applied, largest) = &mut *takes.lock().unwrap();
            if word.latch != *latch {
                let to = word.counts.unwrap();
                *largest = (to - *applied).abs().max(*largest);
                (*latch, *applied) = (word.latch, to);
            }
        });
        for cycle in 0..400 {
            if cycle == lost_in {
                rig.panel.left_at(0);
                let (latch, applied, _) = &mut *control.lock().unwrap();
                assert_eq!(*applied, 25, "{lost_in}");
                if std::mem::take(latch) {
                    *applied = 0;
                }
            }
            rig.cycle((cycle == 30).then_some(Request::Arm)).unwrap();
        }
        let (_, applied, largest) = *control.lock().unwrap();
        assert_eq!(applied, 25, "{lost_in}");
        assert!((1..=2).contains(&largest), "{largest} µm in one step, lost in {lost_in}");
    }
}

/// The most negative word encodes no correction, so the correction on the lines is unknown: the guard does not arm over it and writes nothing over
/// it.
#[test]
fn a_word_that_is_no_correction_is_not_overwritten() {
    for left_in in [0, 150] {
        let mut rig = Rig::new(Wiring::published(), &[AxisName::X]);
        let mut last = None;
        for cycle in 0..400 {
            if cycle == left_in {
                rig.panel.left_at(0x80);
            }
            last = rig.cycle((cycle == 30).then_some(Request::Arm));
        }
        let out = last.unwrap();
        assert_eq!(rig.panel.levels(), 0x80, "{left_in}");
        assert!(out.reasons.contains(Reasons::UNCONFIRMED), "{left_in}: {:?}", out.reasons);
        assert_eq!(out.state == State::Disarmed, left_in == 0, "{left_in}: {:?}", out.state);
        assert_ne!(out.state, State::Compensating, "{left_in}");
    }
}

//! A five-axis correction behind a barrier: tip error while the rotary axes move.

use std::{collections::VecDeque, time::Duration};

use volcomp_guard::{
    AxisLimits, BarrierLink, CorrectionReport, Guard, Inputs, Limits, ReadBack, Reading, Reasons,
    Request, RequestedCorrection,
    barrier::{Barrier, FRAME_WORDS, REPORT_WORDS, Settings},
    protocol::{Counts, Layout},
    vocabulary::{AxisKind, AxisName, PerChannel},
};

use crate::vector::{five, of};

const LEVER_MM: f64 = 300.0;

struct Case {
    linear_step: f64,
    rotary_step: f64,
    /// Delay from the guard to the barrier and back, cycles.
    delay: usize,
    /// Ratio of the barrier's rate to the guard's slew.
    rate: f64,
}

fn limits(case: &Case) -> Limits {
    let mut limits = five(0.0);
    for axis in limits.axes.iter_mut().take(5) {
        let rotary = axis.kind == AxisKind::Rotary;
        *axis = AxisLimits {
            limit: if rotary { 250e-6 } else { 0.250 },
            warn: f64::INFINITY,
            resolution: if rotary { case.rotary_step } else { case.linear_step },
            accel_per_s2: f64::INFINITY,
            includes_correction: false,
            ..*axis
        };
        axis.warn = axis.limit;
    }
    limits.hold = Duration::from_millis(100);
    limits.test_shift = PerChannel::ZERO;
    limits.read_back_cycles = 2 * case.delay + 2;
    limits
}

/// Largest tip error of the applied correction (mm) in cycles that the slew does not limit.
#[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "small whole numbers")]
fn off(case: &Case) -> f64 {
    let limits = limits(case);
    let layout = [AxisName::X, AxisName::Y, AxisName::Z, AxisName::A, AxisName::C];
    let layout = Layout::of(layout).expect("each once");
    // The period of a scan is 2 ms.
    let in_a_scan =
        |i: usize| limits.axes[i].slew_per_s * case.rate * 0.002 / limits.axes[i].resolution;
    let step_scans = (0..5).map(|i| (1.0 / in_a_scan(i) - 1e-9).ceil()).fold(1.0, f64::max);
    let counts = |value: f64| (value - 1e-9).ceil() as i16;
    let of_axes = |value: &dyn Fn(usize) -> f64| {
        Counts::from_fn(|i| if i < 5 { counts(value(i)) } else { 0 })
    };
    let settings = Settings {
        axes: layout,
        machine: 1,
        limit: of_axes(&|i| limits.axes[i].limit / limits.axes[i].resolution),
        rate: of_axes(&|i| in_a_scan(i) * step_scans),
        step_scans: step_scans as u16,
        hold_scans: 50,
        time_out_scans: 150,
    };
    let mut barrier = Barrier::start(settings, 0, 0, &Counts::default()).expect("valid");
    let link = BarrierLink::new(7, 1, layout, Duration::from_millis(2));
    let mut way = ReadBack::barrier(link);
    let mut guard = Guard::new(limits).expect("valid");
    let (mut frames, mut reports) = (VecDeque::new(), VecDeque::new());
    let mut mailbox = [0; FRAME_WORDS];
    let (mut most, mut quiet) = (0.0_f64, 0);
    let mut requested = RequestedCorrection {
        rotary: of([0.0, 0.0, 0.0, 100e-6, -60e-6]),
        ..RequestedCorrection::default()
    };
    // The request moves Y and Z only to follow A and C.
    requested.follow[3] = of([0.0, LEVER_MM]);
    requested.follow[4] = of([0.0, 0.0, -0.7 * LEVER_MM]);
    for cycle in 0..1200_u32 {
        let now = Duration::from_millis(4) * (cycle + 1);
        if frames.len() > case.delay {
            mailbox = frames.pop_front().expect("some");
        }
        barrier.scan(&[&mailbox], false);
        let mut words = [0; REPORT_WORDS];
        let length = barrier.scan(&[&mailbox], false).encode(&mut words);
        reports.push_back((words, length, now));
        if reports.len() > case.delay {
            let (words, length, taken) = reports.pop_front().expect("some");
            way.receive(now, taken, &CorrectionReport::Barrier(&words[..length]), &limits);
        } else {
            way.receive(now, now, &CorrectionReport::Missing, &limits);
        }
        let out = guard.cycle(&Inputs {
            now,
            reading: Some(Reading { taken: now, positions: PerChannel::ZERO }),
            read_back: *way.status(),
            requested: Some(requested),
            request: (cycle == 450).then_some(Request::Arm),
            ..Inputs::default()
        });
        if out.write {
            let mut frame = [0; FRAME_WORDS];
            if way.frame(&out.correction, &limits, &mut frame).is_some() {
                frames.push_back(frame);
            }
            way.sent(now, &out.correction, true);
        } else if let Some(last) = frames.back() {
            frames.push_back(*last);
        }
        let slews = out.reasons.contains(Reasons::SLEWING);
        quiet = if slews { 0 } else { quiet + 1 };
        if quiet > 2 * case.delay {
            let at = |i: usize| f64::from(barrier.memory().applied[i]) * limits.axes[i].resolution;
            let y = at(1) - LEVER_MM * at(3);
            let z = at(2) + 0.7 * LEVER_MM * at(4);
            most = most.max(y.abs()).max(z.abs());
        }
    }
    assert_eq!(guard.state(), volcomp_guard::State::Compensating);
    most
}

/// For any delay and rate the tip error is at most 1.1 linear steps plus one rotary step at its lever, because the barrier rounds to the
/// nearest count. Rounding towards the start of the line would add up to one linear step.
#[test]
fn a_barrier_adds_half_a_count_to_the_tip_error() {
    for delay in [0, 2, 4, 8] {
        for rate in [2.0, 10.0] {
            for (linear_step, rotary_step) in
                [(1e-3, 1e-6), (1e-4, 1e-7), (1e-4, 1e-6), (1e-3, 1e-7)]
            {
                let case = Case { linear_step, rotary_step, delay, rate };
                let off = off(&case);
                let most = 1.1 * linear_step + rotary_step * LEVER_MM;
                assert!(
                    off <= most,
                    "{off} of {most}: {delay} cycles, steps {linear_step} {rotary_step}"
                );
            }
        }
    }
}

//! Controls whose program is slower than configured, or stands: when their barrier is taken for zero, and for heard.

use std::time::Duration;

use volcomp_guard::{
    BarrierLink, Guard, Inputs, Limits, ReadBack, Reading, Request, Told, Wanted,
    barrier::{Barrier, FRAME_WORDS, REPORT_WORDS, Settings},
    protocol::{Counts, Layout},
    vocabulary::{AxisName, MAX_AXES, PerChannel},
};

use crate::world::{MACHINE, PERIOD, SCAN, axes, limits};

/// A guard that asks for 140 µm of X, on a way without delay to a barrier.
struct Bench {
    limits: Limits,
    guard: Guard,
    way: ReadBack,
    barrier: Barrier,
    sent: [u16; FRAME_WORDS],
    sent_at: Duration,
}

impl Bench {
    fn new(zero_after: Duration, time_out_scans: u16) -> Self {
        let limits = Limits {
            zero_after,
            ..limits()
        };
        let layout = Layout::of([AxisName::X, AxisName::Y]).expect("each once");
        let settings = Settings {
            axes: layout,
            machine: MACHINE,
            limit: PerChannel([150; MAX_AXES]),
            rate: PerChannel([2; MAX_AXES]),
            step_scans: 1,
            hold_scans: 25,
            time_out_scans,
        };
        Self {
            limits,
            guard: Guard::new(limits).expect("good limits"),
            way: ReadBack::barrier(BarrierLink::new(7, MACHINE, layout, SCAN)),
            barrier: Barrier::start(settings, 1, 0, &Counts::default()).expect("good settings"),
            sent: [0; FRAME_WORDS],
            sent_at: Duration::ZERO,
        }
    }

    /// Reads the report and sends a frame, as a gateway does. Whether anything was to be sent.
    fn exchange(&mut self, now: Duration, request: Option<Request>) -> bool {
        let mut words = [0; REPORT_WORDS];
        let length = self.barrier.report().encode(&mut words);
        let told = Told::Report(&words[..length]);
        self.way.hear(now, now, &told, &self.limits);
        let positions = PerChannel::ZERO;
        let output = self.guard.cycle(&Inputs {
            now,
            reading: Some(Reading {
                taken: now,
                positions,
            }),
            known: *self.way.known(),
            wanted: Some(Wanted::linear(axes(0.140, 0.0))),
            request,
            ..Inputs::default()
        });
        if output.write {
            let frame = (self.way).frame(&output.correction, &self.limits, &mut self.sent);
            if frame.is_some() {
                self.sent_at = now;
            }
            self.way.sent(now, &output.correction, true);
        }
        output.write
    }
}

/// Scans of 2.45 ms, where 2 ms are configured, are accepted. The barrier was taken for zero at the configured time: with
/// 140 µm, 10 µm and 46 µm on X.
#[test]
fn a_slow_control_is_at_zero_when_it_is_taken_for_it() {
    let real_scan = Duration::from_micros(2450);
    // The time-out in scans, and how long the last frame is on its way.
    for (time_out, late_ms) in [(1000, 0), (100, 0), (100, 14)] {
        let mut bench = Bench::new(Duration::from_secs(3), time_out);
        let mut mailbox = bench.sent;
        let mut scanned = Duration::ZERO;
        let is_at_zero = (1..4000).any(|cycle| {
            let now = PERIOD * cycle;
            while scanned + real_scan <= now {
                scanned += real_scan;
                bench.barrier.scan(&[&mailbox], false);
            }
            if cycle <= 1500 {
                let request = (cycle == 700).then_some(Request::Arm);
                let is_sent = bench.exchange(now, request);
                // The last one is late.
                if cycle < 1500 && is_sent {
                    mailbox = bench.sent;
                }
                assert!(cycle != 1500 || bench.barrier.memory().applied[0] == 140);
                return false;
            }
            if now >= bench.sent_at + Duration::from_millis(late_ms) {
                mailbox = bench.sent;
            }
            let by_itself = bench.way.zero_by_itself(&bench.limits);
            by_itself.is_some_and(|wait| now > bench.sent_at + wait)
        });
        assert!(is_at_zero, "it is never taken for zero");
        assert_eq!(bench.barrier.memory().applied[0], 0, "{time_out} {late_ms}");
    }
}

/// The control's program stands, and its interface goes on answering: the same report was taken for a new one every five
/// seconds, and the machine was armed.
#[test]
fn a_report_whose_tick_stands_is_never_new() {
    let mut bench = Bench::new(Duration::from_millis(500), 100);
    for cycle in 1..6000 {
        let now = PERIOD * cycle;
        if cycle < 600 {
            bench.barrier.scan(&[], false);
            bench.barrier.scan(&[], false);
        }
        let request = (cycle >= 1000).then_some(Request::Arm);
        assert!(!bench.exchange(now, request), "a frame at {now:?}");
    }
}

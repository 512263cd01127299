//! A simulated control as the guard sees it, with injected faults. Tests check the motion of its axes.

use std::{collections::VecDeque, time::Duration};

use volcomp_guard::{
    AxisLimits, BarrierLink, CorrectionReport, Guard, Inputs, Interlock, Interlocks, Limits,
    Output, ReadBack, ReadBackStatus, Reading, Reasons, Request, RequestedCorrection, Scheme,
    State,
    barrier::{Barrier, FRAME_WORDS, REPORT_WORDS, Settings},
    protocol::Layout,
};
use volcomp_vocabulary::{AxisKind, AxisName, MAX_AXES, PerChannel};

pub(crate) const PERIOD: Duration = Duration::from_millis(4);
pub(crate) const SCAN: Duration = Duration::from_millis(2);
pub(crate) const STEP: f64 = 0.001;
pub(crate) const SLEW: f64 = 0.5;
/// Guard's slew per cycle and barrier's rate per scan, with rounding, mm.
pub(crate) const MOST: f64 = 0.002 + 1e-9;
pub(crate) const SECOND: Duration = Duration::from_secs(1);
pub(crate) const MACHINE: u16 = 4711;
/// The interlock flags of another path, none set.
pub(crate) const CLEAR: Option<Interlock> =
    Some(Interlock { unreferenced: false, alarm: false, emergency_stop: false });
pub(crate) const STOP: Option<Interlock> =
    Some(Interlock { unreferenced: false, alarm: false, emergency_stop: true });

pub(crate) fn limits() -> Limits {
    let axis = AxisLimits {
        kind: AxisKind::Linear,
        limit: 0.150,
        warn: 0.100,
        slew_per_s: SLEW,
        accel_per_s2: 20.0,
        resolution: STEP,
        includes_correction: false,
    };
    Limits {
        axes: [axis; MAX_AXES],
        count: 2,
        period: PERIOD,
        hold: Duration::from_millis(50),
        zero_after: Duration::from_millis(500),
        ramp: Duration::from_millis(500),
        test_shift: PerChannel::ZERO,
        read_back_cycles: 2,
        only_thermal: false,
    }
}

pub(crate) fn layout() -> Layout {
    Layout::of([AxisName::X, AxisName::Y]).expect("each once")
}

/// A barrier for the limits above: 1 µm/ms, hold 50 ms, timeout 200 ms.
pub(crate) fn barrier() -> Barrier {
    barrier_from(17, 40)
}

/// The barrier of [`barrier`], powered up with this epoch and tick.
pub(crate) fn barrier_from(epoch: u16, tick: u16) -> Barrier {
    let settings = Settings {
        axes: layout(),
        machine: MACHINE,
        limit: PerChannel([150; MAX_AXES]),
        rate: PerChannel([2; MAX_AXES]),
        step_scans: 1,
        hold_scans: 25,
        time_out_scans: 100,
    };
    Barrier::start(settings, epoch, tick, &PerChannel::default()).expect("valid")
}

#[expect(clippy::struct_excessive_bools, reason = "separate faults")]
pub(crate) struct World {
    pub(crate) guard: Guard,
    pub(crate) read_back: ReadBack,
    pub(crate) interlocks: Interlocks,
    pub(crate) now: Duration,
    pub(crate) applied: PerChannel<f64>,
    pub(crate) barrier: Option<Barrier>,
    pub(crate) mailbox: Vec<u16>,
    scanned: Duration,
    pub(crate) scan_time: Duration,
    pub(crate) target: Option<PerChannel<f64>>,
    /// As in [`RequestedCorrection`].
    pub(crate) follow: PerChannel<PerChannel<f64>>,
    pub(crate) rotary: PerChannel<f64>,
    pub(crate) positions: PerChannel<f64>,
    pub(crate) referenced: bool,
    pub(crate) alarm: bool,
    pub(crate) emergency_stop: bool,
    /// The barrier holds in a stop that no path reports.
    pub(crate) holds: bool,
    pub(crate) answers: bool,
    /// Correction that the control reports instead of the applied correction; `None`: the control reports the applied
    /// correction.
    pub(crate) false_reading: Option<PerChannel<f64>>,
    /// Index of a word of the barrier's report, and the bits to flip.
    pub(crate) flipped_word: Option<(usize, u16)>,
    /// Delay of the reported correction, cycles; its timestamp is still fresh.
    pub(crate) report_delay: usize,
    /// Reported corrections have their own timestamp.
    pub(crate) dates_reports: bool,
    /// Delay of frames to the barrier, cycles.
    pub(crate) frame_delay: usize,
    in_transit: VecDeque<Vec<u16>>,
    reported: VecDeque<(PerChannel<f64>, [u16; REPORT_WORDS], usize, Duration)>,
    /// The control does not report its correction.
    pub(crate) hides_correction: bool,
    /// Lines whose device reports the levels of its outputs.
    pub(crate) reports_levels: bool,
    /// Writes take effect.
    pub(crate) sticks: bool,
    pub(crate) write_fails: bool,
    /// Interval between new positions; each position is one interval old.
    pub(crate) positions_every: Option<Duration>,
    shown: [Option<Reading>; 2],
    /// Timestamp of frozen positions.
    pub(crate) frozen_at: Option<Duration>,
    pub(crate) really_includes: bool,
    pub(crate) forbids: Reasons,
    /// Largest change of an axis by one write or scan since the last reset, mm.
    pub(crate) largest_step: f64,
}

/// Axis indices for a path with the axis order of the previous one.
pub(crate) fn same_places() -> PerChannel<Option<usize>> {
    PerChannel::from_fn(Some)
}

pub(crate) fn axes(x: f64, y: f64) -> PerChannel<f64> {
    let mut values = PerChannel::ZERO;
    (values[0], values[1]) = (x, y);
    values
}

impl World {
    pub(crate) fn new(limits: &Limits) -> Self {
        Self::of(limits, ReadBack::plain(Duration::ZERO), None)
    }

    pub(crate) fn lines(limits: &Limits) -> Self {
        Self::of(limits, ReadBack::no_read_back(None), None)
    }

    pub(crate) fn guarded(limits: &Limits) -> Self {
        Self::guarded_by(limits, barrier(), SCAN)
    }

    pub(crate) fn guarded_by(limits: &Limits, barrier: Barrier, scan: Duration) -> Self {
        let link = BarrierLink::new(99, MACHINE, layout(), scan);
        let mut world = Self::of(limits, ReadBack::barrier(link), Some(barrier));
        world.scan_time = scan;
        // Long enough to measure the scan rate.
        world.run(Duration::from_secs(2));
        world
    }

    /// A compensating world with a delay of `late` cycles each way to its barrier, `after` cycles into a ramp to 140
    /// µm.
    pub(crate) fn ramping(late: usize, after: u32) -> Self {
        let mut world = Self::guarded(&Limits { read_back_cycles: 2 * late + 2, ..limits() });
        (world.frame_delay, world.report_delay) = (late, late);
        world.target = Some(axes(0.140, -0.070));
        world.request(Request::Arm);
        world.run(after * PERIOD);
        world
    }

    fn of(limits: &Limits, read_back: ReadBack, barrier: Option<Barrier>) -> Self {
        let now = Duration::from_secs(1);
        let mut world = Self {
            guard: Guard::new(*limits).expect("valid"),
            read_back,
            interlocks: Interlocks::default(),
            now,
            applied: PerChannel::ZERO,
            barrier,
            mailbox: Vec::new(),
            scanned: now,
            scan_time: SCAN,
            target: Some(axes(0.040, -0.020)),
            rotary: PerChannel::ZERO,
            follow: PerChannel::default(),
            positions: PerChannel::ZERO,
            referenced: true,
            alarm: false,
            emergency_stop: false,
            holds: false,
            answers: true,
            false_reading: None,
            flipped_word: None,
            report_delay: 0,
            dates_reports: false,
            frame_delay: 0,
            in_transit: VecDeque::new(),
            reported: VecDeque::new(),
            hides_correction: false,
            reports_levels: false,
            sticks: true,
            write_fails: false,
            positions_every: None,
            shown: [None; 2],
            frozen_at: None,
            really_includes: false,
            forbids: Reasons::NONE,
            largest_step: 0.0,
        };
        // Three independent readings.
        world.run(2 * limits.delay() + 9 * PERIOD);
        world
    }

    /// Takes over with these limits on another path to the same barrier. The guard has not read the new path before.
    pub(crate) fn take_other_path(&mut self, limits: &Limits) {
        let link = BarrierLink::new(99, MACHINE, layout(), SCAN);
        let places = same_places();
        self.guard.take_path(*limits, &places).expect("valid");
        let before = std::mem::replace(&mut self.read_back, ReadBack::barrier(link));
        if let Some(frame) = before.last_frame() {
            self.read_back.also_sent(frame);
        }
    }

    pub(crate) fn status(&self) -> &ReadBackStatus {
        self.read_back.status()
    }

    /// Lowers the limit of every axis to `limit`, mm.
    pub(crate) fn lower_limits(&mut self, limit: f64) {
        let mut lowered = *self.guard.limits();
        for axis in &mut lowered.axes {
            (axis.limit, axis.warn) = (limit, limit);
        }
        self.guard.set_limits(lowered).expect("valid");
    }

    fn is_stopped(&self) -> bool {
        !self.referenced || self.alarm || self.emergency_stop
    }

    pub(crate) fn scan(&mut self) {
        while self.scanned + self.scan_time <= self.now {
            self.scanned += self.scan_time;
            let holds = self.holds || self.is_stopped();
            let Some(barrier) = &mut self.barrier else {
                continue;
            };
            barrier.scan(&[&self.mailbox], holds);
            let counts = barrier.memory().applied;
            self.apply(PerChannel::from_fn(|i| f64::from(counts[i]) * STEP));
        }
    }

    pub(crate) fn apply(&mut self, values: PerChannel<f64>) {
        for (new, old) in values.iter().zip(&self.applied) {
            self.largest_step = self.largest_step.max((new - old).abs());
        }
        self.applied = values;
    }

    pub(crate) fn reading(&self) -> Option<Reading> {
        let mut positions = self.positions;
        if self.really_includes {
            for (position, applied) in positions.iter_mut().zip(&self.applied) {
                *position += applied;
            }
        }
        let reading = Reading { taken: self.frozen_at.unwrap_or(self.now), positions };
        let reading = match (self.positions_every, self.shown) {
            (Some(_), [Some(before), Some(last)]) => Reading { taken: last.taken, ..before },
            _ => reading,
        };
        self.answers.then_some(reading)
    }

    fn show(&mut self) {
        let Some(every) = self.positions_every.take() else {
            return;
        };
        let [_, last] = self.shown;
        if last.is_none_or(|last| self.now >= last.taken + every) {
            self.shown = [last, self.reading()];
        }
        self.positions_every = Some(every);
    }

    pub(crate) fn read(&mut self) {
        self.show();
        let limits = *self.guard.limits();
        let mut words = [0; REPORT_WORDS];
        let barrier = self.barrier.as_ref();
        let length = barrier.map_or(0, |barrier| barrier.report().encode(&mut words));
        self.reported.push_back((self.applied, words, length, self.now));
        while self.reported.len() > self.report_delay + 1 {
            self.reported.pop_front();
        }
        let (applied, mut words, length, then) = self.reported[0];
        let taken = if self.dates_reports { then } else { self.now };
        if let Some((word, bits)) = self.flipped_word {
            words[word % length.max(1)] ^= bits;
        }
        let reported = match &self.barrier {
            _ if !self.answers || self.hides_correction => CorrectionReport::Missing,
            Some(_) => CorrectionReport::Barrier(&words[..length]),
            None if self.status().scheme == Scheme::NoReadBack && !self.reports_levels => {
                CorrectionReport::Missing
            }
            None => CorrectionReport::Values(self.false_reading.unwrap_or(applied)),
        };
        self.read_back.receive(self.now, taken, &reported, &limits);
        let interlock = Interlock {
            unreferenced: !self.referenced,
            alarm: self.alarm,
            emergency_stop: self.emergency_stop,
        };
        self.interlocks.update(0, self.answers.then_some(interlock));
    }

    pub(crate) fn decide(&mut self, request: Option<Request>) -> Output {
        if request == Some(Request::Acknowledge) {
            self.interlocks.acknowledge();
            self.read_back.acknowledge(self.now);
        }
        self.guard.cycle(&Inputs {
            now: self.now,
            reading: self.reading(),
            read_back: *self.status(),
            interlocks: self.interlocks.reasons(),
            requested: self.target.map(|target| RequestedCorrection {
                follow: self.follow,
                rotary: self.rotary,
                ..RequestedCorrection::linear(target)
            }),
            fast_ramp_out: false,
            request,
            forbids: self.forbids,
        })
    }

    /// Sends an output unless its deadline has passed.
    pub(crate) fn send(&mut self, output: &Output) {
        if !output.write {
            return;
        }
        if self.guard.time_to_send(self.now).is_none() {
            self.guard.not_sent();
            return;
        }
        let limits = *self.guard.limits();
        let ok = !self.write_fails;
        let lands = self.sticks && ok;
        if self.barrier.is_some() {
            let mut words = [0; FRAME_WORDS];
            let frame = self.read_back.frame(&output.correction, &limits, &mut words);
            if let (Some(length), true) = (frame, lands) {
                self.in_transit.push_back(words[..length].to_vec());
                if self.in_transit.len() > self.frame_delay {
                    self.mailbox = self.in_transit.pop_front().unwrap_or_default();
                }
            }
        } else if lands {
            self.apply(output.correction);
        }
        self.read_back.sent(self.now, &output.correction, ok);
        if !ok {
            self.guard.not_sent();
        }
    }

    pub(crate) fn cycle_after(&mut self, dt: Duration, request: Option<Request>) -> Output {
        self.now += dt;
        self.scan();
        self.read();
        let output = self.decide(request);
        self.send(&output);
        output
    }

    /// Changes the correction as a foreign client would, if the control has no barrier.
    pub(crate) fn clear(&mut self, values: PerChannel<f64>) {
        if self.status().scheme == Scheme::Plain {
            self.applied = values;
        }
    }

    /// A cycle in which the program is suspended for `stopped` between read and write. Returns whether the output was
    /// sent.
    pub(crate) fn cycle_with_pause(
        &mut self,
        dt: Duration,
        stopped: Duration,
        request: Option<Request>,
    ) -> (Output, bool) {
        self.now += dt;
        self.scan();
        self.read();
        let output = self.decide(request);
        self.now += stopped;
        self.scan();
        let before = self.applied;
        self.send(&output);
        (output, before != self.applied)
    }

    /// Checks that no write or scan changed an axis by more than `most`, mm.
    #[track_caller]
    pub(crate) fn assert_steps(&self, most: f64, case: &str) {
        let found = self.largest_step;
        assert!(found <= most, "{case}: a step of {found} mm, at most {most}");
    }

    /// Checks the corrections of X and Y, mm.
    #[track_caller]
    pub(crate) fn assert_applied(&self, expected: PerChannel<f64>, case: &str) {
        let off = |i: usize| (self.applied[i] - expected[i]).abs();
        assert!(off(0) < 1e-9 && off(1) < 1e-9, "{case}: {:?}", self.applied);
    }

    /// Runs for `time`, then checks the state.
    #[track_caller]
    pub(crate) fn run_to(&mut self, time: Duration, state: State) -> Output {
        let output = self.run(time);
        assert_eq!(output.state, state, "{:?}", output.reasons);
        output
    }

    pub(crate) fn request(&mut self, request: Request) -> Output {
        self.cycle_after(PERIOD, Some(request))
    }

    pub(crate) fn run(&mut self, time: Duration) -> Output {
        let mut output = self.cycle_after(PERIOD, None);
        let end = self.now + time;
        while self.now < end {
            output = self.cycle_after(PERIOD, None);
        }
        output
    }

    /// Arms and completes the ramp.
    pub(crate) fn arm(mut self) -> Self {
        self.request(Request::Arm);
        let output = self.run(Duration::from_secs(2));
        assert_eq!(output.state, State::Compensating, "{:?}", output.reasons);
        self.largest_step = 0.0;
        self
    }

    /// Arms, and resets the largest step.
    pub(crate) fn arm_from_here(mut self) -> Self {
        self.largest_step = 0.0;
        self.request(Request::Arm);
        self
    }

    /// An armed control without a barrier, with read-back.
    pub(crate) fn compensating(limits: &Limits) -> Self {
        Self::new(limits).arm()
    }
}

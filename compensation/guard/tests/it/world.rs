//! A control as a guard sees it, with all that may go wrong: what its axes get is what counts.

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
/// mm/s.
pub(crate) const SLEW: f64 = 0.5;
pub(crate) const MACHINE: u16 = 4711;

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

/// A barrier that fits the limits above: 1 µm/ms, hold 50 ms, time-out 200 ms.
pub(crate) fn barrier() -> Barrier {
    barrier_from(17, 40)
}

/// The same, switched on with this epoch and tick.
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
    Barrier::start(settings, epoch, tick, &PerChannel::default()).expect("good settings")
}

/// A control, a guard and time.
#[expect(clippy::struct_excessive_bools, reason = "each is a fault of its own")]
pub(crate) struct World {
    pub(crate) guard: Guard,
    pub(crate) read_back: ReadBack,
    pub(crate) interlocks: Interlocks,
    pub(crate) now: Duration,
    /// What the axes have, written, cleared, or moved by the barrier.
    pub(crate) applied: PerChannel<f64>,
    pub(crate) barrier: Option<Barrier>,
    pub(crate) mailbox: Vec<u16>,
    scanned: Duration,
    /// The control scans once in this time.
    pub(crate) scan_time: Duration,
    pub(crate) target: Option<PerChannel<f64>>,
    /// How linear axes follow rotary ones, as in [`RequestedCorrection`].
    pub(crate) follow: PerChannel<PerChannel<f64>>,
    /// The shares of the rotary axes, as in [`RequestedCorrection`].
    pub(crate) rotary: PerChannel<f64>,
    pub(crate) positions: PerChannel<f64>,
    pub(crate) referenced: bool,
    pub(crate) alarm: bool,
    pub(crate) emergency_stop: bool,
    /// The control's barrier holds by a stop that nothing shows.
    pub(crate) holds: bool,
    pub(crate) answers: bool,
    /// What is told of the correction this time, instead of what is so.
    pub(crate) lie: Option<PerChannel<f64>>,
    /// A word of the barrier's report, and what is wrong with its bits.
    pub(crate) spoils_word: Option<(usize, u16)>,
    /// What is told of the correction is so many cycles old, but has a fresh time.
    pub(crate) told_late: usize,
    /// What is told of the correction has the time at which it held.
    pub(crate) tells_age: bool,
    /// So many frames to the barrier are on their way.
    pub(crate) sent_late: usize,
    air: VecDeque<Vec<u16>>,
    told: VecDeque<(PerChannel<f64>, [u16; REPORT_WORDS], usize, Duration)>,
    /// The reading says nothing of the correction.
    pub(crate) hides_applied: bool,
    /// Lines whose device tells what its outputs carry.
    pub(crate) tells_levels: bool,
    /// Writes are taken.
    pub(crate) sticks: bool,
    /// Writes fail, and are told to have failed.
    pub(crate) write_fails: bool,
    /// Positions come anew only after so much time, each as it was when the one before came.
    pub(crate) positions_every: Option<Duration>,
    shown: [Option<Reading>; 2],
    /// Positions do not get younger.
    pub(crate) frozen_at: Option<Duration>,
    pub(crate) really_includes: bool,
    pub(crate) forbids: Reasons,
    /// The largest change of an axis from one write, or one scan, to the next since this was set to zero, mm.
    pub(crate) largest_step: f64,
}

/// Each axis has the place on this path that it had on the one before.
pub(crate) fn same_places() -> PerChannel<Option<usize>> {
    PerChannel::from_fn(Some)
}

pub(crate) fn axes(x: f64, y: f64) -> PerChannel<f64> {
    let mut values = PerChannel::ZERO;
    (values[0], values[1]) = (x, y);
    values
}

impl World {
    /// A control without a barrier that can be asked, found as it is.
    pub(crate) fn new(limits: &Limits) -> Self {
        Self::of(limits, ReadBack::plain(Duration::ZERO), None)
    }

    /// Lines: a control that cannot be asked.
    pub(crate) fn lines(limits: &Limits) -> Self {
        Self::of(limits, ReadBack::no_read_back(None), None)
    }

    /// A control with a barrier.
    pub(crate) fn guarded(limits: &Limits) -> Self {
        Self::guarded_by(limits, barrier(), SCAN)
    }

    /// A control with this barrier, which scans once in this time.
    pub(crate) fn guarded_by(limits: &Limits, barrier: Barrier, scan: Duration) -> Self {
        let link = BarrierLink::new(99, MACHINE, layout(), scan);
        let mut world = Self::of(limits, ReadBack::barrier(link), Some(barrier));
        world.scan_time = scan;
        // The scans of the control are counted.
        world.run(Duration::from_secs(2));
        world
    }

    /// A barrier some cycles away, so long after the begin of the ramp of a correction to 140 µm.
    pub(crate) fn in_motion(late: usize, after: u32) -> Self {
        let mut world = Self::guarded(&Limits {
            read_back_cycles: 2 * late + 2,
            ..limits()
        });
        (world.sent_late, world.told_late) = (late, late);
        world.target = Some(axes(0.140, -0.070));
        world.request(Request::Arm);
        world.run(after * PERIOD);
        world
    }

    fn of(limits: &Limits, read_back: ReadBack, barrier: Option<Barrier>) -> Self {
        let now = Duration::from_secs(1);
        let mut world = Self {
            guard: Guard::new(*limits).expect("the limits of the tests are good"),
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
            lie: None,
            spoils_word: None,
            told_late: 0,
            tells_age: false,
            sent_late: 0,
            air: VecDeque::new(),
            told: VecDeque::new(),
            hides_applied: false,
            tells_levels: false,
            sticks: true,
            write_fails: false,
            positions_every: None,
            shown: [None; 2],
            frozen_at: None,
            really_includes: false,
            forbids: Reasons::NONE,
            largest_step: 0.0,
        };
        // Three readings that each tell something of their own.
        world.run(2 * limits.delay() + 9 * PERIOD);
        world
    }

    /// Another way to the same barrier, which was not heard yet, takes over with these limits.
    pub(crate) fn take_other_way(&mut self, limits: &Limits) {
        let link = BarrierLink::new(99, MACHINE, layout(), SCAN);
        let places = same_places();
        self.guard.take_path(*limits, &places).expect("good limits");
        let before = std::mem::replace(&mut self.read_back, ReadBack::barrier(link));
        if let Some(frame) = before.last_frame() {
            self.read_back.also_sent(frame);
        }
    }

    pub(crate) fn known(&self) -> &ReadBackStatus {
        self.read_back.status()
    }

    /// Lowers the limit of every axis to this, mm.
    pub(crate) fn lower_limits(&mut self, limit: f64) {
        let mut lowered = *self.guard.limits();
        for axis in &mut lowered.axes {
            (axis.limit, axis.warn) = (limit, limit);
        }
        self.guard.set_limits(lowered).expect("good limits");
    }

    fn is_stopped(&self) -> bool {
        !self.referenced || self.alarm || self.emergency_stop
    }

    /// The scans of the control that are due.
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

    /// The axes get this.
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
        let reading = Reading {
            taken: self.frozen_at.unwrap_or(self.now),
            positions,
        };
        let reading = match (self.positions_every, self.shown) {
            (Some(_), [Some(before), Some(last)]) => Reading {
                taken: last.taken,
                ..before
            },
            _ => reading,
        };
        self.answers.then_some(reading)
    }

    /// Positions come anew, where they do now.
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

    /// What a reading tells of the correction and of the machine.
    pub(crate) fn hear(&mut self) {
        self.show();
        let limits = *self.guard.limits();
        let mut words = [0; REPORT_WORDS];
        let barrier = self.barrier.as_ref();
        let length = barrier.map_or(0, |barrier| barrier.report().encode(&mut words));
        self.told.push_back((self.applied, words, length, self.now));
        while self.told.len() > self.told_late + 1 {
            self.told.pop_front();
        }
        let (applied, mut words, length, then) = self.told[0];
        let taken = if self.tells_age { then } else { self.now };
        if let Some((word, bits)) = self.spoils_word {
            words[word % length.max(1)] ^= bits;
        }
        let told = match &self.barrier {
            _ if !self.answers || self.hides_applied => CorrectionReport::Missing,
            Some(_) => CorrectionReport::Barrier(&words[..length]),
            None if self.known().scheme == Scheme::NoReadBack && !self.tells_levels => {
                CorrectionReport::Missing
            }
            None => CorrectionReport::Values(self.lie.unwrap_or(applied)),
        };
        self.read_back.receive(self.now, taken, &told, &limits);
        let interlock = Interlock {
            unreferenced: !self.referenced,
            alarm: self.alarm,
            emergency_stop: self.emergency_stop,
        };
        self.interlocks.update(0, self.answers.then_some(interlock));
    }

    /// What the guard makes of it.
    pub(crate) fn decide(&mut self, request: Option<Request>) -> Output {
        if request == Some(Request::Acknowledge) {
            self.interlocks.acknowledge();
            self.read_back.acknowledge(self.now);
        }
        self.guard.cycle(&Inputs {
            now: self.now,
            reading: self.reading(),
            read_back: *self.known(),
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

    /// Sends an output, if it is still young enough at `now`.
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
            let frame = self
                .read_back
                .frame(&output.correction, &limits, &mut words);
            if let (Some(length), true) = (frame, lands) {
                self.air.push_back(words[..length].to_vec());
                if self.air.len() > self.sent_late {
                    self.mailbox = self.air.pop_front().unwrap_or_default();
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
        self.hear();
        let output = self.decide(request);
        self.send(&output);
        output
    }

    /// Somebody else changes what the axes have, on a control that lets them.
    pub(crate) fn clear(&mut self, values: PerChannel<f64>) {
        if self.known().scheme == Scheme::Plain {
            self.applied = values;
        }
    }

    /// A cycle in which the program is stopped for `stopped` between reading and writing while the control goes on.
    /// Whether the guard's output was sent.
    pub(crate) fn freezes_between(
        &mut self,
        dt: Duration,
        stopped: Duration,
        request: Option<Request>,
    ) -> (Output, bool) {
        self.now += dt;
        self.scan();
        self.hear();
        let output = self.decide(request);
        self.now += stopped;
        self.scan();
        let before = self.applied;
        self.send(&output);
        (output, before != self.applied)
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

    /// Armed and through with its ramp.
    pub(crate) fn arm(mut self) -> Self {
        self.request(Request::Arm);
        let output = self.run(Duration::from_secs(2));
        assert_eq!(output.state, State::Compensating, "{:?}", output.reasons);
        self.largest_step = 0.0;
        self
    }

    /// Armed, and its largest step counted from here.
    pub(crate) fn arm_from_here(mut self) -> Self {
        self.largest_step = 0.0;
        self.request(Request::Arm);
        self
    }

    /// A control without a barrier that can be asked, armed.
    pub(crate) fn compensating(limits: &Limits) -> Self {
        Self::new(limits).arm()
    }
}

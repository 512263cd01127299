use std::{
    collections::BTreeMap,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use volcomp_model::Machine;
use volcomp_port::{Clock, Controller, Description, Fault, Snapshot, Words};
use volcomp_runtime::{
    AxisSettings, ControlPath, Cycle, GuardSettings, Model, PathPlan, PathSettings, PlanError,
    Report,
    guard::{
        Request,
        barrier::{Barrier, REPORT_WORDS, Settings},
        protocol::{Counts, Layout},
    },
};
use volcomp_vocabulary::{AxisName, MAX_AXES, PerChannel, Um};

use crate::rig::{self, PERIOD, referenced};

pub(crate) const AXES: [AxisName; 3] = [AxisName::X, AxisName::Y, AxisName::Z];

pub(crate) fn three_axes(errors: &str, guard: &GuardSettings) -> Model {
    let text = format!(
        "structure = \"w X' Y' b Z t\"
axes = {{ X.travel = [0, 100], Y.travel = [0, 500], Z.travel = [0, 400] }}
errors = {{ {errors} }}"
    );
    let machine = Machine::parse(&text, "m").expect("valid");
    Model::new(&machine, guard.fading).expect("compiles")
}

/// Settings for linear axes with this limit (µm), 500 µm/s, and a ramp of 200 ms.
pub(crate) fn guard_um(limit: f64) -> GuardSettings {
    GuardSettings {
        ramp: Duration::from_millis(200),
        ..GuardSettings::new(AxisSettings::new(Um(limit), Um(500.0)))
    }
}

/// The barrier of a control with these axes; rate 2 counts per scan.
pub(crate) fn barrier_of(
    axes: &[AxisName],
    limit: i16,
    hold_scans: u16,
    time_out_scans: u16,
) -> Barrier {
    let settings = Settings {
        axes: Layout::of(axes.iter().copied()).expect("each once"),
        machine: 1,
        limit: PerChannel([limit; MAX_AXES]),
        rate: PerChannel([2; MAX_AXES]),
        step_scans: 1,
        hold_scans,
        time_out_scans,
    };
    Barrier::start(settings, 1, 0, &Counts::default()).expect("valid settings")
}

pub(crate) trait Plant: Send {
    fn read(&mut self, way: &Description, clock: &Clock) -> Result<Snapshot, Fault>;

    fn apply(
        &mut self,
        way: &Description,
        corrections: &PerChannel<f64>,
        clock: &Clock,
    ) -> Result<(), Fault> {
        let _ = (way, corrections, clock);
        Ok(())
    }

    fn post(&mut self, _: &Description, _: &Words) -> Result<(), Fault> {
        Err(Fault::Unsupported("frames"))
    }

    /// Duration of a reading on this path.
    fn hangs(&self, _: &Description) -> Duration {
        Duration::ZERO
    }
}

/// A control that applies each write at once, at a position set by the test.
#[derive(Default)]
pub(crate) struct Control {
    /// Positions of the axes without correction, mm and rad; 0 if missing.
    pub(crate) place: BTreeMap<AxisName, f64>,
    /// Applied corrections, mm and rad.
    pub(crate) words: BTreeMap<AxisName, f64>,
    /// Corrections written on paths without read-back, if they are separate from `words`.
    pub(crate) lines: Option<BTreeMap<AxisName, f64>>,
    pub(crate) barrier: Option<Barrier>,
    pub(crate) mailbox: Option<Vec<u16>>,
    pub(crate) scanned: Duration,
    /// The device that does not answer, and the duration of its exchanges.
    pub(crate) away: Option<&'static str>,
    pub(crate) hangs: Duration,
    /// Emergency stop; paths with a barrier do not report it.
    pub(crate) stop: bool,
    /// Largest change of a word by one write, mm or rad.
    pub(crate) largest: f64,
    /// Time of each device's last write.
    pub(crate) written: BTreeMap<String, Duration>,
}

impl Control {
    pub(crate) fn at(place: &[(AxisName, f64)]) -> Self {
        Self { place: place.iter().copied().collect(), ..Self::default() }
    }

    pub(crate) fn um(&self, axis: AxisName) -> f64 {
        (value(&self.words, axis) * 1e3).round()
    }

    pub(crate) fn scan_until(&mut self, now: Duration, scan: Duration) {
        while self.scanned + scan <= now {
            self.scanned += scan;
            let mailboxes: Vec<&[u16]> = self.mailbox.as_deref().into_iter().collect();
            if let Some(barrier) = &mut self.barrier {
                barrier.scan(&mailboxes, self.stop);
            }
        }
    }

    pub(crate) fn applied(&self) -> Counts {
        let barrier = self.barrier.as_ref().expect("a barrier");
        barrier.memory().applied
    }

    fn answers(&self, way: &Description) -> Result<(), Fault> {
        let is_away = self.away == Some(way.device.as_str());
        if is_away { Err(Fault::TimedOut) } else { Ok(()) }
    }
}

pub(crate) fn value(values: &BTreeMap<AxisName, f64>, axis: AxisName) -> f64 {
    values.get(&axis).copied().unwrap_or(0.0)
}

impl Plant for Control {
    fn read(&mut self, way: &Description, clock: &Clock) -> Result<Snapshot, Fault> {
        self.answers(way)?;
        let of_way = |values: &BTreeMap<AxisName, f64>| {
            let mut channel = PerChannel::ZERO;
            for (into, name) in channel.iter_mut().zip(way.shown_axes()) {
                *into = value(values, name);
            }
            channel
        };
        let tells = way.tells_applied && !way.barrier;
        let applied = tells.then(|| of_way(&self.words));
        let mut snapshot = referenced(of_way(&self.place), clock.now(), applied);
        snapshot.state.emergency_stop = self.stop && !way.barrier;
        if let Some(barrier) = self.barrier.as_ref().filter(|_| way.barrier) {
            let mut words = [0; REPORT_WORDS];
            let length = barrier.report().encode(&mut words);
            snapshot.report = Words::new(&words[..length]);
        }
        Ok(snapshot)
    }

    fn apply(
        &mut self,
        way: &Description,
        corrections: &PerChannel<f64>,
        clock: &Clock,
    ) -> Result<(), Fault> {
        self.answers(way)?;
        let words = match &mut self.lines {
            Some(lines) if !way.tells_applied => lines,
            _ => &mut self.words,
        };
        for (axis, correction) in way.axes.iter().zip(corrections) {
            let before = words.insert(axis.name, *correction).unwrap_or(0.0);
            self.largest = self.largest.max((correction - before).abs());
        }
        self.written.insert(way.device.clone(), clock.elapsed());
        Ok(())
    }

    fn post(&mut self, way: &Description, frame: &Words) -> Result<(), Fault> {
        self.answers(way)?;
        self.mailbox = Some(frame.as_slice().to_vec());
        Ok(())
    }

    fn hangs(&self, way: &Description) -> Duration {
        match self.answers(way) {
            Ok(()) => Duration::ZERO,
            Err(_) => self.hangs,
        }
    }
}

pub(crate) struct Ways<P> {
    plant: Arc<Mutex<P>>,
    pub(crate) clock: Clock,
}

impl<P: Plant + 'static> Ways<P> {
    pub(crate) fn to(plant: P, clock: Clock) -> Self {
        Self { plant: Arc::new(Mutex::new(plant)), clock }
    }

    pub(crate) fn plant(&self) -> MutexGuard<'_, P> {
        self.plant.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn controller(&self, description: Description) -> Box<dyn Controller> {
        Box::new(Way { plant: Arc::clone(&self.plant), clock: self.clock.clone(), description })
    }

    pub(crate) fn path(
        &self,
        description: Description,
        model: &Model,
        guard: &GuardSettings,
        settings: &PathSettings,
    ) -> ControlPath {
        let plan = PathPlan::new(description.clone(), model, guard, settings, PERIOD);
        ControlPath::new(self.controller(description), &plan.expect("fits")).expect("fits")
    }

    pub(crate) fn cycle(
        &self,
        model: Model,
        guard: &GuardSettings,
        paths: Vec<ControlPath>,
    ) -> Result<Cycle, PlanError> {
        Ok(rig::cycle_of(model, guard, paths)?.with_clock(self.clock.clone()))
    }

    pub(crate) fn run(&self, cycle: &mut Cycle, request: Option<Request>) -> Report {
        rig::run(cycle, &self.clock, request)
    }

    /// Advances the clock by a period, and runs one cycle.
    pub(crate) fn step(&self, cycle: &mut Cycle, request: Option<Request>) -> Report {
        rig::step(cycle, &self.clock, request)
    }
}

struct Way<P> {
    plant: Arc<Mutex<P>>,
    clock: Clock,
    description: Description,
}

impl<P: Plant> Way<P> {
    fn plant(&self) -> MutexGuard<'_, P> {
        self.plant.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl<P: Plant> Controller for Way<P> {
    fn description(&self) -> &Description {
        &self.description
    }

    fn read(&mut self, _: Instant) -> Result<Snapshot, Fault> {
        let (read, hangs) = {
            let mut plant = self.plant();
            let read = plant.read(&self.description, &self.clock);
            (read, plant.hangs(&self.description))
        };
        std::thread::sleep(hangs);
        read
    }

    fn apply(&mut self, corrections: &PerChannel<f64>, _: Instant) -> Result<(), Fault> {
        self.plant().apply(&self.description, corrections, &self.clock)
    }

    fn post(&mut self, frame: &Words, _: Instant) -> Result<(), Fault> {
        self.plant().post(&self.description, frame)
    }
}

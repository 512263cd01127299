//! A complete gateway in this process, on a simulated machine and clock.
//!
//! Cycle, service, audit log, models and files are those of the program, and nothing waits for real time. [`Served`]
//! adds the dashboard, for clients over HTTP and other protocols.

use std::{
    ops::Deref,
    path::{Path, PathBuf},
    sync::{
        Arc, Mutex, MutexGuard, PoisonError,
        atomic::{AtomicBool, Ordering},
    },
    thread::{self, JoinHandle},
    time::Duration,
};

use serde_json::Value;
use tokio::{
    runtime::Runtime,
    sync::oneshot::{self, error::TryRecvError},
};
use volcomp_focas::simulator::{self, Simulator, World};
use volcomp_gateway::{
    audit::AuditLog,
    http,
    interop::{Interop, RunningInterfaces as Others, quantities::Shape},
    machine::{Machine, MachineParts, assemble, open_audit, restore_output},
    options::Options,
    rehearse::Rig,
    request::{Operation, Reply, RequestSender, ServiceRequest},
    service::Life,
};
use volcomp_port::inject::Injection;
use volcomp_runtime::{DisarmSwitch, ManualCycles, start_manual};
use volcomp_vocabulary::PerChannel;

use crate::program::{Client, token_file};

/// Timeout in simulated time.
const PATIENCE: Duration = Duration::from_secs(60);
/// Timeout for file operations, in real time.
const DISK: Duration = Duration::from_secs(60);

pub(crate) struct Gateway {
    pub(crate) rig: Rig,
    pub(crate) parts: MachineParts,
    shape: Shape,
    cycles: ManualCycles,
    period: Duration,
}

/// A configuration and machine file for a controller whose device does not respond, with a short ramp and an error of
/// 20 µm on Y.
pub(crate) fn configuration(dir: &Path, more: &str) -> PathBuf {
    configuration_of("127.0.0.1:1", dir, more, "")
}

/// As [`configuration`], with a controller at this address and these additional tables.
pub(crate) fn configuration_of(address: &str, dir: &Path, more: &str, tables: &str) -> PathBuf {
    std::fs::write(dir.join("machine.toml"), crate::program::MACHINE).expect("writable");
    let text = format!(
        r#"
machine = "machine.toml"
cycle_ms = 4.0
{more}
[guard]
limit_um = 150.0
limit_without_barrier_um = 150.0
slew_um_per_s = 500.0
hold_ms = 200
zero_after_ms = 3000
confirm_um = 10.0
ramp_s = 0.1
# It moves all the time.
test_shift_um = 0
[[controller]]
url = "focas://{address}"
axes = ["X", "Y", "Z"]
heartbeat = {{ pmc = "R", at = 120 }}
{tables}"#
    );
    let file = dir.join("G.toml");
    std::fs::write(&file, text).expect("writable");
    file
}

pub(crate) fn says(state: &Value, words: &str) -> bool {
    state["reasons"].to_string().contains(words)
}

/// Checks that since the start no axis has moved in a cycle of 4 ms by more than the slew and one step.
pub(crate) fn no_step(rig: &Rig) {
    let changes = rig.controls.axes.largest_change();
    let is_small = |mm: &f64| *mm <= 0.003 + 1e-9;
    assert!(changes.iter().all(is_small), "{changes:?} mm");
}

pub(crate) fn machine(config: &Path) -> Machine {
    Machine {
        options: Options { config: Some(config.to_owned()), ..Options::default() },
        proven_within: Duration::from_secs(4),
    }
}

pub(crate) fn started(more: &str) -> (tempfile::TempDir, PathBuf, Gateway) {
    let dir = tempfile::tempdir().expect("writable");
    let config = configuration(dir.path(), more);
    let gateway = Gateway::start(&config);
    (dir, config, gateway)
}

impl Gateway {
    pub(crate) fn start(config: &Path) -> Self {
        Self::on(None, config, |log| log)
    }

    /// Starts a gateway with a changed audit log.
    pub(crate) fn with_log(config: &Path, change: impl FnOnce(AuditLog) -> AuditLog) -> Self {
        Self::on(None, config, change)
    }

    /// Ends the gateway as a power failure does.
    pub(crate) fn killed(self) -> Rig {
        let Self { rig, parts, .. } = self;
        drop(parts);
        rig.clock().advance(Duration::from_millis(100));
        rig
    }

    /// Kills the gateway as a power failure does, and starts another one on the same machine.
    pub(crate) fn killed_and_started(self, config: &Path) -> Self {
        Self::again(self.killed(), config)
    }

    pub(crate) fn again(rig: Rig, config: &Path) -> Self {
        Self::on(Some(rig), config, |log| log)
    }

    fn on(rig: Option<Rig>, config: &Path, change_log: impl FnOnce(AuditLog) -> AuditLog) -> Self {
        let machine = machine(config);
        let plan = machine.plan().unwrap_or_else(|e| panic!("{e}"));
        let period = plan.config.cycle();
        let rig = rig.unwrap_or_else(|| Rig::of(&plan).expect("a machine"));
        let shape = plan.shape();
        let (audit, found) = open_audit(&plan.config).expect("writable");
        let mut opened = rig.open(plan).expect("it fits");
        restore_output(&mut opened);
        let mut cycles = None;
        let audit = change_log(audit);
        let parts = assemble(&machine, opened, audit, &Life::default(), |cycle, _| {
            let (handle, by_hand) = start_manual(cycle);
            cycles = Some(by_hand);
            Ok(handle)
        });
        let mut parts = parts.expect("threads");
        parts.service.started(&found);
        Self { rig, parts, shape, cycles: cycles.expect("launched"), period }
    }

    /// Runs one cycle and one iteration of the service, with its file work.
    pub(crate) fn step(&mut self) {
        self.rig.clock().advance(self.period);
        self.cycles.cycle();
        self.parts.service.poll_within(Duration::ZERO);
        assert!(self.parts.service.settle(DISK), "the disk hangs");
    }

    pub(crate) fn run(&mut self, time: Duration) {
        let end = self.rig.clock().elapsed() + time;
        while self.rig.clock().elapsed() < end {
            self.step();
        }
    }

    pub(crate) fn state(&self) -> Value {
        serde_json::to_value(self.parts.published.latest()).expect("JSON")
    }

    pub(crate) fn wait(&mut self, what: &str, done: impl Fn(&Value) -> bool) -> Value {
        let end = self.rig.clock().elapsed() + PATIENCE;
        loop {
            self.step();
            let state = self.state();
            if done(&state) {
                return state;
            }
            assert!(self.rig.clock().elapsed() < end, "not {what}: {state}");
        }
    }

    pub(crate) fn wait_for(&mut self, name: &str) -> Value {
        self.wait(name, |state| state["state"] == name)
    }

    pub(crate) fn wait_until_says(&mut self, words: &str) -> Value {
        self.wait(words, |state| says(state, words))
    }

    pub(crate) fn wait_until_silent_of(&mut self, words: &str) -> Value {
        self.wait(words, |state| !says(state, words))
    }

    /// Sends a request of `anna`, and runs until it is answered. Returns status and document.
    pub(crate) fn ask(&mut self, ask: Operation) -> (u16, Value) {
        let mut wait = self.begin(ask);
        let end = self.rig.clock().elapsed() + PATIENCE;
        loop {
            match wait.try_recv() {
                Ok(reply) => {
                    let answer = serde_json::to_value(reply.answer).expect("JSON");
                    return (reply.status, answer);
                }
                Err(TryRecvError::Empty) => self.step(),
                Err(TryRecvError::Closed) => panic!("no answer: the service has ended"),
            }
            assert!(self.rig.clock().elapsed() < end, "no answer");
        }
    }

    /// Sends a request of `anna` without running a cycle.
    pub(crate) fn begin(&self, ask: Operation) -> oneshot::Receiver<Reply> {
        begin(&self.parts.requests, &self.parts.switch, ask)
    }

    /// Runs until the control has been observed long enough for arming.
    pub(crate) fn watch(&mut self) {
        self.wait("watched", |state| state["error_um"].is_array() && !says(state, "watching"));
    }

    /// Arms after [`watch`](Self::watch).
    pub(crate) fn must_arm(&mut self) -> Value {
        self.watch();
        let (status, answer) = self.ask(Operation::Arm(None));
        assert_eq!(status, 200, "{answer}");
        answer
    }

    /// Another sender writes 30 mm to the word of Y, which causes a fault.
    pub(crate) fn fault(&mut self) -> Value {
        let mut far = PerChannel::ZERO;
        far[1] = 30.0;
        for _ in 0..2500 {
            self.rig.overwrite(&far);
            self.step();
            if self.state()["state"] == "faulted" {
                self.rig.overwrite(&PerChannel::ZERO);
                return self.state();
            }
        }
        panic!("no fault: {}", self.state());
    }

    pub(crate) fn disconnect(&self) {
        self.rig.inject(Injection::Disconnect { calls: u32::MAX });
    }

    pub(crate) fn cycle_alone(&mut self) {
        self.rig.clock().advance(self.period);
        self.cycles.cycle();
    }

    pub(crate) fn hang(&mut self, time: Duration) {
        let end = self.rig.clock().elapsed() + time;
        while self.rig.clock().elapsed() < end {
            self.rig.clock().advance(self.period);
            self.parts.service.poll_within(Duration::ZERO);
            assert!(self.parts.service.settle(DISK), "the disk hangs");
        }
    }

    /// Stops the gateway as a signal does, and runs its last cycles.
    pub(crate) fn stop(self) -> Rig {
        self.stop_while(|_| {})
    }

    /// As [`stop`](Self::stop), with an action between the last cycles.
    pub(crate) fn stop_while(
        mut self,
        mut act: impl FnMut(&dyn Fn(Operation) -> oneshot::Receiver<Reply>),
    ) -> Rig {
        let (clock, period) = (self.rig.clock().clone(), self.period);
        let (requests, switch) = (self.parts.requests.clone(), self.parts.switch.clone());
        let begin = |ask| begin(&requests, &switch, ask);
        let cycles = &mut self.cycles;
        let ended = self.parts.service.stop(&mut || {
            for _ in 0..10 {
                clock.advance(period);
                cycles.cycle();
            }
            act(&begin);
            false
        });
        assert!(ended);
        self.rig
    }

    /// Corrections applied to the axes, mm.
    pub(crate) fn shifts(&self) -> PerChannel<f64> {
        self.rig.controls.axes.applied()
    }

    pub(crate) fn audit(&self) -> String {
        let folder = self.parts.config.audit_dir();
        std::fs::read_to_string(folder.join("audit.log")).expect("a log")
    }
}

fn begin(
    requests: &RequestSender,
    switch: &DisarmSwitch,
    ask: Operation,
) -> oneshot::Receiver<Reply> {
    let (answer, wait) = oneshot::channel();
    let asked = ServiceRequest::new(ask, "anna", Some(answer), switch);
    assert!(requests.try_send(asked).is_ok(), "too many wait");
    wait
}

/// A gateway in this process with its dashboard and its other configured interfaces. Its clock runs about three times
/// as fast as the clock of its clients.
pub(crate) struct Served {
    client: Client,
    gateway: Arc<Mutex<Gateway>>,
    /// Largest change of Y between two cycles since the last reset, mm.
    largest_step: Arc<Mutex<f64>>,
    ends: Arc<AtomicBool>,
    cycles: Option<JoinHandle<()>>,
    _dashboard: Runtime,
    _others: Others,
}

impl Deref for Served {
    type Target = Client;

    fn deref(&self) -> &Client {
        &self.client
    }
}

impl Drop for Served {
    fn drop(&mut self) {
        self.end_cycles();
    }
}

pub(crate) fn served_configuration(dir: &Path, more: &str) -> PathBuf {
    token_file(dir);
    let tables = "[dashboard]\ntoken_file = \"tokens\"\n";
    configuration_of("127.0.0.1:1", dir, more, tables)
}

impl Served {
    /// A gateway with tokens that compensates as soon as possible.
    pub(crate) fn simulated(dir: &Path) -> Self {
        Self::start(&served_configuration(dir, "auto_arm = true"))
    }

    pub(crate) fn start(config: &Path) -> Self {
        Self::of(Gateway::start(config))
    }

    /// Starts a gateway on a machine that another gateway has left.
    pub(crate) fn again(rig: Rig, config: &Path) -> Self {
        Self::of(Gateway::again(rig, config))
    }

    /// Ends the gateway as a power failure does.
    pub(crate) fn killed(self) -> Rig {
        self.taken().killed()
    }

    /// Kills the gateway as a power failure does, and starts another one on the same machine.
    pub(crate) fn killed_and_started(self, config: &Path) -> Self {
        Self::again(self.killed(), config)
    }

    pub(crate) fn stop(self) -> Rig {
        self.taken().stop()
    }

    fn taken(mut self) -> Gateway {
        self.end_cycles();
        let gateway = Arc::clone(&self.gateway);
        drop(self);
        let gateway = Arc::into_inner(gateway).expect("its cycles have ended");
        gateway.into_inner().unwrap_or_else(PoisonError::into_inner)
    }

    pub(crate) fn of(mut gateway: Gateway) -> Self {
        let others = Interop::open(&gateway.parts.config).expect("free addresses");
        let shape = gateway.shape.clone();
        let others = others.serve(&shape, &gateway.parts.published);
        let listener = http::listen(([127, 0, 0, 1], 0).into()).expect("loopback");
        let served = gateway.parts.serve_dashboard(listener, &shape);
        let (dashboard, live) = served.expect("threads");
        let gateway = Arc::new(Mutex::new(gateway));
        let (ends, largest_step) = <(Arc<AtomicBool>, Arc<Mutex<f64>>)>::default();
        let cycles = thread::spawn({
            let (gateway, ends) = (Arc::clone(&gateway), Arc::clone(&ends));
            let largest_step = Arc::clone(&largest_step);
            let mut before = lock(&gateway).shifts()[1];
            move || {
                while !ends.load(Ordering::Relaxed) {
                    let now = {
                        let mut gateway = lock(&gateway);
                        gateway.step();
                        gateway.shifts()[1]
                    };
                    let mut largest = lock(&largest_step);
                    *largest = largest.max((now - before).abs());
                    before = now;
                    drop(largest);
                    // Leaves processor time and the lock to the requests of clients.
                    thread::sleep(Duration::from_millis(1));
                }
            }
        });
        Self {
            client: Client::of(live.address),
            gateway,
            largest_step,
            ends,
            cycles: Some(cycles),
            _dashboard: dashboard,
            _others: others.expect("threads"),
        }
    }

    fn end_cycles(&mut self) {
        self.ends.store(true, Ordering::Relaxed);
        if let Some(cycles) = self.cycles.take() {
            // If the thread has panicked, the test fails at its next wait.
            let _ = cycles.join();
        }
    }

    pub(crate) fn gateway(&self) -> MutexGuard<'_, Gateway> {
        lock(&self.gateway)
    }

    /// Largest change of Y between two cycles since the last call, µm.
    pub(crate) fn largest_step_um(&self) -> f64 {
        1e3 * std::mem::take(&mut *lock(&self.largest_step))
    }
}

fn lock<T>(shared: &Mutex<T>) -> MutexGuard<'_, T> {
    shared.lock().unwrap_or_else(PoisonError::into_inner)
}

pub(crate) fn control() -> Simulator {
    let mut world = World::new(&['X', 'Y', 'Z']);
    world.motion = Arc::new(|elapsed| {
        let x = 400.0 + 300.0 * (elapsed.as_secs_f64() * 0.5).sin();
        vec![x, 150.0, 50.0]
    });
    Simulator::start("127.0.0.1:0", simulator::Options::default(), world).expect("loopback")
}

/// A controlled_configuration with machine file and tokens for this control, without a test shift and with a short ramp, so that
/// the gateway arms quickly.
pub(crate) fn controlled_configuration(
    dir: &Path,
    control: &Simulator,
    more: &str,
) -> std::path::PathBuf {
    token_file(dir);
    let address = control.address().to_string();
    configuration_of(&address, dir, more, "[dashboard]\ntoken_file = \"tokens\"\n")
}

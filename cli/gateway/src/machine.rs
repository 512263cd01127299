//! Runs the machine on a separate thread: start, supervision and final ramp.
//!
//! A panic on this thread is caught here. A [`Slot`] connects the process with its machine: the process sends orders
//! and reads the phase of the machine. A stop order waits for no lock.

use std::{
    io::Write,
    net::{SocketAddr, TcpListener},
    os::unix::net::UnixListener,
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
    sync::{
        Arc, Mutex,
        atomic::{AtomicU32, AtomicUsize, Ordering},
    },
    time::Duration,
};

use tokio::sync::Semaphore;
use volcomp_guard::Reasons;
use volcomp_port::Description;
use volcomp_runtime::{
    Cycle, DisarmSwitch, Handle, Model, Realtime, Report, monotonic, start as start_thread,
};
use volcomp_vocabulary::{MAX_AXES, PerAxis};

use crate::{
    audit::{AuditLog, LogState, boot_id, output_file},
    config::Config,
    documents::{Broken, LastOutput, Status},
    error::{Failure, GatewayError},
    history::{Columns, Recorder},
    http::{self, AccessControl, Dashboard, Tls, Tokens},
    interop::{
        Interop, RunningInterfaces,
        quantities::{Shape, quantities},
    },
    lock::lock,
    locked,
    models::Models,
    observe::{self, Facts, Times},
    options::Options,
    plan::{OpenedPlan, Plan},
    published::{Published, published},
    request::{Operation, RequestSender, ServiceRequest, queue},
    service::{Life, Service, ServiceParts, standing},
    simulate::Demo,
};

/// The machine controlled by this process.
#[derive(Clone, Debug)]
pub struct Machine {
    pub options: Options,
    /// Watchdog timeout of the service manager, within which the gateway must report that it runs.
    pub proven_within: Duration,
}

/// One iteration of the service loop: [`Service::poll`].
pub type ServiceStep<'t> = &'t mut dyn FnMut(&mut Service);

impl Machine {
    /// Plans the machine from the current files.
    ///
    /// # Errors
    /// An error in one of these files.
    pub fn plan(&self) -> Result<Plan, GatewayError> {
        Plan::new(self.options.configuration()?)
    }

    /// Runs the gateway of this machine until it is stopped or fails. The outcome, including a panic, becomes the phase
    /// of `slot`.
    pub fn run(&self, plan: Plan, slot: &Slot, turn: ServiceStep<'_>) {
        let whole = AssertUnwindSafe(|| self.run_to_its_end(plan, slot, turn));
        let ended = catch_unwind(whole).unwrap_or_else(|_| Err(panicked()));
        slot.set(ended.map_or_else(Phase::Failed, |()| Phase::Ended));
    }

    fn run_to_its_end(
        &self,
        plan: Plan,
        slot: &Slot,
        turn: ServiceStep<'_>,
    ) -> Result<(), Failure> {
        let started = match start(self, plan, slot) {
            Ok(Some(started)) => started,
            // The machine was stopped before the gateway could write anything.
            Ok(None) => return Ok(()),
            Err(error) => return Err(error.failure()),
        };
        let StartedMachine { assembled, runtime, locks, interop } = started;
        let MachineParts {
            mut service,
            requests,
            switch,
            #[cfg(feature = "fleet")]
            fleet,
            ..
        } = assembled;
        let mut hurry = || slot.stops() > 1;
        let mut is_lost = false;
        let turned = catch_unwind(AssertUnwindSafe(|| {
            let mut reloads = slot.reloads();
            while slot.stops() == 0 {
                if slot.reloads() != reloads {
                    reloads = slot.reloads();
                    let reload =
                        ServiceRequest::new(Operation::Reload(None), "signal", None, &switch);
                    if requests.try_send(reload).is_err() {
                        tracing::warn!("reload: too many requests wait");
                    }
                }
                turn(&mut service);
                if service.is_without_control() {
                    tracing::error!("the control thread has ended unexpectedly: nothing corrects");
                    is_lost = true;
                    break;
                }
            }
            service.stop(&mut hurry)
        }));
        let has_panicked = turned.is_err();
        let has_ended = turned.unwrap_or_else(|_| {
            switch.end();
            tracing::error!("fault of the program in the service: the correction ramps to zero");
            catch_unwind(AssertUnwindSafe(|| service.abandon(&mut hurry))).unwrap_or(false)
        });
        if !has_ended {
            // The control thread hangs and may still write, so keep the device locks until the process ends.
            std::mem::forget(locks);
        }
        // Dropping the fleet sends or saves its pending messages.
        #[cfg(feature = "fleet")]
        drop(fleet);
        drop(interop);
        runtime.shutdown_background();
        if is_lost {
            Err(without_control())
        } else if has_panicked {
            Err(panicked())
        } else {
            Ok(())
        }
    }
}

/// The failure reported if the control thread has ended.
fn without_control() -> Failure {
    Failure {
        what: "the control thread has ended unexpectedly, the reason is on standard error: the applied correction remains until the control removes it".to_owned(),
        status: 1,
    }
}

fn panicked() -> Failure {
    Failure { what: "a fault of the program, written on standard error".to_owned(), status: 1 }
}

struct StartedMachine {
    assembled: MachineParts,
    runtime: tokio::runtime::Runtime,
    locks: Vec<UnixListener>,
    interop: RunningInterfaces,
}

/// Starts a machine. `None`: it was stopped before the gateway could write anything.
fn start(
    machine: &Machine,
    plan: Plan,
    slot: &Slot,
) -> Result<Option<StartedMachine>, GatewayError> {
    let listener = http::listen(plan.config.dashboard.listen)?;
    let (interop, shape) = (Interop::open(&plan.config)?, plan.shape());
    let locks = lock(&plan.config)?;
    let audit = open_audit(&plan.config)?;
    let mut opened = plan.open()?;
    if !slot.launch() {
        return Ok(None);
    }
    restore_output(&mut opened);
    let (audit, found) = audit;
    let mut assembled = assemble(machine, opened, audit, slot.life(), |cycle, realtime| {
        let (handle, lacking) = start_thread(cycle, realtime)?;
        slot.launched(&handle.disarm_switch());
        for lacking in &lacking {
            tracing::warn!("{lacking}");
        }
        Ok(handle)
    })?;
    let interop = interop.serve(&shape, &assembled.published)?;
    assembled.service.started(&found);
    let (runtime, live) = assembled.serve_dashboard(listener, &shape)?;
    let url = live.url();
    // Standard output may be closed.
    let mut out = std::io::stdout();
    let _ = writeln!(out, "listening on {url}");
    slot.set(Phase::Running(live));
    Ok(Some(StartedMachine { assembled, runtime, locks, interop }))
}

/// The service of a machine, and the handles shared with other threads.
pub struct MachineParts {
    pub config: Config,
    pub service: Service,
    pub published: Published,
    pub requests: RequestSender,
    pub switch: DisarmSwitch,
    pub models: Models,
    pub tokens: Tokens,
    pub tls: Option<Tls>,
    pub demo: Option<Arc<Demo>>,
    #[cfg(feature = "fleet")]
    pub fleet: Option<crate::fleet::Fleet>,
}

impl MachineParts {
    /// Serves the dashboard on a socket for the lifetime of the runtime.
    ///
    /// # Errors
    /// The operating system cannot create a thread or return the address of the socket.
    pub fn serve_dashboard(
        &mut self,
        listener: TcpListener,
        shape: &Shape,
    ) -> Result<(tokio::runtime::Runtime, Live), GatewayError> {
        let address = listener.local_addr().map_err(|e| GatewayError::system("dashboard", e))?;
        let tls = self.tls.take();
        let live = Live { published: self.published.clone(), address, tls: tls.is_some() };
        let tokens = std::mem::take(&mut self.tokens);
        let tokens = tokens.with_clock(self.published.clock().clone());
        let dashboard = Arc::new(Dashboard {
            models: self.models.clone(),
            published: self.published.clone(),
            quantities: quantities(shape),
            requests: self.requests.clone(),
            switch: self.switch.clone(),
            access: Arc::new(AccessControl {
                is_demo: self.demo.is_some(),
                ..AccessControl::new(&self.config.dashboard, tokens)
            }),
            streams: AtomicUsize::new(0),
            demo: self.demo.clone(),
            audit_dir: self.config.audit_dir().to_owned(),
            log_reader: Arc::new(Semaphore::new(1)),
        });
        let runtime = http::runtime(listener, |listener| {
            http::serve(listener, tls, http::router(dashboard))
        })?;
        Ok((runtime, live))
    }
}

/// Initializes the cycle with the last stored output. Without a stored output the output is unknown, not zero: the
/// device must report it, or an operator must check the machine.
pub fn restore_output(opened: &mut OpenedPlan) {
    let unknown = || (PerAxis::from_fn(|_| f64::NAN), Duration::ZERO);
    let file = output_file(opened.config.audit_dir());
    let remembered = last_output(&file, &opened.model, &opened.controllers);
    let (output, age) = remembered.unwrap_or_else(unknown);
    opened.cycle.restore(&output, age);
}

/// Builds the service of a machine around its cycle, which `launch` starts. [`Service::started`] writes the first
/// record of the service.
///
/// # Errors
/// `launch` fails, or the operating system cannot create a thread.
pub fn assemble(
    machine: &Machine,
    opened: OpenedPlan,
    audit: AuditLog,
    life: &Life,
    launch: impl FnOnce(Cycle, Realtime) -> Result<Handle, GatewayError>,
) -> Result<MachineParts, GatewayError> {
    let OpenedPlan { config, mut cycle, model, controllers, sensors, truth, tokens, tls, demo } =
        opened;
    let mut standing = standing::read(config.audit_dir());
    for (index, interlock) in standing::interlocks(&mut standing, &controllers) {
        cycle.restore_interlock(index, interlock);
    }
    let handle = launch(cycle, config.realtime)?;
    let switch = handle.disarm_switch();
    let facts = Facts {
        model: &model,
        controllers: &controllers,
        sensors: &sensors,
        truth: truth.as_ref(),
        guard: config.guard.as_ref(),
        auto_arm: config.auto_arm,
        cycle: config.cycle(),
    };
    let first: Status = observe::status(&facts, &Report::default(), &Times::default());
    let columns = Columns::new(&model.axes, &sensors);
    let recorder = Recorder::start(config.audit_dir(), columns)
        .map_err(|e| GatewayError::system("history", e))?;
    let (publisher, published) = published(first, Arc::clone(&model), handle.pulse(), recorder);
    let (requests, request_queue) = queue();
    #[cfg(feature = "fleet")]
    let fleet = crate::fleet::start(&config, &published, &requests, &switch)?;
    let is_built_in = machine.options.config.is_none();
    let models = Models::start(&config, is_built_in, &published, &requests, &switch)?;
    let parts = ServiceParts {
        handle,
        forbids: Reasons::NO_LIMITS.when(config.guard.is_none()) | forbids_of_centre(&config),
        options: machine.options.clone(),
        controllers,
        sensors,
        model,
        truth,
        standing,
        config: config.clone(),
        life: life.clone(),
        proven_within: machine.proven_within,
        notes: models.notes(),
    };
    let service = Service::new(parts, audit, publisher, request_queue)?;
    Ok(MachineParts {
        config,
        service,
        published,
        requests,
        switch,
        models,
        tokens,
        tls,
        demo,
        #[cfg(feature = "fleet")]
        fleet,
    })
}

fn forbids_of_centre(config: &Config) -> Reasons {
    #[cfg(feature = "fleet")]
    let forbids = crate::fleet::forbids(config);
    // In a build without the feature, planning rejects a configuration with a centre.
    #[cfg(not(feature = "fleet"))]
    let forbids = Reasons::NONE.when(config.fleet.is_some());
    forbids
}

/// Opens the audit log and returns the state in which it was found.
///
/// # Errors
/// The folder or file cannot be written.
pub fn open_audit(config: &Config) -> Result<(AuditLog, LogState), GatewayError> {
    let (audit, found) = AuditLog::open(config.audit_dir())
        .map_err(|e| GatewayError::system(config.audit_dir().display().to_string(), e))?;
    if found.cut_bytes > 0 {
        tracing::warn!(
            "audit log: a torn tail of {} bytes was cut after {} records",
            found.cut_bytes,
            found.records
        );
    }
    if let Some(Broken { line, aside }) = &found.broken {
        tracing::error!(
            "audit log: line {line} does not belong to the chain: the file is now {}",
            aside
        );
    }
    Ok((audit, found))
}

/// The last stored output (mm, rad) and its age. `None` if no readable output is stored, or it belongs to another boot,
/// other axes or other controllers.
fn last_output(
    path: &Path,
    model: &Model,
    controllers: &[Description],
) -> Option<(PerAxis<f64>, Duration)> {
    let text = std::fs::read_to_string(path).ok()?;
    let output: LastOutput = serde_json::from_str(&text).ok()?;
    let fits = output.boot == boot_id()
        && (output.axes, output.controllers) == LastOutput::belongs_to(model, controllers)
        && output.correction.len() <= MAX_AXES
        && output.correction.iter().all(|value| value.is_finite());
    let written = Duration::try_from_secs_f64(output.monotonic_s).unwrap_or_default();
    let age = monotonic().saturating_sub(written);
    let of = |axis: usize| output.correction.get(axis).copied().unwrap_or(0.0);
    fits.then(|| (PerAxis::from_fn(of), age))
}

/// Orders to a machine, and its phase.
#[derive(Default)]
pub struct Slot {
    stops: AtomicU32,
    reloads: AtomicU32,
    /// `None` until the control thread is started.
    switch: Mutex<Option<DisarmSwitch>>,
    phase: Mutex<Phase>,
    life: Life,
}

#[derive(Clone, Default)]
pub enum Phase {
    /// Files are being read and devices opened; nothing can be written yet.
    #[default]
    Starting,
    /// The control thread is being started.
    Launching,
    /// The control thread runs.
    Running(Live),
    /// The machine ended with this failure.
    Failed(Failure),
    /// The machine was stopped.
    Ended,
}

/// Public handles of a running machine.
#[derive(Clone)]
pub struct Live {
    /// Latest state of the machine, as served by dashboard and interfaces.
    pub published: Published,
    /// Listening address of the dashboard.
    pub address: SocketAddr,
    /// True if the dashboard uses TLS.
    pub tls: bool,
}

impl Live {
    /// URL of the dashboard.
    pub fn url(&self) -> String {
        let scheme = if self.tls { "https" } else { "http" };
        format!("{scheme}://{}", self.address)
    }
}

impl Slot {
    /// Orders a stop: the correction ramps out from the next cycle on. A second order ends the machine immediately.
    pub fn stop(&self) {
        self.stops.fetch_add(1, Ordering::SeqCst);
        // The lock is held only while the switch is being set. `launched` checks the orders afterwards.
        if let Ok(switch) = self.switch.try_lock()
            && let Some(switch) = &*switch
        {
            switch.end();
        }
    }

    pub fn stops(&self) -> u32 {
        self.stops.load(Ordering::SeqCst)
    }

    /// Orders a reload of configuration and machine file.
    pub fn reload(&self) {
        self.reloads.fetch_add(1, Ordering::Relaxed);
    }

    pub fn reloads(&self) -> u32 {
        self.reloads.load(Ordering::Relaxed)
    }

    pub fn phase(&self) -> Phase {
        locked(&self.phase).clone()
    }

    /// Proof that cycles are on time.
    pub fn life(&self) -> &Life {
        &self.life
    }

    pub(crate) fn set(&self, phase: Phase) {
        *locked(&self.phase) = phase;
    }

    /// Marks the start of the control thread. `false` if the machine was stopped meanwhile and must not start.
    pub(crate) fn launch(&self) -> bool {
        let mut phase = locked(&self.phase);
        let may = matches!(*phase, Phase::Starting) && self.stops() == 0;
        *phase = if may { Phase::Launching } else { Phase::Ended };
        may
    }

    /// Abandons a machine whose devices are still being opened.
    pub(crate) fn give_up(&self) {
        let mut phase = locked(&self.phase);
        if matches!(*phase, Phase::Starting) {
            *phase = Phase::Ended;
        }
    }

    /// Sets the switch of the started control thread. A stop ordered meanwhile takes effect now.
    pub(crate) fn launched(&self, switch: &DisarmSwitch) {
        *locked(&self.switch) = Some(switch.clone());
        if self.stops() > 0 {
            switch.end();
        }
    }
}

impl Phase {
    pub(crate) fn is_starting(&self) -> bool {
        matches!(self, Self::Starting | Self::Launching)
    }
}

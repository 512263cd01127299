//! The machine, in a thread of its own: started, kept running, ramped out at its end. A fault of the program in it is caught here.

use std::{
    io::Write,
    net::TcpListener,
    os::unix::net::UnixListener,
    panic::{AssertUnwindSafe, catch_unwind},
    path::Path,
    sync::{Arc, atomic::AtomicUsize},
    time::Duration,
};

use volcomp_guard::Reasons;
use volcomp_port::Description;
use volcomp_runtime::{
    Cycle, DisarmSwitch, Handle, Model, Realtime, Report, monotonic, start as start_thread,
};
use volcomp_vocabulary::{MAX_AXES, PerAxis};

use crate::{
    audit::{AuditLog, Found, boot_id},
    config::Config,
    documents::{Broken, LastOutput, Status},
    error::{Failure, GatewayError},
    http::{self, Dashboard, Door, Tls, Tokens},
    interop::{
        Interop, Served,
        quantities::{Shape, quantities},
    },
    lock::lock,
    models::Models,
    observe::{self, Facts},
    options::Options,
    plan::{Opened, Plan},
    published::{Published, published},
    request::{Ask, Asked, Asks, queue},
    service::{Life, Parts, Service, standing},
    slot::{Live, Phase, Slot},
    times::Times,
};

/// The machine of the process.
#[derive(Clone, Debug)]
pub struct Machine {
    /// How the gateway is called.
    pub options: Options,
    /// The time of the watchdog of the service manager.
    pub proven_within: Duration,
}

/// One turn of a service: [`Service::turn`].
pub type Turn<'t> = &'t mut dyn FnMut(&mut Service);

impl Machine {
    /// The plan of its files as they are now.
    ///
    /// # Errors
    /// What is wrong with them.
    pub fn plan(&self) -> Result<Plan, GatewayError> {
        Plan::new(self.options.configuration()?)
    }

    /// Runs it until it is told to stop.
    pub fn run(&self, plan: Plan, slot: &Slot, turn: Turn<'_>) {
        let whole = AssertUnwindSafe(|| self.run_to_its_end(plan, slot, turn));
        let ended = catch_unwind(whole).unwrap_or_else(|_| Err(panicked()));
        slot.set(ended.map_or_else(Phase::Failed, |()| Phase::Ended));
    }

    fn run_to_its_end(&self, plan: Plan, slot: &Slot, turn: Turn<'_>) -> Result<(), Failure> {
        let started = match start(self, plan, slot) {
            Ok(Some(started)) => started,
            // Told to stop before anything could be written.
            Ok(None) => return Ok(()),
            Err(error) => return Err(error.failure()),
        };
        let Started {
            assembled,
            runtime,
            locks,
            interop,
        } = started;
        let Assembled {
            mut service,
            asks,
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
                    let reload = Asked::new(Ask::Reload(None), "signal", None, &switch);
                    if asks.try_send(reload).is_err() {
                        tracing::warn!("reload: too many requests wait");
                    }
                }
                turn(&mut service);
                if service.is_without_control() {
                    tracing::error!("the control thread has ended by itself: nothing corrects");
                    is_lost = true;
                    break;
                }
            }
            service.stop(&mut hurry)
        }));
        let has_panicked = turned.is_err();
        let has_ended = turned.unwrap_or_else(|_| {
            tracing::error!("fault of the program in the service: the correction ramps to zero");
            switch.end();
            catch_unwind(AssertUnwindSafe(|| service.abandon(&mut hurry))).unwrap_or(false)
        });
        if !has_ended {
            // It hangs: the locks of its devices are held until the process ends.
            std::mem::forget(locks);
        }
        // What was to be told last is sent or kept.
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

/// A machine whose control thread has ended, so that what is applied stands until the control takes it out.
fn without_control() -> Failure {
    Failure {
        what: "the control thread has ended by itself, why is written on standard error: what was applied stands until the control takes it out".to_owned(),
        status: 1,
    }
}

/// A machine in which the program has a fault.
fn panicked() -> Failure {
    Failure {
        what: "a fault of the program, written on standard error".to_owned(),
        status: 1,
    }
}

/// A machine that runs.
struct Started {
    assembled: Assembled,
    /// The dashboard.
    runtime: tokio::runtime::Runtime,
    /// One gateway for each device.
    locks: Vec<UnixListener>,
    /// Other systems that read it, as long as this is held.
    interop: Served,
}

/// Starts a machine; `None`: it was told to stop before anything could be written.
fn start(machine: &Machine, plan: Plan, slot: &Slot) -> Result<Option<Started>, GatewayError> {
    let listener = http::listen(plan.config.dashboard.listen)?;
    let (interop, shape) = (Interop::open(&plan.config)?, plan.shape());
    let locks = lock(&plan.config)?;
    let audit = open_audit(&plan.config)?;
    let mut opened = plan.open()?;
    restore_output(&mut opened);
    if !slot.launch() {
        return Ok(None);
    }
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
    // Nobody may be reading.
    let mut out = std::io::stdout();
    let _ = writeln!(out, "listening on {url}");
    slot.set(Phase::Running(live));
    Ok(Some(Started {
        assembled,
        runtime,
        locks,
        interop,
    }))
}

/// The service of a machine, and what others reach of it.
#[expect(missing_docs, reason = "each is named as its type")]
pub struct Assembled {
    pub config: Config,
    pub service: Service,
    pub published: Published,
    pub asks: Asks,
    pub switch: DisarmSwitch,
    pub models: Models,
    pub tokens: Tokens,
    pub tls: Option<Tls>,
    #[cfg(feature = "fleet")]
    pub fleet: Option<crate::fleet::Fleet>,
}

impl Assembled {
    /// Serves the dashboard on a socket, as long as the runtime lives.
    ///
    /// # Errors
    /// The operating system gives no thread, or no address of the socket.
    pub fn serve_dashboard(
        &mut self,
        listener: TcpListener,
        shape: &Shape,
    ) -> Result<(tokio::runtime::Runtime, Live), GatewayError> {
        let address = listener
            .local_addr()
            .map_err(|e| GatewayError::system("dashboard", e))?;
        let tls = self.tls.take();
        let live = Live {
            published: self.published.clone(),
            address,
            tls: tls.is_some(),
        };
        let tokens = std::mem::take(&mut self.tokens);
        let tokens = tokens.with_clock(self.published.clock().clone());
        let dashboard = Arc::new(Dashboard {
            models: self.models.clone(),
            published: self.published.clone(),
            quantities: quantities(shape),
            asks: self.asks.clone(),
            switch: self.switch.clone(),
            door: Arc::new(Door::new(&self.config.dashboard, tokens)),
            streams: AtomicUsize::new(0),
        });
        let runtime = http::runtime(listener, |listener| {
            http::serve(listener, tls, http::router(dashboard))
        })?;
        Ok((runtime, live))
    }
}

/// Lets the cycle begin with the output that was stored last. What is not remembered is not zero: the device tells it, or a person
/// has to look.
pub fn restore_output(opened: &mut Opened) {
    let unknown = || (PerAxis::from_fn(|_| f64::NAN), Duration::ZERO);
    let file = opened.config.audit_dir().join("output.json");
    let remembered = last_output(&file, &opened.model, &opened.controllers);
    let (output, age) = remembered.unwrap_or_else(unknown);
    opened.cycle.restore(&output, age);
}

/// Puts the service of a machine together around its cycle, which `launch` starts. Its first record is written by
/// [`Service::started`].
///
/// # Errors
/// What `launch` refuses, or the operating system gives no thread.
pub fn assemble(
    machine: &Machine,
    opened: Opened,
    audit: AuditLog,
    life: &Life,
    launch: impl FnOnce(Cycle, Realtime) -> Result<Handle, GatewayError>,
) -> Result<Assembled, GatewayError> {
    let Opened {
        config,
        cycle,
        model,
        controllers,
        sensors,
        truth,
        tokens,
        tls,
    } = opened;
    let handle = launch(cycle, config.realtime)?;
    let switch = handle.disarm_switch();
    let facts = Facts {
        model: &model,
        controllers: &controllers,
        sensors: &sensors,
        truth: truth.as_ref(),
        auto_arm: config.auto_arm,
        cycle: config.cycle(),
    };
    let first: Status = observe::status(&facts, &Report::default(), &Times::default());
    let (publisher, published) = published(first, Arc::clone(&model), handle.pulse());
    let (asks, asked) = queue();
    #[cfg(feature = "fleet")]
    let fleet = crate::fleet::start(&config, &published, &asks, &switch)?;
    let is_built_in = machine.options.config.is_none();
    let models = Models::start(&config, is_built_in, &published, &asks, &switch)?;
    let parts = Parts {
        handle,
        forbids: Reasons::NO_LIMITS.when(config.guard.is_none()) | forbids_of_centre(&config),
        options: machine.options.clone(),
        controllers,
        sensors,
        model,
        truth,
        standing: standing::read(config.audit_dir()),
        config: config.clone(),
        life: life.clone(),
        proven_within: machine.proven_within,
        notes: models.notes(),
    };
    let service = Service::new(parts, audit, publisher, asked)?;
    Ok(Assembled {
        config,
        service,
        published,
        asks,
        switch,
        models,
        tokens,
        tls,
        #[cfg(feature = "fleet")]
        fleet,
    })
}

/// What the centre of the fleet said last about correcting at all.
fn forbids_of_centre(config: &Config) -> Reasons {
    #[cfg(feature = "fleet")]
    let forbids = crate::fleet::forbids(config);
    // Without the feature there is no plan of a configuration with a centre.
    #[cfg(not(feature = "fleet"))]
    let forbids = Reasons::NONE.when(config.fleet.is_some());
    forbids
}

/// The audit log, and what was found when it was opened.
///
/// # Errors
/// A folder or file that cannot be written.
pub fn open_audit(config: &Config) -> Result<(AuditLog, Found), GatewayError> {
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

/// The last output that was stored (mm, rad), and how long ago; `None` where none was, it cannot be read, is of another
/// boot of the computer, of other axes or of other controllers. Where the program did not come to its end it may have
/// sent another one afterwards: then what was sent last is no number.
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
    let of = |axis: usize| match output.correction.get(axis) {
        Some(value) if output.ended => *value,
        Some(_) => f64::NAN,
        None => 0.0,
    };
    fits.then(|| (PerAxis::from_fn(of), age))
}

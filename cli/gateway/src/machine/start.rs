//! From a plan to a machine that runs: sockets, locks, log, devices, control thread, service, dashboard.

use std::{
    io::Write,
    os::unix::net::UnixListener,
    path::Path,
    sync::{Arc, atomic::AtomicUsize},
    time::Duration,
};

use volcomp_guard::Reasons;
use volcomp_port::Description;
use volcomp_runtime::{DisarmSwitch, Model, Report, monotonic, start as start_thread};
use volcomp_vocabulary::{MAX_AXES, PerAxis};

use super::Machine;
use crate::{
    audit::{AuditLog, Found, boot_id},
    config::Config,
    documents::{LastOutput, Status},
    error::GatewayError,
    http::{self, Dashboard, Door},
    interop::{Interop, Served, quantities::quantities},
    lock::lock,
    models::Models,
    observe::{self, Facts},
    plan::{Opened, Plan},
    published::published,
    request::{Asks, queue},
    service::{Parts, Service, standing},
    slot::{Live, Phase, Slot},
    times::Times,
};

/// A machine that runs.
pub(super) struct Started {
    pub(super) service: Service,
    pub(super) asks: Asks,
    pub(super) switch: DisarmSwitch,
    /// The dashboard.
    pub(super) runtime: tokio::runtime::Runtime,
    /// One gateway for each device.
    pub(super) locks: Vec<UnixListener>,
    /// Other systems that read it, as long as this is held.
    pub(super) interop: Served,
    /// The threads that speak with the centre, as long as this is held.
    #[cfg(feature = "fleet")]
    pub(super) fleet: Option<crate::fleet::Fleet>,
}

/// Starts a machine; `None`: it was told to stop before anything could be written.
pub(super) fn start(
    machine: &Machine,
    plan: Plan,
    slot: &Slot,
) -> Result<Option<Started>, GatewayError> {
    let listener = http::listen(plan.config.dashboard.listen)?;
    let (interop, shape) = (Interop::open(&plan.config)?, plan.shape());
    let locks = lock(&plan.config)?;
    let (audit, found) = open_audit(&plan.config)?;
    let Opened {
        config,
        mut cycle,
        model,
        controllers,
        sensors,
        truth,
        tokens,
        tls,
    } = plan.open()?;
    // What is not remembered is not zero: the device tells it, or a person has to look.
    let unknown = || (PerAxis::from_fn(|_| f64::NAN), Duration::ZERO);
    let remembered = last_output(
        &config.audit_dir().join("output.json"),
        &model,
        &controllers,
    );
    let (output, age) = remembered.unwrap_or_else(unknown);
    cycle.restore(&output, age);
    if !slot.launch() {
        return Ok(None);
    }
    let (handle, lacking) = start_thread(cycle, config.realtime)?;
    let switch = handle.disarm_switch();
    slot.launched(&switch);
    for lacking in &lacking {
        tracing::warn!("{lacking}");
    }
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
    let interop = interop.serve(&shape, &published)?;
    let address = listener
        .local_addr()
        .map_err(|e| GatewayError::system("dashboard", e))?;
    let live = Live {
        published: published.clone(),
        address,
        tls: tls.is_some(),
    };
    #[cfg(feature = "fleet")]
    let fleet = crate::fleet::start(&config, &published, &asks, &switch)?;
    let is_built_in = machine.options.config.is_none();
    let models = Models::start(&config, is_built_in, &published, &asks, &switch)?;
    let dashboard = Dashboard {
        models: models.clone(),
        published,
        quantities: quantities(&shape),
        asks: asks.clone(),
        switch: switch.clone(),
        door: Arc::new(Door::new(&config.dashboard, tokens)),
        streams: AtomicUsize::new(0),
    };
    let parts = Parts {
        handle,
        forbids: Reasons::NO_LIMITS.when(config.guard.is_none()) | forbids_of_centre(&config),
        options: machine.options.clone(),
        controllers,
        sensors,
        model,
        truth,
        standing: standing::read(config.audit_dir()),
        config,
        life: slot.life().clone(),
        proven_within: machine.proven_within,
        notes: models.notes(),
    };
    let mut service = Service::new(parts, audit, publisher, asked)?;
    service.started(&found);
    let runtime = http::runtime(listener, |listener| {
        http::serve(listener, tls, http::router(Arc::new(dashboard)))
    })?;
    let url = live.url();
    // Nobody may be reading.
    let mut out = std::io::stdout();
    let _ = writeln!(out, "listening on {url}");
    slot.set(Phase::Running(live));
    Ok(Some(Started {
        service,
        asks,
        switch,
        runtime,
        locks,
        interop,
        #[cfg(feature = "fleet")]
        fleet,
    }))
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
fn open_audit(config: &Config) -> Result<(AuditLog, Found), GatewayError> {
    let (audit, found) = AuditLog::open(config.audit_dir())
        .map_err(|e| GatewayError::system(config.audit_dir().display().to_string(), e))?;
    if found.cut_bytes > 0 {
        tracing::warn!(
            "audit log: a torn tail of {} bytes was cut after {} records",
            found.cut_bytes,
            found.records
        );
    }
    if let Some((line, aside)) = &found.broken {
        tracing::error!(
            "audit log: line {line} does not belong to the chain: the file is now {}",
            aside.display()
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

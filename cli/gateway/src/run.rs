//! From a call to a running gateway, and to its end.

use std::{
    io::Write,
    net::TcpListener,
    path::Path,
    sync::{Arc, atomic::AtomicUsize},
    time::Duration,
};

use volcomp_guard::Reasons;
use volcomp_port::Description;
use volcomp_runtime::{DisarmSwitch, Model, Report, monotonic, start};
use volcomp_vocabulary::{MAX_AXES, PerAxis};

use crate::{
    audit::{AuditLog, Found, boot_id},
    config::Config,
    documents::{LastOutput, Status},
    error::GatewayError,
    http::{self, Dashboard, Tls},
    lock::lock,
    observe::{self, Facts},
    options::Options,
    plan::{Opened, Plan},
    process::Process,
    published::published,
    request::{Ask, Asked, Asks, queue},
    service::{Parts, Service, standing},
    signals::{Heard, Signal},
    times::Times,
};

/// Runs until it is told to stop.
///
/// # Errors
/// Why it does not start. Once it runs, troubles are states and log lines.
pub fn run(options: &Options) -> Result<(), GatewayError> {
    let plan = Plan::new(options.configuration()?)?;
    let process = Process::prepare();
    let listener = listen(&plan.config)?;
    let _locks = lock(&plan.config)?;
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
    let remembered = last_output(&config.audit_dir.join("output.json"), &model, &controllers);
    let (output, age) = remembered.unwrap_or_else(unknown);
    cycle.restore(&output, age);
    let (handle, lacking) = start(cycle, config.realtime)?;
    for lacking in process.lacking.iter().chain(&lacking) {
        tracing::warn!("{lacking}");
    }
    let facts = Facts {
        model: &model,
        controllers: &controllers,
        sensors: &sensors,
        truth: truth.as_ref(),
        auto_arm: config.auto_arm,
        cycle: config.cycle,
    };
    let first: Status = observe::status(&facts, &Report::default(), &Times::default());
    let switch = handle.disarm_switch();
    let stops = switch.clone();
    let signals = Heard::new(move || stops.end())?;
    let (publisher, published) = published(first, Arc::clone(&model), handle.pulse());
    let (asks, asked) = queue();
    let address = listener
        .local_addr()
        .map_err(|e| GatewayError::system("dashboard", e))?;
    let scheme = if tls.is_some() { "https" } else { "http" };
    let dashboard = Dashboard {
        published,
        controllers: controllers.len(),
        asks: asks.clone(),
        switch: switch.clone(),
        tokens,
        hosts: config.dashboard.hosts.clone(),
        reading_needs_token: !config.dashboard.listen.ip().is_loopback(),
        streams: AtomicUsize::new(0),
    };
    let parts = Parts {
        handle,
        forbids: Reasons::NO_LIMITS.when(config.guard.is_none()),
        options: options.clone(),
        controllers,
        sensors,
        model,
        truth,
        standing: standing::read(&config.audit_dir),
        config,
    };
    let mut service = Service::new(parts, audit, publisher, asked)?;
    service.started(&found);
    let runtime = serve(listener, tls, dashboard)?;
    // Nobody may be reading.
    let _ = writeln!(std::io::stdout(), "listening on {scheme}://{address}");
    let _ = sd_notify::notify(&[sd_notify::NotifyState::Ready]);
    until_stopped(&mut service, &signals, &asks, &switch);
    runtime.shutdown_background();
    Ok(())
}

/// Turns until SIGTERM or SIGINT; SIGHUP reloads. A second signal ends a stop at once.
fn until_stopped(service: &mut Service, signals: &Heard, asks: &Asks, switch: &DisarmSwitch) {
    loop {
        while let Some(signal) = signals.next() {
            if signal == Signal::Stop {
                service.stop(&mut || signals.stops());
                return;
            }
            let reload = Asked::new(Ask::Reload(None), "signal", None, switch);
            if asks.try_send(reload).is_err() {
                tracing::warn!("reload: too many requests wait");
            }
        }
        service.turn();
    }
}

/// The socket of the dashboard.
fn listen(config: &Config) -> Result<TcpListener, GatewayError> {
    let address = config.dashboard.listen;
    TcpListener::bind(address)
        .and_then(|listener| listener.set_nonblocking(true).map(|()| listener))
        .map_err(|e| GatewayError::system(format!("dashboard {address}"), e))
}

/// A runtime with one worker for the dashboard.
fn serve(
    listener: TcpListener,
    tls: Option<Tls>,
    dashboard: Dashboard,
) -> Result<tokio::runtime::Runtime, GatewayError> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .max_blocking_threads(1)
        .thread_name("volcomp-http")
        .thread_stack_size(512 * 1024)
        .enable_io()
        .enable_time()
        .build()
        .map_err(|e| GatewayError::system("dashboard", e))?;
    let guard = runtime.enter();
    let listener = tokio::net::TcpListener::from_std(listener)
        .map_err(|e| GatewayError::system("dashboard", e))?;
    drop(guard);
    runtime.spawn(http::serve(
        listener,
        tls,
        http::router(Arc::new(dashboard)),
    ));
    Ok(runtime)
}

/// The audit log, and what was found when it was opened.
fn open_audit(config: &Config) -> Result<(AuditLog, Found), GatewayError> {
    let (audit, found) = AuditLog::open(&config.audit_dir)
        .map_err(|e| GatewayError::system(config.audit_dir.display().to_string(), e))?;
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

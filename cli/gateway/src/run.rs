//! From a call to a running gateway, and back to nothing.

use std::{
    io::{ErrorKind, Write},
    net::{SocketAddr, TcpListener},
    os::{
        linux::net::SocketAddrExt,
        unix::net::{SocketAddr as UnixAddress, UnixListener},
    },
    path::{Path, PathBuf},
    sync::{Arc, atomic::AtomicUsize, mpsc::sync_channel},
    time::Duration,
};

use sha2::{Digest, Sha256};
use signal_hook::{
    consts::{SIGHUP, SIGINT, SIGTERM},
    iterator::Signals,
};
use volcomp_guard::Reasons;
use volcomp_port::{Clock, Description};

use volcomp_vocabulary::{AxisName, PerAxis};

use crate::{
    assemble::{self, PathConfig},
    audit::{AuditLog, boot_id},
    config::{Config, DashboardConfig},
    cycle::{Cycle, Sensors},
    error::GatewayError,
    http::{self, Dashboard, Tokens},
    model::Model,
    process::Process,
    realtime,
    service::{Ask, Asked, Parts, Service, no_limits, published},
    simulate::{self, Simulation, Truth},
};

/// How the gateway is called.
#[derive(Clone, Debug, Default)]
pub struct Options {
    /// The configuration; `None`: the embedded simulation.
    pub config: Option<PathBuf>,
    /// Where the dashboard listens, instead of the configured place.
    pub listen: Option<SocketAddr>,
    /// Named tokens, instead of the configured file.
    pub token_file: Option<PathBuf>,
    /// Folder of the audit log, instead of the configured one.
    pub audit_dir: Option<PathBuf>,
    /// Time of a cycle of the simulation.
    pub simulated_cycle: Option<Duration>,
}

/// What is corrected, put together.
struct Assembled {
    cycle: Cycle,
    controllers: Vec<Description>,
    sensors: Vec<String>,
    model: Arc<Model>,
    truth: Option<Truth>,
}

/// Runs until it is told to stop.
///
/// # Errors
/// Why it does not start. Once it runs, troubles are states and log lines.
pub fn run(options: &Options) -> Result<(), GatewayError> {
    let config = configuration(options)?;
    let process = Process::prepare();
    let (listener, tls) = listen(&config)?;
    let tokens = Tokens::load(
        options
            .token_file
            .as_deref()
            .or(config.dashboard.token_file.as_deref()),
    )?;
    let is_local = config.dashboard.listen.ip().is_loopback();
    if !is_local && tokens.is_empty() {
        return Err(GatewayError::Unfit("[dashboard]: others can reach it, so reading needs a token: token_file is missing or empty".to_owned()));
    }
    let assembled = assemble_all(options, &config)?;
    let _locks = lock(&config)?;
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
    let Assembled {
        cycle,
        controllers,
        sensors,
        model,
        truth,
    } = assembled;
    let (handle, lacking) = realtime::start(cycle, config.cycle, config.realtime)?;
    for lacking in process.lacking.iter().chain(&lacking) {
        tracing::warn!("{lacking}");
    }
    let (publisher, published) = published(Arc::clone(&model));
    let (asks, asked) = sync_channel(64);
    let address = listener
        .local_addr()
        .map_err(|e| GatewayError::system("dashboard", e))?;
    let scheme = if tls.is_some() { "https" } else { "http" };
    let dashboard = Dashboard {
        published,
        asks: asks.clone(),
        tokens,
        hosts: config.dashboard.hosts.clone(),
        reading_needs_token: !is_local,
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
        audit,
        config,
    };
    let mut service = Service::new(parts, publisher, asked);
    service.started(&found);
    let runtime = serve(listener, tls, dashboard)?;
    // Nobody may be reading.
    let _ = writeln!(std::io::stdout(), "listening on {scheme}://{address}");
    let _ = sd_notify::notify(&[sd_notify::NotifyState::Ready]);
    until_stopped(&mut service, &asks)?;
    runtime.shutdown_background();
    Ok(())
}

/// Turns until SIGTERM or SIGINT; SIGHUP reloads. A second signal ends a stop at once.
fn until_stopped(
    service: &mut Service,
    asks: &std::sync::mpsc::SyncSender<Asked>,
) -> Result<(), GatewayError> {
    let mut signals =
        Signals::new([SIGTERM, SIGINT, SIGHUP]).map_err(|e| GatewayError::system("signals", e))?;
    loop {
        for signal in signals.pending() {
            if signal != SIGHUP {
                service.stop(&mut || signals.pending().any(|signal| signal != SIGHUP));
                return Ok(());
            }
            let reload = Asked {
                ask: Ask::Reload(None),
                who: "signal".to_owned(),
                answer: None,
            };
            if asks.try_send(reload).is_err() {
                tracing::warn!("reload: too many requests wait");
            }
        }
        service.turn();
    }
}

/// The configuration with what the call says instead.
pub(crate) fn configuration(options: &Options) -> Result<Config, GatewayError> {
    let mut config = match &options.config {
        Some(path) => Config::read(path)?,
        None => simulate::config(),
    };
    if let Some(listen) = options.listen {
        config.dashboard.listen = listen;
    }
    if let Some(dir) = &options.audit_dir {
        config.audit_dir.clone_from(dir);
    }
    if let (None, Some(cycle)) = (&options.config, options.simulated_cycle) {
        config.cycle = cycle;
    }
    Ok(config)
}

/// Where others can reach the dashboard it needs TLS.
fn check_listen(dashboard: &DashboardConfig) -> Result<(), GatewayError> {
    let address = dashboard.listen;
    if address.ip().is_loopback() || dashboard.tls.is_some() {
        return Ok(());
    }
    Err(GatewayError::Unfit(format!(
        "[dashboard] listen = {address}: others can reach this address, so tls_certificate and tls_key are needed (volcomp-gateway tls-init makes a pair)"
    )))
}

/// The socket of the dashboard; where others can reach it, only with TLS.
fn listen(
    config: &Config,
) -> Result<(TcpListener, Option<tokio_rustls::TlsAcceptor>), GatewayError> {
    let address = config.dashboard.listen;
    let tls = config
        .dashboard
        .tls
        .as_ref()
        .map(|(certificate, key)| http::tls::acceptor(certificate, key))
        .transpose()?;
    check_listen(&config.dashboard)?;
    let bound = TcpListener::bind(address)
        .and_then(|listener| listener.set_nonblocking(true).map(|()| listener));
    Ok((
        bound.map_err(|e| GatewayError::system(format!("dashboard {address}"), e))?,
        tls,
    ))
}

/// A runtime with one worker for the dashboard.
fn serve(
    listener: TcpListener,
    tls: Option<tokio_rustls::TlsAcceptor>,
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
    runtime.spawn(http::serve(listener, tls, Arc::new(dashboard)));
    Ok(runtime)
}

fn assemble_all(options: &Options, config: &Config) -> Result<Assembled, GatewayError> {
    let mut assembled = if options.config.is_some() {
        assemble_configured(config)?
    } else {
        assemble_simulated(config)?
    };
    if let Some(output) = last_output(&config.audit_dir.join("output.json")) {
        assembled.cycle.restore(&output);
    }
    Ok(assembled)
}

fn assemble_configured(config: &Config) -> Result<Assembled, GatewayError> {
    let guard = config.guard.clone().unwrap_or_else(no_limits);
    let model = Model::read(&config.machine, guard.fading)?;
    let cycle = assemble::cycle(config, &guard, Box::new(model.clone()))?;
    Ok(Assembled {
        controllers: cycle
            .paths()
            .iter()
            .map(|path| path.controller.description().clone())
            .collect(),
        sensors: config
            .thermometers
            .iter()
            .flat_map(|thermometer| thermometer.names.clone())
            .collect(),
        model: Arc::new(model),
        truth: None,
        cycle,
    })
}

fn assemble_simulated(config: &Config) -> Result<Assembled, GatewayError> {
    let guard = config.guard.clone().unwrap_or_else(no_limits);
    let simulation = Simulation::new(Clock::system())?;
    let model = Model::new(&simulation.model, guard.fading)?;
    let path_config = PathConfig {
        fixed: Vec::new(),
        unwatched: false,
        proves: true,
        position_step: 0.0,
        read_back_cycles: 1,
    };
    let controller = Box::new(simulation.controller);
    let path = assemble::path(
        controller,
        &model,
        &guard,
        &path_config,
        config.cycle,
        &mut Vec::new(),
    )?;
    let sensors = Sensors {
        thermometers: vec![Box::new(simulation.thermometer)],
        limits: assemble::sensor_limits(&guard),
    };
    Ok(Assembled {
        controllers: vec![path.controller.description().clone()],
        sensors: sensors.names(),
        model: Arc::new(model.clone()),
        truth: Some(simulation.truth),
        cycle: Cycle::new(
            Box::new(model),
            vec![path],
            guard.hand_back,
            sensors,
            config.cycle,
        ),
    })
}

/// What was written down of the last output, machine's order, mm and rad.
fn last_output(path: &Path) -> Option<PerAxis<f64>> {
    let text = std::fs::read_to_string(path).ok()?;
    let document: serde_json::Value = serde_json::from_str(&text).ok()?;
    // After a reboot nobody knows what the lines carry: from zero then.
    if document["boot"] != boot_id() {
        return None;
    }
    let values = document["correction"].as_array()?;
    let mut output = PerAxis::ZERO;
    for (into, value) in output.iter_mut().zip(values) {
        *into = value.as_f64().filter(|x| x.is_finite())?;
    }
    Some(output)
}

/// One gateway on a host for each controller: a name of the device in the kernel's abstract socket addresses, which
/// nobody can hold twice, every user sees, and no crash leaves behind.
fn lock(config: &Config) -> Result<Vec<UnixListener>, GatewayError> {
    let devices = config.controllers.iter().map(|controller| &controller.url);
    devices.map(|device| lock_device(device)).collect()
}

fn lock_device(device: &str) -> Result<UnixListener, GatewayError> {
    let digest = crate::hex(&Sha256::digest(device.as_bytes())[..8]);
    let failed = |e| GatewayError::system(device.to_owned(), e);
    let address =
        UnixAddress::from_abstract_name(format!("volcomp-gateway-{digest}")).map_err(failed)?;
    UnixListener::bind_addr(&address).map_err(|e| match e.kind() {
        ErrorKind::AddrInUse => failed(std::io::Error::other(
            "another gateway on this host corrects it",
        )),
        _ => failed(e),
    })
}

/// Checks a configuration without touching a device: what would be corrected, in words.
///
/// # Errors
/// What is wrong.
pub fn check(path: &Path) -> Result<Vec<String>, GatewayError> {
    let config = Config::read(path)?;
    let guard = config.guard.clone().unwrap_or_else(no_limits);
    let model = Model::read(&config.machine, guard.fading)?;
    let mut lines = vec![format!(
        "machine {} ({}), axes {}",
        model.name,
        model.hash,
        model
            .axes
            .iter()
            .map(|name| name.letter())
            .collect::<String>()
    )];
    if config.guard.is_none() {
        lines.push("[guard] is missing: it will not arm".to_owned());
    }
    for controller in &config.controllers {
        let address = volcomp_devices::Address::parse(&controller.url)?;
        if let Some(axis) = controller
            .axes
            .iter()
            .find(|axis| model.index_of(**axis).is_none())
        {
            return Err(GatewayError::Unfit(format!(
                "{}: axis {axis} is not an axis of {}",
                controller.url, model.name
            )));
        }
        let watched = controller.unwatched
            || controller.heartbeat.is_some()
            || !matches!(address.scheme, volcomp_devices::Scheme::Focas);
        if !watched {
            return Err(GatewayError::Unfit(format!(
                "{}: name a heartbeat that the control watches, or say unwatched = true",
                controller.url
            )));
        }
        lines.push(format!(
            "controller {}: axes {}",
            controller.url,
            controller
                .axes
                .iter()
                .map(|name| name.letter())
                .collect::<String>()
        ));
    }
    let shown = |name: &AxisName| {
        let mut controllers = config.controllers.iter();
        controllers.any(|c| c.axes.contains(name) || c.fixed.contains_key(name))
    };
    for name in model.axes.iter().filter(|name| !shown(name)) {
        lines.push(format!("axis {name}: no controller shows it and `fixed` does not say where it stands: it will not arm"));
    }
    let known: Vec<&String> = config
        .thermometers
        .iter()
        .flat_map(|thermometer| &thermometer.names)
        .collect();
    for sensor in model.thermal.sensors() {
        if !known.contains(&sensor) {
            lines.push(format!(
                "no thermometer has the sensor {sensor}: its thermal terms are left out"
            ));
        }
    }
    for thermometer in &config.thermometers {
        volcomp_devices::Address::parse(&thermometer.url)?;
        lines.push(format!(
            "thermometer {}: {}",
            thermometer.url,
            thermometer.names.join(", ")
        ));
    }
    check_listen(&config.dashboard)?;
    let tokens = Tokens::load(config.dashboard.token_file.as_deref())?;
    if tokens.is_empty() {
        lines.push("no token: nobody can arm over HTTP".to_owned());
    }
    lines.push(format!("dashboard {}", config.dashboard.listen));
    Ok(lines)
}

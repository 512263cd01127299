//! Runs the centre and its web interface, and checks its configuration and environment.

use std::{
    fmt::Write as _,
    fs::{File, TryLockError},
    io::IsTerminal,
    net::SocketAddr,
    os::unix::fs::OpenOptionsExt,
    path::Path,
    sync::Arc,
};

use tokio::{net::TcpListener, task::JoinHandle};
use tracing_subscriber::{
    filter::{LevelFilter, Targets},
    fmt,
    layer::SubscriberExt,
    util::SubscriberInitExt,
};
use volcomp_web::tls;

use crate::{
    Error,
    command::{
        arguments::LogForm,
        machines::{check_audit_chain, link, settings},
        open, print, signing_key,
    },
    config::{Config, PageConfig},
    demo::{AUTO_CONFIRM_DELAY, Demo},
    engine::{Engine, Settings},
    http::{PageSettings, PageState, router},
    keys::Key,
    rollout::Rules,
    store::Store,
};

pub(super) fn run(config: &Config, log: LogForm) -> Result<(), Error> {
    // The library would report a line that cannot be written with `eprintln!`, which then panics.
    let lines = fmt::layer()
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal())
        .log_internal_errors(false);
    // The NATS client logs every connection attempt; the engine already logs once that the server cannot be reached.
    let reported =
        Targets::new().with_default(LevelFilter::INFO).with_target("async_nats", LevelFilter::OFF);
    let registry = tracing_subscriber::registry().with(reported);
    match log {
        LogForm::Text => registry.with(lines.with_target(false)).init(),
        LogForm::Json => registry.with(lines.json()).init(),
    }
    let (link, _) = link(config)?;
    let engine = Settings {
        link,
        stream_retention: config.nats.stream_retention(),
        keep: config.keep,
        key: signing_key(config)?,
        own: Key::all(&config.keys.folder)?,
    };
    let _lock = lock(&config.store.file)?;
    let store = open(config)?;
    store.audit("centre", "centre.start", "", serde_json::json!({}))?;
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(async {
        let mut running = Engine::start(store.clone(), engine).await?;
        let mut page = match &config.page {
            Some(page) => Some(serve_page(page, config.rollout.clone(), &store).await?),
            None => None,
        };
        tracing::info!("the centre runs");
        tokio::select! {
            signal = terminated() => signal?,
            part = running.ended() => return Err(Error::Ended(part)),
            () = page_ended(page.as_mut()) => return Err(Error::Ended("the page")),
        }
        tracing::info!("the centre ends");
        for task in page.iter().flatten() {
            task.abort();
        }
        running.end().await;
        Ok::<(), Error>(())
    })?;
    store.audit("centre", "centre.end", "", serde_json::json!({}))
}

/// Locks the database until the file is dropped. Two centres on one database would advance the times of a roll-out
/// twice as fast, and each would receive the messages of only some machines.
///
/// Call this function before the database is opened, so that the lock file is dropped last: closing the file releases
/// the POSIX locks that the connections of this program hold on it.
fn lock(database: &Path) -> Result<File, Error> {
    let failed = |why| Error::Database { file: database.display().to_string(), why };
    let file = File::options().append(true).create(true).mode(0o600).open(database);
    let file = file.map_err(failed)?;
    match file.try_lock() {
        Ok(()) => Ok(file),
        Err(TryLockError::WouldBlock) => Err(Error::Wrong(format!(
            "{}: another centre runs with this database, expected one",
            database.display()
        ))),
        Err(TryLockError::Error(error)) => Err(failed(error)),
    }
}

/// Waits until a task of the web interface ends, which is always a failure. Never returns without a web interface.
async fn page_ended(page: Option<&mut [JoinHandle<()>; 2]>) {
    match page {
        Some([refreshed, served]) => {
            tokio::select! {
                _ = refreshed => {}
                _ = served => {}
            }
        }
        None => std::future::pending().await,
    }
}

async fn serve_page(
    config: &PageConfig,
    rules: Rules,
    store: &Arc<Store>,
) -> Result<[JoinHandle<()>; 2], Error> {
    let acceptor = match config.tls() {
        Some((certificate, key)) => Some(tls::acceptor(certificate, key)?),
        None => None,
    };
    let bound = TcpListener::bind(config.listen).await;
    let listener = bound.map_err(|error| {
        let why = if error.kind() == std::io::ErrorKind::AddrInUse {
            "another program uses it: expected a free address, or stop the other centre first"
                .to_owned()
        } else {
            error.to_string()
        };
        Error::Failed(format!("the web interface cannot listen on {}: {why}", config.listen))
    })?;
    let scheme = if acceptor.is_some() { "https" } else { "http" };
    tracing::info!("web interface: {scheme}://{}", listener.local_addr()?);
    let store_clone = Arc::clone(store);
    // A database query may block, so it must not run on a runtime thread.
    let users = tokio::task::spawn_blocking(move || store_clone.users()).await;
    if users.map_err(std::io::Error::other)??.is_empty() {
        tracing::warn!(
            "found no user of the web interface: add one with volcomp-centre user add NAME --role admin"
        );
    }
    let page = PageState::new(
        Arc::clone(store),
        PageSettings {
            hosts: config.hosts.clone(),
            secure: acceptor.is_some(),
            rules,
            ..PageSettings::default()
        },
    );
    Ok([
        tokio::spawn(Arc::clone(&page).refresh()),
        tokio::spawn(volcomp_web::serve(listener, acceptor, router(&page))),
    ])
}

async fn terminated() -> std::io::Result<()> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    tokio::select! {
        _ = terminate.recv() => {}
        _ = interrupt.recv() => {}
    }
    Ok(())
}

pub(super) fn check(config: &Config) -> Result<(), Error> {
    let store = open(config)?;
    let key = signing_key(config)?;
    // Read every key at the start, not only the one that signs.
    Key::all(&config.keys.folder)?;
    let server = settings(config)?;
    server.text()?;
    if let Some((certificate, private)) = config.page.as_ref().and_then(PageConfig::tls) {
        tls::acceptor(certificate, private)?;
    }
    let machines = store.machines()?;
    let without = machines.iter().filter(|machine| machine.nkey.is_none());
    let without: Vec<&str> = without.map(|machine| machine.identity.machine.as_str()).collect();
    let mut report = format!(
        "store        {}\nserver       {}\nsigns with   {} {}\nmachines     {}\n",
        config.store.file.display(),
        config.nats.url,
        key.name,
        key.public(),
        machines.len(),
    );
    for name in without {
        let _ = writeln!(report, "note: {name} has no nkey: it has no access to the server");
    }
    if let Some(server) = volcomp_fleet::in_the_clear(&config.nats.url).next() {
        let _ = writeln!(
            report,
            "note: the connection to {server} is not encrypted: everyone on the network can read it"
        );
    }
    print(&report)?;
    check_audit_chain(&store)
}

pub(super) fn demo(listen: SocketAddr) -> Result<(), Error> {
    let runtime = tokio::runtime::Builder::new_multi_thread().enable_all().build()?;
    runtime.block_on(async {
        let demo = Demo::start(listen)
            .await
            .map_err(|error| Error::Failed(error.to_string()))?;
        print(&format!(
            "The web interface is at http://{}\n  name      {}\n  password  {}\nThree machines are simulated; no data are kept. Ctrl-C ends the demonstration.\nTheir models wait until a user confirms them in the web interface, under Roll-outs; after {} s the demonstration confirms them automatically.\n",
            demo.address,
            demo.user,
            demo.password,
            AUTO_CONFIRM_DELAY.as_secs()
        ))?;
        terminated().await?;
        demo.end().await;
        Ok(())
    })
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    /// Each task that returns or panics is reported as ended; a running or absent web interface is not.
    #[tokio::test]
    async fn an_ended_task_is_detected() {
        let for_ever = || tokio::spawn(std::future::pending::<()>());
        let at_once = || tokio::spawn(std::future::ready(()));
        let faulty = || tokio::spawn(async { panic!("injected") });
        let soon = Duration::from_millis(50);
        for (mut page, ends) in [
            ([for_ever(), for_ever()], false),
            ([at_once(), for_ever()], true),
            ([for_ever(), at_once()], true),
            ([faulty(), for_ever()], true),
            ([for_ever(), faulty()], true),
        ] {
            let within = if ends { Duration::from_secs(60) } else { soon };
            let noticed = tokio::time::timeout(within, page_ended(Some(&mut page))).await;
            assert_eq!(noticed.is_ok(), ends);
        }
        assert!(tokio::time::timeout(soon, page_ended(None)).await.is_err());
    }
}

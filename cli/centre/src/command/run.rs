//! Running the centre, and checking what it needs.

use std::fmt::Write;

use std::io::IsTerminal;

use volcomp_fleet::LinkSettings;

use super::{
    CommandError,
    arguments::LogForm,
    open, page, print,
    server::{centre_nkey, settings},
    signing_key,
};
use crate::{
    config::Config,
    engine::{Engine, Settings},
    keys::Key,
};

pub(super) fn run(config: &Config, log: LogForm) -> Result<(), CommandError> {
    let lines = tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal());
    match log {
        LogForm::Text => lines.with_target(false).init(),
        LogForm::Json => lines.json().init(),
    }
    let (seed, _) = centre_nkey(config)?;
    let engine = Settings {
        link: LinkSettings {
            url: config.nats.url.clone(),
            seed,
            roots: config.nats.ca.clone(),
        },
        keeping: config.nats.keeping,
        keep: config.keep,
        key: signing_key(config)?,
        own: Key::all(&config.keys.folder)?,
    };
    let store = open(config)?;
    store.audit("centre", "centre.start", "", serde_json::json!({}))?;
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()?;
    runtime.block_on(async {
        let running = Engine::start(store.clone(), engine).await?;
        let page = match &config.page {
            Some(page) => Some(page::serve(page, &store).await?),
            None => None,
        };
        tracing::info!("the centre runs");
        ended().await?;
        tracing::info!("the centre ends");
        for task in page.iter().flatten() {
            task.abort();
        }
        running.end().await;
        Ok::<_, CommandError>(())
    })?;
    Ok(store.audit("centre", "centre.end", "", serde_json::json!({}))?)
}

/// Waits for a signal to end.
pub(super) async fn ended() -> std::io::Result<()> {
    use tokio::signal::unix::{SignalKind, signal};
    let mut terminate = signal(SignalKind::terminate())?;
    let mut interrupt = signal(SignalKind::interrupt())?;
    tokio::select! {
        _ = terminate.recv() => {}
        _ = interrupt.recv() => {}
    }
    Ok(())
}

pub(super) fn check(config: &Config) -> Result<(), CommandError> {
    let store = open(config)?;
    let key = signing_key(config)?;
    let server = settings(config)?;
    server.text()?;
    let machines = store.machines()?;
    let without = machines.iter().filter(|machine| machine.nkey.is_none());
    let without: Vec<&str> = without
        .map(|machine| machine.identity.machine.as_str())
        .collect();
    let mut said = format!(
        "store        {}\nserver       {}\nsigns with   {} {}\nmachines     {}\n",
        config.store,
        config.nats.url,
        key.name,
        key.public(),
        machines.len(),
    );
    for name in without {
        let _ = writeln!(
            said,
            "note: {name} has no nkey: it has no access to the server"
        );
    }
    if !config.nats.url.contains("tls://") {
        said.push_str(
            "note: the connection is in the clear: everybody on the network can read it\n",
        );
    }
    print(&said)?;
    match store.broken_audit()? {
        None => Ok(()),
        Some(number) => Err(CommandError::Found(format!(
            "the audit log: record {number} does not follow from the one before"
        ))),
    }
}

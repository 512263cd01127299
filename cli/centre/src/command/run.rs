//! Running the centre, and checking its configuration and environment.

use std::{fmt::Write as _, io::IsTerminal, net::SocketAddr};

use tracing_subscriber::{
    filter::{LevelFilter, Targets},
    fmt,
    layer::SubscriberExt,
    util::SubscriberInitExt,
};

use super::{
    arguments::LogForm,
    open, page, print,
    server::{chain_holds, link, settings},
    signing_key,
};
use crate::{
    Error,
    config::{Config, PageConfig},
    demo::{CONFIRMS_AFTER, Demo},
    engine::{Engine, Settings},
    keys::Key,
};

pub(super) fn run(config: &Config, log: LogForm) -> Result<(), Error> {
    let lines = fmt::layer()
        .with_writer(std::io::stderr)
        .with_ansi(std::io::stderr().is_terminal());
    // The NATS client logs every connection attempt; the engine already logs once that the server cannot be reached.
    let told = Targets::new()
        .with_default(LevelFilter::INFO)
        .with_target("async_nats", LevelFilter::OFF);
    let registry = tracing_subscriber::registry().with(told);
    match log {
        LogForm::Text => registry.with(lines.with_target(false)).init(),
        LogForm::Json => registry.with(lines.json()).init(),
    }
    let (link, _) = link(config)?;
    let engine = Settings {
        link,
        keeping: config.nats.keeping(),
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
        let mut running = Engine::start(store.clone(), engine).await?;
        let mut page = match &config.page {
            Some(page) => Some(page::serve(page, config.rollout.clone(), &store).await?),
            None => None,
        };
        tracing::info!("the centre runs");
        tokio::select! {
            told = ended() => told?,
            part = running.ended() => return Err(Error::Ended(part)),
            () = page::ended(page.as_mut()) => return Err(Error::Ended("the page")),
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

/// Waits for a termination signal.
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

pub(super) fn check(config: &Config) -> Result<(), Error> {
    let store = open(config)?;
    let key = signing_key(config)?;
    // Read every key at the start, not only the one that signs.
    Key::all(&config.keys.folder)?;
    let server = settings(config)?;
    server.text()?;
    if let Some((certificate, private)) = config.page.as_ref().and_then(PageConfig::tls) {
        volcomp_web::tls::acceptor(certificate, private)?;
    }
    let machines = store.machines()?;
    let without = machines.iter().filter(|machine| machine.nkey.is_none());
    let without: Vec<&str> = without
        .map(|machine| machine.identity.machine.as_str())
        .collect();
    let mut said = format!(
        "store        {}\nserver       {}\nsigns with   {} {}\nmachines     {}\n",
        config.store.file.display(),
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
    if let Some(server) = volcomp_fleet::in_the_clear(&config.nats.url).next() {
        let _ = writeln!(
            said,
            "note: {server} is reached in the clear: everybody on the network can read what is said"
        );
    }
    print(&said)?;
    chain_holds(&store)
}

pub(super) fn demo(listen: SocketAddr) -> Result<(), Error> {
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .enable_all()
        .build()?;
    runtime.block_on(async {
        let demo = Demo::start(listen)
            .await
            .map_err(|error| Error::Failed(error.to_string()))?;
        print(&format!(
            "The page is on http://{}\n  name      {}\n  password  {}\nThree machines are simulated, and nothing is kept. Ctrl-C ends everything.\nTheir models wait until somebody confirms them on the page, under Roll-outs; after {} s the demonstration confirms them by itself.\n",
            demo.address,
            demo.user,
            demo.password,
            CONFIRMS_AFTER.as_secs()
        ))?;
        ended().await?;
        demo.end().await;
        Ok(())
    })
}

//! Measures the throughput of one centre on this computer.
//!
//! `cargo run --release -p volcomp-centre --example load -- --machines 1000 --minutes 5`, after
//! `cargo build --release -p volcomp-centre`. Starts a `nats-server` and the centre as separate processes and prints:
//!
//! 1. the throughput of the bare server (publish, store, consume, acknowledge) and of the centre (the same, and stored in
//!    its database), with the same publishers, in alternating rounds;
//! 2. with many gateways, each with its own connection and nkey, a condition per second and full telemetry every ten
//!    seconds: the duration of a roll-out to all, and the memory of the centre over the minutes.

#![allow(clippy::unwrap_used, clippy::expect_used, reason = "a measurement fails by panicking")]

#[path = "../tests/it/gateway.rs"]
mod gateway;

use std::{
    path::{Path, PathBuf},
    process::{Child, Command},
    sync::{
        Arc, Mutex,
        atomic::{AtomicU64, Ordering},
    },
    time::{Duration, Instant},
};

use clap::Parser;
use futures_util::StreamExt;
use nkeys::KeyPair;
use volcomp_centre::{
    keys::{Key, write_secret},
    models::NewModel,
    records::{Machine, Origin},
    rollout::{Phase, Rules},
    store::Store,
};
use volcomp_fleet::{
    Condition, Envelope, Hub, Identity, Kind, LinkSettings, MachineUser, ServerSettings,
    StreamRetention, Subjects, server::Server,
};

const STATE: &str = include_str!("state.json");
const MODEL: &str = include_str!("../../../examples/gantry.toml");

#[derive(Parser)]
struct Arguments {
    /// Number of gateways
    #[arg(long, default_value_t = 1000)]
    machines: usize,
    /// Duration of the run
    #[arg(long, default_value_t = 5)]
    minutes: u64,
    /// Number of messages for each throughput measurement
    #[arg(long, default_value_t = 100_000)]
    messages: u64,
    /// Number of repetitions
    #[arg(long, default_value_t = 3)]
    rounds: u32,
}

fn size_mb(file: &Path) -> f64 {
    let of = |file: &Path| std::fs::metadata(file).map_or(0, |data| data.len());
    (of(file) + of(&file.with_extension("db-wal"))) as f64 / 1e6
}

struct Bench {
    folder: tempfile::TempDir,
    server: Server,
    centre: KeyPair,
    machines: Vec<(Machine, KeyPair)>,
    key: Key,
    database: PathBuf,
    store: Arc<Store>,
}

impl Bench {
    fn new(count: usize) -> Self {
        let folder = tempfile::Builder::new()
            .prefix("load")
            .tempdir_in(
                std::env::var_os("VOLCOMP_LOAD_DIR").map_or_else(std::env::temp_dir, Into::into),
            )
            .unwrap();
        let model = model(0);
        let machines: Vec<(Machine, KeyPair)> = (0..count)
            .map(|place| {
                let identity = Identity {
                    site: "load".parse().unwrap(),
                    machine: format!("mill-{place}").parse().unwrap(),
                };
                let (structure, axes) = (&model.model.structure, &model.model.axes);
                let serial = format!("{place}");
                let machine = Machine::new(identity, serial, structure.clone(), axes.clone());
                (machine, KeyPair::new_user())
            })
            .collect();
        let centre = KeyPair::new_user();
        let settings = ServerSettings {
            name: "load".to_owned(),
            listen: volcomp_test_support::free_address(),
            store: folder.path().join("streams"),
            tls: None,
            cluster: None,
            centres: vec![centre.public_key()],
            machines: (machines.iter())
                .map(|(machine, key)| MachineUser {
                    identity: machine.identity.clone(),
                    nkey: key.public_key(),
                })
                .collect(),
        };
        let server = Server::start(&settings, folder.path()).unwrap();
        write_secret(&folder.path().join("centre.nkey"), &centre.seed().unwrap()).unwrap();
        let key = Key::create(&folder.path().join("keys"), "main").unwrap();
        std::fs::write(
            folder.path().join("centre.toml"),
            format!("[nats]\nurl = \"{}\"\n", server.url()),
        )
        .unwrap();
        let config = volcomp_centre::config::Config::read(&folder.path().join("centre.toml"));
        let config = config.unwrap();
        let store = volcomp_centre::command::open(&config).unwrap();
        for (machine, _) in &machines {
            store.put_machine(machine, "load").unwrap();
        }
        Self { folder, server, centre, machines, key, database: config.store.file, store }
    }

    fn link(&self, key: &KeyPair) -> LinkSettings {
        LinkSettings { url: self.server.url(), seed: key.seed().unwrap(), roots: None }
    }

    async fn hub(&self) -> Hub {
        Hub::connect(&self.link(&self.centre)).await.unwrap()
    }

    fn start_centre(&self) -> Centre {
        let program = std::env::current_exe().unwrap();
        let folder = program.parent().unwrap().parent().unwrap();
        let program = folder.join("volcomp-centre");
        let config = self.folder.path().join("centre.toml");
        Centre(Command::new(program).arg("--config").arg(config).arg("run").spawn().unwrap())
    }
}

struct Centre(Child);

impl Drop for Centre {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn model(number: u32) -> NewModel {
    let origin = Origin::File { name: "gantry.toml".to_owned() };
    let text = format!("# {number}\n{MODEL}");
    NewModel::of_text(text, "gantry.toml", origin, "load").unwrap()
}

fn condition() -> Condition {
    let state: serde_json::Value = serde_json::from_str(STATE).unwrap();
    let temperatures = state["temperatures"].as_array().unwrap();
    Condition {
        state: "compensating".to_owned(),
        reasons: vec!["not proven what positions contain".to_owned()],
        armed: true,
        correction_um: serde_json::from_value(state["correction_um"].clone()).unwrap(),
        correction_urad: std::collections::BTreeMap::new(),
        residual_um: Some(0.712),
        temperatures_degc: (temperatures.iter())
            .map(|one| (one["name"].as_str().unwrap().to_owned(), one["degc"].as_f64()))
            .collect(),
        cycle_p99_us: 125.951,
        overruns: 6,
        faults: 0,
    }
}

/// One message of a machine; every eleventh is full telemetry.
fn message(instance: &str, number: u64) -> (Kind, Vec<u8>) {
    fn bytes<T: serde::Serialize>(instance: &str, number: u64, body: T) -> Vec<u8> {
        serde_json::to_vec(&Envelope {
            instance: instance.to_owned(),
            number,
            uptime_s: number as f64,
            wall_s: 1_795_000_000.0,
            version: 3,
            model: "sha256:6ed4a0aafd8e5651bf7c90ae5d81e5a02605574c096c6ba849af7f98ccd47ad2"
                .to_owned(),
            body,
        })
        .unwrap()
    }
    if number % 11 == 10 {
        let body: &serde_json::value::RawValue = serde_json::from_str(STATE).unwrap();
        (Kind::Telemetry, bytes(instance, number, body))
    } else {
        (Kind::Condition, bytes(instance, number, condition()))
    }
}

/// Publishes messages of all machines of a site with a bounded number in flight. The stream acknowledges each message.
async fn publish(hub: &Hub, site: &str, machines: usize, messages: u64, run: u32) -> u64 {
    const MAX_IN_FLIGHT: usize = 500;
    let bytes = AtomicU64::new(0);
    let count = machines as u64;
    futures_util::stream::iter(0..messages)
        .for_each_concurrent(MAX_IN_FLIGHT, |place| {
            let bytes = &bytes;
            async move {
                let machine = place % count;
                let (kind, text) = message(&format!("run-{run}"), place / count);
                let identity = Identity {
                    site: site.parse().unwrap(),
                    machine: format!("mill-{machine}").parse().unwrap(),
                };
                let subjects = Subjects::of(&identity);
                let subject = match kind {
                    Kind::Telemetry => subjects.telemetry,
                    _ => subjects.condition,
                };
                bytes.fetch_add(text.len() as u64, Ordering::Relaxed);
                let stored = hub.context().publish(subject, text.into()).await.unwrap();
                stored.await.unwrap();
            }
        })
        .await;
    bytes.load(Ordering::Relaxed)
}

/// Waits until the centre has acknowledged the whole stream, so that every message is on disk.
async fn acknowledged(hub: &Hub, stream: &str) {
    loop {
        let stream = hub.context().get_stream(stream).await.unwrap();
        let info = stream.consumer_info("centre").await;
        if info.is_ok_and(|info| info.num_pending == 0 && info.num_ack_pending == 0) {
            return;
        }
        tokio::time::sleep(Duration::from_millis(20)).await;
    }
}

async fn throughput(bench: &Bench, arguments: &Arguments) {
    let hub = bench.hub().await;
    let bare: [volcomp_fleet::SiteId; 1] = ["bare".parse().unwrap()];
    hub.prepare(&bare, StreamRetention::default()).await.unwrap();
    let mut ratios = Vec::new();
    // One pull subscription for all rounds, because the server would still send messages to an abandoned subscription.
    let [mut collection, _] = hub.collections(&bare[0]);
    let count = arguments.machines;
    for round in 0..arguments.rounds {
        let messages = arguments.messages;
        let consume = async {
            let mut seen = 0;
            while seen < messages {
                let batch = collection.next().await.unwrap();
                seen += batch.messages.len() as u64;
                batch.acknowledge().await.unwrap();
            }
        };
        let start = Instant::now();
        let (bytes, ()) = tokio::join!(publish(&hub, "bare", count, messages, round), consume);
        acknowledged(&hub, "telemetry-bare").await;
        let bare_s = start.elapsed().as_secs_f64();

        let centre = bench.start_centre();
        // The centre is ready when its stream exists and all messages of the previous round are acknowledged.
        while hub.context().get_stream("telemetry-load").await.is_err() {
            tokio::time::sleep(Duration::from_millis(50)).await;
        }
        acknowledged(&hub, "telemetry-load").await;
        let start = Instant::now();
        publish(&hub, "load", count, messages, round).await;
        let published_s = start.elapsed().as_secs_f64();
        acknowledged(&hub, "telemetry-load").await;
        let centre_s = start.elapsed().as_secs_f64();
        let memory = memory_mib(centre.0.id());
        drop(centre);
        let ratio = bare_s / centre_s;
        ratios.push(ratio);
        println!(
            "round {round}: {messages} messages, {:.1} MB; bare {:.0}/s, centre {:.0}/s (published in {published_s:.1} s), ratio {ratio:.2}; centre {memory:.0} MiB",
            bytes as f64 / 1e6,
            messages as f64 / bare_s,
            messages as f64 / centre_s,
        );
    }
    ratios.sort_by(f64::total_cmp);
    println!("throughput: median ratio {:.2}", ratios[ratios.len() / 2]);
}

fn memory_mib(process: u32) -> f64 {
    let text = std::fs::read_to_string(format!("/proc/{process}/status")).unwrap_or_default();
    let line = text.lines().find_map(|line| line.strip_prefix("VmRSS:"));
    let kib = line.and_then(|line| line.split_whitespace().next()?.parse::<f64>().ok());
    kib.unwrap_or(0.0) / 1024.0
}

fn processor_s(process: u32) -> f64 {
    let text = std::fs::read_to_string(format!("/proc/{process}/stat")).unwrap_or_default();
    let after = text.rsplit(')').next().unwrap_or_default();
    let fields: Vec<f64> = after.split_whitespace().filter_map(|one| one.parse().ok()).collect();
    // The process state, which is no number, was skipped, so utime and stime are fields 11 and 12.
    fields.get(10).zip(fields.get(11)).map_or(0.0, |(user, system)| (user + system) / 100.0)
}

async fn fleet(bench: &Bench, arguments: &Arguments) {
    let centre = bench.start_centre();
    let state: Arc<serde_json::value::RawValue> =
        Arc::from(serde_json::value::RawValue::from_string(STATE.trim().to_owned()).unwrap());
    let mut reported = Vec::new();
    let mut tasks = tokio::task::JoinSet::new();
    let start = Instant::now();
    for (machine, key) in &bench.machines {
        let plan = gateway::Plan {
            link: bench.link(key),
            identity: machine.identity.clone(),
            serial: machine.serial.clone(),
            trusted: vec![bench.key.key.verifying_key()],
            // The server discards a second message with the same ID, so every gateway needs its own instance name.
            instance: format!("fleet-{}", machine.identity.machine),
            condition_every: Duration::from_secs(1),
            telemetry_every: Duration::from_secs(10),
            telemetry: Arc::clone(&state),
            residual_um: Arc::new(Mutex::new(0.7)),
        };
        let seen = gateway::GatewayState::default();
        reported.push(seen.clone());
        tasks.spawn(gateway::run(plan, seen));
        tokio::time::sleep(Duration::from_millis(2)).await;
    }
    let all = || reported.iter().map(|one| one.all.load(Ordering::Relaxed)).sum::<u64>();
    println!(
        "{} gateways are connected after {:.1} s",
        reported.len(),
        start.elapsed().as_secs_f64()
    );
    let mut number = 1;
    let (mut last, mut last_all, mut last_cpu) = (Instant::now(), all(), 0.0);
    let mut last_nats = 0.0;
    let end = Instant::now() + Duration::from_secs(60 * arguments.minutes);
    let mut rolls = Vec::new();
    while Instant::now() < end {
        let took_s = tokio::task::block_in_place(|| roll_out(bench, &reported, number));
        rolls.push(took_s);
        number += 1;
        tokio::time::sleep(Duration::from_secs(30)).await;
        let (cpu, nats) = (processor_s(centre.0.id()), processor_s(bench.server.id()));
        let since_s = last.elapsed().as_secs_f64();
        println!(
            "{:5.0} s: roll-out to all {took_s:.1} s; {:.0} messages/s; centre {:.0} MiB, {:.0} % of a core; server {:.0} MiB, {:.0} % of a core; database {:.0} MB",
            start.elapsed().as_secs_f64(),
            (all() - last_all) as f64 / since_s,
            memory_mib(centre.0.id()),
            (cpu - last_cpu) / since_s * 100.0,
            memory_mib(bench.server.id()),
            (nats - last_nats) / since_s * 100.0,
            size_mb(&bench.database),
        );
        (last, last_all, last_cpu, last_nats) = (Instant::now(), all(), cpu, nats);
    }
    rolls.sort_by(f64::total_cmp);
    println!(
        "roll-out to {} machines: median {:.1} s, longest {:.1} s",
        reported.len(),
        rolls[rolls.len() / 2],
        rolls[rolls.len() - 1]
    );
    tasks.shutdown().await;
    let hub = bench.hub().await;
    let waits = Instant::now();
    acknowledged(&hub, "telemetry-load").await;
    println!(
        "everything that was said is stored {:.1} s after the last gateway ended",
        waits.elapsed().as_secs_f64()
    );
}

/// Duration of a roll-out to all machines until the centre has closed it, s.
fn roll_out(bench: &Bench, reported: &[gateway::GatewayState], number: u32) -> f64 {
    let new = model(number);
    bench.store.add_model(&new.model, &new.text).unwrap();
    let machines: Vec<_> = (bench.machines.iter())
        .map(|(machine, _)| (machine.identity.machine.clone(), false))
        .collect();
    let rules = Rules { waves: vec![100], soak_s: 0.0, answer_s: 300.0, ..Rules::default() };
    let start = Instant::now();
    let begun = bench.store.begin_rollout(&new.model.sha256, &machines, rules, "load");
    let id = begun.unwrap().id;
    loop {
        std::thread::sleep(Duration::from_millis(100));
        let state = bench.store.rollout(id).unwrap().unwrap();
        match state.phase {
            Phase::Done => break,
            Phase::Running => {}
            other => panic!("the roll-out: {other:?}"),
        }
    }
    let took_s = start.elapsed().as_secs_f64();
    let version = u64::from(number);
    let all = reported.iter().all(|one| one.version.load(Ordering::Relaxed) == version);
    assert!(all, "each has it");
    took_s
}

fn main() {
    let arguments = Arguments::parse();
    let bench = Bench::new(arguments.machines);
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(2).enable_all().build().unwrap();
    runtime.block_on(async {
        throughput(&bench, &arguments).await;
        fleet(&bench, &arguments).await;
    });
}

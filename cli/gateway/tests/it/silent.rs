//! The control thread alone stands still, in an exchange with a controller that does not come back: whoever reads the
//! state hears that it is unknown.

use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use serde_json::{Value, json};
use volcomp_gateway::{
    audit::AuditLog,
    documents::Standing,
    http::{self, Dashboard, Door, Tokens},
    models::Models,
    options::Options,
    published::published,
    request::queue,
    service::{Life, Parts, Service},
    simulate::{self, Simulation},
};
use volcomp_guard::Reasons;
use volcomp_port::{
    Clock, Controller,
    inject::{HangSwitch, Hanging},
};
use volcomp_runtime::{Model, Realtime, start};

use crate::{
    bench,
    program::{Answer, OPERATE, PATIENCE, answer},
    standing::kept,
};

/// A gateway in this process, whose controller hangs at a switch.
struct Gateway {
    address: SocketAddr,
    hangs: HangSwitch,
    ends: Arc<AtomicBool>,
    /// The service does nothing meanwhile, as on a computer without time for it.
    stands: Arc<AtomicBool>,
    dir: tempfile::TempDir,
    service: Option<JoinHandle<()>>,
    _runtime: tokio::runtime::Runtime,
}

impl Drop for Gateway {
    fn drop(&mut self) {
        self.hangs.set(false);
        self.stands.store(false, Ordering::Relaxed);
        self.ends.store(true, Ordering::Relaxed);
        if let Some(service) = self.service.take() {
            let _ = service.join();
        }
    }
}

fn gateway() -> Gateway {
    let dir = tempfile::tempdir().expect("writable");
    let config = volcomp_gateway::config::Config {
        audit: volcomp_gateway::config::AuditConfig {
            dir: dir.path().to_owned(),
        },
        auto_arm: false,
        ..simulate::config()
    };
    let guard = simulate::guard();
    let clock = Clock::system();
    let simulation = Simulation::new(clock.clone()).expect("built in");
    let model = Model::new(&simulation.model, guard.fading).expect("built in");
    let hangs = HangSwitch::default();
    let controller = Hanging::new(simulation.controller, &hangs);
    let controllers = vec![controller.description().clone()];
    let path = bench::path(controller, &model, &guard, &bench::unproven());
    let thermometer = Box::new(simulation.thermometer);
    let cycle = bench::cycle(model.clone(), vec![path], &guard, thermometer, &clock);
    let (handle, _) = start(cycle, Realtime::default()).expect("a thread");
    let model = Arc::new(model);
    let (publisher, published) = published(first(), Arc::clone(&model), handle.pulse());
    let (asks, asked) = queue();
    let tokens = format!("anna operate {OPERATE}\n");
    let switch = handle.disarm_switch();
    let models = Models::start(&config, true, &published, &asks, &switch).expect("a thread");
    let dashboard = Dashboard {
        models: models.clone(),
        published,
        quantities: Vec::new(),
        asks,
        switch: handle.disarm_switch(),
        door: Arc::new(Door {
            tokens: Tokens::parse(&tokens).expect("a token"),
            hosts: Vec::new(),
            reading_needs_token: false,
        }),
        streams: AtomicUsize::new(0),
    };
    let (audit, _) = AuditLog::open(dir.path()).expect("new");
    let parts = Parts {
        handle,
        options: Options::default(),
        config,
        controllers,
        sensors: Vec::new(),
        model,
        truth: None,
        standing: Standing::default(),
        forbids: Reasons::NONE,
        life: Life::default(),
        proven_within: Duration::from_secs(4),
        notes: models.notes(),
    };
    let mut service = Service::new(parts, audit, publisher, asked).expect("a thread");
    let ends = Arc::new(AtomicBool::new(false));
    let end = Arc::clone(&ends);
    let stands = Arc::new(AtomicBool::new(false));
    let is_still = Arc::clone(&stands);
    let service = std::thread::spawn(move || {
        while !end.load(Ordering::Relaxed) {
            if is_still.load(Ordering::Relaxed) {
                std::thread::sleep(Duration::from_millis(5));
            } else {
                service.turn();
            }
        }
    });
    let runtime = tokio::runtime::Builder::new_multi_thread()
        .worker_threads(1)
        .enable_all()
        .build()
        .expect("threads");
    let listener = TcpListener::bind("127.0.0.1:0").expect("loopback");
    listener.set_nonblocking(true).expect("ours");
    let address = listener.local_addr().expect("bound");
    let guard = runtime.enter();
    let listener = tokio::net::TcpListener::from_std(listener).expect("ours");
    drop(guard);
    runtime.spawn(http::serve(
        listener,
        None,
        http::router(Arc::new(dashboard)),
    ));
    Gateway {
        address,
        hangs,
        ends,
        stands,
        dir,
        service: Some(service),
        _runtime: runtime,
    }
}

/// A state before the first cycle.
fn first() -> volcomp_gateway::documents::Status {
    let times = json!({ "p50_us": 0.0, "p99_us": 0.0, "max_us": 0.0 });
    let state = json!({
        "state": "disarmed", "reasons": [], "armed": false, "auto_arm": false, "simulated": false,
        "machine": { "name": "m", "hash": "", "axes": [] }, "controller": null,
        "positions_mm": {}, "correction_um": {}, "wanted_um": {},
        "error_um": null, "error_urad": null, "residual_um": null, "temperatures": [],
        "held_back": 0, "faults": 0, "uptime_s": 0.0, "age_ms": 0.0,
        "cycle": {
            "count": 0, "period_us": 4000.0, "p50_us": 0.0, "p99_us": 0.0, "max_us": 0.0, "overruns": 0,
            "own": times, "wake": times, "exchange": times, "histogram_us": [],
        },
    });
    serde_json::from_value(state).expect("a state")
}

impl Gateway {
    fn connect(&self) -> TcpStream {
        let stream = TcpStream::connect(self.address).expect("it listens");
        stream.set_read_timeout(Some(PATIENCE)).expect("a time");
        stream
    }

    fn request(&self, method: &str, path: &str) -> Answer {
        let mut stream = self.connect();
        let text = format!(
            "{method} {path} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {OPERATE}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
        );
        stream.write_all(text.as_bytes()).expect("sent");
        let mut text = String::new();
        stream.read_to_string(&mut text).expect("an answer");
        answer(&text)
    }

    fn state(&self) -> Value {
        self.request("GET", "/api/state").json()
    }

    fn wait_for(&self, name: &str) -> Value {
        self.wait(|state| state["state"] == name)
    }

    fn wait(&self, done: impl Fn(&Value) -> bool) -> Value {
        let end = Instant::now() + PATIENCE;
        loop {
            let state = self.state();
            if done(&state) {
                return state;
            }
            assert!(Instant::now() < end, "{state}");
            std::thread::sleep(Duration::from_millis(5));
        }
    }

    /// The latest event of a stream that has just been opened.
    fn event(&self) -> String {
        let mut stream = self.connect();
        let text = "GET /api/events HTTP/1.1\r\nHost: localhost\r\n\r\n";
        stream.write_all(text.as_bytes()).expect("sent");
        let mut heard = String::new();
        let mut buffer = [0; 4096];
        while heard.matches("event: state").count() < 2 {
            let count = stream.read(&mut buffer).expect("more");
            assert!(count > 0, "it ended: {heard}");
            heard += &String::from_utf8_lossy(&buffer[..count]);
        }
        heard
    }
}

/// Before, it went on saying what the last cycle had said, and armed when the controller came back.
#[test]
fn a_silent_control_thread_is_told_and_what_was_asked_meanwhile_expires() {
    let gateway = gateway();
    gateway.wait(|state| state["positions_mm"]["X"].is_number());
    gateway.hangs.set(true);
    let silent = Instant::now();
    let state = gateway.wait_for("unknown");
    println!(
        "state unknown {:.0} ms after the last cycle (period 4 ms)",
        silent.elapsed().as_secs_f64() * 1e3
    );
    let reason = state["reasons"][0].as_str().expect("a reason");
    assert!(
        reason.starts_with("no cycle for ") && reason.ends_with(" ms"),
        "{reason}"
    );
    assert!(state["age_ms"].as_f64() > Some(12.0), "{state}");
    for key in ["positions_mm", "correction_um"] {
        assert_eq!(state[key], json!({}), "nothing is known: {state}");
    }
    assert_eq!(state["error_um"], Value::Null);
    assert_eq!(state["correction_known"], false);
    assert_eq!(state["proven"], json!({}));
    let path = &state["controllers"][0];
    assert_eq!(path["holds_correction"], Value::Null, "nothing is known");
    assert!(path["answered_ms"].as_f64() > Some(12.0), "it ages: {path}");
    let metrics = gateway.request("GET", "/metrics").body;
    assert!(
        metrics.contains("volcomp_state{state=\"unknown\"} 1"),
        "{metrics}"
    );
    assert!(
        metrics.contains("volcomp_reason{reason=\"no cycle\"} 1"),
        "{metrics}"
    );
    assert!(gateway.event().contains("\"state\":\"unknown\""));
    // Asked now it is not done later.
    let armed = gateway.request("POST", "/api/arm");
    assert_eq!(armed.status, 503, "{}", armed.body);
    assert!(armed.body.contains("expired"), "{}", armed.body);
    gateway.hangs.set(false);
    gateway.wait_for("disarmed");
    std::thread::sleep(Duration::from_millis(500));
    assert_eq!(gateway.state()["state"], "disarmed");
    // Disarming waits for the thread, and is done with its next cycle.
    assert_eq!(gateway.request("POST", "/api/arm").status, 200);
    gateway.wait_for("compensating");
    gateway.hangs.set(true);
    gateway.wait_for("unknown");
    let disarmed = gateway.request("POST", "/api/disarm");
    assert_eq!(disarmed.status, 503, "{}", disarmed.body);
    assert!(
        disarmed.body.contains("it disarms with its next cycle"),
        "{}",
        disarmed.body
    );
    gateway.hangs.set(false);
    gateway.wait_for("disarmed");
}

/// Sixty-four requests that wait for the service: a disarming was carried out, but neither written down nor remembered, so
/// that the gateway armed by itself after a restart.
#[test]
fn disarming_is_written_down_whatever_waits() {
    let gateway = gateway();
    gateway.wait(|state| state["positions_mm"]["X"].is_number());
    gateway.stands.store(true, Ordering::Relaxed);
    std::thread::sleep(Duration::from_millis(200));
    let text = |what: &str| {
        format!(
            "POST /api/{what} HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {OPERATE}\r\nContent-Length: 0\r\n\r\n"
        )
    };
    let ask = |what: &str| {
        let mut stream = gateway.connect();
        stream.write_all(text(what).as_bytes()).expect("sent");
        stream
    };
    // Until one finds no place: each further connection ends the oldest one.
    let mut waiting = Vec::new();
    let refused = loop {
        assert!(waiting.len() < 256, "all of them find a place");
        let mut stream = ask("acknowledge");
        let soon = Some(Duration::from_millis(5));
        stream.set_read_timeout(soon).expect("a time");
        let mut begins = [0; 12];
        if stream.read_exact(&mut begins).is_ok() {
            break begins;
        }
        waiting.push(stream);
    };
    assert!(waiting.len() >= 64, "{}", waiting.len());
    assert_eq!(refused.as_slice(), b"HTTP/1.1 503");
    let disarming = ask("disarm");
    std::thread::sleep(Duration::from_millis(100));
    gateway.stands.store(false, Ordering::Relaxed);
    let file = gateway.dir.path().join("standing.slots");
    gateway.wait(|_| file.exists() && kept(&file).contains("\"disarmed_by\":\"anna\""));
    drop((waiting, disarming));
}

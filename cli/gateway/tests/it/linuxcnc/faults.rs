//! A gateway or bridge that dies, a second gateway, and a network that loses, duplicates, delays and reorders datagrams.

use std::{
    net::UdpSocket,
    process::Command,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    thread::JoinHandle,
    time::{Duration, Instant},
};

use rand::{RngExt, SeedableRng};

use super::{
    MOST, PORT, alone::alone, corrected, corrected_at, gateway, no_jump, peer::LinuxCnc,
    wait_corrected, wait_zero,
};
use crate::program::{Program, path};

alone!(faults: a_gateway_that_dies_leaves_nothing, a_network_that_loses_doubles_and_delays_moves_nothing_wrongly);

fn a_gateway_that_dies_leaves_nothing() {
    let dir = tempfile::tempdir().expect("writable");
    let (mut control, mut program) = corrected_at("X50 Y40 Z-20", dir.path(), |ini| {
        assert!(ini.contains("AXES = XYZ\n"));
        ini.replace("AXES = XYZ\n", "")
    });
    let epoch = control.pin("volcomp.epoch");
    // The disk hangs. Only the writer of the epoch file waits for the disk.
    let hangs = dir.path().join("volcomp.epoch.new");
    let made = Command::new("mkfifo").arg(&hangs).status();
    assert!(made.expect("a program of the system").success());

    // After a kill of the gateway the barrier times out, ramps to zero, and increments the epoch.
    let cycles = control.record(|control| {
        program.running.kill();
        wait_zero(control);
    });
    no_jump(&cycles, MOST);
    assert!(control.pin("volcomp.epoch") > epoch);
    assert_eq!(control.pin("volcomp.owner"), 0.0);
    drop(program);

    let program = gateway(dir.path(), PORT);
    let cycles = control.record(|control| wait_corrected(control, &program));
    no_jump(&cycles, MOST);
    // The disk responds again.
    let both = std::fs::File::options().read(true).write(true).open(&hangs);
    std::fs::remove_file(&hangs).expect("ours");
    drop(both.expect("a pipe"));
    let epoch = control.pin("volcomp.epoch");
    let kept = || std::fs::read_to_string(dir.path().join("volcomp.epoch")).unwrap_or_default();
    control.wait("volcomp.epoch", |now| now == epoch && kept().trim() == epoch.to_string());

    // A second gateway with its own folders moves no axis.
    let other = tempfile::tempdir().expect("writable");
    // The second gateway needs another address, because a second gateway on this computer is refused at the same
    // address.
    let mut relay = Relay::start(47_101, PORT);
    let config = super::configuration(other.path(), 47_101);
    let second = Program::start(other.path(), &["--config", path(&config)]);
    let cycles = control.record(|control| {
        let seen = second.wait(|state| state["reasons"].to_string().contains("gateway"));
        seen.unwrap_or_else(|state| panic!("it does not see the first one: {state}"));
        control.mdi("G1 F600 X90");
    });
    corrected("with a second gateway", &cycles);
    drop(second);
    relay.end();
}

/// A relay between gateway and bridge that loses, duplicates, delays and reorders datagrams.
struct Relay {
    stop: Arc<AtomicBool>,
    bad: Arc<AtomicBool>,
    thread: Option<JoinHandle<[u64; 2]>>,
}

impl Relay {
    fn start(from: u16, to: u16) -> Self {
        let stop = Arc::new(AtomicBool::new(false));
        let bad = Arc::new(AtomicBool::new(false));
        let near = UdpSocket::bind(("127.0.0.1", from)).expect("free");
        let far = UdpSocket::bind("127.0.0.1:0").expect("loopback");
        far.connect(("127.0.0.1", to)).expect("loopback");
        for socket in [&near, &far] {
            socket.set_nonblocking(true).expect("a socket");
        }
        let (stopped, worse) = (Arc::clone(&stop), Arc::clone(&bad));
        let thread = std::thread::spawn(move || {
            let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(7);
            let mut waiting: Vec<(Instant, bool, Vec<u8>)> = Vec::new();
            let mut peer = None;
            let mut counts = [0; 2];
            while !stopped.load(Ordering::Relaxed) {
                let mut came = Vec::new();
                let mut bytes = [0; 600];
                while let Ok((length, sender)) = near.recv_from(&mut bytes) {
                    peer = Some(sender);
                    came.push((true, bytes[..length].to_vec()));
                }
                while let Ok(length) = far.recv(&mut bytes) {
                    came.push((false, bytes[..length].to_vec()));
                }
                for (outwards, bytes) in came {
                    counts[0] += 1;
                    let is_bad = worse.load(Ordering::Relaxed);
                    if is_bad && random.random_bool(0.1) {
                        continue;
                    }
                    let copies = if is_bad && random.random_bool(0.1) { 2 } else { 1 };
                    for _ in 0..copies {
                        // One frame in ten is so late that other frames overtake it. One frame in a hundred is so late
                        // that very many frames overtake it.
                        let ms = match random.random_range(0..100) {
                            0 if is_bad => random.random_range(100..2000),
                            1..10 if is_bad => random.random_range(1..12),
                            _ => 0,
                        };
                        let at = Instant::now() + Duration::from_millis(ms);
                        waiting.push((at, outwards, bytes.clone()));
                        counts[1] += u64::from(ms > 0 || copies > 1);
                    }
                }
                let now = Instant::now();
                waiting.retain(|(at, outwards, bytes)| {
                    if *at > now {
                        return true;
                    }
                    let _ = match (outwards, peer) {
                        (true, _) => far.send(bytes),
                        (false, Some(peer)) => near.send_to(bytes, peer),
                        (false, None) => Ok(0),
                    };
                    false
                });
                std::thread::sleep(Duration::from_micros(200));
            }
            counts
        });
        Self { stop, bad, thread: Some(thread) }
    }

    /// Returns the number of received datagrams, and the number of duplicated or delayed ones.
    fn end(&mut self) -> [u64; 2] {
        self.stop.store(true, Ordering::Relaxed);
        let thread = self.thread.take().expect("ended once");
        thread.join().expect("no panic")
    }
}

fn a_network_that_loses_doubles_and_delays_moves_nothing_wrongly() {
    let dir = tempfile::tempdir().expect("writable");
    let mut control = LinuxCnc::start(dir.path(), |ini| ini);
    let mut relay = Relay::start(47_100, PORT);
    let program = gateway(dir.path(), 47_100);
    control.do_it("up");
    control.mdi("G21 G90 G0 X20 Y10 Z-5");
    wait_corrected(&mut control, &program);
    relay.bad.store(true, Ordering::Relaxed);
    let cycles = control.record(|control| control.mdi("G1 F600 X50 Y30 Z-20"));
    no_jump(&cycles, MOST);
    // Late frames prevent nanometre accuracy. The error is bounded by the motion in a few cycles.
    let found = super::residuals(&cycles);
    let [median, most] = [50, 99].map(|of| super::part(&found, of));
    println!("a bad network: residual {median:.2} nm median, {most:.1} nm p99");
    assert!(median < 20.0, "{median} nm");
    relay.bad.store(false, Ordering::Relaxed);
    program.wait_for("compensating");
    wait_corrected(&mut control, &program);
    let counts = relay.end();
    assert!(counts[0] > 5000 && counts[1] > 300, "{counts:?}");
    // Without frames the barrier ramps to zero after its timeout.
    wait_zero(&mut control);
}

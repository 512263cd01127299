//! The program and a control with a barrier, end to end: under any fault of the program, the connection and the control, an axis never
//! moves by more than the barrier's rate in one scan. Without a barrier these were full steps.
//!
//! Each test repeats a few times, or `VOLCOMP_REPEATS` times.

use std::{
    io::{Read, Write},
    net::{Shutdown, SocketAddr, TcpListener, TcpStream},
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicUsize, Ordering},
    },
    thread::sleep,
    time::Duration,
};

use volcomp_focas::{
    PmcArea,
    simulator::{Options, Simulator, World},
};
use volcomp_guard::barrier::Program as Barrier;
use volcomp_vocabulary::AxisName;

use crate::{
    controlled::configuration,
    online::check,
    program::{Program, change, path},
};

/// Rate of the barrier: counts of 1 µm per scan of 2 ms.
const RATE: i64 = 2;
/// Maximum time until an axis is at zero after the last frame: hold 200 ms + timeout 450 ms + 150 µm at 1 mm/s, with a margin for a busy
/// computer.
const LETS_GO: Duration = Duration::from_millis(1200);

fn repeats() -> u64 {
    let asked = std::env::var("VOLCOMP_REPEATS");
    asked.ok().and_then(|asked| asked.parse().ok()).unwrap_or(3)
}

/// A pseudo-random duration below `most_ms` for this number.
fn some(number: u64, most_ms: u64) -> Duration {
    let mixed = number
        .wrapping_add(1)
        .wrapping_mul(0x9e37_79b9_7f4a_7c15)
        .rotate_left(31)
        .wrapping_mul(0xbf58_476d_1ce4_e5b9);
    Duration::from_millis((mixed >> 33) % most_ms)
}

/// A control whose X moves back and forth, not started yet: limit 150 counts, rate 2 counts per scan of 2 ms.
pub(crate) fn world() -> World {
    let axes = [AxisName::X, AxisName::Y, AxisName::Z];
    let settings = volcomp_test_support::barrier::settings(&axes).expect("sensible");
    let barrier = Barrier::new(settings).expect("sensible");
    let mut world = World::new(&['X', 'Y', 'Z']).with_barrier(Box::new(barrier));
    world.motion = Arc::new(|elapsed| {
        let x = 400.0 + 300.0 * (elapsed.as_secs_f64() * 0.5).sin();
        vec![x, 150.0, 50.0]
    });
    world
}

pub(crate) fn start(world: World) -> Simulator {
    Simulator::start("127.0.0.1:0", Options::default(), world).expect("loopback")
}

pub(crate) fn guarded(dir: &Path, control: &Simulator) -> std::path::PathBuf {
    let config = configuration(dir, control, "auto_arm = true");
    change(
        &config,
        "heartbeat = { pmc = \"R\", at = 120 }",
        "barrier = { machine = 4711, scan_ms = 2.0, frame = { pmc = \"R\", at = 200 }, report = { pmc = \"R\", at = 240 } }",
    );
    config
}

/// Waits until the gateway compensates and the axes have the correction: −20 µm for Y.
fn corrects(program: &Program, control: &Simulator) {
    program.wait_for("compensating");
    for _ in 0..2000 {
        if control.world().shift_counts()[1] == -20 {
            return;
        }
        sleep(Duration::from_millis(5));
    }
    panic!("{:?}: {}", control.world().shift_counts(), program.state());
}

fn no_step(control: &Simulator, of: &str) {
    let world = control.world();
    let steps = world.largest_steps();
    assert!(steps.iter().all(|step| *step <= RATE), "{of}: {steps:?}");
}

/// The gateway is killed, and restarted while the control still holds the correction, ramps it out, or is at zero: the new process does
/// not step to the stored correction of 40 µm.
#[test]
fn killed_and_started_again() {
    let dir = tempfile::tempdir().expect("writable");
    let control = start(world());
    let config = guarded(dir.path(), &control);
    let arguments = ["--config", path(&config)];
    for number in 0..repeats() {
        let mut program = Program::start(dir.path(), &arguments);
        corrects(&program, &control);
        sleep(some(number, 700));
        program.running.kill();
        drop(program);
        sleep(some(number + 1000, 1500));
        no_step(&control, &format!("killed, {number}"));
    }
    let mut program = Program::start(dir.path(), &arguments);
    corrects(&program, &control);
    program.signal("TERM");
    assert_eq!(program.end(), Some(0));
    assert_eq!(control.world().shifts(), [0.0; 3], "ramped out");
    no_step(&control, "ended");
}

/// The gateway is suspended for two seconds, also between a read and its write: the expired write does not reach an axis that the control
/// has ramped to zero.
#[test]
fn stopped_for_two_seconds() {
    let dir = tempfile::tempdir().expect("writable");
    let control = start(world());
    let config = guarded(dir.path(), &control);
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    for number in 0..repeats() {
        corrects(&program, &control);
        sleep(some(number, 300));
        program.signal("STOP");
        sleep(Duration::from_secs(2));
        let held = control.world().shifts();
        program.signal("CONT");
        assert_eq!(held, [0.0; 3], "the control ramps to zero");
        corrects(&program, &control);
        no_step(&control, &format!("stopped, {number}"));
    }
}

/// The control restarts, by a reset that keeps the correction words or a power cycle that clears them: the gateway continues from the
/// reported words.
#[test]
fn a_control_that_begins_anew() {
    let dir = tempfile::tempdir().expect("writable");
    let control = start(world());
    let config = guarded(dir.path(), &control);
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    for number in 0..2 * repeats() {
        corrects(&program, &control);
        sleep(some(number, 300));
        if number % 2 == 0 {
            control.world().reset();
        } else {
            control.power_up();
        }
        sleep(some(number + 1000, 200));
        corrects(&program, &control);
        no_step(&control, &format!("begun anew, {number}"));
    }
}

#[test]
fn garbage_in_the_words() {
    let dir = tempfile::tempdir().expect("writable");
    let control = start(world());
    let config = guarded(dir.path(), &control);
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    corrects(&program, &control);
    for number in 0..40 * repeats() {
        let bytes: Vec<u8> = (0..40)
            .map(|place| {
                let value = some(number * 64 + place, 256).as_millis();
                u8::try_from(value).expect("below 256")
            })
            .collect();
        let at = if number % 2 == 0 { 200 } else { 240 };
        control.world().set(PmcArea::R, at, &bytes);
        sleep(some(number, 30));
        no_step(&control, &format!("garbage, {number}"));
    }
    corrects(&program, &control);
}

/// An axis holds a word of 5 mm, far above the limit, when a gateway with auto-arm starts: the barrier ramps it to zero at its rate, and
/// only then the gateway corrects.
#[test]
fn a_correction_beyond_the_limit_is_found_at_the_start() {
    let dir = tempfile::tempdir().expect("writable");
    let mut world = world();
    world.set(PmcArea::R, 100, &[0x88, 0x13]);
    let control = start(world);
    control.world().reset_largest_steps();
    let config = guarded(dir.path(), &control);
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    let mut before = control.world().shift_counts()[0];
    assert!(before > 1000, "{before}");
    for _ in 0..1000 {
        let now = control.world().shift_counts()[0];
        assert!(now.abs() <= before.abs().max(150), "{before} to {now}");
        before = now;
        if now.abs() <= 150 {
            break;
        }
        sleep(Duration::from_millis(10));
    }
    assert!(before.abs() <= 150, "{before}: {}", program.state());
    no_step(&control, "found at the start");
}

/// Writes that are in transit when the connection closes arrive 0.5 to 2 s later: the axis does not step to the old correction.
#[test]
fn what_was_kept_back_comes_later() {
    let dir = tempfile::tempdir().expect("writable");
    let control = start(world());
    let wire = Wire::to(control.address());
    let config = guarded(dir.path(), &control);
    let (direct, kept) = (control.address().to_string(), wire.address.to_string());
    change(&config, &direct, &kept);
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    for number in 0..repeats() {
        corrects(&program, &control);
        let before = wire.connections();
        wire.keep();
        sleep(Duration::from_millis(500) + some(number, 1500));
        // By now a new connection carries the correction, or waits until the barrier is free.
        wire.deliver();
        sleep(LETS_GO);
        no_step(&control, &format!("kept back, {number}"));
        corrects(&program, &control);
        assert!(wire.connections() > before, "it connected anew");
    }
}

/// The barrier has the axes X, Y, Z and the configuration another order: the gateway stays disarmed, because X would get the correction
/// of Y, and `check --online` fails.
#[test]
fn axes_in_another_order_than_the_barriers_are_refused() {
    let dir = tempfile::tempdir().expect("writable");
    let control = start(world());
    let config = guarded(dir.path(), &control);
    change(
        &config,
        r#"axes = ["X", "Y", "Z"]"#,
        r#"axes = ["Y", "X", "Z"]"#,
    );
    let (_, errors, status) = check(&config, &["--online"]);
    assert_eq!(status, 1, "{errors}");
    assert!(
        errors.contains("found no report of a barrier for this machine and these axes")
            && errors.contains("the axes YXZ in this order")
            && errors.contains("`layout` to 213"),
        "{errors}"
    );
    let program = Program::start(dir.path(), &["--config", path(&config)]);
    let refused = "no barrier for this machine and these axes";
    program
        .wait(|state| state["reasons"].to_string().contains(refused))
        .expect("it is reported");
    sleep(Duration::from_secs(3));
    let state = program.state();
    assert_eq!(state["state"], "disarmed", "{state}");
    assert_eq!(state["correction_known"], false, "{state}");
    assert_eq!(control.world().shift_counts(), [0, 0, 0]);
    drop(program);
    change(
        &config,
        r#"axes = ["Y", "X", "Z"]"#,
        r#"axes = ["X", "Y", "Z"]"#,
    );
    assert_eq!(check(&config, &["--online"]).2, 0);
}

/// A TCP relay to a control, which refuses new connections once dropped.
pub(crate) struct Wire {
    pub(crate) address: SocketAddr,
    made: Arc<AtomicUsize>,
    /// The relay holds back the data of connections with a lower number.
    kept: Arc<AtomicUsize>,
    done: Arc<AtomicBool>,
}

impl Wire {
    pub(crate) fn to(control: SocketAddr) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").expect("loopback");
        let wire = Self {
            address: listener.local_addr().expect("bound"),
            made: Arc::default(),
            kept: Arc::default(),
            done: Arc::default(),
        };
        let (made, kept) = (Arc::clone(&wire.made), Arc::clone(&wire.kept));
        let done = Arc::clone(&wire.done);
        std::thread::spawn(move || {
            for near in listener.incoming() {
                if done.load(Ordering::Relaxed) {
                    return;
                }
                let (Ok(near), Ok(far)) = (near, TcpStream::connect(control)) else {
                    continue;
                };
                let number = made.fetch_add(1, Ordering::Relaxed);
                let ends = near.try_clone().and_then(|n| Ok((n, far.try_clone()?)));
                let Ok((near_back, far_back)) = ends else {
                    continue;
                };
                let kept = Arc::clone(&kept);
                std::thread::spawn(move || {
                    pass(near, far, || number < kept.load(Ordering::Relaxed));
                });
                std::thread::spawn(move || pass(far_back, near_back, || false));
            }
        });
        wire
    }

    /// Holds back the data to the control on all connections that are open now, until [`deliver`](Self::deliver).
    pub(crate) fn keep(&self) {
        let made = self.made.load(Ordering::Relaxed);
        self.kept.store(made, Ordering::Relaxed);
    }

    pub(crate) fn deliver(&self) {
        self.kept.store(0, Ordering::Relaxed);
    }

    pub(crate) fn connections(&self) -> usize {
        self.made.load(Ordering::Relaxed)
    }
}

impl Drop for Wire {
    fn drop(&mut self) {
        self.done.store(true, Ordering::Relaxed);
        // Wakes the thread that waits in `accept`.
        let _ = TcpStream::connect(self.address);
    }
}

/// Forwards bytes until one end closes; bytes already received are delivered even then.
fn pass(mut from: TcpStream, mut to: TcpStream, waits: impl Fn() -> bool) {
    let _ = to.set_nodelay(true);
    let mut bytes = [0; 4096];
    while let Ok(count) = from.read(&mut bytes) {
        while waits() {
            std::thread::sleep(Duration::from_millis(1));
        }
        if count == 0 || to.write_all(&bytes[..count]).is_err() {
            break;
        }
    }
    let _ = to.shutdown(Shutdown::Write);
}

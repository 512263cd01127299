//! Several machines in one process: what happens to one, and what the others notice of it.

use std::{
    net::{SocketAddr, TcpListener},
    path::{Path, PathBuf},
    process::Command,
    sync::{
        Arc,
        atomic::{AtomicBool, Ordering},
    },
    time::{Duration, Instant},
};

use serde_json::Value;
use volcomp_focas::simulator::{BarrierLadder, Ladder, Options, Simulator, World};
use volcomp_gateway::{
    machine::Machine,
    options,
    service::Service,
    slot::{Phase, Slot},
};
use volcomp_guard::barrier::{Program as Barrier, Protection};
use volcomp_test_support::until;
use volcomp_vocabulary::AxisName;

use crate::{
    hung_disk::preloaded,
    online::{check, said},
    program::{Answer, MACHINE, Program, change, exchange, path},
};

const PATIENCE: Duration = Duration::from_secs(30);
pub(crate) const NAMES: [&str; 3] = ["mill-1", "mill-2", "mill-3"];
/// The corrections of [`MACHINE`] at 400, 150, 50 mm.
const CORRECTED: [f64; 3] = [-0.020, -0.020, 0.0];

/// A control whose axes stand.
fn control() -> Simulator {
    let mut world = World::new(&['X', 'Y', 'Z']);
    world.motion = Arc::new(|_| vec![400.0, 150.0, 50.0]);
    Simulator::start("127.0.0.1:0", Options::default(), world).expect("loopback")
}

/// A control with a barrier, at every address of this computer. It scans slowly: with 2 ms, scans that come late on a computer
/// with other work keep the gateways from arming.
fn control_with_barrier() -> Simulator {
    let axes = volcomp_test_support::barrier::axes(&[AxisName::X, AxisName::Y, AxisName::Z]);
    let protection = Protection {
        scan: Duration::from_millis(8),
        ..volcomp_test_support::barrier::protection()
    };
    let settings = protection.settings(&axes).expect("three axes");
    let program = Barrier::new(settings).expect("right");
    let mut world = World::new(&['X', 'Y', 'Z']);
    world.scan = protection.scan;
    world.ladder = Some(Ladder::Barrier(BarrierLadder::new(Box::new(program), 3)));
    world.motion = Arc::new(|_| vec![400.0, 150.0, 50.0]);
    Simulator::start("0.0.0.0:0", Options::default(), world).expect("loopback")
}

/// The corrections go as plain values: a barrier whose scans come late on a computer with other work is not armed.
const WORDS: &str = "heartbeat = { pmc = \"R\", at = 120 }";
/// The corrections go to the barrier.
const BARRIER: &str = "barrier = { machine = 4711, scan_ms = 8.0, frame = { pmc = \"R\", at = 200 }, report = { pmc = \"R\", at = 240 } }";

/// A token of its own for each machine.
fn token(name: &str) -> String {
    format!(
        "{:0>32}",
        name.len() * 1000 + usize::from(name.as_bytes()[name.len() - 1])
    )
}

/// A machine in a folder of its name.
fn machine(dir: &Path, name: &str, control: SocketAddr) -> PathBuf {
    use std::os::unix::fs::PermissionsExt;
    let folder = dir.join(name);
    std::fs::create_dir_all(&folder).expect("writable");
    std::fs::write(folder.join("machine.toml"), MACHINE).expect("writable");
    let tokens = folder.join("tokens");
    std::fs::write(&tokens, format!("anna operate {}\n", token(name))).expect("writable");
    std::fs::set_permissions(&tokens, std::fs::Permissions::from_mode(0o600)).expect("ours");
    let text = format!(
        r#"
machine = "machine.toml"
auto_arm = true
[guard]
limit_um = 150.0
limit_without_barrier_um = 150.0
slew_um_per_s = 500.0
hold_ms = 200
zero_after_ms = 3000
ramp_s = 0.2
test_shift_um = 0
[[controller]]
url = "focas://{control}"
axes = ["X", "Y", "Z"]
{WORDS}
[dashboard]
listen = "127.0.0.1:0"
token_file = "tokens"
"#
    );
    let config = folder.join("G.toml");
    std::fs::write(&config, text).expect("writable");
    config
}

/// The file of machines that stand in folders of their names.
fn shop_file(dir: &Path, names: &[&str]) -> PathBuf {
    let tables = names
        .iter()
        .map(|name| format!("[[machine]]\nname = \"{name}\"\nconfig = \"{name}/G.toml\"\n"));
    let text: String = tables.collect();
    let file = dir.join("shop.toml");
    std::fs::write(&file, text + "[dashboard]\nlisten = \"127.0.0.1:0\"\n").expect("writable");
    file
}

/// Three machines in one process, each with a control of its own.
pub(crate) struct Shop {
    pub(crate) dir: tempfile::TempDir,
    pub(crate) file: PathBuf,
    pub(crate) controls: Vec<Simulator>,
}

impl Shop {
    pub(crate) fn new() -> Self {
        Self::of(NAMES.len())
    }

    /// So many machines, three at the most.
    pub(crate) fn of(count: usize) -> Self {
        let names = &NAMES[..count];
        let dir = tempfile::tempdir().expect("writable");
        let controls: Vec<Simulator> = names.iter().map(|_| control()).collect();
        for (name, control) in names.iter().zip(&controls) {
            machine(dir.path(), name, control.address());
        }
        let file = shop_file(dir.path(), names);
        Self {
            dir,
            file,
            controls,
        }
    }

    pub(crate) fn start(&self) -> Program {
        Program::start(self.dir.path(), &["--config", path(&self.file)])
    }

    pub(crate) fn all_compensate(&self, program: &Program) {
        all_compensate(program, &NAMES[..self.controls.len()]);
    }

    /// The configuration of a machine.
    pub(crate) fn config(&self, name: &str) -> PathBuf {
        self.dir.path().join(name).join("G.toml")
    }

    /// Where a control has its axes.
    fn shifts(&self, number: usize) -> [f64; 3] {
        let shifts = self.controls[number].world().shifts();
        [shifts[0], shifts[1], shifts[2]]
    }
}

/// A machine as the overview shows it.
fn glance(program: &Program, name: &str) -> Value {
    let overview = program.get("/api/machines").json();
    crate::documents::validate("gateway-overview.json", &overview);
    let machines = overview["machines"].as_array().expect("a list");
    let found = machines.iter().find(|machine| machine["name"] == name);
    found.expect("listed").clone()
}

fn wait_for(program: &Program, name: &str, what: &str, holds: impl Fn(&Value) -> bool) -> Value {
    let mut last = Value::Null;
    until(
        &format!("{name} {what}: {}", program.log()),
        PATIENCE,
        || {
            last = glance(program, name);
            holds(&last)
        },
    );
    last
}

fn is_in(state: &'static str) -> impl Fn(&Value) -> bool {
    move |machine| machine["state"] == state
}

fn all_compensate(program: &Program, names: &[&str]) {
    for name in names {
        wait_for(program, name, "compensates", is_in("compensating"));
    }
}

/// A request to the dashboard of a machine.
fn ask(program: &Program, name: &str, request: &str, token: &str) -> Answer {
    let url = glance(program, name)["dashboard"].clone();
    let url = url.as_str().expect("it runs");
    let address: SocketAddr = url["http://".len()..].parse().expect("an address");
    let (method, path) = request.split_once(' ').expect("two words");
    let head = format!(
        "{method} {path} HTTP/1.1\r\nHost: {address}\r\nAuthorization: Bearer {token}\r\nContent-Length: 0\r\nConnection: close\r\n\r\n"
    );
    crate::program::answer(&exchange(address, head.as_bytes()))
}

fn cycles(program: &Program, name: &str) -> u64 {
    let state = ask(program, name, "GET /api/state", "").json();
    state["cycle"]["count"].as_u64().expect("a number")
}

/// Machines that go on while `holds` becomes true of another one: none of them stops, is disarmed or faulted, and afterwards they
/// compensate, their axes are where they were to the last bit, and cycles are counted on. Held they may be for a moment: their
/// controls are simulated on this computer, which has other work, too.
fn go_on(shop: &Shop, program: &Program, numbers: &[usize], what: &str, holds: impl Fn() -> bool) {
    let before: Vec<u64> = numbers.iter().map(|n| cycles(program, NAMES[*n])).collect();
    let look = || {
        for number in numbers {
            let machine = glance(program, NAMES[*number]);
            assert!(is_undisturbed(machine["state"].as_str()), "{machine}");
            assert_eq!(machine["phase"], "running", "{machine}");
        }
    };
    until(what, PATIENCE, || {
        look();
        holds()
    });
    until("the others compensate, cycle after cycle", PATIENCE, || {
        look();
        let others = numbers.iter().zip(&before);
        others.into_iter().all(|(number, before)| {
            let name = NAMES[*number];
            shop.shifts(*number) == CORRECTED
                && glance(program, name)["state"] == "compensating"
                && cycles(program, name) > before + 100
        })
    });
}

/// Whether a state is one that a machine has by itself, and that it leaves by itself.
fn is_undisturbed(state: Option<&str>) -> bool {
    !matches!(state, None | Some("disarmed" | "faulted" | "failed"))
}

/// The controller of one vanishes; it comes to no halt for the others, nor does a person who disarms one.
#[test]
fn the_others_go_on_where_one_is_disarmed_or_loses_its_controller() {
    let mut shop = Shop::new();
    let mut program = shop.start();
    all_compensate(&program, &NAMES);
    // Tokens are each machine's own.
    let foreign = ask(&program, "mill-1", "POST /api/disarm", &token("mill-2"));
    assert_eq!(foreign.status, 401, "{}", foreign.body);
    assert_eq!(glance(&program, "mill-1")["state"], "compensating");
    let own = ask(&program, "mill-1", "POST /api/disarm", &token("mill-1"));
    assert_eq!(own.status, 200, "{}", own.body);
    go_on(&shop, &program, &[1, 2], "mill-1 is at zero", || {
        shop.shifts(0) == [0.0; 3] && glance(&program, "mill-1")["state"] == "disarmed"
    });
    assert_eq!(
        ask(&program, "mill-1", "POST /api/arm", &token("mill-1")).status,
        200
    );
    all_compensate(&program, &["mill-1"]);
    // The control of mill-2 is gone.
    drop(std::mem::replace(&mut shop.controls[1], control()));
    go_on(&shop, &program, &[0, 2], "mill-2 is lost", || {
        let told = glance(&program, "mill-2")["reasons"].to_string();
        told.contains("positions lost") && told.contains("controller does not answer")
    });
    program.signal("TERM");
    // Its correction is not known: it waits for as long as it may, and the others are at zero long before.
    until("the others are at zero", PATIENCE, || {
        shop.shifts(0) == [0.0; 3] && shop.shifts(2) == [0.0; 3]
    });
    assert_eq!(program.end(), Some(0), "{}", program.log());
}

/// The disk of one machine's audit log hangs.
#[test]
fn the_others_arm_and_end_while_the_disk_of_one_hangs() {
    let shop = Shop::new();
    let Some(library) = preloaded(shop.dir.path()) else {
        return;
    };
    let hangs = shop.dir.path().join("hangs");
    let mut command = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"));
    command.env("LD_PRELOAD", library).env("HANGS", &hangs).env(
        "HANGS_BELOW",
        shop.dir
            .path()
            .join("mill-2")
            .canonicalize()
            .expect("there"),
    );
    let mut program = Program::spawn(command, shop.dir.path(), &["--config", path(&shop.file)]);
    all_compensate(&program, &NAMES);
    std::fs::write(&hangs, "").expect("writable");
    // It writes what hangs.
    assert_eq!(
        ask(&program, "mill-2", "POST /api/disarm", &token("mill-2")).status,
        200
    );
    go_on(&shop, &program, &[0, 2], "mill-2 tells of its disk", || {
        let reasons = glance(&program, "mill-2")["reasons"].to_string();
        shop.shifts(1) == [0.0; 3] && reasons.contains("audit log")
    });
    // Arming waits for a record: for that of its own machine.
    assert_eq!(
        ask(&program, "mill-1", "POST /api/disarm", &token("mill-1")).status,
        200
    );
    assert_eq!(
        ask(&program, "mill-1", "POST /api/arm", &token("mill-1")).status,
        200
    );
    let refused = ask(&program, "mill-2", "POST /api/arm", &token("mill-2"));
    assert!(matches!(refused.status, 409 | 503), "{}", refused.body);
    // Ctrl-C meanwhile.
    program.signal("INT");
    assert_eq!(program.end(), Some(0), "{}", program.log());
    assert!(hangs.exists());
    assert_eq!([0, 1, 2].map(|number| shop.shifts(number)), [[0.0; 3]; 3]);
    let log = program.log();
    assert!(
        log.contains("machine{name=\"mill-2\"}: the disk of the audit log does not answer"),
        "{log}"
    );
    for name in ["mill-1", "mill-3"] {
        let audit = std::fs::read_to_string(shop.dir.path().join(name).join("audit/audit.log"));
        // On a busy computer its own disk may be late, too, which is told.
        let late = format!("machine{{name=\"{name}\"}}: the disk of the audit log does not answer");
        assert!(
            audit.expect("a log").contains("\"what\":\"stopped\"") || log.contains(&late),
            "{name}: {log}"
        );
    }
}

/// Ends all machines when it is dropped.
struct EndsAll<'s>(&'s [Arc<Slot>]);

impl Drop for EndsAll<'_> {
    fn drop(&mut self) {
        self.0.iter().for_each(|slot| slot.stop());
    }
}

/// The control thread of a machine ends, which it never should by itself: the machine is told as one that does not run, and
/// what would end the process ends it with status 1.
#[test]
fn a_machine_without_its_control_thread_has_failed() {
    let shop = Shop::new();
    let slot = Arc::new(Slot::default());
    let machine = Machine {
        name: None,
        options: options::Options {
            config: Some(shop.config("mill-1")),
            ..options::Options::default()
        },
        proven_within: Duration::from_secs(4),
    };
    let mut turns = 0;
    let mut turn = |service: &mut Service| {
        service.turn();
        turns += 1;
        if turns == 20 {
            // As good as dead: it is told to end at once.
            service.stop(&mut || true);
        }
    };
    machine.run(None, &slot, &mut turn);
    assert_eq!(turns, 20, "it is noticed at once");
    let Phase::Failed(failure) = slot.phase() else {
        panic!("it has not failed");
    };
    assert_eq!(failure.status, 1);
    let told = "the control thread has ended by itself";
    assert!(failure.what.contains(told), "{}", failure.what);
}

/// A fault of the program in the service of one machine, which is injected here: its correction goes out by its ramp, the others
/// notice nothing, and it can be started again without them.
#[test]
fn a_fault_of_the_program_in_one_machine_ramps_that_one_out() {
    let shop = Shop::new();
    let slots = NAMES.map(|_| Arc::new(Slot::default()));
    let faulty = AtomicBool::new(false);
    std::thread::scope(|scope| {
        // Where something below fails, the machines end all the same.
        let _end = EndsAll(&slots);
        for (name, slot) in NAMES.iter().zip(&slots) {
            let machine = Machine {
                name: Some((*name).to_owned()),
                options: options::Options {
                    config: Some(shop.config(name)),
                    ..options::Options::default()
                },
                proven_within: Duration::from_secs(4),
            };
            let faulty = &faulty;
            scope.spawn(move || {
                let mut turn = |service: &mut Service| {
                    let is_here = machine.name.as_deref() == Some("mill-2");
                    assert!(
                        !(is_here && faulty.swap(false, Ordering::Relaxed)),
                        "injected"
                    );
                    service.turn();
                };
                machine.run(None, slot, &mut turn);
            });
        }
        let state = |number: usize| match slots[number].phase() {
            Phase::Running(live) => live.published.latest().state.name(),
            Phase::Failed(_) => "failed",
            _ => "on its way",
        };
        let count = |number: usize| match slots[number].phase() {
            Phase::Running(live) => live.published.latest().cycle.count,
            _ => 0,
        };
        let all = || (0..3).all(|n| state(n) == "compensating" && shop.shifts(n) == CORRECTED);
        until("all compensate", PATIENCE, all);
        let proofs = slots[0].life().proofs();
        let before = [0, 2].map(count);
        faulty.store(true, Ordering::Relaxed);
        let others_go_on = || {
            assert!(
                [0, 2].iter().all(|n| is_undisturbed(Some(state(*n)))),
                "{} and {}",
                state(0),
                state(2)
            );
        };
        until("mill-2 is out", PATIENCE, || {
            others_go_on();
            state(1) == "failed"
        });
        assert_eq!(
            shop.shifts(1),
            [0.0; 3],
            "ramped out before it was given up"
        );
        until("the others compensate, cycle after cycle", PATIENCE, || {
            others_go_on();
            let counts = [0, 2].map(count).into_iter().zip(before);
            counts.into_iter().all(|(now, before)| now > before + 100)
                && [0, 2]
                    .iter()
                    .all(|n| state(*n) == "compensating" && shop.shifts(*n) == CORRECTED)
                && slots[0].life().proofs() > proofs + 1
        });
        let audit = std::fs::read_to_string(shop.dir.path().join("mill-2/audit/audit.log"));
        assert!(audit.expect("a log").contains("\"what\":\"failed\""));
        // Not by itself, since the fault would come again; a person asks for it.
        slots[1].reload();
        until("mill-2 is back", PATIENCE, || {
            others_go_on();
            state(1) == "compensating" && shop.shifts(1) == CORRECTED
        });
    });
    assert!(
        slots
            .iter()
            .all(|slot| matches!(slot.phase(), Phase::Ended))
    );
    assert_eq!([0, 1, 2].map(|number| shop.shifts(number)), [[0.0; 3]; 3]);
}

/// One whose configuration is wrong and one whose socket is taken: told, started as soon as that is mended, and the status of
/// the end.
#[test]
fn a_machine_that_cannot_start_keeps_no_other_from_starting() {
    let shop = Shop::new();
    let config = |name: &str| shop.config(name);
    let taken = TcpListener::bind("127.0.0.1:0").expect("loopback");
    let address = taken.local_addr().expect("bound");
    change(&config("mill-3"), "127.0.0.1:0", &address.to_string());
    change(&config("mill-2"), "limit_um = 150.0", "limit_um = -1.0");
    let refused = said(&check(&shop.file, &[]));
    assert_eq!(refused.2, Some(2), "{}", refused.1);
    assert!(refused.1.contains("machine mill-2: ") && refused.1.contains("guard.limit_um"));
    let mut program = shop.start();
    all_compensate(&program, &["mill-1"]);
    let failed = |name: &str| wait_for(&program, name, "does not run", |m| m["phase"] == "failed");
    let told = failed("mill-2");
    assert_eq!(told["state"], "unknown");
    assert_eq!(told["starts_again"], false, "files do not mend themselves");
    assert!(
        told["trouble"].to_string().contains("guard.limit_um"),
        "{told}"
    );
    let told = failed("mill-3");
    assert_eq!(told["starts_again"], true);
    assert!(
        told["trouble"].to_string().contains(&address.to_string()),
        "{told}"
    );
    assert!(
        program
            .log()
            .contains("machine{name=\"mill-2\"}: does not run: ")
    );
    // Mended, and read again.
    change(&config("mill-2"), "limit_um = -1.0", "limit_um = 150.0");
    program.signal("HUP");
    all_compensate(&program, &["mill-2"]);
    assert_eq!(glance(&program, "mill-1")["state"], "compensating");
    program.signal("TERM");
    assert_eq!(program.end(), Some(1), "mill-3 did not run");
    let log = program.log();
    assert!(log.contains("error: machine mill-3: "), "{log}");
    assert_eq!([0, 1].map(|number| shop.shifts(number)), [[0.0; 3]; 2]);
    // The socket is free: by itself, after some seconds.
    let program = shop.start();
    failed_of(&program, "mill-3");
    drop(taken);
    all_compensate(&program, &NAMES);
}

fn failed_of(program: &Program, name: &str) {
    wait_for(program, name, "does not run", |m| m["phase"] == "failed");
}

/// Where none can start there is nothing that would be disturbed: the program ends, and its service is started again.
#[test]
fn where_no_machine_can_start_the_program_ends() {
    let shop = Shop::new();
    for name in NAMES {
        let config = shop.config(name);
        change(&config, "limit_um = 150.0", "limit_um = -1.0");
    }
    let ended = Command::new(env!("CARGO_BIN_EXE_volcomp-gateway"))
        .args(["--config", path(&shop.file)])
        .output()
        .expect("built");
    let (_, errors, status) = said(&ended);
    assert_eq!(status, Some(2), "{errors}");
    for name in NAMES {
        assert!(errors.contains(&format!("machine {name}: ")), "{errors}");
    }
}

/// Two machines of one process at one barrier, by addresses of which nobody can know that they lead to one control: only one
/// of them corrects. Before, both had the owner number of the process.
#[test]
fn a_barrier_tells_two_machines_of_one_process_apart() {
    let dir = tempfile::tempdir().expect("writable");
    let control = control_with_barrier();
    let port = control.address().port();
    for (name, host) in [("mill-1", [127, 0, 0, 1]), ("mill-2", [127, 0, 0, 2])] {
        let config = machine(dir.path(), name, SocketAddr::from((host, port)));
        change(&config, WORDS, BARRIER);
    }
    let file = shop_file(dir.path(), &["mill-1", "mill-2"]);
    let program = Program::start(dir.path(), &["--config", path(&file)]);
    let both = || ["mill-1", "mill-2"].map(|name| glance(&program, name));
    let corrects = |machine: &Value| machine["state"] == "compensating";
    let is_refused = |machine: &Value| {
        // Disarmed, or faulted where both began at the same moment.
        (machine["state"] == "disarmed" || machine["state"] == "faulted")
            && machine["reasons"].to_string().contains("another gateway")
    };
    let is_told = || {
        let both = both();
        both.iter().any(corrects) && both.iter().any(is_refused)
    };
    let end = Instant::now() + PATIENCE;
    while !is_told() {
        assert!(Instant::now() < end, "{:?}\n{}", both(), program.log());
        std::thread::sleep(Duration::from_millis(20));
    }
    let [one, other] = ["mill-1", "mill-2"].map(|name| cycles(&program, name));
    until("it stays so", PATIENCE, || {
        let both = both();
        assert!(!both.iter().all(corrects), "{both:?}");
        is_told()
            && cycles(&program, "mill-1") > one + 500
            && cycles(&program, "mill-2") > other + 500
    });
}

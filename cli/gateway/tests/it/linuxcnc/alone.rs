//! Whether a test of LinuxCNC goes on here, and how it has the computer's LinuxCNC for itself.

use std::{
    path::Path,
    process::Command,
    sync::{Mutex, MutexGuard, PoisonError},
};

use volcomp_test_support::peers;

/// What a test that has namespaces of its own finds in its environment.
pub(crate) const ALONE: &str = "VOLCOMP_ALONE";

/// Whether a LinuxCNC can be started here at all.
pub(crate) fn is_there() -> bool {
    let there = Path::new("/usr/bin/linuxcnc").exists();
    if !there {
        peers::not_run("linuxcnc-uspace");
    }
    there
}

/// Runs each test with both bridges, in namespaces of their own.
macro_rules! with_both {
    ($module:ident: $($name:ident),* $(,)?) => {
        mod user {
            $(#[test]
            fn $name() {
                let name = concat!(stringify!($module), "::user::", stringify!($name));
                if let Some(_alone) = crate::linuxcnc::alone::alone(name) {
                    super::$name(crate::linuxcnc::peer::Bridge::User);
                }
            })*
        }
        mod servo {
            $(#[test]
            fn $name() {
                let name = concat!(stringify!($module), "::servo::", stringify!($name));
                if crate::linuxcnc::alone::can_build()
                    && let Some(_alone) = crate::linuxcnc::alone::alone(name)
                {
                    super::$name(crate::linuxcnc::peer::Bridge::Servo);
                }
            })*
        }
    };
}
pub(crate) use with_both;

/// Whether a component can be built, and put beside those of LinuxCNC for the time of a test.
pub(crate) fn can_build() -> bool {
    if !Path::new("/usr/bin/halcompile").exists() {
        peers::not_run("linuxcnc-uspace-dev");
        return false;
    }
    let is_root = rustix::process::geteuid().is_root();
    if !is_root {
        eprintln!("not run: only root can put a component beside those of LinuxCNC");
    }
    is_root
}

/// One LinuxCNC at a time: its servo thread has what there is of real time.
static ONE: Mutex<()> = Mutex::new(());

/// For as long as a test has the computer's only LinuxCNC, or one in namespaces of its own.
pub(crate) struct Alone {
    _one: Option<MutexGuard<'static, ()>>,
}

/// Whether the test of this name goes on. Two LinuxCNC on one computer share their memory, and the one that ends first kills
/// the programs of the other, which it knows by their names: so, as root, a test is started once more in namespaces of its
/// own, which end with it, and its end is that of the one here.
pub(crate) fn alone(name: &str) -> Option<Alone> {
    if !is_there() {
        return None;
    }
    if std::env::var_os(ALONE).is_some() {
        return Some(Alone { _one: None });
    }
    // What a test that failed had is free again.
    let one = ONE.lock().unwrap_or_else(PoisonError::into_inner);
    if !rustix::process::geteuid().is_root() {
        // Nobody else may have one then.
        return Some(Alone { _one: Some(one) });
    }
    for tried in 1.. {
        let (succeeds, told) = inside(name);
        if succeeds {
            break;
        }
        let again = tried < TRIES && told.contains(STANDS);
        assert!(again, "in namespaces of its own it fails");
        println!("LinuxCNC itself stood still, see above: the test is started again");
    }
    None
}

/// How often a test is started in which LinuxCNC itself stands still. What a test finds wrong of ours ends it the first time.
const TRIES: usize = 3;

/// What the user interface says when LinuxCNC does not do what it was asked for, and nothing moves. Without a real-time kernel
/// it does that on a busy computer.
const STANDS: &str = "LinuxCNC stands:";

/// Runs the test of this name in namespaces of its own: whether it succeeds, and what it told.
fn inside(name: &str) -> (bool, String) {
    let inside = std::env::current_exe().expect("this program");
    let output = Command::new("unshare")
        .args(["--ipc", "--net", "--pid", "--fork", "--kill-child"])
        .args(["--mount-proc", "sh", "-c"])
        .arg("ip link set lo up && exec \"$@\" 2>&1")
        .arg("sh")
        .arg(inside)
        .args(["--exact", &format!("linuxcnc::{name}"), "--nocapture"])
        .env(ALONE, "1")
        .output()
        .expect("unshare of util-linux");
    let told = String::from_utf8_lossy(&output.stdout).into_owned();
    println!("{told}");
    (output.status.success(), told)
}

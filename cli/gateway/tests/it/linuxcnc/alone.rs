//! Checks whether a LinuxCNC test can run on this computer, and isolates its LinuxCNC.

use std::{
    os::unix::fs::PermissionsExt as _,
    path::Path,
    process::Command,
    sync::{Mutex, OnceLock, PoisonError},
};

use tempfile::TempDir;
use volcomp_test_support::{peers, root};

use super::peer::HERE;

/// The folder of LinuxCNC's components.
const MODULES: &str = "/usr/lib/linuxcnc/modules";

/// The start script of LinuxCNC.
const LINUXCNC: &str = "/usr/bin/linuxcnc";
/// Line of the start script that names the lock file of a running LinuxCNC.
const RUNS: &str = "LOCKFILE=/tmp/linuxcnc.lock\n";

/// Environment variable that names a folder with LinuxCNC's components, the bridge and the start script.
const WITH_BRIDGE: &str = "VOLCOMP_MODULES";

/// Declares tests that run with an isolated LinuxCNC.
macro_rules! alone {
    ($module:ident: $($name:ident),* $(,)?) => {
        mod on_linuxcnc {
            $(#[test]
            fn $name() {
                let name = concat!(stringify!($module), "::on_linuxcnc::", stringify!($name));
                if crate::linuxcnc::alone::goes_on(name) {
                    super::$name();
                }
            })*
        }
    };
}
pub(crate) use alone;

fn can_start() -> bool {
    for (file, package) in
        [(LINUXCNC, "linuxcnc-uspace"), ("/usr/bin/halcompile", "linuxcnc-uspace-dev")]
    {
        if !Path::new(file).exists() {
            peers::not_run(package);
            return false;
        }
    }
    let is_root = rustix::process::geteuid().is_root();
    if !is_root {
        eprintln!("not run: only root can place the bridge among the components of LinuxCNC");
    }
    is_root
}

/// The folder for [`WITH_BRIDGE`], built once per run.
static WITH_BRIDGE_BUILT: OnceLock<TempDir> = OnceLock::new();

/// Slots for running LinuxCNC. Each slot runs one at a time, because its servo thread needs processor time.
static PLACES: [Mutex<()>; 2] = [const { Mutex::new(()) }; 2];

fn run(command: &mut Command) {
    let output = command.output().expect("a program of the system");
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(output.status.success(), "{command:?}: {said}");
}

fn build() -> TempDir {
    let dir = tempfile::tempdir().expect("writable");
    let modules = dir.path().join("modules");
    run(Command::new("cp").args(["-a", MODULES]).arg(&modules));
    let component = root().join("drivers/linuxcnc/bridge/volcomp.comp");
    std::fs::copy(component, modules.join("volcomp.comp")).expect("writable");
    run(Command::new("halcompile").args(["--compile", "volcomp.comp"]).current_dir(&modules));
    let script = std::fs::read_to_string(LINUXCNC).expect("a script");
    assert!(script.contains(RUNS), "another file says that it runs");
    let own = script.replace(RUNS, &format!("LOCKFILE=\"${HERE}/lock\"\n"));
    let file = dir.path().join("linuxcnc");
    std::fs::write(&file, own).expect("writable");
    let runs = std::fs::Permissions::from_mode(0o755);
    std::fs::set_permissions(&file, runs).expect("ours");
    dir
}

/// True if this process runs the test itself.
///
/// Two LinuxCNC on one computer share memory and lock file, and the first to end kills the programs of the other by
/// name. This function therefore starts each test again in separate namespaces, in which it returns true. In the outer
/// process it returns false after the test has passed there, or if LinuxCNC cannot be started, and panics if the test
/// has failed.
pub(crate) fn goes_on(name: &str) -> bool {
    if let Some(folder) = std::env::var_os(WITH_BRIDGE) {
        for (own, of_all) in [("modules", MODULES), ("linuxcnc", LINUXCNC)] {
            let own = Path::new(&folder).join(own);
            run(Command::new("mount").arg("--bind").arg(own).arg(of_all));
        }
        return true;
    }
    if !can_start() {
        return false;
    }
    let free = PLACES.iter().find_map(|place| place.try_lock().ok());
    // A failed test has also released its slot, so ignore poisoning.
    let _place = free.unwrap_or_else(|| PLACES[0].lock().unwrap_or_else(PoisonError::into_inner));
    let folder = WITH_BRIDGE_BUILT.get_or_init(build).path();
    for tried in 1.. {
        let (succeeds, reported) = inside(name, folder);
        if succeeds {
            break;
        }
        let again = tried < TRIES && reported.contains(STANDS);
        assert!(again, "in separate namespaces it fails");
        println!("LinuxCNC itself stood still, see above: the test is started again");
    }
    false
}

/// Maximum number of attempts of a test in which LinuxCNC itself stalls. Any other failure ends the test at its first
/// attempt.
const TRIES: usize = 3;

/// Message of the user interface if LinuxCNC ignores a command and nothing moves, as on a busy computer without a real-time kernel.
const STANDS: &str = "LinuxCNC stands:";

/// Runs the test in separate namespaces. Returns its success and its output.
fn inside(name: &str, folder: &Path) -> (bool, String) {
    let inside = std::env::current_exe().expect("this program");
    let output = Command::new("unshare")
        .args(["--ipc", "--net", "--pid", "--fork", "--kill-child"])
        .args(["--mount-proc", "sh", "-c"])
        .arg("ip link set lo up && exec \"$@\" 2>&1")
        .arg("sh")
        .arg(inside)
        .args(["--exact", &format!("linuxcnc::{name}"), "--nocapture"])
        .env(WITH_BRIDGE, folder)
        .output()
        .expect("unshare of util-linux");
    let reported = String::from_utf8_lossy(&output.stdout).into_owned();
    println!("{reported}");
    (output.status.success(), reported)
}

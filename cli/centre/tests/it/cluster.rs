//! A PostgreSQL of its own for tests: a cluster in a temporary folder, on a Unix socket, ended with the last test that uses it.

use std::{
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    sync::{
        Arc, Mutex, PoisonError, Weak,
        atomic::{AtomicU32, Ordering},
    },
    time::{Duration, Instant},
};

/// Where Debian has the programs of the server, the newest first.
const PROGRAMS: [&str; 3] = [
    "/usr/lib/postgresql/17/bin",
    "/usr/lib/postgresql/16/bin",
    "/usr/lib/postgresql/15/bin",
];
/// The user that the server runs as where the tests run as root, which it refuses.
const USER: &str = "postgres";
/// The role of the tests.
pub(crate) const ROLE: &str = "volcomp";
/// Starting, recovering and ending are done within this time, on the slowest machine.
const LONG: Duration = Duration::from_secs(120);

/// A cluster and its server.
pub(crate) struct Cluster {
    folder: tempfile::TempDir,
    programs: &'static Path,
    settings: Vec<String>,
    server: Mutex<Option<Child>>,
    databases: AtomicU32,
}

/// The cluster that the tests of one process share.
static SHARED: Mutex<Weak<Cluster>> = Mutex::new(Weak::new());

impl Cluster {
    /// The cluster that all tests share; `None` where PostgreSQL is not installed.
    pub(crate) fn shared() -> Option<Arc<Self>> {
        let mut shared = SHARED.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(cluster) = shared.upgrade() {
            return Some(cluster);
        }
        let cluster = Arc::new(Self::new(&[])?);
        *shared = Arc::downgrade(&cluster);
        Some(cluster)
    }

    /// A cluster of one's own, with settings for its server (`name=value`).
    pub(crate) fn new(settings: &[&str]) -> Option<Self> {
        let mut programs = PROGRAMS.iter().map(Path::new);
        let programs = programs.find(|folder| folder.join("initdb").is_file())?;
        let folder = tempfile::Builder::new().prefix("pg").tempdir().unwrap();
        let cluster = Self {
            folder,
            programs,
            settings: settings.iter().map(|one| (*one).to_owned()).collect(),
            server: Mutex::new(None),
            databases: AtomicU32::new(0),
        };
        let path = cluster.socket();
        if is_root() {
            run(Command::new("chown").arg(USER).arg(path));
        }
        run(cluster
            .program("initdb")
            .args(["--username", ROLE, "--auth", "trust", "--encoding", "UTF8"])
            // A language in which hyphens do not count, so that a test sees whether its order matters.
            .args([
                "--locale-provider",
                "icu",
                "--icu-locale",
                "en-u-ka-shifted",
            ])
            .args(["--locale", "C.UTF-8", "--no-sync", "-D"])
            .arg(cluster.data()));
        cluster.start();
        Some(cluster)
    }

    /// The folder of the socket.
    pub(crate) fn socket(&self) -> &Path {
        self.folder.path()
    }

    /// The folder of the cluster.
    pub(crate) fn data(&self) -> PathBuf {
        self.folder.path().join("data")
    }

    /// A program of PostgreSQL, as the user who may.
    fn program(&self, name: &str) -> Command {
        let program = self.programs.join(name);
        let mut command = if is_root() {
            // It becomes the program, so that its process is ours to end.
            let mut command = Command::new("setpriv");
            command
                .args(["--reuid", USER, "--regid", USER, "--clear-groups"])
                .arg(program);
            command
        } else {
            Command::new(program)
        };
        command.current_dir(self.socket()).env("LC_ALL", "C.UTF-8");
        command
    }

    /// Starts the server, and waits until it takes connections.
    pub(crate) fn start(&self) {
        let log = std::fs::File::options()
            .create(true)
            .append(true)
            .open(self.socket().join("log"))
            .unwrap();
        let mut command = self.program("postgres");
        command.arg("-D").arg(self.data()).arg("-k");
        command.arg(self.socket());
        let listens = self
            .settings
            .iter()
            .any(|one| one.starts_with("listen_addresses"));
        if !listens {
            command.args(["-c", "listen_addresses="]);
        }
        for setting in &self.settings {
            command.args(["-c", setting]);
        }
        let server = command.stdout(Stdio::null()).stderr(log).spawn().unwrap();
        *self.server() = Some(server);
        let end = Instant::now() + LONG;
        loop {
            let ready = Command::new(self.programs.join("pg_isready"))
                .args(["-q", "-h"])
                .arg(self.socket())
                .args(["-p", self.port()])
                .status();
            if ready.unwrap().success() {
                return;
            }
            let ended = self.server().as_mut().unwrap().try_wait().unwrap();
            assert!(
                ended.is_none() && Instant::now() < end,
                "{}",
                std::fs::read_to_string(self.socket().join("log")).unwrap_or_default()
            );
            std::thread::sleep(Duration::from_millis(50));
        }
    }

    fn port(&self) -> &str {
        let mut port = self.settings.iter();
        port.find_map(|one| one.strip_prefix("port="))
            .unwrap_or("5432")
    }

    fn server(&self) -> std::sync::MutexGuard<'_, Option<Child>> {
        self.server.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Ends the server as `pg_ctl stop -m immediate` does: as a crash.
    pub(crate) fn crash(&self) {
        self.end("QUIT");
    }

    fn end(&self, signal: &str) {
        let Some(mut server) = self.server().take() else {
            return;
        };
        let _ = Command::new("kill")
            .args([&format!("-{signal}"), &server.id().to_string()])
            .status();
        let _ = server.wait();
    }

    /// A new, empty database: its name.
    pub(crate) fn database(&self) -> String {
        let number = self.databases.fetch_add(1, Ordering::Relaxed);
        let name = format!("test_{number}");
        self.execute("postgres", &format!("CREATE DATABASE {name}"));
        name
    }

    /// How a database is reached.
    pub(crate) fn connection(&self, database: &str) -> String {
        format!(
            "host={} port={} user={ROLE} dbname={database}",
            self.socket().display(),
            self.port()
        )
    }

    /// Executes statements in a database, past the store: what is printed, one line a row.
    pub(crate) fn execute(&self, database: &str, sql: &str) -> String {
        let mut psql = Command::new(self.programs.join("psql"));
        psql.args(["-X", "-q", "-A", "-t", "-v", "ON_ERROR_STOP=1", "-h"])
            .arg(self.socket())
            .args(["-p", self.port(), "-U", ROLE, "-d", database, "-c", sql]);
        run(&mut psql)
    }
}

impl Drop for Cluster {
    fn drop(&mut self) {
        self.end("QUIT");
    }
}

fn is_root() -> bool {
    run(Command::new("id").arg("-u")).trim() == "0"
}

fn run(command: &mut Command) -> String {
    let output = command.output();
    let output = output.unwrap_or_else(|error| panic!("{command:?}: {error}"));
    assert!(
        output.status.success(),
        "{command:?}: {}{}",
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr)
    );
    String::from_utf8_lossy(&output.stdout).into_owned()
}

//! A `nats-server` as a child process: for tests, and for a centre that brings its own.

use std::{
    ffi::OsStr,
    io::{self, Write},
    net::TcpStream,
    os::unix::fs::{MetadataExt, OpenOptionsExt, fchown},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use crate::{NoConfiguration, ServerSettings};

/// Where Debian puts the server, which is not in the path of every user.
const ON_DEBIAN: &str = "/usr/sbin/nats-server";
/// A server that is not ready after so long is told as one that does not start.
const READY_WITHIN: Duration = Duration::from_secs(30);

/// Why a server does not run.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// The settings make no configuration.
    #[error(transparent)]
    Configuration(#[from] NoConfiguration),
    #[error("nats-server is not installed: on Debian `apt install nats-server`")]
    NotInstalled,
    /// A file or a process.
    #[error("nats-server: {0}")]
    Io(#[from] io::Error),
    /// It ended, or does not listen.
    #[error("nats-server does not listen on {listen}; what it says stands in {log}")]
    NotReady { listen: String, log: String },
}

/// A running server. It ends when this is dropped.
#[derive(Debug)]
pub struct Server {
    child: Child,
    listen: String,
    configuration: PathBuf,
}

/// The program, where it is installed.
pub fn program() -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders = std::env::split_paths(&path).map(|folder| folder.join("nats-server"));
    folders
        .chain([PathBuf::from(ON_DEBIAN)])
        .find(|file| file.is_file())
}

/// Writes a configuration, which may hold the password of a cluster, in the place of the one before: only its owner can read
/// it. One that another user owns (the one as which the server runs) stays that user's.
///
/// # Errors
/// It cannot be written.
pub fn write_private(file: &Path, text: &str) -> io::Result<()> {
    let mut beside = file.as_os_str().to_owned();
    beside.push(".new");
    let beside = PathBuf::from(beside);
    match std::fs::remove_file(&beside) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
        _ => {}
    }
    let mut written = std::fs::OpenOptions::new()
        .write(true)
        .create_new(true)
        .mode(0o600)
        .open(&beside)?;
    if let Ok(before) = std::fs::metadata(file) {
        fchown(&written, Some(before.uid()), Some(before.gid()))?;
    }
    written.write_all(text.as_bytes())?;
    written.sync_all()?;
    std::fs::rename(&beside, file)
}

impl Server {
    /// Starts a server with its configuration and its log in `folder`, and waits until it listens.
    ///
    /// # Errors
    /// Why it does not run.
    pub fn start(settings: &ServerSettings, folder: &Path) -> Result<Self, ServerError> {
        let server = Self::spawn(settings, folder)?;
        server.ready(folder)
    }

    /// Starts a server of a cluster, which is ready only when the others run too.
    ///
    /// # Errors
    /// Why it does not run.
    pub fn spawn(settings: &ServerSettings, folder: &Path) -> Result<Self, ServerError> {
        let program = program().ok_or(ServerError::NotInstalled)?;
        let configuration = folder.join("nats.conf");
        write_private(&configuration, &settings.text()?)?;
        let child = Command::new(program)
            .args([OsStr::new("-c"), configuration.as_os_str()])
            .args([OsStr::new("-l"), folder.join("nats.log").as_os_str()])
            .stdin(Stdio::null())
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()?;
        Ok(Self {
            child,
            listen: settings.listen.clone(),
            configuration,
        })
    }

    fn ready(mut self, folder: &Path) -> Result<Self, ServerError> {
        let end = Instant::now() + READY_WITHIN;
        while TcpStream::connect(&self.listen).is_err() {
            if Instant::now() > end || self.child.try_wait()?.is_some() {
                return Err(ServerError::NotReady {
                    listen: self.listen.clone(),
                    log: folder.join("nats.log").display().to_string(),
                });
            }
            std::thread::sleep(Duration::from_millis(20));
        }
        Ok(self)
    }

    /// The address of the server as clients have it.
    pub fn url(&self) -> String {
        format!("nats://{}", self.listen)
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Writes other settings (users, that is) and has the server take them over.
    ///
    /// # Errors
    /// The settings make no configuration, or the server does not take them.
    pub fn reload(&self, settings: &ServerSettings) -> Result<(), ServerError> {
        let program = program().ok_or(ServerError::NotInstalled)?;
        write_private(&self.configuration, &settings.text()?)?;
        let told = Command::new(program)
            .arg("--signal")
            .arg(format!("reload={}", self.child.id()))
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status()?;
        if told.success() {
            Ok(())
        } else {
            Err(io::Error::other("it does not take the signal to reload").into())
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // It ended by itself, or it ends now: nothing else can be done here.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

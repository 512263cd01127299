//! A `nats-server` child process, for tests and for a centre that runs its own server.

use std::{
    ffi::OsStr,
    io::{self, Write},
    net::TcpStream,
    os::unix::fs::{MetadataExt, OpenOptionsExt, fchown},
    path::{Path, PathBuf},
    process::{Child, Command, Stdio},
    time::{Duration, Instant},
};

use crate::{ServerConfigError, ServerSettings};

const DEBIAN_PATH: &str = "/usr/sbin/nats-server";
const START_TIMEOUT: Duration = Duration::from_secs(30);

#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// The settings do not give a valid configuration.
    #[error(transparent)]
    Configuration(#[from] ServerConfigError),
    #[error("nats-server is not installed: on Debian `apt install nats-server`")]
    NotInstalled,
    #[error("nats-server: {0}")]
    Io(#[from] io::Error),
    /// The server has exited, or does not listen.
    #[error("nats-server does not listen on {listen}; see its log {log}")]
    NotReady { listen: String, log: String },
}

/// A running server, terminated when dropped.
#[derive(Debug)]
pub struct Server {
    child: Child,
    listen: String,
    configuration: PathBuf,
}

/// Path of `nats-server`; `None` if it is not installed.
pub fn program() -> Option<PathBuf> {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let folders = std::env::split_paths(&path).map(|folder| folder.join("nats-server"));
    folders.chain([PathBuf::from(DEBIAN_PATH)]).find(|file| file.is_file())
}

/// Replaces a configuration file. Only the owner can read the file, because it may contain a cluster password. If the
/// file belongs to another user, such as the user of the server, it keeps its owner.
///
/// # Errors
/// The file cannot be written.
pub fn write_private(file: &Path, text: &str) -> io::Result<()> {
    let mut new_file = file.as_os_str().to_owned();
    new_file.push(".new");
    let new_file = PathBuf::from(new_file);
    match std::fs::remove_file(&new_file) {
        Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
        _ => {}
    }
    let mut written =
        std::fs::OpenOptions::new().write(true).create_new(true).mode(0o600).open(&new_file)?;
    if let Ok(before) = std::fs::metadata(file) {
        fchown(&written, Some(before.uid()), Some(before.gid()))?;
    }
    written.write_all(text.as_bytes())?;
    written.sync_all()?;
    std::fs::rename(&new_file, file)
}

impl Server {
    /// Starts a server with its configuration and its log in `folder`, and waits until it listens.
    ///
    /// # Errors
    /// The server does not start or does not listen.
    pub fn start(settings: &ServerSettings, folder: &Path) -> Result<Self, ServerError> {
        let server = Self::spawn(settings, folder)?;
        server.ready(folder)
    }

    /// Starts a server of a cluster, which becomes ready only when the other servers run too.
    ///
    /// # Errors
    /// The server does not start.
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
        Ok(Self { child, listen: settings.listen.clone(), configuration })
    }

    fn ready(mut self, folder: &Path) -> Result<Self, ServerError> {
        let end = Instant::now() + START_TIMEOUT;
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

    pub fn url(&self) -> String {
        format!("nats://{}", self.listen)
    }

    pub fn id(&self) -> u32 {
        self.child.id()
    }

    /// Writes changed settings (such as users) and makes the server reload them.
    ///
    /// # Errors
    /// The settings do not give a valid configuration, or the server rejects it.
    pub fn reload(&self, settings: &ServerSettings) -> Result<(), ServerError> {
        let program = program().ok_or(ServerError::NotInstalled)?;
        write_private(&self.configuration, &settings.text()?)?;
        let reload = Command::new(program)
            .arg("--signal")
            .arg(format!("reload={}", self.child.id()))
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .status()?;
        if reload.success() {
            Ok(())
        } else {
            Err(io::Error::other("it rejected the reload signal").into())
        }
    }
}

impl Drop for Server {
    fn drop(&mut self) {
        // The process may have exited already, and `drop` cannot return an error.
        let _ = self.child.kill();
        let _ = self.child.wait();
    }
}

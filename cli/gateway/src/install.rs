//! `service install`: program, units, groups and folders of the systemd service, as the Debian package installs them.

use std::{
    fs::{self, OpenOptions},
    io::{self, Write},
    os::unix::fs::{OpenOptionsExt, PermissionsExt},
    path::{Path, PathBuf},
    process::Command,
};

use crate::error::GatewayError;

const UNIT: &str = include_str!("../debian/volcomp-gateway.service");
const TEMPLATE: &str = include_str!("../debian/volcomp-gateway@.service");
const RULES: &str = include_str!("../debian/90-volcomp-gpio.rules");
const TOKENS: &str = include_str!("../debian/tokens");
/// Groups of the service; systemd allocates its user (`DynamicUser`).
const GROUPS: &str = "g dialout -\ng gpio -\n";

/// Path of the program in the packaged units.
const PACKAGED: &str = "/usr/bin/volcomp-gateway";
const PROGRAM: &str = "/usr/local/bin/volcomp-gateway";

/// The commands of `service`.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum ServiceCommand {
    /// Install the systemd service: program, units, groups and folders
    ///
    /// Without --yes nothing is changed, and what would be done is printed. Files of the user are kept: configuration and
    /// tokens.
    #[command(after_help = "Examples:
  volcomp-gateway service install                     what would be done
  sudo volcomp-gateway service install --yes          one machine: /etc/volcomp/gateway.toml
  sudo volcomp-gateway service install mill-1 --yes   one of several: /etc/volcomp/mill-1/gateway.toml")]
    Install(InstallArguments),
}

/// Options of `service install`.
#[derive(Clone, Debug, clap::Args)]
pub struct InstallArguments {
    /// Name of the machine, if this computer runs several gateways
    name: Option<String>,
    /// Change the system, instead of printing what would change
    #[arg(long)]
    yes: bool,
    /// Folder that takes the place of /; no command is run there
    #[arg(long, value_name = "FOLDER", default_value = "/")]
    root: PathBuf,
}

enum Step {
    Folder(PathBuf),
    File {
        path: PathBuf,
        content: Vec<u8>,
        mode: u32,
    },
    /// A file that is kept if it exists.
    NewFile(PathBuf, &'static str),
    Run(&'static str, &'static [&'static str]),
}

/// Installs the service with `--yes`; otherwise only returns the steps.
///
/// # Errors
/// The name is invalid, the user is not root, or a step fails.
pub fn install(arguments: &InstallArguments) -> Result<String, GatewayError> {
    let steps = arguments.steps()?;
    let is_system = arguments.root == Path::new("/");
    if arguments.yes && is_system && !rustix::process::geteuid().is_root() {
        return Err(GatewayError::invalid(
            "service install --yes changes the system, expected root: sudo volcomp-gateway service install --yes",
        ));
    }
    let mut text = String::new();
    for step in &steps {
        if matches!(step, Step::Run(..)) && !is_system {
            continue;
        }
        let what = step.text();
        if arguments.yes {
            step.perform().map_err(|e| GatewayError::system(what.clone(), e))?;
        }
        text.extend([&*what, "\n"]);
    }
    let (folder, unit) = arguments.names();
    let next = if arguments.yes {
        format!(
            "Next: volcomp-gateway init {folder}/gateway.toml, then systemctl enable --now {unit}\n"
        )
    } else {
        "Nothing is changed: --yes does it\n".to_owned()
    };
    Ok(text + &next)
}

impl InstallArguments {
    /// Folder of the configuration, and name of the unit.
    fn names(&self) -> (String, String) {
        match &self.name {
            None => ("/etc/volcomp".to_owned(), "volcomp-gateway".to_owned()),
            Some(name) => (format!("/etc/volcomp/{name}"), format!("volcomp-gateway@{name}")),
        }
    }

    fn steps(&self) -> Result<Vec<Step>, GatewayError> {
        // systemd escapes other characters in an instance name.
        let is_plain = |c: char| c.is_ascii_alphanumeric() || c == '-' || c == '_';
        if let Some(name) = &self.name
            && (name.is_empty() || name.starts_with('-') || !name.chars().all(is_plain))
        {
            return Err(GatewayError::invalid(format!(
                "NAME: found {name:?}, expected letters, digits, - and _"
            )));
        }
        let at = |path: &str| self.root.join(path.trim_start_matches('/'));
        let failed = |e| GatewayError::system("this program", e);
        let program = std::env::current_exe().map_err(failed)?;
        let mut steps = Vec::new();
        if program != Path::new(PACKAGED) {
            let file = |path: &str, content: &[u8], mode| Step::File {
                path: at(path),
                content: content.to_owned(),
                mode,
            };
            let unit = |text: &str| text.replace(PACKAGED, PROGRAM).into_bytes();
            let folder = "/etc/systemd/system";
            steps.extend([
                file(PROGRAM, &fs::read(&program).map_err(failed)?, 0o755),
                file(&format!("{folder}/volcomp-gateway.service"), &unit(UNIT), 0o644),
                file(&format!("{folder}/volcomp-gateway@.service"), &unit(TEMPLATE), 0o644),
                file("/etc/sysusers.d/volcomp-gateway.conf", GROUPS.as_bytes(), 0o644),
                file("/etc/udev/rules.d/90-volcomp-gpio.rules", RULES.as_bytes(), 0o644),
                Step::Run("systemd-sysusers", &[]),
                Step::Run("udevadm", &["control", "--reload"]),
                Step::Run("systemctl", &["daemon-reload"]),
            ]);
        }
        let (folder, _) = self.names();
        steps.push(Step::Folder(at(&folder)));
        steps.push(Step::NewFile(at(&format!("{folder}/tokens")), TOKENS));
        Ok(steps)
    }
}

impl Step {
    fn text(&self) -> String {
        match self {
            Self::Folder(path) => format!("create the folder {}", path.display()),
            Self::File { path, mode, .. } => {
                let verb = if path.exists() { "replace" } else { "write" };
                format!("{verb} {}, mode {mode:04o}", path.display())
            }
            Self::NewFile(path, _) if path.exists() => format!("keep {}", path.display()),
            Self::NewFile(path, _) => format!("write {}, mode 0600", path.display()),
            Self::Run(program, arguments) => {
                format!("run {program} {}", arguments.join(" ")).trim_end().to_owned()
            }
        }
    }

    fn perform(&self) -> io::Result<()> {
        match self {
            Self::Folder(path) => fs::create_dir_all(path),
            Self::File { path, content, mode } => write(path, content, *mode),
            Self::NewFile(path, _) if path.exists() => Ok(()),
            Self::NewFile(path, text) => {
                crate::token::private_file(path)?.write_all(text.as_bytes())
            }
            Self::Run(program, arguments) => {
                let status = Command::new(program).args(*arguments).status()?;
                if status.success() { Ok(()) } else { Err(io::Error::other(status.to_string())) }
            }
        }
    }
}

/// Replaces a file by renaming a new one, because a running program cannot be overwritten.
fn write(path: &Path, content: &[u8], mode: u32) -> io::Result<()> {
    if let Some(folder) = path.parent() {
        fs::create_dir_all(folder)?;
    }
    let mut temporary = path.as_os_str().to_owned();
    temporary.push(".new");
    let placed = OpenOptions::new()
        .write(true)
        .create(true)
        .truncate(true)
        .mode(mode)
        .open(&temporary)
        .and_then(|mut file| {
            file.write_all(content)?;
            // Unlike `mode`, this call ignores the umask of the process.
            file.set_permissions(fs::Permissions::from_mode(mode))?;
            file.sync_all()?;
            fs::rename(&temporary, path)
        });
    if placed.is_err() {
        let _ = fs::remove_file(&temporary);
    }
    placed
}

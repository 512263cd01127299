//! The `volcomp-gateway` command: corrects a machine tool in real time.

use std::{
    io::Write as _,
    path::{Path, PathBuf},
    process::ExitCode,
};

use clap::{CommandFactory, Parser, Subcommand, ValueEnum};
use clap_complete::Shell;
use tracing_appender::non_blocking::{NonBlockingBuilder, WorkerGuard};
#[cfg(feature = "shdr")]
use volcomp_gateway::interop::shdr;
use volcomp_gateway::{
    check,
    client::{self, ArmArguments, RunningArguments},
    config::Config,
    documents,
    error::GatewayError,
    http::tls,
    init::{self, InitArguments},
    install::{self, ServiceCommand},
    options::Options,
    plan::Plan,
    print,
    rehearse::{self, Rehearsal},
    run, send_map,
    token::{self, TokenCommand},
};

const EXAMPLES: &str = "Examples:
  volcomp-gateway                                     a simulated machine on http://127.0.0.1:8080
  volcomp-gateway --config /etc/volcomp/gateway.toml  the machine of a configuration";
const INIT_EXAMPLES: &str = "Examples:
  volcomp-gateway init gateway.toml                   asks for the rest on a terminal
  volcomp-gateway init gateway.toml --machine mill.toml --control focas://192.0.2.10:8193 \\
      --sensors \"modbus://192.0.2.20?unit=1&profile=PTA8C04\" bed,column";
const ARM_EXAMPLES: &str = "Examples:
  volcomp-gateway arm --config gateway.toml --token-file tokens
  volcomp-gateway arm --token-file tokens --confirm sha256:5f2c…";
const CHECK_EXAMPLES: &str = "Examples:
  volcomp-gateway check gateway.toml                  what will be corrected, and within which limits
  volcomp-gateway check gateway.toml --json | jq .notes
  volcomp-gateway check gateway.toml --online         also compares with the controls";
const REHEARSE_EXAMPLES: &str = "Examples:
  volcomp-gateway rehearse gateway.toml > rehearsal.txt       every fault, to be filed
  volcomp-gateway rehearse gateway.toml --fault late_write    one fault alone
  volcomp-gateway rehearse gateway.toml --json | jq .passed";
const STATUS_EXAMPLES: &str = "Examples:
  volcomp-gateway status                              the gateway on http://127.0.0.1:8080
  volcomp-gateway status --config /etc/volcomp/gateway.toml --token-file viewer --json";
#[cfg(feature = "shdr")]
const SHDR_EXAMPLES: &str = "Examples:
  volcomp-gateway shdr-device gateway.toml > Devices.xml";
const SEND_MAP_EXAMPLES: &str = "Examples:
  volcomp-gateway send-map map-sender.toml            what would be sent, and its hash; nothing is opened
  volcomp-gateway send-map map-sender.toml --confirm 5f2c1b0a99d4e871
  volcomp-gateway send-map map-sender.toml --confirm 88d0… --replace    another one, while the first is in use";
const TLS_EXAMPLES: &str = "Examples:
  volcomp-gateway tls-init localhost 127.0.0.1
  volcomp-gateway tls-init gateway.shop.lan 192.0.2.30 --output /etc/volcomp";

/// Version with commit and date in released programs, see `.github/release`. A packaged crate has no repository to read them from.
const VERSION: &str = match option_env!("VOLCOMP_VERSION") {
    Some(version) => version,
    None => env!("CARGO_PKG_VERSION"),
};

/// Correct a machine tool in real time
///
/// Reads the position and the temperatures of a machine tool, computes its volumetric error, and writes the correction
/// back to the control under the rules of a guard. Shows what it does on a dashboard.
///
/// Without a configuration it simulates a machine. SIGHUP reads the configuration and the machine file again. SIGTERM
/// and SIGINT ramp the correction to zero and then end the program; a second signal ends it at once.
///
/// Exit status: 0 done, 1 the work failed, 2 the configuration or the call is wrong.
#[derive(Parser)]
#[command(version = VERSION, args_conflicts_with_subcommands = true, after_help = EXAMPLES)]
struct Arguments {
    #[command(flatten)]
    run: RunArguments,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(clap::Args)]
struct RunArguments {
    #[command(flatten)]
    options: Options,
    /// Simulate a machine, which is what happens without a configuration
    #[arg(long)]
    simulate: bool,
    /// The form of the log on standard error
    #[arg(long, value_enum, default_value_t = LogForm::Text)]
    log: LogForm,
}

#[derive(Clone, Copy, PartialEq, ValueEnum)]
enum LogForm {
    Text,
    Json,
}

#[derive(Subcommand)]
enum Command {
    /// Write a first configuration, commented, that passes `check`
    ///
    /// Asks on a terminal if --machine or --control is missing. Nothing is overwritten, and no device is opened.
    #[command(after_help = INIT_EXAMPLES)]
    Init(InitArguments),
    /// Check a configuration without opening a device, and print what it means
    #[command(after_help = CHECK_EXAMPLES)]
    Check {
        /// The TOML file of the configuration
        config: PathBuf,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
        /// Also connect to the controls and compare their axes and parameters; nothing is written to them
        #[arg(long)]
        online: bool,
    },
    /// Rehearse every fault on a simulated machine, and print what its axes did
    ///
    /// No device is opened and nothing is sent: a simulated machine takes the place of the configured controllers and
    /// thermometers. It has the axes, steps and limits of the configuration, and the reference barrier in its control where
    /// the configuration has one. Each controller is rehearsed alone. Each fault begins once while compensating and once
    /// while ramping, and is taken away again.
    ///
    /// Exit status: 0 no rule was broken, 1 a rule was broken, 2 the configuration or the call is wrong, 130 ended by Ctrl-C.
    #[command(after_help = REHEARSE_EXAMPLES)]
    Rehearse {
        /// The TOML file of the configuration
        config: PathBuf,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
        /// Seed of the random faults; the same seed gives the same faults
        #[arg(long, default_value_t = 1)]
        seed: u64,
        /// Rehearse only this fault, by its name in the table; may be repeated
        #[arg(long, value_name = "NAME")]
        fault: Vec<String>,
    },
    /// Print the state of a running gateway
    #[command(after_help = STATUS_EXAMPLES)]
    Status {
        #[command(flatten)]
        running: RunningArguments,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Arm a running gateway
    ///
    /// A changed model or changed limits raise a question, as on the dashboard: it is printed, and the gateway is not
    /// armed until the command is repeated with --confirm.
    ///
    /// Exit status: 0 armed, 1 refused or no answer, 2 the call or a file is wrong.
    #[command(after_help = ARM_EXAMPLES)]
    Arm(ArmArguments),
    /// Disarm a running gateway: ramp the correction to zero
    ///
    /// Needs no token on the gateway's own computer.
    Disarm(RunningArguments),
    /// Acknowledge the faults of a running gateway
    Acknowledge(RunningArguments),
    /// Manage the tokens of the dashboard
    #[command(subcommand)]
    Token(TokenCommand),
    /// Manage the systemd service
    #[command(subcommand)]
    Service(ServiceCommand),
    /// Print the description of the gateway for an agent of MTConnect, XML
    ///
    /// An agent that reads the adapter of the table [shdr] needs it as its file Devices.xml. No device is opened.
    #[cfg(feature = "shdr")]
    #[command(after_help = SHDR_EXAMPLES)]
    ShdrDevice {
        /// The TOML file of the configuration
        config: PathBuf,
    },
    /// Send a map of corrections to a control that does the look-up itself, and keep it valid
    ///
    /// `volcomp map-table` makes the map. Without --confirm the files are checked and the command prints what would be sent.
    /// With it the map is sent, read back and activated. It is then kept valid
    /// until SIGTERM or SIGINT. After that nothing is sent and the control ramps its corrections to zero; the program
    /// waits for that. A second signal ends it at once.
    ///
    /// Exit status: 0 the corrections are zero again, 1 the work failed, 2 a file or the call is wrong.
    #[command(after_help = SEND_MAP_EXAMPLES)]
    SendMap {
        /// The TOML file of the sender
        config: PathBuf,
        /// Hash of the map, as printed without this option
        #[arg(long, value_name = "HASH")]
        confirm: Option<String>,
        /// Replace the map of the running sender: the control moves between the values at its rate, not through zero
        #[arg(long, requires = "confirm")]
        replace: bool,
        /// The form of the log on standard error
        #[arg(long, value_enum, default_value_t = LogForm::Text)]
        log: LogForm,
    },
    /// Make a self-signed certificate and its key for the dashboard
    #[command(after_help = TLS_EXAMPLES)]
    TlsInit {
        /// Host names and addresses of the dashboard
        #[arg(required = true)]
        names: Vec<String>,
        /// The folder for certificate.pem and key.pem
        #[arg(long, short, default_value = ".")]
        output: PathBuf,
    },
    /// Print a completion script for a shell
    #[command(after_help = "Example:\n  volcomp-gateway completions bash > volcomp-gateway.bash")]
    Completions {
        /// Shell
        shell: Shell,
    },
    /// Write the JSON Schemas of the documents
    #[command(hide = true)]
    Schema {
        /// The folder for the files
        folder: PathBuf,
    },
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    let json = matches!(
        arguments.command,
        Some(
            Command::Check { json: true, .. }
                | Command::Rehearse { json: true, .. }
                | Command::Status { json: true, .. }
        )
    );
    match act(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            let failure = error.failure();
            let text = match serde_json::to_string(&failure) {
                Ok(text) if json => text,
                _ => format!("error: {error}"),
            };
            // `eprintln!` would panic if standard error cannot be written, and the status would be lost.
            bounded(move || drop(writeln!(std::io::stderr(), "{text}")));
            ExitCode::from(failure.status)
        }
    }
}

fn act(arguments: Arguments) -> Result<(), GatewayError> {
    match arguments.command {
        None => {
            let _log = Log::start(arguments.run.log);
            // Without a configuration the gateway runs the built-in simulation.
            run::run(&arguments.run.options)
        }
        Some(Command::Check { config, json, online }) => {
            print(&check::check(&config, online, json)?)
        }
        Some(Command::Rehearse { config, json, seed, fault }) => {
            let rehearsal = Rehearsal::of(seed, &fault)?;
            run::exit_when_interrupted()?;
            let found = rehearsal.run(&Plan::new(Config::read(&config)?)?)?;
            print(&if json { check::line(&found)? } else { rehearse::text(&found, columns()) })?;
            found.verdict()
        }
        Some(Command::Init(arguments)) => print(&init::init(arguments)?),
        Some(Command::Status { running, json }) => {
            let token = running.token()?;
            let status = client::request_status(&running.dashboard()?, token.as_deref())?;
            print(&if json { check::line(&status)? } else { client::status_text(&status) })
        }
        Some(Command::Arm(arguments)) => print(&client::arm(&arguments)?),
        Some(Command::Disarm(running)) => print(&client::disarm(&running)?),
        Some(Command::Acknowledge(running)) => print(&client::acknowledge(&running)?),
        Some(Command::Token(TokenCommand::Add(arguments))) => {
            print(&(token::add(&arguments)? + "\n"))
        }
        Some(Command::Service(ServiceCommand::Install(arguments))) => {
            print(&install::install(&arguments)?)
        }
        Some(Command::Completions { shell }) => {
            let mut script = Vec::new();
            clap_complete::generate(
                shell,
                &mut Arguments::command(),
                "volcomp-gateway",
                &mut script,
            );
            print(&String::from_utf8_lossy(&script))
        }
        #[cfg(feature = "shdr")]
        Some(Command::ShdrDevice { config }) => {
            let plan = Plan::new(Config::read(&config)?)?;
            print(&shdr::device(&plan.shape(), plan.shdr_device()))
        }
        Some(Command::SendMap { config, confirm, replace, log: form }) => {
            let checked = send_map::check(&config)?;
            let Some(hash) = confirm else {
                return print(&checked.text());
            };
            checked.confirmed(&hash)?;
            if replace {
                send_map::request_replacement(&checked)?;
                return print(
                    "the running sender has the request: its output states when the map is in use, its log why not\n",
                );
            }
            let _log = Log::start(form);
            send_map::run(&checked)
        }
        Some(Command::Schema { folder }) => write_schemas(&folder)
            .map_err(|e| GatewayError::system(folder.display().to_string(), e)),
        Some(Command::TlsInit { names, output }) => {
            let [certificate, key] = tls::make(&output, &names)?;
            print(&format!(
                "tls_certificate = {:?}\ntls_key = {:?}\n",
                certificate.display().to_string(),
                key.display().to_string()
            ))
        }
    }
}

fn write_schemas(folder: &Path) -> std::io::Result<()> {
    std::fs::create_dir_all(folder)?;
    for (name, schema) in documents::schemas() {
        let text = serde_json::to_string_pretty(&schema)?;
        std::fs::write(folder.join(name), text + "\n")?;
    }
    Ok(())
}

/// Width of standard output in columns: from `COLUMNS`, else from the terminal, else the width for files.
fn columns() -> usize {
    let stated = std::env::var("COLUMNS").ok();
    let of_terminal = || rustix::termios::tcgetwinsize(std::io::stdout()).ok();
    stated
        .and_then(|columns| columns.parse().ok())
        .or_else(|| of_terminal().map(|size| usize::from(size.ws_col)))
        .filter(|columns| *columns > 0)
        .unwrap_or(rehearse::COLUMNS)
}

/// Further lines are dropped. Room for all is taken at the start.
const MAX_WAITING_LINES: usize = 1000;

/// The log on standard error. A thread of its own writes the lines, because standard error may be a full disk, a pipe
/// that nobody reads or a stopped terminal. Dropping it waits for the last lines.
struct Log(Option<WorkerGuard>);

impl Log {
    fn start(form: LogForm) -> Self {
        use tracing_subscriber::{
            Layer as _, filter, layer::SubscriberExt as _, util::SubscriberInitExt as _,
        };
        // The OPC UA library logs irrelevant messages on every connection, such as a missing certificate. Real failures
        // are reported as our own errors, with the URL.
        let targets = filter::Targets::new()
            .with_default(filter::LevelFilter::INFO)
            .with_target("opcua", filter::LevelFilter::OFF);
        let (stderr, guard) = NonBlockingBuilder::default()
            .buffered_lines_limit(MAX_WAITING_LINES)
            .finish(std::io::stderr());
        let lines = tracing_subscriber::fmt::layer().with_writer(stderr).with_target(false);
        let lines = match form {
            LogForm::Text => {
                lines.with_ansi(std::io::IsTerminal::is_terminal(&std::io::stderr())).boxed()
            }
            LogForm::Json => lines.json().flatten_event(true).boxed(),
        };
        tracing_subscriber::registry().with(lines.with_filter(targets)).init();
        // The standard hook would wait for standard error before the correction is ramped out.
        std::panic::set_hook(Box::new(|panic| tracing::error!("{panic}")));
        Self(Some(guard))
    }
}

impl Drop for Log {
    fn drop(&mut self) {
        let guard = self.0.take();
        // With a full queue the guard prints to standard output, which may be blocked as well.
        bounded(move || drop(guard));
    }
}

/// Waits at most two seconds for output that may be blocked.
fn bounded(output: impl FnOnce() + Send + 'static) {
    let (done, waiting) = std::sync::mpsc::channel();
    let printing = move || {
        output();
        let _ = done.send(());
    };
    if std::thread::Builder::new().spawn(printing).is_ok() {
        let _ = waiting.recv_timeout(std::time::Duration::from_secs(2));
    }
}

#[cfg(test)]
mod tests {
    use clap::CommandFactory;

    #[test]
    fn every_option_has_help_for_its_man_page() {
        let end = include_str!("../debian/man-end.roff");
        volcomp_test_support::man_pages::write(super::Arguments::command(), "8", end);
    }

    #[test]
    fn options_are_those_of_the_book() {
        volcomp_test_support::options::compare(super::Arguments::command());
    }
}

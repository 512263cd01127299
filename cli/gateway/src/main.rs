//! The `volcomp-gateway` command: corrects a machine tool in real time.

use std::{io::Write, net::SocketAddr, path::PathBuf, process::ExitCode, time::Duration};

use clap::{Parser, Subcommand, ValueEnum};
use volcomp_gateway::{
    config::{Config, DashboardConfig},
    error::GatewayError,
    http::tls,
    run::{self, Options},
    status,
};

/// Corrects a machine tool in real time: reads its position and temperatures, computes the volumetric correction,
/// and writes it back under the rules of a guard. Shows what it does on a dashboard.
///
/// Without a configuration it simulates a machine. SIGHUP reads the configuration and the machine file again;
/// SIGTERM and SIGINT ramp the correction to zero and end it, a second one at once.
/// Exit status: 0 done, 1 the work failed, 2 the configuration or the call is wrong.
#[derive(Parser)]
#[command(version, args_conflicts_with_subcommands = true)]
struct Arguments {
    #[command(flatten)]
    run: RunArguments,
    #[command(subcommand)]
    command: Option<Command>,
}

#[derive(clap::Args)]
struct RunArguments {
    /// Configuration, TOML
    #[arg(long, conflicts_with = "simulate")]
    config: Option<PathBuf>,
    /// Simulate a machine; so it is without a configuration
    #[arg(long)]
    simulate: bool,
    /// Where the dashboard listens, instead of the configured address
    #[arg(long)]
    listen: Option<SocketAddr>,
    /// Named tokens (NAME ROLE TOKEN, mode 0600), instead of the configured file
    #[arg(long)]
    token_file: Option<PathBuf>,
    /// Folder of the audit log, instead of the configured one
    #[arg(long)]
    audit_dir: Option<PathBuf>,
    /// Time of a cycle of the simulation, ms
    #[arg(long, value_parser = cycle, conflicts_with = "config")]
    cycle_ms: Option<Duration>,
    /// How the log on standard error is written
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
    /// Check a configuration without touching a device
    Check {
        /// Configuration, TOML
        config: PathBuf,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Say what a running gateway does
    Status {
        /// Its configuration
        #[arg(long)]
        config: Option<PathBuf>,
        /// Where it listens
        #[arg(long)]
        listen: Option<SocketAddr>,
        /// A file whose first line is a token, where reading needs one
        #[arg(long)]
        token_file: Option<PathBuf>,
        /// Print the JSON document
        #[arg(long)]
        json: bool,
    },
    /// Make a self-signed certificate and its key for the dashboard
    TlsInit {
        /// Names and addresses under which browsers will ask for it
        #[arg(required = true)]
        names: Vec<String>,
        /// Folder for certificate.pem and key.pem
        #[arg(long, short, default_value = ".")]
        output: PathBuf,
    },
}

fn cycle(text: &str) -> Result<Duration, String> {
    let ms: f64 = text
        .parse()
        .map_err(|_| "expected a number of milliseconds".to_owned())?;
    if (0.1..=1000.0).contains(&ms) {
        Ok(Duration::from_secs_f64(ms * 1e-3))
    } else {
        Err("expected 0.1 to 1000".to_owned())
    }
}

fn main() -> ExitCode {
    let arguments = Arguments::parse();
    match act(arguments) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::from(error.status())
        }
    }
}

fn act(arguments: Arguments) -> Result<(), GatewayError> {
    match arguments.command {
        None => {
            let options = arguments.run;
            log(options.log);
            run::run(&Options {
                config: options.config.filter(|_| !options.simulate),
                listen: options.listen,
                token_file: options.token_file,
                audit_dir: options.audit_dir,
                simulated_cycle: options.cycle_ms,
            })
        }
        Some(Command::Check { config, json }) => {
            let lines = run::check(&config)?;
            if json {
                print(&format!("{}\n", serde_json::json!({ "notes": lines })))
            } else {
                print(&(lines.join("\n") + "\n"))
            }
        }
        Some(Command::Status {
            config,
            listen,
            token_file,
            json,
        }) => {
            let mut dashboard = match config {
                Some(path) => Config::read(&path)?.dashboard,
                None => DashboardConfig::default(),
            };
            if let Some(listen) = listen {
                dashboard.listen = listen;
            }
            let token = match token_file {
                Some(path) => {
                    let text = std::fs::read_to_string(&path).map_err(|e| GatewayError::Read {
                        file: path.display().to_string(),
                        source: e,
                    })?;
                    // A token alone, or a line of the gateway's own file.
                    text.lines()
                        .next()
                        .and_then(|line| line.split_whitespace().last())
                        .map(str::to_owned)
                }
                None => None,
            };
            let state = status::ask(&dashboard, token.as_deref())?;
            print(&if json {
                format!(
                    "{state}
"
                )
            } else {
                status::text(&state)
            })
        }
        Some(Command::TlsInit { names, output }) => {
            let [certificate, key] = tls::make(&output, &names)?;
            print(&format!(
                "tls_certificate = {:?}
tls_key = {:?}
",
                certificate.display().to_string(),
                key.display().to_string()
            ))
        }
    }
}

/// To standard output; a reader that has gone away is no failure.
fn print(text: &str) -> Result<(), GatewayError> {
    match std::io::stdout().write_all(text.as_bytes()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => {
            Err(GatewayError::system("standard output", e))
        }
        _ => Ok(()),
    }
}

fn log(form: LogForm) {
    let builder = tracing_subscriber::fmt()
        .with_writer(std::io::stderr)
        .with_max_level(tracing::Level::INFO)
        .with_target(false);
    match form {
        LogForm::Text => builder
            .with_ansi(std::io::IsTerminal::is_terminal(&std::io::stderr()))
            .init(),
        LogForm::Json => builder.json().flatten_event(true).init(),
    }
}

use std::{net::SocketAddr, path::PathBuf};

use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::{
    discover::{MAX_PER_SECOND, PER_SECOND, Subnet},
    users::{Role, UserName},
};

const EXAMPLES: &str = "Examples:
  volcomp-centre key new main
  volcomp-centre machine add mill-1 --site berlin --serial 4711 --like mill.toml
  volcomp-centre nats-config > /etc/nats-server.conf
  volcomp-centre run
  volcomp-centre model add mill-1.toml --measured 2026-11-25
  volcomp-centre rollout start --model 5f0c --machine mill-1";

/// Version with commit and date in released programs, see `.github/release`. A packaged crate has no repository to read them from.
const VERSION: &str = match option_env!("VOLCOMP_VERSION") {
    Some(version) => version,
    None => env!("CARGO_PKG_VERSION"),
};

/// The control centre of many machine tools
///
/// Registers machines, signs their error models and rolls them out, and watches the condition of every machine. The machines are reached over a NATS server; each works on alone when the centre or the server is gone.
///
/// Exit status: 0 done, 1 the work failed, 2 the configuration or the call is wrong.
#[derive(Parser)]
#[command(name = "volcomp-centre", version = VERSION, after_help = EXAMPLES, max_term_width = 80)]
pub struct Arguments {
    /// Configuration file, TOML
    #[arg(long, global = true, default_value = "centre.toml")]
    pub(super) config: PathBuf,
    /// Author for the audit log [default: user of the operating system]
    #[arg(long, global = true, value_name = "NAME")]
    pub(super) by: Option<String>,
    #[command(subcommand)]
    pub(super) command: Command,
}

#[derive(Subcommand)]
pub(super) enum Command {
    /// Run the centre until it receives SIGTERM or SIGINT
    Run {
        /// Format of the log on standard error
        #[arg(long, value_enum, default_value_t = LogForm::Text)]
        log: LogForm,
    },
    /// Check the configuration, the keys, the store and its audit log
    Check,
    /// Machines: add, list, remove, enable, disable
    #[command(subcommand)]
    Machine(MachineCommand),
    /// Models: add, list, compare
    #[command(subcommand)]
    Model(ModelCommand),
    /// Roll-outs: start, watch, pause, confirm, stop
    #[command(subcommand)]
    Rollout(RolloutCommand),
    /// Signing keys, and nkeys of the server's users
    #[command(subcommand)]
    Key(KeyCommand),
    /// Users of the web interface: add, list, change, remove
    #[command(subcommand)]
    User(UserCommand),
    /// Create a self-signed certificate and its key for the web interface
    TlsInit {
        /// Host names and addresses that browsers will use
        #[arg(required = true)]
        names: Vec<String>,
        /// Folder for certificate.pem and key.pem
        #[arg(long, short, default_value = ".")]
        output: PathBuf,
    },
    /// Find controls, modules and gateways in stated subnets; nothing is written to them
    Discover(DiscoverArguments),
    /// Run a demonstration: a server, three simulated machines and the web interface; no data are kept
    Demo {
        /// Address and port of the web interface
        #[arg(long, default_value = "127.0.0.1:8460")]
        listen: SocketAddr,
    },
    /// Print the configuration of the NATS server, with every machine that has an nkey
    NatsConfig {
        /// Write it to this file, readable only by its owner; an existing file is replaced
        #[arg(long, short, value_name = "FILE")]
        output: Option<PathBuf>,
    },
    /// Print the open alarms
    Alarms {
        /// Include closed alarms
        #[arg(long)]
        all: bool,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Check the chain of the audit log, and print its last records
    Audit {
        /// Number of records
        #[arg(long, default_value_t = 20)]
        count: u32,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
}

#[derive(Clone, Copy, Debug, PartialEq, ValueEnum)]
pub(super) enum LogForm {
    Text,
    Json,
}

#[derive(Subcommand)]
pub(super) enum MachineCommand {
    /// Register a machine, or change its record
    Add(Box<AddMachine>),
    /// List the machines with their current states
    List {
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Remove a machine; its versions and history are kept
    Remove {
        /// Name of the machine
        machine: String,
    },
    /// Permit the correction of a machine
    Enable {
        /// Name of the machine
        machine: String,
    },
    /// Ramp the correction of a machine out, and forbid arming
    Disable {
        /// Name of the machine
        machine: String,
    },
}

#[derive(Args)]
pub(super) struct AddMachine {
    /// Name of the machine: lower-case letters, digits and hyphens
    pub(super) machine: String,
    /// Site of the machine
    #[arg(long)]
    pub(super) site: String,
    /// Serial number of the machine tool, as configured in its gateway
    #[arg(long)]
    pub(super) serial: String,
    /// Machine file with the structure and the axes of the machine
    #[arg(long, value_name = "FILE", visible_alias = "from")]
    pub(super) like: PathBuf,
    /// Public nkey of the machine's gateway
    #[arg(long, conflicts_with = "new_nkey")]
    pub(super) nkey: Option<String>,
    /// Generate an nkey for the machine's gateway, and write its seed to this new file
    #[arg(long, value_name = "FILE")]
    pub(super) new_nkey: Option<PathBuf>,
    /// Make the machine a canary, which receives each roll-out before the others
    #[arg(long)]
    pub(super) canary: bool,
    /// Forbid the correction of the machine until `machine enable`
    #[arg(long)]
    pub(super) disabled: bool,
    /// Days after a calibration until the next one is due
    #[arg(long, value_name = "DAYS")]
    pub(super) due_days: Option<u32>,
    /// Interval of the gateway's condition messages, s [default: 1]
    #[arg(long, value_name = "S")]
    pub(super) condition_s: Option<u32>,
    /// Interval of the gateway's complete telemetry messages, s [default: 10]
    #[arg(long, value_name = "S")]
    pub(super) telemetry_s: Option<u32>,
    /// Network address of the control, for display
    #[arg(long)]
    pub(super) address: Option<String>,
    /// Make of the control, for display
    #[arg(long)]
    pub(super) control: Option<String>,
    /// Note, for display
    #[arg(long)]
    pub(super) note: Option<String>,
}

#[derive(Subcommand)]
pub(super) enum ModelCommand {
    /// Add a machine file
    Add(AddModel),
    /// List the models
    List {
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Print the record of a model
    Show {
        /// Checksum of the model, or its beginning
        model: String,
    },
    /// Write the machine file of a model to a new file, exactly as signed
    Download {
        /// Checksum of the model, or its beginning
        model: String,
        /// Path of the new file
        #[arg(long, short, value_name = "FILE")]
        output: PathBuf,
    },
    /// Compare two models line by line
    Diff {
        /// Checksum of the first model, or its beginning
        one: String,
        /// Checksum of the second model, or its beginning
        other: String,
    },
    /// Roll the previously active model of a machine out to it again
    Back {
        /// Name of the machine
        machine: String,
    },
    /// Print how the errors of a machine have changed from model to model
    Drift {
        /// Name of the machine
        machine: String,
    },
}

#[derive(Args)]
pub(super) struct AddModel {
    /// Machine file to add
    pub(super) file: PathBuf,
    /// Day of the measurements, such as 2026-11-25
    #[arg(long, value_name = "DAY")]
    pub(super) measured: Option<String>,
}

#[derive(Subcommand)]
pub(super) enum RolloutCommand {
    /// Start a roll-out of a model
    Start(StartRollout),
    /// Print the progress of roll-outs
    Status {
        /// Number of the roll-out [default: all open ones, and the latest]
        id: Option<u64>,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Keep the model of a stopped or aborted roll-out on a machine
    Keep {
        /// Number of the roll-out
        id: u64,
        /// Name of the machine
        machine: String,
    },
    #[command(flatten)]
    Request(RequestCommand),
}

#[derive(Subcommand)]
pub(super) enum RequestCommand {
    /// Pause a roll-out: nothing more is sent
    Pause {
        /// Number of the roll-out
        id: u64,
    },
    /// Resume a roll-out, although the reason for its stop may persist
    Resume {
        /// Number of the roll-out
        id: u64,
    },
    /// Abort a roll-out; machines keep the version that is active
    Stop {
        /// Number of the roll-out
        id: u64,
    },
    /// Confirm a large change of the axis positions of a machine
    Confirm {
        /// Number of the roll-out
        id: u64,
        /// Name of the machine
        machine: String,
        /// Hash of the change, as shown by `rollout status`
        hash: String,
    },
}

#[derive(Args)]
pub(super) struct StartRollout {
    /// Checksum of the model, or its beginning
    #[arg(long)]
    pub(super) model: String,
    /// Machine to which the model is sent; may be given several times
    #[arg(long, value_name = "NAME", required_unless_present = "all")]
    pub(super) machine: Vec<String>,
    /// Send the model to every machine with its structure and axes
    #[arg(long, conflicts_with = "machine")]
    pub(super) all: bool,
    /// Send all machines the same model, although it was measured on one of them
    #[arg(long, requires = "all")]
    pub(super) same_model: bool,
    /// Time for which a machine is observed before the next ones follow, s
    #[arg(long, value_name = "S")]
    pub(super) soak_s: Option<f64>,
    /// Maximum number of machines, canaries not counted, that may drop out before the roll-out stops
    #[arg(long, value_name = "N")]
    pub(super) tolerate: Option<u32>,
}

#[derive(Subcommand)]
pub(super) enum KeyCommand {
    /// Generate a signing key, and print the public key, which the machines must trust
    New {
        /// Name of the key
        name: String,
    },
    /// List the signing keys with their public keys
    List,
    /// Generate an nkey of a server user, write its seed to a new file, and print the public nkey
    Nkey {
        /// Path of the new file for the seed
        file: PathBuf,
    },
}

#[derive(Subcommand)]
pub(super) enum UserCommand {
    /// Add a user; the password is prompted for, or read from standard input
    Add {
        /// Name of the user: lower-case letters, digits, dots, hyphens and underscores
        name: UserName,
        /// Role: viewer, engineer or admin
        #[arg(long)]
        role: Role,
    },
    /// List the users
    List {
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Set the password of a user, and log the user out everywhere
    Password {
        /// Name of the user
        name: UserName,
    },
    /// Change the role of a user, or whether the user may log in
    Change {
        /// Name of the user
        name: UserName,
        /// Role: viewer, engineer or admin
        #[arg(long)]
        role: Option<Role>,
        /// Forbid the user to log in
        #[arg(long, conflicts_with = "enable")]
        disable: bool,
        /// Permit the user to log in again
        #[arg(long)]
        enable: bool,
    },
    /// Remove a user
    Remove {
        /// Name of the user
        name: UserName,
    },
}

#[derive(Args)]
pub(super) struct DiscoverArguments {
    /// Subnets or addresses, such as 192.0.2.0/24
    #[arg(required = true)]
    pub(super) subnets: Vec<Subnet>,
    /// Search public address ranges too, which must belong to you
    #[arg(long)]
    pub(super) yes_these_are_mine: bool,
    /// Maximum rate of new connections over all addresses, per second, 1 to 1000
    #[arg(long, default_value_t = PER_SECOND, value_parser = rate)]
    pub(super) rate: f64,
    /// Try this port for FOCAS instead of 8193; may be given several times
    #[arg(long, value_name = "PORT")]
    pub(super) focas_port: Vec<u16>,
    /// Try this port for OPC UA instead of 4840
    #[arg(long, value_name = "PORT")]
    pub(super) opc_ua_port: Vec<u16>,
    /// Try this port for Modbus TCP instead of 502
    #[arg(long, value_name = "PORT")]
    pub(super) modbus_port: Vec<u16>,
    /// Try this port for gateways instead of 8080 and 8443
    #[arg(long, value_name = "PORT")]
    pub(super) gateway_port: Vec<u16>,
    /// Print one JSON document
    #[arg(long)]
    pub(super) json: bool,
}

fn rate(text: &str) -> Result<f64, String> {
    let found: f64 = text.parse().map_err(|_| "expected a number".to_owned())?;
    if (1.0..=MAX_PER_SECOND).contains(&found) {
        Ok(found)
    } else {
        Err(format!("expected 1 to {MAX_PER_SECOND}"))
    }
}

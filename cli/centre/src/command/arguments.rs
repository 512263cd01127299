//! Command-line arguments.

use std::{net::SocketAddr, path::PathBuf};

use clap::{Args, Parser, Subcommand, ValueEnum};

use crate::{
    discover::{FASTEST_PER_SECOND, PER_SECOND, Subnet},
    users::{Role, UserName},
};

const EXAMPLES: &str = "Examples:
  volcomp-centre key new main
  volcomp-centre machine add mill-1 --site berlin --serial 4711 --like mill.toml
  volcomp-centre nats-config > /etc/nats-server.conf
  volcomp-centre run
  volcomp-centre model add mill-1.toml --measured 2026-11-25
  volcomp-centre rollout start --model 5f0c --machine mill-1";

/// The control centre of many machine tools
///
/// Registers machines, signs their error models and rolls them out, and watches the condition of every machine. The machines are reached over a NATS server; each works on alone when the centre or the server is gone.
///
/// Exit status: 0 done, 1 the work failed, 2 the configuration or the call is wrong.
#[derive(Parser)]
#[command(name = "volcomp-centre", version, after_help = EXAMPLES, max_term_width = 80)]
pub struct Arguments {
    /// The TOML file of the configuration
    #[arg(long, global = true, default_value = "centre.toml")]
    pub(super) config: PathBuf,
    /// Who does it, for the audit log; without it the user of the operating system
    #[arg(long, global = true, value_name = "NAME")]
    pub(super) by: Option<String>,
    #[command(subcommand)]
    pub(super) command: Command,
}

#[derive(Subcommand)]
pub(super) enum Command {
    /// Run the centre until it is told to end
    Run {
        /// The form of the log on standard error
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
    /// Roll-outs: start, watch, hold, confirm, end
    #[command(subcommand)]
    Rollout(RolloutCommand),
    /// Keys that sign, and nkeys of users of the server
    #[command(subcommand)]
    Key(KeyCommand),
    /// Users of the page: add, list, change, remove
    #[command(subcommand)]
    User(UserCommand),
    /// Make a self-signed certificate and its key for the page
    TlsInit {
        /// Host names and addresses under which browsers will ask for it
        #[arg(required = true)]
        names: Vec<String>,
        /// The folder for certificate.pem and key.pem
        #[arg(long, short, default_value = ".")]
        output: PathBuf,
    },
    /// Find controls, modules and gateways in stated subnets; nothing is written to them
    Discover(DiscoverArguments),
    /// Show it: a server, three simulated machines and the page; nothing is kept
    Demo {
        /// The address and port of the page
        #[arg(long, default_value = "127.0.0.1:8460")]
        listen: SocketAddr,
    },
    /// Print the configuration of the NATS server, with every machine that has an nkey
    NatsConfig {
        /// Write it into this file, which only its owner can read; the one before is replaced
        #[arg(long, short, value_name = "FILE")]
        output: Option<PathBuf>,
    },
    /// Print what is wrong
    Alarms {
        /// Those that are over, too
        #[arg(long)]
        all: bool,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Check the chain of the audit log, and print its last records
    Audit {
        /// So many records
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
    /// Register a machine, or change what is known of it
    Add(Box<AddMachine>),
    /// List the machines with what is known of each now
    List {
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Forget a machine; its versions and its history stay
    Remove {
        /// Its name
        machine: String,
    },
    /// Let a machine be corrected
    Enable {
        /// Its name
        machine: String,
    },
    /// Have a machine ramp its correction out, and forbid it to arm
    Disable {
        /// Its name
        machine: String,
    },
}

#[derive(Args)]
pub(super) struct AddMachine {
    /// Its name: lower-case letters, digits and hyphens
    pub(super) machine: String,
    /// The site where it stands
    #[arg(long)]
    pub(super) site: String,
    /// The serial number of the machine tool, as its gateway has it
    #[arg(long)]
    pub(super) serial: String,
    /// A machine file with its structure and axes
    #[arg(long, value_name = "FILE", visible_alias = "from")]
    pub(super) like: PathBuf,
    /// The public nkey of its gateway
    #[arg(long, conflicts_with = "new_nkey")]
    pub(super) nkey: Option<String>,
    /// Draw an nkey for its gateway, and write the seed into this new file
    #[arg(long, value_name = "FILE")]
    pub(super) new_nkey: Option<PathBuf>,
    /// It is among the first of a roll-out
    #[arg(long)]
    pub(super) canary: bool,
    /// It may not be corrected yet
    #[arg(long)]
    pub(super) disabled: bool,
    /// Days after a calibration until the next one is due
    #[arg(long, value_name = "DAYS")]
    pub(super) due_days: Option<u32>,
    /// Seconds between two conditions; without it 1
    #[arg(long, value_name = "S")]
    pub(super) condition_s: Option<u32>,
    /// Seconds between two whole states; without it 10
    #[arg(long, value_name = "S")]
    pub(super) telemetry_s: Option<u32>,
    /// Where its control was found, for people
    #[arg(long)]
    pub(super) address: Option<String>,
    /// The make of its control, for people
    #[arg(long)]
    pub(super) control: Option<String>,
    /// What else is to be known
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
    /// Print what is known of a model
    Show {
        /// The beginning of its checksum
        model: String,
    },
    /// Write the machine file of a model into a new file, byte by byte as it is signed
    Download {
        /// The beginning of its checksum
        model: String,
        /// The new file
        #[arg(long, short, value_name = "FILE")]
        output: PathBuf,
    },
    /// Compare two models line by line
    Diff {
        /// The beginning of the checksum of one
        one: String,
        /// The beginning of the checksum of the other
        other: String,
    },
    /// Roll out to a machine the model that it has had in force before the one that it has now
    Back {
        /// The name of the machine
        machine: String,
    },
    /// Print how the errors of a machine have changed from model to model
    Drift {
        /// The name of the machine
        machine: String,
    },
}

#[derive(Args)]
pub(super) struct AddModel {
    /// A machine file
    pub(super) file: PathBuf,
    /// The day of the measurements, such as 2026-11-25
    #[arg(long, value_name = "DAY")]
    pub(super) measured: Option<String>,
}

#[derive(Subcommand)]
pub(super) enum RolloutCommand {
    /// Start a roll-out of a model
    Start(StartRollout),
    /// Print where roll-outs stand
    Status {
        /// The number of one; without it all that are not over, and the last ones
        id: Option<u64>,
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Say that a machine keeps the model of a roll-out that stopped or was ended
    Keep {
        /// The number of the roll-out
        id: u64,
        /// The name of the machine
        machine: String,
    },
    #[command(flatten)]
    Wish(WishCommand),
}

#[derive(Subcommand)]
pub(super) enum WishCommand {
    /// Hold a roll-out: nothing more is sent
    Pause {
        /// Its number
        id: u64,
    },
    /// Let a roll-out go on, in spite of what it has stopped for
    Resume {
        /// Its number
        id: u64,
    },
    /// End a roll-out; what was sent stays sent
    Stop {
        /// Its number
        id: u64,
    },
    /// Confirm that a model moves the axes of a machine far
    Confirm {
        /// The number of the roll-out
        id: u64,
        /// The name of the machine
        machine: String,
        /// The hash as `rollout status` shows it
        hash: String,
    },
}

#[derive(Args)]
pub(super) struct StartRollout {
    /// The beginning of the checksum of the model
    #[arg(long)]
    pub(super) model: String,
    /// A machine; may be given several times
    #[arg(long, value_name = "NAME", required_unless_present = "all")]
    pub(super) machine: Vec<String>,
    /// Every machine with the structure and the axes of the model
    #[arg(long, conflicts_with = "machine")]
    pub(super) all: bool,
    /// The machines shall have one model, although a model is measured on one of them
    #[arg(long, requires = "all")]
    pub(super) same_model: bool,
    /// A machine is watched for so long before the next ones, s
    #[arg(long, value_name = "S")]
    pub(super) soak_s: Option<f64>,
    /// So many machines after the first may stay out
    #[arg(long, value_name = "N")]
    pub(super) tolerate: Option<u32>,
}

#[derive(Subcommand)]
pub(super) enum KeyCommand {
    /// Draw a key that signs, and print the public key, which the machines must trust
    New {
        /// Its name
        name: String,
    },
    /// List the keys that sign, with their public keys
    List,
    /// Draw an nkey of a user of the server, write its seed into a new file, and print the public nkey
    Nkey {
        /// The new file of the seed
        file: PathBuf,
    },
}

#[derive(Subcommand)]
pub(super) enum UserCommand {
    /// Add a user; the password is asked for, or read from standard input
    Add {
        /// The name: lower-case letters, digits, dots, hyphens and underscores
        name: UserName,
        /// viewer, engineer or admin
        #[arg(long)]
        role: Role,
    },
    /// List the users
    List {
        /// Print one JSON document
        #[arg(long)]
        json: bool,
    },
    /// Set the password of a user, who is logged out everywhere
    Password {
        /// The name
        name: UserName,
    },
    /// Change the role of a user, or whether the user may log in
    Change {
        /// The name
        name: UserName,
        /// viewer, engineer or admin
        #[arg(long)]
        role: Option<Role>,
        /// The user may not log in any more
        #[arg(long, conflicts_with = "enable")]
        disable: bool,
        /// The user may log in again
        #[arg(long)]
        enable: bool,
    },
    /// Remove a user
    Remove {
        /// The name
        name: UserName,
    },
}

#[derive(Args)]
pub(super) struct DiscoverArguments {
    /// Subnets or addresses, such as 192.0.2.0/24
    #[arg(required = true)]
    pub(super) subnets: Vec<Subnet>,
    /// Search ranges that are not private, too: they belong to you
    #[arg(long)]
    pub(super) yes_these_are_mine: bool,
    /// New connections a second over all addresses, 1 to 1000
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
    if (1.0..=FASTEST_PER_SECOND).contains(&found) {
        Ok(found)
    } else {
        Err(format!("expected 1 to {FASTEST_PER_SECOND}"))
    }
}

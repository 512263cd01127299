//! Dispatches the commands of `volcomp-centre`.
//!
//! The commands `user` and `discover` are implemented here, the other commands in submodules.

use std::{
    fmt::Write as _,
    io::{BufRead, IsTerminal, Write as _},
    path::Path,
    sync::Arc,
};

use crate::{
    Error,
    command::arguments::{
        Command, DiscoverArguments, KeyCommand, MachineCommand, ModelCommand, RolloutCommand,
        UserCommand,
    },
    config::Config,
    discover::{Kind, Search, table},
    keys::Key,
    store::Store,
    users::{Password, hash},
};

mod arguments;
mod machines;
mod models;
mod run;
mod text;

pub use arguments::Arguments;

impl Arguments {
    pub fn act(self) -> Result<(), Error> {
        let config = || Config::read(&self.config);
        let by = self.by.clone().unwrap_or_else(os_user);
        match self.command {
            Command::Run { log } => run::run(&config()?, log),
            Command::Demo { listen } => run::demo(listen),
            Command::Discover(discover) => search(&discover),
            Command::User(user) => user_command(&config()?, user, &by),
            Command::TlsInit { names, output } => {
                let [certificate, key] = volcomp_web::tls::make(&output, &names)?;
                print(&format!(
                    "tls_certificate = {:?}\ntls_key = {:?}\n",
                    shown(&certificate),
                    shown(&key)
                ))
            }
            Command::Check => run::check(&config()?),
            Command::NatsConfig { output } => machines::nats_config(&config()?, output.as_deref()),
            Command::Audit { count, json } => machines::audit(&config()?, count, json),
            Command::Alarms { all, json } => machines::alarms(&config()?, all, json),
            Command::Key(KeyCommand::New { name }) => machines::new_key(&config()?, &name),
            Command::Key(KeyCommand::List) => machines::list_keys(&config()?),
            Command::Key(KeyCommand::Nkey { file }) => machines::new_nkey(&file),
            Command::Machine(MachineCommand::Add(add)) => machines::add(&config()?, &add, &by),
            Command::Machine(MachineCommand::List { json }) => machines::list(&config()?, json),
            Command::Machine(MachineCommand::Remove { machine }) => {
                machines::remove(&config()?, &machine, &by)
            }
            Command::Machine(MachineCommand::Enable { machine }) => {
                machines::enable(&config()?, &machine, true, &by)
            }
            Command::Machine(MachineCommand::Disable { machine }) => {
                machines::enable(&config()?, &machine, false, &by)
            }
            Command::Model(ModelCommand::Add(add)) => models::add(&config()?, &add, &by),
            Command::Model(ModelCommand::List { json }) => models::list(&config()?, json),
            Command::Model(ModelCommand::Show { model }) => models::show(&config()?, &model),
            Command::Model(ModelCommand::Download { model, output }) => {
                models::download(&config()?, &model, &output)
            }
            Command::Model(ModelCommand::Diff { one, other }) => {
                models::diff(&config()?, &one, &other)
            }
            Command::Model(ModelCommand::Back { machine }) => {
                models::back(&config()?, &machine, &by)
            }
            Command::Model(ModelCommand::Drift { machine }) => models::drift(&config()?, &machine),
            Command::Rollout(RolloutCommand::Start(start)) => {
                models::start_rollout(&config()?, &start, &by)
            }
            Command::Rollout(RolloutCommand::Status { id, json }) => {
                models::rollout_status(&config()?, id, json)
            }
            Command::Rollout(RolloutCommand::Keep { id, machine }) => {
                models::keep(&config()?, id, &machine, &by)
            }
            Command::Rollout(RolloutCommand::Request(request)) => {
                models::request_rollout(&config()?, request, &by)
            }
        }
    }
}

/// The user of the operating system according to the environment.
fn os_user() -> String {
    let named = ["SUDO_USER", "USER", "LOGNAME"].iter();
    let mut named = named.filter_map(|key| std::env::var(key).ok());
    named.find(|name| !name.is_empty()).unwrap_or_else(|| "command line".to_owned())
}

pub fn open(config: &Config) -> Result<Arc<Store>, Error> {
    Ok(Arc::new(Store::open(&config.store.file)?))
}

pub fn signing_key(config: &Config) -> Result<Key, Error> {
    Key::read(&config.keys.folder, &config.keys.sign_with)
}

/// Prints to standard output. A closed reader is not a failure.
fn print(text: &str) -> Result<(), Error> {
    match std::io::stdout().lock().write_all(text.as_bytes()) {
        Err(e) if e.kind() != std::io::ErrorKind::BrokenPipe => Err(e.into()),
        _ => Ok(()),
    }
}

fn print_json<T: serde::Serialize>(document: &T) -> Result<(), Error> {
    let text = serde_json::to_string_pretty(document).map_err(std::io::Error::from)?;
    print(&format!("{text}\n"))
}

fn machine_named(text: &str) -> Result<volcomp_fleet::MachineId, Error> {
    text.parse().map_err(|e| Error::Wrong(format!("the name of a machine: {e}")))
}

fn shown(path: &Path) -> String {
    path.display().to_string()
}

/// Origin of a change in the audit log.
const ORIGIN: &str = "command line";

fn user_command(config: &Config, command: UserCommand, by: &str) -> Result<(), Error> {
    let store = open(config)?;
    match command {
        UserCommand::List { json } => {
            let users = store.users()?;
            if json {
                return print_json(&users);
            }
            let mut lines = String::new();
            for user in &users {
                let disabled = if user.disabled { "  may not log in" } else { "" };
                let (name, role) = (user.name.as_str(), user.role.name());
                // Writing to a string never fails.
                let _ = writeln!(lines, "{name:20}  {role:8}{disabled}");
            }
            print(&lines)?;
        }
        UserCommand::Add { name, role } => {
            store.add_user(&name, role, &read_password()?, by, ORIGIN)?;
        }
        UserCommand::Password { name } => {
            store.set_password(&name, &read_password()?, by, ORIGIN)?;
        }
        UserCommand::Change { name, role, disable, enable } => {
            let (user, _) = (store.user(&name)?).ok_or_else(|| Error::missing("user", &name))?;
            let role = role.unwrap_or(user.role);
            let disabled = !enable && (disable || user.disabled);
            store.change_user(&name, role, disabled, by, ORIGIN)?;
        }
        UserCommand::Remove { name } => store.remove_user(&name, by, ORIGIN)?,
    }
    Ok(())
}

/// Reads a password: twice without echo at a terminal, otherwise the first line of standard input. It is never an argument, because every user of
/// the computer can see arguments.
fn read_password() -> Result<String, Error> {
    let text = if std::io::stdin().is_terminal() {
        let text = rpassword::prompt_password("Password: ")?;
        if text != rpassword::prompt_password("Once more: ")? {
            return Err(Error::Wrong("the two passwords differ".to_owned()));
        }
        text
    } else {
        let mut line = String::new();
        std::io::stdin().lock().read_line(&mut line)?;
        line.trim_end_matches(['\r', '\n']).to_owned()
    };
    hash(&Password::chosen(text)?)
}

fn search(arguments: &DiscoverArguments) -> Result<(), Error> {
    for subnet in &arguments.subnets {
        let checked = subnet.check(arguments.yes_these_are_mine);
        checked.map_err(|e| Error::Wrong(e.to_string()))?;
    }
    let mut search = Search::new(arguments.subnets.clone());
    search.per_second = arguments.rate;
    let stated = [
        (Kind::Focas, &arguments.focas_port),
        (Kind::OpcUa, &arguments.opc_ua_port),
        (Kind::Modbus, &arguments.modbus_port),
        (Kind::Gateway, &arguments.gateway_port),
    ];
    for (kind, ports) in stated {
        if !ports.is_empty() {
            search.ports.retain(|(known, _)| *known != kind);
            search.ports.extend(ports.iter().map(|port| (kind, *port)));
        }
    }
    let shows = std::io::stderr().is_terminal();
    let of = search.addresses();
    if shows {
        let seconds = search.connections() as f64 / arguments.rate;
        eprintln!("{of} addresses, about {seconds:.0} s");
    }
    let runtime =
        tokio::runtime::Builder::new_multi_thread().worker_threads(1).enable_all().build()?;
    let devices = runtime.block_on(search.run(|done| {
        if shows {
            // Standard error may be closed.
            let _ = write!(std::io::stderr(), "\r{done} of {of} ");
        }
    }));
    if shows {
        eprintln!();
    }
    if arguments.json { print_json(&devices) } else { print(&table(&devices)) }
}

mod arguments;
mod discover;
mod machines;
mod models;
mod rollouts;
mod run;
mod server;
mod text;
mod user;

pub use arguments::Arguments;

use std::{io::Write, path::Path, sync::Arc};

use crate::{Error, config::Config, keys::Key, store::Store};

use self::arguments::{Command, KeyCommand, MachineCommand, ModelCommand, RolloutCommand};

impl Arguments {
    pub fn act(self) -> Result<(), Error> {
        let config = || Config::read(&self.config);
        let by = self.by.clone().unwrap_or_else(os_user);
        match self.command {
            Command::Run { log } => run::run(&config()?, log),
            Command::Demo { listen } => run::demo(listen),
            Command::Discover(discover) => discover::act(&discover),
            Command::User(user) => user::act(&config()?, user, &by),
            Command::TlsInit { names, output } => {
                let [certificate, key] = volcomp_web::tls::make(&output, &names)?;
                print(&format!(
                    "tls_certificate = {:?}\ntls_key = {:?}\n",
                    shown(&certificate),
                    shown(&key)
                ))
            }
            Command::Check => run::check(&config()?),
            Command::NatsConfig { output } => server::nats_config(&config()?, output.as_deref()),
            Command::Audit { count, json } => server::audit(&config()?, count, json),
            Command::Alarms { all, json } => server::alarms(&config()?, all, json),
            Command::Key(KeyCommand::New { name }) => server::new_key(&config()?, &name),
            Command::Key(KeyCommand::List) => server::list_keys(&config()?),
            Command::Key(KeyCommand::Nkey { file }) => server::new_nkey(&file),
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
                rollouts::back(&config()?, &machine, &by)
            }
            Command::Model(ModelCommand::Drift { machine }) => models::drift(&config()?, &machine),
            Command::Rollout(RolloutCommand::Start(start)) => {
                rollouts::start(&config()?, &start, &by)
            }
            Command::Rollout(RolloutCommand::Status { id, json }) => {
                rollouts::status(&config()?, id, json)
            }
            Command::Rollout(RolloutCommand::Keep { id, machine }) => {
                rollouts::keep(&config()?, id, &machine, &by)
            }
            Command::Rollout(RolloutCommand::Request(request)) => {
                rollouts::request(&config()?, request, &by)
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

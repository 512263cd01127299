//! User commands on the centre's computer.

use std::{
    fmt::Write,
    io::{BufRead, IsTerminal},
};

use super::{arguments::UserCommand, open, print, print_json};
use crate::{
    Error,
    config::Config,
    users::{Password, hash},
};

/// Origin of a change in the audit log.
const ORIGIN: &str = "command line";

pub(super) fn act(config: &Config, command: UserCommand, by: &str) -> Result<(), Error> {
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

//! Users: added, listed, changed and removed on the computer of the centre.

use std::{
    fmt::Write,
    io::{BufRead, IsTerminal},
};

use clap::Subcommand;

use super::{CommandError, open, print, print_json};
use crate::{
    config::Config,
    store::Changed,
    users::{Password, Role, UserName, hash},
};

/// What is to be done with a user.
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

/// From where a change comes, in the audit log.
const HERE: &str = "command line";

pub(super) fn act(config: &Config, command: UserCommand, by: &str) -> Result<(), CommandError> {
    let store = open(config)?;
    let (name, changed) = match command {
        UserCommand::List { json } => {
            let users = store.users()?;
            if json {
                return print_json(&users);
            }
            let mut lines = String::new();
            for user in &users {
                let disabled = if user.disabled {
                    "  may not log in"
                } else {
                    ""
                };
                let (name, role) = (user.name.as_str(), user.role.name());
                // Writing to a string never fails.
                let _ = writeln!(lines, "{name:20}  {role:8}{disabled}");
            }
            return print(&lines);
        }
        UserCommand::Add { name, role } => {
            let hash = asked()?;
            match store.add_user(&name, role, &hash, by, HERE)? {
                Changed::No => {
                    return Err(CommandError::Wrong(format!(
                        "found a user {name} already, expected another name"
                    )));
                }
                other => (name, other),
            }
        }
        UserCommand::Password { name } => {
            let hash = asked()?;
            let changed = store.set_password(&name, &hash, by, HERE)?;
            (name, changed)
        }
        UserCommand::Change {
            name,
            role,
            disable,
            enable,
        } => match store.user(&name)? {
            Some((user, _)) => {
                let disabled = if enable {
                    false
                } else {
                    disable || user.disabled
                };
                let role = role.unwrap_or(user.role);
                let changed = store.change_user(&name, role, disabled, by, HERE)?;
                (name, changed)
            }
            None => (name, Changed::No),
        },
        UserCommand::Remove { name } => {
            let changed = store.remove_user(&name, by, HERE)?;
            (name, changed)
        }
    };
    match changed {
        Changed::Done => Ok(()),
        Changed::No => Err(CommandError::Wrong(format!("found no user {name}"))),
        Changed::LastAdmin => Err(CommandError::Wrong(format!(
            "{name} is the last admin who may log in: make another one first"
        ))),
    }
}

/// Asks for a password, twice at a terminal and without showing it; otherwise the first line of standard input. It is never an
/// argument: those can be seen by everybody on the computer.
fn asked() -> Result<String, CommandError> {
    let text = if std::io::stdin().is_terminal() {
        let text = rpassword::prompt_password("Password: ")?;
        if text != rpassword::prompt_password("Once more: ")? {
            return Err(CommandError::Wrong("the two passwords differ".to_owned()));
        }
        text
    } else {
        let mut line = String::new();
        std::io::stdin().lock().read_line(&mut line)?;
        line.trim_end_matches(['\r', '\n']).to_owned()
    };
    let wrong = |e: crate::users::PasswordError| CommandError::Wrong(e.to_string());
    hash(&Password::chosen(text).map_err(wrong)?).map_err(wrong)
}

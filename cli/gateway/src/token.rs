//! `token add`: a new line of a token file.

use std::{
    fs::{self, File, OpenOptions},
    io::{self, Write},
    os::unix::fs::OpenOptionsExt,
    path::{Path, PathBuf},
};

use crate::{
    error::GatewayError,
    http::{Role, Tokens},
};

/// The commands of `token`.
#[derive(Clone, Debug, clap::Subcommand)]
pub enum TokenCommand {
    /// Add a token to a token file, and print it once
    ///
    /// A new file has mode 0600. A gateway reads its token file when it starts.
    #[command(after_help = "Examples:
  volcomp-gateway token add anna --role operate --token-file tokens
  sudo volcomp-gateway token add anna --role engineer --token-file /etc/volcomp/tokens")]
    Add(AddArguments),
}

/// Options of `token add`.
#[derive(Clone, Debug, clap::Args)]
pub struct AddArguments {
    /// Name of the user or program, as in the audit log
    name: String,
    /// What the token allows
    #[arg(long, value_enum)]
    role: Role,
    /// The file with lines NAME ROLE TOKEN, mode 0600
    #[arg(long, value_name = "FILE")]
    token_file: PathBuf,
}

/// Adds a token to the file, and returns the token.
///
/// # Errors
/// The name is invalid or in use, or the file is invalid or cannot be written.
pub fn add(arguments: &AddArguments) -> Result<String, GatewayError> {
    let AddArguments { name, role, token_file } = arguments;
    let is_word = |c: char| !c.is_whitespace() && !c.is_control() && c != '#';
    if name.is_empty() || !name.chars().all(is_word) {
        return Err(GatewayError::invalid(format!(
            "NAME: found {name:?}, expected a name without blanks and #"
        )));
    }
    let failed = |e| GatewayError::system(token_file.display().to_string(), e);
    let mut separator = "";
    match Tokens::load(Some(token_file)) {
        Ok(tokens) if tokens.holders().any(|holder| holder.name == *name) => {
            return Err(GatewayError::invalid_in(
                token_file.display(),
                format_args!("the name {name} has a token: use another name, or remove its line"),
            ));
        }
        Ok(_) => {
            let text = fs::read(token_file).map_err(failed)?;
            if text.last().is_some_and(|byte| *byte != b'\n') {
                separator = "\n";
            }
        }
        // The file does not exist yet. Any other error is reported.
        Err(error) if token_file.symlink_metadata().is_ok() => return Err(error),
        Err(_) => drop(private_file(token_file).map_err(failed)?),
    }
    let token = secret()?;
    let line = format!("{separator}{name} {} {token}\n", role.name());
    let mut file = OpenOptions::new().append(true).open(token_file).map_err(failed)?;
    file.write_all(line.as_bytes()).and_then(|()| file.sync_all()).map_err(failed)?;
    Ok(token)
}

/// A new secret: 128 random bits as hexadecimal digits.
pub(crate) fn secret() -> Result<String, GatewayError> {
    let mut bytes = [0; 16];
    rustix::rand::getrandom(&mut bytes, rustix::rand::GetRandomFlags::empty())
        .map_err(|e| GatewayError::system("random numbers", e.into()))?;
    Ok(volcomp_model::hexadecimal(&bytes))
}

/// Creates a file that only its owner may read. Fails if the file exists.
pub(crate) fn private_file(path: &Path) -> io::Result<File> {
    let mut options = OpenOptions::new();
    options.write(true).create_new(true).mode(0o600).open(path)
}

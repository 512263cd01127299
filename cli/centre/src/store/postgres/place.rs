//! Where a PostgreSQL database is: what stands in the configuration, and what of it is let through.
//!
//! A password is never part of it: it stands in a file that its owner alone can read, and is read at each connection.

use std::{fmt, net::IpAddr, path::PathBuf, time::Duration};

use tokio_postgres::{
    Config,
    config::{Host, SslMode},
};

/// A server that does not answer for so long is not there.
const CONNECT_WITHIN: Duration = Duration::from_secs(10);
/// A connection on which nothing was acknowledged for so long is gone.
const SILENT: Duration = Duration::from_secs(30);

/// A PostgreSQL database and the way to it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PostgresPlace {
    /// Host, port, user, database; without a password.
    pub(super) config: Config,
    /// The file with the password, mode 0600; without: the server knows the user by other means.
    pub(super) password_file: Option<PathBuf>,
    /// Certificates that are trusted besides those of the system, PEM.
    pub(super) ca: Option<PathBuf>,
}

impl PostgresPlace {
    /// Reads a connection: `host=… user=… dbname=…`, or `postgresql://user@host/database`.
    ///
    /// # Errors
    /// What is wrong with it. The text itself is never repeated: somebody may have written a password into it.
    pub fn of(
        text: &str,
        password_file: Option<PathBuf>,
        ca: Option<PathBuf>,
    ) -> Result<Self, String> {
        if has_password(text) {
            return Err(
                "found a password, expected it in a file of its own (password_file, mode 0600)"
                    .to_owned(),
            );
        }
        let expected = "expected such as \"host=/run/postgresql user=volcomp dbname=volcomp\"";
        let mut config: Config = (text.parse())
            .map_err(|_| format!("found no connection to a PostgreSQL server, {expected}"))?;
        if config.get_password().is_some() {
            return Err(
                "found a password, expected it in a file of its own (password_file, mode 0600)"
                    .to_owned(),
            );
        }
        for (there, key) in [
            (
                !config.get_hosts().is_empty() || !config.get_hostaddrs().is_empty(),
                "host",
            ),
            (config.get_user().is_some(), "user"),
            (config.get_dbname().is_some(), "dbname"),
        ] {
            if !there {
                return Err(format!("found no {key}, {expected}"));
            }
        }
        let stays = stays_on_this_computer(&config);
        if !stays && config.get_ssl_mode() == SslMode::Disable {
            return Err(format!(
                "found sslmode=disable with {}, expected TLS towards another computer: without it everybody between reads and changes what is stored",
                hosts(&config)
            ));
        }
        // `prefer` would go on in the clear where somebody between says that there is no TLS.
        let encrypted = !stays || ca.is_some() || config.get_ssl_mode() == SslMode::Require;
        config
            .ssl_mode(if encrypted {
                SslMode::Require
            } else {
                SslMode::Disable
            })
            .connect_timeout(CONNECT_WITHIN)
            .tcp_user_timeout(SILENT)
            .keepalives_idle(SILENT);
        if config.get_application_name().is_none() {
            config.application_name("volcomp-centre");
        }
        Ok(Self {
            config,
            password_file,
            ca,
        })
    }

    /// Whether the connection is encrypted.
    pub fn is_encrypted(&self) -> bool {
        self.config.get_ssl_mode() == SslMode::Require
    }
}

/// Host, database and user, as people read it.
impl fmt::Display for PostgresPlace {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        // They are there: it was looked at where this was made.
        write!(
            f,
            "PostgreSQL on {}, database {}, user {}",
            hosts(&self.config),
            self.config.get_dbname().unwrap_or_default(),
            self.config.get_user().unwrap_or_default(),
        )
    }
}

/// Whether the text states a password, in either of its forms, even where it is no connection otherwise.
fn has_password(text: &str) -> bool {
    let folded = text.to_ascii_lowercase();
    let mut after_words = folded.split("password").skip(1);
    if after_words.any(|after| after.trim_start().starts_with('=')) {
        return true;
    }
    let after = folded.split_once("://").map(|(_, after)| after);
    let before_host = after.and_then(|after| after.rsplit_once('@'));
    before_host.is_some_and(|(user, _)| user.contains(':'))
}

fn stays_on_this_computer(config: &Config) -> bool {
    let local_name = |name: &String| {
        name == "localhost"
            || name
                .parse()
                .is_ok_and(|address: IpAddr| address.is_loopback())
    };
    // An address is what is connected to; the name beside it is then only that of the certificate.
    if !config.get_hostaddrs().is_empty() {
        return config.get_hostaddrs().iter().all(IpAddr::is_loopback);
    }
    config.get_hosts().iter().all(|host| match host {
        Host::Unix(_) => true,
        Host::Tcp(name) => local_name(name),
    })
}

fn hosts(config: &Config) -> String {
    let names = config.get_hosts().iter().map(|host| match host {
        Host::Tcp(name) => name.clone(),
        Host::Unix(folder) => folder.display().to_string(),
    });
    let mut names: Vec<String> = names.collect();
    if names.is_empty() {
        names.extend(config.get_hostaddrs().iter().map(IpAddr::to_string));
    }
    let ports = config.get_ports();
    let each = names.iter().enumerate().map(|(place, name)| {
        // One port is that of all hosts, as the library has it.
        let port = ports.get(place).or(ports.first()).copied().unwrap_or(5432);
        format!("{name}, port {port}")
    });
    each.collect::<Vec<_>>().join("; ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn of(text: &str) -> Result<PostgresPlace, String> {
        PostgresPlace::of(text, None, None)
    }

    #[test]
    fn nothing_goes_over_a_network_in_the_clear() {
        for (text, encrypted) in [
            ("host=/run/postgresql user=a dbname=b", false),
            ("host=127.0.0.1 user=a dbname=b", false),
            ("host=::1 user=a dbname=b", false),
            ("host=localhost user=a dbname=b", false),
            ("host=localhost user=a dbname=b sslmode=require", true),
            ("host=192.0.2.1 user=a dbname=b", true),
            ("host=192.0.2.1 user=a dbname=b sslmode=prefer", true),
            ("postgresql://a@db.example/b", true),
            ("host=localhost,db.example user=a dbname=b", true),
            // The address counts, not the name.
            ("host=localhost hostaddr=192.0.2.1 user=a dbname=b", true),
            (
                "host=db.example hostaddr=127.0.0.1 user=a dbname=b sslmode=disable",
                false,
            ),
        ] {
            assert_eq!(of(text).unwrap().is_encrypted(), encrypted, "{text}");
        }
        for text in [
            "host=192.0.2.1 user=a dbname=b sslmode=disable",
            "host=/run,db.example user=a dbname=b sslmode=disable",
            "host=localhost hostaddr=192.0.2.1 user=a dbname=b sslmode=disable",
        ] {
            assert!(of(text).unwrap_err().contains("expected TLS"), "{text}");
        }
        let ca = Some("ca.pem".into());
        let local = PostgresPlace::of("host=127.0.0.1 user=a dbname=b", None, ca);
        assert!(local.unwrap().is_encrypted());
    }

    #[test]
    fn a_password_is_refused_and_never_repeated() {
        for text in [
            "host=a user=b dbname=c password=hunter2",
            "host=a user=b dbname=c password = 'hunter2 hunter2'",
            "host=a PASSWORD=hunter2",
            "postgres://b:hunter2@a/c",
            "postgresql://b:hunter2@@a/c",
            "postgresql://b@a/c?password=hunter2",
            // A slip of the finger.
            "host=a user=b dbname=c pasword=hunter2",
            "host=a user=b hunter2",
        ] {
            let told = of(text).unwrap_err();
            assert!(!told.contains("hunter2"), "{told}");
        }
    }

    #[test]
    fn what_is_missing_is_named() {
        for (text, told) in [
            ("", "host"),
            ("user=a dbname=b", "host"),
            ("host=a dbname=b", "user"),
            ("host=a user=b", "dbname"),
            ("centre.db", "no connection"),
            ("host=a user=b dbname=c port=x", "no connection"),
        ] {
            assert!(of(text).unwrap_err().contains(told), "{text}");
        }
        let place = of("host=/run/postgresql user=a dbname=b port=5433").unwrap();
        let told = "PostgreSQL on /run/postgresql, port 5433, database b, user a";
        assert_eq!(place.to_string(), told);
    }
}

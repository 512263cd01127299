use rusqlite::{Connection, Row, params};
use serde_json::{Value as Json, json};

use crate::{
    Error,
    clock::now_s,
    store::{Store, audit, document, execute, first, json, number, rows},
    users::{BootTime, Role, Session, Token, User, UserName},
};

const COLUMNS: &str = "name, role, disabled, document, password";

fn user(row: &Row<'_>) -> Result<User, Error> {
    let document: Json = json(row, 3)?;
    Ok(User {
        name: serde_json::from_value(row.get::<_, String>(0)?.into())?,
        role: serde_json::from_value(row.get::<_, String>(1)?.into())?,
        disabled: row.get(2)?,
        added_s: serde_json::from_value(document["added_s"].clone())?,
        added_by: serde_json::from_value(document["added_by"].clone())?,
    })
}

/// Fails if no other admin may log in, because the users could then no longer be managed.
fn check_other_admin(database: &Connection, name: &UserName) -> Result<(), Error> {
    let sql = "SELECT count(*) FROM users WHERE role = 'admin' AND disabled = 0 AND name <> ?1";
    if number(database, sql, [name.as_str()])? > 0 {
        return Ok(());
    }
    Err(Error::Conflict(format!("{name} is the last admin who may log in: add another one first")))
}

/// True if the user may log in and still has the password hash `compared`. Passwords are verified outside of
/// transactions and after a delay, so the user may have been changed or removed since then.
fn is_current(database: &Connection, name: &UserName, compared: &str) -> Result<bool, Error> {
    let sql = "SELECT count(*) FROM users WHERE name = ?1 AND password = ?2 AND disabled = 0";
    Ok(number(database, sql, [name.as_str(), compared])? > 0)
}

/// Sets a password hash, and logs the user out everywhere.
fn set_password(
    database: &Connection,
    name: &UserName,
    password_hash: &str,
    by: &str,
    from: &str,
) -> Result<(), Error> {
    let sql = "UPDATE users SET password = ?2 WHERE name = ?1";
    let count = execute(database, sql, [name.as_str(), password_hash])?;
    let details = json!({ "from": from });
    changed(database, name, count, by, "user.password", details)
}

/// Completes a change of a user that affected `changed` rows: logs the user out everywhere and records the change.
fn changed(
    database: &Connection,
    name: &UserName,
    changed: usize,
    by: &str,
    action: &str,
    details: Json,
) -> Result<(), Error> {
    if changed == 0 {
        return Err(Error::missing("user", name));
    }
    execute(database, "DELETE FROM sessions WHERE name = ?1", [name.as_str()])?;
    audit::append(database, by, action, name.as_str(), details)
}

impl Store {
    /// Adds a user with a password hash.
    ///
    /// # Errors
    /// The user name is taken.
    pub fn add_user(
        &self,
        name: &UserName,
        role: Role,
        password_hash: &str,
        by: &str,
        from: &str,
    ) -> Result<(), Error> {
        let document = json!({ "added_s": now_s(), "added_by": by }).to_string();
        self.write(|database| {
            let added = execute(
                database,
                "INSERT INTO users (name, role, password, disabled, document) VALUES (?1, ?2, ?3, 0, ?4)
                 ON CONFLICT (name) DO NOTHING",
                [name.as_str(), role.name(), password_hash, &document],
            )?;
            if added == 0 {
                return Err(Error::Conflict(format!(
                    "found a user {name} already, expected another name"
                )));
            }
            let details = json!({ "role": role, "from": from });
            audit::append(database, by, "user.add", name.as_str(), details)
        })
    }

    /// Changes the role of a user, and whether the user may log in. Logs the user out.
    ///
    /// # Errors
    /// The user does not exist, or is the last admin who may log in.
    pub fn change_user(
        &self,
        name: &UserName,
        role: Role,
        disabled: bool,
        by: &str,
        from: &str,
    ) -> Result<(), Error> {
        self.write(|database| {
            if disabled || role != Role::Admin {
                check_other_admin(database, name)?;
            }
            let sql = "UPDATE users SET role = ?2, disabled = ?3 WHERE name = ?1";
            let count = execute(database, sql, params![name.as_str(), role.name(), disabled])?;
            let details = json!({ "role": role, "disabled": disabled, "from": from });
            changed(database, name, count, by, "user.change", details)
        })
    }

    /// Sets the password hash of a user, and logs the user out everywhere.
    ///
    /// # Errors
    /// The user does not exist.
    pub fn set_password(
        &self,
        name: &UserName,
        password_hash: &str,
        by: &str,
        from: &str,
    ) -> Result<(), Error> {
        self.write(|database| set_password(database, name, password_hash, by, from))
    }

    /// Replaces the password hash of a user whose password was verified against the hash `compared`, and logs the user
    /// out everywhere. Returns false without any change if the user's hash is no longer `compared`, or the user may not
    /// log in.
    pub fn replace_password(
        &self,
        name: &UserName,
        compared: &str,
        password_hash: &str,
        from: &str,
    ) -> Result<bool, Error> {
        self.write(|database| {
            if !is_current(database, name, compared)? {
                return Ok(false);
            }
            set_password(database, name, password_hash, name.as_str(), from)?;
            Ok(true)
        })
    }

    /// Removes a user.
    ///
    /// # Errors
    /// The user does not exist, or is the last admin who may log in.
    pub fn remove_user(&self, name: &UserName, by: &str, from: &str) -> Result<(), Error> {
        self.write(|database| {
            let sql = "DELETE FROM users WHERE name = ?1";
            let count = execute(database, sql, [name.as_str()])?;
            changed(database, name, count, by, "user.remove", json!({ "from": from }))?;
            check_other_admin(database, name)
        })
    }

    pub fn users(&self) -> Result<Vec<User>, Error> {
        let sql = format!("SELECT {COLUMNS} FROM users ORDER BY name");
        self.read(|database| rows(database, &sql, [], user))
    }

    pub fn user(&self, name: &UserName) -> Result<Option<(User, String)>, Error> {
        let sql = format!("SELECT {COLUMNS} FROM users WHERE name = ?1");
        self.read(|database| {
            first(database, &sql, [name.as_str()], |row| Ok((user(row)?, row.get(4)?)))
        })
    }

    /// Adds a session of a user whose password was verified against the hash `compared`. Returns false without any
    /// change if the user's hash is no longer `compared`, or the user may not log in.
    pub fn begin_session(
        &self,
        token: &Token,
        session: &Session,
        compared: &str,
    ) -> Result<bool, Error> {
        let document = serde_json::to_string(session)?;
        let user = session.user.as_str();
        self.write(|database| {
            if !is_current(database, &session.user, compared)? {
                return Ok(false);
            }
            // Delete expired sessions.
            let sql = "SELECT token_sha256, document FROM sessions";
            let sessions = rows(database, sql, [], |row| {
                Ok((row.get::<_, String>(0)?, json::<Session>(row, 1)))
            })?;
            for (token, known) in sessions {
                if !known.is_ok_and(|known| known.is_alive(&session.used)) {
                    execute(database, "DELETE FROM sessions WHERE token_sha256 = ?1", [token])?;
                }
            }
            execute(
                database,
                "INSERT INTO sessions (token_sha256, name, since_s, until_s, document) VALUES (?1, ?2, ?3, ?4, ?5)",
                params![
                    token.hash(),
                    user,
                    session.since.since_boot_s,
                    session.since.later(Session::MAX_DURATION).since_boot_s,
                    document,
                ],
            )?;
            audit::append(database, user, "login", user, json!({ "from": session.from }))?;
            Ok(true)
        })
    }

    /// The user of a valid session, if the user may log in. Updates the time of the session's last use.
    pub fn session(&self, token: &Token, now: &BootTime) -> Result<Option<User>, Error> {
        let hash = token.hash();
        let sql = "SELECT document FROM sessions WHERE token_sha256 = ?1";
        let found: Option<Session> = self.read(|database| document(database, sql, [&hash]))?;
        let Some(mut session) = found.filter(|session| session.is_alive(now)) else {
            return Ok(None);
        };
        if session.needs_last_use_update(now) {
            session.used = now.clone();
            let document = serde_json::to_string(&session)?;
            let sql = "UPDATE sessions SET document = ?2 WHERE token_sha256 = ?1";
            // On a full disk the page must still show the failure; at worst the session ends too early.
            if let Err(error) = self.write(|database| execute(database, sql, [&hash, &document])) {
                tracing::warn!("the last use of a session is not stored: {error}");
            }
        }
        let user = self.user(&session.user)?;
        Ok(user.map(|(user, _)| user).filter(|user| !user.disabled))
    }

    pub fn end_session(&self, token: &Token, by: &UserName) -> Result<(), Error> {
        self.write(|database| {
            let sql = "DELETE FROM sessions WHERE token_sha256 = ?1";
            execute(database, sql, [token.hash()])?;
            audit::append(database, by.as_str(), "logout", by.as_str(), json!({}))
        })
    }
}

//! Users and their sessions in the store.

use serde_json::json;

use super::{
    Store, StoreError, audit,
    database::{Database, Row},
};
use crate::{
    clock::now_s,
    users::{Moment, Role, Session, Token, User, UserName},
};

/// What of a user is in the document.
#[derive(serde::Serialize, serde::Deserialize)]
struct Document {
    added_s: f64,
    added_by: String,
}

const COLUMNS: &str = "name, role, disabled, document, password";

fn user(row: &Row) -> Result<User, StoreError> {
    let Document { added_s, added_by } = row.json(3)?;
    Ok(User {
        name: serde_json::from_value(row.text(0)?.into())?,
        role: serde_json::from_value(row.text(1)?.into())?,
        disabled: row.count(2)? != 0,
        added_s,
        added_by,
    })
}

/// Whether some admin may log in besides this user.
fn other_admin(database: &mut Database, name: &UserName) -> Result<bool, StoreError> {
    let row = database.first(
        "SELECT count(*) FROM users WHERE role = 'admin' AND disabled = 0 AND name <> ?1",
        &[name.as_str().into()],
    )?;
    Ok(row.map_or(Ok(0), |row| row.count(0))? > 0)
}

fn end_sessions(database: &mut Database, name: &UserName) -> Result<(), StoreError> {
    database.execute(
        "DELETE FROM sessions WHERE name = ?1",
        &[name.as_str().into()],
    )?;
    Ok(())
}

/// What became of a change of a user.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Changed {
    /// It is done.
    Done,
    /// There is no such user, or there is one already.
    No,
    /// Nobody could say who may do what any more: it was the last admin.
    LastAdmin,
}

impl Store {
    /// Adds a user with the hash of a password.
    ///
    /// # Errors
    /// The database takes no change (its disk is full, another program holds it, its server is gone); then nothing of it is changed.
    pub fn add_user(
        &self,
        name: &UserName,
        role: Role,
        password_hash: &str,
        by: &str,
        from: &str,
    ) -> Result<Changed, StoreError> {
        let document = serde_json::to_string(&Document {
            added_s: now_s(),
            added_by: by.to_owned(),
        })?;
        self.write(|database| {
            let added = database.execute(
                "INSERT INTO users (name, role, password, disabled, document) VALUES (?1, ?2, ?3, 0, ?4)
                 ON CONFLICT (name) DO NOTHING",
                &[
                    name.as_str().into(),
                    role.name().into(),
                    password_hash.into(),
                    document.into(),
                ],
            )?;
            if added == 0 {
                return Ok(Changed::No);
            }
            let details = json!({ "role": role, "from": from });
            audit::append(database, by, "user.add", name.as_str(), details)?;
            Ok(Changed::Done)
        })
    }

    /// Changes what a user may, and whether the user may log in. A user who may less is logged out.
    ///
    /// # Errors
    /// The database takes no change (its disk is full, another program holds it, its server is gone); then nothing of it is changed.
    pub fn change_user(
        &self,
        name: &UserName,
        role: Role,
        disabled: bool,
        by: &str,
        from: &str,
    ) -> Result<Changed, StoreError> {
        self.write(|database| {
            if (disabled || role != Role::Admin) && !other_admin(database, name)? {
                return Ok(Changed::LastAdmin);
            }
            let changed = database.execute(
                "UPDATE users SET role = ?2, disabled = ?3 WHERE name = ?1",
                &[name.as_str().into(), role.name().into(), disabled.into()],
            )?;
            if changed == 0 {
                return Ok(Changed::No);
            }
            end_sessions(database, name)?;
            let details = json!({ "role": role, "disabled": disabled, "from": from });
            audit::append(database, by, "user.change", name.as_str(), details)?;
            Ok(Changed::Done)
        })
    }

    /// Sets the hash of a user's password, and logs the user out everywhere.
    ///
    /// # Errors
    /// The database takes no change (its disk is full, another program holds it, its server is gone); then nothing of it is changed.
    pub fn set_password(
        &self,
        name: &UserName,
        password_hash: &str,
        by: &str,
        from: &str,
    ) -> Result<Changed, StoreError> {
        self.write(|database| {
            let changed = database.execute(
                "UPDATE users SET password = ?2 WHERE name = ?1",
                &[name.as_str().into(), password_hash.into()],
            )?;
            if changed == 0 {
                return Ok(Changed::No);
            }
            end_sessions(database, name)?;
            let details = json!({ "from": from });
            audit::append(database, by, "user.password", name.as_str(), details)?;
            Ok(Changed::Done)
        })
    }

    /// Removes a user.
    ///
    /// # Errors
    /// The database takes no change (its disk is full, another program holds it, its server is gone); then nothing of it is changed.
    pub fn remove_user(
        &self,
        name: &UserName,
        by: &str,
        from: &str,
    ) -> Result<Changed, StoreError> {
        self.write(|database| {
            let of = |row: Option<Row>| row.map(|row| user(&row)).transpose();
            let known = of(database.first(
                &format!("SELECT {COLUMNS} FROM users WHERE name = ?1"),
                &[name.as_str().into()],
            )?)?;
            if known.is_none() {
                return Ok(Changed::No);
            }
            if !other_admin(database, name)? {
                return Ok(Changed::LastAdmin);
            }
            database.execute("DELETE FROM users WHERE name = ?1", &[name.as_str().into()])?;
            end_sessions(database, name)?;
            audit::append(
                database,
                by,
                "user.remove",
                name.as_str(),
                json!({ "from": from }),
            )?;
            Ok(Changed::Done)
        })
    }

    /// Every user, by name.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn users(&self) -> Result<Vec<User>, StoreError> {
        self.read(|database| {
            let rows = database.rows(&format!("SELECT {COLUMNS} FROM users ORDER BY name"), &[])?;
            rows.iter().map(user).collect()
        })
    }

    /// A user and the hash of the password.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn user(&self, name: &UserName) -> Result<Option<(User, String)>, StoreError> {
        self.read(|database| {
            let row = database.first(
                &format!("SELECT {COLUMNS} FROM users WHERE name = ?1"),
                &[name.as_str().into()],
            )?;
            row.map(|row| Ok((user(&row)?, row.text(4)?.to_owned())))
                .transpose()
        })
    }

    /// Begins a session.
    ///
    /// # Errors
    /// The database takes no change (its disk is full, another program holds it, its server is gone); then nothing of it is changed.
    pub fn begin_session(&self, token: &Token, session: &Session) -> Result<(), StoreError> {
        let document = serde_json::to_string(session)?;
        self.write(|database| {
            // Those that have ended are of no use any more.
            let rows = database.rows("SELECT token_sha256, document FROM sessions", &[])?;
            for row in rows {
                let alive = row.json(1).is_ok_and(|known: Session| known.is_alive(&session.used));
                if !alive {
                    let key = [row.text(0)?.into()];
                    database.execute("DELETE FROM sessions WHERE token_sha256 = ?1", &key)?;
                }
            }
            database.execute(
                "INSERT INTO sessions (token_sha256, name, since_s, until_s, document) VALUES (?1, ?2, ?3, ?4, ?5)",
                &[
                    token.hash().into(),
                    session.user.as_str().into(),
                    session.since.since_boot_s.into(),
                    session.since.later(Session::LONGEST).since_boot_s.into(),
                    document.into(),
                ],
            )?;
            let details = json!({ "from": session.from });
            audit::append(database, session.user.as_str(), "login", session.user.as_str(), details)
        })
    }

    /// The user whose session this is, while it is alive and the user may log in. Its use is noted.
    ///
    /// # Errors
    /// The database takes no change (its disk is full, another program holds it, its server is gone); then nothing of it is changed.
    pub fn session(&self, token: &Token, now: &Moment) -> Result<Option<User>, StoreError> {
        let hash = token.hash();
        let key = || [hash.as_str().into()];
        let found = self.read(|database| {
            let row = database.first(
                "SELECT document FROM sessions WHERE token_sha256 = ?1",
                &key(),
            )?;
            row.map(|row| row.json::<Session>(0)).transpose()
        })?;
        let Some(session) = found.filter(|session| session.is_alive(now)) else {
            return Ok(None);
        };
        if session.is_to_be_noted(now) {
            let used = Session {
                used: now.clone(),
                ..session.clone()
            };
            let document = serde_json::to_string(&used)?;
            self.write(|database| {
                database.execute(
                    "UPDATE sessions SET document = ?2 WHERE token_sha256 = ?1",
                    &[hash.as_str().into(), document.into()],
                )
            })?;
        }
        let user = self.user(&session.user)?;
        Ok(user.map(|(user, _)| user).filter(|user| !user.disabled))
    }

    /// Ends a session.
    ///
    /// # Errors
    /// The database takes no change (its disk is full, another program holds it, its server is gone); then nothing of it is changed.
    pub fn end_session(&self, token: &Token, by: &UserName) -> Result<(), StoreError> {
        self.write(|database| {
            database.execute(
                "DELETE FROM sessions WHERE token_sha256 = ?1",
                &[token.hash().into()],
            )?;
            audit::append(database, by.as_str(), "logout", by.as_str(), json!({}))
        })
    }
}

//! Models, and the versions that were issued of them.

use serde_json::json;
use volcomp_fleet::{Acknowledgement, MachineId};

use super::{
    Store, StoreError, audit,
    database::{Database, Row},
};
use crate::records::{Live, Model, Version};

impl Store {
    /// Adds a model with its text. Tells whether it is new. Of one that is there already the day of its measurements is taken,
    /// where one is stated.
    ///
    /// # Errors
    /// The database takes no change (its disk is full, another program holds it, its server is gone); then nothing of it is changed.
    pub fn add_model(&self, model: &Model, text: &str) -> Result<bool, StoreError> {
        let document = serde_json::to_string(model)?;
        self.write(|database| {
            let added = database.execute(
                "INSERT INTO models (sha256, document, text) VALUES (?1, ?2, ?3) ON CONFLICT (sha256) DO NOTHING",
                &[model.sha256.as_str().into(), document.into(), text.into()],
            )?;
            if added > 0 {
                audit::append(database, &model.by, "model.add", &model.sha256, json!(model))?;
                return Ok(true);
            }
            let known = model_of(database, &model.sha256)?;
            if let Some(known) = known.filter(|known| {
                !model.measured.is_empty() && known.measured != model.measured
            }) {
                let details = json!({ "before": known.measured, "measured": model.measured });
                let dated = Model {
                    measured: model.measured.clone(),
                    ..known
                };
                database.execute(
                    "UPDATE models SET document = ?2 WHERE sha256 = ?1",
                    &[
                        dated.sha256.as_str().into(),
                        serde_json::to_string(&dated)?.into(),
                    ],
                )?;
                audit::append(database, &model.by, "model.measured", &model.sha256, details)?;
            }
            Ok(false)
        })
    }

    /// The model whose checksum begins so; `None`: there is none, or more than one.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn model(&self, beginning: &str) -> Result<Option<Model>, StoreError> {
        if beginning.is_empty() || !beginning.bytes().all(|byte| byte.is_ascii_hexdigit()) {
            return Ok(None);
        }
        self.read(|database| {
            let rows = database.rows(
                "SELECT document FROM models WHERE sha256 LIKE ?1 LIMIT 2",
                &[format!("{}%", beginning.to_ascii_lowercase()).into()],
            )?;
            match rows.as_slice() {
                [row] => Ok(Some(row.json(0)?)),
                _ => Ok(None),
            }
        })
    }

    /// The text of the model with this checksum.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn model_text(&self, sha256: &str) -> Result<Option<String>, StoreError> {
        self.read(|database| text_of(database, sha256))
    }

    /// Every model, the newest first.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn models(&self) -> Result<Vec<Model>, StoreError> {
        let mut models: Vec<Model> = self.read(|database| {
            let rows = database.rows("SELECT document FROM models", &[])?;
            rows.iter().map(|row| row.json(0)).collect()
        })?;
        models.sort_by(|one, other| other.added_s.total_cmp(&one.added_s));
        Ok(models)
    }

    /// Every version of a machine, the newest first.
    ///
    /// # Errors
    /// The database cannot be read (its file or its server is gone), or a row holds what this program does not write.
    pub fn versions(&self, machine: &MachineId) -> Result<Vec<Version>, StoreError> {
        self.read(|database| versions_of(database, machine))
    }
}

/// The text of a model, as it stands in a transaction.
pub(crate) fn text_of(database: &mut Database, sha256: &str) -> Result<Option<String>, StoreError> {
    let row = database.first(
        "SELECT text FROM models WHERE sha256 = ?1",
        &[sha256.into()],
    )?;
    row.map(|row| row.text(0).map(str::to_owned)).transpose()
}

/// A model by its whole checksum, as it stands in a transaction.
pub(crate) fn model_of(database: &mut Database, sha256: &str) -> Result<Option<Model>, StoreError> {
    let row = database.first(
        "SELECT document FROM models WHERE sha256 = ?1",
        &[sha256.into()],
    )?;
    row.map(|row| row.json(0)).transpose()
}

/// Every version of a machine, the newest first, as it stands in a transaction.
pub(crate) fn versions_of(
    database: &mut Database,
    machine: &MachineId,
) -> Result<Vec<Version>, StoreError> {
    let rows = database.rows(
        "SELECT document FROM versions WHERE machine = ?1 ORDER BY version DESC",
        &[machine.as_str().into()],
    )?;
    rows.iter().map(|row| row.json(0)).collect()
}

/// A name of a machine in a column.
pub(super) fn machine(row: &Row, column: usize) -> Result<MachineId, StoreError> {
    row.text(column)?.parse().map_err(|_| StoreError::Column {
        column,
        found: format!("{:?}", row.0.get(column)),
        expected: "the name of a machine",
    })
}

/// What a machine told last, as it stands in a transaction.
pub(crate) fn live_of(
    database: &mut Database,
    machine: &MachineId,
) -> Result<Option<Live>, StoreError> {
    let row = database.first(
        "SELECT document FROM live WHERE machine = ?1",
        &[machine.as_str().into()],
    )?;
    row.map(|row| row.json(0)).transpose()
}

/// A version that a machine tells is believed up to here: above it must be room for every version that will ever be issued.
const HIGHEST_TOLD: u64 = 1 << 52;

/// The version that the next manifest of a machine gets: above every one that was issued here, and above the one that the
/// machine says is in force, which another centre may have issued. A machine may tell
/// anything: what no centre can have issued does not count.
pub(crate) fn next_version(
    database: &mut Database,
    machine: &MachineId,
) -> Result<u64, StoreError> {
    let name = || [machine.as_str().into()];
    let issued = database.first(
        "SELECT coalesce(max(version), 0) FROM versions WHERE machine = ?1",
        &name(),
    )?;
    let issued = issued.map_or(Ok(0), |row| row.count(0))?;
    let live = live_of(database, machine)?;
    let told = live.map_or(0, |live| live.version);
    let highest = issued.max(if told <= HIGHEST_TOLD { told } else { 0 });
    let next = highest
        .checked_add(1)
        .filter(|next| i64::try_from(*next).is_ok());
    next.ok_or_else(|| StoreError::Column {
        column: 0,
        found: format!("version {highest} of {machine}"),
        expected: "a version above which there is another",
    })
}

/// Adds a version with its signed value, which takes the place of the one before.
pub(crate) fn add_version(
    database: &mut Database,
    version: &Version,
    value: &str,
) -> Result<(), StoreError> {
    let machine = || version.machine.as_str().into();
    database.execute(
        "INSERT INTO versions (machine, version, model, rollout, value_sha256, document)
         VALUES (?1, ?2, ?3, ?4, ?5, ?6)",
        &[
            machine(),
            version.version.into(),
            version.model.as_str().into(),
            version.rollout.into(),
            version.value_sha256.as_str().into(),
            serde_json::to_string(version)?.into(),
        ],
    )?;
    database.execute(
        "INSERT INTO desired (machine, version, model, value) VALUES (?1, ?2, ?3, ?4)
         ON CONFLICT (machine) DO UPDATE SET version = excluded.version, model = excluded.model, value = excluded.value",
        &[
            machine(),
            version.version.into(),
            version.model.as_str().into(),
            value.into(),
        ],
    )?;
    audit::append(
        database,
        &version.by,
        "version.issue",
        version.machine.as_str(),
        json!(version),
    )
}

/// Writes an answer of a machine to the version that it answers. An answer to a value that was never issued here changes no
/// version.
pub(crate) fn answer(
    database: &mut Database,
    machine: &MachineId,
    at_s: f64,
    answer: &Acknowledgement,
) -> Result<(), StoreError> {
    database.execute(
        "INSERT INTO acknowledgements (machine, at_s, version, document) VALUES (?1, ?2, ?3, ?4)",
        &[
            machine.as_str().into(),
            at_s.into(),
            answer.version.into(),
            serde_json::to_string(answer)?.into(),
        ],
    )?;
    let key = || [machine.as_str().into(), answer.value_sha256.as_str().into()];
    let row = database.first(
        "SELECT document FROM versions WHERE machine = ?1 AND value_sha256 = ?2",
        &key(),
    )?;
    let Some(row) = row else { return Ok(()) };
    let mut version: Version = row.json(0)?;
    version.outcome = Some(answer.outcome.clone());
    version.answered_s = Some(at_s);
    change_version(database, &version)
}

/// Writes what became of a version.
pub(crate) fn change_version(database: &mut Database, version: &Version) -> Result<(), StoreError> {
    database.execute(
        "UPDATE versions SET document = ?3 WHERE machine = ?1 AND version = ?2",
        &[
            version.machine.as_str().into(),
            version.version.into(),
            serde_json::to_string(version)?.into(),
        ],
    )?;
    Ok(())
}

//! Which error of the machine each displacement is.

use volcomp_model::ErrorName;
use volcomp_vocabulary::AxisKind;

use super::{columns::displacement, is_angular};
use crate::failure::Failure;

/// The error of a lone displacement of which nothing is said: most thermal tests are of a spindle along Z.
const OF_ONE: &str = "EZZ";

/// What `--error` says: `EZZ` for every displacement, or `dz_um=EZZ` for one.
pub(super) struct Errors {
    of_all: Option<ErrorName>,
    of_one: Vec<(String, ErrorName)>,
}

impl Errors {
    /// Reads what the call says.
    pub(super) fn read(stated: &[String]) -> Result<Self, Failure> {
        let mut errors = Self {
            of_all: None,
            of_one: Vec::new(),
        };
        for text in stated {
            let (column, name) = match text.rsplit_once('=') {
                Some((column, name)) => (Some(displacement(column.trim())), name.trim()),
                None => (None, text.trim()),
            };
            let error: ErrorName = name
                .parse()
                .map_err(|e| Failure::Input(format!("--error: {e}")))?;
            if error.location {
                return Err(Failure::Input(format!(
                    "--error {text}: found a location error, expected an error motion, such as {}: a machine file takes thermal terms of these only",
                    ErrorName::motion(error.component, error.axis)
                )));
            }
            let is_twice = match column {
                Some(column) => {
                    let known = errors.of_one.iter().any(|(known, _)| *known == column);
                    errors.of_one.push((column, error));
                    known
                }
                None => errors.of_all.replace(error).is_some(),
            };
            if is_twice {
                return Err(Failure::Input(format!(
                    "--error {text}: found a second error for the same displacement, expected COLUMN=ERROR once for each"
                )));
            }
        }
        Ok(errors)
    }

    /// The error of each displacement that is fitted; `None` where the call does not say it.
    pub(super) fn of(&self, names: &[&str]) -> Result<Vec<Option<ErrorName>>, Failure> {
        let unknown = |(column, _): &&(String, ErrorName)| !names.contains(&column.as_str());
        if let Some((column, error)) = self.of_one.iter().find(unknown) {
            return Err(Failure::Input(format!(
                "--error {column}={error}: found no displacement {column} to fit, expected one of {}",
                names.join(", ")
            )));
        }
        names
            .iter()
            .map(|name| self.of_column(name, names))
            .collect()
    }

    fn of_column(&self, name: &str, names: &[&str]) -> Result<Option<ErrorName>, Failure> {
        let fits = |error: &ErrorName| error.component.is_angular() == is_angular(name);
        let own = self.of_one.iter().find(|(column, _)| column == name);
        if let Some(error) = own.map(|(_, error)| *error).or(self.of_all) {
            if fits(&error) {
                return Ok(Some(error));
            }
            if own.is_some() || names.len() == 1 {
                let (found, expected) = if is_angular(name) {
                    ("µrad", "an angular error motion")
                } else {
                    ("µm", "a linear error motion")
                };
                return Err(Failure::Input(format!(
                    "--error: found {error} for {name}, which is in {found}: expected {expected}"
                )));
            }
            return Ok(None);
        }
        let of_one = OF_ONE.parse().ok().filter(fits);
        Ok(of_one.filter(|_| names.len() == 1))
    }

    /// A note where one error is stated for several displacements.
    pub(super) fn note(&self, of: &[Option<ErrorName>], names: &[&str]) -> Option<String> {
        let error = self.of_all?;
        let alike = of.iter().filter(|found| **found == Some(error)).count();
        (alike > 1).then(|| {
            format!(
                "{error} is taken for {alike} displacements, and a machine file takes the terms of one of them: name the error of each, `--error {}={error}`",
                names.first().copied().unwrap_or_default()
            )
        })
    }
}

/// Whether an error grows with the position of its axis, so that expansion may be looked for.
pub(super) fn may_expand(error: Option<ErrorName>) -> Option<ErrorName> {
    error.filter(|e| e.axis.kind() == AxisKind::Linear && !e.component.is_angular())
}

//! Columns of a row file by name, and rejection of names that resemble expected ones.

use volcomp_document::{Column, CsvTable, InputError, quoted, split_head, unit_named};
use volcomp_model::axis_of_head;
use volcomp_vocabulary::AxisName;

/// Columns of a table by exact name: `X` is an axis, `x` a coordinate of a target.
pub(crate) struct Columns<'t> {
    pub(crate) table: &'t CsvTable,
    /// Names requested so far.
    pub(crate) used: Vec<String>,
}

impl Columns<'_> {
    pub(crate) fn get(&mut self, name: &str) -> Result<Option<Column>, InputError> {
        self.used.push(name.to_owned());
        let mut named = self.table.columns().filter(|(_, found)| *found == name);
        let first = named.next().map(|(column, _)| column);
        match named.next() {
            Some(_) => Err(self
                .table
                .header_error(format!("column `{name}` stands twice"))),
            None => Ok(first),
        }
    }

    /// Column of an axis: its letter, alone or with the unit (`X`, `X mm`, `X_mm`, `C [deg]`).
    pub(crate) fn axis(&mut self, axis: AxisName) -> Result<Option<Column>, InputError> {
        self.alone_or(&axis.to_string(), |found| axis_of_head(found) == Some(axis))
    }

    /// Name of the column of an axis, alone or with any unit, requested or not.
    pub(crate) fn named_like(&self, axis: AxisName) -> Option<&str> {
        let letter = axis.to_string();
        let is_axis = |found: &str| without_unit(found) == Some(letter.as_str());
        let mut names = self.table.names().map(|(_, name)| name);
        names.find(|name| is_axis(name))
    }

    /// Column of a name, alone or with its fixed unit.
    fn with_unit(&mut self, name: &str, unit: &str) -> Result<Option<Column>, InputError> {
        self.alone_or(name, |found| {
            let (stem, found) = split_head(found);
            stem == name && unit_named(found) == Some(unit)
        })
    }

    /// Column of this name, or of an equivalent one according to `means_it`.
    fn alone_or(
        &mut self,
        name: &str,
        means_it: impl Fn(&str) -> bool,
    ) -> Result<Option<Column>, InputError> {
        let names = || self.table.names().map(|(_, name)| name);
        let mut others = names()
            .filter(|found| *found != name && means_it(found))
            .map(str::to_owned);
        let Some(with_unit) = others.next() else {
            return self.get(name);
        };
        let alone = names().find(|found| *found == name).map(str::to_owned);
        if let Some(other) = alone.or_else(|| others.next()) {
            return Err(self.table.header_error(format!(
                "found columns `{other}` and `{with_unit}`, expected one of them"
            )));
        }
        self.get(&with_unit)
    }

    /// Columns that were not requested.
    pub(crate) fn unused(&self) -> Vec<&str> {
        let names = self.table.names().map(|(_, name)| name);
        names
            .filter(|name| !self.used.iter().any(|used| used == name))
            .collect()
    }

    /// Rejects an unused column whose name resembles a missing one, in other letters or with another unit: `a` for `A`,
    /// `X [mm]` for `X`, `dx_mm` for `dx_um`. If it were ignored, its axis would be taken as zero.
    pub(crate) fn refuse_lookalikes(&self) -> Result<(), InputError> {
        let is_there = |name: &str| self.table.names().any(|(_, found)| found == name);
        for found in self.unused() {
            // `X_actual`, `X MCS` and `Xmm` are columns of X, whatever follows the letter.
            let axis = axis_named_first(found).filter(|axis| {
                let mut names = self.table.names().map(|(_, name)| name);
                self.used.contains(&axis.to_string())
                    && !names.any(|name| axis_of_head(name) == Some(*axis))
            });
            if let Some(axis) = axis {
                return Err(self.table.header_error(format!(
                    "found a column {}, expected `{axis}`, alone or with its unit: without it the axis would stand at 0",
                    quoted(found)
                )));
            }
            let Some(stem) = without_unit(found) else {
                continue;
            };
            let missing = || self.used.iter().filter(|name| !is_there(name));
            let stem_of = |name: &String| split_head(name).0.to_owned();
            // `z_mm` matches a target's `z` before the axis `Z`.
            let meant = missing()
                .find(|name| stem_of(name) == stem)
                .or_else(|| missing().find(|name| stem_of(name).eq_ignore_ascii_case(stem)));
            if let Some(meant) = meant {
                return Err(self.table.header_error(format!(
                    "found a column {}, expected `{meant}`: names and units of columns are read letter by letter",
                    quoted(found)
                )));
            }
        }
        Ok(())
    }

    /// Column of a required name.
    pub(crate) fn require(&mut self, name: &str) -> Result<Column, InputError> {
        let column = self.get(name)?;
        self.found(name, column)
    }

    /// Column of a required length, alone or with its unit: `x`, `x mm`, `x_mm`.
    pub(crate) fn require_mm(&mut self, name: &str) -> Result<Column, InputError> {
        let column = self.with_unit(name, "mm")?;
        self.found(name, column)
    }

    /// Returns a column that was searched for under a name, or rejects the file if it is missing.
    pub(crate) fn found(&self, name: &str, column: Option<Column>) -> Result<Column, InputError> {
        if column.is_none() {
            self.refuse_lookalikes()?;
        }
        column.ok_or_else(|| {
            let found: Vec<&str> = self.table.names().map(|(_, name)| name).collect();
            let found = quoted(&found.join(","));
            self.table
                .header_error(format!("found {found}, expected a column `{name}`"))
        })
    }
}

/// Name of a column without its unit; `None` if the suffix is not a unit.
fn without_unit(head: &str) -> Option<&str> {
    let (name, unit) = split_head(head);
    (unit.is_empty() || unit_named(unit).is_some()).then_some(name)
}

/// The axis whose letter begins a head, followed by a unit or by no letter or digit: `X_actual`, `X MCS`, `Xmm`.
fn axis_named_first(head: &str) -> Option<AxisName> {
    let (letter, behind) = head.split_at_checked(1)?;
    let is_word = behind.starts_with(char::is_alphanumeric) && unit_named(behind).is_none();
    letter.parse().ok().filter(|_| !is_word)
}

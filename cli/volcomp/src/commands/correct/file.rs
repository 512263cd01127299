//! Corrections as a CSV file: the columns that were read, then corrected positions, corrections and what they leave.

use csv::WriterBuilder;
use volcomp_document::{Column, CsvTable};
use volcomp_model::Machine;
use volcomp_vocabulary::AxisName;

use super::{CorrectionAt, norm};
use crate::{
    commands::{not_counted::NotCounted, outside::joined},
    failure::Failure,
    table::fixed,
};

/// The columns of the file. Separator and decimal mark are those of the table that was read.
pub(super) struct Columns<'t> {
    table: Option<&'t CsvTable>,
    /// The columns of the table that are written as they were read.
    carried: Vec<(Column, &'t str)>,
    /// The names of columns of the table in whose place new ones are written.
    replaced: Vec<&'t str>,
    /// The axes in the order of their columns.
    axes: Vec<AxisName>,
    /// Whether uncertainties are written.
    uncertain: bool,
}

impl<'t> Columns<'t> {
    /// The columns for a machine, with those of the table that was read.
    pub(super) fn new(machine: &Machine, table: Option<&'t CsvTable>, uncertain: bool) -> Self {
        let mut axes: Vec<AxisName> = machine.axes().iter().map(|axis| axis.name).collect();
        axes.sort_unstable();
        let written = written(&axes, uncertain);
        let read = table.map(CsvTable::columns).into_iter().flatten();
        let (replaced, carried): (Vec<_>, Vec<_>) =
            read.partition(|(_, name)| written.iter().any(|new| new.eq_ignore_ascii_case(name)));
        Self {
            table,
            carried,
            replaced: replaced.into_iter().map(|(_, name)| name).collect(),
            axes,
            uncertain,
        }
    }

    /// Says which columns of the table are not carried over because new ones have their names.
    pub(super) fn replaced_note(&self) -> Option<String> {
        (!self.replaced.is_empty()).then(|| {
            let names = self.replaced.join(", ");
            format!("columns of --points that are computed anew: {names}")
        })
    }

    /// The file: one row for each correction.
    pub(super) fn csv(&self, corrections: &[CorrectionAt]) -> Result<Vec<u8>, Failure> {
        // `,`, `;` and the tab are one byte each.
        let separator = self.table.map_or(',', CsvTable::separator);
        let mut writer = WriterBuilder::new()
            .delimiter(u8::try_from(separator).unwrap_or(b','))
            .from_writer(Vec::new());
        let failed = |e: csv::Error| Failure::Work(format!("the CSV file: {e}"));
        writer.write_record(self.header()).map_err(failed)?;
        let mut read = self.table.map(CsvTable::rows);
        for correction in corrections {
            let row = read.as_mut().and_then(Iterator::next);
            let mut cells: Vec<String> = match row {
                Some(row) => {
                    let carried = self.carried.iter();
                    carried
                        .map(|(column, _)| row.cell(*column).text().to_owned())
                        .collect()
                }
                None => self.numbers(correction.command.values()),
            };
            cells.extend(self.numbers(correction.corrected.values()));
            cells.extend(self.numbers(correction.correction.values()));
            if let Some(uncertainty) = &correction.uncertainty {
                cells.extend(self.numbers(uncertainty.values()));
            }
            if let Some(not_counted) = &correction.not_counted {
                let told: Vec<String> = not_counted.iter().map(|of| self.told(of)).collect();
                cells.push(told.join(" / "));
            }
            cells.push(self.number(norm(&correction.residual_um)));
            cells.push(self.number(norm(&correction.residual_axis_urad)));
            cells.push(correction.singular.to_string());
            cells.push(joined(&correction.outside.outside_range));
            cells.push(joined(&correction.outside.outside_travel));
            writer.write_record(cells).map_err(failed)?;
        }
        let written = writer.into_inner();
        written.map_err(|e| Failure::Work(format!("the CSV file: {}", e.error())))
    }

    fn header(&self) -> Vec<String> {
        let mut header: Vec<String> = if self.table.is_some() {
            let names = self.carried.iter().map(|(_, name)| (*name).to_owned());
            names.collect()
        } else {
            let axes = self.axes.iter();
            axes.map(|axis| format!("{axis}_{}", axis.kind().coordinate_unit()))
                .collect()
        };
        header.extend(written(&self.axes, self.uncertain));
        header
    }

    fn numbers<'a>(&self, values: impl Iterator<Item = &'a f64>) -> Vec<String> {
        values.map(|value| self.number(*value)).collect()
    }

    /// What an error that the uncertainty does not count moves the tool by here.
    fn told(&self, of: &NotCounted) -> String {
        format!(
            "{} {} um per {} {}",
            of.unknown,
            self.number((of.moves_um * 1e3).round() / 1e3),
            of.size,
            of.unit
        )
    }

    fn number(&self, value: f64) -> String {
        let text = fixed(value, 9);
        let text = if text.contains('e') {
            text.as_str()
        } else {
            text.trim_end_matches('0').trim_end_matches('.')
        };
        if self.table.is_some_and(CsvTable::has_decimal_comma) {
            text.replace('.', ",")
        } else {
            text.to_owned()
        }
    }
}

/// The names of the columns that are computed.
fn written(axes: &[AxisName], uncertain: bool) -> Vec<String> {
    let corrected = axes
        .iter()
        .map(|axis| format!("{axis}_corrected_{}", axis.kind().coordinate_unit()));
    let correction = axes.iter().map(|axis| {
        let unit = axis.kind().micro_unit();
        format!("{axis}_correction_{unit}")
    });
    let uncertainty = axes.iter().filter(|_| uncertain).map(|axis| {
        let unit = axis.kind().micro_unit();
        format!("{axis}_u_correction_{unit}")
    });
    let not_counted = uncertain.then(|| "u_not_counted".to_owned());
    let others = [
        "residual_um",
        "residual_axis_urad",
        "singular",
        "outside_range",
        "outside_travel",
    ];
    corrected
        .chain(correction)
        .chain(uncertainty)
        .chain(not_counted)
        .chain(others.map(str::to_owned))
        .collect()
}

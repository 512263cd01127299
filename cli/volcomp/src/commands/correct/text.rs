//! Corrections for people: an axis a line for one position, a position a line for many.

use std::{collections::BTreeSet, fmt::Write};

use volcomp_model::Machine;
use volcomp_vocabulary::AxisName;

use super::{CorrectionAt, norm};
use crate::{
    commands::{
        ByAxis,
        not_counted::{NotCounted, words},
        outside::remarks,
    },
    table::{fixed, folded, table, table_text},
};

/// The text for people. `rotary` is how many rotary axes may move.
pub(super) fn text(machine: &Machine, rows: &[CorrectionAt], rotary: usize) -> String {
    match rows {
        [row] => one(row, rotary),
        _ => many(machine, rows, rotary),
    }
}

fn one(row: &CorrectionAt, rotary: usize) -> String {
    let mut header = vec!["axis", "command", "correction", "corrected", ""];
    if row.uncertainty.is_some() {
        header.push("u");
    }
    let mut axes = table(&header);
    for (&name, correction) in &row.correction {
        let number = |values: &ByAxis, digits| {
            let value = values.get(&name).copied().unwrap_or(0.0);
            fixed(value, digits)
        };
        let mut cells = vec![
            name.to_string(),
            number(&row.command, 4),
            format!("{} {}", fixed(*correction, 3), name.kind().micro_symbol()),
            number(&row.corrected, 6),
            name.kind().coordinate_unit().to_owned(),
        ];
        if let Some(uncertainty) = &row.uncertainty {
            let symbol = name.kind().micro_symbol();
            cells.push(format!("{} {symbol}", number(uncertainty, 3)));
        }
        axes.add_row(cells);
    }
    let mut text = table_text(&axes);
    // Writing to a string never fails.
    let _ = write!(
        text,
        "\nresidual {} µm, tool axis {} µrad{}",
        fixed(norm(&row.residual_um), 3),
        fixed(norm(&row.residual_axis_urad), 3),
        if is_singular(row, rotary) {
            " (singular: not fully correctable here)"
        } else if row.near_singular {
            " (near a singular pose: large rotary corrections)"
        } else {
            ""
        }
    );
    text.push('\n');
    let outside = row.outside.words();
    let not_counted = words(row.not_counted.as_deref().unwrap_or_default(), "here");
    for sentence in [outside, not_counted] {
        if !sentence.is_empty() {
            text += &folded(&sentence, "");
        }
    }
    text
}

fn many(machine: &Machine, rows: &[CorrectionAt], rotary: usize) -> String {
    let mut names: Vec<AxisName> = machine.axes().iter().map(|axis| axis.name).collect();
    names.sort_unstable();
    let mut header = vec![String::new()];
    header.extend(
        names
            .iter()
            .map(|name| format!("{name} {}", name.kind().micro_symbol())),
    );
    if rows.iter().any(|row| row.uncertainty.is_some()) {
        let uncertain = names.iter();
        header.extend(uncertain.map(|name| format!("u {name} {}", name.kind().micro_symbol())));
    }
    header.extend(["residual µm", "axis µrad"].map(str::to_owned));
    let mut table = table(&header.iter().map(String::as_str).collect::<Vec<_>>());
    for (index, row) in rows.iter().enumerate() {
        let mut cells = vec![(index + 1).to_string()];
        cells.extend(row.correction.values().map(|value| fixed(*value, 3)));
        if let Some(uncertainty) = &row.uncertainty {
            cells.extend(uncertainty.values().map(|value| fixed(*value, 3)));
        }
        cells.push(fixed(norm(&row.residual_um), 3));
        cells.push(fixed(norm(&row.residual_axis_urad), 3));
        table.add_row(cells);
    }
    let said = rows.iter().map(|row| {
        let singular = if is_singular(row, rotary) {
            Some("singular, the tool axis is not fully correctable")
        } else {
            row.near_singular
                .then_some("near singular, rotary corrections are large")
        };
        let singular = singular.map(str::to_owned);
        let parts = singular.into_iter().chain([row.outside.words()]);
        let parts: Vec<String> = parts.filter(|part| !part.is_empty()).collect();
        parts.join("; ")
    });
    let not_counted = worst(rows);
    let not_counted = words(&not_counted, "at one of these positions");
    let mut text = table_text(&table) + &remarks(said);
    if !not_counted.is_empty() {
        text += &folded(&not_counted, "");
    }
    text
}

/// What the uncertainties do not count, each at the position where it moves the tool most.
fn worst(rows: &[CorrectionAt]) -> Vec<NotCounted> {
    let mut all: Vec<NotCounted> = rows
        .iter()
        .filter_map(|row| row.not_counted.clone())
        .flatten()
        .collect();
    all.sort_by(|a, b| b.moves_um.total_cmp(&a.moves_um));
    let mut seen = BTreeSet::new();
    all.retain(|of| seen.insert(of.unknown.clone()));
    all
}

/// Whether the tool axis cannot be corrected at a pose where other poses of the machine can.
fn is_singular(row: &CorrectionAt, rotary: usize) -> bool {
    row.singular && rotary >= 2
}

//! Quantities with their uncertainties and tolerances, as documents and as a table.

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_metrology::{
    Decision, DeviationUnit, JudgedQuantity, Tolerance, Verdict, parse_tolerances,
};

use super::rows::Row;
use crate::{
    failure::Failure,
    table::{fixed, folded, table, table_text, to_the_left},
};

/// The symbols of ISO 230-4.
pub(crate) const CIRCULAR: [&str; 6] = ["G_ccw", "G_cw", "G_b", "F_max", "F_min", "D"];
/// The symbols of ISO 230-6.
pub(crate) const DIAGONALS: [&str; 5] = ["E_d", "E_d_unidirectional", "B_d", "M_d", "spread"];

/// What every evaluation ends in: its quantities against their tolerances, and the notes on it.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub(crate) struct Judgement {
    /// The quantities of every requested standard, with uncertainty and tolerance.
    pub(crate) quantities: Vec<JudgedQuantity>,
    /// The decision over all tolerances; null without any.
    pub(crate) decision: Option<Decision>,
    /// Whether every quantity with a tolerance passes; null without tolerances.
    pass: Option<bool>,
    /// Notes in words on the files and their readings.
    pub(crate) notes: Vec<String>,
}

impl Judgement {
    pub(crate) fn new(quantities: Vec<JudgedQuantity>, notes: Vec<String>) -> Self {
        let decision = Decision::over(&quantities);
        Self {
            pass: decision.map(|decision| decision.pass),
            decision,
            quantities,
            notes,
        }
    }
}

/// The tolerances of the call, among the symbols that it evaluates.
pub(crate) fn tolerances(text: Option<&str>, known: &[&str]) -> Result<Vec<Tolerance>, Failure> {
    let Some(text) = text else {
        return Ok(Vec::new());
    };
    parse_tolerances(text, known).map_err(|error| Failure::Input(format!("--{error}")))
}

/// What several files came to: a row for each with the quantities that have a limit, or without any those of a plain symbol, and the verdict; and the
/// names of all symbols once.
pub(crate) fn verdicts_text(rows: &[Row]) -> String {
    let all = || (rows.iter()).flat_map(|row| row.found.iter().flat_map(|found| &found.quantities));
    let is_judged = all().any(|quantity| quantity.limit.is_some());
    let is_shown = |quantity: &JudgedQuantity| {
        if is_judged {
            quantity.limit.is_some()
        } else {
            !quantity.symbol.contains('_')
        }
    };
    let mut symbols: Vec<&str> = Vec::new();
    let mut names: Vec<(&str, &str)> = Vec::new();
    for quantity in all() {
        if is_shown(quantity) && !symbols.contains(&quantity.symbol) {
            symbols.push(quantity.symbol);
        }
        if !names.contains(&(quantity.symbol, quantity.name)) {
            names.push((quantity.symbol, quantity.name));
        }
    }
    let mut heads = vec!["file", "verdict", "unit"];
    heads.extend(&symbols);
    let mut shown = table(&heads);
    to_the_left(&mut shown, &[1, 2]);
    for row in rows {
        let name = std::path::Path::new(&row.file);
        let name = name.file_name().unwrap_or_default().display().to_string();
        let Ok(Judgement {
            quantities,
            decision,
            ..
        }) = &row.found
        else {
            shown.add_row([name, "REFUSED".to_owned()]);
            continue;
        };
        let verdict = decision.map_or_else(
            || "no limits".to_owned(),
            |d| d.verdict.word().to_uppercase(),
        );
        let unit = quantities.first().map_or(DeviationUnit::Um, |q| q.unit);
        let mut cells = vec![name, verdict, unit.to_string()];
        for symbol in &symbols {
            let mut of = quantities.iter();
            let value = of.find(|q| q.symbol == *symbol).and_then(|q| q.value);
            cells.push(value.map_or_else(|| "-".to_owned(), |value| fixed(value, 2)));
        }
        shown.add_row(cells);
    }
    let names = names
        .iter()
        .map(|(symbol, name)| format!("{symbol}: {name}"));
    let names: Vec<String> = names.collect();
    let names = if names.is_empty() {
        String::new()
    } else {
        format!("\n{}", folded(&names.join("; "), ""))
    };
    table_text(&shown) + &names
}

/// The quantities as a table, with columns for uncertainty and limit where there are any, and for their names where these do not stand
/// elsewhere.
pub(crate) fn quantities_text(quantities: &[JudgedQuantity], with_names: bool) -> String {
    let uncertain = quantities.iter().any(|q| q.uncertainty.is_some());
    let limited = quantities.iter().any(|q| q.limit.is_some());
    let mut heads = vec!["", "value"];
    if uncertain {
        heads.push("U (k=2)");
    }
    if limited {
        heads.extend(["limit", "verdict"]);
    }
    if with_names {
        heads.push("name");
    }
    let mut rows = table(&heads);
    if with_names {
        to_the_left(&mut rows, &[heads.len() - 1]);
    }
    let number = |value: Option<f64>| value.map_or_else(|| "-".to_owned(), |v| fixed(v, 2));
    for quantity in quantities {
        let mut row = vec![quantity.symbol.to_owned(), number(quantity.value)];
        if uncertain {
            row.push(number(quantity.uncertainty));
        }
        if limited {
            row.push(number(quantity.limit));
            row.push(quantity.verdict.map_or("", Verdict::word).to_owned());
        }
        if with_names {
            row.push(quantity.name.to_owned());
        }
        rows.add_row(row);
    }
    table_text(&rows)
}

/// The decision in a sentence.
pub(crate) fn decision_text(judgement: &Judgement) -> String {
    let Some(decision) = judgement.decision else {
        return String::new();
    };
    let of = |verdict: Verdict| {
        let named = (judgement.quantities.iter()).filter(|q| q.verdict == Some(verdict));
        let mut symbols: Vec<&str> = named.map(|q| q.symbol).collect();
        // Two standards may have one symbol.
        let mut seen = std::collections::HashSet::new();
        symbols.retain(|symbol| seen.insert(*symbol));
        symbols.join(", ")
    };
    let rule = match decision.rule {
        "simple" => "Decided by the values alone: no measurement uncertainty is stated",
        "ISO 14253-1" => "Decided by ISO 14253-1, with the measurement uncertainty on top",
        _ => "Decided by ISO 14253-1 where the uncertainty is stated, else by the value alone",
    };
    let worst_first = [
        Verdict::Fail,
        Verdict::NotEvaluated,
        Verdict::Undecided,
        Verdict::Pass,
    ];
    let parts = worst_first.map(|verdict| (verdict, of(verdict)));
    let parts = parts.iter().filter(|(_, named)| !named.is_empty());
    let parts: Vec<String> = parts
        .map(|(verdict, named)| format!("{verdict} {named}"))
        .collect();
    let verdict = decision.verdict.word().to_uppercase();
    folded(&format!("{verdict}: {}. {rule}.", parts.join("; ")), "")
}

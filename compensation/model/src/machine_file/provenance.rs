//! Reads and writes the table `[provenance]` of a machine file.

use core::fmt::Write;

use volcomp_document::{InputError, Section, Value, toml_string};
use volcomp_vocabulary::{AxisName, ErrorName};

use crate::{
    error::ModelError,
    machine::Machine,
    provenance::{Origin, Provenance, Source},
};

const MAX_RUNS_OR_TARGETS: usize = 100_000_000;

pub(super) fn decode_provenance(
    root: &Section<'_>,
    machine: &mut Machine,
) -> Result<(), ModelError> {
    let Some(section) = root.section("provenance")? else {
        return Ok(());
    };
    section.allow(&["version", "serial", "date", "undecided", "error"])?;
    let text = |key: &str| section.optional(key, |v| v.text().map(str::to_owned));
    let provenance = Provenance {
        version: text("version")?,
        serial: text("serial")?,
        date: text("date")?,
        undecided: section.optional("undecided", decode_names)?.unwrap_or_default(),
        errors: section.tables("error", decode_origin)?,
    };
    let refused = machine.set_provenance(provenance);
    refused.map_err(|refusal| section.error(refusal.to_string()).into())
}

fn decode_names(value: &Value<'_>) -> Result<Vec<ErrorName>, InputError> {
    let name = |item: &Value<'_>| {
        let name = item.text()?.parse::<ErrorName>();
        name.map_err(|e| item.error(e.to_string()))
    };
    value.items()?.iter().map(name).collect()
}

fn decode_origin(section: &Section<'_>) -> Result<Origin, InputError> {
    let value = section.require("error")?;
    let error: ErrorName = (value.text()?.parse())
        .map_err(|e: volcomp_vocabulary::UnknownErrorName| value.error(e.to_string()))?;
    let unit = error.component.unit();
    let (residual, leave_one_out) = (format!("residual_{unit}"), format!("leave_one_out_{unit}"));
    section.allow(&["error", "method", "rule", &residual, &leave_one_out, "from"])?;
    Ok(Origin {
        error,
        method: section.require("method")?.text()?.to_owned(),
        rule: section.optional("rule", |v| v.text().map(str::to_owned))?,
        residual: section.optional(&residual, Value::number)?,
        leave_one_out: section.optional(&leave_one_out, Value::number)?,
        sources: section.tables("from", decode_source)?,
    })
}

fn decode_source(section: &Section<'_>) -> Result<Source, InputError> {
    section.allow(&["file", "sha256", "runs", "targets", "at", "date"])?;
    let count = |key: &str| section.optional(key, |v| v.count(MAX_RUNS_OR_TARGETS));
    let mut at = Vec::new();
    if let Some(axes) = section.section("at")? {
        for (key, value) in axes.values() {
            let axis = key.parse::<AxisName>();
            let axis = axis.map_err(|e| value.error(e.to_string()))?;
            at.push((axis, value.number()?));
        }
    }
    at.sort_by_key(|(axis, _)| *axis);
    Ok(Source {
        file: section.require("file")?.text()?.to_owned(),
        sha256: section.require("sha256")?.text()?.to_owned(),
        runs: count("runs")?,
        targets: count("targets")?,
        at,
        date: section.optional("date", |v| v.text().map(str::to_owned))?,
    })
}

/// The table as text. It is empty if nothing is recorded, so that files without provenance keep their text and
/// checksum.
pub(super) fn write_provenance(provenance: &Provenance) -> String {
    if provenance.is_empty() {
        return String::new();
    }
    let mut text = String::from("\n[provenance]\n");
    let of_all = [
        ("version", &provenance.version),
        ("serial", &provenance.serial),
        ("date", &provenance.date),
    ];
    for (key, value) in of_all {
        if let Some(value) = value {
            let _ = writeln!(text, "{key} = {}", toml_string(value)); // writing to a String cannot fail
        }
    }
    if !provenance.undecided.is_empty() {
        let names = provenance.undecided.iter().map(|name| format!("\"{name}\""));
        let names: Vec<String> = names.collect();
        let _ = writeln!(text, "undecided = [{}]", names.join(", "));
    }
    for origin in &provenance.errors {
        let unit = origin.error.component.unit();
        let _ = write!(
            text,
            "\n[[provenance.error]]\nerror = \"{}\"\nmethod = {}\n",
            origin.error,
            toml_string(&origin.method)
        );
        if let Some(rule) = &origin.rule {
            let _ = writeln!(text, "rule = {}", toml_string(rule));
        }
        if let Some(residual) = origin.residual {
            let _ = writeln!(text, "residual_{unit} = {residual:?}");
        }
        if let Some(error) = origin.leave_one_out {
            let _ = writeln!(text, "leave_one_out_{unit} = {error:?}");
        }
        if !origin.sources.is_empty() {
            let sources: Vec<String> = origin.sources.iter().map(write_source).collect();
            let _ = writeln!(text, "from = [\n    {},\n]", sources.join(",\n    "));
        }
    }
    text
}

fn write_source(source: &Source) -> String {
    let mut text = format!(
        "{{ file = {}, sha256 = {}",
        toml_string(&source.file),
        toml_string(&source.sha256)
    );
    for (key, count) in [("runs", source.runs), ("targets", source.targets)] {
        if let Some(count) = count {
            let _ = write!(text, ", {key} = {count}"); // writing to a String cannot fail
        }
    }
    if !source.at.is_empty() {
        let at = source.at.iter().map(|(axis, q)| format!("{axis} = {q:?}"));
        let _ = write!(text, ", at = {{ {} }}", at.collect::<Vec<_>>().join(", "));
    }
    if let Some(date) = &source.date {
        let _ = write!(text, ", date = {}", toml_string(date));
    }
    text + " }"
}

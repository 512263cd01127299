use std::{fmt::Write as _, path::PathBuf};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_model::Machine;
use volcomp_shop::{Wear, WearError};
use volcomp_vocabulary::Direction;

use super::{Answer, fixed, table, table_text};
use crate::{failure::Failure, output::OutputFile, table::folded};

/// Number of equally spaced positions over the travel at which the change of an error is evaluated.
const PLACES: u32 = 200;

/// Simulate the wear of a machine: guides, screws, gears and squareness
///
/// Use the worn machine file to try compensation and recalibration. The wear model is invented, with plausible sizes and
/// shapes, and forecasts no real machine. Wear is proportional to months and load; each error has its own factor
/// (log-normal, standard deviation 0.4) and sign, from the seed.
///
/// Guides wear in the middle 80 % of the travel: straightness gets a raised cosine of 0.06 µm a month, and the carriage
/// tilts with its slope. Screws stretch there: positioning gets its integral, 0.08 µm a month. Reversal values fall by
/// 0.05 µm or µrad a month. Rotary axes get a gear eccentricity of 0.2 µrad and a bearing run-out of 0.02 µm a month,
/// once a turn. EC0Y, EA0Z, EB0Z and angular location errors drift by a normal random number of 0.15 µrad a month. Errors
/// that are grids over two axes stay unchanged.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp age -m mill.toml --months 36 -o worn.toml
  volcomp --json age -m trunnion.toml --months 12 --load 2 --seed 7 -o worn.toml")]
pub(crate) struct AgeArguments {
    /// Machine file (TOML)
    #[arg(long, short, value_name = "FILE")]
    machine: PathBuf,
    /// Months of work, 0 to 1200; 0 changes nothing
    #[arg(long, value_name = "N", allow_negative_numbers = true)]
    months: f64,
    /// Load, 0 to 100; 1 is one shift of mixed parts
    #[arg(long, value_name = "L", default_value_t = 1.0, allow_negative_numbers = true)]
    load: f64,
    /// Seed, which selects one machine of its type
    #[arg(long, value_name = "S", default_value_t = 1)]
    seed: u64,
    /// Machine file of the worn machine
    #[arg(long, short, value_name = "FILE")]
    output: PathBuf,
}

/// Result of `volcomp age`: the written machine file, and the errors changed by wear.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Age {
    /// Path of the written machine file.
    file: String,
    /// Operating time, months.
    months: f64,
    /// Relative load, as a factor on the wear.
    load: f64,
    /// Seed that selects one machine of its type.
    seed: u64,
    /// Errors changed by wear.
    errors: Vec<Aged>,
}

/// The change of one error by wear.
#[derive(Debug, Serialize, JsonSchema)]
struct Aged {
    /// Name of the error.
    name: String,
    /// Unit of the values: `um` or `urad`.
    unit: &'static str,
    /// Symbol of the unit for display.
    #[serde(skip)]
    symbol: &'static str,
    /// Largest change of the mean over the travel.
    largest_change: f64,
    /// Largest magnitude of the new mean over the travel.
    largest: f64,
    /// Reversal value at mid-travel: positive minus negative direction; null for one curve for both
    /// directions.
    reversal: Option<f64>,
}

pub(crate) fn run(arguments: &AgeArguments) -> Result<Answer, Failure> {
    let machine = Machine::read(&arguments.machine)?;
    let inputs = [(arguments.machine.as_path(), "--machine")];
    let output = OutputFile::open_beside(&arguments.output, &inputs)?;
    let AgeArguments { months, load, seed, .. } = *arguments;
    let worn = Wear { months, load, seed }.of(&machine);
    let worn = worn.map_err(|error| match error {
        WearError::Number { .. } => Failure::Input(format!("--{error}")),
        other => Failure::input(other),
    })?;
    output.write_whole(worn.machine.to_toml())?;
    let document = Age {
        file: arguments.output.display().to_string(),
        months,
        load,
        seed,
        errors: changes(&machine, &worn.machine),
    };
    let text = text(&document);
    let notes = worn.left.iter();
    let notes = notes.map(|name| format!("{name} is a grid over two axes: it stays as it is"));
    Answer::new(&document, text, notes.collect())
}

fn text(document: &Age) -> String {
    let Age { file, months, .. } = document;
    if document.errors.is_empty() {
        let load = document.load;
        let said = format!(
            "{file}: nothing wears in {months} months with the load {load}: the errors are those of --machine"
        );
        return folded(&said, "");
    }
    let mut rows = table(&["error", "largest change", "now at most", "reversal", ""]);
    for of in &document.errors {
        rows.add_row([
            of.name.clone(),
            fixed(of.largest_change, 2),
            fixed(of.largest, 2),
            of.reversal.map_or_else(String::new, |value| fixed(value, 2)),
            of.symbol.to_owned(),
        ]);
    }
    let mut text = table_text(&rows);
    let _ = writeln!(text, "{file}: after {months} months");
    text
}

fn changes(before: &Machine, after: &Machine) -> Vec<Aged> {
    let mut changes = Vec::new();
    for (name, curve) in after.errors() {
        let (Ok(own), Some(axis)) = (after.index_of(name.axis), after.axis(name.axis)) else {
            continue;
        };
        let [low, high] = axis.travel;
        let (mut largest_change, mut largest) = (0.0_f64, 0.0_f64);
        for place in 0..=PLACES {
            let mut at = [0.0; 9];
            at[own] = low + (high - low) * f64::from(place) / f64::from(PLACES);
            let now = curve.value(own, &at, None);
            let was = before.error(name).map_or(0.0, |curve| curve.value(own, &at, None));
            largest_change = largest_change.max((now - was).abs());
            largest = largest.max(now.abs());
        }
        let mut middle = [0.0; 9];
        middle[own] = 0.5 * (low + high);
        let sides = Direction::BOTH.map(|side| curve.value(own, &middle, Some(side)));
        let reversal = Some(sides[0] - sides[1]).filter(|value| *value != 0.0);
        changes.push(Aged {
            name: name.to_string(),
            unit: name.component.unit(),
            symbol: name.component.symbol(),
            largest_change,
            largest,
            reversal,
        });
    }
    for (name, value) in after.locations() {
        let was = before.locations().get(name).copied().unwrap_or(0.0);
        changes.push(Aged {
            name: name.to_string(),
            unit: name.component.unit(),
            symbol: name.component.symbol(),
            largest_change: (value - was).abs(),
            largest: value.abs(),
            reversal: None,
        });
    }
    changes.retain(|of| of.largest_change > 0.0);
    changes
}

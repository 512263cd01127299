//! `volcomp fit-thermal`: temperatures and displacements over time to thermal terms of the machine file.

mod checks;
mod columns;
pub(crate) mod document;
mod errors;
mod text;

use std::path::PathBuf;

use volcomp_fit::{
    FitError, JudgedThermal, ThermalRecord, ThermalRun, ThermalSearch, judge_thermal_rows,
    judge_thermal_runs, search_thermal,
};
use volcomp_model::ErrorName;
use volcomp_vocabulary::bounds::PLAUSIBLE_DEGC;

use self::{
    columns::Columns,
    document::FitThermal,
    errors::{Errors, may_expand},
};
use super::{Answer, same_file};
use crate::failure::Failure;

/// Finds thermal terms from temperatures and displacements over time
///
/// Each file is one test: a column time_s, temperatures in columns that end in _degc or °C, displacements in columns that end in
/// _um or _urad (µm, µrad), and where an axis was moved its position in a column X or X_mm; other columns are not read, and are named. Few sensors,
/// few time constants and few numbers are chosen. Several files are judged by leaving out each one as a whole: it is predicted
/// by terms that are found from the others. Of a single file the first rows (--train) find terms, and the rows after them
/// are predicted to judge these. The terms that are printed are found in the same way from all rows of all files. Where terms
/// with time constants predict worse than those without any, or no better than no terms at all, none are printed: by more than
/// the standard error over the files, or over stretches of the single one.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// Time, temperatures and displacements: .csv, one file for each test
    #[arg(required = true)]
    data: Vec<PathBuf>,
    /// Column with the displacement to fit, more than once for several; without it all are fitted
    #[arg(long)]
    displacement: Vec<String>,
    /// The error that a displacement is, for the terms of the machine file: COLUMN=ERROR, once for each displacement, or
    /// ERROR alone where one is fitted. Without it a single displacement in µm is EZZ, and several have a gap in their terms
    /// that you fill in
    #[arg(long, value_name = "[COLUMN=]ERROR", value_delimiter = ',')]
    error: Vec<String>,
    /// Share of the rows of a single file, the first ones, that terms are found from to be judged, 0.05 to 0.95; the rows after
    /// them are predicted
    #[arg(long, default_value_t = 0.7)]
    train: f64,
    /// Temperature at which the terms are zero, °C
    #[arg(long, default_value_t = 20.0, allow_hyphen_values = true)]
    reference: f64,
    /// Time constants to choose from, s, separated by commas; without it
    /// 0,120,300,600,900,1200,1800,2700,3600,5400. 0 is no lag
    #[arg(long, value_delimiter = ',')]
    lags: Vec<f64>,
    /// The most sensors that the terms may have
    #[arg(long, default_value_t = 6)]
    most_sensors: usize,
    /// The most time constants that the terms may have; 0 counts as one, and where an axis was moved and its expansion is
    /// looked for it is always among them
    #[arg(long, default_value_t = 3)]
    most_lags: usize,
}

/// A displacement and the terms that were found for it.
struct Channel {
    name: String,
    /// The error that it is; `None` where the call does not say it.
    error: Option<ErrorName>,
    judged: JudgedThermal,
}

impl Channel {
    /// Whether the displacement is a rotation in µrad and not a translation in µm.
    fn is_angular(&self) -> bool {
        is_angular(&self.name)
    }

    /// The unit as people read it.
    fn symbol(&self) -> &'static str {
        if self.is_angular() { "µrad" } else { "µm" }
    }
}

/// Whether a column holds a rotation in µrad and not a translation in µm.
fn is_angular(column: &str) -> bool {
    column.ends_with("_urad")
}

/// A test that is there twice would be predicted from itself.
fn refuse_twice(files: &[PathBuf]) -> Result<(), Failure> {
    let twice = files.iter().enumerate().find(|(place, file)| {
        let before = &files[..*place];
        before.contains(file) || same_file(before, file).is_some()
    });
    if let Some((_, file)) = twice {
        return Err(Failure::Input(format!(
            "{} stands twice: expected each test once, since each is predicted from all others",
            file.display()
        )));
    }
    // What cannot be read is refused where it is read.
    let texts: Vec<_> = files.iter().map(|file| std::fs::read(file).ok()).collect();
    for (place, (file, text)) in files.iter().zip(&texts).enumerate() {
        let mut before = files.iter().zip(&texts[..place]);
        if let Some((other, _)) = before.find(|(_, other)| text.is_some() && *other == text) {
            return Err(Failure::Input(format!(
                "{} has the same content as {}: expected each test once, since each is predicted from all others",
                file.display(),
                other.display()
            )));
        }
    }
    Ok(())
}

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
    let errors = arguments.checked_errors()?;
    refuse_twice(&arguments.data)?;
    let files = read(arguments)?;
    let first = &files[0];
    let mut notes: Vec<String> = Vec::new();
    for (path, columns) in arguments.data.iter().zip(&files) {
        let note = |note: &String| match &files[..] {
            [_] => note.clone(),
            _ => format!("{}: {note}", path.display()),
        };
        notes.extend(columns.notes.iter().map(note));
    }
    notes.extend(checks::too_small(&files));
    for (path, file) in arguments.data.iter().zip(&files) {
        notes.extend(checks::still_in(path, file, &files));
        notes.extend(checks::gaps(path, file, &arguments.search(false).lags_s));
    }
    let still = checks::still_sensors(&files);
    if !still.is_empty() {
        notes.push(format!(
            "{}: the same value in all rows, so that no terms are found for it",
            still.join(", ")
        ));
    }
    let moved = files.iter().filter_map(|file| file.position.as_ref());
    let moved: Vec<_> = moved.map(|(axis, _)| *axis).collect();
    if moved.iter().any(|axis| *axis != moved[0])
        || (!moved.is_empty() && moved.len() != files.len())
    {
        return Err(Failure::Input(
            "found files in which one axis moves and files in which another or none does, expected the same in all"
                .to_owned(),
        ));
    }
    let names = first.displacements.iter().map(|(name, _)| name.as_str());
    let names: Vec<&str> = names
        .filter(|name| {
            let mut asked = arguments.displacement.iter();
            arguments.displacement.is_empty() || asked.any(|d| columns::displacement(d) == *name)
        })
        .collect();
    let of = errors.of(&names)?;
    notes.extend(errors.note(&of, &names));
    let mut channels = Vec::new();
    for (name, error) in names.iter().zip(of) {
        let expansions = may_expand(error)
            .is_some_and(|e| moved.iter().all(|axis| axis.is_none_or(|a| a == e.axis)));
        if !moved.is_empty() && !expansions {
            let found = error.map_or("none".to_owned(), |error| error.to_string());
            notes.push(format!(
                "{name}: no expansion is looked for: that needs `--error` to name a linear error motion of the axis that was moved, found {found}"
            ));
        }
        let search = arguments.search(expansions);
        let channel = channel(name, error, &files, arguments, &search)?;
        let runs: Vec<ThermalRun> = files.iter().map(|file| run_of(file, name)).collect();
        notes.extend(checks::inverted(&channel, &runs, &arguments.data, &search));
        notes.extend(checks::too_coarse(&channel, &runs, &arguments.data));
        channels.push(channel);
    }
    let sensors = &first.sensors;
    for channel in &channels {
        let spread = channel.judged.terms.constant_at(arguments.reference).1;
        if files.len() > 1 && moved.is_empty() && spread > 3.0 * channel.judged.few.rms {
            notes.push(format!(
                "{}: the constants of the files differ by {spread:.1} {}: each test has a zero of its own, and the constant is their mean",
                channel.name,
                channel.symbol()
            ));
        }
    }
    let document = FitThermal::new(&channels, sensors, arguments);
    let text = text::text(&channels, &document, arguments);
    Answer::new(&document, text, notes)
}

impl Arguments {
    /// What to choose from.
    fn search(&self, expansions: bool) -> ThermalSearch {
        ThermalSearch {
            lags_s: if self.lags.is_empty() {
                ThermalSearch::default().lags_s
            } else {
                self.lags.clone()
            },
            most_sensors: self.most_sensors,
            most_lags: self.most_lags,
            expansions,
            ..ThermalSearch::default()
        }
    }

    /// The errors that are named, when the rest of the call makes sense as well.
    fn checked_errors(&self) -> Result<Errors, Failure> {
        if !(0.05..=0.95).contains(&self.train) {
            let message = format!("--train: found {}, expected 0.05 to 0.95", self.train);
            return Err(Failure::Input(message));
        }
        if !PLAUSIBLE_DEGC.contains(&self.reference) {
            return Err(Failure::Input(format!(
                "--reference: found {}, expected {} to {} °C",
                self.reference,
                PLAUSIBLE_DEGC.start(),
                PLAUSIBLE_DEGC.end()
            )));
        }
        Errors::read(&self.error)
    }
}

/// Every file, with the sensors and the displacements of the first in its order.
fn read(arguments: &Arguments) -> Result<Vec<Columns>, Failure> {
    let mut files: Vec<Columns> = Vec::new();
    for path in &arguments.data {
        let columns = columns::read(path)?;
        files.push(match files.first() {
            Some(first) => columns.in_order_of(first, path)?,
            None => columns,
        });
    }
    // clap asks for at least one file.
    let known = files
        .first()
        .map_or(&[][..], |file| &file.displacements[..]);
    let is_known = |wanted: &String| {
        let wanted = columns::displacement(wanted);
        known.iter().any(|(name, _)| *name == wanted)
    };
    if let Some(missing) = arguments.displacement.iter().find(|d| !is_known(d)) {
        let known: Vec<&str> = known.iter().map(|(name, _)| name.as_str()).collect();
        return Err(Failure::Input(format!(
            "--displacement: found {missing}, expected one of {}",
            known.join(", ")
        )));
    }
    Ok(files)
}

/// The test of a file, with this displacement.
fn run_of(columns: &Columns, name: &str) -> ThermalRun {
    let mut displacements = columns.displacements.iter();
    let displacement = displacements.find(|(known, _)| known == name);
    ThermalRun {
        record: ThermalRecord {
            time_s: columns.time_s.clone(),
            degc: columns.degc.clone(),
            displacement: displacement.map_or_else(Vec::new, |(_, values)| values.clone()),
        },
        position_mm: columns
            .position
            .as_ref()
            .map_or_else(Vec::new, |p| p.1.clone()),
    }
}

fn channel(
    name: &str,
    error: Option<ErrorName>,
    files: &[Columns],
    arguments: &Arguments,
    search: &ThermalSearch,
) -> Result<Channel, Failure> {
    let runs: Vec<ThermalRun> = files.iter().map(|file| run_of(file, name)).collect();
    let sensors = &files[0].sensors;
    let failed = |e: FitError| {
        // Of several files the first one that cannot be fitted by itself.
        let alone = |place: &usize| search_thermal(&runs[*place..=*place], search).is_err();
        let wrong = (0..runs.len()).find(alone).unwrap_or_default();
        let still = checks::still_sensors(files);
        if still.len() == sensors.len() {
            let what = format_args!(
                "{name}: no temperature changes ({}): expected one that does, since terms say what follows from a change",
                still.join(", ")
            );
            return Failure::in_file(&arguments.data[wrong], what);
        }
        Failure::in_file(&arguments.data[wrong], format_args!("{name}: {e}"))
    };
    let judged = match &runs[..] {
        [run] => {
            #[expect(
                clippy::cast_possible_truncation,
                clippy::cast_sign_loss,
                reason = "a share of a count"
            )]
            let train = (run.record.len() as f64 * arguments.train) as usize;
            judge_thermal_rows(run, train, search).map_err(|error| match error {
                FitError::TooFew { needed, .. } if train < needed => Failure::in_file(
                    &arguments.data[0],
                    format_args!(
                        "{name}: found {} rows, of which the first {train} (--train {}) find terms and the others judge them: expected at least {needed} to find terms from",
                        run.record.len(),
                        arguments.train
                    ),
                ),
                other => failed(other),
            })?
        }
        _ => judge_thermal_runs(&runs, search).map_err(failed)?,
    };
    Ok(Channel {
        name: name.to_owned(),
        error,
        judged,
    })
}

//! `volcomp fit-thermal`: finds thermal terms from temperatures and displacements over time.

mod columns;

use std::{collections::BTreeMap, fmt::Write as _, path::PathBuf};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_document::{toml_key, toml_string};
use volcomp_fit::{
    FitError, ThermalEffect, ThermalNumber, ThermalPrediction, ThermalRecord, ThermalRun,
    ThermalSearch, ThermalSize, ThermalTerms, ThermalVerdict, judge_thermal_rows,
    judge_thermal_runs, search_thermal,
};
use volcomp_metrology::DeviationUnit;
use volcomp_vocabulary::{ErrorName, bounds::PLAUSIBLE_DEGC};

use self::columns::{Channel, Columns, Errors, may_expand};
use super::{Answer, fixed, same_file, table, table_text};
use crate::{failure::Failure, table::folded};

/// Find thermal terms from temperatures and displacements over time
///
/// Each CSV file is one test, with the columns time_s, temperatures (_degc or °C), displacements (_um or _urad; µm, µrad)
/// and, if an axis was moved, its position (X or X_mm). Other columns are ignored, with a note. Displacements count from
/// the start of each file, at each position.
///
/// Each of several files is predicted from the others. Of a single file the first rows (--train) find the terms, which
/// predict the rest. The printed terms are found from all rows of all files. None are printed if they predict worse than
/// regression without time constants, or no better than no terms: try --lags 0, or measure more tests.
///
/// Expansion, k·(T − T_ref)·(q − q_fixed), is also fitted if the position of an axis was varied and --error names a
/// linear error of that axis: vary it over the whole time, at a few places, each visited repeatedly.
///
/// After a gap in the log (ten times the usual interval and two minutes) rows are left out until the longest time
/// constant of --lags has forgotten it. Temperatures outside −60 to 200 °C and rows that jump away and back are refused;
/// lasting steps are accepted.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp fit-thermal spindle.csv --displacement ch1_um --error EZZ
  volcomp fit-thermal spindle.csv --lags 0,300,1800 --most-sensors 4")]
pub(crate) struct FitThermalArguments {
    /// CSV files with time, temperatures and displacements, one for each test
    #[arg(required = true)]
    data: Vec<PathBuf>,
    /// Column of a displacement to fit; repeatable [default: all]
    #[arg(long)]
    displacement: Vec<String>,
    /// Error that a displacement is: dz_um=EZZ, or EZZ for a single one [default: EZZ for a single one in µm, else a gap
    /// to fill in]
    #[arg(long, value_name = "[COLUMN=]ERROR", value_delimiter = ',')]
    error: Vec<String>,
    /// Share of the rows of a single file that find the terms; the rest judges them: 0.05 to 0.95
    #[arg(long, default_value_t = 0.7)]
    train: f64,
    /// Temperature at which the terms are zero, °C
    #[arg(long, default_value_t = 20.0, allow_hyphen_values = true)]
    reference: f64,
    /// Candidate time constants, s; 0 is no lag [default: 0,120,300,600,900,1200,1800,2700,3600,5400]
    #[arg(long, value_delimiter = ',')]
    lags: Vec<f64>,
    /// Maximum number of sensors
    #[arg(long, default_value_t = 6)]
    most_sensors: usize,
    /// Maximum number of time constants; 0 counts as one
    #[arg(long, default_value_t = 3)]
    most_lags: usize,
}

/// Rejects duplicate files, because a test must not be predicted from itself.
fn refuse_twice(files: &[PathBuf]) -> Result<(), Failure> {
    let twice = files.iter().enumerate().find(|(place, file)| {
        let before = &files[..*place];
        before.contains(file) || same_file(before, file).is_some()
    });
    if let Some((_, file)) = twice {
        return Err(Failure::Input(format!(
            "{} appears twice: expected each test once, since each is predicted from all others",
            file.display()
        )));
    }
    // Unreadable files are skipped here; reading them later reports the error.
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

pub(crate) fn run(arguments: &FitThermalArguments) -> Result<Answer, Failure> {
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
    notes.extend(columns::too_small(&files));
    for (path, file) in arguments.data.iter().zip(&files) {
        notes.extend(columns::still_in(path, file, &files));
        notes.extend(columns::gaps(path, file, &arguments.search(false).lags_s));
    }
    let still = columns::still_sensors(&files);
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
        notes.extend(columns::inverted(&channel, &runs, &arguments.data, &search));
        notes.extend(columns::too_coarse(&channel, &runs, &arguments.data));
        channels.push(channel);
    }
    let sensors = &first.sensors;
    for channel in &channels {
        let spread = channel.judged.terms.constant_at(arguments.reference).1;
        if files.len() > 1 && moved.is_empty() && spread > 3.0 * channel.judged.few.rms {
            notes.push(format!(
                "{}: the constants of the files differ by {spread:.1} {}: each test has its own zero, and the constant is their mean",
                channel.name,
                channel.symbol()
            ));
        }
    }
    let document = FitThermal::new(&channels, sensors, arguments);
    let text = text(&channels, &document, arguments);
    Answer::new(&document, text, notes)
}

impl FitThermalArguments {
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

    /// Checks all options. Returns the errors that `--error` names.
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

fn read(arguments: &FitThermalArguments) -> Result<Vec<Columns>, Failure> {
    let mut files: Vec<Columns> = Vec::new();
    for path in &arguments.data {
        let columns = columns::read(path)?;
        files.push(match files.first() {
            Some(first) => columns.in_order_of(first, path)?,
            None => columns,
        });
    }
    // clap requires at least one file.
    let known = files.first().map_or(&[][..], |file| &file.displacements[..]);
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

fn run_of(columns: &Columns, name: &str) -> ThermalRun {
    let mut displacements = columns.displacements.iter();
    let displacement = displacements.find(|(known, _)| known == name);
    ThermalRun {
        record: ThermalRecord {
            time_s: columns.time_s.clone(),
            degc: columns.degc.clone(),
            displacement: displacement.map_or_else(Vec::new, |(_, values)| values.clone()),
        },
        position_mm: columns.position.as_ref().map_or_else(Vec::new, |p| p.1.clone()),
    }
}

fn channel(
    name: &str,
    error: Option<ErrorName>,
    files: &[Columns],
    arguments: &FitThermalArguments,
    search: &ThermalSearch,
) -> Result<Channel, Failure> {
    let runs: Vec<ThermalRun> = files.iter().map(|file| run_of(file, name)).collect();
    let sensors = &files[0].sensors;
    let failed = |e: FitError| {
        // Index of the first file that cannot be fitted alone.
        let alone = |place: &usize| search_thermal(&runs[*place..=*place], search).is_err();
        let wrong = (0..runs.len()).find(alone).unwrap_or_default();
        let still = columns::still_sensors(files);
        if still.len() == sensors.len() {
            let what = format_args!(
                "{name}: no temperature changes ({}): expected one that does, since a term relates an error to a change",
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
    Ok(Channel { name: name.to_owned(), error, judged })
}

/// Placeholder for an error that the command line does not name.
const GAP: &str = "???";

/// Thermal terms fitted to measured displacements.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct FitThermal<'a> {
    /// One entry for each fitted displacement.
    displacements: Vec<Displacement<'a>>,
    /// Share of the rows, from the first, used to find the terms that are then tested on the
    /// others; only for a single file.
    #[serde(skip_serializing_if = "Option::is_none")]
    train: Option<f64>,
    /// The temperature columns, without `_degc`.
    sensors: &'a [String],
}

/// One displacement, with values in its unit.
#[derive(Debug, Serialize, JsonSchema)]
struct Displacement<'a> {
    /// Column name in the file.
    name: &'a str,
    /// Name of the error; null if the call does not name it, and the terms have a placeholder.
    error: Option<ErrorName>,
    /// Unit of the displacement and of its residuals.
    unit: DeviationUnit,
    /// Whether the terms predict better than no terms, and no worse than regression without time
    /// constants (`baseline`), within the accuracy of the tests.
    recommended: bool,
    /// Root mean square of the displacement over the predicted rows.
    without_terms_rms: f64,
    /// Ridge regression on the temperatures without time constants.
    baseline: Prediction<'a>,
    /// Regression on all sensors with many time constants, for comparison with few terms; only for
    /// a single file.
    #[serde(skip_serializing_if = "Option::is_none")]
    dense: Option<Prediction<'a>>,
    /// Prediction by few terms with time constants. Its errors, and those in `left_out`, include
    /// the possible effect of temperature changes between rows.
    fit: Prediction<'a>,
    /// Prediction error of each file by terms found from the others; empty for a single file.
    left_out: Vec<LeftOut>,
    /// Coefficients of the terms, found from all rows.
    numbers: Vec<Number>,
    /// Validation error by number of coefficients, in descending order of that number.
    sizes: &'a [ThermalSize],
    /// The drift terms, found from all rows.
    drift: Vec<DriftTerm>,
    /// The expansion terms, found from all rows; only if an axis was moved.
    expansion: Vec<Expansion>,
    /// Ranges of temperature and rate of the sensors in the terms.
    seen: Vec<Seen>,
    /// Constant of the fitted terms.
    constant: f64,
    /// Range of the constants over files and positions.
    constant_spread: f64,
    /// The terms as text for a machine file; if `error` is null, each `error` is a placeholder to
    /// be filled in.
    toml: String,
}

/// Prediction error of a fit on rows that were not used to find it.
#[derive(Debug, Serialize, JsonSchema)]
struct Prediction<'a> {
    #[serde(flatten)]
    found: &'a ThermalPrediction,
    /// Sensors with a nonzero weight.
    sensors: Vec<&'a str>,
}

/// One `[[thermal.expansion]]` of a machine file.
#[derive(Debug, Serialize, JsonSchema)]
struct Expansion {
    /// Name of the sensor, from the head of its column.
    sensor: String,
    /// Coefficient of thermal expansion, µm/(m·K).
    um_per_m_k: f64,
    /// Fixed point of the expansion: the coordinate that does not move, mm.
    fixed_mm: f64,
}

/// One `[[thermal.drift]]` of a machine file.
#[derive(Debug, Serialize, JsonSchema)]
struct DriftTerm {
    /// Time constant of the first-order lag, s.
    lag_s: f64,
    /// Drift per kelvin of each sensor, in the unit of the displacement.
    sensors: BTreeMap<String, f64>,
}

/// Prediction error of one file by terms that were found from the others.
#[derive(Debug, Serialize, JsonSchema)]
struct LeftOut {
    /// Path as named in the call.
    file: String,
    /// Root mean square error, in the unit of the displacement.
    rms: f64,
}

/// One coefficient of the terms.
#[derive(Debug, Serialize, JsonSchema)]
struct Number {
    /// Name of the sensor, from the head of its column.
    sensor: String,
    /// Time constant of the lag, s; missing for an expansion.
    #[serde(skip_serializing_if = "Option::is_none")]
    lag_s: Option<f64>,
    /// The coefficient, in `unit`.
    value: f64,
    /// Standard uncertainty (k = 1) of the coefficient.
    uncertainty: f64,
    /// Unit of value and uncertainty: `um_per_k`, `urad_per_k` or, for an expansion, `um_per_m_k`.
    unit: &'static str,
}

/// Range of the temperature of a sensor, and of its rate of change, in the test files.
#[derive(Debug, Serialize, JsonSchema)]
struct Seen {
    /// Name of the sensor, from the head of its column.
    sensor: String,
    /// Lowest and highest temperature, °C.
    degc: [f64; 2],
    /// Fastest fall and rise, K/min, smoothed over ten minutes.
    k_per_min: [f64; 2],
}

impl<'a> FitThermal<'a> {
    fn new(
        channels: &'a [Channel],
        sensors: &'a [String],
        arguments: &'a FitThermalArguments,
    ) -> Self {
        let displacement = |channel| displacement(channel, sensors, arguments);
        Self {
            displacements: channels.iter().map(displacement).collect(),
            train: (arguments.data.len() == 1).then_some(arguments.train),
            sensors,
        }
    }
}

fn displacement<'a>(
    channel: &'a Channel,
    sensors: &'a [String],
    arguments: &FitThermalArguments,
) -> Displacement<'a> {
    let name = |sensor: usize| sensors.get(sensor).cloned().unwrap_or_default();
    let judged = &channel.judged;
    let found = &judged.terms;
    let prediction = |found: &'a ThermalPrediction| Prediction {
        sensors: (found.sensors.iter())
            .filter_map(|sensor| Some(sensors.get(*sensor)?.as_str()))
            .collect(),
        found,
    };
    let number = |number: &ThermalNumber| {
        let (lag_s, scale, unit) = match number.effect {
            ThermalEffect::Drift { lag_s } if channel.is_angular() => {
                (Some(lag_s), 1.0, "urad_per_k")
            }
            ThermalEffect::Drift { lag_s } => (Some(lag_s), 1.0, "um_per_k"),
            ThermalEffect::Expansion => (None, 1e3, "um_per_m_k"),
        };
        Number {
            sensor: name(number.sensor),
            lag_s,
            value: number.value * scale,
            uncertainty: number.uncertainty * scale,
            unit,
        }
    };
    let left_out = arguments.data.iter().zip(&judged.left_out);
    let left_out = left_out.map(|(file, &rms)| LeftOut { file: file.display().to_string(), rms });
    let seen = found.seen.iter().map(|seen| Seen {
        sensor: name(seen.sensor),
        degc: seen.degc,
        k_per_min: seen.k_per_min,
    });
    let (constant, constant_spread) = found.constant_at(arguments.reference);
    let (drift, expansion) = terms(found, sensors);
    Displacement {
        name: &channel.name,
        error: channel.error,
        unit: if channel.is_angular() { DeviationUnit::Urad } else { DeviationUnit::Um },
        recommended: judged.verdict() == ThermalVerdict::Good,
        without_terms_rms: judged.none_rms,
        baseline: prediction(&judged.plain),
        dense: judged.dense.as_ref().map(prediction),
        fit: prediction(&judged.few),
        left_out: left_out.collect(),
        numbers: found.numbers.iter().map(number).collect(),
        sizes: &found.path,
        drift,
        expansion,
        seen: seen.collect(),
        constant,
        constant_spread,
        toml: toml(channel, sensors, arguments.reference),
    }
}

/// Drift terms by time constant, and expansions. The fixed point of an expansion follows from the drift of the same
/// sensor without a lag.
fn terms(found: &ThermalTerms, sensors: &[String]) -> (Vec<DriftTerm>, Vec<Expansion>) {
    let expansion_of = |sensor: usize| {
        let mut numbers = found.numbers.iter();
        let number = numbers.find(|n| n.sensor == sensor && n.effect == ThermalEffect::Expansion);
        number.filter(|number| number.value != 0.0)
    };
    let (mut drift, mut expansions): (Vec<DriftTerm>, Vec<Expansion>) = (Vec::new(), Vec::new());
    for number in &found.numbers {
        let Some(sensor) = sensors.get(number.sensor) else {
            continue;
        };
        let ThermalEffect::Drift { lag_s } = number.effect else {
            let without_lag = found.numbers.iter().find(|other| {
                other.sensor == number.sensor && other.effect == ThermalEffect::Drift { lag_s: 0.0 }
            });
            let fixed_mm = without_lag.map_or(0.0, |other| -other.value / number.value);
            expansions.push(Expansion {
                sensor: sensor.clone(),
                um_per_m_k: number.value * 1e3,
                fixed_mm: if fixed_mm.is_finite() { fixed_mm } else { 0.0 },
            });
            continue;
        };
        if lag_s == 0.0 && expansion_of(number.sensor).is_some() {
            continue;
        }
        let place = drift.iter().position(|known| known.lag_s == lag_s);
        let place = place.unwrap_or_else(|| {
            drift.push(DriftTerm { lag_s, sensors: BTreeMap::new() });
            drift.len() - 1
        });
        drift[place].sensors.insert(sensor.clone(), number.value);
    }
    (drift, expansions)
}

/// The terms as `[[thermal.drift]]`, `[[thermal.expansion]]` and `[[thermal.seen]]`, with their constant. An unnamed
/// error becomes a placeholder, which a machine file rejects.
fn toml(channel: &Channel, sensors: &[String], reference_degc: f64) -> String {
    let found = &channel.judged.terms;
    let (unit, symbol) = if channel.is_angular() { ("urad", "µrad") } else { ("um", "µm") };
    let (error, curve) = match channel.error {
        Some(error) => (error.to_string(), format!("the curve of {error}")),
        None => (GAP.to_owned(), "its curve".to_owned()),
    };
    let mut text = String::new();
    if channel.error.is_none() {
        let _ = writeln!(text, "# Put the error that {} is in place of {GAP}.", channel.name);
    }
    let _ = writeln!(
        text,
        "# With {reference_degc} °C as [thermal] reference the constant\n# {:.3} {symbol} belongs to {curve}.",
        found.constant_at(reference_degc).0
    );
    let (drift, expansions) = terms(found, sensors);
    for term in expansions {
        let _ = write!(
            text,
            "[[thermal.expansion]]\nerror = \"{error}\"\nsensor = {}\num_per_m_k = {:.6}\nfixed_mm = {:.3}\n",
            toml_string(&term.sensor),
            term.um_per_m_k,
            term.fixed_mm
        );
    }
    for DriftTerm { lag_s, sensors } in drift {
        let weights = sensors.iter().map(|(name, k)| format!("{} = {k:.6}", toml_key(name)));
        let _ = write!(
            text,
            "[[thermal.drift]]\nerror = \"{error}\"\nsensors = {{ {} }}\n{unit}_per_k = 1.0\nlag_s = {lag_s:.1}\n",
            weights.collect::<Vec<_>>().join(", "),
        );
    }
    for seen in &found.seen {
        let Some(sensor) = sensors.get(seen.sensor) else {
            continue;
        };
        // Round outwards, so that the tested values stay within the range.
        let [low, high] = outwards(seen.degc, 1e2);
        let [fall, rise] = outwards(seen.k_per_min, 1e4);
        let _ = write!(
            text,
            "[[thermal.seen]]\nerror = \"{error}\"\nsensor = {}\ndegc = [{low:.2}, {high:.2}]\nk_per_min = [{fall:.4}, {rise:.4}]\n",
            toml_string(sensor)
        );
    }
    text
}

/// Rounds a range outwards to multiples of 1/`parts`. The result is not empty.
fn outwards([low, high]: [f64; 2], parts: f64) -> [f64; 2] {
    let (low, high) = ((low * parts).floor(), (high * parts).ceil());
    [low / parts, high.max(low + 1.0) / parts]
}

fn text(
    channels: &[Channel],
    document: &FitThermal<'_>,
    arguments: &FitThermalArguments,
) -> String {
    let mut text = comparison(channels, arguments);
    for (channel, of) in channels.iter().zip(&document.displacements) {
        let paste = match channel.judged.verdict() {
            ThermalVerdict::Good => format!("# {}\n{}", channel.name, of.toml),
            verdict => worse(channel, verdict),
        };
        let _ = write!(
            text,
            "\n{}\n{}\n{}\n{paste}",
            channel.name,
            numbers(&of.numbers),
            sizes(channel)
        );
    }
    text
}

fn worse(channel: &Channel, verdict: ThermalVerdict) -> String {
    let unit = channel.symbol();
    let judged = &channel.judged;
    let few = fixed(judged.few.rms, 2);
    let decides = |by: (f64, f64)| {
        let [by, error] = [by.0, by.1].map(|square| fixed(square, 2));
        let parts = if judged.left_out.is_empty() { "stretches" } else { "files" };
        format!(
            "(mean squares differ by {by} {unit}², with a standard error over the {parts} of {error} {unit}²)"
        )
    };
    let why = if verdict == ThermalVerdict::WorseThanPlain {
        let plain = fixed(judged.plain.rms, 2);
        format!(
            "they predict worse ({few} {unit}) than regression without time constants ({plain} {unit}) {}. Try `--lags 0`, or take more tests.",
            decides(judged.loss())
        )
    } else {
        let none = fixed(judged.none_rms, 2);
        let by = judged.gain();
        let how = if by.0 > 0.0 && by.0 <= by.1 {
            "not surely better"
        } else if by.0 > 0.0 {
            "hardly better"
        } else {
            "no better"
        };
        format!(
            "they predict tests that they have not seen ({few} {unit}) {how} than no terms at all ({none} {unit}) {}. Either these temperatures do not move what was measured, or it takes more tests to see that.",
            decides(by)
        )
    };
    folded(&format!("No terms are printed: {why}"), "")
}

fn comparison(channels: &[Channel], arguments: &FitThermalArguments) -> String {
    let mut lines = table(&[
        "RMS of prediction",
        "no lag",
        "dense",
        "few terms",
        "worst",
        "from h",
        "numbers",
        "sensors",
        "lags",
    ]);
    for channel in channels {
        let judged = &channel.judged;
        let few = &judged.few;
        let worst = few.worst.as_ref();
        let or_nothing = |value: Option<String>| value.unwrap_or_else(|| "-".to_owned());
        lines.add_row([
            channel.name.clone(),
            fixed(judged.plain.rms, 2),
            or_nothing(judged.dense.as_ref().map(|dense| fixed(dense.rms, 2))),
            fixed(few.rms, 2),
            or_nothing(worst.map(|w| fixed(w.rms, 2))),
            or_nothing(worst.map(|w| fixed(w.from_s / 3600.0, 1))),
            judged.terms.numbers.len().to_string(),
            judged.terms.sensors().len().to_string(),
            judged.terms.lags_s().len().to_string(),
        ]);
    }
    let of_what = if let [_] = arguments.data[..] {
        format!(
            "The prediction is of the last {} % of the rows, by terms found from those before them, in the unit of the column (µm or µrad). Dense: all sensors with many time constants, as a measure of what few terms lose. Worst: the largest error of ten stretches of equally many rows; from h: where that stretch begins, in hours of the file.",
            fixed(100.0 * (1.0 - arguments.train), 0)
        )
    } else {
        "The prediction is of each file from all others, in the unit of the column (µm or µrad), both counted from the start of the file.".to_owned()
    };
    table_text(&lines) + "\n" + &folded(&of_what, "")
}

fn numbers(numbers: &[Number]) -> String {
    let mut lines = table(&["sensor", "lag s", "value", "+/-", "unit"]);
    for number in numbers {
        let unit = match number.unit {
            "um_per_m_k" => "µm/(m·K)",
            "urad_per_k" => "µrad/K",
            _ => "µm/K",
        };
        lines.add_row([
            number.sensor.clone(),
            number.lag_s.map_or("-".to_owned(), |lag_s| lag_s.to_string()),
            fixed(number.value, 3),
            fixed(number.uncertainty, 3),
            unit.to_owned(),
        ]);
    }
    table_text(&lines)
}

fn sizes(channel: &Channel) -> String {
    let mut lines = table(&["numbers", "RMS of validation", "+/-"]);
    let terms = &channel.judged.terms;
    for size in terms.path.iter().rev() {
        let mark = if size.numbers == terms.numbers.len() { "*" } else { "" };
        lines.add_row([
            format!("{}{mark}", size.numbers),
            fixed(size.rms, 2),
            fixed(size.standard_error, 2),
        ]);
    }
    table_text(&lines) + "* taken: the fewest within one standard error of the best\n"
}

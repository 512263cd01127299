use std::{
    collections::BTreeMap,
    fmt::Write as _,
    path::{Path, PathBuf},
};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_calibrate::{CalibrationFile, not_observed};
use volcomp_document::Document as Toml;
use volcomp_identify::Observations;
use volcomp_model::Machine;
use volcomp_report::{
    Check, Edition, Report, Size, Stated, Tolerance, Verdict as Outcome, checks, html,
    refuse_two_units, tolerances, uncertainty,
};
use volcomp_vocabulary::{AxisName, bounds::PLAUSIBLE_DEGC};

use super::{
    Answer,
    calibrate::fit,
    fixed,
    identify::find,
    iso230::parse_edition,
    same_file,
    uncertainty::{Measured, UncertaintyArguments},
};
use crate::{
    arguments::OthersArguments, compensation::refuse_other_geometry, failure::Failure,
    output::OutputFile,
};

/// Write the report of a calibration as one self-contained HTML file
///
/// Contains the verdict against tolerances, warnings, each error curve with its readings, ISO 230-2, squareness,
/// diagonals, the volumetric error and its uncertainty, errors not measured, and the errors that observations determine.
/// It opens in any browser without a network and prints on A4. The same input gives the same bytes: a date is included
/// only if a file or --date states one.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp report calibration.toml -o report.html --tolerance A=10,V=40
  volcomp report calibration.toml -o report.html --truth truth.toml")]
pub(crate) struct ReportArguments {
    /// Calibration file, observations file or machine file (TOML)
    #[arg(value_name = "FILE")]
    source: PathBuf,
    /// HTML file to write
    #[arg(long, short)]
    output: PathBuf,
    /// Machine file with the errors before compensation
    #[arg(long, value_name = "MACHINE")]
    before: Option<PathBuf>,
    /// Machine file with the true errors, to show what correction by FILE leaves of them
    #[arg(long, value_name = "MACHINE")]
    truth: Option<PathBuf>,
    /// Limits, µm or µrad, for every positioning test (A=10), one axis (C.A=30), one error (EXX.A=8; EC0Y=20), or the
    /// largest tool tip error over poses of all axes after alignment (V=40)
    #[arg(long, value_name = "NAME=LIMIT,…")]
    tolerance: Option<String>,
    /// Edition of ISO 230-2: 1997, 2006 or 2014 [default: 2014]
    #[arg(long, value_parser = parse_edition)]
    edition: Option<u16>,
    /// Override the machine name
    #[arg(long, value_name = "TEXT")]
    name: Option<String>,
    /// Override the serial number of the machine
    #[arg(long, value_name = "TEXT")]
    serial: Option<String>,
    /// Override the operator
    #[arg(long, value_name = "TEXT")]
    operator: Option<String>,
    /// Override the date of the measurement
    #[arg(long, value_name = "TEXT")]
    date: Option<String>,
    /// Override the instrument
    #[arg(long, value_name = "TEXT")]
    instrument: Option<String>,
    /// Customer
    #[arg(long, value_name = "TEXT")]
    customer: Option<String>,
    /// Certificate number
    #[arg(long, value_name = "TEXT")]
    certificate: Option<String>,
    /// Override the air temperature, °C: 20.1 or 19.8,20.4
    #[arg(long, value_name = "LOW,HIGH", allow_hyphen_values = true)]
    air_degc: Option<String>,
    /// Override the material temperature, °C: 20.1 or 19.8,20.4
    #[arg(long, value_name = "LOW,HIGH", allow_hyphen_values = true)]
    material_degc: Option<String>,
    #[command(flatten)]
    others: OthersArguments,
    /// Number of Monte Carlo samples for the uncertainty of the volumetric error; 0: none
    #[arg(long, default_value_t = 0, value_parser = clap::value_parser!(u64).range(0..=100_000))]
    trials: u64,
    /// Random seed; the same seed gives the same digits on any number of cores
    #[arg(long, default_value_t = 1)]
    seed: u64,
}

/// Result of `volcomp report`: the written file and the verdict.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct WrittenReport {
    /// Path of the written HTML file.
    file: String,
    /// Result against the tolerances of `--tolerance`. `pass`: all within; `fail`: at least one
    /// exceeded; `undecided`: none exceeded, but at least one is nearer to its limit than its
    /// uncertainty or not measured; `none`: no tolerance is stated.
    verdict: &'static str,
    /// Every quantity with a tolerance.
    checks: Vec<ReportCheck>,
    /// Number of error curves in the report.
    curves: usize,
    /// Warnings of the report, most severe first.
    warnings: Vec<String>,
    /// Volumetric error over poses of all axes in the last state; null without at least two of X, Y
    /// and Z.
    volumetric: Option<Volumetric>,
    /// Volumetric error before a compensation, or the only known one; null without at least two of
    /// X, Y and Z.
    before: Option<Largest>,
    /// Volumetric error after a compensation; null without `--truth` or `--before`.
    after: Option<Largest>,
}

/// A quantity and its tolerance.
#[derive(Debug, Serialize, JsonSchema)]
struct ReportCheck {
    /// Symbol of the quantity.
    symbol: String,
    /// Error and file of the quantity; empty if the symbol identifies it.
    of: String,
    /// Value; null: not measured.
    value: Option<f64>,
    /// Upper limit.
    limit: f64,
    /// `µm` or `µrad`.
    unit: String,
    /// Expanded uncertainty (k = 2) from the stated contributions and, for a squareness, from the
    /// slopes of its lines; null if none is known.
    uncertainty: Option<f64>,
    /// `pass`, `fail`, `undecided` (nearer to the limit than the uncertainty) or `not_evaluated`;
    /// by ISO 14253-1 if an uncertainty is stated.
    outcome: &'static str,
}

/// The volumetric error over poses of all axes after one best-fit rigid-body alignment of the workpiece.
#[derive(Debug, Serialize, JsonSchema)]
struct Volumetric {
    /// Largest error of the tool tip, µm.
    position_um: f64,
    /// Largest tilt of the tool axis, µrad.
    tilt_urad: f64,
    /// The pose of the largest error of the tip, mm and deg.
    worst_at: BTreeMap<String, f64>,
    /// Tool with the largest error; empty: the tool in the spindle.
    worst_tool: String,
}

/// Maximum and root mean square of the volumetric error.
#[derive(Debug, Serialize, JsonSchema)]
#[expect(clippy::struct_field_names, reason = "the keys end in their unit")]
struct Largest {
    /// Maximum, µm.
    max_um: f64,
    /// Root mean square, µm.
    rms_um: f64,
    /// Maximum after alignment of the workpiece, whose location is not an error of the machine, µm.
    form_max_um: f64,
    /// Root mean square after alignment, µm.
    form_rms_um: f64,
}

impl From<&Check> for ReportCheck {
    fn from(check: &Check) -> Self {
        Self {
            symbol: check.symbol.clone(),
            of: check.of.to_string(),
            value: check.value,
            limit: check.limit,
            unit: check.unit.clone(),
            uncertainty: check.uncertainty,
            outcome: match check.outcome {
                Outcome::Pass => "pass",
                Outcome::Fail => "fail",
                Outcome::Undecided => "undecided",
                Outcome::NotEvaluated => "not_evaluated",
            },
        }
    }
}

enum Source {
    Calibration(Box<CalibrationFile>),
    Observations(Box<Observations>),
    Machine(Box<Machine>),
}

pub(crate) fn run(arguments: &ReportArguments) -> Result<Answer, Failure> {
    let limits = match &arguments.tolerance {
        Some(text) => tolerances(text).map_err(|error| Failure::Input(format!("--{error}")))?,
        None => Vec::new(),
    };
    let source = Source::read(&arguments.source)?;
    let mut inputs = source.files(&arguments.source);
    inputs.extend(arguments.before.iter().chain(&arguments.truth).cloned());
    if let Some(path) = same_file(&inputs, &arguments.output) {
        return Err(Failure::Input(format!(
            "--output {}: is {}, which this report reads; expected another file",
            arguments.output.display(),
            path.display()
        )));
    }
    refuse_other_endings(&arguments.output)?;
    let output = OutputFile::open(&arguments.output)?;
    let (machine, mut report) = source.report(arguments)?;
    refuse_two_units(&report, &limits).map_err(|error| Failure::Input(format!("--{error}")))?;
    let mut notes = machine.notes();
    let others = arguments.others.read(&machine, &mut notes)?;
    notes.extend(working_space(&mut report, arguments, &machine, &others)?);
    if arguments.trials > 0 {
        drawn(&mut report, arguments, &source, &machine, &mut notes)?;
    }
    report.checks = checks(&report, &limits);
    let page = html(&report);
    if output.replaces(&page) {
        notes.push(format!("replaced the file that was there: {}", arguments.output.display()));
    }
    output.write_whole(&page)?;
    answer(arguments, &report, &limits, notes)
}

/// Parses one temperature, or the lowest and the highest, °C, separated by a comma or semicolon.
fn temperatures(option: &str, text: Option<&str>) -> Result<Option<[f64; 2]>, Failure> {
    let Some(text) = text else {
        return Ok(None);
    };
    let numbers: Option<Vec<f64>> =
        text.split([',', ';']).map(|number| number.trim().parse().ok()).collect();
    let range = match numbers.as_deref() {
        Some([only]) => Some([*only; 2]),
        Some([low, high]) if low <= high => Some([*low, *high]),
        _ => None,
    };
    let is_plausible = |range: &[f64; 2]| range.iter().all(|degc| PLAUSIBLE_DEGC.contains(degc));
    range.filter(is_plausible).map(Some).ok_or_else(|| {
        Failure::Input(format!(
            "{option}: found `{text}`, expected one temperature or the lowest and the highest in °C: 19.8,20.4"
        ))
    })
}

/// Rejects file extensions other than those of HTML, because a browser would not display the report.
fn refuse_other_endings(output: &Path) -> Result<(), Failure> {
    let ending = output.extension().unwrap_or_default();
    if ["html", "htm"].iter().any(|html| ending.eq_ignore_ascii_case(html)) {
        return Ok(());
    }
    Err(Failure::Input(format!(
        "--output {}: expected a file that ends in .html; a browser prints it as PDF: chromium --headless --print-to-pdf=report.pdf report.html",
        output.display()
    )))
}

impl Source {
    /// Reads a file. Its keys determine its kind.
    fn read(path: &Path) -> Result<Self, Failure> {
        let is_machine =
            Toml::read(path)?.decode(|root| Ok::<_, Failure>(root.get("structure").is_some()))?;
        if is_machine {
            return Ok(Self::Machine(Box::new(Machine::read(path)?)));
        }
        Ok(match Measured::read(path)? {
            Measured::Calibration(file) => Self::Calibration(file),
            Measured::Observations(observations) => Self::Observations(observations),
        })
    }

    fn machine(&self) -> &Machine {
        match self {
            Self::Calibration(file) => &file.machine,
            Self::Observations(observations) => &observations.machine,
            Self::Machine(machine) => machine,
        }
    }

    /// The input files, which the report must not overwrite.
    fn files(&self, path: &Path) -> Vec<PathBuf> {
        match self {
            Self::Calibration(file) => file.files.clone(),
            Self::Observations(observations) => observations.files.clone(),
            Self::Machine(_) => vec![path.to_owned()],
        }
    }

    fn report(&self, arguments: &ReportArguments) -> Result<(Machine, Report), Failure> {
        let stated = Stated {
            machine: arguments.name.clone().or_else(|| name_of(self.machine())),
            serial: arguments.serial.clone(),
            date: arguments.date.clone(),
            operator: arguments.operator.clone(),
            instrument: arguments.instrument.clone(),
            customer: arguments.customer.clone(),
            certificate: arguments.certificate.clone(),
            air_degc: temperatures("--air-degc", arguments.air_degc.as_deref())?,
            material_degc: temperatures("--material-degc", arguments.material_degc.as_deref())?,
            // clap has already rejected other years.
            edition: (arguments.edition.and_then(Edition::of_year)).unwrap_or_default(),
        };
        let name = arguments.source.display().to_string();
        Ok(match self {
            Self::Calibration(file) => {
                let found = fit(file)?;
                let report = Report::of_calibration(&name, file, &found, &stated);
                (found.machine, report)
            }
            Self::Observations(observations) => {
                let found = find(observations)?;
                let open = not_observed(observations);
                let report = Report::of_observations(&name, observations, &found, open, &stated);
                (found.machine, report)
            }
            Self::Machine(machine) => {
                let report = Report::of_machine(&name, machine, &stated);
                (Machine::clone(machine), report)
            }
        })
    }
}

fn name_of(machine: &Machine) -> Option<String> {
    let name = &machine.name;
    (!name.is_empty()).then(|| name.clone())
}

/// Adds diagonals and map, before and after a compensation if two states are known.
fn working_space(
    report: &mut Report,
    arguments: &ReportArguments,
    machine: &Machine,
    others: &[(AxisName, f64)],
) -> Result<Option<String>, Failure> {
    let read = |path: &PathBuf| {
        let found = Machine::read(path)?;
        refuse_other_geometry(path, &found, machine, &arguments.source.display())?;
        Ok::<_, Failure>(found)
    };
    let before = arguments.before.as_ref().map(read).transpose()?;
    let truth = arguments.truth.as_ref().map(read).transpose()?;
    let (before, truth) = (before.as_ref(), truth.as_ref());
    Ok(report.add_working_space(machine, before, truth, others, &|| false)?)
}

/// Adds the uncertainty of the position error, from Monte Carlo samples.
fn drawn(
    report: &mut Report,
    arguments: &ReportArguments,
    source: &Source,
    machine: &Machine,
    notes: &mut Vec<String>,
) -> Result<(), Failure> {
    if matches!(source, Source::Machine(_)) {
        return Err(Failure::Input(format!(
            "--trials: {} is a machine file and has no readings to draw from, expected a calibration or a file of observations",
            arguments.source.display()
        )));
    }
    let from = UncertaintyArguments {
        uncertainty: Some(arguments.source.clone()),
        trials: arguments.trials.max(2),
        seed: arguments.seed,
    };
    let mut told = Vec::new();
    if let Some(measured) = from.read(machine, &mut told)? {
        let (ensemble, _) = from.ensemble(&measured, machine, &mut told)?;
        let trials = (from.trials, from.seed);
        if let Some(found) = uncertainty(machine, &ensemble, trials)? {
            let all = report.uncertainty.get_or_insert_default();
            all.drawn = Some(found);
            all.not_counted.clone_from(&told);
        }
    }
    notes.extend(told);
    Ok(())
}

fn answer(
    arguments: &ReportArguments,
    report: &Report,
    limits: &[Tolerance],
    notes: Vec<String>,
) -> Result<Answer, Failure> {
    let whole = Outcome::of_all(report.checks.iter().map(|check| check.outcome));
    let met = report.all_met();
    let (verdict, words) = match whole {
        _ if limits.is_empty() => ("none", "no tolerance stated"),
        Outcome::Fail => ("fail", "not all stated tolerances are met"),
        Outcome::NotEvaluated | Outcome::Undecided => {
            ("undecided", "not every stated tolerance is decided")
        }
        Outcome::Pass => ("pass", met.as_str()),
    };
    let largest = |size: &Size| Largest {
        max_um: size.max_um,
        rms_um: size.rms_um,
        form_max_um: size.form_max_um,
        form_rms_um: size.form_rms_um,
    };
    let volume = report.volume.as_ref();
    let document = WrittenReport {
        file: arguments.output.display().to_string(),
        verdict,
        checks: report.checks.iter().map(Into::into).collect(),
        curves: report.curves.len(),
        warnings: report.warnings.iter().map(|warning| warning.text.clone()).collect(),
        volumetric: volume.map(|volume| {
            let last = &volume.after.as_ref().unwrap_or(&volume.before).found;
            let at = last.at.iter().map(|(axis, at)| (axis.to_string(), *at));
            Volumetric {
                position_um: last.form_max_um,
                tilt_urad: last.tilt_urad,
                worst_at: at.collect(),
                worst_tool: last.tool.clone(),
            }
        }),
        before: volume.map(|volume| largest(&volume.before.found)),
        after: volume.and_then(|volume| volume.after.as_ref()).map(|after| largest(&after.found)),
    };
    let mut text = format!("{words}\n");
    for check in &report.checks {
        let _ = writeln!(text, "  {check}");
    }
    if let Some(before) = &document.before {
        let um = fixed(before.form_max_um, 2);
        let _ = writeln!(text, "largest volumetric error over all axes, after alignment: {um} µm");
    }
    if let Some(after) = &document.after {
        let um = fixed(after.form_max_um, 2);
        let _ = writeln!(text, "after the compensation: {um} µm");
    }
    if let Some(volume) = volume {
        let last = &volume.after.as_ref().unwrap_or(&volume.before).found;
        let _ = writeln!(
            text,
            "  at {}; largest tilt of the tool axis {} µrad",
            last.place(),
            fixed(last.tilt_urad, 2)
        );
    }
    let (curves, warnings) = (document.curves, document.warnings.len());
    let _ = writeln!(text, "wrote {}: {curves} curves, {warnings} warnings", document.file);
    let met = limits.is_empty() || whole == Outcome::Pass;
    Ok(Answer { tolerances_met: met, ..Answer::new(&document, text, notes)? })
}

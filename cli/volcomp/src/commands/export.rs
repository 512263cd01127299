use std::{
    fmt,
    path::{Path, PathBuf},
    str::FromStr,
};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_identify::unit_symbol;
use volcomp_model::{Machine, Temperatures};
use volcomp_tables::axis_table::{
    AxisLoss, AxisNumbers, Category, Content, ExchangeError, Facts, Firmware, Format, LineError,
    LinearSettings, Loss, TableOptions, TextFile, WriteOptions, Written, firmware_loss,
    linear_settings, loss, sampled, write, write_settings,
};
use volcomp_vocabulary::AxisName;

use super::{Answer, ByAxis, fixed, machine_notes, table, table_text};
use crate::{
    arguments::{LimitArgument, MachineArguments, RAISE_LIMIT, axis_numbers, by_axis, parse_at},
    failure::{Failure, FileFailure},
    output::OutputFile,
    table::{folded, to_the_left},
};

/// Write the corrections as compensation tables of a control
///
/// A control holds less than the model: tables over one axis, on the lines through the reference position --at. The loss
/// is reported, for all errors together and for each kind alone. No format was tried on a real control; the head of each
/// file, or volcomp-tables-FORMAT.txt beside it, states the evidence for its sign.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp export -m gantry.toml --format csv --step 200 -o gantry-tables.csv
  volcomp export -m mill.toml --format siemens-840d --at Z=-200 -o mill-840d")]
pub(crate) struct ExportArguments {
    #[command(flatten)]
    machine: MachineArguments,
    /// csv, linuxcnc, linuxcnc-type1, siemens-840d, heidenhain, isg-csv or fanuc; steps and skew for klipper, marlin or
    /// grbl
    #[arg(long, value_name = "NAME")]
    format: Target,
    /// Folder for the files, or a path with an extension for a format of one file; existing tables are replaced, with a
    /// note
    #[arg(long, short, value_name = "PATH")]
    output: PathBuf,
    /// Spacing on linear axes, mm
    #[arg(long, value_name = "MM", default_value_t = 50.0)]
    step: f64,
    /// Spacing on rotary axes, deg; with `modulo` an integer fraction of the period
    #[arg(long, value_name = "DEG", default_value_t = 15.0)]
    step_deg: f64,
    /// Positions of the axes that a table does not cover: X=400,Z=-100 (mm, deg); axes not named are at 0 or the nearest
    /// end of travel [default: the middle of the travel of linear axes, in whole steps]
    #[arg(long, allow_hyphen_values = true)]
    at: Option<String>,
    /// Steps per mm now set in marlin or grbl, rotation distances (mm) in klipper: X=80,Y=80,Z=400 [default: write their
    /// factors]
    #[arg(long, value_name = "STEPS")]
    steps: Option<String>,
    #[command(flatten)]
    limit: LimitArgument,
    #[command(flatten)]
    control: ControlArguments,
}

/// What is exported: compensation tables for a control, or the steps and skew settings of a firmware without tables.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Target {
    Tables(Format),
    Firmware(Firmware),
}

impl Target {
    fn name(self) -> &'static str {
        match self {
            Self::Tables(format) => format.name(),
            Self::Firmware(firmware) => firmware.name(),
        }
    }
}

impl fmt::Display for Target {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name())
    }
}

impl FromStr for Target {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if let Some(firmware) = Firmware::ALL.into_iter().find(|of| of.name() == text) {
            return Ok(Self::Firmware(firmware));
        }
        text.parse()
            .map(Self::Tables)
            .map_err(|error| format!("{error}, {}", Firmware::ALL.map(Firmware::name).join(", ")))
    }
}

/// What is not in a machine file about its control.
#[derive(clap::Args)]
pub(crate) struct ControlArguments {
    /// Axis numbers in the control: X=1,Y=2 [default: 1, 2, 3 … in the order X Y Z A B C U V W; for import those stated
    /// in the files]
    #[arg(long, value_name = "NUMBERS")]
    pub(crate) axis_numbers: Option<String>,
    /// Encoder of `$AA_ENC_COMP`: 0 or 1
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u8).range(0..=1))]
    pub(crate) encoder: Option<u8>,
    /// Detection unit of a FANUC control, mm or deg
    #[arg(long, value_name = "UNIT", default_value_t = 0.001)]
    pub(crate) detection_unit: f64,
}

impl ControlArguments {
    pub(crate) fn numbers(&self) -> Result<Option<AxisNumbers>, Failure> {
        self.axis_numbers.as_deref().map(axis_numbers).transpose()
    }
}

/// Result of `volcomp export`: the written tables, and what they lose against the model.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Export {
    /// Format of the tables, as in `--format`.
    format: &'static str,
    /// Paths of the written files.
    files: Vec<String>,
    /// Checksum of the machine file, as written in the tables.
    machine: String,
    /// Position of each axis that the tables hold constant, mm and deg.
    at: ByAxis,
    /// Meaning of the sign of the numbers in the files.
    sign: &'static str,
    /// Basis of the sign convention, and whether it is proven.
    trust: &'static str,
    /// The written tables.
    tables: Vec<Made>,
    /// Errors that the files cannot represent, and settings required at the control.
    notes: Vec<String>,
    /// Steps and skew, of firmware without tables.
    #[serde(skip_serializing_if = "Option::is_none")]
    settings: Option<LinearSettings>,
    /// Difference between these tables or settings and the model.
    loss: Loss,
}

/// One compensation table, as written.
#[derive(Debug, Serialize, JsonSchema)]
struct Made {
    /// Axis along which the table runs.
    input: AxisName,
    /// What the table corrects: an axis letter or the name of an error.
    output: String,
    /// Number of positions in the table.
    positions: usize,
    /// First position of the table, mm or deg.
    first: f64,
    /// Last position of the table, mm or deg.
    last: f64,
    /// Whether the table has separate values for the two directions of motion.
    both_directions: bool,
    /// Largest absolute value of the table, in `unit`.
    largest: f64,
    /// Unit of `largest`: `um` or `urad`.
    unit: &'static str,
}

pub(crate) fn run(arguments: &ExportArguments) -> Result<Answer, Failure> {
    let (machine, temperatures) = arguments.machine.read()?;
    let mut notes = machine_notes(&machine, &temperatures);
    let at = arguments.at.as_deref().map(parse_at).transpose()?;
    let mut options = TableOptions {
        step_mm: arguments.step,
        step_deg: arguments.step_deg,
        at: Vec::new(),
        limit: arguments.limit.limit()?,
    };
    options.at = at.unwrap_or_else(|| options.in_the_middle(&machine));
    let reference = options.reference(&machine)?;
    let stated: Vec<String> =
        temperatures.iter().map(|(name, degc)| format!("{name} = {degc} °C")).collect();
    let facts = Facts::of(&machine, reference.clone(), stated.join(", "));
    let place = Place::of(arguments)?;
    let made = match arguments.format {
        Target::Tables(format) => {
            tables(arguments, format, &machine, &temperatures, &options, facts)?
        }
        Target::Firmware(firmware) => {
            let steps = arguments.steps.as_deref();
            let steps = steps.map(|text| by_axis("--steps", text)).transpose()?;
            let settings = linear_settings(&machine, &temperatures, &options)?;
            let now = steps.unwrap_or_default();
            Exported {
                written: write_settings(firmware, &settings, &machine, &facts, &now)?,
                loss: firmware_loss(&machine, &temperatures, &options, firmware)?,
                tables: Vec::new(),
                holds_along_lines: false,
                settings: Some(settings),
                sign: firmware.sign(),
                trust: firmware.trust(),
            }
        }
    };
    if arguments.at.is_none() && made.holds_along_lines {
        notes.extend(not_at(&reference));
    }
    notes.extend(made.loss.axes.iter().filter_map(worse_than_none));
    let reversals = made.loss.categories.iter().filter(|of| of.category == Category::Reversal);
    notes.extend(reversals.flat_map(|of| &of.axes).filter_map(larger_reversal));
    let (files, replaced) = place.write(&made.written.files, arguments)?;
    if !replaced.is_empty() {
        notes.push(format!("replaced what was there: {}", replaced.join(", ")));
    }
    notes.extend(other_tables(arguments, &files));
    let document = Export {
        format: arguments.format.name(),
        files,
        machine: machine.checksum(),
        at: reference.into_iter().collect(),
        sign: made.sign,
        trust: made.trust,
        tables: made.tables,
        notes: made.written.notes,
        settings: made.settings,
        loss: made.loss,
    };
    let text = text(&document);
    Answer::new(&document, text, notes)
}

struct Exported {
    written: Written,
    loss: Loss,
    tables: Vec<Made>,
    /// True if the tables correct axes: the tables then hold only on the lines through the reference position.
    holds_along_lines: bool,
    settings: Option<LinearSettings>,
    sign: &'static str,
    trust: &'static str,
}

fn tables(
    arguments: &ExportArguments,
    format: Format,
    machine: &Machine,
    temperatures: &Temperatures,
    options: &TableOptions,
    facts: Facts,
) -> Result<Exported, Failure> {
    if let Some(steps) = &arguments.steps {
        return Err(Failure::Input(format!(
            "--steps: found {steps} for the format {format}, expected it for klipper, marlin or grbl alone"
        )));
    }
    let numbers = arguments.control.numbers()?;
    let write_options = WriteOptions {
        facts,
        axes: numbers.unwrap_or_else(|| AxisNumbers::of_machine(machine)),
        encoder: arguments.control.encoder.unwrap_or(0),
        detection_unit: arguments.control.detection_unit,
    };
    let content = sampled(machine, temperatures, options, format)?;
    let written = write(format, &content, &write_options)?;
    Ok(Exported {
        loss: loss(machine, temperatures, options, format, &write_options)?,
        tables: made(&content, &written.left_out),
        holds_along_lines: matches!(content, Content::Axes(_)),
        written,
        settings: None,
        sign: format.sign(),
        trust: format.trust(),
    })
}

/// Note that tables without `--at` hold on the lines through these positions; `None` for a machine with one axis, whose
/// only line is the axis itself.
fn not_at(reference: &[(AxisName, f64)]) -> Option<String> {
    let places = reference.iter();
    let places: Vec<String> = places.map(|(name, at)| format!("{name}={}", rounded(*at))).collect();
    (reference.len() > 1).then(|| {
        format!(
            "--at is not given: the tables hold on the lines through the middle of the travel, {}; state the middle of the space in which you work",
            places.join(",")
        )
    })
}

fn rounded(at: f64) -> f64 {
    (at * 1e3).round() / 1e3 + 0.0
}

fn worse_than_none(axis: &AxisLoss) -> Option<String> {
    (axis.largest > axis.correction).then(|| {
        let unit = unit_symbol(axis.unit);
        format!(
            "WARNING: with these tables axis {} is further off than without: by up to {} {unit} (at {}), without them by up to {} {unit}. They help near the line through --at alone: \
             state the middle of the space in which you work, or leave this table off",
            axis.axis,
            fixed(axis.largest, 2),
            place_of(axis),
            fixed(axis.correction, 2),
        )
    })
}

fn larger_reversal(axis: &AxisLoss) -> Option<String> {
    /// What rounding of the values may add, µm or µrad.
    const ROUNDING: f64 = 0.1;
    (axis.largest > axis.correction + ROUNDING).then(|| {
        format!(
            "WARNING: with these tables the reversal error of axis {} grows: to {} {} on each side (at {}), from {} without them, since it is not the same everywhere",
            axis.axis,
            fixed(axis.largest, 2),
            unit_symbol(axis.unit),
            place_of(axis),
            fixed(axis.correction, 2),
        )
    })
}

enum Place {
    File(Box<OutputFile>),
    Folder(PathBuf),
}

impl Place {
    /// A path with an extension is a file, unless an existing folder has this path.
    fn of(arguments: &ExportArguments) -> Result<Self, Failure> {
        let path = &arguments.output;
        if path.is_file() || (path.extension().is_some() && !path.is_dir()) {
            return Ok(Self::File(Box::new(beside_machine(path, arguments)?)));
        }
        let parent = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        if !parent.is_dir() {
            let message = format!(
                "{}: cannot be written: there is no folder {}",
                path.display(),
                parent.display()
            );
            return Err(Failure::Input(message));
        }
        Ok(Self::Folder(path.clone()))
    }

    /// Returns the paths of the written files, and the paths among them whose files had another text before.
    fn write(
        self,
        files: &[TextFile],
        arguments: &ExportArguments,
    ) -> Result<(Vec<String>, Vec<String>), Failure> {
        let mut open = Vec::new();
        match (self, files) {
            (Self::File(output), [only]) => open.push((*output, only, arguments.output.clone())),
            (Self::File(_), files) => {
                return Err(Failure::Input(format!(
                    "--output: found {}, expected a folder: the format {} has {} files",
                    arguments.output.display(),
                    arguments.format,
                    files.len()
                )));
            }
            (Self::Folder(folder), files) => {
                if !folder.is_dir() {
                    std::fs::create_dir(&folder).map_err(|e| {
                        Failure::in_file(&folder, format_args!("cannot be made a folder: {e}"))
                    })?;
                }
                for file in files {
                    let path = folder.join(&file.name);
                    open.push((beside_machine(&path, arguments)?, file, path));
                }
            }
        }
        let (mut names, mut replaced) = (Vec::new(), Vec::new());
        for (output, file, path) in open {
            let name = path.display().to_string();
            if output.replaces(&file.text) {
                replaced.push(name.clone());
            }
            output.write_whole(&file.text)?;
            names.push(name);
        }
        Ok((names, replaced))
    }
}

/// Opens an output file, which must not be the machine file.
fn beside_machine(path: &Path, arguments: &ExportArguments) -> Result<OutputFile, Failure> {
    OutputFile::open_beside(path, &[(arguments.machine.machine.as_path(), "the machine")])
}

/// Notes on tables of earlier exports in the output folder, which a control may still load: tables of another format,
/// or of an axis that no longer has an error.
fn other_tables(arguments: &ExportArguments, written: &[String]) -> Vec<String> {
    /// Maximum size of a control's table, bytes.
    const MOST_BYTES: u64 = 64 << 20;
    let small = |path: &Path| {
        std::fs::metadata(path).is_ok_and(|of| of.is_file() && of.len() <= MOST_BYTES)
    };
    let Ok(files) = std::fs::read_dir(&arguments.output) else {
        return Vec::new();
    };
    let mut found: Vec<(Format, String)> = files
        .flatten()
        .filter(|file| !written.contains(&file.path().display().to_string()))
        .filter_map(|file| {
            let path = Some(file.path()).filter(|path| small(path))?;
            let name = file.file_name().display().to_string();
            if let Target::Tables(format) = arguments.format
                && is_named_by(format, &name)
            {
                return Some((format, name));
            }
            // A file that is no readable text is not a table.
            let text = std::fs::read_to_string(&path).ok()?;
            let format = Format::stated_in(&TextFile { name: name.clone(), text })?;
            Some((format, name))
        })
        .collect();
    found.sort_by_cached_key(|(format, name)| (format.to_string(), name.clone()));
    let folder = arguments.output.display();
    let (own, mut others): (Vec<_>, Vec<_>) =
        (found.into_iter()).partition(|(format, _)| Target::Tables(*format) == arguments.format);
    others.dedup_by(|one, other| one.0 == other.0);
    let mut notes = Vec::new();
    if !others.is_empty() {
        let all = others.iter().map(|(format, name)| format!("{format} ({name})"));
        notes.push(format!(
            "in {folder} there are tables of another format, too: {}; of two formats a control may read both",
            all.collect::<Vec<_>>().join(", ")
        ));
    }
    if !own.is_empty() {
        let all: Vec<String> = own.into_iter().map(|(_, name)| name).collect();
        notes.push(format!(
            "in {folder} there are tables that this export has not written: {}; a control would go on to use them",
            all.join(", ")
        ));
    }
    notes
}

/// True if a file has the name of a table of this format. Only for formats whose content does not identify a table.
fn is_named_by(format: Format, name: &str) -> bool {
    let axis = match format {
        Format::Linuxcnc | Format::LinuxcncType1 => name.strip_suffix(".comp"),
        Format::HeidenhainTnc640 => {
            (name.strip_prefix("AXIS_")).and_then(|name| name.strip_suffix(".COM"))
        }
        _ => None,
    };
    axis.is_some_and(|axis| axis.parse::<AxisName>().is_ok())
}

fn made(content: &Content, left_out: &[(AxisName, AxisName)]) -> Vec<Made> {
    let mut made = Vec::new();
    for table in content.listed() {
        let is_left_out = |(output, input): &(AxisName, AxisName)| {
            table.input == *input && table.output == output.to_string()
        };
        if left_out.iter().any(is_left_out) {
            continue;
        }
        let values = table.forward.iter().chain(table.backward.iter().flatten());
        made.push(Made {
            input: table.input,
            positions: table.positions.len(),
            first: table.positions.first().copied().unwrap_or(0.0),
            last: table.positions.last().copied().unwrap_or(0.0),
            both_directions: table.backward.is_some(),
            largest: values.fold(0.0, |largest, value| value.abs().max(largest)),
            unit: table.unit,
            output: table.output,
        });
    }
    made
}

/// Position and direction of approach of the largest difference between tables and model, such as `X=100 Y=0 +`.
fn place_of(axis: &AxisLoss) -> String {
    let at = axis.at.iter();
    let mut words: Vec<String> = at.map(|(name, at)| format!("{name}={}", fixed(*at, 0))).collect();
    words.extend(axis.direction.map(|direction| direction.to_string()));
    words.join(" ")
}

fn settings_table(settings: &LinearSettings) -> String {
    let mut rows = table(&["setting", "", "value"]);
    for (axis, factor) in ["X", "Y", "Z"].into_iter().zip(settings.steps) {
        rows.add_row(["steps per mm, factor", axis, &fixed(factor, 7)]);
    }
    for (plane, factor) in settings.skew.planes() {
        rows.add_row(["skew factor", plane, &fixed(factor, 7)]);
    }
    table_text(&rows)
}

fn tables_table(document: &Export) -> String {
    let mut tables =
        table(&["table", "over", "positions", "first", "last", "directions", "largest", "unit"]);
    for made in &document.tables {
        tables.add_row(vec![
            made.output.clone(),
            made.input.to_string(),
            made.positions.to_string(),
            fixed(made.first, 3),
            fixed(made.last, 3),
            if made.both_directions { "2" } else { "1" }.to_owned(),
            fixed(made.largest, 2),
            unit_symbol(made.unit).to_owned(),
        ]);
    }
    table_text(&tables)
}

fn text(document: &Export) -> String {
    let mut lost = table(&[
        "what is left",
        "axis",
        "error by\nthe model",
        "left with\nthe tables",
        "RMS of\nwhat is left",
        "unit",
        "most is left at",
    ]);
    to_the_left(&mut lost, &[6]);
    let all = [("all errors", &document.loss.axes)];
    let each = document.loss.categories.iter().map(|of| (of.category.name(), &of.axes));
    for (name, axes) in all.into_iter().chain(each) {
        for (place, axis) in axes.iter().enumerate() {
            lost.add_row(vec![
                if place == 0 { name } else { "" }.to_owned(),
                axis.axis.to_string(),
                fixed(axis.correction, 2),
                fixed(axis.largest, 2),
                fixed(axis.rms, 2),
                unit_symbol(axis.unit).to_owned(),
                place_of(axis),
            ]);
        }
    }
    let mut text = String::new();
    for file in &document.files {
        text += file;
        text.push('\n');
    }
    text.push('\n');
    let settings = document.settings.as_ref().map(settings_table);
    text += &settings.unwrap_or_else(|| tables_table(document));
    text.push('\n');
    text += &table_text(&lost);
    text.push('\n');
    let mut sentences = vec![
        format!(
            "Left: the difference between what the control corrects with these files and the model, at most, over {} poses after positive (+) and negative (-) \
             motion of all axes; each kind of error alone in the mean of both. The error by the model is the most that is left without tables.",
            document.loss.poses
        ),
        format!("Sign: {}.", document.sign),
        document.trust.to_owned(),
    ];
    sentences.extend(document.notes.iter().map(|note| format!("Note: {note}.")));
    for sentence in sentences {
        text += &folded(&sentence, "");
    }
    text
}

impl From<ExchangeError> for Failure {
    fn from(error: ExchangeError) -> Self {
        match error {
            ExchangeError::Model(error) => error.into(),
            ExchangeError::Cell(place) => Self::Place(place),
            ExchangeError::Line(place) => {
                let message = place.to_string();
                let LineError { file, line, .. } = place;
                Self::File(Box::new(FileFailure {
                    file,
                    line: line.map(|line| line as u64),
                    key: None,
                    message,
                }))
            }
            limited @ ExchangeError::BeyondLimit { .. } => {
                Self::Input(format!("{limited}{RAISE_LIMIT}"))
            }
            other => Self::Input(other.to_string()),
        }
    }
}

use std::{
    fmt::Write as _,
    fs::File,
    io::{BufReader, Read as _},
    path::{Path, PathBuf},
};

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_document::read_text;
use volcomp_identify::{Kind, Observations, RowReading};
use volcomp_model::{Machine, Temperatures};
use volcomp_nc::{
    Alignment, Average, BoundViolation, Corrector, Counts, Decimals, Deviation, Dialect, Found,
    InspectError, Inspected, Job, MeanOf, NcError, NcNote, Note, Part, Reading, SetUp, Strategy,
    Summary, Verification, Virtual, average, compensate, verify, verify_average,
};
use volcomp_report::{ProgramFigures, ProgramPlace, program_picture};

use super::{Answer, fixed, machine_notes, table, table_text, thermal_note};
use crate::{
    arguments::{LimitArgument, MachineArguments, RAISE_LIMIT},
    compensation::{refuse_other_geometry, resolution},
    failure::Failure,
    output::{OutputFile, PlotArguments, PlotFile, byte_bar},
    table::folded,
};

/// Correct the coordinates of an NC program
///
/// Reads RS-274 (LinuxCNC, FANUC), SINUMERIK or conversational HEIDENHAIN programs. All bytes other than changed
/// coordinates stay. A line is split only where the correction bends by more than the tolerance; arcs stay arcs where the
/// corrected circle fits.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp nc part.ngc -o part-compensated.ngc -m mill.toml
  volcomp nc part.ngc -o out.ngc -m mill.toml --setup setup.toml --tolerance 0.5")]
pub(crate) struct NcArguments {
    /// NC program
    program: PathBuf,
    /// Compensated program
    #[arg(long, short)]
    output: PathBuf,
    #[command(flatten)]
    machine: MachineArguments,
    /// Set-up file (TOML): work offsets, tool lengths and start position not contained in the program
    #[arg(long, value_name = "FILE")]
    setup: Option<PathBuf>,
    /// Folder of subroutines: name.ngc for a name, O1000 or 1000.nc for M98 P1000; repeatable
    #[arg(long, value_name = "DIR")]
    subroutines: Vec<PathBuf>,
    /// Language of the program [default: by `control` in the set-up file, else by its extension]
    #[arg(long, value_enum)]
    dialect: Option<Language>,
    /// Largest deviation of a motion before it is split, µm
    #[arg(long, value_name = "UM", default_value_t = 1.0, allow_negative_numbers = true)]
    tolerance: f64,
    /// Decimals of changed coordinates; further decimals of the program stay
    #[arg(long, value_name = "MM,INCH,DEG", default_value = "3,4,3", value_parser = decimals)]
    decimals: Decimals,
    /// Rounding in split lines: to the nearest (plain), or together by the shortest path (floyd)
    #[arg(long, value_enum, default_value_t)]
    strategy: Rounding,
    #[command(flatten)]
    limit: LimitArgument,
    /// Maximum number of executed blocks in a program with O-words
    #[arg(long, value_name = "N", default_value_t = 10_000_000)]
    max_blocks: u64,
    /// Change only the work offsets in --setup (G10 L2), by the mean correction over all cutting positions
    #[arg(long, requires = "setup", conflicts_with_all = ["strategy", "tolerance"])]
    average: bool,
    /// Observations file of ball rows: use their mean reading instead
    #[arg(long, value_name = "FILE", requires = "average")]
    ball_row: Option<PathBuf>,
    /// Run the program and its result on the virtual machine, and print the deviations of the tool
    #[arg(long)]
    verify: bool,
    /// Machine file with the errors taken as real in the verification
    #[arg(long, value_name = "FILE", requires = "verify")]
    truth: Option<PathBuf>,
    /// Step of the control to which the verification rounds the correction: µm on linear, µrad on rotary axes
    #[arg(long, value_name = "STEP", requires = "verify", value_parser = resolution)]
    resolution: Option<f64>,
    /// Part file (TOML): evaluate its features on the virtual workpiece, before and after
    #[arg(long, value_name = "FILE", requires = "verify")]
    inspect: Option<PathBuf>,
    #[command(flatten)]
    plot: PlotArguments,
}

/// The language of a program.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Language {
    Rs274,
    Siemens,
    Heidenhain,
}

/// Result of `volcomp nc`: the written program, and what was changed in it.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Nc {
    /// Path of the written file.
    file: String,
    /// Dialect of the program: `rs274`, `siemens` or `heidenhain`.
    dialect: &'static str,
    #[serde(flatten)]
    counts: Counts,
    /// Whether the result is identical to that of `--strategy plain`; only with `--strategy floyd`.
    #[serde(skip_serializing_if = "Option::is_none")]
    same_as_plain: Option<bool>,
    /// Whether the program contains its end (M2, M30 or a second percent sign).
    ended: bool,
    /// Deviation of the tool from the programmed path; only with `--verify`.
    #[serde(skip_serializing_if = "Option::is_none")]
    verified: Option<Verified>,
    /// Notes on the program, each once.
    notes: Vec<NcNote>,
}

/// Result of `volcomp nc --average`: the written program, and its work offsets.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct NcAverage {
    /// Path of the written file.
    file: String,
    /// Work offsets used for cutting. `before_um` and `left_um` are the maximum and the root mean
    /// square.
    offsets: Vec<Average>,
    /// Deviation of the tool from the programmed path; only with `--verify`.
    #[serde(skip_serializing_if = "Option::is_none")]
    verified: Option<Verified>,
}

/// Comparison of the program and its result on a virtual machine.
#[derive(Debug, Serialize, JsonSchema)]
struct Verified {
    #[serde(flatten)]
    found: Verification,
    /// Whether the features are evaluated after the best rigid alignment of the part by its own
    /// points; only with `--inspect`.
    #[serde(skip_serializing_if = "Option::is_none")]
    best_fit: Option<bool>,
    /// Evaluated features of the part; only with `--inspect`.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    features: Vec<NcFeature>,
}

/// A feature of the part, as cut by the virtual machine.
#[derive(Debug, Serialize, JsonSchema)]
struct NcFeature {
    /// Name in the part file.
    name: String,
    /// Number of points.
    points: usize,
    /// Result for the original program; null if it cannot be evaluated.
    before: Option<Found>,
    /// Result for the compensated program; null if it cannot be evaluated.
    after: Option<Found>,
    /// Why the feature cannot be evaluated.
    #[serde(skip_serializing_if = "Option::is_none")]
    reason: Option<String>,
}

impl NcArguments {
    /// The input files, which no output may overwrite, each with the name of its option.
    fn inputs(&self) -> Vec<(&Path, &'static str)> {
        let mut inputs = vec![
            (self.program.as_path(), "PROGRAM"),
            (self.machine.machine.as_path(), "--machine"),
        ];
        let others = [
            (&self.setup, "--setup"),
            (&self.truth, "--truth"),
            (&self.inspect, "--inspect"),
            (&self.ball_row, "--ball-row"),
        ];
        inputs.extend(
            others.into_iter().filter_map(|(path, option)| Some((path.as_deref()?, option))),
        );
        inputs
    }

    /// The language of the program: from `--dialect`, else the control in the set-up file, else the file name.
    fn dialect(&self, setup: &SetUp) -> Dialect {
        match self.dialect {
            Some(Language::Rs274) => Dialect::Rs274,
            Some(Language::Siemens) => Dialect::Siemens,
            Some(Language::Heidenhain) => Dialect::Heidenhain,
            None => match setup.control() {
                Some(control) => control.dialect(),
                None => Dialect::of_file(&self.program),
            },
        }
    }
}

/// How the numbers of split lines are rounded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, clap::ValueEnum)]
enum Rounding {
    #[default]
    Plain,
    Floyd,
}

/// Maximum size of a program for `--average`, bytes. Such a program is read twice, from memory.
const MOST_IN_MEMORY: u64 = 256 << 20;

/// Parses the decimals of mm, inch and deg, such as `3,4,3`.
fn decimals(text: &str) -> Result<Decimals, String> {
    let numbers: Option<Vec<u8>> = text
        .split(',')
        .map(|number| number.trim().parse().ok().filter(|number| *number <= 9))
        .collect();
    match numbers.as_deref() {
        Some(&[mm, inch, deg]) => Ok(Decimals { mm, inch, deg }),
        _ => Err("expected three whole numbers from 0 to 9: 3,4,3".to_owned()),
    }
}

pub(crate) fn run(arguments: &NcArguments) -> Result<Answer, Failure> {
    let tolerance_um = arguments.tolerance;
    if !(1e-3..=1e3).contains(&tolerance_um) {
        return Err(Failure::Input(format!(
            "--tolerance: found {tolerance_um}, expected µm from 0.001 to 1000"
        )));
    }
    let limit = arguments.limit.limit()?;
    let (machine, temperatures) = arguments.machine.read()?;
    let setup = match &arguments.setup {
        Some(path) => SetUp::parse(&read_text(path)?, &path.display().to_string())?,
        None => SetUp::default(),
    };
    let setup = setup.with_subroutines(arguments.subroutines.clone());
    let program = &arguments.program;
    let file = File::open(program)
        .map_err(|e| Failure::in_file(program, format_args!("cannot be read: {e}")))?;
    if file.metadata().is_ok_and(|about| about.is_dir()) {
        return Err(Failure::in_file(program, "it is a directory, expected an NC program"));
    }
    let length = file.metadata().map_or(0, |about| about.len());
    let inputs = arguments.inputs();
    let part = arguments
        .inspect
        .as_deref()
        .map(|path| Ok::<_, Failure>(Part::parse(&read_text(path)?, &path.display().to_string())?))
        .transpose()?;
    refuse_subroutine(arguments)?;
    refuse_read_once(arguments, &file)?;
    let mut output = OutputFile::open_beside(&arguments.output, &inputs)?;
    let plot = plot_file(arguments)?;
    let corrector = Corrector::new(&machine, &temperatures, 1e-3 * tolerance_um)
        .map_err(|error| failure(program, error))?;
    let job = Job {
        corrector: &corrector,
        setup: &setup,
        dialect: arguments.dialect(&setup),
        decimals: arguments.decimals,
        strategy: match arguments.strategy {
            Rounding::Plain => Strategy::Plain,
            Rounding::Floyd => Strategy::Floyd,
        },
        most_blocks: arguments.max_blocks,
        limit,
        keep_shares: arguments.verify,
    };
    let mut notes = machine_notes(&machine, &temperatures);
    let made = if arguments.average {
        let mut text = Vec::new();
        (file.take(MOST_IN_MEMORY + 1).read_to_end(&mut text))
            .map_err(|e| Failure::in_file(program, e))?;
        if text.len() as u64 > MOST_IN_MEMORY {
            let what = "longer than 256 MiB, which --average does not take";
            return Err(Failure::in_file(program, what));
        }
        let readings = (arguments.ball_row.as_deref()).map(readings).transpose()?;
        let of = (readings.as_deref()).map_or(MeanOf::Places, MeanOf::Readings);
        Written::Averaged(
            average(&text, &mut output, job, of).map_err(|error| failure(program, error))?,
        )
    } else {
        let bar = byte_bar(length);
        let mut input = BufReader::with_capacity(1 << 18, file);
        let summary = compensate(&mut input, &mut output, job, |bytes| {
            bar.set_position(bytes);
            Ok(())
        });
        bar.finish_and_clear();
        Written::Compensated(summary.map_err(|error| failure(program, error))?)
    };
    let verified = if arguments.verify {
        let on = OnTruth {
            arguments,
            model: (&machine, &temperatures),
            setup: &setup,
            part: part.as_ref().map(|part| (part, &corrector)),
        };
        Some(on.verified(&made, output.so_far()?, &mut notes)?)
    } else {
        None
    };
    output.finish()?;
    if let (Some(plot), Some(verified)) = (plot, &verified) {
        plot.write(&picture(arguments, &verified.found))?;
    }
    match made {
        Written::Compensated(summary) => {
            let dialect = arguments.dialect(&setup);
            answer(arguments, dialect, &summary, verified, notes)
        }
        Written::Averaged(found) => averaged(&arguments.output, found, verified, notes),
    }
}

/// Refuses an output in a folder of subroutines, because it would overwrite a file that the program may call.
fn refuse_subroutine(arguments: &NcArguments) -> Result<(), Failure> {
    let Ok(output) = arguments.output.canonicalize() else {
        return Ok(());
    };
    let mut folders = arguments.subroutines.iter();
    let is_in = |folder: &PathBuf| {
        folder.canonicalize().is_ok_and(|folder| output.parent() == Some(&folder))
    };
    match folders.find(|folder| is_in(folder)) {
        Some(folder) => Err(Failure::in_file(
            &arguments.output,
            format_args!(
                "there is such a file in {} of --subroutines, which the program may call: expected another one to write",
                folder.display()
            ),
        )),
        None => Ok(()),
    }
}

/// Rejects a pipe as the program with `--verify`, because the verification reads the program a second time.
fn refuse_read_once(arguments: &NcArguments, program: &File) -> Result<(), Failure> {
    let is_file = program.metadata().is_ok_and(|about| about.is_file());
    if is_file || !arguments.verify {
        return Ok(());
    }
    Err(Failure::in_file(
        &arguments.program,
        "found a pipe or a device, expected a file with --verify, which reads the program twice: store it first",
    ))
}

/// Creates the file of the picture before the work starts. The file becomes visible when the result is stored.
fn plot_file(arguments: &NcArguments) -> Result<Option<PlotFile>, Failure> {
    let mut others = arguments.inputs();
    others.push((arguments.output.as_path(), "--output"));
    let plot = arguments.plot.open(&others)?;
    if plot.is_some() && !arguments.verify {
        let what = "--plot: found without --verify, which it draws: expected both";
        return Err(Failure::input(what));
    }
    Ok(plot)
}

enum Written {
    Compensated(Summary),
    Averaged(Vec<Average>),
}

fn failure(program: &Path, error: NcError) -> Failure {
    match error {
        NcError::Machine(error) => error.into(),
        NcError::Io(error) => Failure::work_on(program, &error),
        other if is_beyond_limit(&other) => {
            Failure::in_file(program, format_args!("{other}{RAISE_LIMIT}"))
        }
        other => Failure::in_file(program, other),
    }
}

fn is_beyond_limit(error: &NcError) -> bool {
    match error {
        NcError::InFile { error, .. } => is_beyond_limit(error),
        NcError::OutOfBounds { violation, .. } => matches!(
            violation,
            BoundViolation::BeyondLimit { .. } | BoundViolation::ToolBeyondLimit { .. }
        ),
        _ => false,
    }
}

fn answer(
    arguments: &NcArguments,
    dialect: Dialect,
    summary: &Summary,
    verified: Option<Verified>,
    more: Vec<String>,
) -> Result<Answer, Failure> {
    let Counts { lines, motions, changed, added } = summary.counts;
    let document = Nc {
        file: arguments.output.display().to_string(),
        dialect: dialect.name(),
        counts: summary.counts,
        same_as_plain: (arguments.strategy == Rounding::Floyd)
            .then_some(summary.rounded_otherwise == 0),
        ended: summary.ended,
        verified,
        notes: summary.notes.in_words(),
    };
    let mut text = format!(
        "{}: {lines} lines with {motions} motions read, {changed} lines changed, {added} added\n",
        document.file
    );
    if let Some(same) = document.same_as_plain {
        text += if same {
            "--strategy floyd: same as plain, byte for byte\n"
        } else {
            "--strategy floyd: other numbers than plain\n"
        };
    }
    if let Some(verified) = &document.verified {
        text += &verified_text(verified);
    }
    let mut notes: Vec<String> =
        (document.notes.iter()).map(|note| format!("line {}: {}", note.line, note.text)).collect();
    notes.extend(more);
    if motions == 0 {
        notes.push(format!(
            "no motion was found in {} lines, and nothing was changed: is this an NC program in the language {}? (--dialect)",
            lines, document.dialect
        ));
    }
    Answer::new(&document, text, notes)
}

/// The answer for mean corrections that were written to the work offsets.
fn averaged(
    output: &Path,
    found: Vec<Average>,
    verified: Option<Verified>,
    mut notes: Vec<String>,
) -> Result<Answer, Failure> {
    let zeros = found.iter().filter_map(|of| of.off_at_zero.as_ref());
    notes.extend(
        zeros.map(|note| format!("{note}. Here it is added to the values of the line G10 L2")),
    );
    let document = NcAverage { file: output.display().to_string(), offsets: found, verified };
    let mut text = format!("{}: the mean correction is in the work offsets\n", document.file);
    for of in &document.offsets {
        let [x, y, z] = of.mean_mm.map(|mm| 1e3 * mm);
        let [at_x, at_y, at_z] = of.offset_mm;
        let _ = write!(
            text,
            "{}, {} places: X {x:+.1} Y {y:+.1} Z {z:+.1} µm, now X {at_x} Y {at_y} Z {at_z} mm\n  correction before: at most {:.2} µm, RMS {:.2} µm; residual after the mean: at most {:.2} µm, RMS {:.2} µm\n",
            of.system, of.places, of.before_um[0], of.before_um[1], of.left_um[0], of.left_um[1]
        );
    }
    if let Some(verified) = &document.verified {
        text += &verified_text(verified);
    }
    Answer::new(&document, text, notes)
}

fn picture(arguments: &NcArguments, found: &Verification) -> String {
    let places = found.path.iter().map(|place| ProgramPlace {
        tip_mm: place.tip_mm,
        before_um: place.before_um,
        after_um: place.after_um,
        begins: place.begins,
    });
    let places: Vec<ProgramPlace> = places.collect();
    let figures = [&found.before, &found.after].map(|of| ProgramFigures {
        max_um: of.max_um,
        rms_um: of.rms_um,
        line: of.line,
        tip_mm: of.tip_mm,
    });
    let truth = arguments.truth.as_ref().unwrap_or(&arguments.machine.machine);
    let machine = format!("on the machine of {}", truth.display());
    let files = [arguments.program.display().to_string(), machine];
    program_picture(&files, &places, figures)
}

struct OnTruth<'a> {
    arguments: &'a NcArguments,
    model: (&'a Machine, &'a Temperatures),
    setup: &'a SetUp,
    part: Option<(&'a Part, &'a Corrector)>,
}

impl OnTruth<'_> {
    /// Compares the program and its result on the virtual machine. Rejects a result that is worse than the program.
    fn verified(
        &self,
        made: &Written,
        result: &Path,
        notes: &mut Vec<String>,
    ) -> Result<Verified, Failure> {
        let arguments = self.arguments;
        if arguments.truth.is_none() {
            notes.push("--verify without --truth: the model is judged by itself, which shows rounding and splits, not how well it knows the machine".to_owned());
        }
        let found = self.run(made, result, notes)?;
        notes.extend(is_better(&found, arguments, &left_out(made))?);
        let features = arguments.inspect.as_deref();
        Ok(Verified {
            best_fit: (self.part).map(|(part, _)| part.alignment == Alignment::BestFit),
            features: features.map_or_else(Vec::new, |part| inspected(&found.features, part)),
            found,
        })
    }

    fn run(
        &self,
        made: &Written,
        result: &Path,
        notes: &mut Vec<String>,
    ) -> Result<Verification, Failure> {
        let arguments = self.arguments;
        let read;
        let (truth, temperatures) = match &arguments.truth {
            Some(path) => {
                read = arguments.machine.spindle.read(path)?;
                refuse_other_geometry(path, &read.0, self.model.0, &"--machine")?;
                let note = thermal_note(&read.0, &read.1);
                notes.extend(note.map(|note| format!("{}: {note}", path.display())));
                (&read.0, &read.1)
            }
            None => self.model,
        };
        let of = Virtual {
            truth,
            temperatures,
            setup: self.setup,
            most_blocks: arguments.max_blocks,
            dialect: arguments.dialect(self.setup),
            part: self.part,
            resolution: arguments.resolution,
        };
        let open = |path: &Path| {
            let file = File::open(path).map_err(|e| Failure::in_file(path, e))?;
            Ok::<_, Failure>(BufReader::new(file))
        };
        let (mut original, mut result) = (open(&arguments.program)?, open(result)?);
        match made {
            Written::Compensated(summary) => {
                verify(&mut original, &mut result, &summary.shares, of)
            }
            Written::Averaged(averages) => verify_average(&mut original, &mut result, averages, of),
        }
        .map_err(|error| failure(&arguments.program, error))
    }
}

/// Rejects a result that is worse than the program. Returns a note if only the whole part is shifted.
///
/// The form is worse if, after alignment of the part, the RMS deviation of the tool is larger, or its maximum is more
/// than twice as large. A model with another zero shifts the whole part, which is no error of the part. A larger
/// deviation before alignment is therefore accepted if the form is better. Differences below the tolerance plus two
/// increments of the written numbers are ignored.
fn is_better(
    found: &Verification,
    arguments: &NcArguments,
    left_out: &str,
) -> Result<Option<String>, Failure> {
    let Decimals { mm, inch, .. } = arguments.decimals;
    let Verification { before, after, .. } = found;
    let (unit_um, decimals) = if found.in_inches { (25.4e3, inch) } else { (1e3, mm) };
    let step_um = unit_um / 10_f64.powi(i32::from(decimals));
    let no_matter_um = arguments.tolerance + 2.0 * step_um;
    let is_worse = |rms: [f64; 2], max: [f64; 2]| {
        rms[1] > rms[0] + no_matter_um || max[1] > 2.0 * max[0] + no_matter_um
    };
    let form_is_worse =
        is_worse([before.form_rms_um, after.form_rms_um], [before.form_max_um, after.form_max_um]);
    let is_further = is_worse([before.rms_um, after.rms_um], [before.max_um, after.max_um]);
    let form_is_better = after.form_rms_um < MUCH_BETTER * before.form_rms_um;
    if !form_is_worse && (form_is_better || !is_further) {
        return Ok(is_further.then(|| {
            format!(
                "with the result the whole part lies elsewhere, as with a model that has another zero: RMS {:.2} µm instead of {:.2} µm; after alignment {:.2} µm instead of {:.2} µm",
                after.rms_um, before.rms_um, after.form_rms_um, before.form_rms_um
            )
        }));
    }
    Err(Failure::Work(format!(
        "{}: not written, since the tool is further off with the result than without: at most {:.2} µm (line {}), RMS {:.2} µm, instead of at most {:.2} µm, RMS {:.2} µm; after alignment of the part at most {:.2} µm, RMS {:.2} µm, instead of at most {:.2} µm, RMS {:.2} µm{left_out}",
        arguments.output.display(),
        after.max_um,
        after.line,
        after.rms_um,
        before.max_um,
        before.rms_um,
        after.form_max_um,
        after.form_rms_um,
        before.form_max_um,
        before.form_rms_um
    )))
}

/// Suffix of the error message with the axes that were not corrected because their position was unknown; empty if all
/// were corrected.
fn left_out(made: &Written) -> String {
    let Written::Compensated(summary) = made else {
        return String::new();
    };
    let notes = summary.notes.by_line();
    let axes: Vec<String> = (notes.iter())
        .filter_map(|(line, note)| match note {
            Note::LeftOut(axis) => Some(format!("{axis} from line {line} on")),
            _ => None,
        })
        .collect();
    if axes.is_empty() {
        return String::new();
    }
    format!(
        "; corrections are left out while it is not known where an axis stands ({}): [start] of the set-up file says it",
        axes.join(", ")
    )
}

/// Maximum ratio of the RMS form deviations, after to before, at which a shift of the whole part is accepted. The ratio
/// is below 1 because one or two points have no form deviation.
const MUCH_BETTER: f64 = 0.9;

/// Increase of the RMS form deviation above which the summary says that the form is worse, µm. The rounding of numbers
/// changes the form less.
const WORSE_FORM_UM: f64 = 0.1;

/// The deviation of the tool from the programmed path, and the features of the part.
fn verified_text(verified: &Verified) -> String {
    let found = &verified.found;
    let row = |name: &str, of: &Deviation| {
        let whole = [of.max_um, of.rms_um, of.across_max_um, of.across_rms_um];
        let form = [of.form_max_um, of.form_rms_um];
        let all = whole.iter().chain(&form);
        let cells: Vec<String> = all.map(|um| format!("{um:>9.2}")).collect();
        format!("{name:<8}{}\n", cells.concat())
    };
    let place = |name: &str, of: &Deviation| {
        let [x, y, z] = of.tip_mm;
        format!("largest {name}: line {}, tip at {x:.1} {y:.1} {z:.1} mm\n", of.line)
    };
    let mut text = format!(
        "\nDeviation of the tool from the programmed path, {} motions checked; across:\nwithout what is along the path; form: after alignment of the part, since how\nit lies is no error of it\n{:<8}{:>18}{:>18}{:>18}\n{:<8}{}\n",
        found.motions,
        "",
        "whole",
        "across",
        "form",
        "",
        format!("{:>9}{:>9}", "max µm", "RMS µm").repeat(3)
    );
    text += &row("before", &found.before);
    text += &row("after", &found.after);
    text += &place("before", &found.before);
    text += &place("after", &found.after);
    let further = &found.further;
    if let Some(line) = further.line {
        let sentence = format!(
            "In {} of {} motions the tool is further off with the result than before, in RMS or at most, by up to {:.2} µm (line {line}), as where words are rounded or a circle is kept.",
            further.motions, found.motions, further.by_um
        );
        text += &folded(&sentence, "");
    }
    let [before, after] = [found.before.form_rms_um, found.after.form_rms_um];
    if after > before + WORSE_FORM_UM {
        let sentence = format!(
            "The form is worse with the result than without: RMS {after:.2} µm instead of {before:.2} µm. The model does not suit the errors of the machine that was simulated.",
        );
        text += &folded(&sentence, "");
    }
    if let Some(best_fit) = verified.best_fit {
        text += &part_text(&verified.features, best_fit);
    }
    text
}

/// The inspected features. For a feature that cannot be evaluated, the reason names the key of the part file.
fn inspected(features: &[Inspected], part: &Path) -> Vec<NcFeature> {
    let reason = |place: usize, error: &InspectError| {
        let key = match error {
            InspectError::NothingCut { .. } => "lines",
            _ => "kind",
        };
        format!("{}: feature[{place}].{key}: {error}", part.display())
    };
    let feature = |(place, of): (usize, &Inspected)| {
        let [before, after] = match &of.found {
            Ok(found) => found.map(Some),
            Err(_) => [None; 2],
        };
        NcFeature {
            name: of.name.clone(),
            points: of.points,
            before,
            after,
            reason: (of.found.as_ref().err()).map(|error| reason(place, error)),
        }
    };
    features.iter().enumerate().map(feature).collect()
}

type Take = fn(&Found) -> Option<f64>;

fn part_text(features: &[NcFeature], best_fit: bool) -> String {
    const NUMBERS: [(&str, Take, &str); 6] = [
        ("form", |f| f.form_um, "µm"),
        ("minimum zone", |f| f.minimum_zone_um, "µm"),
        ("position", |f| f.position_um, "µm"),
        ("direction", |f| f.direction_urad, "µrad"),
        ("radius", |f| f.radius_um, "µm"),
        ("coaxiality", |f| f.coaxiality_um, "µm"),
    ];
    let mut rows = table(&["feature", "", "before", "after", ""]);
    let mut reasons = String::new();
    for feature in features {
        let mut name = feature.name.as_str();
        for (what, of, unit) in NUMBERS {
            let both =
                feature.before.as_ref().and_then(of).zip(feature.after.as_ref().and_then(of));
            if let Some((before, after)) = both {
                let [before, after] = [before, after].map(|number| fixed(number, 2));
                rows.add_row([name, what, &before, &after, unit]);
                name = "";
            }
        }
        if let Some(reason) = &feature.reason {
            reasons += &folded(&format!("{}: {reason}", feature.name), "");
        }
    }
    let part = if rows.is_empty() { String::new() } else { table_text(&rows) };
    let aligned = if best_fit { ", aligned by all its points" } else { "" };
    format!("\nThe part as a measuring machine would find it{aligned}:\n{part}{reasons}")
}

/// The readings of all ball rows of a file: the distance of the tip from each ball, along each measured direction.
///
/// # Errors
/// The file cannot be read or has no ball rows, or a row states no position, so that its readings do not determine
/// where the machine is.
fn readings(path: &Path) -> Result<Vec<Reading>, Failure> {
    let observations = Observations::read(path)?;
    let mut readings = Vec::new();
    for observation in &observations.observations {
        if observation.kind != Kind::BallRow {
            continue;
        }
        for row in &observation.rows {
            let RowReading::Ball { origin, tilts, axes, offset_mm, .. } = &row.reading else {
                continue;
            };
            let setup = &observations.setup;
            if setup.points[*origin].unknown
                || tilts.iter().any(|tilt| setup.numbers[*tilt].unknown)
            {
                return Err(Failure::in_file(
                    path,
                    format!(
                        "the ball row {} has an unknown `origin` or `direction`, so that the position of the machine at its readings is unknown; expected both as numbers",
                        observation.file
                    ),
                ));
            }
            for (along, error_mm) in axes.column_iter().zip(offset_mm) {
                readings.extend(error_mm.map(|error_mm| Reading {
                    direction: [along[0], along[1], along[2]],
                    error_mm,
                }));
            }
        }
    }
    if readings.is_empty() {
        return Err(Failure::in_file(
            path,
            "found no observation of kind \"ball-row\", expected one at least",
        ));
    }
    Ok(readings)
}

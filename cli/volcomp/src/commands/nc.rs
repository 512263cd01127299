//! `volcomp nc`: an NC program in, the compensated one out.

use std::{
    fmt::Write as _,
    fs::File,
    io::{BufReader, Read as _},
    path::{Path, PathBuf},
};

use volcomp_document::read_text;
use volcomp_nc::{
    Average, BoundViolation, Corrector, Decimals, Dialect, Job, MeanOf, NcError, SetUp, Strategy,
    Summary, average, compensate,
};

use super::{Answer, machine_notes, nc_ball_row, nc_part, nc_verified, nc_verified::OnTruth};
use crate::{
    answers::nc::{AverageOffset, Nc, NcAverage, NcNote, Verified},
    failure::Failure,
    limit::{LimitArgument, RAISE_LIMIT},
    output::OutputFile,
    points::MachineArguments,
    progress::byte_bar,
};

/// An NC program in, the same program with the correction in its coordinates out
///
/// RS-274 as LinuxCNC and FANUC controls read it, the language of SINUMERIK controls, or the conversational one of HEIDENHAIN controls. Every byte that is no changed coordinate comes out as it went in. A line is
/// split only where the correction bends by more than the tolerance; arcs stay arcs where the corrected circle fits.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// The NC program
    pub(super) program: PathBuf,
    /// The compensated program
    #[arg(long, short)]
    pub(super) output: PathBuf,
    #[command(flatten)]
    pub(super) machine: MachineArguments,
    /// What the program relies on and does not say: work offsets, tool lengths, where the axes stand (TOML); what is not in
    /// it is taken as zero
    #[arg(long, value_name = "FILE")]
    setup: Option<PathBuf>,
    /// A folder of subroutines that the program calls and does not have itself: name.ngc for the subroutine name, O1000 or 1000.nc for
    /// M98 P1000; may be given several times
    #[arg(long, value_name = "DIR")]
    subroutines: Vec<PathBuf>,
    /// The language of the program; by default that of `control` in the set-up file, or by the end of its name: siemens for .mpf and .spf, heidenhain for .h, otherwise
    /// rs274
    #[arg(long, value_enum)]
    dialect: Option<Language>,
    /// How far a motion may be from where it belongs before it is split, µm
    #[arg(
        long,
        value_name = "UM",
        default_value_t = 1.0,
        allow_negative_numbers = true
    )]
    pub(super) tolerance: f64,
    /// Decimals of changed coordinates: mm,inch,deg; a program's own further ones stay
    #[arg(long, value_name = "MM,INCH,DEG", default_value = "3,4,3", value_parser = decimals)]
    pub(super) decimals: Decimals,
    /// How the numbers of split lines are rounded: each to the nearest (plain), or together, by the shortest way through the graph of
    /// the nearest ones (floyd)
    #[arg(long, value_enum, default_value_t)]
    strategy: Rounding,
    #[command(flatten)]
    limit: LimitArgument,
    /// Blocks that are executed at the most where the program has O-words
    #[arg(long, value_name = "N", default_value_t = 10_000_000)]
    pub(super) max_blocks: u64,
    /// The simplest form: nothing but the work offsets change, by the mean of the correction over all places where the program cuts
    /// (G10 L2 at its beginning); what stays is printed. Needs --setup, which states these offsets; no motion is split, so that
    /// --tolerance and --strategy are refused
    #[arg(long, requires = "setup", conflicts_with_all = ["strategy", "tolerance"])]
    average: bool,
    /// Take the mean of what was measured instead: of the readings of the ball rows of this observations file, whose `origin` and
    /// `direction` are stated
    #[arg(long, value_name = "FILE", requires = "average")]
    ball_row: Option<PathBuf>,
    /// Run the program and its result through the virtual machine, and print how far the tool is from where it belongs
    #[arg(long)]
    verify: bool,
    /// The machine file with the errors that are taken for the real ones in the verification, without which the model is judged by itself
    #[arg(long, value_name = "FILE", requires = "verify")]
    pub(super) truth: Option<PathBuf>,
    /// The features of a part (TOML) as a measuring machine would find them on what the virtual machine cuts, before and after
    #[arg(long, value_name = "FILE", requires = "verify")]
    pub(super) inspect: Option<PathBuf>,
    /// A picture of the path and of the deviations, a thousandfold (SVG)
    #[arg(long, value_name = "FILE", requires = "verify")]
    picture: Option<PathBuf>,
}

/// The language of a program.
#[derive(Clone, Copy, Debug, clap::ValueEnum)]
enum Language {
    Rs274,
    Siemens,
    Heidenhain,
}

impl Arguments {
    /// The files that are read, which no output may replace, with what the call names them by.
    pub(super) fn inputs(&self) -> Vec<(&Path, &'static str)> {
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
            others
                .into_iter()
                .filter_map(|(path, option)| Some((path.as_deref()?, option))),
        );
        inputs
    }

    /// The language of the program: that of the call, that of the control, or that of the name of the file.
    pub(super) fn dialect(&self, setup: &SetUp) -> Dialect {
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

/// Programs whose mean correction is asked for are read twice, from memory.
const MOST_IN_MEMORY: u64 = 256 << 20;

/// `3,4,3`.
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

pub(crate) fn run(arguments: &Arguments) -> Result<Answer, Failure> {
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
        return Err(Failure::in_file(
            program,
            "it is a directory, expected an NC program",
        ));
    }
    let length = file.metadata().map_or(0, |about| about.len());
    let inputs = arguments.inputs();
    let part = arguments
        .inspect
        .as_deref()
        .map(nc_part::read)
        .transpose()?;
    refuse_subroutine(arguments)?;
    refuse_read_once(arguments, &file)?;
    let mut output = OutputFile::open_beside(&arguments.output, &inputs)?;
    let mut drawn = picture_file(arguments)?;
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
        let readings = (arguments.ball_row.as_deref())
            .map(nc_ball_row::readings)
            .transpose()?;
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
        Some(on.verified(&made, output.so_far()?, drawn.as_mut(), &mut notes)?)
    } else {
        None
    };
    output.finish()?;
    if let Some(picture) = drawn {
        picture.finish()?;
    }
    match made {
        Written::Compensated(summary) => {
            let dialect = arguments.dialect(&setup);
            answer(arguments, dialect, &summary, verified, notes)
        }
        Written::Averaged(found) => averaged(&arguments.output, &found, verified, notes),
    }
}

/// Refuses a result in the place of a file that the program may call.
fn refuse_subroutine(arguments: &Arguments) -> Result<(), Failure> {
    let Ok(output) = arguments.output.canonicalize() else {
        return Ok(());
    };
    let mut folders = arguments.subroutines.iter();
    let is_in = |folder: &PathBuf| {
        folder
            .canonicalize()
            .is_ok_and(|folder| output.parent() == Some(&folder))
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

/// The verification reads the program a second time, which a pipe does not give.
fn refuse_read_once(arguments: &Arguments, program: &File) -> Result<(), Failure> {
    let is_file = program.metadata().is_ok_and(|about| about.is_file());
    if is_file || !arguments.verify {
        return Ok(());
    }
    Err(Failure::in_file(
        &arguments.program,
        "found a pipe or a device, expected a file with --verify, which reads the program twice: store it first",
    ))
}

/// The file of the picture, opened before the work starts; it appears when the result is kept.
fn picture_file(arguments: &Arguments) -> Result<Option<OutputFile>, Failure> {
    let Some(path) = &arguments.picture else {
        return Ok(None);
    };
    let ending = path.extension().unwrap_or_default();
    if !ending.eq_ignore_ascii_case("svg") {
        return Err(Failure::Input(format!(
            "--picture: found {}, expected a name that ends in .svg, since the picture is written as SVG only",
            path.display()
        )));
    }
    let both = [path, &arguments.output].map(|path| std::path::absolute(path).ok());
    if both[0] == both[1] {
        return Err(Failure::in_file(
            path,
            "found it for --picture and for --output, expected two files",
        ));
    }
    let mut inputs = arguments.inputs();
    inputs.push((arguments.output.as_path(), "--output"));
    OutputFile::open_beside(path, &inputs).map(Some)
}

/// What was written.
pub(super) enum Written {
    Compensated(Summary),
    Averaged(Vec<Average>),
}

pub(super) fn failure(program: &Path, error: NcError) -> Failure {
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
    arguments: &Arguments,
    dialect: Dialect,
    summary: &Summary,
    verified: Option<Verified>,
    more: Vec<String>,
) -> Result<Answer, Failure> {
    let counts = &summary.counts;
    let document = Nc {
        file: arguments.output.display().to_string(),
        dialect: dialect.name().to_owned(),
        lines: counts.lines,
        motions: counts.motions,
        changed: counts.changed,
        added: counts.added,
        same_as_plain: (arguments.strategy == Rounding::Floyd)
            .then_some(summary.rounded_otherwise == 0),
        ended: summary.ended,
        verified,
        notes: (summary.notes.by_line().into_iter())
            .map(|(line, note)| NcNote {
                line,
                text: note.to_string(),
            })
            .collect(),
    };
    let mut text = format!(
        "{}: {} lines with {} motions read, {} lines changed, {} added\n",
        document.file, document.lines, document.motions, document.changed, document.added
    );
    if let Some(same) = document.same_as_plain {
        text += if same {
            "--strategy floyd: same as plain, byte for byte\n"
        } else {
            "--strategy floyd: other numbers than plain\n"
        };
    }
    if let Some(verified) = &document.verified {
        text += &nc_verified::text(verified);
    }
    let mut notes: Vec<String> = (document.notes.iter())
        .map(|note| format!("line {}: {}", note.line, note.text))
        .collect();
    notes.extend(more);
    if document.motions == 0 {
        notes.push(format!(
            "no motion was found in {} lines, and nothing was changed: is this an NC program in the language {}? (--dialect)",
            document.lines, document.dialect
        ));
    }
    Answer::new(&document, text, notes)
}

/// The mean corrections that are in the work offsets now.
fn averaged(
    output: &Path,
    found: &[Average],
    verified: Option<Verified>,
    mut notes: Vec<String>,
) -> Result<Answer, Failure> {
    let zeros = found.iter().filter_map(|of| of.off_at_zero.as_ref());
    notes.extend(
        zeros.map(|note| format!("{note}. Here it is added to the values of the line G10 L2")),
    );
    let document = NcAverage {
        file: output.display().to_string(),
        offsets: (found.iter())
            .map(|of| AverageOffset {
                work_offset: of.system.clone(),
                places: of.places,
                mean_um: of.mean_mm.map(|mm| 1e3 * mm),
                offset_mm: of.offset_mm,
                before_max_um: of.before_um[0],
                before_rms_um: of.before_um[1],
                left_max_um: of.left_um[0],
                left_rms_um: of.left_um[1],
            })
            .collect(),
        verified,
    };
    let mut text = format!(
        "{}: the mean correction is in the work offsets\n",
        document.file
    );
    for of in &document.offsets {
        let [x, y, z] = of.mean_um;
        let [at_x, at_y, at_z] = of.offset_mm;
        let _ = write!(
            text,
            "{}, {} places: X {x:+.1} Y {y:+.1} Z {z:+.1} µm, now X {at_x} Y {at_y} Z {at_z} mm\n  correction before: at most {:.2} µm, RMS {:.2} µm; what is left beside the mean: at most {:.2} µm, RMS {:.2} µm\n",
            of.work_offset,
            of.places,
            of.before_max_um,
            of.before_rms_um,
            of.left_max_um,
            of.left_rms_um
        ); // writing to a String cannot fail
    }
    if let Some(verified) = &document.verified {
        text += &nc_verified::text(verified);
    }
    Answer::new(&document, text, notes)
}

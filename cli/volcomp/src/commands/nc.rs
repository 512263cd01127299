//! `volcomp nc`: an NC program in, the compensated one out.

use std::{
    fmt::Write as _,
    fs::File,
    io::{BufReader, Write},
    path::{Path, PathBuf},
};

use volcomp_document::read_text;
use volcomp_model::{Machine, Temperatures};
use volcomp_nc::{
    Average, Corrector, Decimals, Deviation, Job, NcError, Part, SetUp, Strategy, Summary,
    Verification, Virtual, average, compensate, picture, verify,
};

use super::{Answer, machine_notes, nc_part};
use crate::{
    answers::nc::{AverageOffset, Nc, NcAverage, NcDeviation, NcNote, Verified},
    failure::Failure,
    output::OutputFile,
    points::MachineArguments,
    progress::byte_bar,
};

/// An NC program in, the same program with the correction in its coordinates out
///
/// RS-274 as LinuxCNC and FANUC controls read it. Every byte that is no changed coordinate comes out as it went in. A line is
/// split only where the correction bends by more than the tolerance; arcs stay arcs where the corrected circle fits.
#[derive(clap::Args)]
pub(crate) struct Arguments {
    /// The NC program
    program: PathBuf,
    /// The compensated program
    #[arg(long, short)]
    output: PathBuf,
    #[command(flatten)]
    machine: MachineArguments,
    /// What the program relies on and does not say: work offsets, tool lengths, where the axes stand (TOML); what is not in
    /// it is taken as zero
    #[arg(long, value_name = "FILE")]
    setup: Option<PathBuf>,
    /// How far a motion may be from where it belongs before it is split, µm
    #[arg(long, value_name = "UM", default_value_t = 1.0)]
    tolerance: f64,
    /// Decimals of changed coordinates: mm,inch,deg; a program's own further ones stay
    #[arg(long, value_name = "MM,INCH,DEG", default_value = "3,4,3", value_parser = decimals)]
    decimals: Decimals,
    /// How the numbers of split lines are rounded: each to the nearest (plain), or together, by the shortest way through the graph of
    /// the nearest ones (floyd)
    #[arg(long, value_enum, default_value_t)]
    strategy: Rounding,
    /// Blocks that are executed at the most where the program has O-words
    #[arg(long, value_name = "N", default_value_t = 10_000_000)]
    max_blocks: u64,
    /// The simplest form: nothing but the work offsets change, by the mean of the correction over all places where the program cuts
    /// (G10 L2 at its beginning); what stays is printed. Needs --setup, which states these offsets
    #[arg(long, requires = "setup", conflicts_with_all = ["verify", "inspect", "picture"])]
    average: bool,
    /// Run the program and its result through the virtual machine, and print how far the tool is from where it belongs
    #[arg(long)]
    verify: bool,
    /// The machine file with the errors that are taken for the real ones in the verification, without which the model is judged by itself
    #[arg(long, value_name = "FILE", requires = "verify")]
    truth: Option<PathBuf>,
    /// The features of a part (TOML) as a measuring machine would find them on what the virtual machine cuts, before and after
    #[arg(long, value_name = "FILE", requires = "verify")]
    inspect: Option<PathBuf>,
    /// A picture of the path and of the deviations, a thousandfold (SVG)
    #[arg(long, value_name = "FILE", requires = "verify")]
    picture: Option<PathBuf>,
}

/// How the numbers of split lines are rounded.
#[derive(Clone, Copy, Debug, Default, clap::ValueEnum)]
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
    let (machine, temperatures) = arguments.machine.read()?;
    let setup = match &arguments.setup {
        Some(path) => SetUp::parse(&read_text(path)?, &path.display().to_string())?,
        None => SetUp::default(),
    };
    let program = &arguments.program;
    let file = File::open(program).map_err(|e| Failure::in_file(program, e))?;
    if file.metadata().is_ok_and(|about| about.is_dir()) {
        return Err(Failure::in_file(
            program,
            "it is a directory, expected an NC program",
        ));
    }
    let length = file.metadata().map_or(0, |about| about.len());
    let mut inputs = vec![
        (program.as_path(), "PROGRAM"),
        (arguments.machine.machine.as_path(), "--machine"),
    ];
    inputs.extend(arguments.setup.as_deref().map(|path| (path, "--setup")));
    inputs.extend(arguments.truth.as_deref().map(|path| (path, "--truth")));
    inputs.extend(arguments.inspect.as_deref().map(|path| (path, "--inspect")));
    let part = arguments
        .inspect
        .as_deref()
        .map(nc_part::read)
        .transpose()?;
    let mut output = OutputFile::open_beside(&arguments.output, &inputs)?;
    let corrector = Corrector::new(&machine, &temperatures, 1e-3 * tolerance_um)
        .map_err(|error| failure(program, error))?;
    let job = Job {
        corrector: &corrector,
        setup: &setup,
        decimals: arguments.decimals,
        strategy: match arguments.strategy {
            Rounding::Plain => Strategy::Plain,
            Rounding::Floyd => Strategy::Floyd,
        },
        most_blocks: arguments.max_blocks,
        keep_shares: arguments.verify,
    };
    if arguments.average {
        if length > MOST_IN_MEMORY {
            let what = "longer than 256 MiB, which --average does not take";
            return Err(Failure::in_file(program, what));
        }
        let text = std::fs::read(program).map_err(|e| Failure::in_file(program, e))?;
        let found = average(&text, &mut output, job).map_err(|error| failure(program, error))?;
        output.finish()?;
        let notes = machine_notes(&machine, &temperatures);
        return averaged(&arguments.output, &found, notes);
    }
    let bar = byte_bar(length);
    let mut input = BufReader::with_capacity(1 << 18, file);
    let summary = compensate(&mut input, &mut output, job, |bytes| {
        bar.set_position(bytes);
        Ok(())
    });
    bar.finish_and_clear();
    let summary = summary.map_err(|error| failure(program, error))?;
    let mut notes = machine_notes(&machine, &temperatures);
    let verification = if arguments.verify {
        if arguments.truth.is_none() {
            notes.push("--verify without --truth: the model is judged by itself, which shows rounding and splits, not how well it knows the machine".to_owned());
        }
        let model = (&machine, &temperatures);
        let result = output.so_far()?;
        Some(verified(
            arguments,
            model,
            &setup,
            &summary,
            result,
            part.as_ref(),
        )?)
    } else {
        None
    };
    if let (Some(path), Some(found)) = (&arguments.picture, &verification) {
        let inputs = [
            (program.as_path(), "PROGRAM"),
            (arguments.output.as_path(), "--output"),
        ];
        let mut file = OutputFile::open_beside(path, &inputs)?;
        file.write_all(picture(found).as_bytes())
            .map_err(|e| Failure::in_file(path, e))?;
        file.finish()?;
    }
    if let Some(found) = &verification {
        is_better(found, arguments)?;
    }
    output.finish()?;
    answer(&arguments.output, &summary, verification.as_ref(), notes)
}

/// The program and its result on the virtual machine.
fn verified(
    arguments: &Arguments,
    model: (&Machine, &Temperatures),
    setup: &SetUp,
    summary: &Summary,
    result: &Path,
    part: Option<&Part>,
) -> Result<Verification, Failure> {
    let read;
    let (truth, temperatures) = match &arguments.truth {
        Some(path) => {
            read = arguments.machine.spindle.read(path)?;
            (&read.0, &read.1)
        }
        None => model,
    };
    let of = Virtual {
        truth,
        temperatures,
        setup,
        most_blocks: arguments.max_blocks,
        part,
    };
    let open = |path: &Path| {
        let file = File::open(path).map_err(|e| Failure::in_file(path, e))?;
        Ok::<_, Failure>(BufReader::new(file))
    };
    let (mut original, mut result) = (open(&arguments.program)?, open(result)?);
    verify(&mut original, &mut result, &summary.shares, of)
        .map_err(|error| failure(&arguments.program, error))
}

/// A result with which the tool is further off than without is not kept: by the root of the mean square, or in one place by
/// more than twice as much. Less than the tolerance and two steps of the words does not count.
fn is_better(found: &Verification, arguments: &Arguments) -> Result<(), Failure> {
    let Decimals { mm, inch, .. } = arguments.decimals;
    let step_um = [(1e3, mm), (25.4e3, inch)]
        .map(|(unit_um, decimals)| unit_um / 10_f64.powi(i32::from(decimals)));
    let no_matter_um = arguments.tolerance + 2.0 * step_um[0].max(step_um[1]);
    let Verification { before, after, .. } = found;
    let is_worse = after.rms_um > before.rms_um + no_matter_um
        || after.max_um > 2.0 * before.max_um + no_matter_um;
    if !is_worse {
        return Ok(());
    }
    Err(Failure::Work(format!(
        "{}: not written, since the tool is further off with the result than without: at most {:.2} µm (line {}), RMS {:.2} µm, instead of at most {:.2} µm, RMS {:.2} µm",
        arguments.output.display(),
        after.max_um,
        after.line,
        after.rms_um,
        before.max_um,
        before.rms_um
    )))
}

fn failure(program: &Path, error: NcError) -> Failure {
    match error {
        NcError::Machine(error) => error.into(),
        NcError::Io(error) => Failure::work_on(program, &error),
        other => Failure::in_file(program, other),
    }
}

fn answer(
    output: &Path,
    summary: &Summary,
    verification: Option<&Verification>,
    more: Vec<String>,
) -> Result<Answer, Failure> {
    let counts = &summary.counts;
    let document = Nc {
        file: output.display().to_string(),
        lines: counts.lines,
        motions: counts.motions,
        changed: counts.changed,
        added: counts.added,
        ended: summary.ended,
        verified: verification.map(|found| Verified {
            motions: found.motions,
            places: found.places,
            before: deviation(&found.before),
            after: deviation(&found.after),
            features: nc_part::document(&found.features),
        }),
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
    if let Some(verified) = &document.verified {
        text.push_str(&table(verified));
        if !verified.features.is_empty() {
            text.push_str(&nc_part::text(&verified.features));
        }
    }
    let mut notes: Vec<String> = (document.notes.iter())
        .map(|note| format!("line {}: {}", note.line, note.text))
        .collect();
    notes.extend(more);
    Answer::new(&document, text, notes)
}

fn deviation(of: &Deviation) -> NcDeviation {
    NcDeviation {
        max_um: of.max_um,
        rms_um: of.rms_um,
        line: of.line,
        tip_mm: of.tip_mm,
    }
}

/// The mean corrections that are in the work offsets now.
fn averaged(output: &Path, found: &[Average], notes: Vec<String>) -> Result<Answer, Failure> {
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
    Answer::new(&document, text, notes)
}

/// How far the tool is from where the program wants it.
fn table(verified: &Verified) -> String {
    let row = |name: &str, of: &NcDeviation| {
        let [x, y, z] = of.tip_mm;
        format!(
            "{name:<10}{:>9.2}{:>9.2}   line {}, tip at {x:.1} {y:.1} {z:.1} mm\n",
            of.max_um, of.rms_um, of.line
        )
    };
    let mut text = format!(
        "\nDeviation of the tool from the programmed path, {} motions looked at:\n{:<10}{:>9}{:>9}   largest in\n",
        verified.motions, "", "max µm", "RMS µm"
    );
    text.push_str(&row("before", &verified.before));
    text.push_str(&row("after", &verified.after));
    text
}

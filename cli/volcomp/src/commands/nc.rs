//! `volcomp nc`: an NC program in, the compensated one out.

use std::{
    fs::File,
    io::{BufReader, Write},
    path::{Path, PathBuf},
};

use volcomp_document::read_text;
use volcomp_nc::{Corrector, Decimals, NcError, SetUp, Summary, compensate};

use super::{Answer, machine_notes};
use crate::{
    answers::nc::{Nc, NcNote},
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
}

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
        return Err(Failure::in_file(program, "it is a directory, expected an NC program"));
    }
    let length = file.metadata().map_or(0, |about| about.len());
    let mut inputs = vec![
        (program.as_path(), "PROGRAM"),
        (arguments.machine.machine.as_path(), "--machine"),
    ];
    inputs.extend(arguments.setup.as_deref().map(|path| (path, "--setup")));
    let mut output = OutputFile::open_beside(&arguments.output, &inputs)?;
    let corrector = Corrector::new(&machine, &temperatures, 1e-3 * tolerance_um)
        .map_err(|error| failure(program, error))?;
    let bar = byte_bar(length);
    let mut input = BufReader::with_capacity(1 << 18, file);
    let summary = compensate(
        &mut input,
        &mut output,
        &corrector,
        &setup,
        arguments.decimals,
        |bytes| {
            bar.set_position(bytes);
            Ok(())
        },
    );
    bar.finish_and_clear();
    let summary = summary.map_err(|error| failure(program, error))?;
    output.flush().map_err(|e| Failure::in_file(&arguments.output, e))?;
    output.finish()?;
    answer(&arguments.output, &summary, machine_notes(&machine, &temperatures))
}

fn failure(program: &Path, error: NcError) -> Failure {
    match error {
        NcError::Machine(error) => error.into(),
        NcError::Io(error) => Failure::work_on(program, &error),
        other => Failure::in_file(program, other),
    }
}

fn answer(output: &Path, summary: &Summary, thermal: Vec<String>) -> Result<Answer, Failure> {
    let counts = &summary.counts;
    let document = Nc {
        file: output.display().to_string(),
        lines: counts.lines,
        motions: counts.motions,
        changed: counts.changed,
        added: counts.added,
        ended: summary.ended,
        notes: (summary.notes.by_line().into_iter())
            .map(|(line, note)| NcNote {
                line,
                text: note.to_string(),
            })
            .collect(),
    };
    let text = format!(
        "{}: {} lines with {} motions read, {} lines changed, {} added\n",
        document.file, document.lines, document.motions, document.changed, document.added
    );
    let mut notes: Vec<String> = (document.notes.iter())
        .map(|note| format!("line {}: {}", note.line, note.text))
        .collect();
    notes.extend(thermal);
    Answer::new(&document, text, notes)
}

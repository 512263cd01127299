//! `compensate_nc`: NC programs with the correction in their coordinates.

use std::{
    fs::File,
    io::{self, BufReader},
    path::{Path, PathBuf},
};

use pyo3::{
    prelude::*,
    types::{PyDict, PyList},
};
use volcomp_model::{Temperatures, document::read_text, vocabulary::CorrectionLimit};
use volcomp_nc::{Corrector, Dialect, Job, NcError, SetUp, Summary, compensate};

use crate::{failure::Failure, machine::Machine, output::write_file, positions::temperatures};

/// Write an NC program with the correction of the machine in its coordinates.
///
/// program, output: paths; output appears by rename. setup: set-up file (TOML) with what the program does not contain. subroutines: folders.
/// dialect: "rs274", "siemens" or "heidenhain"; default by `control` in the set-up file, else by the extension. tolerance_um: largest deviation of
/// a motion before it is split. limit_um: largest correction of an axis (um; urad of rotary axes). temperatures_degc: dict sensor -> degC.
///
/// Returns a dict with the keys of `volcomp nc --json`: file, dialect, lines, motions, changed, added, ended, notes.
/// Raises InputError with the line of the program that cannot be compensated; then nothing is written.
#[pyfunction]
#[pyo3(signature = (program, output, machine, *, setup=None, subroutines=None, dialect=None, tolerance_um=1.0, limit_um=250.0, temperatures_degc=None))]
#[expect(clippy::too_many_arguments, reason = "named in Python")]
pub(crate) fn compensate_nc<'py>(
    py: Python<'py>,
    program: PathBuf,
    output: PathBuf,
    machine: &Bound<'py, Machine>,
    setup: Option<PathBuf>,
    subroutines: Option<Vec<PathBuf>>,
    dialect: Option<&str>,
    tolerance_um: f64,
    limit_um: f64,
    temperatures_degc: Option<Temperatures>,
) -> PyResult<Bound<'py, PyDict>> {
    let machine = &machine.get().machine;
    let temperatures = temperatures(machine, temperatures_degc)?;
    if !(1e-3..=1e3).contains(&tolerance_um) {
        let message = format!("tolerance_um: found {tolerance_um}, expected 0.001 to 1000");
        return Err(Failure::argument(message).into());
    }
    let limit = CorrectionLimit::new(limit_um)
        .map_err(|error| Failure::argument(format_args!("limit_um: {error}")))?;
    let (dialect, summary) = py.detach(|| {
        let setup_file = setup.as_deref();
        let setup = match setup_file {
            Some(path) => SetUp::parse(&read_text(path)?, &path.display().to_string())?,
            None => SetUp::default(),
        };
        let setup = setup.with_subroutines(subroutines.unwrap_or_default());
        let dialect = match (dialect, setup.control()) {
            (Some(name), _) => dialect_named(name)?,
            (None, Some(control)) => control.dialect(),
            (None, None) => Dialect::of_file(&program),
        };
        for input in setup_file.into_iter().chain([program.as_path()]) {
            refuse_same(input, &output)?;
        }
        let file = File::open(&program).map_err(|error| Failure::system(&program, error))?;
        let corrector = Corrector::new(machine, &temperatures, 1e-3 * tolerance_um)
            .map_err(|error| failure(&program, error))?;
        let job = Job { dialect, limit, ..Job::new(&corrector, &setup) };
        let mut interrupted = None;
        let written = write_file(&output, |out| {
            let mut input = BufReader::with_capacity(1 << 18, file);
            compensate(&mut input, out, job, |_| {
                Python::attach(|py| {
                    py.check_signals().map_err(|error| {
                        interrupted = Some(error);
                        NcError::Io(io::ErrorKind::Interrupted.into())
                    })
                })
            })
            .map_err(|error| failure(&program, error))
        });
        match interrupted {
            Some(error) => Err(Failure::Raised(error)),
            None => written.map(|summary| (dialect, summary)),
        }
    })?;
    document(py, &output, dialect, &summary)
}

fn document<'py>(
    py: Python<'py>,
    output: &Path,
    dialect: Dialect,
    summary: &Summary,
) -> PyResult<Bound<'py, PyDict>> {
    let notes = PyList::empty(py);
    for (line, note) in summary.notes.by_line() {
        let entry = PyDict::new(py);
        entry.set_item("line", line)?;
        entry.set_item("text", note.to_string())?;
        notes.append(entry)?;
    }
    let result = PyDict::new(py);
    result.set_item("file", output.display().to_string())?;
    result.set_item("dialect", dialect.name())?;
    result.set_item("lines", summary.counts.lines)?;
    result.set_item("motions", summary.counts.motions)?;
    result.set_item("changed", summary.counts.changed)?;
    result.set_item("added", summary.counts.added)?;
    result.set_item("ended", summary.ended)?;
    result.set_item("notes", notes)?;
    Ok(result)
}

fn dialect_named(name: &str) -> Result<Dialect, Failure> {
    let all = [Dialect::Rs274, Dialect::Siemens, Dialect::Heidenhain];
    let found = all.into_iter().find(|dialect| dialect.name() == name);
    found.ok_or_else(|| {
        Failure::argument(format_args!(
            "dialect: found {name:?}, expected \"rs274\", \"siemens\" or \"heidenhain\""
        ))
    })
}

fn refuse_same(input: &Path, output: &Path) -> Result<(), Failure> {
    match (input.canonicalize(), output.canonicalize()) {
        (Ok(from), Ok(to)) if from == to => Err(Failure::argument(format_args!(
            "output: found {}, which this call reads, expected another file",
            output.display()
        ))),
        _ => Ok(()),
    }
}

fn failure(program: &Path, error: NcError) -> Failure {
    let line = match &error {
        NcError::Block { line, .. }
        | NcError::NotCompensated { line, .. }
        | NcError::OnlyAtMachine { line, .. }
        | NcError::LongLine { line, .. }
        | NcError::Binary { line, .. }
        | NcError::OutOfBounds { line, .. } => Some(*line),
        _ => None,
    };
    match error {
        NcError::Machine(error) => error.into(),
        NcError::Io(error) => Failure::system(program, error),
        other => {
            let file = program.display().to_string();
            Failure::at(format_args!("{file}: {other}"), Some(file.clone()), line, None)
        }
    }
}

use std::path::PathBuf;

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_model::{Tolerance, evaluator::BLOB_VERSION, hexadecimal};

use super::{Answer, machine_notes};
use crate::{arguments::SpindleArguments, failure::Failure, output::OutputFile};

/// Write the compiled machine for real-time evaluation
///
/// Curves become piecewise cubics within the tolerance. The file starts with VOLCOMPM, the format version and the SHA-256
/// of the rest; `volcomp_evaluator::CompiledMachine::from_blob` reads it.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp compile gantry.toml -o gantry.blob
  volcomp compile mill.toml --tool T5 --tolerance-nm 10 -o mill.blob")]
pub(crate) struct CompileArguments {
    /// Machine file (TOML)
    machine: PathBuf,
    #[command(flatten)]
    spindle: SpindleArguments,
    /// File for the compiled machine
    #[arg(long, short)]
    output: PathBuf,
    /// Largest deviation of a compiled curve, nm or nrad
    #[arg(long, value_name = "NM", default_value_t = 1.0)]
    tolerance_nm: f64,
}

/// Result of `volcomp compile`: the written file and the deviation of its curves.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Compile {
    /// Path of the written file.
    file: String,
    /// The size of the file, bytes.
    bytes: usize,
    /// Version of the file format.
    version: u32,
    /// SHA-256 of the machine, as in the header of the file: hexadecimal digits.
    sha256: String,
    /// Maximum deviation of a compiled curve from its source, nm for displacements and nrad for
    /// rotations.
    tolerance_nm: f64,
    /// Number of cubic pieces of all curves.
    pieces: usize,
}

pub(crate) fn run(arguments: &CompileArguments) -> Result<Answer, Failure> {
    let nm = arguments.tolerance_nm;
    if !(nm > 0.0 && nm.is_finite()) {
        return Err(Failure::Input(format!(
            "--tolerance-nm: found {nm}, expected a tolerance above 0 nm"
        )));
    }
    let (machine, temperatures) = arguments.spindle.read(&arguments.machine)?;
    let file = OutputFile::open_beside(&arguments.output, &[(&arguments.machine, "the machine")])?;
    let compiled = machine.compile_at(Tolerance::from_nm(nm), &temperatures)?;
    let blob = compiled.to_blob();
    file.write_whole(&blob)?;
    let document = Compile {
        file: arguments.output.display().to_string(),
        bytes: blob.len(),
        version: BLOB_VERSION,
        // In the file the checksum follows VOLCOMPM and the version.
        sha256: hexadecimal(blob.get(12..44).unwrap_or_default()),
        tolerance_nm: nm,
        pieces: compiled.pieces(),
    };
    let text = format!(
        "{}: {} bytes, {} cubic pieces, within {nm} nm and {nm} nrad\nSHA-256 {}\n",
        document.file, document.bytes, document.pieces, document.sha256
    );
    Answer::new(&document, text, machine_notes(&machine, &temperatures))
}

use std::{
    path::{Path, PathBuf},
    str::FromStr,
};

use schemars::JsonSchema;
use serde::Serialize;
use serde_json::Value;
use volcomp_document::read_text;
use volcomp_tables::axis_table::{
    Curves, Format, ListedTable, ReadOptions, TextFile, curves, is_facts_file, read, read_mesh,
    to_toml,
};

use super::{Answer, export::ControlArguments};
use crate::{failure::Failure, output::OutputFile};

/// Convert compensation tables of a control to curves of a machine file
///
/// A table of an axis over itself becomes positioning (EXX), one of another axis straightness (EYX), by the directions of
/// the axis letters. Anomalies of the files are reported on standard error. The curves are printed, or written with
/// `--output`.
#[derive(clap::Args)]
#[command(after_help = "\
Examples:
  volcomp import gantry-tables.csv -o curves.toml
  volcomp --json import mill-840d")]
pub(crate) struct ImportArguments {
    /// Files of one control, or a folder of them
    #[arg(required = true)]
    files: Vec<PathBuf>,
    /// Format, where the files do not show it: of the tables of `export`, or mesh for the heights of a bed, which become EZX
    /// and EZY
    #[arg(long)]
    format: Option<Source>,
    /// File for the part `[errors]` of a machine file [default: print it]
    #[arg(long, short, value_name = "FILE")]
    output: Option<PathBuf>,
    #[command(flatten)]
    control: ControlArguments,
}

/// Compensation tables, or a mesh of heights.
#[derive(Clone, Copy, Debug)]
enum Source {
    Tables(Format),
    Mesh,
}

const MESH: &str = "mesh";

impl FromStr for Source {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == MESH {
            return Ok(Self::Mesh);
        }
        let format = text.parse().map(Self::Tables);
        format.map_err(|error| format!("{error}, {MESH}"))
    }
}

/// Result of `volcomp import`: the tables read, as curves of a machine file.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Import {
    /// Format of the tables, as in `--format`; detected from the files if not given.
    format: String,
    /// Paths of the read files.
    files: Vec<String>,
    /// Anomalies in the files and how they were interpreted.
    warnings: Vec<String>,
    /// The tables of the files, in the sign convention of volcomp.
    tables: Vec<ListedTable>,
    /// The curves by error name, as in `[errors]` of a machine file.
    errors: Value,
    /// Path of the file with the curves; only with `--output`.
    #[serde(skip_serializing_if = "Option::is_none")]
    output: Option<String>,
}

pub(crate) fn run(arguments: &ImportArguments) -> Result<Answer, Failure> {
    let paths = paths(&arguments.files)?;
    let mut files = Vec::new();
    for path in &paths {
        files.push(TextFile { name: path.display().to_string(), text: read_text(path)? });
    }
    let shown = || Format::of_files(&files).map(Source::Tables);
    let Some(source) = arguments.format.or_else(shown) else {
        return Err(not_shown(&paths));
    };
    let output = match &arguments.output {
        None => None,
        Some(path) => {
            let inputs: Vec<(&Path, &str)> =
                paths.iter().map(|path| (path.as_path(), "a table")).collect();
            Some(OutputFile::open_beside(path, &inputs)?)
        }
    };
    let options = ReadOptions {
        axes: arguments.control.numbers()?.unwrap_or_default(),
        encoder: arguments.control.encoder,
        detection_unit: arguments.control.detection_unit,
    };
    let (format, found) = match (source, &files[..]) {
        (Source::Tables(format), files) => (format.name(), read(format, files, &options)?),
        (Source::Mesh, [file]) => (MESH, read_mesh(file)?),
        (Source::Mesh, files) => {
            let message = format!("--format mesh: found {} files, expected one", files.len());
            return Err(Failure::Input(message));
        }
    };
    let made = curves(&found.content)?;
    let text = to_toml(&made);
    if let Some(output) = output {
        output.write_whole(&text)?;
    }
    let warnings: Vec<String> = found.warnings.iter().map(ToString::to_string).collect();
    let document = Import {
        format: format.to_string(),
        files: paths
            .iter()
            .filter(|path| !is_facts(path))
            .map(|path| path.display().to_string())
            .collect(),
        warnings: warnings.clone(),
        tables: found.content.listed(),
        errors: as_json(&made)?,
        output: arguments.output.as_ref().map(|path| path.display().to_string()),
    };
    let shown = match &arguments.output {
        None => text,
        Some(path) => {
            let motions = made.motions.iter().map(|(name, _)| name.to_string());
            let locations = made.locations.iter().map(|(name, _)| name.to_string());
            let names: Vec<String> = motions.chain(locations).collect();
            format!("{}: {}\n", path.display(), names.join(", "))
        }
    };
    Answer::new(&document, shown, warnings)
}

/// True if a file describes the tables and is no table itself.
fn is_facts(path: &Path) -> bool {
    let name = path.file_name().and_then(|name| name.to_str());
    name.is_some_and(is_facts_file)
}

/// The paths in `given`. Each folder is replaced by its files, sorted by name.
fn paths(given: &[PathBuf]) -> Result<Vec<PathBuf>, Failure> {
    let mut paths = Vec::new();
    for path in given {
        if !path.is_dir() {
            paths.push(path.clone());
            continue;
        }
        let unreadable =
            |e: std::io::Error| Failure::in_file(path, format_args!("cannot be read: {e}"));
        let mut inside = Vec::new();
        for entry in std::fs::read_dir(path).map_err(unreadable)? {
            let file = entry.map_err(unreadable)?.path();
            if file.is_file() {
                inside.push(file);
            }
        }
        if inside.iter().all(|file| is_facts(file)) {
            return Err(Failure::in_file(
                path,
                "found no file in this folder, expected compensation tables",
            ));
        }
        inside.sort();
        paths.extend(inside);
    }
    Ok(paths)
}

fn not_shown(paths: &[PathBuf]) -> Failure {
    let is_comp = paths.iter().any(|path| path.extension().is_some_and(|ending| ending == "comp"));
    let expected = if is_comp {
        "--format linuxcnc for COMP_FILE_TYPE 0 or --format linuxcnc-type1 for 1: the file does not say it".to_owned()
    } else {
        format!("--format and one of: {}", Format::ALL.map(Format::name).join(", "))
    };
    let first = paths
        .iter()
        .find(|path| !is_facts(path))
        .map_or_else(|| Path::new("").to_owned(), Clone::clone);
    Failure::in_file(&first, format_args!("found no format that is certain, expected {expected}"))
}

fn as_json(made: &Curves) -> Result<Value, Failure> {
    let text = to_toml(made);
    let table: toml::Table = text.parse().map_err(|e| Failure::Work(format!("the curves: {e}")))?;
    let json =
        serde_json::to_value(&table).map_err(|e| Failure::Work(format!("the curves: {e}")))?;
    Ok(json.get("errors").cloned().unwrap_or(Value::Null))
}

//! Output of the commands: standard output, files that are written atomically, SVG and PNG pictures, progress bars.
//!
//! Numbers that are not finite are refused, because JSON would represent them as null.

use std::{
    collections::BTreeSet,
    fmt,
    io::{self, BufWriter, ErrorKind, Write},
    path::{Path, PathBuf},
    sync::{Mutex, MutexGuard, PoisonError},
    time::Duration,
};

use ciborium::Value;
use indicatif::{HumanDuration, ProgressBar, ProgressState, ProgressStyle};
use resvg::{
    tiny_skia::{Pixmap, Transform},
    usvg::{Options, Tree, fontdb::Database},
};
use serde::Serialize;
use tempfile::{NamedTempFile, TempDir};

use crate::failure::Failure;

/// Writes a text to standard output.
pub(crate) fn print(text: &str) -> Result<(), Failure> {
    print_by(|out| out.write_all(text.as_bytes()))
}

/// Writes text to standard output. Headers are bold only on a terminal, unless `NO_COLOR` is set.
pub(crate) fn print_by(
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), Failure> {
    let out = anstream::AutoStream::auto(io::stdout().lock());
    written(BufWriter::new(out), write)
}

/// Writes text without styles to standard output.
pub(crate) fn print_plain(
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), Failure> {
    written(io::stdout().lock(), write)
}

/// Writes to standard output; a broken pipe is ignored.
fn written(
    mut out: impl Write,
    write: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), Failure> {
    match write(&mut out).and_then(|()| out.flush()) {
        Err(e) if e.kind() != ErrorKind::BrokenPipe => {
            Err(Failure::Work(format!("standard output: {e}")))
        }
        _ => Ok(()),
    }
}

/// Unfinished files and temporary folders, which are removed if the program is interrupted.
static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

fn unfinished() -> MutexGuard<'static, BTreeSet<PathBuf>> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// On Ctrl-C or termination, removes unfinished files and exits with status 130, as a shell does.
pub(crate) fn clean_up_when_interrupted() {
    let clean_up = || {
        for path in unfinished().iter() {
            // The file may already have been removed. Errors cannot be reported here.
            let _ = if path.is_dir() {
                std::fs::remove_dir_all(path)
            } else {
                std::fs::remove_file(path)
            };
        }
        eprintln!("interrupted: nothing half-written is left");
        std::process::exit(130);
    };
    if let Err(e) = ctrlc::set_handler(clean_up) {
        tracing::warn!("Ctrl-C may leave unfinished files: {e}");
    }
}

pub(crate) struct TemporaryFolder(TempDir);

impl TemporaryFolder {
    pub(crate) fn new() -> Result<Self, Failure> {
        let folder =
            tempfile::tempdir().map_err(|e| Failure::Work(format!("temporary folder: {e}")))?;
        unfinished().insert(folder.path().to_owned());
        Ok(Self(folder))
    }

    pub(crate) fn path(&self) -> &Path {
        self.0.path()
    }
}

impl Drop for TemporaryFolder {
    fn drop(&mut self) {
        unfinished().remove(self.0.path());
    }
}

/// A file that becomes visible by rename once its content is complete.
pub(crate) struct OutputFile {
    path: PathBuf,
    temporary: PathBuf,
    writer: Option<BufWriter<NamedTempFile>>,
}

impl Drop for OutputFile {
    fn drop(&mut self) {
        unfinished().remove(&self.temporary);
    }
}

impl OutputFile {
    /// Opens an output before the work starts, so that an unwritable path fails early.
    pub(crate) fn open(path: &Path) -> Result<Self, Failure> {
        let refused = |why: &dyn std::fmt::Display| {
            Failure::Input(format!("{}: cannot be written: {why}", path.display()))
        };
        if path.is_dir() {
            return Err(refused(&"it is a directory, expected a file"));
        }
        let folder = match path.parent() {
            Some(parent) if !parent.as_os_str().is_empty() => parent,
            _ => Path::new("."),
        };
        // A rename must not replace a device or a pipe.
        if path.exists() && !path.is_file() {
            return Err(refused(&"it is no ordinary file"));
        }
        if !folder.is_dir() {
            return Err(refused(&format_args!("there is no folder {}", folder.display())));
        }
        let file = tempfile::Builder::new().permissions_as_new_file().tempfile_in(folder).map_err(
            |e| {
                // Remove the name of the temporary file, which would not help the user.
                let message = e.to_string();
                refused(&message.split(" at path ").next().unwrap_or_default())
            },
        )?;
        let temporary = file.path().to_owned();
        unfinished().insert(temporary.clone());
        Ok(Self { path: path.to_owned(), temporary, writer: Some(BufWriter::new(file)) })
    }

    /// Opens an output that must not be one of the `inputs`. Each input comes with its option, which the message names.
    pub(crate) fn open_beside(path: &Path, inputs: &[(&Path, &str)]) -> Result<Self, Failure> {
        for (input, option) in inputs {
            if let (Ok(output), Ok(input)) = (path.canonicalize(), input.canonicalize())
                && output == input
            {
                return Err(Failure::in_file(
                    path,
                    format_args!("this is the file of {option}, expected another one to write"),
                ));
            }
        }
        Self::open(path)
    }

    /// True if a file with another text exists, which the output will replace.
    pub(crate) fn replaces(&self, text: &str) -> bool {
        std::fs::read(&self.path).is_ok_and(|there| there != text.as_bytes())
    }

    pub(crate) fn append(&mut self, bytes: &[u8]) -> Result<(), Failure> {
        match &mut self.writer {
            Some(writer) => writer.write_all(bytes).map_err(|e| Failure::work_on(&self.path, &e)),
            None => Ok(()),
        }
    }

    pub(crate) fn write_whole(mut self, bytes: impl AsRef<[u8]>) -> Result<(), Failure> {
        self.append(bytes.as_ref())?;
        self.finish()
    }

    pub(crate) fn so_far(&mut self) -> Result<&Path, Failure> {
        self.flush().map_err(|e| Failure::work_on(&self.path, &e))?;
        Ok(&self.temporary)
    }

    pub(crate) fn finish(mut self) -> Result<(), Failure> {
        let Some(writer) = self.writer.take() else {
            return Ok(());
        };
        let failed = |e: &io::Error| Failure::work_on(&self.path, e);
        let file = writer.into_inner().map_err(|e| failed(e.error()))?;
        file.as_file().sync_all().map_err(|e| failed(&e))?;
        file.persist(&self.path).map_err(|e| failed(&e.error))?;
        tracing::debug!("wrote {}", self.path.display());
        Ok(())
    }
}

/// Libraries write to the file through `io::Write`.
impl Write for OutputFile {
    fn write(&mut self, bytes: &[u8]) -> io::Result<usize> {
        self.writer.as_mut().map_or(Ok(0), |writer| writer.write(bytes))
    }

    fn flush(&mut self) -> io::Result<()> {
        self.writer.as_mut().map_or(Ok(()), Write::flush)
    }
}

trait PermissionsAsNewFile {
    fn permissions_as_new_file(&mut self) -> &mut Self;
}

impl PermissionsAsNewFile for tempfile::Builder<'_, '_> {
    /// Sets the permissions of a new file under the umask, because temporary files are private by default.
    fn permissions_as_new_file(&mut self) -> &mut Self {
        #[cfg(unix)]
        {
            use std::os::unix::fs::PermissionsExt;
            self.permissions(std::fs::Permissions::from_mode(0o666));
        }
        self
    }
}

/// The option of commands that draw their result.
#[derive(clap::Args)]
pub(crate) struct PlotArguments {
    /// Draw the result to this file: .svg, or .png (on white, with a font of this system)
    #[arg(long, value_name = "FILE")]
    plot: Option<PathBuf>,
}

/// The file of a picture, which is opened before the work starts.
pub(crate) struct PlotFile {
    output: OutputFile,
    path: PathBuf,
    is_png: bool,
}

impl PlotArguments {
    /// Opens the file of `--plot`. It must be none of the `others`: inputs and other outputs, each with its name for
    /// the message.
    pub(crate) fn open(&self, others: &[(&Path, &str)]) -> Result<Option<PlotFile>, Failure> {
        let Some(path) = &self.plot else {
            return Ok(None);
        };
        let ending = path.extension().unwrap_or_default();
        let is_png = ending.eq_ignore_ascii_case("png");
        if !is_png && !ending.eq_ignore_ascii_case("svg") {
            return Err(Failure::Input(format!(
                "--plot: found {}, expected a name that ends in .svg or .png",
                path.display()
            )));
        }
        // An output that does not exist yet has no canonical path, so compare absolute paths.
        let absolute = |path: &Path| std::path::absolute(path).ok();
        let same = (others.iter()).find(|(other, _)| absolute(other) == absolute(path));
        if let Some((_, option)) = same {
            return Err(Failure::in_file(
                path,
                format_args!("found it for --plot and for {option}, expected two files"),
            ));
        }
        Ok(Some(PlotFile {
            output: OutputFile::open_beside(path, others)?,
            path: path.clone(),
            is_png,
        }))
    }
}

impl PlotFile {
    /// Writes the picture `svg`, an SVG document, in the format of the file: SVG or PNG.
    pub(crate) fn write(self, svg: &str) -> Result<(), Failure> {
        if self.is_png {
            let mut fonts = Database::new();
            fonts.load_system_fonts();
            let bytes = png(svg, fonts).map_err(|what| {
                Failure::Work(format!("{}: {what}; write .svg instead", self.path.display()))
            })?;
            return self.output.write_whole(bytes);
        }
        self.output.write_whole(svg)
    }
}

/// Pixels per unit of a picture. With this number a picture is sharp on screens of high density and in print.
const SCALE: f32 = 2.0;
/// Maximum height of a picture, px. Viewers refuse larger pictures.
const MAX_HEIGHT: f32 = 30_000.0;

/// Fonts for the text of a picture, first choice first. Each has the signs µ, °, −, ± and arrows.
const FONTS: [&str; 7] =
    ["DejaVu Sans", "Noto Sans", "Liberation Sans", "Arial", "Helvetica", "Segoe UI", "Roboto"];

/// Renders a picture on white as PNG. No font is embedded, because every desktop system has fonts. Without fonts the
/// function fails, because `usvg` omits text without a font.
fn png(svg: &str, mut fonts: Database) -> Result<Vec<u8>, String> {
    let has = |name: &&str| {
        let mut families = fonts.faces().flat_map(|face| &face.families);
        families.any(|(family, _)| family == name)
    };
    let of_list = FONTS.into_iter().find(has).map(str::to_owned);
    let first = || {
        let face = fonts.faces().find(|face| !face.monospaced)?;
        Some(face.families.first()?.0.clone())
    };
    let family = of_list
        .or_else(first)
        .ok_or("this system has no font for the text of a PNG: install one, such as DejaVu Sans")?;
    fonts.set_sans_serif_family(&family);
    fonts.set_serif_family(&family);
    let options =
        Options { font_family: family, fontdb: std::sync::Arc::new(fonts), ..Options::default() };
    let tree = Tree::from_str(svg, &options).map_err(|error| format!("the picture: {error}"))?;
    let size = tree.size();
    if size.height() > MAX_HEIGHT {
        return Err("the picture is too high for PNG".to_owned());
    }
    let scale = SCALE.min(MAX_HEIGHT / size.height());
    let scaled = size.to_int_size().scale_by(scale);
    let scaled = scaled.ok_or("the picture has no size")?;
    let mut pixels = Pixmap::new(scaled.width(), scaled.height())
        .ok_or("there is not enough memory for the picture")?;
    resvg::render(&tree, Transform::from_scale(scale, scale), &mut pixels.as_mut());
    pixels.encode_png().map_err(|error| format!("PNG: {error}"))
}

pub(crate) fn bar(count: usize, what: &str) -> ProgressBar {
    let bar = ProgressBar::new(count as u64);
    let template = format!("{{bar:30}} {{pos}}/{{len}} {what} {{left}}");
    styled(bar, &template)
}

/// Runs an operation with a progress bar. The operation reports the number of finished steps and of all steps.
pub(crate) fn with_bar<T, E>(
    what: &str,
    work: impl FnOnce(&mut dyn FnMut(usize, usize)) -> Result<T, E>,
) -> Result<T, E> {
    let bar = bar(0, what);
    let done = work(&mut |done, of| {
        bar.set_length(of as u64);
        bar.set_position(done as u64);
    });
    bar.finish_and_clear();
    done
}

pub(crate) fn byte_bar(bytes: u64) -> ProgressBar {
    let bar = ProgressBar::new(bytes);
    styled(bar, "{bar:30} {bytes}/{total_bytes} {left}")
}

fn styled(bar: ProgressBar, template: &str) -> ProgressBar {
    let style = ProgressStyle::with_template(template);
    let style = style.unwrap_or_else(|_| ProgressStyle::default_bar());
    bar.with_style(style.with_key("left", |state: &ProgressState, out: &mut dyn fmt::Write| {
        // A failure to draw the bar cannot be reported.
        let _ = out.write_str(&left(state.pos(), state.eta()));
    }))
}

/// The remaining time as text; empty before the first step is finished.
fn left(done: u64, eta: Duration) -> String {
    match done {
        0 => String::new(),
        _ => format!("{:#} left", HumanDuration(eta)),
    }
}

/// The key of the first number that is NaN or infinite; `None` if all numbers are finite.
pub(crate) fn first_not_finite(document: &impl Serialize) -> Option<String> {
    // Unlike JSON, CBOR represents such numbers. A value that CBOR cannot represent is rejected later by JSON.
    below(&Value::serialized(document).ok()?)
}

/// The failure of a result with a number under `key` that is not finite.
pub(crate) fn not_finite(key: &str) -> Failure {
    Failure::Input(format!(
        "the result `{key}` is not a finite number: check the numbers in the input files, which are too large or do not determine it"
    ))
}

fn below(value: &Value) -> Option<String> {
    match value {
        Value::Float(number) => (!number.is_finite()).then(String::new),
        Value::Array(items) => {
            let mut items = items.iter().enumerate();
            items.find_map(|(index, item)| Some(joined(&format!("[{index}]"), &below(item)?)))
        }
        Value::Map(entries) => {
            let mut entries = entries.iter();
            entries.find_map(|(key, item)| Some(joined(key.as_text()?, &below(item)?)))
        }
        _ => None,
    }
}

fn joined(key: &str, rest: &str) -> String {
    let dot = if rest.is_empty() || rest.starts_with('[') { "" } else { "." };
    format!("{key}{dot}{rest}")
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use super::{first_not_finite, *};

    #[test]
    fn a_system_without_fonts_gets_an_error_and_no_picture_without_text() {
        let svg = "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"10\" height=\"10\"/>";
        let found = png(svg, Database::new()).expect_err("no font");
        assert!(found.contains("no font") && found.contains("install one"), "{found}");
    }

    #[derive(serde::Serialize)]
    #[serde(untagged)]
    enum Shape {
        Plain(f64),
        Named { value: Option<f64> },
    }

    #[derive(serde::Serialize)]
    struct Document {
        name: &'static str,
        shapes: Vec<Shape>,
        by_axis: BTreeMap<String, [f64; 2]>,
    }

    #[test]
    fn the_first_number_that_is_not_finite_is_named() {
        let document = |shape: f64, named: Option<f64>, axis: f64| Document {
            name: "NaN",
            shapes: vec![Shape::Plain(shape), Shape::Named { value: named }],
            by_axis: BTreeMap::from([("X".to_owned(), [0.0, axis])]),
        };
        let cases = [
            (document(1.0, None, 2.0), None),
            (document(f64::NAN, None, 2.0), Some("shapes[0]")),
            (document(1.0, Some(f64::INFINITY), 2.0), Some("shapes[1].value")),
            (document(1.0, Some(0.0), f64::NEG_INFINITY), Some("by_axis.X[1]")),
        ];
        for (document, key) in cases {
            assert_eq!(first_not_finite(&document).as_deref(), key);
        }
    }
}

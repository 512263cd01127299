//! Pictures of results, written as SVG or PNG.

use std::path::{Path, PathBuf};

use resvg::{
    tiny_skia::{Pixmap, Transform},
    usvg::{Options, Tree, fontdb::Database},
};

use crate::{failure::Failure, output::OutputFile};

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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_system_without_fonts_gets_an_error_and_no_picture_without_text() {
        let svg = "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"10\" height=\"10\"/>";
        let found = png(svg, Database::new()).expect_err("no font");
        assert!(found.contains("no font") && found.contains("install one"), "{found}");
    }
}

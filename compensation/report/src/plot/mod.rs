//! Plots as SVG: pure functions from data to text. Each returns one `<svg>` element, whose colours come from [`STYLE`], so that a page can
//! be light or dark.
//!
//! Values that are not finite are not drawn. Texts are escaped.

mod field;
mod plane;
mod svg;
mod xy;

use self::svg::{Anchor, without_variables};

pub use field::{Arrow, HeatMap, Quiver, heat_map, quiver};
pub use plane::{
    PathPlot, PathPoint, PolarPlot, PolarSeries, SquareSketch, path_plot, polar, square_sketch,
};
pub use svg::{
    MOST_POINTS, Mark, Scale, Svg, colour_at, colour_bar, colour_scale, colour_variables, escaped,
    finite, round_below, short, thinned, ticks,
};
pub use xy::{Band, Bars, Bracket, Look, Series, WIDTH, XyPlot, bars, xy};

/// CSS rules of the plots. Their colours are the variables of [`colour_variables`].
pub const STYLE: &str = include_str!("style.css");

/// Width of a picture, in its own units: px at its natural size.
const PAGE_WIDTH: f64 = 720.0;
const MARGIN: f64 = 20.0;
/// Distance between panels.
const GAP: f64 = 16.0;

/// CSS rules of the document itself. Media rules apply in browsers; other viewers ignore them and show the picture at its natural size.
const PAGE: &str = ".page{font-family:system-ui,\"Segoe UI\",Roboto,\"DejaVu Sans\",Arial,sans-serif}.page .paper{fill:var(--paper)}.page .title{font-size:17px;font-weight:700;fill:var(--ink)}.page .caption{font-size:13px;fill:var(--faint)}.page .panel{font-size:13px;font-weight:700;fill:var(--ink)}\n";
const SCREEN: &str = "@media all{.page{max-width:100%;height:auto;background:#fff}}@media (max-width:560px){.page .title{font-size:20px}.page .caption,.page .plot text,.page .plot .tick{font-size:16px}.page .panel{font-size:14px}.page .plot .letter{font-size:13px}}";

/// One plot of a picture, with a heading.
#[derive(Clone, Debug, PartialEq)]
pub struct Panel {
    /// Heading above the plot; may be empty.
    pub heading: String,
    /// `<svg>` element of the plot, from a function of this module.
    pub svg: String,
}

/// Creates a picture as an SVG document: title, lines of text, and rows of panels. The panels of a row share its width in proportion to their own
/// widths, and keep their heights.
pub fn picture(title: &str, lines: &[String], rows: &[Vec<Panel>]) -> String {
    let mut body = Svg::inner();
    let mut y = MARGIN;
    let full = PAGE_WIDTH - 2.0 * MARGIN;
    for line in folded(title, 62) {
        y += 21.0;
        body.text("title", [MARGIN, y - 6.0], Anchor::Start, line);
    }
    for line in lines.iter().flat_map(|line| folded(line, 84)) {
        y += 18.0;
        body.text("caption", [MARGIN, y - 4.0], Anchor::Start, line);
    }
    y += GAP;
    for row in rows {
        let sizes: Vec<[f64; 2]> = row.iter().map(|panel| size(&panel.svg)).collect();
        let across: f64 = sizes.iter().map(|size| size[0]).sum();
        let gaps = GAP * row.len().saturating_sub(1) as f64;
        // A row of narrow panels is hardly enlarged.
        let scale = ((full - gaps) / across.max(1.0)).min(1.04);
        let heads = row.iter().zip(&sizes).map(|(panel, [width, _])| {
            let lines = folded(&panel.heading, chars(width * scale));
            lines.collect::<Vec<_>>()
        });
        let heads: Vec<Vec<&str>> = heads.collect();
        y += 18.0 * heads.iter().map(Vec::len).max().unwrap_or(0) as f64;
        let (mut x, mut tallest) = (MARGIN, 0.0_f64);
        for ((panel, head), [width, height]) in row.iter().zip(heads).zip(sizes) {
            let [width, height] = [width * scale, height * scale];
            for (above, line) in head.iter().rev().enumerate() {
                let at = [x, y - 6.0 - 18.0 * above as f64];
                body.text("panel", at, Anchor::Start, line);
            }
            // A nested element has its own position and keeps its units.
            if let Some(rest) = panel.svg.strip_prefix("<svg") {
                body.put(format_args!(
                    "<svg x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"{rest}\n",
                    finite(x),
                    finite(y),
                    finite(width),
                    finite(height)
                ));
            }
            x += width + GAP;
            tallest = tallest.max(height);
        }
        y += tallest + GAP;
    }
    let height = finite(y + MARGIN - GAP);
    let style = format!("{PAGE}{STYLE}");
    let (light, dark) =
        (without_variables(&style, false), without_variables(&colours_of(&style), true));
    format!(
        "<svg xmlns=\"http://www.w3.org/2000/svg\" class=\"page\" viewBox=\"0 0 {PAGE_WIDTH} {height}\" width=\"{PAGE_WIDTH}\" height=\"{height}\">\n\
         <title>{}</title>\n<style>\n{light}{SCREEN}\n@media screen and (prefers-color-scheme:dark){{\n.page{{background:#171a1d}}\n{dark}}}\n</style>\n\
         <rect class=\"paper\" width=\"{PAGE_WIDTH}\" height=\"{height}\"/>\n{}</svg>\n",
        escaped(title),
        body.finish_inner()
    )
}

/// Lines of a style that set a colour.
fn colours_of(style: &str) -> String {
    let lines = style.lines().filter(|line| line.contains("var(--"));
    lines.flat_map(|line| [line, "\n"]).collect()
}

/// Maximum number of characters of a heading over a panel.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a width of at most some hundred px"
)]
fn chars(width: f64) -> usize {
    (width / 7.6).max(8.0) as usize
}

/// Width and height of a plot from its `viewBox`, which [`Svg::new`] wrote.
fn size(svg: &str) -> [f64; 2] {
    let inside = svg.split_once("viewBox=\"0 0 ").and_then(|(_, rest)| rest.split_once('"'));
    let mut numbers = inside
        .map_or("", |(inside, _)| inside)
        .split(' ')
        .map(|number| number.parse().unwrap_or(0.0));
    [0, 1].map(|_| numbers.next().unwrap_or(0.0))
}

/// Breaks a text into lines of at most `most` characters, at spaces if possible.
fn folded(text: &str, most: usize) -> impl Iterator<Item = &str> {
    let mut rest = text;
    std::iter::from_fn(move || {
        if rest.is_empty() {
            return None;
        }
        let Some((end, _)) = rest.char_indices().nth(most) else {
            return Some(std::mem::take(&mut rest));
        };
        let end = match rest[..end].rfind(' ') {
            Some(space) if space > 0 => space,
            _ => end,
        };
        let line;
        (line, rest) = rest.split_at(end);
        rest = rest.trim_start();
        Some(line)
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn texts_are_folded_at_spaces_and_never_lost() {
        let lines: Vec<&str> = folded("one two three", 8).collect();
        assert_eq!(lines, ["one two", "three"]);
        let long: Vec<&str> = folded("µµµµµ", 2).collect();
        assert_eq!(long, ["µµ", "µµ", "µ"]);
        assert_eq!(folded("", 5).count(), 0);
    }

    #[test]
    fn panels_are_placed_in_rows_and_keep_their_proportions() {
        let panel = |width: f64| Panel {
            heading: "<b>".to_owned(),
            svg: Svg::new("plot", (width, 100.0), "x", "").finish(),
        };
        let svg = picture("a < b", &[], &[vec![panel(332.0), panel(332.0)], vec![panel(100.0)]]);
        let place =
            |x: &str, y: &str| format!("<svg x=\"{x}\" y=\"{y}\" width=\"332\" height=\"100\"");
        assert!(svg.contains(&place("20", "75")), "{svg}");
        assert!(svg.contains(&place("368", "75")), "{svg}");
        assert!(svg.contains("width=\"104\" height=\"104\""), "{svg}");
        assert!(svg.contains("<title>a &lt; b</title>"));
        assert!(!svg.contains("var(") && !svg.contains("<b>"));
    }
}

//! Plots of values: over a coordinate (runs, curves, bands, limits and labelled brackets), and as bars.

use super::svg::{
    Anchor, MOST_POINTS, Mark, Scale, Svg, escaped, finite, outline, short, thinned, ticks,
};

/// Width of a plot that fills a page, in picture units.
pub const WIDTH: f64 = 680.0;
const LEFT: f64 = 58.0;
/// Width that each [`Bracket`] next to the plot takes, in picture units.
const SLOT: f64 = 44.0;
/// Width of an average legend character in picture units; the text is larger on narrow screens, where the picture is scaled down.
const SIGN: f64 = 8.6;
const ROW: f64 = 17.0;
/// Maximum number of points of a series up to which markers are drawn; more would overlap.
const MOST_MARKS: usize = 250;

/// Line style of a series. Forward and backward differ in colour, line (solid, dashed) and markers.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// A single run forward.
    RunForward,
    /// A single run backward.
    RunBackward,
    /// Mean readings or a curve forward.
    Forward,
    /// Mean readings or a curve backward.
    Backward,
    /// A curve for both directions, or the mean of both.
    Both,
    /// Mean ± 2 s of the forward runs.
    LimitForward,
    /// Mean ± 2 s of the backward runs.
    LimitBackward,
    /// The state before a compensation.
    Before,
    /// The state after a compensation.
    After,
    /// A limit of a tolerance.
    Tolerance,
}

impl Look {
    pub(super) fn class(self) -> &'static str {
        match self {
            Self::RunForward => "run f",
            Self::RunBackward => "run b",
            Self::Both => "mean m",
            Self::LimitForward => "limit f",
            Self::LimitBackward => "limit b",
            Self::Tolerance => "tolerance",
            Self::Backward | Self::Before => "mean b",
            Self::Forward | Self::After => "mean f",
        }
    }
}

/// Points of one curve.
#[derive(Clone, Debug, PartialEq)]
pub struct Series {
    /// Name of the series, shown with the value at the pointer.
    pub name: String,
    /// Coordinate and value of each point, coordinates ascending.
    pub points: Vec<(f64, f64)>,
    pub look: Look,
    /// The marker at each point.
    pub mark: Mark,
    /// Whether a line connects the points.
    pub line: bool,
}

/// An area between two curves.
#[derive(Clone, Debug, PartialEq)]
pub struct Band {
    /// Coordinates, ascending.
    pub x: Vec<f64>,
    /// The lower limit at each coordinate.
    pub low: Vec<f64>,
    /// The upper limit at each coordinate.
    pub high: Vec<f64>,
    /// Line style; [`Look::Backward`] is hatched.
    pub look: Look,
}

/// A span of values with a label, drawn next to the plot or at a coordinate within it.
#[derive(Clone, Debug, PartialEq)]
pub struct Bracket {
    /// Label: the symbol and its value.
    pub label: String,
    /// Values at both ends.
    pub span: [f64; 2],
    /// Coordinate at which the bracket is drawn; `None`: next to the plot.
    pub at: Option<f64>,
}

/// Series, bands and labelled spans over one coordinate.
#[derive(Clone, Debug, PartialEq)]
pub struct XyPlot {
    /// Text alternative for a screen reader.
    pub words: String,
    /// Label of the coordinate axis, with its unit.
    pub x_label: String,
    /// Whether the coordinate axis is labelled; false if another plot with the same coordinate follows below.
    pub x_named: bool,
    /// Label of the value axis, with its unit.
    pub y_label: String,
    /// Range that the coordinate axis covers at least; `None`: that of the points.
    pub x_range: Option<[f64; 2]>,
    /// Range that the value axis covers at least, so that several plots have the same scale; `None`: that of the points.
    pub y_range: Option<[f64; 2]>,
    /// Width of the picture, in its own units: at most [`WIDTH`].
    pub width: f64,
    /// Height of the plot area, in picture units.
    pub height: f64,
    /// Series, drawn in this order.
    pub series: Vec<Series>,
    /// Bands, drawn behind the series.
    pub bands: Vec<Band>,
    pub brackets: Vec<Bracket>,
    /// Line styles, markers and texts of the legend; empty for no legend.
    pub legend: Vec<(Look, Mark, String)>,
    /// Legend text of the bands; empty without bands.
    pub band_label: String,
}

impl XyPlot {
    fn coordinates(&self) -> impl Iterator<Item = f64> {
        let series = self.series.iter().flat_map(|s| &s.points).map(|p| p.0);
        let bands = self.bands.iter().flat_map(|b| b.x.iter().copied());
        series.chain(bands).chain(self.x_range.into_iter().flatten())
    }

    fn values(&self) -> impl Iterator<Item = f64> {
        let series = self.series.iter().flat_map(|s| &s.points).map(|p| p.1);
        let edges = self.bands.iter().flat_map(|b| b.low.iter().chain(&b.high));
        let spans = self.brackets.iter().flat_map(|b| b.span);
        let all = series.chain(edges.copied()).chain(spans);
        all.chain(self.y_range.into_iter().flatten())
    }

    /// Smallest and largest finite coordinate; infinite without any.
    pub(crate) fn coordinate_range(&self) -> [f64; 2] {
        range(self.coordinates())
    }

    /// Smallest and largest finite value; infinite without any.
    pub(crate) fn value_range(&self) -> [f64; 2] {
        range(self.values())
    }
}

fn range(values: impl Iterator<Item = f64>) -> [f64; 2] {
    let finite = values.filter(|value| value.is_finite());
    finite.fold([f64::INFINITY, f64::NEG_INFINITY], |[low, high], value| {
        [low.min(value), high.max(value)]
    })
}

/// Draws the plot as one `<svg>` element.
pub fn xy(plot: &XyPlot) -> String {
    let beside = plot.brackets.iter().filter(|b| b.at.is_none()).count();
    let whole = if plot.width.is_finite() { plot.width.clamp(240.0, 4000.0) } else { WIDTH };
    let right = whole - 14.0 - if beside > 0 { 10.0 + SLOT * beside as f64 } else { 0.0 };
    let (legend, rows) = legend_places(plot);
    let top = 10.0 + ROW * rows as f64 + 14.0;
    let bottom = top + plot.height;
    let x = Scale::over(plot.coordinates(), [LEFT, right], 0.0);
    let zero = with_zero(plot.value_range());
    let y = Scale::over(plot.values().chain(zero), [bottom, top], 0.06);
    let frame = format!(
        " data-x=\"{} {} {} {}\" data-y=\"{} {} {} {}\" data-l=\"{}\" data-m=\"{}\"",
        LEFT,
        finite(right),
        x.values[0],
        x.values[1],
        finite(bottom),
        finite(top),
        y.values[0],
        y.values[1],
        escaped(&plot.x_label),
        escaped(&plot.y_label)
    );
    let mut svg = Svg::new(
        "plot xy",
        (whole, bottom + if plot.x_named { 42.0 } else { 22.0 }),
        &plot.words,
        &frame,
    );
    axes(&mut svg, plot, (&x, &y));
    for band in &plot.bands {
        area(&mut svg, band, (&x, &y));
    }
    let most = (MOST_POINTS / plot.series.len().max(1)).max(40);
    for series in &plot.series {
        one(&mut svg, series, most, (&x, &y));
    }
    brackets(&mut svg, plot, (&x, &y));
    for (look, mark, text, [at, row]) in legend {
        sample(&mut svg, look, mark, &text, [at, row]);
    }
    svg.raw("<g class=\"at\"></g>");
    svg.finish()
}

/// Zero, if the value axis can include it and the values still take at least a quarter of its height.
fn with_zero([low, high]: [f64; 2]) -> Option<f64> {
    (low >= high || high - low >= 0.25 * (high.max(0.0) - low.min(0.0))).then_some(0.0)
}

/// A legend entry: its look (`None`: a band), text and position.
type Entry = (Option<Look>, Mark, String, [f64; 2]);

/// Positions of the legend entries, and the number of rows.
fn legend_places(plot: &XyPlot) -> (Vec<Entry>, usize) {
    let band = (!plot.bands.is_empty() && !plot.band_label.is_empty())
        .then(|| (None, Mark::None, plot.band_label.clone()));
    let entries = plot.legend.iter().map(|(look, mark, text)| (Some(*look), *mark, text.clone()));
    let mut placed = Vec::new();
    let (mut at, mut row) = (LEFT, 0_u32);
    for (look, mark, text) in entries.chain(band) {
        let width = 34.0 + SIGN * text.chars().count() as f64 + 8.0;
        if at > LEFT && at + width > plot.width {
            at = LEFT;
            row += 1;
        }
        placed.push((look, mark, text, [at, 14.0 + ROW * f64::from(row)]));
        at += width;
    }
    let rows = if placed.is_empty() { 0 } else { row as usize + 1 };
    (placed, rows)
}

fn sample(svg: &mut Svg, look: Option<Look>, mark: Mark, text: &str, [x, y]: [f64; 2]) {
    match look {
        Some(look) => {
            let class = look.class();
            svg.line(class, [x, y - 4.0], [x + 26.0, y - 4.0]);
            let mut path = String::new();
            outline(&mut path, mark, [x + 13.0, y - 4.0], 3.2);
            if !path.is_empty() {
                svg.put(format_args!("<path class=\"sign {class}\" d=\"{path}\"/>"));
            }
        }
        None => svg.polygon(
            "band f",
            [[x, y - 10.0], [x + 26.0, y - 10.0], [x + 26.0, y + 2.0], [x, y + 2.0]],
        ),
    }
    svg.text("key", [x + 32.0, y], Anchor::Start, text);
}

fn axes(svg: &mut Svg, plot: &XyPlot, (x, y): (&Scale, &Scale)) {
    let ([left, right], [bottom, top]) = (x.places, y.places);
    let (values, decimals) = ticks(y.values, if plot.height < 120.0 { 4 } else { 6 });
    for value in values {
        let at = y.at(value);
        let class = if value == 0.0 { "zero" } else { "grid" };
        svg.line(class, [left, at], [right, at]);
        svg.text("tick", [left - 7.0, at + 4.0], Anchor::End, &short(value, decimals));
    }
    let (values, decimals) = ticks(x.values, if plot.width < 400.0 { 4 } else { 8 });
    for value in values {
        let at = x.at(value);
        svg.line("grid", [at, top], [at, bottom]);
        svg.text("tick", [at, bottom + 16.0], Anchor::Middle, &short(value, decimals));
    }
    svg.line("frame", [left, top], [left, bottom]);
    svg.line("frame", [left, bottom], [right, bottom]);
    if plot.x_named {
        svg.text("name", [right, bottom + 33.0], Anchor::End, &plot.x_label);
    }
    svg.text("name", [6.0, top - 8.0], Anchor::Start, &plot.y_label);
}

fn area(svg: &mut Svg, band: &Band, (x, y): (&Scale, &Scale)) {
    let edge = |values: &[f64]| -> Vec<(f64, f64)> {
        band.x.iter().copied().zip(values.iter().copied()).collect()
    };
    let [low, high] = [&band.low, &band.high].map(|values| thinned(&edge(values), MOST_POINTS / 4));
    let place = |(at, value): (f64, f64)| [x.at(at), y.at(value)];
    let upper = high.into_iter().map(place);
    let lower = low.into_iter().rev().map(place);
    let class = if band.look == Look::Backward { "band b" } else { "band f" };
    svg.polygon(class, upper.chain(lower));
}

fn one(svg: &mut Svg, series: &Series, most: usize, (x, y): (&Scale, &Scale)) {
    let points = thinned(&series.points, most);
    if points.is_empty() {
        return;
    }
    let class = series.look.class();
    let places: Vec<[f64; 2]> =
        points.iter().map(|(at, value)| [x.at(*at), y.at(*value)]).collect();
    let shown = if series.line { class } else { "none" };
    svg.put(format_args!("<g class=\"s\" data-n=\"{}\">", escaped(&series.name)));
    svg.polyline(shown, places.iter().copied());
    if series.mark != Mark::None && places.len() <= MOST_MARKS {
        let size = match series.look {
            Look::RunForward | Look::RunBackward => 2.0,
            _ => 3.2,
        };
        let mut path = String::new();
        for place in &places {
            outline(&mut path, series.mark, *place, size);
        }
        svg.put(format_args!("<path class=\"sign {class}\" d=\"{path}\"/>"));
    }
    svg.raw("</g>");
}

fn brackets(svg: &mut Svg, plot: &XyPlot, (x, y): (&Scale, &Scale)) {
    let mut slot = 0.0;
    for bracket in &plot.brackets {
        let at = if let Some(at) = bracket.at {
            x.at(at)
        } else {
            slot += 1.0;
            x.places[1] + SLOT * (slot - 0.5)
        };
        let [low, high] = bracket.span.map(|value| y.at(value));
        svg.line("bracket", [at, low], [at, high]);
        for end in [low, high] {
            svg.line("bracket", [at - 4.0, end], [at + 4.0, end]);
            if bracket.at.is_none() {
                svg.line("lead", [x.places[1], end], [at - 4.0, end]);
            }
        }
        let (middle, from) = (0.5 * (low + high), y.places[1]);
        let place = match bracket.at {
            Some(_) if at < x.places[1] - 60.0 => ([at + 6.0, middle + 4.0], Anchor::Start),
            Some(_) => ([at - 6.0, middle + 4.0], Anchor::End),
            None => ([at, low.min(high).max(from) - 6.0], Anchor::Middle),
        };
        svg.text("letter", place.0, place.1, &bracket.label);
    }
}

const BARS_WIDTH: f64 = 340.0;
const BARS_LEFT: f64 = 64.0;
const TOP: f64 = 44.0;
const BARS_ROW: f64 = 16.0;

/// Horizontal bars, one below the other, each with a mark at a second value.
#[derive(Clone, Debug, PartialEq)]
pub struct Bars {
    /// Text alternative for a screen reader.
    pub words: String,
    /// Label of the value axis, with the unit.
    pub label: String,
    /// Legend of the bars and of the marks.
    pub legend: [String; 2],
    /// Name, value of the bar, value of the mark.
    pub rows: Vec<(String, f64, f64)>,
}

/// Draws bars from zero, at a common scale.
pub fn bars(bars: &Bars) -> String {
    let right = BARS_WIDTH - 14.0;
    let bottom = TOP + BARS_ROW * bars.rows.len() as f64;
    let values = bars.rows.iter().flat_map(|row| [row.1, row.2]);
    let x = Scale::over(values.chain([0.0]), [BARS_LEFT, right], 0.0);
    let frame =
        format!(" data-x=\"{} {} {} {}\"", x.places[0], x.places[1], x.values[0], x.values[1]);
    let mut svg = Svg::new("plot bars", (BARS_WIDTH, bottom + 42.0), &bars.words, &frame);
    let [of_bar, of_mark] = &bars.legend;
    svg.put(format_args!(
        "<rect class=\"bar\" x=\"{BARS_LEFT}\" y=\"8\" width=\"20\" height=\"10\"/>"
    ));
    svg.text("key", [BARS_LEFT + 26.0, 17.0], Anchor::Start, of_bar);
    svg.line("mean b", [BARS_LEFT + 146.0, 6.0], [BARS_LEFT + 146.0, 20.0]);
    svg.text("key", [BARS_LEFT + 154.0, 17.0], Anchor::Start, of_mark);
    let (values, decimals) = ticks(x.values, 5);
    for value in values {
        let at = x.at(value);
        let class = if value == 0.0 { "zero" } else { "grid" };
        svg.line(class, [at, TOP - 6.0], [at, bottom]);
        let text = short(value, decimals);
        svg.text("tick", [at, bottom + 15.0], Anchor::Middle, &text);
    }
    for (place, (name, value, mark)) in bars.rows.iter().enumerate() {
        let y = TOP + BARS_ROW * place as f64;
        svg.text("tick", [BARS_LEFT - 6.0, y + 11.0], Anchor::End, name);
        let [from, to] = [x.at(0.0), x.at(*value)].map(finite);
        if value.is_finite() {
            svg.put(format_args!(
                "<rect class=\"bar\" data-n=\"{}\" x=\"{}\" y=\"{}\" width=\"{}\" height=\"{}\"/>",
                escaped(name),
                from.min(to),
                finite(y + 2.0),
                finite((to - from).abs()),
                BARS_ROW - 5.0
            ));
        }
        if mark.is_finite() {
            let at = x.at(*mark);
            svg.line("mean b", [at, y + 1.0], [at, y + BARS_ROW - 2.0]);
        }
    }
    svg.text("name", [right, bottom + 32.0], Anchor::End, &bars.label);
    svg.finish()
}

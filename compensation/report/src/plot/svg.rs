//! Elements that the plots share: SVG text, colours, the scale of an axis, markers, and thinning of many points.

use std::fmt::Write as _;

/// One `<svg>` element under construction.
pub struct Svg {
    text: String,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Anchor {
    Start,
    Middle,
    End,
}

impl Svg {
    /// Creates an empty picture of this size, in its own units, with a text alternative for screen readers. `class` and `more` are attributes from
    /// this crate, never from a file.
    pub fn new(class: &str, (width, height): (f64, f64), words: &str, more: &str) -> Self {
        let (width, height) = (finite(width), finite(height));
        Self {
            text: format!(
                "<svg class=\"{class}\" viewBox=\"0 0 {width} {height}\" role=\"img\" aria-label=\"{}\"{more}>",
                escaped(words)
            ),
        }
    }

    /// Creates elements without an `<svg>` around them, for [`Svg::finish_inner`].
    pub(super) fn inner() -> Self {
        Self { text: String::new() }
    }

    pub(super) fn finish_inner(self) -> String {
        self.text
    }

    /// Adds markup, which must consist of finite numbers and escaped text.
    pub fn raw(&mut self, markup: &str) {
        self.text += markup;
    }

    /// Adds a straight line with this CSS class.
    pub fn line(&mut self, class: &str, [x1, y1]: [f64; 2], [x2, y2]: [f64; 2]) {
        if [x1, y1, x2, y2].iter().all(|x| x.is_finite()) {
            let [x1, y1, x2, y2] = [x1, y1, x2, y2].map(finite);
            self.put(format_args!("<path class=\"{class}\" d=\"M{x1} {y1}L{x2} {y2}\"/>"));
        }
    }

    /// Adds a line through these points.
    pub fn polyline(&mut self, class: &str, points: impl IntoIterator<Item = [f64; 2]>) {
        self.put(format_args!("<polyline class=\"{class}\" points=\""));
        self.coordinates(points);
        self.text += "\"/>";
    }

    /// Adds a closed polygon with these corners.
    pub fn polygon(&mut self, class: &str, points: impl IntoIterator<Item = [f64; 2]>) {
        self.put(format_args!("<polygon class=\"{class}\" points=\""));
        self.coordinates(points);
        self.text += "\"/>";
    }

    /// Adds a text, which is escaped.
    pub(crate) fn text(&mut self, class: &str, [x, y]: [f64; 2], anchor: Anchor, text: &str) {
        if x.is_finite() && y.is_finite() {
            let anchor = match anchor {
                Anchor::Start => "",
                Anchor::Middle => " text-anchor=\"middle\"",
                Anchor::End => " text-anchor=\"end\"",
            };
            let (x, y, text) = (finite(x), finite(y), escaped(text));
            self.put(format_args!(
                "<text class=\"{class}\" x=\"{x}\" y=\"{y}\"{anchor}>{text}</text>"
            ));
        }
    }

    /// Closes the element and returns its text.
    pub fn finish(mut self) -> String {
        self.text += "</svg>";
        self.text
    }

    pub(crate) fn put(&mut self, what: core::fmt::Arguments<'_>) {
        let _ = self.text.write_fmt(what);
    }

    fn coordinates(&mut self, points: impl IntoIterator<Item = [f64; 2]>) {
        let mut first = true;
        for [x, y] in points {
            if x.is_finite() && y.is_finite() {
                let space = if first { "" } else { " " };
                self.put(format_args!("{space}{},{}", finite(x), finite(y)));
                first = false;
            }
        }
    }
}

/// Rounds a number to hundredths, never to −0; 0 if it is not finite.
pub fn finite(x: f64) -> f64 {
    let hundredths = (x * 100.0).round() / 100.0;
    if hundredths.is_finite() { hundredths + 0.0 } else { 0.0 }
}

/// Escapes a text for HTML and quoted attributes. Control characters that are invalid in documents are replaced.
pub fn escaped(text: &str) -> String {
    let mut safe = String::with_capacity(text.len());
    for sign in text.chars() {
        match sign {
            '&' => safe += "&amp;",
            '<' => safe += "&lt;",
            '>' => safe += "&gt;",
            '"' => safe += "&quot;",
            '\'' => safe += "&#39;",
            '\n' | '\t' => safe.push(sign),
            sign if sign.is_control() => safe.push('\u{fffd}'),
            sign => safe.push(sign),
        }
    }
    safe
}

/// Colours of the plots: name of the variable, colour on white, colour on dark. Blue and orange stay distinct with every colour-vision deficiency.
const COLOURS: [[&str; 3]; 7] = [
    ["paper", "#fff", "#171a1d"],
    ["ink", "#16191c", "#e7eaed"],
    ["faint", "#5c656d", "#a3acb4"],
    ["grid", "#dfe3e7", "#2d3339"],
    ["forward", "#0067a8", "#64b5f0"],
    ["backward", "#b84a00", "#f39a55"],
    ["mark", "#6a2c91", "#cfa2f2"],
];

/// CSS declarations of the plot colours as variables: `--paper`, `--ink`, `--faint`, `--grid`, `--forward`, `--backward`, `--mark`.
pub fn colour_variables() -> String {
    let set = |theme: usize| -> String {
        let one = |colour: &[&str; 3]| format!("--{}:{};", colour[0], colour[theme]);
        COLOURS.iter().map(one).collect()
    };
    format!(
        ":root{{{}}}\n@media screen and (prefers-color-scheme:dark){{:root{{{}}}}}\n",
        set(1),
        set(2)
    )
}

/// Replaces the variables of a style by the colours on white, or on dark: most viewers of SVG files do not support CSS variables.
pub(super) fn without_variables(style: &str, dark: bool) -> String {
    COLOURS.iter().fold(style.to_owned(), |style, colour| {
        let name = format!("var(--{})", colour[0]);
        style.replace(&name, colour[1 + usize::from(dark)])
    })
}

/// Equidistant support colours: red, green, blue, 0 to 255, of a scale from dark blue to yellow with increasing lightness, for readers with
/// colour-vision deficiency and for grey printing: those of the published colour map `cividis` (Nuñez, Anderton, Renslow 2018), rounded.
const SUPPORTS: [[f64; 3]; 9] = [
    [0.0, 34.0, 78.0],
    [18.0, 53.0, 112.0],
    [59.0, 73.0, 108.0],
    [87.0, 93.0, 109.0],
    [112.0, 113.0, 115.0],
    [138.0, 134.0, 120.0],
    [165.0, 156.0, 116.0],
    [201.0, 185.0, 92.0],
    [254.0, 232.0, 56.0],
];

/// The colour of a value from 0 to 1, as `#rrggbb`; grey for NaN.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a place among the supports, and a channel between two of them"
)]
pub fn colour_at(share: f64) -> String {
    if share.is_nan() {
        return "#808080".to_owned();
    }
    let at = share.clamp(0.0, 1.0) * (SUPPORTS.len() - 1) as f64;
    // Index from 0 to 7, because the last support is the end of the last interval.
    let part = (at.floor() as usize).min(SUPPORTS.len() - 2);
    let within = at - part as f64;
    let channel = |index: usize| {
        let [from, to] = [SUPPORTS[part][index], SUPPORTS[part + 1][index]];
        (from + (to - from) * within).round() as u8
    };
    format!("#{:02x}{:02x}{:02x}", channel(0), channel(1), channel(2))
}

/// Strips of a legend: the value (0 to 1) at the lower end of each, and its colour.
pub fn colour_scale(strips: usize) -> impl Iterator<Item = (f64, String)> {
    let count = strips.max(1) as f64;
    (0..strips).map(move |strip| {
        let share = strip as f64 / count;
        (finite(share * 1e4) / 1e4, colour_at((strip as f64 + 0.5) / count))
    })
}

/// Draws the colour scale from 0 to `most`, with its `label` above.
pub fn colour_bar(label: &str, most: f64) -> String {
    let (left, width) = (4.0, 400.0);
    let mut svg = Svg::new("plot", (420.0, 54.0), label, "");
    let strips = 60;
    for (share, colour) in colour_scale(strips) {
        svg.put(format_args!(
            "<rect x=\"{}\" y=\"18\" width=\"{}\" height=\"14\" fill=\"{colour}\"/>",
            finite(left + share * width),
            finite(width / strips as f64 + 0.5)
        ));
    }
    svg.text("name", [left, 12.0], Anchor::Start, label);
    let most = if most > 0.0 { most } else { 1.0 };
    let (values, decimals) = ticks([0.0, most], 6);
    for value in values {
        let x = left + value / most * width;
        svg.line("frame", [x, 32.0], [x, 36.0]);
        let text = short(value, decimals);
        svg.text("tick", [x, 49.0], Anchor::Middle, &text);
    }
    svg.finish()
}

/// A linear scale from values to picture positions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Scale {
    /// The values at both ends.
    pub values: [f64; 2],
    /// The positions of both ends.
    pub places: [f64; 2],
}

impl Scale {
    /// Creates a scale over all finite `values`, extended at both ends by `margin` (relative to their range). An empty range is widened.
    pub fn over(values: impl IntoIterator<Item = f64>, places: [f64; 2], margin: f64) -> Self {
        /// Maximum magnitude of a drawn value: far beyond measured values, and small enough to subtract without overflow.
        const MOST: f64 = 1e12;
        let finite = values.into_iter().filter(|x| x.abs() <= MOST);
        let (low, high) = finite
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), x| (low.min(x), high.max(x)));
        let (low, high) = if low <= high { (low, high) } else { (0.0, 1.0) };
        let least = 1e-6 * low.abs().max(high.abs()).max(1e-3);
        let range = high - low;
        let (low, high) = if range < least {
            let half = 0.5 * low.abs().max(1.0);
            (low - half, high + half)
        } else {
            (low - margin * range, high + margin * range)
        };
        Self { values: [low, high], places }
    }

    /// The position of a value.
    pub fn at(&self, value: f64) -> f64 {
        let ([low, high], [from, to]) = (self.values, self.places);
        from + (value - low) / (high - low) * (to - from)
    }
}

/// About `count` round values in a range, and the number of decimals with which to format them.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "a few decimals, never below 0"
)]
pub fn ticks([low, high]: [f64; 2], count: usize) -> (Vec<f64>, usize) {
    let range = high - low;
    if !(range > 0.0 && range.is_finite()) || count == 0 {
        return (Vec::new(), 0);
    }
    let rough = range / count as f64;
    let power = 10.0_f64.powf(rough.log10().floor());
    let factor = [1.0, 2.0, 2.5, 5.0, 10.0]
        .into_iter()
        .find(|factor| factor * power >= rough * (1.0 - 1e-9))
        .unwrap_or(10.0);
    let step = factor * power;
    let mut decimals = (-step.log10()).ceil().max(0.0) as usize;
    if factor == 2.5 && step < 10.0 {
        decimals = (-power.log10()).ceil().max(0.0) as usize + 1;
    }
    let first = (low / step - 1e-9).ceil();
    let all = (0..=4 * count).map(|index| (first + index as f64) * step);
    let values = all.take_while(|value| *value <= high + 1e-9 * range);
    (values.map(|value| value + 0.0).collect(), decimals.min(9))
}

/// Formats a number for a label with `decimals` decimals, a true minus sign, and no −0.
pub fn short(value: f64, decimals: usize) -> String {
    if !value.is_finite() {
        return "–".to_owned();
    }
    let text = format!("{value:.decimals$}");
    let is_zero = text.chars().all(|sign| matches!(sign, '-' | '0' | '.'));
    match text.strip_prefix('-') {
        Some(rest) if is_zero => rest.to_owned(),
        Some(rest) => format!("−{rest}"),
        None => text,
    }
}

/// Rounds down to 1, 2 or 5 times a power of ten; 1 for a value that is not positive.
pub fn round_below(value: f64) -> f64 {
    let power = 10.0_f64.powf(value.log10().floor());
    if !(power > 0.0 && power.is_finite()) {
        return 1.0;
    }
    let rounds = [5.0, 2.0, 1.0].map(|f| f * power);
    rounds.into_iter().find(|round| *round <= value).unwrap_or(power)
}

/// The marker at each point of a series.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Mark {
    None,
    /// A filled dot.
    Dot,
    /// A triangle that points up: forward.
    Up,
    /// A triangle that points down: backward.
    Down,
    /// A diagonal cross.
    Cross,
}

pub(crate) fn outline(path: &mut String, mark: Mark, [x, y]: [f64; 2], size: f64) {
    use std::fmt::Write as _;
    if !(x.is_finite() && y.is_finite()) {
        return;
    }
    let r = finite(size);
    let f = finite;
    let _ = match mark {
        Mark::None => Ok(()),
        Mark::Dot => write!(
            path,
            "M{} {}a{r} {r} 0 1 0 {} 0a{r} {r} 0 1 0 {} 0",
            f(x - r),
            f(y),
            2.0 * r,
            -2.0 * r
        ),
        Mark::Up => write!(
            path,
            "M{} {}l{} {}h{}z",
            f(x),
            f(y - 1.15 * r),
            f(1.1 * r),
            f(1.9 * r),
            f(-2.2 * r)
        ),
        Mark::Down => write!(
            path,
            "M{} {}l{} {}h{}z",
            f(x),
            f(y + 1.15 * r),
            f(1.1 * r),
            f(-1.9 * r),
            f(-2.2 * r)
        ),
        Mark::Cross => write!(
            path,
            "M{} {}l{} {}m{} 0l{} {}",
            f(x - r),
            f(y - r),
            2.0 * r,
            2.0 * r,
            -2.0 * r,
            2.0 * r,
            -2.0 * r
        ),
    };
}

/// Maximum number of drawn points of one plot.
pub const MOST_POINTS: usize = 6000;

/// Reduces points in ascending x to about `most`. The range is divided into equal parts, of which the first, smallest, largest and last value are
/// kept, so that peaks remain. Points that are not finite are removed.
#[expect(
    clippy::cast_possible_truncation,
    clippy::cast_sign_loss,
    reason = "held between 0 and the number of parts"
)]
pub fn thinned(points: &[(f64, f64)], most: usize) -> Vec<(f64, f64)> {
    let is_finite = |(x, y): &&(f64, f64)| x.is_finite() && y.is_finite();
    let finite: Vec<(f64, f64)> = points.iter().filter(is_finite).copied().collect();
    if finite.len() <= most.max(8) {
        return finite;
    }
    let parts = (most / 4).max(2);
    let (low, high) =
        finite.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), (x, _)| {
            (low.min(*x), high.max(*x))
        });
    let width = (high - low) / parts as f64;
    let part_of = |x: f64| {
        if width > 0.0 && width.is_finite() {
            // Between 0 and `parts` for any x.
            (((x - low) / width).clamp(0.0, parts as f64 - 1.0)) as usize
        } else {
            0
        }
    };
    let mut kept = Vec::new();
    for part in finite.chunk_by(|a, b| part_of(a.0) == part_of(b.0)) {
        let by_value = |a: &usize, b: &usize| part[*a].1.total_cmp(&part[*b].1);
        let mut places = vec![0, part.len() - 1];
        places.extend((0..part.len()).min_by(by_value));
        places.extend((0..part.len()).max_by(by_value));
        places.sort_unstable();
        places.dedup();
        kept.extend(places.into_iter().map(|place| part[place]));
    }
    kept
}

/// Drops points of a path that are not finite, and points that are nearer than `least` to the previous kept point.
/// Finite points that begin a line, and a finite last point, are kept.
pub(super) fn spaced(
    points: &[([f64; 2], bool)],
    least: f64,
) -> impl Iterator<Item = ([f64; 2], bool)> {
    let mut before: Option<[f64; 2]> = None;
    let last = points.len().saturating_sub(1);
    let kept = points.iter().enumerate().filter(move |(place, (at, begins))| {
        if !(at[0].is_finite() && at[1].is_finite()) {
            return false;
        }
        let near = before.is_some_and(|from| (at[0] - from[0]).hypot(at[1] - from[1]) < least);
        let keeps = !near || *begins || *place == last;
        if keeps {
            before = Some(*at);
        }
        keeps
    });
    kept.map(|(_, point)| *point)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Relative luminance of WCAG 2.
    fn luminance(colour: &str) -> f64 {
        let channel = |at: usize| {
            let value = u8::from_str_radix(&colour[at..at + 2], 16).expect("hexadecimal");
            let part = f64::from(value) / 255.0;
            if part <= 0.04045 { part / 12.92 } else { ((part + 0.055) / 1.055).powf(2.4) }
        };
        0.2126 * channel(1) + 0.7152 * channel(3) + 0.0722 * channel(5)
    }

    #[test]
    fn it_grows_ever_lighter() {
        let all: Vec<f64> = (0..=50).map(|i| luminance(&colour_at(f64::from(i) / 50.0))).collect();
        assert!(all.windows(2).all(|pair| pair[1] > pair[0]), "{all:?}");
        assert_eq!(colour_at(f64::NAN), "#808080");
        assert_eq!(colour_at(-3.0), colour_at(0.0));
        assert_eq!(colour_at(f64::INFINITY), colour_at(1.0));
    }

    #[test]
    fn round_numbers_are_below() {
        assert_eq!([7.0, 23.0, 0.4].map(round_below), [5.0, 20.0, 0.2]);
        assert_eq!([0.0, -3.0, f64::NAN].map(round_below), [1.0; 3]);
    }

    #[test]
    fn ticks_are_round_and_within() {
        assert_eq!(ticks([0.0, 1000.0], 5), (vec![0.0, 200.0, 400.0, 600.0, 800.0, 1000.0], 0));
        let (values, decimals) = ticks([-0.31, 0.42], 4);
        assert_eq!(decimals, 1);
        assert_eq!(values.len(), 4);
        assert!(values.iter().all(|v| (-0.31..=0.42).contains(v)));
        assert_eq!(ticks([0.0, 1.0], 4).1, 2);
        for wrong in [[1.0, 1.0], [2.0, 1.0], [f64::NAN, 1.0], [0.0, f64::INFINITY]] {
            assert!(ticks(wrong, 5).0.is_empty());
        }
    }

    #[test]
    fn a_number_has_a_minus_sign_and_no_negative_zero() {
        assert_eq!(short(-0.001, 2), "0.00");
        assert_eq!(short(-1.5, 1), "−1.5");
        assert_eq!(short(f64::NAN, 1), "–");
    }

    #[test]
    fn points_at_one_place_and_few_points_are_no_trouble() {
        let same = vec![(5.0, 1.0); 100];
        assert!(!thinned(&same, 10).is_empty());
        assert_eq!(thinned(&[(1.0, 2.0)], 100), [(1.0, 2.0)]);
        assert!(thinned(&[], 100).is_empty());
    }
}

//! Writes one SVG element from finite numbers and escaped text only.

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

//! Colour scale from dark blue to yellow with increasing lightness, for readers with colour-vision deficiency and for grey printing. Its
//! support colours are those of the published colour map `cividis` (Nuñez, Anderton, Renslow 2018), rounded.

use super::{
    scale::{short, ticks},
    svg::{Anchor, Svg, finite},
};

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

/// Equidistant support colours: red, green, blue, 0 to 255.
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
}

//! Maps of the volumetric error.

use volcomp_vocabulary::AxisName;

use super::diagonals::in_pairs;
use crate::{
    plot::{HeatMap, Panel, colour_bar, heat_map, picture, short},
    report::{Slice, Vector, Volume},
};

/// Length of the longest arrow of a map, in picture units: about the distance from its position to the frame.
const LONGEST: f64 = 32.0;

/// Maps of both states, with a common colour scale and a common scale of the arrows.
pub(crate) struct Maps {
    /// Maps before compensation, or of the only state.
    pub(crate) before: Vec<HeatMap>,
    /// Maps after compensation; empty if there is no such state.
    pub(crate) after: Vec<HeatMap>,
    /// Error shown by the last colour, µm.
    pub(crate) most_um: f64,
}

pub(crate) fn maps(volume: &Volume) -> Maps {
    let all = volume.slices.iter().flat_map(|slice| {
        let after = slice.after_um.iter().flatten();
        slice.before_um.iter().chain(after)
    });
    let most_um = all.copied().filter(|um| um.is_finite()).fold(0.0, f64::max);
    let arrows = |after: bool| {
        let of = |slice| arrows(slice, after);
        volume.slices.iter().map(of).collect::<Vec<_>>()
    };
    let arrows = [arrows(false), arrows(true)];
    let lengths = arrows.iter().flatten().flatten();
    let longest = lengths.map(|(_, [u, v])| u.hypot(*v));
    let longest = longest.filter(|um| um.is_finite()).fold(0.0, f64::max);
    let arrow_scale = if longest > 0.0 { LONGEST / longest } else { 0.0 };
    let map = |slice: &Slice, word: &str, values: &[f64], arrows: &[([f64; 2], [f64; 2])]| {
        let held = match &slice.held {
            Some(held) => format!(", {} = {} mm", held.axis, short(held.at, 0)),
            None if is_rotary(&slice.across) => ", X, Y, Z in the middle".to_owned(),
            None => String::new(),
        };
        let title = format!("{}{}{held}", slice.across, slice.up);
        HeatMap {
            words: format!("plane {title} {word}"),
            title: format!("{title}{}{word}", if word.is_empty() { "" } else { ", " }),
            x_label: label(&slice.across),
            y_label: label(&slice.up),
            x: slice.x.clone(),
            y: slice.y.clone(),
            values: values.to_vec(),
            most: most_um,
            unit: "µm".to_owned(),
            arrows: arrows.to_vec(),
            arrow_scale,
        }
    };
    let word = if volume.after.is_some() { "before" } else { "" };
    let [arrows_before, arrows_after] = arrows;
    let slices = || volume.slices.iter();
    let before = slices()
        .zip(&arrows_before)
        .map(|(slice, arrows)| map(slice, word, &slice.before_um, arrows));
    let after = slices()
        .zip(&arrows_after)
        .filter_map(|(slice, arrows)| Some(map(slice, "after", slice.after_um.as_ref()?, arrows)));
    Maps { before: before.collect(), after: after.collect(), most_um }
}

fn is_rotary(axis: &str) -> bool {
    axis.parse().is_ok_and(AxisName::is_rotary)
}

fn label(axis: &str) -> String {
    format!("{axis}, {}", if is_rotary(axis) { "deg" } else { "mm" })
}

/// Positions and error vectors of a plane, projected onto it.
fn arrows(slice: &Slice, after: bool) -> Vec<([f64; 2], [f64; 2])> {
    let index = |axis: &str| axis.parse().map_or(0, AxisName::mcs_index);
    let (across, up) = (index(&slice.across), index(&slice.up));
    let arrow = |vector: &Vector| {
        let error = if after { vector.after_um? } else { vector.before_um };
        let in_plane = |of: [f64; 3]| [of[across], of[up]];
        Some((in_plane(vector.at_mm), in_plane(error)))
    };
    slice.vectors.iter().filter_map(arrow).collect()
}

/// Draws the volumetric error: maps over planes with the error vectors in them, a map over two rotary axes, and one colour scale.
pub fn map_picture(title: &str, lines: &[String], volume: &Volume) -> String {
    let maps = maps(volume);
    let panel = |map: &HeatMap| Panel { heading: String::new(), svg: heat_map(map) };
    let panels: Vec<Panel> = maps.before.iter().chain(&maps.after).map(panel).collect();
    let mut rows = in_pairs(&panels);
    rows.push(vec![Panel { heading: String::new(), svg: colour_bar(COLOURS, maps.most_um) }]);
    picture(title, lines, &rows)
}

/// Label of the colour scale of the maps.
pub(crate) const COLOURS: &str = "length of the error, µm";

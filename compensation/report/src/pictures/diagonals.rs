//! Pictures of body and face diagonals.

use volcomp_metrology::{Iso230Part6, JudgedQuantity};
use volcomp_vocabulary::Direction;

use super::{
    curve::{direction_word, look},
    figures, span,
};
use crate::{
    plot::{Look, Mark, Panel, Series, XyPlot, picture, short, xy},
    report::{Diagonal, Diagonals},
};

/// Panels of the diagonals, all with the same scale.
pub(crate) fn diagonal_plots(of: &Diagonals) -> Vec<Panel> {
    let after_of = |name: &str| -> Option<&Diagonal> {
        let after = of.after.as_ref()?;
        after.found.iter().find(|diagonal| diagonal.name == name)
    };
    let plots = of.before.found.iter().map(|diagonal| {
        let (mut series, mut legend) = (Vec::new(), Vec::new());
        let mut add = |of: &Diagonal, word: &str, look, mark| {
            series.push(Series {
                name: format!("{} {word}", of.name).trim_end().to_owned(),
                points: of.points.clone(),
                look,
                mark,
                line: true,
            });
            legend.push((look, mark, word.to_owned()));
        };
        if let Some(after) = after_of(&diagonal.name) {
            add(diagonal, "before", Look::Before, Mark::Down);
            add(after, "after", Look::After, Mark::Dot);
        } else {
            add(diagonal, "", Look::Forward, Mark::Dot);
            legend.clear();
        }
        (diagonal.name.clone(), plot(&diagonal.name, series, legend))
    });
    with_one_scale(plots.collect())
}

/// Draws the diagonals of a machine.
pub fn diagonals_picture(title: &str, lines: &[String], of: &Diagonals) -> String {
    let mut panels = diagonal_plots(of);
    for (panel, diagonal) in panels.iter_mut().zip(&of.before.found) {
        panel.heading = format!("{}: range {} µm", diagonal.name, short(diagonal.range_um, 2));
    }
    picture(title, lines, &in_pairs(&panels))
}

/// Draws measured diagonals, with their judged quantities.
pub fn measured_diagonals_picture(of: &Iso230Part6, quantities: &[JudgedQuantity]) -> String {
    let plots = of.diagonals.iter().map(|measured| {
        let mut series = Vec::new();
        let mut legend = Vec::new();
        let from = measured.result.targets.first().map_or(0.0, |row| row.target);
        for direction in Direction::BOTH {
            let points = measured.result.targets.iter().filter_map(|row| {
                let approach = match direction {
                    Direction::Positive => row.forward,
                    Direction::Negative => row.backward,
                };
                Some((row.target - from, approach?.mean))
            });
            let points: Vec<(f64, f64)> = points.collect();
            if points.is_empty() {
                continue;
            }
            let (of, mark) = look(Some(direction));
            let word = direction_word(Some(direction));
            legend.push((of, mark, format!("mean, {word}")));
            series.push(Series {
                name: format!("mean, {word}"),
                points,
                look: of,
                mark,
                line: true,
            });
        }
        let name = measured.diagonal.name();
        let heading = format!("{name}: {}", measured.file);
        (heading, plot(name, series, legend))
    });
    let panels = with_one_scale(plots.collect());
    let title = "Measured diagonals, test to ISO 230-6";
    picture(title, &figures(quantities), &in_pairs(&panels))
}

fn plot(name: &str, series: Vec<Series>, legend: Vec<(Look, Mark, String)>) -> XyPlot {
    XyPlot {
        words: format!("diagonal {name}"),
        x_label: "place along the diagonal, mm".to_owned(),
        x_named: true,
        y_label: "deviation, µm".to_owned(),
        x_range: None,
        y_range: None,
        width: 340.0,
        height: 170.0,
        series,
        bands: Vec::new(),
        brackets: Vec::new(),
        legend,
        band_label: String::new(),
    }
}

fn with_one_scale(mut plots: Vec<(String, XyPlot)>) -> Vec<Panel> {
    let range = span(plots.iter().flat_map(|(_, plot)| plot.value_range()));
    for (_, plot) in &mut plots {
        plot.y_range = range;
    }
    let panel = |(heading, plot): (String, XyPlot)| Panel { heading, svg: xy(&plot) };
    plots.into_iter().map(panel).collect()
}

pub(super) fn in_pairs(panels: &[Panel]) -> Vec<Vec<Panel>> {
    panels.chunks(2).map(<[Panel]>::to_vec).collect()
}

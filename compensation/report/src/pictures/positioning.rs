//! The picture of positioning tests to ISO 230-2.

use volcomp_metrology::{Approach, Edition, Iso230Part2, JudgedQuantity, Measurement, TargetRow};
use volcomp_vocabulary::{AxisKind, Direction};

use super::{
    curve::{direction_word, look, run_series},
    figures, span, tolerance_lines,
};
use crate::{
    curves::runs_of,
    described::described,
    plot::{Bracket, Look, Mark, Panel, Series, WIDTH, XyPlot, picture, short, xy},
    report::Positioning,
};

impl Positioning {
    /// Evaluates the test of one file, without VDI/DGQ 3441 and uncertainties. `error` is the ISO 230 name of the
    /// error, empty if unknown.
    pub fn of_measurement(
        file: String,
        error: String,
        kind: AxisKind,
        unit: String,
        measurement: &Measurement,
        result: Iso230Part2,
        edition: Edition,
    ) -> Self {
        Self {
            file,
            error,
            x_unit: kind.coordinate_unit().to_owned(),
            unit,
            runs: runs_of(measurement, |_, _, reading| Some(reading)),
            edition: edition.year(),
            result,
            vdi: None,
            uncertainties: Vec::new(),
        }
    }
}

/// Draws one or several tests with their judged quantities, one plot below the other. Plots of the same unit have the same scale.
pub fn positioning_picture(tests: &[(Positioning, Vec<JudgedQuantity>)]) -> String {
    let mut plots: Vec<(XyPlot, &Positioning)> = tests
        .iter()
        .map(|(test, quantities)| {
            let mut plot = positioning_plot(test);
            for symbol in ["A", "E", "M"] {
                if let Some(limit) = limit_of(quantities, symbol)
                    && let Some(span) = spans(&test.result)
                        .into_iter()
                        .find_map(|(of, _, span)| (of == symbol).then_some(span).flatten())
                {
                    tolerance_lines(&mut plot, symbol, &test.unit, span, limit);
                    break;
                }
            }
            (plot, test)
        })
        .collect();
    let ranges: Vec<([f64; 2], &str)> =
        plots.iter().map(|(plot, test)| (plot.value_range(), test.unit.as_str())).collect();
    for (plot, test) in &mut plots {
        let alike = ranges.iter().filter(|(_, unit)| *unit == test.unit);
        plot.y_range = span(alike.flat_map(|(range, _)| *range));
    }
    let title = match tests {
        [(test, _)] => title(test),
        _ => format!("Positioning tests to ISO 230-2, {} files", tests.len()),
    };
    let lines = match tests {
        [(test, quantities)] => [vec![test.file.clone()], figures(quantities)].concat(),
        _ => Vec::new(),
    };
    let rows: Vec<Vec<Panel>> = plots
        .iter()
        .map(|(plot, test)| {
            let heading = if plots.len() > 1 { test.file.clone() } else { String::new() };
            let svg = xy(plot);
            vec![Panel { heading, svg }]
        })
        .collect();
    picture(&title, &lines, &rows)
}

fn title(test: &Positioning) -> String {
    let what = described(&test.error);
    let what = if what.is_empty() {
        "positioning deviation".to_owned()
    } else {
        format!("{}: {what}", test.error)
    };
    let mut letters = what.chars();
    let first = letters.next().map(|letter| letter.to_ascii_uppercase());
    let what: String = first.into_iter().chain(letters).collect();
    format!("{what}, test to ISO 230-2:{}", test.edition)
}

fn limit_of(quantities: &[JudgedQuantity], symbol: &str) -> Option<f64> {
    let mut all = quantities.iter();
    all.find(|of| of.symbol == symbol && of.limit.is_some())?.limit
}

fn of(row: &TargetRow, direction: Direction) -> Option<&Approach> {
    match direction {
        Direction::Positive => row.forward.as_ref(),
        Direction::Negative => row.backward.as_ref(),
    }
}

/// Plot of runs, means, mean ± 2 s, and the quantities of the standard at the values that determine them.
pub(crate) fn positioning_plot(test: &Positioning) -> XyPlot {
    let mut series = run_series(&test.runs, true);
    let mut legend = Vec::new();
    for direction in Direction::BOTH {
        let (mean_look, mark) = look(Some(direction));
        let (run_look, limit) = match direction {
            Direction::Positive => (Look::RunForward, Look::LimitForward),
            Direction::Negative => (Look::RunBackward, Look::LimitBackward),
        };
        let word = direction_word(Some(direction));
        let with = |value: &dyn Fn(&Approach) -> Option<f64>| -> Vec<(f64, f64)> {
            let rows = test.result.targets.iter();
            rows.filter_map(|row| Some((row.target, value(of(row, direction)?)?))).collect()
        };
        let means = with(&|of| Some(of.mean));
        if means.is_empty() {
            continue;
        }
        if test.runs.iter().any(|run| run.direction == direction) {
            legend.push((run_look, Mark::None, format!("runs, {word}")));
        }
        series.push(Series {
            name: format!("mean, {word}"),
            points: means,
            look: mean_look,
            mark,
            line: true,
        });
        legend.push((mean_look, mark, format!("mean, {word}")));
        for (sign, name) in [(2.0, "+ 2 s"), (-2.0, "− 2 s")] {
            let points = with(&|of| Some(of.mean + sign * of.s?));
            if points.is_empty() {
                continue;
            }
            if sign > 0.0 {
                legend.push((limit, Mark::None, format!("mean ± 2 s, {word}")));
            }
            series.push(Series {
                name: format!("mean {name}, {word}"),
                points,
                look: limit,
                mark: Mark::None,
                line: true,
            });
        }
    }
    XyPlot {
        words: format!("Positioning tests (ISO 230-2): {}", test.error),
        x_label: format!("target, {}", test.x_unit),
        x_named: true,
        y_label: format!("deviation, {}", test.unit),
        x_range: None,
        y_range: None,
        width: WIDTH,
        height: 250.0,
        series,
        bands: Vec::new(),
        brackets: brackets(&test.result),
        legend,
        band_label: String::new(),
    }
}

/// Symbol and value of a quantity, and the range of readings whose width is the value.
type Span = (&'static str, Option<f64>, Option<[f64; 2]>);

/// Spans of the quantities A, E and M.
fn spans(result: &Iso230Part2) -> [Span; 3] {
    let rows = &result.targets;
    let approaches = || rows.iter().flat_map(|row| [row.forward, row.backward]).flatten();
    let limits = approaches().filter_map(|of| Some([of.mean - 2.0 * of.s?, of.mean + 2.0 * of.s?]));
    [
        ("A", result.a, span(limits.flatten())),
        ("E", result.e, span(approaches().map(|of| of.mean))),
        ("M", result.m, span(rows.iter().filter_map(|row| row.mean))),
    ]
}

/// Brackets for A, E and M next to the plot, and for R and B at their targets.
fn brackets(result: &Iso230Part2) -> Vec<Bracket> {
    let rows = &result.targets;
    let [a, e, m] = spans(result).map(|(letter, value, span)| {
        Some(Bracket { label: format!("{letter} {}", short(value?, 1)), span: span?, at: None })
    });
    let most = |value: fn(&TargetRow) -> Option<f64>| {
        let with = rows.iter().filter_map(|row| Some((row, value(row)?)));
        with.max_by(|a, b| a.1.total_cmp(&b.1)).map(|found| found.0)
    };
    let r = most(|row| row.repeatability).and_then(|row| {
        let both = [row.forward?, row.backward?];
        let limits =
            both.iter().filter_map(|of| Some([of.mean - 2.0 * of.s?, of.mean + 2.0 * of.s?]));
        Some(Bracket {
            label: format!("R {}", short(row.repeatability?, 1)),
            span: span(limits.flatten())?,
            at: Some(row.target),
        })
    });
    let b = most(|row| row.reversal.map(f64::abs)).and_then(|row| {
        Some(Bracket {
            // As in the figures, B is the absolute value of the largest reversal value.
            label: format!("B {}", short(row.reversal?.abs(), 1)),
            span: [row.forward?.mean, row.backward?.mean],
            at: Some(row.target),
        })
    });
    [a, e, m, r, b].into_iter().flatten().collect()
}

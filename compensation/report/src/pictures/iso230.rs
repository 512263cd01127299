//! Pictures of tests to ISO 230: positioning, straightness and squareness, circles, diagonals.

use volcomp_metrology::{
    Approach, Edition, Iso230Part2, Iso230Part6, JudgedQuantity, Measurement, ReferenceLine,
    TargetRow,
    circular::{CircularPlane, CircularTrace, Sense},
};
use volcomp_vocabulary::{AxisKind, Direction};

use super::{
    curve::{direction_word, look, run_series},
    figures, span, tolerance_lines,
};
use crate::{
    curves::{described, runs_of},
    plot::{
        Bracket, Look, Mark, Panel, PolarPlot, Series, WIDTH, XyPlot, picture, polar, short,
        square_sketch, xy,
    },
    report::{Diagonal, Diagonals, Positioning},
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

/// A straightness profile relative to its reference line.
#[derive(Clone, Debug)]
pub struct StraightnessPlot {
    pub file: String,
    /// Symbol of the quantity that belongs to the reference line.
    pub reference: &'static str,
    /// Targets, mm, and deviations from the reference line, µm.
    pub profile: Vec<(f64, f64)>,
    /// Straightness by each reference line.
    pub quantities: Vec<JudgedQuantity>,
}

/// Draws one or several profiles at the same scale; the zero line is the reference line.
pub fn straightness_picture(profiles: &[StraightnessPlot]) -> String {
    let mut plots: Vec<XyPlot> = profiles.iter().map(profile_plot).collect();
    let range = span(plots.iter().flat_map(XyPlot::value_range));
    for plot in &mut plots {
        plot.y_range = range;
    }
    let about = profiles.first().map_or("", |profile| profile.reference);
    let title = format!("Straightness about the {} line", about.replace('-', " "));
    let lines = match profiles {
        [only] => [vec![only.file.clone()], figures(&only.quantities)].concat(),
        _ => Vec::new(),
    };
    let rows: Vec<Vec<Panel>> = profiles
        .iter()
        .zip(&plots)
        .map(|(profile, plot)| {
            let heading = if profiles.len() > 1 { profile.file.clone() } else { String::new() };
            let svg = xy(plot);
            vec![Panel { heading, svg }]
        })
        .collect();
    picture(&title, &lines, &rows)
}

fn profile_plot(of: &StraightnessPlot) -> XyPlot {
    let quantity = of.quantities.iter().find(|q| q.symbol == of.reference);
    let value = quantity.and_then(|q| q.value);
    let height = span(of.profile.iter().map(|point| point.1));
    let bracket =
        value.zip(height).map(|(value, span)| Bracket { label: short(value, 2), span, at: None });
    let mut plot = XyPlot {
        words: format!("straightness: {}", of.file),
        x_label: "target, mm".to_owned(),
        x_named: true,
        y_label: "deviation from the line, µm".to_owned(),
        x_range: None,
        y_range: None,
        width: WIDTH,
        height: 250.0,
        series: vec![Series {
            name: "mean".to_owned(),
            points: of.profile.clone(),
            look: Look::Both,
            mark: Mark::Dot,
            line: true,
        }],
        bands: Vec::new(),
        brackets: bracket.into_iter().collect(),
        legend: vec![(Look::Both, Mark::Dot, "mean of all runs".to_owned())],
        band_label: String::new(),
    };
    let limit = quantity.and_then(|q| q.limit);
    if let (Some(limit), Some(span)) = (limit, height) {
        tolerance_lines(&mut plot, of.reference, "µm", span, limit);
    }
    plot
}

/// One of the two straightness lines of a squareness.
#[derive(Clone, Debug)]
pub struct SlopePlot {
    /// Name of the straightness error, such as `EXY`.
    pub error: String,
    pub file: String,
    /// Targets, mm, and mean deviations, µm.
    pub profile: Vec<(f64, f64)>,
    /// Line whose slope enters the squareness.
    pub line: ReferenceLine,
}

/// Data of the picture of a squareness.
#[derive(Clone, Debug)]
pub struct SquarenessPlot {
    /// Name of the squareness error, such as `EC0Y`.
    pub error: String,
    /// Axis from which, and axis to which the angle is counted.
    pub axes: [String; 2],
    /// Angle between the axes minus 90°, µrad.
    pub angle_urad: f64,
    /// Straightness lines whose slopes give the angle, one for each axis.
    pub lines: [SlopePlot; 2],
    /// Squareness with its tolerance.
    pub quantities: Vec<JudgedQuantity>,
}

/// Draws a squareness: both profiles with their lines at the same scale, and the angle.
pub fn squareness_picture(of: &SquarenessPlot) -> String {
    let mut plots = of.lines.each_ref().map(slope_plot);
    let range = span(plots.iter().flat_map(XyPlot::value_range));
    for plot in &mut plots {
        plot.y_range = range;
    }
    let panels = of.lines.iter().zip(&plots).map(|(line, plot)| Panel {
        heading: format!("{}: slope {} µrad", line.error, short(line.line.slope().0, 2)),
        svg: xy(plot),
    });
    let exaggeration = super::exaggeration([of.angle_urad]);
    let sketch = Panel {
        heading: String::new(),
        svg: square_sketch(&super::sketch(&of.axes, of.angle_urad, exaggeration)),
    };
    let files = of.lines.iter().map(|line| format!("{}: {}", line.error, line.file));
    let lines = [files.collect(), figures(&of.quantities)].concat();
    let title = format!("Squareness {} of {} and {}", of.error, of.axes[0], of.axes[1]);
    picture(&title, &lines, &[panels.collect(), vec![sketch]])
}

/// Profile minus the value of its line at mid travel, which depends on the set-up of the optics and is no error.
fn slope_plot(of: &SlopePlot) -> XyPlot {
    let line = |at: f64| of.line.intercept_um + of.line.slope_um_per_mm * at;
    let ends = of.profile.first().zip(of.profile.last());
    let ends = ends.map_or([0.0; 2], |(first, last)| [first.0, last.0]);
    let middle = line(f64::midpoint(ends[0], ends[1]));
    let series = |name: &str, points: Vec<(f64, f64)>, look, mark| Series {
        name: name.to_owned(),
        points: points.into_iter().map(|(at, x)| (at, x - middle)).collect(),
        look,
        mark,
        line: true,
    };
    XyPlot {
        words: format!("{}: {}", of.error, of.file),
        x_label: "target, mm".to_owned(),
        x_named: true,
        y_label: "deviation, µm".to_owned(),
        x_range: None,
        y_range: None,
        width: 340.0,
        height: 190.0,
        series: vec![
            series("mean", of.profile.clone(), Look::Both, Mark::Dot),
            series("line", ends.map(|at| (at, line(at))).to_vec(), Look::Backward, Mark::None),
        ],
        bands: Vec::new(),
        brackets: Vec::new(),
        legend: vec![
            (Look::Both, Mark::Dot, "mean".to_owned()),
            (Look::Backward, Mark::None, "its line".to_owned()),
        ],
        band_label: String::new(),
    }
}

/// Data of the picture of a circular test.
pub struct CirclePlot {
    pub file: String,
    pub plane: CircularPlane,
    /// Measured points of the circle.
    pub trace: CircularTrace,
    /// Least-squares centre of all points along the two axes, µm, which the picture subtracts.
    pub centre_um: [f64; 2],
    /// Results by ISO 230-4.
    pub quantities: Vec<JudgedQuantity>,
}

/// Draws one or several circular tests.
pub fn circles_picture(tests: &[CirclePlot]) -> String {
    let title = match tests {
        [one] => format!(
            "Circular test to ISO 230-4, plane {}{}, radius {} mm",
            one.plane.axes()[0],
            one.plane.axes()[1],
            short(one.trace.radius_mm, 3)
        ),
        _ => format!("Circular tests to ISO 230-4, {} files", tests.len()),
    };
    let lines = match tests {
        [one] => [vec![one.file.clone()], figures(&one.quantities)].concat(),
        _ => Vec::new(),
    };
    let rows: Vec<Vec<Panel>> = tests
        .iter()
        .map(|of| {
            vec![Panel {
                heading: if tests.len() > 1 { of.file.clone() } else { String::new() },
                svg: polar(&circle_plot(of)),
            }]
        })
        .collect();
    picture(&title, &lines, &rows)
}

/// Radial deviations about the centre of all points, whose range is G(b).
fn circle_plot(of: &CirclePlot) -> PolarPlot {
    let [x, y] = of.centre_um;
    let series = Sense::BOTH.into_iter().filter_map(|sense| {
        let points = of.trace.points.iter().filter(|point| point.sense == sense);
        let points: Vec<(f64, f64)> = points
            .map(|point| {
                let (sin, cos) = point.angle_rad.sin_cos();
                (point.angle_rad, point.deviation_um - x * cos - y * sin)
            })
            .collect();
        let (name, look) = match sense {
            Sense::CounterClockwise => ("counter-clockwise", Look::Forward),
            Sense::Clockwise => ("clockwise", Look::Backward),
        };
        (!points.is_empty()).then(|| (name.to_owned(), look, points))
    });
    PolarPlot {
        words: format!("circular test: {}", of.file),
        axes: of.plane.axes().map(|axis| axis.to_string()),
        unit: "µm".to_owned(),
        series: series.collect(),
    }
}

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
        (diagonal.name.clone(), diagonal_plot(&diagonal.name, series, legend))
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
        (heading, diagonal_plot(name, series, legend))
    });
    let panels = with_one_scale(plots.collect());
    let title = "Measured diagonals, test to ISO 230-6";
    picture(title, &figures(quantities), &in_pairs(&panels))
}

fn diagonal_plot(name: &str, series: Vec<Series>, legend: Vec<(Look, Mark, String)>) -> XyPlot {
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

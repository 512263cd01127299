//! Pictures of error curves, of the residuals of an identification, and of the effects of errors.
//!
//! The picture of a curve has its readings and band, with the residuals below.

use volcomp_fit::BandSource;
use volcomp_identify::FileResiduals;
use volcomp_metrology::Measurement;
use volcomp_vocabulary::Direction;

use super::span;
use crate::{
    curves::{described, runs_of},
    plot::{self, Bars, Look, Mark, Panel, Series, WIDTH, XyPlot, bars, picture, xy},
    report::{Band, Branch, Curve, CurveLine},
};

const POINTS: usize = 241;

impl Curve {
    /// Creates the curve through the mean readings of one file. `value` is the curve at any coordinate, `band` its half widths at some coordinates. The
    /// error has no name; the axis is that stated in the file.
    pub fn of_fit(
        file: String,
        x_unit: String,
        unit: String,
        measurement: &Measurement,
        value: impl Fn(f64) -> f64,
        band: Option<(BandSource, Vec<[f64; 2]>)>,
    ) -> Self {
        let means = measurement.mean_curve();
        let ends = means.first().zip(means.last());
        let [low, high] = ends.map_or([0.0; 2], |(first, last)| [first.0, last.0]);
        let at = |index: usize| low + (high - low) * index as f64 / (POINTS - 1) as f64;
        let points: Vec<(f64, f64)> = (0..POINTS).map(|i| (at(i), value(at(i)))).collect();
        let residuals = means.iter().map(|(at, mean)| (*at, mean - value(*at)));
        let band = band.map(|(source, halves)| {
            let edge = |sign: f64| {
                let edge = halves.iter().map(|[x, half]| value(*x) + sign * half);
                edge.collect()
            };
            Band {
                x: halves.iter().map(|of| of[0]).collect(),
                low: edge(-1.0),
                high: edge(1.0),
                source,
            }
        });
        let values = points.iter().map(|point| point.1);
        let [smallest, largest] =
            values.fold([f64::INFINITY, f64::NEG_INFINITY], |[a, b], x| [a.min(x), b.max(x)]);
        Self {
            error: String::new(),
            axis: measurement.metadata.axis.clone().unwrap_or_default(),
            x_unit,
            unit,
            travel: [low, high],
            lines: vec![CurveLine {
                file: Some(file),
                runs: runs_of(measurement, |_, _, reading| Some(reading)),
                means: Direction::BOTH.map(|direction| measurement.mean_curve_in(direction)),
            }],
            range: [smallest, largest],
            has_other_axes: false,
            branches: vec![Branch {
                direction: None,
                residuals: residuals.collect(),
                points,
                band,
                fit: None,
            }],
        }
    }
}

/// Draws a curve with its readings and band, and the residuals below.
pub fn curve_picture(title: &str, lines: &[String], curve: &Curve) -> String {
    let panel = |plot: XyPlot, height: f64, heading: &str| {
        vec![Panel {
            heading: heading.to_owned(),
            svg: xy(&XyPlot { height, x_named: true, ..plot }),
        }]
    };
    let rows = [
        panel(curve_plot(curve), 250.0, ""),
        panel(residual_plot(curve), 110.0, "Mean reading minus curve"),
    ];
    picture(title, lines, &rows)
}

pub(crate) fn direction_word(direction: Option<Direction>) -> &'static str {
    match direction {
        Some(Direction::Positive) => "forward",
        Some(Direction::Negative) => "backward",
        None => "both",
    }
}

pub(crate) fn look(direction: Option<Direction>) -> (Look, Mark) {
    match direction {
        Some(Direction::Positive) => (Look::Forward, Mark::Up),
        Some(Direction::Negative) => (Look::Backward, Mark::Down),
        None => (Look::Both, Mark::Dot),
    }
}

pub(crate) fn run_series(runs: &[crate::report::Run], line: bool) -> Vec<Series> {
    let series = runs.iter().map(|run| Series {
        name: format!("run {}, {}", run.number, direction_word(Some(run.direction))),
        points: run.points.clone(),
        look: match run.direction {
            Direction::Positive => Look::RunForward,
            Direction::Negative => Look::RunBackward,
        },
        mark: look(Some(run.direction)).1,
        line,
    });
    series.collect()
}

pub(crate) fn curve_plot(curve: &Curve) -> XyPlot {
    let mut series = Vec::new();
    for line in &curve.lines {
        series.extend(run_series(&line.runs, false));
    }
    // With a single run the reading is the mean.
    let has_runs = curve.lines.iter().any(|line| line.runs.len() > 2);
    for line in &curve.lines {
        for direction in Direction::BOTH {
            let means = &line.means[direction as usize];
            if means.is_empty() || (!has_runs && !line.runs.is_empty()) {
                continue;
            }
            let (of, mark) = look(Some(direction));
            series.push(Series {
                name: format!("mean, {}", direction_word(Some(direction))),
                points: means.clone(),
                look: of,
                mark,
                line: false,
            });
        }
    }
    let mut band_label = "";
    let mut bands = Vec::new();
    for branch in &curve.branches {
        let (of, _) = look(branch.direction);
        let words = match branch.direction {
            Some(direction) => format!("curve, {}", direction_word(Some(direction))),
            None => "curve".to_owned(),
        };
        series.push(Series {
            name: words.clone(),
            points: branch.points.clone(),
            look: of,
            mark: Mark::None,
            line: true,
        });
        if let Some(band) = &branch.band {
            band_label = match band.source {
                BandSource::Runs => "95 % of the curve",
                BandSource::Residuals => "95 % of the curve, from one run",
            };
            bands.push(plot::Band {
                x: band.x.clone(),
                low: band.low.clone(),
                high: band.high.clone(),
                look: of,
            });
        }
    }
    XyPlot {
        words: format!("{}: {}", name(curve), described(&curve.error)),
        x_label: coordinate(curve),
        // The residual plot below has the label of the coordinate.
        x_named: curve.branches.iter().all(|branch| branch.residuals.is_empty()),
        y_label: format!("{}, {}", name(curve), curve.unit),
        x_range: Some(curve.travel),
        y_range: None,
        width: WIDTH,
        height: 150.0,
        series,
        bands,
        brackets: Vec::new(),
        legend: legend(curve),
        band_label: band_label.to_owned(),
    }
}

fn name(curve: &Curve) -> &str {
    if curve.error.is_empty() { "deviation" } else { &curve.error }
}

fn coordinate(curve: &Curve) -> String {
    let axis = if curve.axis.is_empty() { "target" } else { &curve.axis };
    format!("{axis}, {}", curve.x_unit)
}

fn legend(curve: &Curve) -> Vec<(Look, Mark, String)> {
    let mut entries = Vec::new();
    for direction in Direction::BOTH {
        let (of, mark) = look(Some(direction));
        let word = direction_word(Some(direction));
        let mut lines = curve.lines.iter();
        let read = lines.any(|line| !line.means[direction as usize].is_empty());
        let mut branches = curve.branches.iter();
        let own = branches.any(|branch| branch.direction == Some(direction));
        let (mark, words) = match (read, own) {
            (true, true) => (mark, "readings, curve".to_owned()),
            (true, false) => (mark, "readings".to_owned()),
            (false, true) => (Mark::None, "curve".to_owned()),
            (false, false) => continue,
        };
        entries.push((of, mark, format!("{word}: {words}")));
    }
    if curve.branches.iter().any(|branch| branch.direction.is_none()) {
        entries.push((Look::Both, Mark::None, "curve".to_owned()));
    }
    entries
}

pub(crate) fn residual_plot(curve: &Curve) -> XyPlot {
    let branches = curve.branches.iter().filter(|branch| !branch.residuals.is_empty());
    let series = branches.map(|branch: &Branch| {
        let (of, mark) = look(branch.direction);
        Series {
            name: format!("residual, {}", direction_word(branch.direction)),
            points: branch.residuals.clone(),
            look: of,
            mark,
            line: branch.residuals.windows(2).all(|pair| pair[0].0 < pair[1].0),
        }
    });
    XyPlot {
        words: format!("{}: residuals: mean reading minus curve", name(curve)),
        x_label: coordinate(curve),
        x_named: true,
        y_label: format!("residual, {}", curve.unit),
        x_range: Some(curve.travel),
        y_range: None,
        width: WIDTH,
        height: 60.0,
        series: series.collect(),
        bands: Vec::new(),
        brackets: Vec::new(),
        legend: Vec::new(),
        band_label: String::new(),
    }
}

/// Draws the residuals of the rows of each file and their stated uncertainty, at the same scale.
pub fn residuals_picture(lines: &[String], files: &[FileResiduals]) -> String {
    let mut plots: Vec<XyPlot> = files.iter().map(residuals_plot).collect();
    let range = span(plots.iter().flat_map(XyPlot::value_range));
    for plot in &mut plots {
        plot.y_range = range;
    }
    let rows: Vec<Vec<Panel>> = files
        .iter()
        .zip(&plots)
        .map(|(of, residuals_plot)| {
            vec![Panel { heading: of.file.clone(), svg: xy(residuals_plot) }]
        })
        .collect();
    let title = "Residuals of the identification: distance of each row from the model";
    picture(title, lines, &rows)
}

fn residuals_plot(of: &FileResiduals) -> XyPlot {
    let column = |index: usize| -> Vec<(f64, f64)> {
        let rows = of.rows.iter().enumerate();
        rows.map(|(place, row)| (place as f64 + 1.0, row[index])).collect()
    };
    let series = |name: &str, index, look, mark, line| Series {
        name: name.to_owned(),
        points: column(index),
        look,
        mark,
        line,
    };
    let name = "stated standard uncertainty";
    XyPlot {
        words: format!("residuals: {}", of.file),
        x_label: "row of the file".to_owned(),
        x_named: true,
        y_label: "residual, µm".to_owned(),
        x_range: Some([0.0, 1.0]),
        y_range: None,
        width: WIDTH,
        height: 130.0,
        series: vec![
            series("residual", 0, Look::Forward, Mark::Dot, false),
            series(name, 1, Look::Tolerance, Mark::None, true),
        ],
        bands: Vec::new(),
        brackets: Vec::new(),
        legend: vec![
            (Look::Forward, Mark::Dot, "residual".to_owned()),
            (Look::Tolerance, Mark::None, name.to_owned()),
        ],
        band_label: String::new(),
    }
}

/// Draws the effect of each error on the position (µm) and on the orientation (µrad) of the tool. Each entry has the name of the error, the RMS
/// and the largest effect.
pub fn effects_picture(
    title: &str,
    lines: &[String],
    positions: Vec<(String, f64, f64)>,
    orientations: Vec<(String, f64, f64)>,
) -> String {
    let panel = |what: &str, unit: &str, rows| Panel {
        heading: what.to_owned(),
        svg: bars(&Bars {
            words: format!("effect on the {what}"),
            label: format!("{what}, {unit}"),
            legend: ["RMS".to_owned(), "largest".to_owned()],
            rows,
        }),
    };
    let panels =
        vec![panel("position", "µm", positions), panel("orientation", "µrad", orientations)];
    picture(title, lines, &[panels])
}

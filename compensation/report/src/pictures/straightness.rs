//! Pictures of straightness and squareness.

use volcomp_metrology::{JudgedQuantity, ReferenceLine};

use super::{figures, span, tolerance_lines};
use crate::plot::{
    Bracket, Look, Mark, Panel, Series, WIDTH, XyPlot, picture, short, square_sketch, xy,
};

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

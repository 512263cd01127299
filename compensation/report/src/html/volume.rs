//! Squareness, diagonals and the map of the working space.

use volcomp_vocabulary::AxisName;

use super::write::{Cell, Page};
use crate::{
    plot::{
        Arrow, HeatMap, Look, Mark, Quiver, Series, SquareSketch, Svg, XyPlot, colour_scale,
        escaped, heat_map, quiver, short, square_sketch, ticks, xy,
    },
    report::{Diagonal, Report, Slice, Standing, State, Volume},
};

/// Angle in the drawing of the largest squareness error, rad.
const DRAWN_RAD: f64 = 0.2;

pub(super) fn squareness(page: &mut Page, report: &Report) {
    if report.squareness.is_empty() {
        page.paragraph("lead", "No squareness is known.");
    } else {
        page.paragraph(
            "lead",
            "The angle of each pair of axes less 90°, drawn much larger than it is; dashed: 90°.",
        );
        let angles = report
            .squareness
            .iter()
            .map(|square| square.angle_urad.abs());
        let largest = angles.filter(|angle| angle.is_finite()).fold(0.0, f64::max);
        let exaggeration = if largest > 0.0 {
            round(DRAWN_RAD / (largest * 1e-6))
        } else {
            1.0
        };
        page.put("<div class=\"squares\">");
        for square in &report.squareness {
            let sketch = SquareSketch {
                words: format!(
                    "{} {}: {} µrad",
                    square.first,
                    square.second,
                    short(square.angle_urad, 1)
                ),
                first: square.first.clone(),
                second: square.second.clone(),
                angle_urad: square.angle_urad,
                exaggeration,
                label: format!(
                    "{}{}: 90° {} µrad",
                    square.first,
                    square.second,
                    signed(square.angle_urad)
                ),
            };
            page.put(&format!("<figure>{}</figure>", square_sketch(&sketch)));
        }
        page.put("</div>");
        let rows = report.squareness.iter().map(|square| {
            let from = square.from.iter();
            let from: Vec<String> = from
                .map(|tilt| format!("{} = {}", tilt.error, short(tilt.urad, 2)))
                .collect();
            vec![
                Cell::text(format!("{}{}", square.first, square.second)),
                Cell::number(square.angle_urad, 2),
                Cell::text(from.join(", ")),
                Cell::text(if square.measured {
                    "this calibration"
                } else {
                    "the machine file"
                }),
            ]
        });
        page.table(&["pair", ">angle − 90°, µrad", "from", "known from"], rows);
    }
    if !report.locations.is_empty() {
        page.heading(4, "Other location errors", "");
        let columns = ["error", ">value", ">standard uncertainty", ""];
        let rows = report.locations.iter().map(|location| {
            vec![
                Cell::text(&location.error),
                Cell::number(location.value, 2),
                Cell::Number(location.uncertainty, 2),
                Cell::text(&location.unit),
            ]
        });
        page.table(&columns, rows);
    }
}

/// Rounds down to 1, 2 or 5 times a power of ten.
fn round(value: f64) -> f64 {
    let power = 10.0_f64.powf(value.log10().floor());
    [5.0, 2.0, 1.0]
        .into_iter()
        .map(|f| f * power)
        .find(|round| *round <= value)
        .unwrap_or(1.0)
}

fn signed(value: f64) -> String {
    let sign = if value < 0.0 { "−" } else { "+" };
    format!("{sign} {}", short(value.abs(), 1))
}

fn state_words(state: State, has_before: bool) -> &'static str {
    match state {
        State::Found if has_before => "the errors that were found",
        State::Found => "the errors that were found, without compensation",
        State::GivenBefore => "the errors of the machine file that was stated as the state before",
        State::Truth => {
            "the errors of the machine file that was stated as the truth, without compensation"
        }
        State::TruthCorrected => "what the compensation by this model leaves of the stated truth",
    }
}

fn states(page: &mut Page, before: State, after: Option<State>) {
    let line = |name: &str, words: &str| format!("<b>{}</b>: {}", escaped(name), escaped(words));
    let mut all = Vec::new();
    if let Some(after) = after {
        all.push(line("before", state_words(before, false)));
        all.push(line("after", state_words(after, true)));
    } else {
        all.push(escaped(state_words(before, false)) + ".");
        all.push("What a compensation leaves is not shown: the model against itself would prove nothing. It needs a truth or a second measurement.".to_owned());
    }
    page.put(&format!("<p class=\"lead\">{}</p>", all.join("<br>")));
}

pub(super) fn diagonals(page: &mut Page, report: &Report) {
    let Some(found) = &report.diagonals else {
        page.paragraph("lead", "Not computed: they need the axes X, Y and Z.");
        return;
    };
    page.paragraph("lead", "Computed from the model: the deviation along each diagonal of the travels, zero at its first target.");
    if let Some(volume) = &report.volume {
        standing(page, volume);
    }
    states(
        page,
        found.before.state,
        found.after.as_ref().map(|after| after.state),
    );
    let after_of = |name: &str| -> Option<&Diagonal> {
        let after = found.after.as_ref()?;
        after.found.iter().find(|diagonal| diagonal.name == name)
    };
    page.put("<div class=\"maps two\">");
    for diagonal in &found.before.found {
        let mut series = vec![Series {
            name: format!("{}, before", diagonal.name),
            points: diagonal.points.clone(),
            look: Look::Before,
            mark: Mark::Down,
            line: true,
        }];
        let mut legend = vec![(Look::Before, Mark::Down, "before".to_owned())];
        if let Some(after) = after_of(&diagonal.name) {
            series.push(Series {
                name: format!("{}, after", diagonal.name),
                points: after.points.clone(),
                look: Look::After,
                mark: Mark::Dot,
                line: true,
            });
            legend.push((Look::After, Mark::Dot, "after".to_owned()));
        } else {
            legend.clear();
        }
        let plot = XyPlot {
            words: format!("diagonal {}", diagonal.name),
            x_label: "place along the diagonal, mm".to_owned(),
            x_named: true,
            y_label: "deviation, µm".to_owned(),
            x_range: None,
            width: 340.0,
            height: 170.0,
            series,
            bands: Vec::new(),
            brackets: Vec::new(),
            legend,
            band_label: String::new(),
        };
        page.figure(&xy(&plot), &diagonal.name);
    }
    page.put("</div>");
    let columns: &[&str] = if found.after.is_some() {
        &["diagonal", ">range before, µm", ">range after, µm"]
    } else {
        &["diagonal", ">range, µm"]
    };
    let rows = found.before.found.iter().map(|diagonal| {
        let mut row = vec![
            Cell::text(&diagonal.name),
            Cell::number(diagonal.range_um, 2),
        ];
        if found.after.is_some() {
            row.push(Cell::Number(
                after_of(&diagonal.name).map(|of| of.range_um),
                2,
            ));
        }
        row
    });
    page.table(columns, rows);
}

pub(super) fn volume(page: &mut Page, report: &Report) {
    let Some(volume) = &report.volume else {
        page.paragraph("lead", "A map needs two of the axes X, Y and Z.");
        return;
    };
    page.paragraph("lead", "Length of the error of the tool tip after best-fit rigid-body alignment of the workpiece, on planes through the middle of the working space. One colour scale for all maps.");
    states(
        page,
        volume.before.state,
        volume.after.as_ref().map(|after| after.state),
    );
    let columns = [
        "state",
        ">largest, µm",
        "at",
        ">rms, µm",
        ">largest tilt of the tool axis, µrad",
        ">before alignment: largest, µm",
        ">rms, µm",
    ];
    let mut states = vec![("before", &volume.before.found)];
    states.extend(volume.after.iter().map(|after| ("after", &after.found)));
    if volume.after.is_none() {
        states[0].0 = "uncompensated";
    }
    let rows = states.into_iter().map(|(name, size)| {
        vec![
            Cell::Fixed(name.to_owned()),
            Cell::number(size.form_max_um, 2),
            Cell::Fixed(size.place()),
            Cell::number(size.form_rms_um, 2),
            Cell::number(size.tilt_urad, 2),
            Cell::number(size.max_um, 2),
            Cell::number(size.rms_um, 2),
        ]
    });
    page.table(&columns, rows);
    page.paragraph(
        "note",
        &format!("{} poses over the travels of all axes. The workpiece is aligned once for all poses and tools (best-fit rigid body: three shifts and three small rotations by least squares): where it lies is a convention and no error of the machine. Largest values are searched from the worst poses. The last two columns are before alignment.", volume.poses),
    );
    standing(page, volume);
    maps(page, volume);
    vectors(page, volume);
}

/// Lists the axes that do not move, and the errors that the maps therefore omit.
fn standing(page: &mut Page, volume: &Volume) {
    if volume.standing.is_empty() {
        return;
    }
    let at = volume.standing.iter();
    let at: Vec<String> = at
        .map(|Standing { axis, at }| {
            let rotary = axis.parse().is_ok_and(AxisName::is_rotary);
            let unit = if rotary { "°" } else { " mm" };
            format!("{axis} {}{unit}", short(*at, 3))
        })
        .collect();
    page.paragraph(
        "note",
        &format!("Axes that do not move in the pictures: {}. The table and the verdict cover poses of all axes; the pictures show this one.", at.join(", ")),
    );
}

/// All slices before, then all after compensation, with a common colour scale.
fn maps(page: &mut Page, volume: &Volume) {
    let all = volume.slices.iter().flat_map(|slice| {
        slice
            .before_um
            .iter()
            .chain(slice.after_um.iter().flatten())
    });
    let most = all.copied().filter(|um| um.is_finite()).fold(0.0, f64::max);
    let class = match volume.slices.len() {
        1 => "maps one",
        2 => "maps two",
        _ => "maps",
    };
    let mut row = |word: &str, values: &dyn Fn(&Slice) -> Option<Vec<f64>>| {
        page.put(&format!("<div class=\"{class}\">"));
        for slice in &volume.slices {
            let Some(values) = values(slice) else {
                continue;
            };
            let held = slice
                .held
                .as_ref()
                .map(|held| format!(", {} = {} mm", held.axis, short(held.at, 0)));
            let title = format!("{}{}{}", slice.across, slice.up, held.unwrap_or_default());
            let map = HeatMap {
                words: format!("plane {title} {word}"),
                title: format!("{title}{}{word}", if word.is_empty() { "" } else { ", " }),
                x_label: format!("{}, mm", slice.across),
                y_label: format!("{}, mm", slice.up),
                x: slice.x.clone(),
                y: slice.y.clone(),
                values,
                most,
                unit: "µm".to_owned(),
            };
            page.put(&heat_map(&map));
        }
        page.put("</div>");
    };
    let before = if volume.after.is_some() { "before" } else { "" };
    row(before, &|slice| Some(slice.before_um.clone()));
    if volume.after.is_some() {
        row("after", &|slice| slice.after_um.clone());
    }
    page.put(&format!("<div class=\"colours\">{}</div>", colours(most)));
}

fn colours(most: f64) -> String {
    let (left, width) = (4.0, 400.0);
    let mut svg = Svg::new("plot", (420.0, 54.0), "length of the error, µm", "");
    let strips = 60;
    for (share, colour) in colour_scale(strips) {
        svg.raw(&format!(
            "<rect x=\"{}\" y=\"18\" width=\"{}\" height=\"14\" fill=\"{colour}\"/>",
            crate::plot::finite(left + share * width),
            crate::plot::finite(width / strips as f64 + 0.5)
        ));
    }
    svg.raw(&format!(
        "<text class=\"name\" x=\"{left}\" y=\"12\">length of the error, µm</text>"
    ));
    let most = if most > 0.0 { most } else { 1.0 };
    let (values, decimals) = ticks([0.0, most], 6);
    for value in values {
        let x = crate::plot::finite(left + value / most * width);
        svg.line("frame", [x, 32.0], [x, 36.0]);
        svg.raw(&format!(
            "<text class=\"tick\" x=\"{x}\" y=\"49\" text-anchor=\"middle\">{}</text>",
            escaped(&short(value, decimals))
        ));
    }
    svg.finish()
}

fn vectors(page: &mut Page, volume: &Volume) {
    let arrows = volume.vectors.iter().flat_map(|vector| {
        let arrow = |error_um, after| Arrow {
            at_mm: vector.at_mm,
            error_um,
            after,
        };
        let after = vector.after_um.map(|error| arrow(error, true));
        core::iter::once(arrow(vector.before_um, false)).chain(after)
    });
    let picture = Quiver {
        words: "Error vectors".to_owned(),
        travels_mm: volume.travels_mm,
        arrows: arrows.collect(),
        scale_word: "an error of".to_owned(),
    };
    page.put("<div class=\"keep whole\">");
    page.heading(3, "Error vectors", "");
    page.paragraph("note", "Each line begins with a dot at its place and points along the error, enlarged as the rule says.");
    page.paragraph("note screen", "Drag to turn, or use the arrow keys.");
    if volume.after.is_some() {
        page.put("<div class=\"legend\"><span><i class=\"b\"></i>before</span><span><i class=\"f\"></i>after</span></div>");
    }
    page.figure(&quiver(&picture), "");
    page.put("</div>");
}

//! Squareness, diagonals and the map of the working space.

use volcomp_vocabulary::AxisName;

use super::write::{Cell, Page};
use crate::{
    plot::{
        Arrow, HeatMap, Look, Mark, Quiver, Series, SquareSketch, Svg, XyPlot, colour_scale,
        escaped, heat_map, quiver, short, square_sketch, ticks, xy,
    },
    report::{Diagonal, Report, Slice, Standing, State, Volume},
    texts::Texts,
};

/// The largest squareness is drawn as this angle.
const DRAWN_RAD: f64 = 0.2;

pub(super) fn squareness(page: &mut Page, report: &Report, t: &Texts) {
    if report.squareness.is_empty() {
        page.paragraph("lead", t.no_squareness);
    } else {
        page.paragraph("lead", t.squareness_lead);
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
        let angle = format!(">{}, µrad", t.angle);
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
                    t.measured_here
                } else {
                    t.of_file
                }),
            ]
        });
        page.table(&[t.pair, &angle, t.from, t.known_from], rows);
    }
    if !report.locations.is_empty() {
        page.heading(4, t.locations, "");
        let columns = [
            t.error.to_owned(),
            format!(">{}", t.value),
            format!(">{}", t.uncertainty_k1),
            String::new(),
        ];
        let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
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

/// 1, 2 or 5 times a power of ten, not above the value.
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

fn state_words(state: State, has_before: bool, t: &Texts) -> &'static str {
    match state {
        State::Found if has_before => t.state_found_after,
        State::Found => t.state_found,
        State::GivenBefore => t.state_given,
        State::Truth => t.state_truth,
        State::TruthCorrected => t.state_corrected,
    }
}

/// What before and after mean.
fn states(page: &mut Page, before: State, after: Option<State>, t: &Texts) {
    let line = |name: &str, words: &str| format!("<b>{}</b>: {}", escaped(name), escaped(words));
    let mut all = Vec::new();
    if let Some(after) = after {
        all.push(line(t.before, state_words(before, false, t)));
        all.push(line(t.after, state_words(after, true, t)));
    } else {
        all.push(escaped(state_words(before, false, t)) + ".");
        all.push(escaped(t.no_after));
    }
    page.put(&format!("<p class=\"lead\">{}</p>", all.join("<br>")));
}

pub(super) fn diagonals(page: &mut Page, report: &Report, t: &Texts) {
    let Some(found) = &report.diagonals else {
        page.paragraph("lead", t.no_diagonals);
        return;
    };
    page.paragraph("lead", t.diagonals_lead);
    if let Some(volume) = &report.volume {
        standing(page, volume, t);
    }
    states(
        page,
        found.before.state,
        found.after.as_ref().map(|after| after.state),
        t,
    );
    let after_of = |name: &str| -> Option<&Diagonal> {
        let after = found.after.as_ref()?;
        after.found.iter().find(|diagonal| diagonal.name == name)
    };
    page.put("<div class=\"maps two\">");
    for diagonal in &found.before.found {
        let mut series = vec![Series {
            name: format!("{}, {}", diagonal.name, t.before),
            points: diagonal.points.clone(),
            look: Look::Before,
            mark: Mark::Down,
            line: true,
        }];
        let mut legend = vec![(Look::Before, Mark::Down, t.before.to_owned())];
        if let Some(after) = after_of(&diagonal.name) {
            series.push(Series {
                name: format!("{}, {}", diagonal.name, t.after),
                points: after.points.clone(),
                look: Look::After,
                mark: Mark::Dot,
                line: true,
            });
            legend.push((Look::After, Mark::Dot, t.after.to_owned()));
        } else {
            legend.clear();
        }
        let plot = XyPlot {
            words: format!("{} {}", t.diagonal, diagonal.name),
            x_label: t.along.to_owned(),
            x_named: true,
            y_label: format!("{}, µm", t.deviation),
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
    let range = |word: &str| format!(">{} {word}, µm", t.range);
    let (before, after) = (range(t.before), range(t.after));
    let alone = format!(">{}, µm", t.range);
    let columns: &[&str] = if found.after.is_some() {
        &[t.diagonal, &before, &after]
    } else {
        &[t.diagonal, &alone]
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

pub(super) fn volume(page: &mut Page, report: &Report, t: &Texts) {
    let Some(volume) = &report.volume else {
        page.paragraph("lead", t.no_volume);
        return;
    };
    page.paragraph("lead", t.volume_lead);
    states(
        page,
        volume.before.state,
        volume.after.as_ref().map(|after| after.state),
        t,
    );
    let columns = [
        t.state.to_owned(),
        format!(">{}, µm", t.max),
        t.at.to_owned(),
        format!(">{}, µm", t.rms),
        format!(">{}, µrad", t.tilt),
        format!(">{}, µm", t.whole_max),
        format!(">{}, µm", t.rms),
    ];
    let columns: Vec<&str> = columns.iter().map(String::as_str).collect();
    let mut states = vec![(t.before, &volume.before.found)];
    states.extend(volume.after.iter().map(|after| (t.after, &after.found)));
    if volume.after.is_none() {
        states[0].0 = t.uncompensated;
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
        &format!("{} {}. {}", volume.poses, t.nodes, t.rigid_note),
    );
    standing(page, volume, t);
    maps(page, volume, t);
    vectors(page, volume, t);
}

/// The axes that stand still, and what is not seen for it.
fn standing(page: &mut Page, volume: &Volume, t: &Texts) {
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
        &format!("{} {}. {}", t.standing, at.join(", "), t.standing_note),
    );
}

/// Every slice before, then every one after, in one scale of colours.
fn maps(page: &mut Page, volume: &Volume, t: &Texts) {
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
                words: format!("{} {title} {word}", t.plane),
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
    let before = if volume.after.is_some() { t.before } else { "" };
    row(before, &|slice| Some(slice.before_um.clone()));
    if volume.after.is_some() {
        row(t.after, &|slice| slice.after_um.clone());
    }
    page.put(&format!(
        "<div class=\"colours\">{}</div>",
        colours(most, t)
    ));
}

/// The scale of the colours.
fn colours(most: f64, t: &Texts) -> String {
    let (left, width) = (4.0, 400.0);
    let mut svg = Svg::new("plot", (420.0, 54.0), t.scale_word, "");
    let strips = 60;
    for (share, colour) in colour_scale(strips) {
        svg.raw(&format!(
            "<rect x=\"{}\" y=\"18\" width=\"{}\" height=\"14\" fill=\"{colour}\"/>",
            crate::plot::finite(left + share * width),
            crate::plot::finite(width / strips as f64 + 0.5)
        ));
    }
    svg.raw(&format!(
        "<text class=\"name\" x=\"{left}\" y=\"12\">{}</text>",
        escaped(t.scale_word)
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

fn vectors(page: &mut Page, volume: &Volume, t: &Texts) {
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
        words: t.vectors.to_owned(),
        travels_mm: volume.travels_mm,
        arrows: arrows.collect(),
        scale_word: t.arrow_word.to_owned(),
    };
    page.put("<div class=\"keep whole\">");
    page.heading(3, t.vectors, "");
    page.paragraph("note", t.vectors_hint);
    page.paragraph("note screen", t.vectors_turn);
    if volume.after.is_some() {
        page.put(&format!(
            "<div class=\"legend\"><span><i class=\"b\"></i>{}</span><span><i class=\"f\"></i>{}</span></div>",
            escaped(t.before),
            escaped(t.after)
        ));
    }
    page.figure(&quiver(&picture), "");
    page.put("</div>");
}

//! Squareness, diagonals and the map of the working space.

use volcomp_vocabulary::AxisName;

use super::write::{Cell, Page};
use crate::{
    pictures::{self, Maps, diagonal_plots, exaggeration, sketch},
    plot::{
        Arrow, Quiver, colour_bar, escaped, finite, heat_map, quiver, round_below, short,
        square_sketch,
    },
    report::{Diagonal, Report, Standing, State, Volume},
};

pub(super) fn squareness(page: &mut Page, report: &Report) {
    if report.squareness.is_empty() {
        page.paragraph("lead", "No squareness is known.");
    } else {
        page.paragraph(
            "lead",
            "The angle of each pair of axes less 90°, drawn much larger than it is; dashed: 90°.",
        );
        let exaggeration = exaggeration(report.squareness.iter().map(|of| of.angle_urad));
        page.put("<div class=\"squares\">");
        for square in &report.squareness {
            let axes = [square.first.clone(), square.second.clone()];
            let sketch = square_sketch(&sketch(&axes, square.angle_urad, exaggeration));
            page.put(&format!("<figure>{sketch}</figure>"));
        }
        page.put("</div>");
        let rows = report.squareness.iter().map(|square| {
            let from = square.from.iter();
            let from: Vec<String> =
                from.map(|tilt| format!("{} = {}", tilt.error, short(tilt.urad, 2))).collect();
            vec![
                Cell::text(format!("{}{}", square.first, square.second)),
                Cell::number(square.angle_urad, 2),
                Cell::text(from.join(", ")),
                Cell::text(if square.measured { "this calibration" } else { "the machine file" }),
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
    states(page, found.before.state, found.after.as_ref().map(|after| after.state));
    page.put("<div class=\"maps two\">");
    for panel in diagonal_plots(found) {
        page.figure(&panel.svg, &panel.heading);
    }
    page.put("</div>");
    let after_of = |name: &str| -> Option<&Diagonal> {
        let after = found.after.as_ref()?;
        after.found.iter().find(|diagonal| diagonal.name == name)
    };
    let columns: &[&str] = if found.after.is_some() {
        &["diagonal", ">range before, µm", ">range after, µm"]
    } else {
        &["diagonal", ">range, µm"]
    };
    let rows = found.before.found.iter().map(|diagonal| {
        let mut row = vec![Cell::text(&diagonal.name), Cell::number(diagonal.range_um, 2)];
        if found.after.is_some() {
            row.push(Cell::Number(after_of(&diagonal.name).map(|of| of.range_um), 2));
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
    page.paragraph("lead", "Length of the error of the tool tip after best-fit rigid-body alignment of the workpiece, on planes through the middle of the working space, with the error in the plane as arrows. One colour scale for all maps.");
    states(page, volume.before.state, volume.after.as_ref().map(|after| after.state));
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

/// Lists the axes at fixed coordinates, and the errors that the maps therefore omit.
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
        &format!("Axes that do not move in the pictures over X, Y and Z: {}. The table and the verdict cover poses of all axes; these pictures show this one.", at.join(", ")),
    );
}

/// Writes the maps before, then those after compensation, with a common colour scale.
fn maps(page: &mut Page, volume: &Volume) {
    let Maps { before, after, most_um } = pictures::maps(volume);
    let class = match volume.slices.len() {
        1 => "maps one",
        2 | 4 => "maps two",
        _ => "maps",
    };
    for maps in [before, after].iter().filter(|maps| !maps.is_empty()) {
        page.put(&format!("<div class=\"{class}\">"));
        for map in maps {
            page.put(&heat_map(map));
        }
        page.put("</div>");
    }
    let bar = colour_bar(pictures::COLOURS, most_um);
    page.put(&format!("<div class=\"colours\">{bar}</div>"));
}

/// A slider for the smallest error that is shown, µm. It is hidden until the script runs.
fn level(picture: &Quiver) -> String {
    let lengths = picture.arrows.iter().map(|arrow| {
        let [x, y, z] = arrow.error_um;
        x.hypot(y).hypot(z)
    });
    let longest = lengths.filter(|um| um.is_finite()).fold(0.0, f64::max);
    let step = round_below(longest / 50.0).max(0.01);
    // The longest vector is shown at the last step as well.
    let end = finite(step * (longest / step).floor());
    format!(
        "<label class=\"level\" hidden>Show errors of at least <input type=\"range\" min=\"0\" max=\"{end}\" step=\"{step}\" value=\"0\"> <output></output></label>"
    )
}

fn vectors(page: &mut Page, volume: &Volume) {
    let arrows = volume.vectors.iter().flat_map(|vector| {
        let arrow = |error_um, after| Arrow { at_mm: vector.at_mm, error_um, after };
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
    page.put(&level(&picture));
    page.put("</div>");
}

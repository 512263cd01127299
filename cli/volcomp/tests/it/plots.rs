//! Pictures of results: their numbers are those of the JSON document of the same call.

use std::{fmt::Write as _, fs};

use serde_json::Value;

use crate::{Folder, close, contains, float, json, list, one_line, refused, root, text, volcomp};

const POSITIONING: &str = "fitting/metrology/tests/data/iso230-2-axis.csv";
const STRAIGHT: [&str; 2] = ["examples/straight-exy.csv", "examples/straight-eyx.csv"];

/// Calls, with `{o}` for a file to be written, and a part of the title of the picture.
const CALLS: [(&str, &str); 13] = [
    ("iso230 {positioning}", "test to ISO 230-2:2014"),
    (
        "iso230 {positioning} examples/calibration/ecc.csv",
        "Positioning tests to ISO 230-2, 2 files",
    ),
    (
        "iso230 examples/circle.csv --part 4 --radius-mm 150",
        "Circular test to ISO 230-4, plane XY, radius 150.000 mm",
    ),
    ("fit {positioning}", "through the mean deviations"),
    ("map -m examples/gantry.toml --grid 2x2x2", "Volumetric error"),
    ("map -m examples/two-axes.toml --grid 2x2x2", "Volumetric error"),
    ("diagonals -m examples/gantry.toml", "Body diagonals of the machine, by the model"),
    (
        "nc examples/part.ngc -o {o} -m examples/mill.toml --setup examples/setup.toml --verify",
        "Tool deviation from the programmed path",
    ),
    ("straightness examples/straight-exy.csv", "Straightness about the least squares line"),
    (
        "squareness examples/straight-exy.csv examples/straight-eyx.csv --error EC0Y",
        "Squareness EC0Y of X and Y",
    ),
    ("sensitivity -m examples/gantry.toml", "Effect of 1 µm or 1 µrad of each error"),
    ("sensitivity -m examples/gantry.toml --values", "Effect of the errors of the machine file"),
    (
        "identify examples/identification/observations.toml -o {o}",
        "Residuals of the identification",
    ),
];

fn call(words: &str, folder: &Folder) -> Vec<String> {
    let output = folder.path().join("output").display().to_string();
    let word = |word: &str| word.replace("{o}", &output).replace("{positioning}", POSITIONING);
    words.split(' ').map(word).collect()
}

/// The document of a call, and the SVG that it draws.
fn drawn(words: &str) -> (Value, String) {
    let folder = Folder::new();
    let svg = folder.path().join("plot.svg").display().to_string();
    let mut all = call(words, &folder);
    all.extend(["--plot".to_owned(), svg.clone()]);
    let all: Vec<&str> = all.iter().map(String::as_str).collect();
    (json(&all), fs::read_to_string(svg).expect("the picture"))
}

/// The numbers in the first attribute of this name in the text.
fn numbers(svg: &str, attribute: &str) -> Vec<f64> {
    let (_, rest) = svg.split_once(&format!("{attribute}=\"")).expect(attribute);
    let inside = rest.split_once('"').expect("an end").0;
    let parts = inside.split([' ', ',']).filter(|part| !part.is_empty());
    parts.map(|part| part.parse().expect("a number")).collect()
}

/// The points of the series `name` in the units of its plot, whose scales are the last `data-x` and `data-y` before the
/// series.
fn series(svg: &str, name: &str) -> Vec<[f64; 2]> {
    let start =
        svg.find(&format!("data-n=\"{name}\"")).unwrap_or_else(|| panic!("no {name} in {svg}"));
    let plot = svg[..start].rfind("data-x=").expect("a plot");
    let [x, y] = ["data-x", "data-y"].map(|axis| numbers(&svg[plot..], axis));
    let value = |scale: &[f64], at: f64| {
        scale[2] + (at - scale[0]) / (scale[1] - scale[0]) * (scale[3] - scale[2])
    };
    let places = numbers(&svg[start..], "points");
    places.chunks(2).map(|at| [value(&x, at[0]), value(&y, at[1])]).collect()
}

/// Positions in a picture are rounded to 0.01 units. On an axis of at least 60 units this is 1/6000 of the range.
#[track_caller]
fn same(found: &[[f64; 2]], expected: &[[f64; 2]]) {
    assert_eq!(found.len(), expected.len(), "{found:?} {expected:?}");
    for axis in [0, 1] {
        let values = || expected.iter().chain(found).map(|point| point[axis]);
        let largest = values().map(f64::abs).fold(1e-9, f64::max);
        for (found, expected) in found.iter().zip(expected) {
            let far = (found[axis] - expected[axis]).abs();
            assert!(far <= 2e-3 * largest, "{found:?} {expected:?}");
        }
    }
}

/// Every command writes SVG and PNG. No SVG contains a number that is not finite, an unexpanded variable or unescaped
/// text.
#[test]
fn every_command_draws_its_result_as_svg_and_png() {
    for (words, title) in CALLS {
        let folder = Folder::new();
        for ending in ["svg", "PNG"] {
            let path = folder.path().join(format!("plot.{ending}"));
            fs::write(&path, "what was there before").expect("a file");
            let mut all = call(words, &folder);
            all.extend(["--plot".to_owned(), path.display().to_string()]);
            let all: Vec<&str> = all.iter().map(String::as_str).collect();
            text(&all);
            let bytes = fs::read(&path).expect("the picture");
            if ending == "PNG" {
                assert!(bytes.starts_with(b"\x89PNG\r\n"), "{words}");
                // Width in the PNG header: twice the 720 units of the SVG.
                assert_eq!(bytes[16..20], 1440_u32.to_be_bytes(), "{words}");
                continue;
            }
            let svg = String::from_utf8(bytes).expect("UTF-8");
            assert!(svg.starts_with("<svg xmlns") && svg.ends_with("</svg>\n"), "{words}");
            contains(&svg, title);
            contains(&svg, "prefers-color-scheme:dark");
            for wrong in ["NaN", "inf\"", "inf ", "var(--"] {
                assert!(!svg.contains(wrong), "{words}: {wrong}");
            }
        }
    }
}

#[test]
fn a_positioning_test_is_drawn_where_its_numbers_are() {
    let (found, svg) = drawn("iso230 {positioning} --tolerance A=300");
    for (direction, name) in [("forward", "mean, forward"), ("backward", "mean, backward")] {
        let rows = list(&found["targets"]).iter();
        let means = rows.map(|row| [float(&row["target"]), float(&row[direction]["mean"])]);
        same(&series(&svg, name), &means.collect::<Vec<_>>());
        let rows = list(&found["targets"]).iter();
        let upper = rows.map(|row| {
            let of = &row[direction];
            [float(&row["target"]), float(&of["mean"]) + 2.0 * float(&of["s"])]
        });
        same(&series(&svg, &name.replace("mean", "mean + 2 s")), &upper.collect::<Vec<_>>());
    }
    let [upper, lower] =
        ["upper", "lower"].map(|side| series(&svg, &format!("{side} limit of A"))[0][1]);
    assert!((upper - lower - 300.0).abs() < 0.5, "{upper} {lower}");
    contains(&svg, &format!("A {:.2} µm (limit 300.00: pass)", float(&found["A_um"])));
    contains(&svg, POSITIONING);
}

#[test]
fn a_fit_is_drawn_where_its_numbers_are() {
    let (found, svg) = drawn("fit {positioning} --at 100,500,1500");
    let curve = series(&svg, "curve");
    for value in list(&found["values"]) {
        let at = float(&value["at"]);
        let nearest = curve.iter().min_by(|a, b| (a[0] - at).abs().total_cmp(&(b[0] - at).abs()));
        let nearest = nearest.expect("a curve");
        close(&value["value_um"], nearest[1], 1.5);
    }
    let residual = series(&svg, "residual, both");
    let [min, max] = [f64::min, f64::max].map(|of| residual.iter().map(|r| r[1]).fold(0.0, of));
    close(&found["residual_um"]["min"], min, 0.05);
    close(&found["residual_um"]["max"], max, 0.05);
    let band = svg.split_once("class=\"band f\"").expect("a band").1;
    let widths = numbers(band, "points");
    assert_eq!(widths.len(), 4 * list(&found["band"]["half_widths"]).len());
}

#[test]
fn straightness_and_squareness_are_drawn_where_their_numbers_are() {
    let (found, svg) = drawn("straightness examples/straight-exy.csv --tolerance least-squares=5");
    let profile = list(&found["profile"]).iter().map(|p| [float(&p[0]), float(&p[1])]);
    same(&series(&svg, "mean"), &profile.collect::<Vec<_>>());
    let words = format!("squareness {} {} --error EC0Y", STRAIGHT[0], STRAIGHT[1]);
    let (found, svg) = drawn(&words);
    let second = svg.find("class=\"plot xy\"").expect("a plot") + 1;
    let second = second + svg[second..].find("<svg").expect("a second plot");
    for (part, svg) in list(&found["parts"]).iter().zip([&svg[..], &svg[second..]]) {
        let line = series(svg, "line");
        let slope = 1e3 * (line[1][1] - line[0][1]) / (line[1][0] - line[0][0]);
        close(&part["slope_urad"], slope, 0.1);
    }
    contains(&svg, &format!("XY: 90° + {:.1} µrad", float(&found["squareness_urad"])));
}

#[test]
fn diagonals_are_drawn_where_their_numbers_are_with_one_scale() {
    let (found, svg) = drawn("diagonals -m examples/gantry.toml --points 5");
    let mut scales = Vec::new();
    for name in ["PPP", "NPP", "PNP", "PPN"] {
        let deviations = list(&found[name]["deviation_um"]).iter().map(float);
        let drawn = series(&svg, name);
        let expected: Vec<[f64; 2]> = deviations.zip(&drawn).map(|(um, at)| [at[0], um]).collect();
        same(&drawn, &expected);
        contains(&svg, &format!("{name}: range {:.2} µm", float(&found[name]["range_um"])));
        let plot = svg.find(&format!("aria-label=\"diagonal {name}\"")).expect("a plot");
        scales.push(numbers(&svg[plot..], "data-y"));
    }
    assert!(scales.iter().all(|scale| *scale == scales[0]), "{scales:?}");
}

/// EXX grows by 0.1 µm per mm: after alignment it is linear about the middle, and the arrows point along X.
#[test]
fn a_map_is_drawn_where_its_numbers_are() {
    let folder = Folder::new();
    let machine = folder.write(
        "m.toml",
        "structure = \"w b X Y Z t\"\n[axes]\nX.travel = [0, 500]\nY.travel = [0, 400]\nZ.travel = [0, 300]\n[errors]\nEXX = { poly = [0.0, 0.1] }\n",
    );
    let (found, svg) = drawn(&format!("map -m {machine} --grid 3x3x3"));
    let form = &found["all_axes"];
    contains(
        &svg,
        &format!(
            "largest {:.3} µm, RMS {:.3} µm",
            float(&form["form_max_um"]),
            float(&form["form_rms_um"])
        ),
    );
    assert_eq!(svg.matches("class=\"plot heat\"").count(), 3);
    let cells = svg.split("data-v=\"").skip(1).map(|rest| rest.split_once('"').expect("an end").0);
    let values: Vec<f64> = cells.map(|value| value.parse().expect("a number")).collect();
    assert_eq!(values.len(), 3 * 625);
    // Both ends of X in the first plane are 25 µm from the middle.
    assert!((values[0] - 25.0).abs() < 1.0 && (values[24] - 25.0).abs() < 1.0, "{values:?}");
    assert!(values[12] < 1.0, "{}", values[12]);
    // Two of the planes contain the X axis and have 25 arrows each. The third plane has 25 arrows of length 0.
    assert_eq!(svg.matches("class=\"arrow\"").count(), 75);
}

#[test]
fn an_nc_program_is_drawn_with_the_figures_of_its_verification() {
    let (found, svg) = drawn(CALLS[7].0);
    for (name, which) in [("original", "before"), ("compensated", "after")] {
        let of = &found["verified"][which];
        let [max, rms] = ["max_um", "rms_um"].map(|key| float(&of[key]));
        let line = format!("{name}: at most {max:.1} µm (line {}), RMS {rms:.1} µm", of["line"]);
        contains(&svg, &line);
    }
    let times = numbers(&svg, "data-times")[0];
    contains(&svg, &format!("{times} times magnified"));
}

#[test]
fn sensitivities_are_bars_of_their_length() {
    let (found, svg) = drawn("sensitivity -m examples/gantry.toml");
    let scale = numbers(&svg, "data-x");
    for effect in list(&found["errors"]).iter().take(6) {
        let name = effect["name"].as_str().expect("a name");
        let bar = svg.split_once(&format!("data-n=\"{name}\"")).expect("a bar").1;
        let width = numbers(bar, "width")[0] / (scale[1] - scale[0]) * (scale[3] - scale[2]);
        close(&effect["position_rms_um"], width, 1e-3 * (scale[3] - scale[2]));
    }
}

#[test]
fn residuals_of_an_identification_are_those_of_its_figures() {
    let (found, svg) = drawn(CALLS[12].0);
    let figures = &found["residual_um"];
    let plots = svg.split("data-n=\"residual\"").skip(1).count();
    assert_eq!(plots, 4);
    contains(
        &svg,
        &format!(
            "{} fitted rows: RMS {:.2} µm, largest {:.2} µm",
            figures["rows"],
            float(&figures["rms"]),
            float(&figures["max"])
        ),
    );
}

/// One target with one run, deviations that are all zero, and 20,000 readings.
#[test]
fn few_and_many_readings_are_drawn() {
    let folder = Folder::new();
    let header = "target,run,direction,deviation\n";
    let many = (0..20_000).fold(String::new(), |mut rows, target| {
        let _ = writeln!(rows, "{target},1,+,{}", target % 7);
        rows
    });
    for (name, rows) in
        [("one", "0,1,+,3\n0,1,-,4\n"), ("zeros", "0,1,+,0\n10,1,+,0\n20,1,+,0\n"), ("many", &many)]
    {
        let file = folder.write(&format!("{name}.csv"), format!("{header}{rows}"));
        let plot = folder.path().join(format!("{name}.svg")).display().to_string();
        text(&["iso230", &file, "--plot", &plot]);
        let svg = fs::read_to_string(&plot).expect("the picture");
        assert!(!svg.contains("NaN") && !svg.contains("inf\""), "{name}");
        assert!(svg.len() < 400_000, "{name}: {}", svg.len());
    }
}

#[test]
fn a_plot_that_cannot_be_written_is_refused_before_the_work() {
    let folder = Folder::new();
    let readings = fs::read_to_string(root().join(POSITIONING)).expect("the readings");
    let file = folder.write("a.svg", readings);
    let plot = |name: &str| folder.path().join(name).display().to_string();
    for (path, expected) in [
        ("a.pdf", "a.pdf, expected a name that ends in .svg or .png"),
        ("a", "expected a name that ends in .svg or .png"),
        ("none/a.svg", "there is no folder"),
        ("a.svg", "found it for --plot and for the readings, expected two files"),
    ] {
        contains(&one_line(&refused(&["iso230", &file, "--plot", &plot(path)])), expected);
    }
    let same = plot("b.svg");
    contains(
        &one_line(&refused(&["iso230", POSITIONING, "-o", &same, "--plot", &same])),
        "found it for --plot and for --csv",
    );
    let nc = "nc examples/part.ngc -m examples/mill.toml --setup examples/setup.toml";
    let nc = format!("{nc} -o {} --plot {same}", plot("o.ngc"));
    contains(&one_line(&refused(&nc)), "--plot: found without --verify");
    assert!(!volcomp(&["check", "-m", "examples/gantry.toml", "--plot", &same]).status.success());
    assert_eq!(fs::read_dir(folder.path()).expect("a folder").count(), 1);
}

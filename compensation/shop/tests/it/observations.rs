//! Observations of the virtual shop equal separate chains of 4×4 matrices, and identification reproduces the errors.

use std::fmt::Write as _;
use std::fs;
use std::path::Path;

use volcomp_identify::{Observations, RowReading};
use volcomp_kinematics::nalgebra::Vector3;
use volcomp_model::Machine;
use volcomp_shop::{Shop, ShopError};
use volcomp_test_support::rows;

use crate::{identified, shop_in, write};

/// A head with one rotary axis on three linear axes: the machine of the hand-written chain.
const HEAD: &str = "structure = \"w X' b Y Z B t\"
[axes]
X.travel = [-300, 300]
Y.travel = [-250, 250]
Z.travel = [-100, 500]
B = { travel = [-90, 90], point = [20.0, 0.0, 400.0] }
[tool]
tip = [0.0, 0.0, 150.0]
[errors]
EXX = { poly = [0.0, 0.05] }
EX0B = 30.0
EAY = { poly = [0.0, 0.2] }
";

/// Actual tip of that machine, mm. X carries the workpiece, and its scale is 50 µm/m too long; Y rolls about X by 0.2 µrad/mm at
/// machine zero; B's axis is 30 µm too far along X.
fn tip_of_head([x, y, z, b_deg]: [f64; 4]) -> [f64; 3] {
    let (roll, b) = (0.2e-6 * y, b_deg.to_radians());
    // B turns the tip about the line through (20.03, 0, 400), then Z moves the tip.
    let (s, c) = b.sin_cos();
    let [dx, dz] = [0.0 - 20.03, 150.0 - 400.0];
    let turned = [20.03 + c * dx + s * dz, 0.0, 400.0 - s * dx + c * dz + z];
    // The axis of the roll of Y moves with the carriage.
    let (sr, cr) = roll.sin_cos();
    let rolled = [turned[0], cr * turned[1] - sr * turned[2] + y, sr * turned[1] + cr * turned[2]];
    [rolled[0] + x + 0.05e-3 * x, rolled[1], rolled[2]]
}

fn shop(folder: &Path, truth: &str, text: &str) -> Shop {
    shop_in(folder, truth, &format!("machine = \"truth.toml\"\n{text}"))
}

/// Header and rows of a row file.
fn table(folder: &Path, name: &str) -> (Vec<String>, Vec<Vec<String>>) {
    let text = fs::read_to_string(folder.join(name)).expect("written");
    let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned).collect());
    (lines.next().expect("a header"), lines.collect())
}

fn number(table: &(Vec<String>, Vec<Vec<String>>), row: usize, column: &str) -> f64 {
    let place = table.0.iter().position(|name| name == column);
    let place = place.unwrap_or_else(|| panic!("{column}: {:?}", table.0));
    table.1[row][place].parse().expect("a number")
}

#[test]
fn readings_are_those_of_a_chain_written_by_hand() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let shop = shop(
        folder,
        HEAD,
        "seed = 3
unknown = [\"EX0B\"]
[[observation]]
kind = \"sphere\"
centres = [[50.0, -40.0, 300.0]]
poses = 12
[[observation]]
kind = \"sphere\"
file = \"r-test\"
reads = \"offset\"
centres = [[50.0, -40.0, 300.0]]
poses = 12
[[observation]]
kind = \"distance\"
point = [10.0, 20.0, 30.0]
dead_length_mm = 100.5
poses = 12
[[observation]]
kind = \"points\"
frame = [1000.0, 200.0, -300.0, 0.0, 0.0, 90.0]
target = [3.0, 0.0, 0.0]
at = { B = 0.0 }
poses = 12
[[observation]]
kind = \"ball-row\"
reads = \"offset\"
origin = [-100.0, 10.0, 300.0]
direction = [1.0, 0.0, 0.0]
distances = [0.0, 60.0, 130.0]
at = { B = 30.0 }
runs = 1
both_directions = false
",
    );
    write(&shop, folder);
    let state = |table: &_, row| ["X", "Y", "Z", "B"].map(|axis| number(table, row, axis));
    let near = |found: f64, expected: f64, what: &str| {
        assert!((found - expected).abs() < 3e-6, "{what}: {found} for {expected}");
    };
    let centre = [50.0, -40.0, 300.0];
    let probe = table(folder, "sphere.csv");
    let offset = table(folder, "r-test.csv");
    let distance = table(folder, "distance.csv");
    let tracker = table(folder, "points.csv");
    let mut angles = Vec::new();
    for row in 0..12 {
        for (place, axis) in ["x", "y", "z"].into_iter().enumerate() {
            near(tip_of_head(state(&probe, row))[place], centre[place], "probe");
            let read = number(&offset, row, &format!("d{axis}_um"));
            let expected = tip_of_head(state(&offset, row))[place] - centre[place];
            near(read * 1e-3, expected, "offset");
            assert!(expected.abs() < 0.2);
        }
        let tip = Vector3::from(tip_of_head(state(&distance, row)));
        let length = (tip - Vector3::new(10.0, 20.0, 30.0)).norm() - 100.5;
        near(number(&distance, row, "length_mm"), length, "distance");
        // The tracker is rotated by 90° about Z, so its x is Y of the workpiece. Without B the target moves only along X.
        let tip = tip_of_head(state(&tracker, row));
        near(number(&tracker, row, "x"), tip[1] - 200.0, "tracker x");
        near(number(&tracker, row, "y"), -(tip[0] + 3.0 - 1000.0), "tracker y");
        near(number(&tracker, row, "z"), tip[2] + 300.0, "tracker z");
        angles.push(number(&probe, row, "B"));
    }
    angles.sort_by(f64::total_cmp);
    assert!(angles[11] - angles[0] > 90.0, "B is all over: {angles:?}");
    let row = table(folder, "ball-row.csv");
    for (ball, distance) in [0.0, 60.0, 130.0].into_iter().enumerate() {
        let tip = tip_of_head(state(&row, ball));
        near(number(&row, ball, "along_um") * 1e-3, tip[0] + 100.0 - distance, "along");
        near(number(&row, ball, "side1_um") * 1e-3, tip[1] - 10.0, "side 1");
        near(number(&row, ball, "side2_um") * 1e-3, tip[2] - 300.0, "side 2");
    }
}

/// Three squareness errors, the scales, and the errors of a table's axes.
const TABLE: &str = "structure = \"w C' X' Y' b Z A t\"
[axes]
C = { travel = [-180, 180], point = [0, 0, 0] }
X.travel = [-300, 300]
Y.travel = [-250, 250]
Z.travel = [0, 400]
A = { travel = [-60, 60], point = [0, 0, 300] }
[tool]
tip = [0.0, 0.0, 120.0]
[tools.long]
tip = [0.0, 0.0, 60.0]
[tools.short]
tip = [0.0, 0.0, 180.0]
";
const ERRORS: &str = "[errors]
EC0X = 20.0
EA0Z = -15.0
EB0Z = 12.0
EB0A = 25.0
EC0A = -18.0
EA0C = 22.0
EB0C = -9.0
EX0C = 14.0
EXX = { poly = [0.0, 0.03] }
EYY = { poly = [0.0, -0.02, 4e-5] }
EZZ = { poly = [0.0, 0.025] }
EBX = { poly = [0.0, 0.08] }
ECC = { fourier = [0.0, 8.0, -5.0], period = 360.0 }
";
const UNKNOWN: &str = "unknown = [\"EC0X\", \"EA0Z\", \"EB0Z\", \"EB0A\", \"EC0A\", \"EA0C\", \"EB0C\", \"EX0C\",
    { error = \"EXX\", legendre = 1 }, { error = \"EYY\", legendre = 2 }, { error = \"EZZ\", legendre = 1 },
    { error = \"EBX\", legendre = 1 }, { error = \"ECC\", fourier = 1 }]\n";

/// Largest difference between two machines over poses within the travels, µm, after best-fit rigid-body alignment of the workpiece.
fn largest_difference_um(one: &Machine, other: &Machine) -> f64 {
    crate::figures::compare(one, other, 300, 5).position_um
}

/// Each instrument without noise, alone or in the required combination, reproduces the errors within 0.1 µm.
#[test]
fn every_instrument_brings_the_errors_back() {
    let truth = format!("{TABLE}{ERRORS}");
    for (name, text) in [
        (
            "tracker",
            "[[observation]]
kind = \"points\"
poses = 80
frame = [1500.0, -200.0, 800.0, 10.0, -20.0, 160.0]
target = [5.0, -3.0, 2.0]
drift_um = 8.0
drift_urad = 5.0
[[observation]]
kind = \"sphere\"
poses = 20
centres = [[60, 20, 320]]
",
        ),
        (
            "spheres",
            "[[observation]]
kind = \"sphere\"
poses = 20
centres = [[60, 20, 310], [-80, 90, 330], [-40, -110, 350], [20, 60, 430]]
tools = [\"short\", \"long\"]
[[observation]]
kind = \"ball-row\"
origin = [-200, 0, 150]
direction = [1, 0, 0]
distances = [0, 100, 200, 400]
alignment_urad = 300
at = { A = 0, C = 0 }
[[observation]]
kind = \"ball-row\"
file = \"ball-row-y\"
origin = [0, -200, 150]
direction = [0, 1, 0]
distances = [0, 100, 200, 400]
alignment_urad = 300
at = { A = 0, C = 0 }
[[observation]]
kind = \"step-gauge\"
origin = [0, 0, 150]
direction = [0, 0, 1]
distances = [0, 100, 200, 300]
at = { A = 0, C = 0 }
runs = 1
[[observation]]
kind = \"diagonals\"
targets = 5
runs = 1
",
        ),
        (
            "ballbar and tracer",
            "[[observation]]
kind = \"distance\"
poses = 60
point = [30, 40, -100]
dead_length_mm = 150.2
drift_um = 4.0
[[observation]]
kind = \"distance\"
poses = 60
point = [250, -240, 500]
[[observation]]
kind = \"distance\"
poses = 60
point = [-280, 230, 480]
tools = [\"short\", \"long\"]
[[observation]]
kind = \"distance\"
file = \"ballbar\"
poses = 40
point = [30, -20, 200]
radius_mm = 100
dead_length_mm = 100.02
",
        ),
    ] {
        let folder = tempfile::tempdir().expect("a folder");
        let shop = shop(folder.path(), &truth, &format!("seed = 4\n{UNKNOWN}{text}"));
        write(&shop, folder.path());
        let found = identified(folder.path());
        assert!(found.residual.max_um < 0.05, "{name}: {:?}", found.residual);
        let before =
            largest_difference_um(&shop.truth, &Machine::parse(TABLE, "m").expect("valid"));
        let left = largest_difference_um(&shop.truth, &found.machine);
        assert!(before > 10.0 && left < 0.1, "{name}: {left} of {before}, {:?}", found.warnings);
    }
}

#[test]
fn noise_is_that_of_the_shop_and_a_seed_repeats_itself() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let text = |seed: u32, noise: f64| {
        format!(
            "seed = {seed}\n{UNKNOWN}[[observation]]\nkind = \"points\"\nposes = 400\nnoise_um = {noise:?}\nframe = [900, 0, 0, 0, 0, 0]\n"
        )
    };
    let files =
        |seed, noise| shop(folder, TABLE, &text(seed, noise)).files(|_, _| {}).expect("measured");
    assert_eq!(files(1, 2.0), files(1, 2.0));
    assert_ne!(files(1, 2.0), files(2, 2.0));
    let [clean, noisy] = [files(1, 0.0), files(1, 2.0)];
    let numbers = |text: &str| -> Vec<f64> {
        let rows = text.lines().skip(1);
        let cells = rows.flat_map(|row| row.split(',').skip(5));
        cells.map(|cell| cell.parse().expect("a number")).collect()
    };
    let pairs = numbers(&clean[1].1).into_iter().zip(numbers(&noisy[1].1));
    let differences: Vec<f64> = pairs.map(|(a, b)| (b - a) * 1e3).collect();
    let count = differences.len() as f64;
    let spread = (differences.iter().map(|d| d * d).sum::<f64>() / count).sqrt();
    // The standard deviation of 1200 values is known within 2 %.
    assert!((spread / 2.0 - 1.0).abs() < 0.08, "{spread}");
    assert!(clean[2].1.contains("uncertainty_um = 0.001"));
    assert!(noisy[2].1.contains("uncertainty_um = 2\n"));
}

/// Distinct names in the column `sphere` of a row file, in order.
fn spheres(folder: &Path, file: &str) -> Vec<String> {
    let table = table(folder, file);
    let place = table.0.iter().position(|name| name == "sphere");
    let place = place.expect("the column");
    let mut names: Vec<String> = table.1.into_iter().map(|row| row[place].clone()).collect();
    names.dedup();
    names
}

/// Two tables with different spheres, and a third with a sphere of each: the spheres keep their names, and the observations determine the
/// errors.
#[test]
fn spheres_of_several_tables_have_names_of_their_own() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let tables = [
        "[[50.0, -40.0, 300.0]]",
        "[[-60.0, 30.0, 250.0], [50.0, 60.0, 200.0]]",
        "[[50.0, 60.0, 200.0], [50.0, -40.0, 300.0]]",
    ];
    let tables = tables.map(|centres| {
        format!("[[observation]]\nkind = \"sphere\"\nposes = 12\ncentres = {centres}\n")
    });
    let text = format!("seed = 3\nunknown = [\"EX0B\"]\n{}", tables.concat());
    write(&shop(folder, HEAD, &text), folder);
    assert_eq!(spheres(folder, "sphere.csv"), ["S1"]);
    assert_eq!(spheres(folder, "sphere-2.csv"), ["S2", "S3"]);
    assert_eq!(spheres(folder, "sphere-3.csv"), ["S3", "S1"]);
    identified(folder);
}

#[test]
fn names_are_read_back_whatever_stands_in_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    // The names as TOML strings.
    let tools = [r#""T1, long""#, r#"'T"2"'"#, r##""# T3""##, r#""T\u200B4""#];
    let mut truth = HEAD.to_owned();
    for (place, name) in tools.iter().enumerate() {
        writeln!(truth, "[tools.{name}]\ntip = [0.0, 0.0, {}]", 120 + 10 * place)
            .expect("a string");
    }
    let names = format!("[{}]", tools.join(", "));
    let text = format!(
        "format = \"csv\"\nunknown = [\"EX0B\"]\n[[measurement]]\nerror = \"EXX\"\nfile = 'x\"line'\n\
         [[observation]]\nkind = \"points\"\nfile = 'a\"b'\nposes = 40\nframe = [900, -500, 200, 0, 0, 120]\ntarget = [1, 2, 3]\ntools = {names}\n\
         [[observation]]\nkind = \"ball-row\"\nfile = 'c,\"d'\norigin = [-100.0, 10.0, 300.0]\ndirection = [1, 0, 0]\ndistances = [0, 60]\ntools = {names}\n"
    );
    let shop = shop(folder, &truth, &text);
    write(&shop, folder);
    // The machine from which the observations start.
    let machine = fs::read_to_string(folder.join("machine.toml")).expect("written");
    fs::write(folder.join("calibrated.toml"), machine).expect("written");
    let file = Observations::read(&folder.join("observations.toml")).expect("read back");
    assert!(!file.observations.is_empty());
    volcomp_calibrate::CalibrationFile::read(&folder.join("calibration.toml")).expect("read back");
}

/// A squareness from a step gauge along both diagonals: 92 to 98 % of the 95 % bands contain the truth, whatever share of the uncertainty
/// is due to the calibration (common to all runs) or to the first face (common to a run).
#[test]
fn bands_of_step_gauges_hold_the_truth_as_often() {
    const SHOPS: u32 = 300;
    const PORTAL: &str = "structure = \"w b X Y Z t\"
[axes.X]
travel = [0.0, 600.0]
[axes.Y]
travel = [0.0, 500.0]
[axes.Z]
travel = [-400.0, 0.0]
[errors]
EC0Y = 25.0
";
    for (calibration_um, runs) in [(1.0, 3), (0.0, 1), (0.0, 3)] {
        let mut inside = 0;
        for seed in 1..=SHOPS {
            let gauge = |file: &str, x: f64, along: f64| {
                format!(
                    "[[observation]]\nkind = \"step-gauge\"\nfile = \"{file}\"\norigin = [{x:?}, 50, -300]\ndirection = [{along:?}, 1, 0]\ndistances = [0, 100, 200, 300, 400]\ncalibration_um = {calibration_um:?}\nnoise_um = 0.5\nruns = {runs}\n"
                )
            };
            let folder = tempfile::tempdir().expect("a folder");
            let text = format!(
                "seed = {seed}\nunknown = [\"EC0Y\"]\n{}{}",
                gauge("up", 50.0, 1.0),
                gauge("down", 400.0, -1.0)
            );
            write(&shop(folder.path(), PORTAL, &text), folder.path());
            let found = identified(folder.path());
            let squareness = found.parameters.iter().find(|p| p.name == "EC0Y");
            let squareness = squareness.expect("EC0Y");
            let uncertainty = squareness.uncertainty.expect("determined");
            inside += u32::from((squareness.value - 25.0).abs() < 1.959_964 * uncertainty);
        }
        let share = f64::from(inside) / f64::from(SHOPS);
        println!("{calibration_um} µm, {runs} runs: {share}");
        assert!((0.92..=0.98).contains(&share), "{calibration_um} µm, {runs} runs: {share}");
    }
}

/// If the machine does not rotate the tool, the target position is stated as measured with a ruler; otherwise the effect of tilts at the tip
/// would be unknown.
#[test]
fn a_target_on_a_machine_without_rotary_axes_is_stated_by_a_ruler() {
    let folder = tempfile::tempdir().expect("a folder");
    let machine = "structure = \"w b X Y Z t\"
[axes.X]
travel = [0.0, 600.0]
[axes.Y]
travel = [0.0, 500.0]
[axes.Z]
travel = [-400.0, 0.0]
";
    let text = "seed = 4\nunknown = [{ error = \"EAX\", legendre = 2 }]\n[[observation]]\nkind = \"points\"\nposes = 40\ntarget = [40, -60, -250]\n";
    let shop = shop(folder.path(), machine, text);
    write(&shop, folder.path());
    let written = std::fs::read_to_string(folder.path().join("observations.toml")).expect("read");
    assert!(written.contains("target_within_mm = 1\n"), "{written}");
    let found = identified(folder.path());
    for (name, at) in [("x", 40.0), ("y", -60.0), ("z", -250.0)] {
        let name = format!("points.csv:target.{name}");
        let target = found.parameters.iter().find(|p| p.name == name);
        let target = target.expect("the target");
        assert!((target.value - at).abs() < 5.0, "{name} {}", target.value);
        let uncertainty = target.uncertainty.expect("determined");
        assert!((uncertainty - 1.0).abs() < 0.1, "{name} {uncertainty}");
    }
}

/// The approach direction of the first row is random, as on a real machine: that row deviates by half the reversal value to either side,
/// never by the mean.
#[test]
fn the_first_row_comes_from_a_side_that_is_drawn() {
    const TRUTH: &str = "structure = \"w b X Y Z t\"
axes = { X.travel = [0, 600], Y.travel = [0, 600], Z.travel = [0, 600] }
[errors]
EXX = { mean = { poly = [0.0] }, reversal = 20.0 }
";
    for [table_of, column] in rows(
        r#"
kind = "points"\nposes = 5\nframe = [0, 0, 0, 0, 0, 0]\n | x
kind = "distance"\nposes = 5\npoint = [-500, 300, 300]\n | length_mm
"#,
    ) {
        let mut seen = [0; 2];
        for seed in 0..40 {
            let folder = tempfile::tempdir().expect("a folder");
            let folder = folder.path();
            let text = format!(
                "seed = {seed}\nunknown = [{{ error = \"EXX\", reversal = true }}]\n[[observation]]\nfile = \"o\"\n{table_of}noise_um = 0.0\nresolution_um = 0.0\n"
            );
            write(&shop(folder, TRUTH, &text), folder);
            let (header, rows) = table(folder, "o.csv");
            let number = |name: &str| {
                let place = header.iter().position(|head| head == name);
                let cell = &rows[0][place.expect("a column")];
                cell.parse::<f64>().expect("a number")
            };
            let at = Vector3::new(number("X"), number("Y"), number("Z"));
            let read = |along_mm: f64| {
                let tip = at + Vector3::x() * along_mm;
                if column == "x" {
                    tip.x
                } else {
                    (tip - Vector3::new(-500.0, 300.0, 300.0)).norm()
                }
            };
            // Numbers are written to 1 nm.
            let is_from = [-0.01, 0.01].map(|along| (number(column) - read(along)).abs() < 3e-6);
            assert_ne!(is_from[0], is_from[1], "{seed}: {at} {}", number(column));
            seen[usize::from(is_from[1])] += 1;
        }
        assert!(seen.iter().all(|count| *count >= 8), "{seen:?}");
    }
}

/// C carries the table, 20 µm too far along X and −10 µm along Y; there are no other errors.
const TRUTH: &str = "structure = \"w C' X' b Y Z t\"
[axes]
C.travel = [0, 360]
X.travel = [-500, 500]
Y.travel = [-400, 400]
Z.travel = [-300, 300]
[errors]
EX0C = 20.0
EY0C = -10.0
";

fn planned_shop(folder: &Path, observation: &str, plan: &str) -> Result<Shop, ShopError> {
    fs::write(folder.join("truth.toml"), TRUTH).expect("written");
    fs::write(folder.join("plan.csv"), plan).expect("written");
    let text = format!(
        "machine = \"truth.toml\"\nunknown = [\"EX0C\", \"EY0C\"]\n[[observation]]\nposes = \"plan.csv\"\n{observation}"
    );
    fs::write(folder.join("shop.toml"), text).expect("written");
    Shop::read(&folder.join("shop.toml"))
}

fn made(folder: &Path, observation: &str, plan: &str) -> Observations {
    let shop = planned_shop(folder, observation, plan).expect("a valid shop");
    write(&shop, folder);
    Observations::read(&folder.join("observations.toml")).expect("read back")
}

/// Tool position in workpiece axes, mm, with the axes at x, y and C: positive C moves the tool right-handed about the actual axis.
fn tip(x: f64, y: f64, c: f64, axis: [f64; 2]) -> [f64; 2] {
    let (s, k) = c.to_radians().sin_cos();
    let (dx, dy) = (x - axis[0], y - axis[1]);
    [axis[0] + k * dx - s * dy, axis[1] + s * dx + k * dy]
}

/// In an R-test at planned angles the linear axes move to the nominal sphere, and the offset is the effect of the displaced axis.
#[test]
fn angles_alone_let_the_linear_axes_follow() {
    let folder = tempfile::tempdir().expect("a folder");
    let sphere = "kind = \"sphere\"\nreads = \"offset\"\ncentres = [[150, 50, 20]]\n";
    let angles = [0.0, 300.0, 45.0, 123.5];
    let plan = angles.map(|c| c.to_string()).join("\n");
    let found = made(folder.path(), sphere, &format!("C_deg\n{plan}"));
    let rows = &found.observations[0].rows;
    assert_eq!(rows.len(), angles.len());
    for (row, c) in rows.iter().zip(angles) {
        let [_, x, y, z] = [0, 1, 2, 3].map(|place| row.pose.state.q[place]);
        assert!((row.pose.state.q[0].to_degrees() - c).abs() < 1e-9);
        assert!((z - 20.0).abs() < 1e-3);
        let nominal = tip(x, y, c, [0.0, 0.0]);
        assert!((nominal[0] - 150.0).abs() < 1e-3 && (nominal[1] - 50.0).abs() < 1e-3);
        let expected = tip(x, y, c, [0.020, -0.010]);
        let RowReading::Sphere { offset_mm, .. } = &row.reading else {
            panic!("a sphere");
        };
        for (read, real) in offset_mm.iter().zip([expected[0] - 150.0, expected[1] - 50.0]) {
            assert!((read - real).abs() < 2e-6, "{c}: {read} for {real}");
        }
    }
}

#[test]
fn rows_alternate_between_spheres() {
    let folder = tempfile::tempdir().expect("a folder");
    let spheres = "kind = \"sphere\"\ncentres = [[150, 0, 20], [0, 150, 120]]\n";
    made(folder.path(), spheres, "sphere,C\nS2,0\nS1,90\nS2,180\n");
    let text = fs::read_to_string(folder.path().join("sphere.csv")).expect("made");
    let cells: Vec<Vec<&str>> =
        text.lines().skip(1).map(|line| line.split(',').collect()).collect();
    let order: Vec<[&str; 2]> = cells.iter().map(|row| [row[0], row[4]]).collect();
    assert_eq!(order, [["0", "S2"], ["90", "S1"], ["180", "S2"]]);
    // A touch probe records machine coordinates; checked for S1 at C = 90°.
    let at: Vec<f64> = cells[1][1..4].iter().map(|q| q.parse().expect("a number")).collect();
    let [x, y] = tip(at[0], at[1], 90.0, [0.020, -0.010]);
    assert!((x - 150.0).abs() < 2e-6 && y.abs() < 2e-6, "{x} {y}");
}

#[test]
fn commands_of_a_tracker_are_those_of_the_plan() {
    let folder = tempfile::tempdir().expect("a folder");
    let plan = "Z mm,X,C\n-100,20,0\n50.5,-300,90\n300,500,359\n";
    made(folder.path(), "kind = \"points\"\nat = { Y = 25 }\n", plan);
    let text = fs::read_to_string(folder.path().join("points.csv")).expect("made");
    let at: Vec<String> = text
        .lines()
        .skip(1)
        .map(|line| line.split(',').take(4).collect::<Vec<_>>().join(","))
        .collect();
    assert_eq!(at, ["0,20,25,-100", "90,-300,25,50.5", "359,500,25,300"]);
}

#[test]
fn files_that_were_read_are_named() {
    let folder = tempfile::tempdir().expect("a folder");
    let shop = planned_shop(folder.path(), "kind = \"points\"\n", "X\n1\n").expect("valid");
    let names = ["shop.toml", "truth.toml", "plan.csv"];
    assert_eq!(shop.inputs, names.map(|name| folder.path().join(name)));
}

#[test]
fn what_is_wrong_with_a_plan_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    for [observation, plan, expected] in rows(
        r#"
kind = "points"\n | X,A\n0,0\n | plan.csv:1: header: found a column `A`
kind = "points"\n | x\n0\n | found a column `x`, expected the letters
kind = "points"\n | X_in\n0\n | found a column `X_in`
kind = "points"\n | X,X mm\n0,0\n | found two columns of X
kind = "points"\n | X\n | found 0 rows, expected 1 to 100000
kind = "points"\n | X\nnan\n | plan.csv:2: X: found `nan`
kind = "points"\n | X\n0\n501\n | plan.csv:3: X: found 501 mm, expected a position within the travel of X, -500 to 500 mm
kind = "points"\nat = { X = 3 }\n | X\n0\n | which `at` of the shop file holds
kind = "sphere"\ncentres = [[150, 0, 20], [0, 150, 120]]\n | C\n0\n | found no column `sphere`
kind = "sphere"\ncentres = [[150, 0, 20], [0, 150, 120]]\n | C,sphere\n0,S3\n | plan.csv:2: sphere: found `S3`, expected one of the spheres S1 to S2
kind = "distance"\npoint = [0, 0, 0]\nradius_mm = 100\n | X\n0\n | radius_mm
kind = "sphere"\ncentres = [[150, 0, 20]]\n | X,Y,Z\n150,0,20\n150,3,20\n | the observation sphere: row 2 of the plan: found the tool 3.000 mm from sphere S1, expected at most 2 mm
kind = "sphere"\ncentres = [[600, 0, 0]]\n | C\n90\n0\n | row 1 of the plan: found no position within travel
"#,
    ) {
        let result =
            planned_shop(folder.path(), observation, plan).and_then(|shop| shop.files(|_, _| {}));
        let message = match result {
            Ok(_) => panic!("made: {plan}"),
            Err(error) => error.to_string(),
        };
        assert!(message.contains(expected), "{plan}: {message}");
    }
    let missing = "kind = \"points\"\nposes = \"nothing.csv\"\n";
    let text =
        format!("machine = \"truth.toml\"\nunknown = [\"EX0C\"]\n[[observation]]\n{missing}");
    fs::write(folder.path().join("shop.toml"), text).expect("written");
    let message = Shop::read(&folder.path().join("shop.toml")).expect_err("refused").to_string();
    assert!(message.contains("shop.toml:5:") && message.contains("nothing.csv"), "{message}");
}

//! Planned poses: readings equal a separate chain.

use std::{fs, path::Path};

use volcomp_identify::{Observations, RowReading};
use volcomp_shop::{Shop, ShopError};
use volcomp_test_support::rows;

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

fn shop(folder: &Path, observation: &str, plan: &str) -> Result<Shop, ShopError> {
    fs::write(folder.join("truth.toml"), TRUTH).expect("written");
    fs::write(folder.join("plan.csv"), plan).expect("written");
    let text = format!(
        "machine = \"truth.toml\"\nunknown = [\"EX0C\", \"EY0C\"]\n[[observation]]\nposes = \"plan.csv\"\n{observation}"
    );
    fs::write(folder.join("shop.toml"), text).expect("written");
    Shop::read(&folder.join("shop.toml"))
}

fn made(folder: &Path, observation: &str, plan: &str) -> Observations {
    let shop = shop(folder, observation, plan).expect("a valid shop");
    for (name, text) in shop.files(|_, _| {}).expect("made") {
        fs::write(folder.join(name), text).expect("written");
    }
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
    let shop = shop(folder.path(), "kind = \"points\"\n", "X\n1\n").expect("valid");
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
        let result = shop(folder.path(), observation, plan).and_then(|shop| shop.files(|_, _| {}));
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

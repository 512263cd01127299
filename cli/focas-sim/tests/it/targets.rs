//! Measurements at the targets of a program, compared with values by hand.

use std::{fs, path::Path};

use serde_json::Value;
use volcomp_focas::PmcArea;
use volcomp_test_support::machines::gantry;

use super::{PATIENCE, Simulator};

/// X has a positioning error of 50 µm/m, and moves Y by 10 µm everywhere.
const ERRORS: &str = "[errors]\nEXX = { poly = [0.0, 0.05] }\nEYX = 10.0\n";

/// A folder with a machine and a program, and the command line that runs the program.
struct Shop {
    folder: tempfile::TempDir,
}

impl Shop {
    fn new(program: &str) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let truth = gantry([[0.0, 200.0]; 3]) + ERRORS;
        fs::write(folder.path().join("truth.toml"), truth).unwrap();
        fs::write(folder.path().join("program.csv"), program).unwrap();
        Self { folder }
    }

    fn path(&self, name: &str) -> String {
        self.folder.path().join(name).to_str().unwrap().to_owned()
    }

    fn start(&self, report: &str, more: &[&str]) -> Simulator {
        let [truth, program, report] = ["truth.toml", "program.csv", report].map(|n| self.path(n));
        let arguments = [
            "--truth",
            &truth,
            "--program",
            &program,
            "--report",
            &report,
            "--report-s",
            "0",
            "--acceleration-mm-s2",
            "100000",
            "--json",
        ];
        Simulator::start(&[&arguments[..], more].concat())
    }
}

/// Rows of a table with their column names.
fn rows(file: &Path) -> Vec<Vec<(String, String)>> {
    let text = fs::read_to_string(file).unwrap();
    let mut lines = text.lines();
    let head: Vec<&str> = lines.next().unwrap().split(',').collect();
    let row = |line: &str| {
        let cells: Vec<&str> = line.split(',').collect();
        assert_eq!(cells.len(), head.len(), "{line}");
        let named = head.iter().zip(cells);
        named.map(|(n, c)| ((*n).to_owned(), c.to_owned())).collect()
    };
    lines.map(row).collect()
}

fn number(row: &[(String, String)], name: &str) -> f64 {
    let cell = row.iter().find(|(found, _)| found == name).unwrap();
    cell.1.parse().unwrap_or_else(|_| panic!("{name}: {cell:?}"))
}

/// Two lines and an intermediate point. The second pass has a correction of -4 µm on X and +3 µm on Y. The ranges equal
/// those calculated by hand within 0.002 µm. Along the diagonal of the plane of 200 × 150 mm the error of X has the
/// weight 0.8, which gives 8 µm at its end; a constant error has no effect.
#[test]
fn the_range_along_a_line_matches_the_hand_calculation() {
    let program = "line,X,Y,Z,feed\nalong,0,0,0,60000\nalong,100,0,0,60000\nalong,200,0,0,60000\n\
                   ,100,50,100,60000\nacross,0,0,0,60000\nacross,200,150,0,60000\n";
    let shop = Shop::new(program);
    let mut simulator = shop.start("targets.csv", &["--wait", "--no-barrier"]);
    simulator.type_line("run");
    let first = simulator.json();
    let line = |line: &str, targets: u32, um: f64| serde_json::json!({"line": line, "targets": targets, "range_without_um": um, "range_um": um});
    let expected = serde_json::json!({
        "pass": 1, "targets": 5, "not_settled": 0, "lines": [line("along", 3, 10.0), line("across", 2, 8.0)],
    });
    assert_eq!(first, expected);
    let words = [0xfc, 0xff, 0x03, 0x00];
    let mut client = simulator.client();
    client.write_pmc(PmcArea::R, 100, &words).unwrap();
    simulator.type_line("run");
    let second = simulator.json();
    assert_eq!(second["pass"], 2);
    for (found, range) in second["lines"].as_array().unwrap().iter().zip([10.0, 8.0]) {
        let of = |name: &str| found[name].as_f64().unwrap();
        // The error is that of the true position. A correction of 4 µm on X changes it by 0.0002 µm.
        assert!((of("range_um") - range).abs() < 0.002, "{found}");
        assert_eq!(of("range_without_um"), range);
    }
    let rows = rows(&shop.folder.path().join("targets.csv"));
    assert_eq!(rows.len(), 10);
    for (index, row) in rows.iter().enumerate() {
        let corrected = index >= 5;
        let x = number(row, "X");
        assert_eq!(number(row, "settled"), 1.0);
        assert!(number(row, "stood_s") >= 0.2);
        let [dx, dy] = if corrected { [-4.0, 3.0] } else { [0.0, 0.0] };
        assert_eq!([number(row, "X_um"), number(row, "Y_um")], [dx, dy]);
        for (name, value) in [
            ("error_x_um", 0.05 * x),
            ("error_y_um", 10.0),
            ("residual_x_um", 0.05 * x + dx),
            ("residual_y_um", 10.0 + dy),
            ("residual_z_um", 0.0),
        ] {
            assert!((number(row, name) - value).abs() < 0.002, "{name}: {row:?}");
        }
    }
}

/// Without a column `line` every row is a target. Without `--wait` the program starts automatically. The extension
/// `.json` selects one JSON document per line.
#[test]
fn json_documents_are_one_per_line() {
    let shop = Shop::new("X,feed,dwell_s\n0,60000,0\n200,60000,0.4\n");
    let mut simulator = shop.start("targets.json", &[]);
    let pass = simulator.json();
    assert_eq!((&pass["targets"], &pass["lines"]), (&2.into(), &Value::Array(vec![])));
    let text = fs::read_to_string(shop.folder.path().join("targets.json")).unwrap();
    let targets: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).unwrap()).collect();
    assert_eq!(targets.len(), 2);
    assert_eq!(targets[1]["positions_mm"]["X"], 200.0);
    assert_eq!(targets[1]["residual"]["position_um"], serde_json::json!([10.0, 10.0, 0.0]));
    assert!(targets[1]["stood_s"].as_f64().unwrap() >= 0.4);
    simulator.type_line("quit");
    assert_eq!(simulator.end(), Some(0));
}

#[test]
fn nothing_is_measured_during_an_emergency_stop() {
    // A move of 200 mm at 10 mm/s.
    let shop = Shop::new("line,X,feed\na,0,60000\na,200,600\n");
    let mut simulator = shop.start("targets.csv", &["--wait", "--no-barrier"]);
    let file = shop.folder.path().join("targets.csv");
    let mut client = simulator.client();
    let mut x = move || client.positions(volcomp_focas::PositionKind::Machine, 3).unwrap()[0];
    simulator.type_line("run");
    super::until("it moves", || x() > 1.0);
    simulator.type_line("estop on");
    super::is_stopped(&simulator);
    let stands = x();
    assert!(stands < 199.0, "{stands} mm");
    assert_eq!(rows(&file).len(), 1);
    simulator.type_line("estop off");
    volcomp_test_support::until("the second target", 3 * PATIENCE, || rows(&file).len() == 2);
}

/// Text output has at most 80 columns. Commands that need a report are rejected without one.
#[test]
fn text_output_for_operators() {
    let shop = Shop::new("line,X,feed\nPPP,0,60000\nPPP,200,60000\n");
    let [truth, program, report] = ["truth.toml", "program.csv", "r.csv"].map(|n| shop.path(n));
    let arguments = ["--truth", &truth, "--program", &program, "--report-s", "0", "--report"];
    let mut simulator = Simulator::start(&[&arguments[..], &[&report]].concat());
    assert_eq!(simulator.line(), "pass 1: 2 targets; PPP 10.0 → 10.0 µm\n");
}

#[test]
fn an_unwritable_file_is_named() {
    let shop = Shop::new("X\n0\n");
    let [truth, program] = ["truth.toml", "program.csv"].map(|name| shop.path(name));
    let output = std::process::Command::new(env!("CARGO_BIN_EXE_focas-sim"))
        .args(["--truth", &truth, "--program", &program, "--report", "/dev/null/x.csv"])
        .output()
        .unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{message}");
    assert!(message.contains("/dev/null/x.csv: cannot be written"), "{message}");
}

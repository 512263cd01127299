//! Values, ranges, temperatures, tools, diagonals, maps and the largest correction, compared with closed forms.

use volcomp_kinematics::{CorrectionOptions, ErrorSource, Form, State};
use volcomp_model::{Machine, MapGrid, Temperatures, corrected, diagonals, quantised};
use volcomp_test_support::machines::gantry;
use volcomp_vocabulary::{AxisName, Direction, ErrorName, PerAxis};

use crate::EXAMPLE;

fn machine(text: &str) -> Machine {
    Machine::parse(text, "machine.toml").expect("a valid machine")
}

fn plain(errors: &str) -> Machine {
    let axes = gantry([[0.0, 1000.0], [0.0, 500.0], [-400.0, 0.0]]);
    machine(&format!("{axes}[errors]\n{errors}"))
}

fn linear_um(machine: &Machine, axis: usize, state: &State) -> [f64; 3] {
    let motion = machine.source(&Temperatures::new()).error_motion(axis, state);
    (motion.linear_mm * 1e3).into()
}

#[test]
fn every_kind_of_curve_has_its_value() {
    let machine = machine(EXAMPLE);
    // Chain order: C X Y Z.
    let mut state = machine
        .state(&[
            (AxisName::C, 90.0),
            (AxisName::X, 200.0),
            (AxisName::Y, 250.0),
            (AxisName::Z, 850.0),
        ])
        .unwrap();
    let [exx, eyx, ezx] = linear_um(&machine, 1, &state);
    let t = 2.0 * 200.0 / 8000.0 - 1.0;
    assert!((exx - (0.0073 * 200.0 - 2.1e-7 * 4e4)).abs() < 1e-12);
    assert!((eyx - (0.4 - 1.2 * t + 3.0 * (2.0 * t * t - 1.0))).abs() < 1e-12);
    assert!((ezx - 0.75).abs() < 1e-12);
    // Grid: in Y half-way between 0 and 0.5, in Z half-way between 650 and 1050.
    assert!((linear_um(&machine, 2, &state)[2] - 1.75).abs() < 1e-12);
    assert!((linear_um(&machine, 3, &state)[1] - (1.0 + 850.0 / 1250.0)).abs() < 1e-12);
    let motion = machine.source(&Temperatures::new()).error_motion(0, &state);
    assert!((motion.angular_rad.x * 1e6 - (0.5 - 1.2)).abs() < 1e-12);
    for (approach, value) in
        [(Some(Direction::Positive), 1.0), (Some(Direction::Negative), 3.5), (None, 2.25)]
    {
        state.approach[2] = approach;
        assert!((linear_um(&machine, 2, &state)[0] - value).abs() < 1e-12);
    }
}

#[test]
fn travel_in_radians_is_noted() {
    let notes = |travel: &str| {
        let text = format!(
            "structure = \"w C' b X t\"\n[axes]\nX.travel = [0.0, 3.14]\nC.travel = {travel}\n"
        );
        machine(&text).notes()
    };
    for (travel, in_deg) in [
        ("[-3.14, 3.14]", "-180 to 180 deg"),
        ("[0, 6.2832]", "0 to 360 deg"),
        ("[-1.5708, 2.094]", "-90 to 120 deg"),
        ("[-0.7853981633974483, 4.712]", "-45 to 270 deg"),
    ] {
        let found = notes(travel);
        assert!(
            found.len() == 1
                && found[0].starts_with("travel of C: ")
                && found[0].contains(in_deg)
                && found[0].contains("is it stated in radians?"),
            "{travel}: {found:?}"
        );
    }
    // Travels that do not look like radians: a table of small tilts, a full circle, only one matching end, unusual fractions.
    for travel in ["[-3, 3]", "[0, 360]", "[-3.14, 90]", "[-5.5, 5.5]", "[0, 6]"] {
        assert_eq!(notes(travel), Vec::<String>::new(), "{travel}");
    }
}

#[test]
fn names_what_is_outside_its_range_sorted() {
    let machine = machine(EXAMPLE);
    let state = machine.state(&[(AxisName::X, 9000.0), (AxisName::Y, 600.0)]).unwrap();
    let names: Vec<String> =
        machine.outside_range(&state).iter().map(ErrorName::to_string).collect();
    assert_eq!(names, ["EXX", "EYX", "EZX", "EZY"]);
    assert_eq!(machine.outside_travel(&state), [AxisName::X]);
    assert!((linear_um(&machine, 1, &state)[2] - 1.5).abs() < 1e-12, "end value held");
}

#[test]
fn expansion_and_drift_add_to_their_errors() {
    let machine = machine(EXAMPLE);
    let state = machine.state(&[(AxisName::X, 1100.0)]).unwrap();
    let temperatures: Temperatures = [("scale_x", 22.0), ("spindle", 31.0), ("bed", 21.0)]
        .map(|(name, degc)| (name.to_owned(), degc))
        .into();
    let cold = machine.source(&Temperatures::new());
    let warm = machine.source(&temperatures);
    let change = |axis| {
        (warm.error_motion(axis, &state).linear_mm - cold.error_motion(axis, &state).linear_mm)
            * 1e3
    };
    assert!((change(1).x - 11.5 * 2.0).abs() < 1e-9, "1 m from the fixed point, 2 K");
    assert!((change(3).z - 32.0).abs() < 1e-9);
    let without_bed: Temperatures = [("spindle".to_owned(), 31.0)].into();
    let partial = machine.source(&without_bed).error_motion(3, &state);
    assert_eq!(partial, cold.error_motion(3, &state), "a term with a missing sensor is left out");
}

#[test]
fn tools_override_the_tool() {
    let mut machine = machine(EXAMPLE);
    assert_eq!(machine.chain().tool_tip_mm().z, -150.0);
    machine.select_tool("T5").unwrap();
    assert_eq!(machine.chain().tool_tip_mm().z, -250.0);
    let message = machine.select_tool("T6").unwrap_err().to_string();
    assert!(message.contains("T6") && message.contains("T5"), "{message}");
    let gauge = plain("")
        .to_toml()
        .replace("[tool]", "[tool]\ngauge = [1.0, 2.0, 3.0]\nlength = 100.0\noffset = [0.5, 0.0, 0.0]\naxis = [0, 0, 2]")
        .lines()
        .filter(|line| !line.starts_with("checksum"))
        .fold(String::new(), |text, line| text + line + "\n");
    let tip: [f64; 3] = self::machine(&gauge).chain().tool_tip_mm().into();
    assert_eq!(tip, [1.5, 2.0, -97.0]);
}

#[test]
fn modulo_brings_the_coordinate_into_travel() {
    let machine = machine(
        "structure = \"w C' b X t\"\n[axes]\nX.travel=[0,1]\nC = { travel = [0, 360], modulo = 360 }\n[errors]\nEXC = { table = [[0, 1], [90, 2], [360, 1]] }",
    );
    for (degrees, value) in [(90.0, 2.0), (450.0, 2.0), (-270.0, 2.0), (360.0, 1.0)] {
        let state = machine.state(&[(AxisName::C, degrees)]).unwrap();
        assert!((linear_um(&machine, 0, &state)[0] - value).abs() < 1e-9, "{degrees}");
        assert!(machine.outside_range(&state).is_empty());
    }
}

#[test]
fn diagonals_of_a_scale_error_and_of_squareness() {
    // EXX = 10 µm over 1000 mm: along a diagonal (1000, 500, 400)/L its component is 10·1000/L.
    let length = (1000.0_f64.powi(2) + 500.0_f64.powi(2) + 400.0_f64.powi(2)).sqrt();
    let of = |errors: &str| {
        let machine = plain(errors);
        diagonals(&machine, &machine.source(&Temperatures::new()), 20, &[], |s| *s).unwrap()
    };
    let names: Vec<_> = of("EXX = { poly = [0, 0.01] }")
        .iter()
        .map(|d| {
            assert_eq!(d.deviation_um.len(), 20);
            assert_eq!(d.deviation_um[0], 0.0);
            assert!((d.range_um - 10.0 * 1000.0 / length).abs() < 1e-6, "{}", d.range_um);
            d.name
        })
        .collect();
    assert_eq!(names, ["PPP", "NPP", "PNP", "PPN"]);
    // A squareness of 20 µrad moves X by −20·500·1e-3 = −10 µm at the far end of Y: PPP is shorter, NPP longer.
    let square = of("EC0Y = 20.0");
    let share = 10.0 * 1000.0 / length;
    let last = |d: &volcomp_model::Diagonal| d.deviation_um[19];
    for (diagonal, sign) in square.iter().zip([-1.0, 1.0, 1.0, -1.0]) {
        assert!((last(diagonal) - sign * share).abs() < 1e-3, "{}", diagonal.name);
    }
}

#[test]
fn correction_leaves_the_diagonals_straight() {
    let machine = plain("EXX = { poly = [0, 0.03] }\nEC0Y = 20.0\nEAY = { poly = [0, 0.05] }");
    let none = Temperatures::new();
    let source = machine.source(&none);
    let correct = |s: &State| {
        corrected(s, &machine.correction_at(s, &none, &CorrectionOptions::default()).delta)
    };
    for diagonal in diagonals(&machine, &source, 11, &[], correct).unwrap() {
        assert!(diagonal.range_um < 1e-4, "{} {}", diagonal.name, diagonal.range_um);
    }
    let rounded = quantised(&machine, &PerAxis::leading([0.0014, -0.0006]), 1e-3, 1e-6);
    assert_eq!(rounded[..3], [0.001, -0.001, 0.0]);
}

#[test]
fn the_map_visits_every_node_x_fastest() {
    let machine = plain("EXX = { poly = [0, 0.01] }");
    let grid = MapGrid::over_travels(&machine, [3, 2, 1], &[]).unwrap();
    assert_eq!(grid.len(), 6);
    for (index, at_mm) in [(1, [500.0, 0.0, -200.0]), (3, [0.0, 500.0, -200.0])] {
        let (found, state) = grid.node(&machine, index);
        assert_eq!(found, at_mm);
        let error = machine.error_at(&state, Form::Exact, &Temperatures::new());
        assert!((error.position_mm.x - 1e-5 * at_mm[0]).abs() < 1e-12);
    }
}

/// Equidistant samples every 25 mm would miss the peak of EXX, and samples at Y = 0 would miss the grid EZX.
#[test]
fn differences_of_two_machines_are_found_wherever_they_are() {
    let one = plain(
        "EXX = { table = [[0, 0], [300, 0], [312, 5], [325, 0], [1000, 0]], interpolation = \"linear\" }\nEC0Y = 7.0",
    );
    let other = plain(
        "EZX = { grid = { axes = [\"X\", \"Y\"], nodes = [[0, 1000], [0, 500]], values = [[0, 0], [0, 4]] } }",
    );
    let found = one.differences(&other);
    assert_eq!(found.len(), 3, "{found:?}");
    for (name, expected) in [("EC0Y", 7.0), ("EXX", 5.0), ("EZX", 4.0)] {
        let by = found.iter().find(|(error, _)| error.to_string() == name);
        assert!(by.is_some_and(|(_, by)| (by - expected).abs() < 1e-6), "{name}: {found:?}");
    }
    assert!(one.differences(&one).iter().all(|(_, by)| *by == 0.0));
}

/// EXX is 10 µm/m over 0.8 m; the bed adds 2 µm/K, the head subtracts 3 µm/K, and the scale expands by 11 µm/(m·K).
const MACHINE: &str = r#"
structure = "w X b Y Z t"
[axes.X]
travel = [0.0, 800.0]
[axes.Y]
travel = [0.0, 400.0]
[axes.Z]
travel = [0.0, 250.0]
[errors]
EXX = { poly = [0.0, 0.01] }
"#;

/// The change of the largest correction per kelvin is the sum of the absolute effects of the sensors.
#[test]
fn each_kelvin_changes_the_largest_correction_by_the_sum_over_the_sensors() {
    const DRIFT: &str = "[[thermal.drift]]\nerror = \"EXX\"\nsensors = { bed = 2.0, head = -3.0 }\num_per_k = 1.0\n";
    const SCALE: &str =
        "[[thermal.expansion]]\nerror = \"EXX\"\nsensor = \"scale\"\num_per_m_k = 11.0\n";
    const OF_BED: &str =
        "[[thermal.expansion]]\nerror = \"EXX\"\nsensor = \"bed\"\num_per_m_k = 11.0\n";
    const SEEN: &str = "[[thermal.seen]]\nerror = \"EXX\"\nsensor = \"bed\"\ndegc = [22.0, 30.0]\n";
    for (terms, um_per_k) in [
        (DRIFT.to_owned(), 5.0),
        (SCALE.to_owned(), 8.8),
        (format!("{SCALE}{DRIFT}"), 13.8),
        // The sensor `bed` in two terms counts once: 3 µm/K from the head, 2 + 8.8 µm/K from the bed.
        (format!("{OF_BED}{DRIFT}"), 13.8),
        // The reference may be outside the tested range.
        (format!("{DRIFT}{SEEN}"), 5.0),
    ] {
        let machine = Machine::parse(&format!("{MACHINE}{terms}"), "m").unwrap();
        let found = machine.largest_corrections_per_k().unwrap()[0].1.um_or_urad();
        assert!((found - um_per_k).abs() < 1e-6, "{terms}: {found}");
        let at_reference =
            machine.largest_corrections(&Temperatures::new()).unwrap()[0].1.um_or_urad();
        assert!((at_reference - 8.0).abs() < 1e-6, "{at_reference}");
    }
    let machine = Machine::parse(MACHINE, "m").unwrap();
    assert!(machine.largest_corrections_per_k().unwrap().is_empty());
}

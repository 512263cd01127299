//! Losses of tables, compared with closed forms.

use volcomp_tables::axis_table::{
    self, AxisLoss, AxisNumbers, Category, Facts, Format, Loss, TableOptions, WriteOptions, loss,
    sampled,
};
use volcomp_tables::model::{Machine, Temperatures};
use volcomp_tables::vocabulary::AxisName;

use super::{close, machine::example};

fn machine(errors: &str) -> Machine {
    Machine::parse(
        &format!(
            "structure = \"w X' b Y Z t\"\n[axes]\nX.travel = [0.0, 1200.0]\nY.travel = [0.0, 1200.0]\nZ.travel = [0.0, 1200.0]\n{errors}"
        ),
        "m.toml",
    )
    .expect("a machine")
}

fn lost(machine: &Machine, format: Format, step_mm: f64) -> Loss {
    let options = TableOptions { step_mm, ..TableOptions::default() };
    lost_by(machine, format, &options)
}

fn lost_by(machine: &Machine, format: Format, options: &TableOptions) -> Loss {
    let none = Temperatures::new();
    loss(machine, &none, options, format, &writing(machine)).expect("compared")
}

fn writing(machine: &Machine) -> WriteOptions {
    WriteOptions { axes: AxisNumbers::of_machine(machine), ..WriteOptions::default() }
}

fn of_axis(axes: &[AxisLoss], axis: AxisName) -> &AxisLoss {
    let found = axes.iter().find(|found| found.axis == axis);
    found.expect("it is there")
}

/// Largest loss of an axis, µm.
fn um(loss: &Loss, category: Option<Category>, axis: AxisName) -> f64 {
    let mut categories = loss.categories.iter();
    let axes = match category {
        None => &loss.axes,
        Some(wanted) => {
            let found = categories.find(|found| found.category == wanted);
            &found.expect("it is there").axes
        }
    };
    of_axis(axes, axis).largest
}

/// Asserts the maximum loss of a category in tables with a step of 100 mm, µm.
fn loses(machine: &Machine, format: Format, what: Category, axis: AxisName, by: f64, within: f64) {
    close(um(&lost(machine, format, 100.0), Some(what), axis), by, within);
}

use AxisName::{X, Y, Z};

#[test]
fn straight_lines_lose_the_bend_between_nodes() {
    // The loss is c h² / 4 in the middle of a step h: 1e-4 µm/mm² × 200² / 4 = 1 µm.
    let machine = machine("[errors]\nEXX = { poly = [0.0, 0.0, 1.0e-4] }\n");
    let found = lost(&machine, Format::Csv, 200.0);
    assert!(found.poses > 13 * 13 * 13);
    close(um(&found, None, X), 1.0, 2e-3);
    close(um(&found, Some(Category::Positioning), X), 1.0, 2e-3);
    assert_eq!(found.categories.len(), 1);
    let x = &found.axes[0];
    let at = x.at[&X];
    assert!((at / 100.0).round() % 2.0 == 1.0, "in the middle of a step: {at}");
    // Half the step has a quarter of the loss. The poses spread over the travel are also 100 mm apart and would miss it.
    let finer = lost(&machine, Format::Csv, 100.0);
    close(um(&finer, None, X), 0.25, 2e-3);
    assert!(finer.axes[0].rms > 0.05, "{:?}", finer.axes[0]);
}

/// An error that is zero at every table position is lost and reported; a model with no other error is rejected with the reason.
#[test]
fn an_error_with_the_period_of_the_step_is_lost() {
    let screw = "EXX = { fourier = [0.0, 0.0, 5.0], period = 10.0 }\n";
    let machine = machine(&format!("[errors]\n{screw}EYX = {{ poly = [0.0, 0.01] }}\n"));
    close(um(&lost(&machine, Format::Csv, 50.0), None, X), 5.0, 0.05);
    let alone = self::machine(&format!("[errors]\n{screw}"));
    let options = TableOptions::default();
    let write = writing(&alone);
    let none = Temperatures::new();
    let content = sampled(&alone, &none, &options, Format::Csv).expect("tables");
    let message = volcomp_tables::axis_table::write(Format::Csv, &content, &write);
    let message = message.expect_err("refused").to_string();
    assert!(message.contains("at its positions") && message.contains("--step"), "{message}");
}

#[test]
fn squareness_is_a_table_over_another_axis() {
    // EC0Y = 20 µrad: 24 µm in X at the end of Y.
    let machine = machine("[errors]\nEC0Y = 20.0\n");
    for (format, um) in [(Format::Csv, 0.0), (Format::Siemens840d, 0.0), (Format::Linuxcnc, 24.0)] {
        loses(&machine, format, Category::Squareness, X, um, 2e-3);
    }
}

#[test]
fn levers_are_those_of_the_reference_position() {
    // EBX = 0.05 µrad/mm: 60 µrad at the end, times 1200 mm of Z from the reference position: 72 µm.
    let machine = machine("[errors]\nEBX = { poly = [0.0, 0.05] }\n");
    for format in [Format::Csv, Format::Siemens840d, Format::HeidenhainTnc640, Format::Linuxcnc] {
        loses(&machine, format, Category::Angular, X, 72.0, 0.2);
    }
    // Component errors are applied with their lever arm, so nothing is lost.
    loses(&machine, Format::IsgCsv, Category::Angular, X, 0.0, 0.02);
}

#[test]
fn reversal_is_lost_where_a_format_has_one_value() {
    let machine = machine(
        "[errors]\nEXX = { mean = { poly = [0.0, 0.01] }, reversal = 6.0 }\nEYX = { mean = 0.0, reversal = 4.0 }\n",
    );
    for (format, [x, y]) in [
        (Format::Csv, [0.0, 0.0]),
        (Format::Siemens840d, [3.0, 0.0]),
        (Format::Linuxcnc, [0.0, 2.0]),
        (Format::HeidenhainTnc640, [0.0, 2.0]),
        (Format::IsgCsv, [3.0, 2.0]),
    ] {
        let found = lost(&machine, format, 100.0);
        for (axis, expected) in [(X, x), (Y, y)] {
            close(um(&found, Some(Category::Reversal), axis), expected, 0.01);
        }
    }
    let found = lost(&machine, Format::Siemens840d, 100.0);
    assert!(found.axes[0].direction.is_some());
}

#[test]
fn a_second_coordinate_is_lost_away_from_the_line() {
    let machine = machine(
        "[errors]\nEZY = { grid = { axes = [\"Y\", \"Z\"], nodes = [[0, 1200], [0, 1200]], values = [[0.0, 0.0], [10.0, 18.0]] } }\n",
    );
    loses(&machine, Format::Csv, Category::SecondCoordinate, Z, 8.0, 0.01);
}

#[test]
fn the_thermal_loss_is_the_effect_of_1_k() {
    let machine = machine(
        "[thermal]\nreference = 20.0\n[[thermal.expansion]]\nerror = \"EXX\"\nsensor = \"scale\"\num_per_m_k = 11.5\nfixed_mm = 0.0\n[errors]\nEXX = 0.0\nEYX = { poly = [0.0, 0.001] }\n",
    );
    // 11.5 µm/(m·K) × 1.2 m.
    loses(&machine, Format::Csv, Category::Thermal, X, 13.8, 0.01);
}

#[test]
fn every_format_is_compared_for_every_example() {
    for name in ["gantry.toml", "mill.toml", "five-axis.toml"] {
        let machine = example(name);
        for format in Format::ALL {
            let options = TableOptions { step_mm: 100.0, ..TableOptions::default() };
            let reference = options.reference(&machine).expect("within travel");
            let write = WriteOptions {
                facts: Facts::of(&machine, reference, String::new()),
                ..writing(&machine)
            };
            let content = sampled(&machine, &Temperatures::new(), &options, format);
            let written = axis_table::write(format, &content.expect("tables"), &write);
            let files = written.expect("files").files;
            let texts: String = files.into_iter().map(|file| file.text).collect();
            for words in "actual - commanded,sha256:,Reference position,Directions:,rov".split(',')
            {
                assert!(texts.contains(words), "{name} {format}: {words}");
            }
            let found = loss(&machine, &Temperatures::new(), &options, format, &write);
            let found = found.unwrap_or_else(|message| panic!("{name} {format}: {message}"));
            assert!(found.poses > 1000, "{name} {format}");
            for axis in &found.axes {
                let is_whole = axis.at.len() == machine.axes().len();
                assert!(axis.rms <= axis.largest && is_whole, "{format} {axis:?}");
            }
        }
    }
}

/// The interpolation error is found within 10 % at any step, even if compared poses coincide with table nodes.
#[test]
fn the_bend_between_nodes_is_found_at_any_step() {
    let machine = machine("[errors]\nEXX = { poly = [0.0, 0.0, 1.0e-4] }\n");
    for step_mm in [200.0, 100.0, 50.0] {
        let bend_um = 1e-4 * step_mm * step_mm / 4.0;
        let found = um(&lost(&machine, Format::Csv, step_mm), None, X);
        assert!(
            (found - bend_um).abs() < 0.1 * bend_um,
            "step {step_mm}: {found} µm, expected {bend_um} µm"
        );
    }
}

/// The last midpoint of a turn that starts within the travel is outside it; the equivalent position within the travel is compared.
#[test]
fn the_midpoint_beyond_the_end_of_a_turn_is_compared() {
    let tops = 15.0;
    let (sin, cos) = f64::to_radians(tops).sin_cos();
    let (sin_2, cos_2) = f64::to_radians(2.0 * tops).sin_cos();
    // 10 µm (cos φ + cos 2φ) with φ from 15°: the largest loss is midway between the nodes at ∓45°, 10 (2 − cos 45°) µm. Midway on the
    // opposite side it is 10 (1 − (1 − cos 45°)) µm, and next to it at most that.
    let machine = Machine::parse(
        &format!(
            "structure = \"w C' X' b Y Z t\"\n[axes]\nX.travel = [0.0, 100.0]\nY.travel = [0.0, 100.0]\nZ.travel = [0.0, 100.0]\n\
             C = {{ travel = [0.0, 360.0], modulo = 360.0 }}\n[errors]\n\
             EZC = {{ fourier = [0.0, {}, {}, {}, {}], period = 360.0 }}\n",
            10.0 * cos, 10.0 * sin, 10.0 * cos_2, 10.0 * sin_2
        ),
        "m.toml",
    )
    .expect("a machine");
    let options =
        TableOptions { step_deg: 90.0, at: vec![(AxisName::C, 60.0)], ..TableOptions::default() };
    let found = lost_by(&machine, Format::Csv, &options);
    let expected = 10.0 * (2.0 - f64::to_radians(45.0).cos());
    close(um(&found, None, Z), expected, 2e-3);
    close(of_axis(&found.axes, Z).at[&AxisName::C], tops, 1e-9);
}

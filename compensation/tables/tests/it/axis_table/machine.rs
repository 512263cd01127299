//! Tables of a machine equal the model's correction on the lines through the reference position.

use volcomp_tables::axis_table::{
    AxisNumbers, AxisTable, Content, ErrorTable, ErrorTables, ExchangeError, Format, ReadOptions,
    TableOptions, WriteOptions, curves, read, sampled, to_toml, write,
};
use volcomp_tables::model::{Machine, Temperatures};
use volcomp_tables::vocabulary::{AxisName, CorrectionLimit, Direction};

use super::{close, file};

pub(super) fn example(name: &str) -> Machine {
    Machine::read(volcomp_test_support::root().join("examples").join(name)).expect("an example")
}

fn tables(machine: &Machine, options: &TableOptions) -> Vec<AxisTable> {
    match sampled(machine, &Temperatures::new(), options, Format::Csv).expect("tables") {
        Content::Axes(tables) => tables,
        Content::Errors(_) => panic!("tables of axes"),
    }
}

#[test]
fn on_lines_through_the_reference_the_tables_sum_to_the_correction() {
    use AxisName::{A, B, C, X, Y, Z};
    let cases: [(&str, Vec<(AxisName, f64)>); 4] = [
        ("gantry.toml", vec![(X, 3000.0), (Y, 1250.0), (Z, 500.0)]),
        ("mill.toml", vec![(Z, -120.0)]),
        ("five-axis.toml", vec![(X, 100.0), (B, 40.0), (C, 75.0)]),
        ("trunnion.toml", vec![(A, -35.0)]),
    ];
    let steady = Temperatures::new();
    for (name, at) in cases {
        let machine = example(name);
        let options = TableOptions { at, ..TableOptions::default() };
        let tables = tables(&machine, &options);
        let standing =
            machine.state(&options.reference(&machine).expect("it stands")).expect("a state");
        let wanted = machine.correction_options();
        let index = |axis: AxisName| machine.index_of(axis).expect("an axis");
        let mut looked_at = 0;
        for table in &tables {
            let along = index(table.input);
            let [low, high] = machine.axes()[along].travel;
            for direction in Direction::BOTH {
                for &node in &table.positions {
                    let edge = table.input_in_file_unit(node);
                    if edge < low || edge > high {
                        continue;
                    }
                    let mut state = standing;
                    state.q[along] = node;
                    state.approach[along] = Some(direction);
                    let model = machine.correction_at(&state, &steady, &wanted);
                    let output = index(table.output);
                    let sum: f64 = tables
                        .iter()
                        .filter(|other| other.output == table.output)
                        .map(|other| {
                            other.deviation(
                                state.q[index(other.input)],
                                state.approach[index(other.input)],
                            )
                        })
                        .sum();
                    close(-sum, model.delta[output], 1e-8);
                    looked_at += 1;
                }
            }
            // The table of one axis over another is zero at the reference position.
            if table.input != table.output {
                close(table.deviation(standing.q[along], None), 0.0, 1e-9);
            }
        }
        assert!(looked_at > 20, "{name}: {looked_at}");
    }
}

#[test]
fn nodes_beyond_the_travel_keep_its_end() {
    let machine = Machine::parse(
        "structure = \"w b X t\"\n[axes.X]\ntravel = [-30.0, 175.0]\n[errors]\nEXX = { poly = [1.0, 0.1, 0.001] }\n",
        "m.toml",
    )
    .expect("a machine");
    let tables = tables(&machine, &TableOptions { step_mm: 50.0, ..TableOptions::default() });
    assert_eq!(tables[0].positions, [-50.0, 0.0, 50.0, 100.0, 150.0, 200.0]);
    let steady = Temperatures::new();
    for end in [-30.0, 175.0] {
        let state = machine.state(&[(AxisName::X, end)]).expect("a state");
        let model = machine.correction_at(&state, &steady, &machine.correction_options());
        close(-tables[0].deviation(end, None), model.delta[0], 1e-9);
    }
    assert_eq!(tables[0].backward, None);
}

#[test]
fn reversal_makes_two_directions() {
    let machine = example("mill.toml");
    let tables = tables(&machine, &TableOptions::default());
    let z = tables
        .iter()
        .find(|table| (table.input, table.output) == (AxisName::Z, AxisName::Z))
        .expect("it is there");
    // The reversal value of the example, 3 µm, is forward − backward.
    let [forward, backward] = Direction::BOTH.map(|direction| z.deviation(-100.0, Some(direction)));
    close(forward - backward, 0.003, 1e-6);
}

#[test]
fn invalid_table_options_are_refused() {
    type Change = fn(&mut TableOptions);
    let machine = example("five-axis.toml");
    let cases: [(Change, &str); 4] = [
        (|o| o.step_mm = 0.0, "--step: found 0"),
        (|o| o.step_mm = 0.001, "at most 10000 steps"),
        (|o| o.step_deg = 7.0, "expected a whole part of 360"),
        (|o| o.at = vec![(AxisName::X, 900.0)], "--at X: found 900, expected 0 to 800, its travel"),
    ];
    for (change, expected) in cases {
        let mut options = TableOptions::default();
        change(&mut options);
        let refused = sampled(&machine, &Temperatures::new(), &options, Format::Csv);
        let message = refused.expect_err(expected).to_string();
        assert!(message.contains(expected), "{message}");
    }
}

#[test]
fn back_to_curves_of_the_machine_file() {
    let machine = example("mill.toml");
    let content = sampled(&machine, &Temperatures::new(), &TableOptions::default(), Format::Csv)
        .expect("tables");
    let text = to_toml(&curves(&content).expect("curves"));
    for name in ["EXX = ", "EYX = ", "EZZ = { forward = { table = ["] {
        assert!(text.contains(name), "{text}");
    }
    let whole = format!(
        "structure = \"w X' Y' b Z t\"\n[axes]\nX.travel = [0.0, 600.0]\nY.travel = [0.0, 400.0]\nZ.travel = [-500.0, 0.0]\n{text}"
    );
    let read = Machine::parse(&whole, "m.toml").expect("a part of a machine file");
    // 20 µm/m, plus the pitch of 0.05 µrad/mm times 530 mm from the table surface to the tool with Z at 0.
    let exx = read.error("EXX".parse().expect("a name")).expect("a curve");
    close(exx.value(0, &[300.0, 0.0, 0.0], None), 0.02 * 300.0 + 0.05 * 300.0 * 0.53, 0.01);
}

/// Tables of an axis with modulo are zero at the reference position, or the format is rejected; at the nodes their sum equals the model.
#[test]
fn tables_of_a_turn_are_zero_at_the_reference() {
    let machine = Machine::parse(
        "structure = \"w C' X' b Y Z t\"\n[axes]\nX.travel = [0.0, 400.0]\nY.travel = [0.0, 400.0]\nZ.travel = [-300.0, 0.0]\nC = { travel = [0.0, 360.0], modulo = 360.0 }\n[errors]\nEXC = { fourier = [0.0, 0.0, 10.0], period = 360.0 }\n",
        "m.toml",
    )
    .expect("a machine");
    let at = |deg: f64| TableOptions { at: vec![(AxisName::C, deg)], ..TableOptions::default() };
    let cold = Temperatures::new();
    let tables = |format, deg| sampled(&machine, &cold, &at(deg), format);
    // 40 is no multiple of the step of 15, 45 is.
    for deg in [40.0, 45.0, 359.0_f64] {
        let Content::Axes(found) = tables(Format::Csv, deg).expect("made") else {
            panic!("tables of axes");
        };
        let of = |output| {
            let mut tables = found.iter();
            tables.find(|table| (table.input, table.output) == (AxisName::C, output))
        };
        let table = of(AxisName::X).expect("X over C");
        let here = table.deviation(deg.to_radians(), None);
        assert!(here.abs() < 1e-9, "{deg}: {here} mm");
        let turn = table.positions[table.positions.len() - 1] - table.positions[0];
        assert!((turn.to_degrees() - 360.0).abs() < 1e-9, "{turn}");
        // 10 µm · (sin of the node − sin of the reference), rotated with the workpiece by the node's angle.
        let largest = table.forward.iter().fold(0.0_f64, |most, of| most.max(of.abs()));
        assert!(largest > 5e-3, "{largest} mm");
    }
    for format in [Format::Siemens840d, Format::HeidenhainTnc640, Format::Linuxcnc] {
        assert!(tables(format, 45.0).is_ok(), "{format}");
        let message = tables(format, 40.0).expect_err("no node").to_string();
        assert!(message.contains("--at C") && message.contains("40"), "{message}");
    }
}

const HEAD: &str = "name = \"m\"\nstructure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0, 600]\n[axes.Y]\ntravel = [0, 300]\n[axes.Z]\ntravel = [-400, 0]\n[errors]\n";

fn made(errors: &str, format: Format, limit_um: f64) -> Result<Content, ExchangeError> {
    let machine = Machine::parse(&format!("{HEAD}{errors}"), "m.toml").expect("a machine");
    let options = TableOptions {
        limit: CorrectionLimit::new(limit_um).expect("a limit"),
        ..TableOptions::default()
    };
    sampled(&machine, &Temperatures::new(), &options, format)
}

#[test]
fn implausible_errors_make_no_table_of_any_format() {
    for format in Format::ALL {
        for errors in [
            "EXX = { poly = [0.0, 20] }\n",
            "EXX = { poly = [1e7, 0.02] }\n",
            // A file with positions in place of deviations.
            "EXX = { table = [[0, 0], [300, 299994], [600, 599988]] }\n",
        ] {
            for limit_um in [250.0, 2000.0] {
                let found = made(errors, format, limit_um);
                assert!(
                    matches!(found, Err(ExchangeError::BeyondLimit { .. })),
                    "{format}: {found:?}"
                );
            }
        }
        let errors = "EXX = { poly = [0.0, 0.5] }\n";
        assert!(made(errors, format, 299.0).is_err(), "{format}");
        let content = made(errors, format, 301.0);
        assert!(content.is_ok(), "{format}: {content:?}");
    }
    let message = made("EXX = { poly = [0.0, 20] }\n", Format::Siemens840d, 250.0);
    assert_eq!(
        message.expect_err("refused").to_string(),
        "the deviation of X at X 50 mm is 980.4 µm, expected at most 250 µm: check the units in the machine file"
    );
}

/// Tables above 2 mm or 2 mrad are rejected in every format.
#[test]
fn no_format_writes_implausible_values() {
    let table = |output: AxisName, value: f64| {
        Content::Axes(vec![AxisTable {
            input: AxisName::X,
            output,
            positions: vec![0.0, 100.0],
            forward: vec![0.0, value],
            backward: None,
            modulo: false,
        }])
    };
    let errors = |value: f64| {
        Content::Errors(ErrorTables {
            curves: vec![ErrorTable {
                name: "EXX".parse().expect("a name"),
                positions: vec![0.0, 100.0],
                values: vec![0.0, value],
            }],
            locations: vec![("EC0Y".parse().expect("a name"), 0.0)],
        })
    };
    let options = WriteOptions {
        axes: AxisNumbers::stated(vec![(AxisName::X, 1), (AxisName::C, 4)]).expect("each once"),
        ..WriteOptions::default()
    };
    for (format, content, refused) in [
        (Format::Csv, table(AxisName::X, 2.0), false),
        (Format::Csv, table(AxisName::X, -2.01), true),
        (Format::Siemens840d, table(AxisName::X, 2.01), true),
        (Format::Csv, table(AxisName::C, 0.002), false),
        (Format::Csv, table(AxisName::C, 0.0021), true),
        (Format::IsgCsv, errors(2.0), false),
        (Format::IsgCsv, errors(10.0), true),
    ] {
        let found = write(format, &content, &options);
        let is_refused = matches!(found, Err(ExchangeError::Implausible { .. }));
        assert_eq!(is_refused, refused, "{format}: {found:?}");
    }
}

/// A LinuxCNC file read as the other type has deviations as large as the travel, and is rejected.
#[test]
fn files_of_the_other_type_are_refused() {
    let read = |format, name: &str, text: &str| {
        let found = read(format, &[file(name, text)], &ReadOptions::default());
        found.expect_err("refused").to_string()
    };
    let trims = "0 0.002 -0.003\n10 0.003 -0.004\n";
    assert_eq!(
        read(Format::Linuxcnc, "X.comp", trims),
        "X.comp:2: found a deviation of -9997.0 µm, read as positions (type 0), expected at most 2000 µm; does the file have trims (type 1)?"
    );
    let positions = "0 0.002 -0.003\n10 10.003 9.996\n";
    assert_eq!(
        read(Format::LinuxcncType1, "X.comp", positions),
        "X.comp:2: found a deviation of -10003.0 µm, read as trims (type 1), expected at most 2000 µm; does the file have positions (type 0)?"
    );
}

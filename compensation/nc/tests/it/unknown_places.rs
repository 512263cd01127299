//! Places that only the control knows: what is not stated is taken as zero, but no word may lead an axis to a place that was made up. What
//! a control does is worked out by hand, and for LinuxCNC by its interpreter (`rs274 -g`).

use volcomp_model::Machine;
use volcomp_nc::{Dialect, NcError, SetUp, Summary};
use volcomp_test_support::cases;

use crate::identity::{TRAVELS, begins, compensated_in, has, rows, written};

/// Z goes down by 0.1 µm for each mm of X: 40 µm at 400 mm.
const SLOPE: &str = "[errors]\nEZX = { poly = [0.0, 0.1] }\n";

fn run(setup: &str, program: &str) -> Result<(String, Summary), NcError> {
    let setup = SetUp::parse(setup, "s.toml").expect("a good set-up");
    let (out, summary) = compensated_in(&setup, SLOPE, program.as_bytes())?;
    Ok((String::from_utf8(out).expect("text"), summary))
}

fn result(setup: &str, program: &str) -> String {
    run(setup, program).expect(program).0
}

fn refusal(program: &str) -> String {
    run("", program).expect_err(program).to_string()
}

fn notes(setup: &str, program: &str) -> String {
    let (_, summary) = run(setup, program).expect(program);
    let notes = summary.notes.by_line();
    let notes = notes.iter().map(|(line, note)| format!("{line}: {note}\n"));
    notes.collect()
}

/// Z would go by the difference of two offsets, from machine zero to the zero of the part, or by a length: all unknown.
#[test]
fn no_word_leads_to_a_place_that_was_made_up() {
    for begins in [
        "G54 G0 X0 Y0 Z50\nG55\n",
        "G0 X0 Y0 Z50\nG53 G0 Z0\n",
        "G0 X0 Y0 Z50\nG28 Z0\n",
        "G0 X0 Y0 Z50\nG91 G30 P3 Z0\nG90\n",
        "G0 X0 Y0 Z50\nG43 H7\n",
        "G43 H7 G0 X0 Y0 Z50\nG49\n",
        "G43 H7 G0 X0 Y0 Z50\nG43 H8\n",
        "G0 X0 Y0 Z50\nG10 L2 P1 Z-310\n",
        "G0 X0 Y0 Z50\nG53 G0 Z0\nG92 Z0\nG92.1\n",
    ] {
        let program = format!("{begins}G0 X400\n");
        let (out, summary) = run("", &program).expect(begins);
        assert_eq!(out, program);
        let notes = format!("{:?}", summary.notes);
        assert!(notes.contains("LeftOut('Z')"), "{begins}{notes}");
        // Named again, it is corrected again.
        let program = format!("{program}G0 Z20\nG0 X300\n");
        let out = result("", &program);
        assert!(out.ends_with("G0 Z19.960\nG0 X300 Z19.970\n"), "{out}");
    }
}

/// Where the set-up states what is needed, and within one offset without any, the word is added: 50 mm under G54 at −310 are
/// 60 under G55 at −320.
#[test]
fn places_that_are_stated_stay_known() {
    let stated = "[work_offset.G54]\nZ = -310\n[work_offset.G55]\nZ = -320\n[tool.7]\nZ = 80\n[home.G28]\nZ = 0\n";
    for (begins, z) in [
        ("G54 G0 X0 Y0 Z50\nG55\n", "59.960"),
        ("G0 X0 Y0 Z50\nG53 G0 Z0\n", "309.960"),
        ("G0 X0 Y0 Z50\nG28 Z0\n", "309.960"),
        ("G0 X0 Y0 Z50\nG43 H7\n", "-30.040"),
    ] {
        let out = result(stated, &format!("{begins}G0 X400\n"));
        assert_eq!(out, format!("{begins}G0 X400 Z{z}\n"));
    }
    for begins in [
        "G54 G0 X0 Y0 Z50\nG54\n",
        "G43 H7 G0 X0 Y0 Z50\nG43 H7\n",
        "G0 X0 Y0 Z0\nG92 Z50\n",
        "G53 G0 X0 Y0 Z0\nG92 X0 Y0 Z50\n",
        "G0 X0 Y0 Z0\nG10 L20 P1 Z50\n",
    ] {
        let out = result("", &format!("{begins}G0 X400\n"));
        assert_eq!(out, format!("{begins}G0 X400 Z49.960\n"));
    }
    // Ways lead nowhere else.
    let out = result("", "G54 G0 X0 Y0 Z50\nG55\nG91 G0 X400\n");
    assert!(out.ends_with("G91 G0 X400 Z-0.040\n"), "{out}");
}

#[test]
fn no_part_of_a_line_is_on_a_way_that_was_made_up() {
    let bent = "[errors]\nEZX = { poly = [0.0, 0.0, 0.0005] }\n";
    let run = |program: &str| {
        let (out, summary) =
            compensated_in(&SetUp::default(), bent, program.as_bytes()).expect(program);
        let notes = format!("{:?}", summary.notes);
        (String::from_utf8(out).expect("text").lines().count(), notes)
    };
    let (lines, notes) = run("G54 G0 X0 Y0 Z50\nG55\nG1 X400 Z10 F100\n");
    assert_eq!(lines, 3, "a way from 50 mm under another offset is split");
    assert!(notes.contains("NotSplit"), "{notes}");
    let (lines, notes) = run("G54 G0 X0 Y0 Z50\nG54\nG1 X400 Z10 F100\n");
    assert!(lines > 5 && !notes.contains("NotSplit"), "{lines} {notes}");
}

#[test]
fn heidenhain_machine_coordinates_and_tools() {
    let machine = Machine::parse(&format!("{TRAVELS}{SLOPE}"), "m.toml").expect("good");
    for program in [
        "L X+0 Y+0 Z+50 FMAX\nTOOL CALL 5 Z S100\nL X+400 FMAX\n",
        "L X+0 Y+0 Z+50 FMAX\nL Z+0 FMAX M91\nL X+400 FMAX\n",
    ] {
        let (out, _) = written(Dialect::Heidenhain, &machine, "", program).expect("compensated");
        assert_eq!(out, program);
    }
}

/// G28.1 at a place that nobody knows stores a place that nobody knows.
#[test]
fn an_unknown_place_that_was_stored_stays_unknown() {
    let program = "G28.1\nG28\nG0 X400\n";
    assert_eq!(result("", program), program);
    let program = "G0 X0 Y0 Z50\nG28.1\nG0 Z70\nG28\nG0 X400\n";
    assert!(result("", program).ends_with("G0 X400 Z49.960\n"));
}

/// Nobody knows where the axes are: machine coordinates would be made up, and with them every correction.
#[test]
fn coordinates_that_are_set_at_an_unknown_place_are_not_corrected() {
    for set in ["G92 X0 Y0 Z0", "G10 L20 P1 X0 Y0 Z0"] {
        let program = format!("{set}\nG0 X400 Z5\nG1 X200 F100\n");
        let (out, summary) = run("", &program).expect(set);
        assert_eq!(out, program);
        let notes = summary.notes.by_line();
        assert!(
            notes
                .iter()
                .any(|(line, note)| *line == 1 && note.to_string().contains("[start]")),
            "{notes:?}"
        );
        // 400 mm from 100 mm are at 500 mm.
        let start = "[work_offset.G54]\nX = 0\n[start]\nX = 100\nY = 0\nZ = 0\n";
        let out = result(start, &program);
        assert!(out.contains("G0 X400 Z4.950"), "{out}");
    }
}

/// `rs274`: with #5223 = −50, `G0 Z[#5223+40]` goes to −10.
#[test]
fn what_the_control_keeps_in_parameters_is_not_set() {
    for number in ["5161", "5223", "5220", "5390", "5403", "5420"] {
        let message = refusal(&format!("G0 X0\n#{number}=-50\n"));
        begins(&message, &format!("line 2: a value for #{number}, "));
    }
    result("", "#5391=2\n#5160=1\n#5399=1\n");
}

/// `rs274` begins with G99: behind the cycle it goes on at Z2, not at Z50.
#[test]
fn behind_a_cycle_the_plane_is_known_only_by_g98_or_g99() {
    let hole = |said: &str| format!("{said}G0 X0 Y0 Z50\nG81 X0 R2 Z-5 F100\nG80\nG1 X300\n");
    let last = |said: &str| {
        let out = result("", &hole(said));
        out.lines().last().expect("a line").to_owned()
    };
    assert_eq!(last(""), "G1 X300");
    assert_eq!(last("G98\n"), "G1 X300 Z49.970");
    assert_eq!(last("G99\n"), "G1 X300 Z1.970");
    let notes = notes("", &hole(""));
    assert!(notes.contains("2: a cycle before G98 or G99"), "{notes}");
}

/// (20, 0) turned by 90° about (10, 5): the matrix takes (10, −5) to (5, 10), that is to (15, 15).
#[test]
fn a_rotation_turns_about_its_centre() {
    // Along X and Y the correction is that of the machine's place, turned back.
    let errors = "[errors]\nEXX = { poly = [0.0, 0.2] }\nEYY = { poly = [0.0, 0.4] }\n";
    let program = b"G0 X0 Y0 Z0\nG68 X10 Y5 R90\nG0 X20 Y0\nG69\n";
    let (out, _) = compensated_in(&SetUp::default(), errors, program).expect("compensated");
    let (sin, cos) = (1.0, 0.0);
    let [x, y] = [20.0 - 10.0, 0.0 - 5.0];
    let machine = [10.0 + cos * x - sin * y, 5.0 + sin * x + cos * y];
    let delta = [-2e-4 * machine[0], -4e-4 * machine[1]];
    let back = [
        cos * delta[0] + sin * delta[1],
        cos * delta[1] - sin * delta[0],
    ];
    let expected = format!("G0 X{:.3} Y{:.3}", 20.0 + back[0], back[1]);
    let out = String::from_utf8(out).expect("text");
    assert_eq!(out.lines().nth(2), Some(expected.as_str()), "{out}");
    for [program, why] in rows(
        r"
G0 X0 Y0\nG68 X10 R90\n | line 2: G68 without X and Y
G0 X0 Y0\nG52 X5\nG68 X10 Y5 R90\n | line 3: G68 while a shift
G0 X0 Y0\nG68 X10 Y5 R90\nG91 G0 X5\n | line 3: a way (G91) behind G68
",
    ) {
        let message = refusal(program);
        assert!(message.starts_with(why), "{message}");
    }
    result("", "G0 X0 Y0\nG68 X10 Y5 R90\nG0 X5\nG91 X5\n");
}

#[test]
fn what_controls_read_in_different_ways_is_refused() {
    for [program, why] in &cases(
        r"
o100 sub\no100 endsub\n/o100 call\n | line 3: an O-word in a block that may be skipped
/G98\n | line 1: a block that may be skipped
/G99\n | line 1: a block that may be skipped
/T5\n | line 1: a block that may be skipped
/M6\n | line 1: a block that may be skipped
/G95\n | line 1: a block that may be skipped
G91 G10 L2 P1 X5\n | line 1: G10 L2 in G91
G10 L2 P0 X5\n | line 1: G10 L2 without a P from 1 to 9
G91 G53 G0 X5\n | line 1: G53 in G91
G43 H1\nG0 X0\nH2\n | line 3: H without G43
G15 H1\n | line 1: H beside G15, G16 or G54 to G59
G0 X0 Y0\nG16 H0\nX300 Y200\n | line 2: H beside G15
G56 Z50 H5\n | line 1: H beside G15
G43 H1\nG1 G42 H19 X5 F1\n | line 2: H beside G41 or G42
G1 G41 H19 X5 F1\n | line 1: H beside G41 or G42
M428\nG1 X1 A5 F1\n | line 2: a motion of A, which the machine file does not have
G43.4 H1\nG1 X1 B5 F1\n | line 2: a motion of B, which the machine file does not have
",
    ) {
        let message = refusal(program);
        assert!(message.starts_with(why), "{message}");
    }
    for good in [
        "M1001\nM12345678\n",
        "G43 H1\nG0 X0\nH1\n",
        "G54 G43 H1\n",
        "G91\nG90 G53 G0 X5\n",
        "H2\n",
    ] {
        assert_eq!(result("", good), good);
    }
    // G05.1 Q1 moves nothing: X goes on with G1.
    assert_eq!(
        result(
            "",
            "G0 X0 Y0 Z0\nG1 X100 F100\nG05.1 Q1\nX400\nG5 P10000\nX0\n"
        ),
        "G0 X0 Y0 Z0\nG1 X100 F100 Z-0.010\nG05.1 Q1\nX400 Z-0.040\nG5 P10000\nX0 Z0.000\n"
    );
}

/// A rigid tapping cycle comes back to where it began, with the correction that is there.
#[test]
fn tapping_comes_back_with_its_correction() {
    let tap = "G90 G33.1 Z-20 K1\nG91 G1 X0.5 F100\n";
    let out = result("", &format!("G90 G0 X400 Y0 Z10\n{}", tap.repeat(3)));
    assert_eq!(out, format!("G90 G0 X400 Y0 Z9.960\n{}", tap.repeat(3)));
}

#[test]
fn what_is_taken_as_zero_or_passes_is_noted() {
    let program = "G0 X400 Y0 Z0\nG53 G0 Z0\nG28 Z0\n";
    let found = notes("", program);
    assert_eq!(
        found,
        "1: work offset G54 is not in the set-up: zero was taken\n2: motions in machine coordinates (G53, G28, G30, SUPA, M91) pass on without a correction\n3: the place of G28 is not in the set-up ([home.G28]): machine zero was taken\n"
    );
    let stated = "[work_offset.G54]\nX = 0\n[home.G28]\nX = 0\nY = 0\nZ = 0\n";
    assert_eq!(notes(stated, program).lines().count(), 1);
}

#[test]
fn other_languages_are_named() {
    for (line, why) in [
        ("IF [#1 EQ 1] GOTO 10", "macro language of FANUC"),
        ("N10 WHILE [#1 LT 5] DO1", "macro language of FANUC"),
        ("GOTO 10", "macro language of FANUC"),
        ("0 BEGIN PGM PART MM", "--dialect heidenhain"),
        ("5 L X+10 Y+20 R0 FMAX", "--dialect heidenhain"),
        ("TRANS X10", "--dialect siemens"),
        ("R1=5", "--dialect siemens"),
        ("N10 G1 X=IC(5)", "--dialect siemens"),
    ] {
        let message = refusal(&format!("{line}\n"));
        assert!(message.contains(why), "{line}: {message}");
    }
    let error = SetUp::parse("[work_offset.G60]\nX = 1\n", "s.toml").expect_err("refused");
    let message = error.to_string();
    has(&message, "G54 to G59");
    assert!(!message.contains("G560"), "{message}");
}

/// With G98 the tool goes back up to where it was before the first hole: where nobody knows that, no word leads there.
#[test]
fn behind_a_hole_from_an_unknown_height_no_height_is_known() {
    let without_start = |program: &str| {
        let (out, summary) = run("[work_offset.G54]\nX = 0\n", program).expect("taken");
        let notes: Vec<String> = (summary.notes.by_line().iter())
            .map(|(_, note)| note.to_string())
            .collect();
        (out, notes.join("; "))
    };
    let (out, notes) = without_start("G98\nG81 X100 Y0 Z-10 R5\nX200\nG80\nG0 X300\nG0 X400 Z9\n");
    assert_eq!(
        out,
        "G98\nG81 X100 Y0 Z-10.010 R4.990\nX200 Z-10.020\nG80\nG0 X300\nG0 X400 Z8.960\n"
    );
    assert!(notes.contains("corrections of Z are left out"), "{notes}");
    // In the plane R the height is known.
    let (out, _) = without_start("G99\nG81 X100 Y0 Z-10 R5\nG80\nG0 X300\n");
    assert_eq!(
        out,
        "G99\nG81 X100 Y0 Z-10.010 R4.990\nG80\nG0 X300 Z4.970\n"
    );
    // A block that may be skipped leaves the height open, and so does the hole behind it.
    let (out, _) = without_start("G98\nG0 X0 Y0 Z150\n/G0 Z30\nG81 X100 Z-10 R5\nG80\nG0 X300\n");
    assert!(out.ends_with("G80\nG0 X300\n"), "{out}");
}

/// Many machines move to change a tool.
#[test]
fn behind_a_tool_change_no_place_is_known() {
    let setup = "[work_offset.G54]\nX = 0\n[tool.1]\nZ = 0.0\n[tool.2]\nZ = 0.0\n[start]\nX = 0\nY = 0\nZ = 0\n";
    assert_eq!(
        result(setup, "G0 X100 Y0 Z5\nT2 M6\nG0 X200\nG0 Z5\nX300\n"),
        "G0 X100 Y0 Z4.990\nT2 M6\nG0 X200\nG0 Z4.980\nX300 Z4.970\n"
    );
}

/// Beginning, end and centre of an arc that cannot be corrected go by one and the same correction: X is 0.05 mm in each metre too long.
#[test]
fn an_arc_of_which_one_axis_is_unknown_goes_as_a_whole() {
    let errors = "[errors]\nEXX = { poly = [0.0, 0.05] }\n";
    let result = |program: &str| {
        let (out, _) =
            compensated_in(&SetUp::default(), errors, program.as_bytes()).expect(program);
        String::from_utf8(out).expect("text")
    };
    // The place of Y is not known until it is named: X is known, and carries -0.020 at 400 mm.
    for (arc, expected) in [
        ("G2 X420 I10 J0 F100", "G2 X419.980 I10 J0 F100"),
        ("G3 X420 R10 F100", "G3 X419.980 R10 F100"),
        ("G3 X420 Y0 R-10 F100", "G3 X419.980 Y0 R-10 F100"),
        (
            "G90.1 G2 X420 I410 J0 F100",
            "G90.1 G2 X419.980 I409.980 J0 F100",
        ),
        ("G91 G2 X20 I10 J0 F100", "G91 G2 X20 I10 J0 F100"),
        ("G2 X420 Z-5 I10 J0 F100", "G2 X419.980 Z-5 I10 J0 F100"),
        ("G2 I10 J0 F100", "G2 I10 J0 F100"),
    ] {
        let out = result(&format!("G0 X400\n{arc}\n"));
        assert_eq!(out, format!("G0 X399.980\n{expected}\n"), "{arc}");
    }
    // In every plane.
    let out = result("G0 X400\nG18 G2 X420 I10 K0 F100\n");
    assert_eq!(out, "G0 X399.980\nG18 G2 X419.980 I10 K0 F100\n");
    // Behind it each axis that is known is corrected again.
    let out = result("G0 X400\nG2 X420 Y0 I10 J0 F100\nG1 X500 Y1\n");
    assert!(
        out.ends_with("G2 X419.980 Y0 I10 J0 F100\nG1 X499.975 Y1\n"),
        "{out}"
    );
}

/// Steps for each mm, accelerations, the arguments of a macro: nobody says that they are coordinates, so none of them changes, and where
/// the axes are behind them nobody knows. X needs 1 µm for each mm of Y.
#[test]
fn words_that_no_code_claims_are_no_coordinates() {
    let skew = "[errors]\nEC0Y = 1000.0\n";
    let run = |control: &str, program: &str| {
        let control = match control {
            "" => String::new(),
            control => format!("control = \"{control}\"\n"),
        };
        let setup = SetUp::parse(&control, "s.toml").expect("a good set-up");
        let (out, summary) =
            compensated_in(&setup, skew, program.as_bytes()).map_err(|error| error.to_string())?;
        let notes: Vec<String> = (summary.notes.by_line().iter())
            .map(|(line, note)| format!("{line}: {note}\n"))
            .collect();
        Ok::<_, String>((String::from_utf8(out).expect("text"), notes.concat()))
    };
    for control in ["", "linuxcnc", "fanuc", "haas", "mazak", "grbl"] {
        for block in [
            "M92 X80. Y80.",
            "M201 X1000. Y1000.",
            "M203 Y9.",
            "M205 X30. Y30. Z1. E5.",
            "M206 X1.5",
            "N5 Y50. M92 (steps)",
            "M92 X80",
            "M12345678 X1. Q2. R3.",
            "G90 F200 M203 Y#1",
        ] {
            let begins = "G90 G1 X0. Y100. Z0. F100\n";
            let program = format!("{begins}{block}\nX50.\nY200.\nX100.\nG91 X1. Y1.\n");
            let (out, notes) = run(control, &program).expect(block);
            let begins = "G90 G1 X0.100 Y100. Z0. F100\n";
            let behind = "X50.100\nY200. X50.200\nX100.200\nG91 X1.001 Y1.\n";
            let expected = format!("{begins}{block}\n{behind}");
            assert_eq!(out, expected, "{control} {block}");
            let name = block.split_whitespace().find(|word| word.starts_with('M'));
            let expected = format!("2: {} passes on as it is", name.expect("an M code"));
            assert!(notes.contains(&expected), "{control} {block}: {notes}");
        }
        // What is known, or has a motion of its own, moves the axes; so does an unknown one without words of axes.
        for block in ["M8 X50.", "X50. M3 S100", "G1 M205 X50.", "M19 X50."] {
            let program = format!("G90 G1 X0. Y100. Z0. F100\n{block}\nY200.\n");
            let (out, _) = run(control, &program).expect(block);
            assert!(out.contains("X50.100"), "{control} {block}: {out}");
            assert!(out.ends_with("Y200. X50.200\n"), "{control} {block}: {out}");
        }
        let (out, _) = run(control, "G1 X0. Y100. Z0. F100\nM205\nY200.\n").expect("taken");
        assert_eq!(out, "G1 X0.100 Y100. Z0. F100\nM205\nY200. X0.200\n");
        // An arc may begin with the correction or without.
        let arc = "G90 G1 X0. Y100. F100\nX10. M205\nG2 X20. I5.\n";
        let message = run(control, arc).expect_err(arc);
        begins(&message, "line 3: an arc after an unknown M code");
        let named = "G90 G1 X0. Y100. F100\nX10. M205\nG1 X10.\nG2 X20. I5.\n";
        run(control, named).expect(named);
        // Ways are as they are until the place is named.
        let ways = "G90 G1 X0. Y100. F100\nM205 X1. Y1.\nG91 X5. Y5.\n";
        let (out, _) = run(control, ways).expect(ways);
        assert!(out.ends_with("M205 X1. Y1.\nG91 X5. Y5.\n"), "{out}");
    }
    // Programs of the user of LinuxCNC have P and Q: coordinates beside them are a motion.
    let (out, _) = run("linuxcnc", "G1 X0 Y100 F100\nM101 P1 Q2 X50\n").expect("taken");
    assert!(out.ends_with("M101 P1 Q2 X50.100\n"), "{out}");
    let (out, _) = run("", "G1 X0 Y100 F100\nM101 P1 Q2 X50\n").expect("taken");
    assert!(out.ends_with("M101 P1 Q2 X50\n"), "{out}");
    // Numbers of an M code count for no manner of writing coordinates.
    for control in ["fanuc", "haas", "mazak"] {
        let (out, _) = run(control, "G1 X0. Y100. F100.\nM92 X80 Y80\nX50.\n").expect("taken");
        assert!(out.ends_with("M92 X80 Y80\nX50.100\n"), "{out}");
    }
}

/// What `rs274` says of each: "R word with no g code that uses it" and such.
#[test]
fn words_beside_a_motion_that_does_not_use_them_are_refused() {
    for [line, why] in &cases(
        "
G1 X1 E1 | E beside G1, which is the filament of a printer
G0 X1 E1 | E beside G0, which is
G2 X1 I.5 E1 | E beside G2, which is
G1 X1 R1 | R beside G1, with which some controls round a corner
X1 R1 | R beside G1
G1 R5 | R beside G1
G53 G1 X1 R1 | R beside G1
G1 X1 Q1 | Q beside G1, which no code of the block uses
G3 X1 I.5 Q1 | Q beside G3
G1 X1 K1 | K beside G1
G2 X1 I.5 K1 | K beside G2, which is no part of the centre
G1 X1 M8 R5 | R beside G1
",
    ) {
        for control in ["", "linuxcnc", "fanuc", "haas", "mazak", "grbl"] {
            let control = match control {
                "" => String::new(),
                control => format!("control = \"{control}\"\nwithout_point = \"unit\"\n"),
            };
            let control = control.replace("linuxcnc\"\nwithout_point = \"unit\"", "linuxcnc\"");
            let control = control.replace("grbl\"\nwithout_point = \"unit\"", "grbl\"");
            let program = format!("G90 G17 G0 X0 Y0 Z0\nG1 F100\n{line}\n");
            let message = run(&control, &program).expect_err(line).to_string();
            let expected = format!("line 3: {why}");
            assert!(message.starts_with(&expected), "{control}{line}: {message}");
        }
    }
    for line in [
        "G1 X1 G64 P.01 Q.01",
        "G1 X1 M19 R5",
        "G1 X1 M67 E0 Q1",
        "G1 X1 M66 P0 L0 Q1",
        "G1 X1 M61 Q0",
        "G18 G2 X1 I.5 K0",
        "G19 G2 Y1 R1",
        "G81 X1 Z-1 R1",
        "G5.1 Q1 R2",
        "G1 X1 M777 E1 Q1 R1 K1",
    ] {
        run("", &format!("G90 G17 G0 X0 Y0 Z0\nG1 F100\n{line}\n")).expect(line);
    }
    for control in ["marlin", "klipper"] {
        let setup = format!("control = \"{control}\"\n");
        run(&setup, "M83\nG1 X1 E1\n").expect("filament");
        let message = run(&setup, "G1 X1 Q1\n").expect_err("refused").to_string();
        assert!(message.starts_with("line 1: Q beside G1"), "{message}");
    }
}

/// The other points of a spline are ways from its ends, so that its end goes by the correction with which it begins: X is 0.05 mm in each metre
/// too long, 20 µm at 400 mm.
#[test]
fn a_spline_goes_as_a_whole() {
    let errors = "[errors]\nEXX = { poly = [0.0, 0.05] }\n";
    for (spline, expected) in [
        ("G5 I0 J3 P0 Q-3 X500 Y50", "G5 I0 J3 P0 Q-3 X499.980 Y50"),
        ("G5.1 I5 J5 X500 Y60", "G5.1 I5 J5 X499.980 Y60"),
        (
            "G5.2 X500 Y120 P1 L3\nX600 Y130 P1\nG5.3",
            "G5.2 X499.980 Y120 P1 L3\nX599.980 Y130 P1\nG5.3",
        ),
        ("G91 G5.1 I5 J5 X100 Y60", "G91 G5.1 I5 J5 X100 Y60"),
    ] {
        for y in ["", " Y0"] {
            let program = format!("G0 X400{y}\n{spline}\nG90 G1 X800 Y0 F100\n");
            let (out, summary) =
                compensated_in(&SetUp::default(), errors, program.as_bytes()).expect(spline);
            let out = String::from_utf8(out).expect("text");
            assert_eq!(
                out,
                format!("G0 X399.980{y}\n{expected}\nG90 G1 X799.960 Y0 F100\n")
            );
            let notes = format!("{:?}", summary.notes);
            assert!(notes.contains("GoesWhole"), "{notes}");
        }
    }
}

/// In each language an axis whose place is unknown gets no word, and the others are corrected, also in cycles and about poles. At 400 mm X
/// needs −20 µm, Y −80 µm, Z −40 µm.
#[test]
fn unknown_axes_in_cycles_and_in_each_language() {
    let errors = "[errors]\nEXX = { poly = [0.0, 0.05] }\nEYX = { poly = [0.0, 0.2] }\nEZX = { poly = [0.0, 0.1] }\n";
    let machine = Machine::parse(&format!("{TRAVELS}{errors}"), "m.toml").expect("good");
    let run = |dialect, program: &str| {
        let written = written(dialect, &machine, "", program);
        written
            .map(|(text, _)| text)
            .map_err(|error| error.to_string())
    };
    for [language, program, expected] in rows(
        r"
// Holes have heights of their own; behind G98 the height is that of before.
rs274 | G0 X400 Y0 Z50\nT2 M6\nG98 G81 X300 Y10 Z-5 R2 F100\nX200\nG80\nG0 X100\nG0 Z9\n | G0 X399.980 Y-0.080 Z49.960\nT2 M6\nG98 G81 X299.985 Y9.940 Z-5.030 R1.970 F100\nX199.990 Z-5.020 R1.980 Y9.960\nG80\nG0 X99.995 Y9.980\nG0 Z8.990\n
rs274 | G0 X400 Y0 Z50\nM205 X1 Y1\nG99 G81 X300 Z-5 R2 F100\nY5\nX100 Y10\nG80\nG0 X200\n | G0 X399.980 Y-0.080 Z49.960\nM205 X1 Y1\nG99 G81 X299.985 Z-5.030 R1.970 F100\nY4.940\nX99.995 Y9.980 Z-5.010 R1.990\nG80\nG0 X199.990 Y9.960 Z1.980\n
// Both polar coordinates are a place of X and Y.
rs274 | G0 X400 Y0 Z50\nT2 M6\nG16\nG0 X300 Y45\nG15\nG0 X100\n | G0 X399.980 Y-0.080 Z49.960\nT2 M6\nG16\nG0 X212.121 Y212.090 G15\nG15\nG0 X99.995 Y212.112\n
rs274 | G0 X400 Y0 Z50\nM205 X1 Y1\nG0 @300 ^45\nG0 X100\n | G0 X399.980 Y-0.080 Z49.960\nM205 X1 Y1\nG0 X212.121 Y212.090\nG0 X99.995 Y212.112\n
siemens | G0 X400\nG2 X420 I10 J0 F100\nG2 X440 Y0 CR=10\nG1 X500 Y1\n | G0 X399.980\nG2 X419.980 I10 J0 F100\nG2 X439.980 Y0 CR=10\nG1 X499.975 Y0.900\n
siemens | G0 X400 Y0 Z50\nT2 M6\nG0 X300\nCYCLE81(10,0,2,-5)\nG0 X200 Y10\nG0 X100\n | G0 X399.980 Y-0.080 Z49.960\nT2 M6\nG0 X299.985\nCYCLE81(10,0,2,-5)\nG0 X199.990 Y9.960 Z9.980\nG0 X99.995 Y9.980 Z9.990\n
heidenhain | L X+400 Y+0 Z+50 FMAX\nTOOL CALL 5 Z S100\nCYCL DEF 200 DRILLING ~\nQ200=2 ~\nQ201=-5\nL X+300 Y+10 FMAX M99\nL X+200\nL Z+20\nL X+100\n | L X+399.980 Y-0.080 Z+49.960 FMAX\nTOOL CALL 5 Z S100\nCYCL DEF 200 DRILLING ~\nQ200=2 ~\nQ201=-5\nL X+299.985 Y+9.940 FMAX M99\nL X+199.990 Y+9.960\nL Z+19.980\nL X+99.995 Y+9.980 Z+19.990\n
heidenhain | L X+400 FMAX\nCR X+420 Y+0 R+10 DR+ F100\nL X+100\n | L X+399.980 FMAX\nCR X+419.980 Y+0 R+10 DR+ F100\nL X+99.995 Y-0.020\n
",
    ) {
        let dialect = match language {
            "siemens" => Dialect::Siemens,
            "heidenhain" => Dialect::Heidenhain,
            _ => Dialect::Rs274,
        };
        assert_eq!(run(dialect, program).as_deref(), Ok(expected), "{program}");
    }
    // A pole relative to a place that is unknown is none.
    for [line, expected] in rows(
        r"
C X+420 Y+0 DR+ F100 | line 3: an arc without a radius and without a pole (CC) whose place is known: name X and Y before
LP PR+50 PA+45 | line 3: polar coordinates without a pole (CC) whose place is known: name X and Y before
",
    ) {
        let program = |begins: &str| format!("{begins}\nCC IX+10 IY+0\n{line}\n");
        let error = run(Dialect::Heidenhain, &program("L X+400 FMAX")).expect_err(line);
        assert!(error.starts_with(expected), "{error}");
        run(Dialect::Heidenhain, &program("L X+400 Y+0 FMAX")).expect(line);
    }
}

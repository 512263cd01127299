//! SINUMERIK 840D: files as in real archives.

use std::fmt::Write;

use volcomp_tables::axis_table::{
    AxisTable, Content, Format, ReadOptions, WriteOptions, read, write,
};
use volcomp_tables::vocabulary::{AxisName, Direction};

use super::{close, edges, file, inside, of_axes, options, over, own, refused, tables, writing};

const F: Format = Format::Siemens840d;

fn cec(
    number: u32,
    values: &[f64],
    [input, output]: [&str; 2],
    [step, min, max]: [f64; 3],
    more: &str,
) -> String {
    let mut text = String::new();
    for (point, value) in values.iter().enumerate() {
        writeln!(text, "$AN_CEC[{number},{point}]={value}").expect("a string");
    }
    write!(
        text,
        "$AN_CEC_INPUT_NCU[{number}]=1\n$AN_CEC_INPUT_AXIS[{number}]=({input})\n$AN_CEC_OUTPUT_NCU[{number}]=1\n\
         $AN_CEC_OUTPUT_AXIS[{number}]=({output})\n$AN_CEC_STEP[{number}]={step}\n$AN_CEC_MIN[{number}]={min}\n\
         $AN_CEC_MAX[{number}]={max}\n$AN_CEC_DIRECTION[{number}]=0\n$AN_CEC_MULT_BY_TABLE[{number}]=0\n\
         $AN_CEC_IS_MODULO[{number}]=0\n$AN_CEC_TYPE[{number}]=0\n"
    )
    .expect("a string");
    text + more
}

/// Reads a text as in an archive. Returns its tables and warnings.
fn read_cec(values: &[f64], axes: [&str; 2], steps: [f64; 3]) -> (Vec<AxisTable>, Vec<String>) {
    tables(F, "a.ini", &framed(&cec(0, values, axes, steps, "")))
}

fn framed(text: &str) -> String {
    format!("\nMETRIC\n\nCHANDATA(1)\n{text}M17\n")
}

#[test]
fn a_length_of_no_whole_number_of_steps_is_read_with_a_warning() {
    let values: Vec<f64> =
        (0..15).map(|n| if n < 10 { 0.001 * f64::from(n) } else { 0.0 }).collect();
    let (found, warnings) = read_cec(&values, ["AX2", "AX1"], [100.0, -850.0, 0.0]);
    assert_eq!((found[0].input, found[0].output), (AxisName::Y, AxisName::X));
    let nodes = edges(&found[0]);
    assert_eq!(nodes.len(), 10);
    assert_eq!(nodes[0], (-850.0, 0.0));
    // Point 9 would be at 50, beyond MAX; the line towards it is interpolated at MAX.
    close(nodes[9].0, 0.0, 1e-12);
    close(nodes[9].1, 0.0085, 1e-12);
    close(found[0].deviation(400.0, None), 0.0085, 1e-12);
    assert!(
        warnings[0].contains("a.ini:") && warnings[0].contains("8.5, no whole number"),
        "{warnings:?}"
    );
}

#[test]
fn unused_allocated_points_are_ignored() {
    let mut values = vec![0.001, 0.002, 0.003];
    values.resize(17, 0.0);
    let (found, warnings) = read_cec(&values, ["AX1", "AX2"], [50.0, 0.0, 100.0]);
    let expected = [(0.0, 0.001), (50.0, 0.002), (100.0, 0.003)];
    assert_eq!(edges(&found[0]), expected);
    assert!(warnings.is_empty(), "{warnings:?}");
    values[16] = 0.5;
    let (_, warnings) = read_cec(&values, ["AX1", "AX2"], [50.0, 0.0, 100.0]);
    let expected = "1 values after point 2";
    assert!(warnings[0].contains(expected), "{warnings:?}");
}

#[test]
fn a_table_that_is_not_defined_is_left_out() {
    let undefined = cec(7, &[0.0, 0.0], ["X", "X"], [0.0, 0.0, 0.0], "");
    let text =
        framed(&(cec(0, &[0.0, 0.01], ["AX1", "AX3"], [100.0, 0.0, 100.0], "") + &undefined));
    let (found, warnings) = tables(F, "a", &text);
    assert_eq!(found.len(), 1);
    assert!(warnings[0].contains("table 7: not defined"), "{warnings:?}");
}

#[test]
fn rotary_axes_are_in_degrees_as_input_and_output() {
    let text = framed(
        &(cec(6, &[0.0, -0.0005], ["AX5", "AX4"], [30.0, 0.0, 30.0], "")
            + &cec(5, &[0.0, 0.004], ["AX5", "AX3"], [30.0, 0.0, 30.0], "")),
    );
    let (found, _) = tables(F, "a", &text);
    let [to_linear, to_rotary] = [&found[0], &found[1]];
    assert_eq!((to_rotary.input, to_rotary.output), (AxisName::A, AxisName::C));
    close(to_rotary.positions[1], 30_f64.to_radians(), 1e-12);
    close(to_rotary.forward[1], -0.0005_f64.to_radians(), 1e-15);
    assert_eq!(to_linear.forward[1], 0.004);
}

#[test]
fn a_modulo_table_of_the_second_encoder() {
    let mut text = String::new();
    for n in 0..=24 {
        let value = match n {
            12 => "0.0054",
            3 => "-0.000",
            _ => "0",
        };
        writeln!(text, "$AA_ENC_COMP[1,{n},AX4]={value}").expect("a string");
    }
    text += "$AA_ENC_COMP_STEP[1,AX4]=15\n$AA_ENC_COMP_MIN[1,AX4]=0\n$AA_ENC_COMP_MAX[1,AX4]=360\n$AA_ENC_COMP_IS_MODULO[1,AX4]=1\n";
    let (found, warnings) = tables(F, "AX_EEC.INI", &framed(&text));
    assert!(warnings.is_empty(), "{warnings:?}");
    assert!(found[0].modulo && found[0].input == AxisName::C);
    let there = found[0].deviation((-180.0_f64).to_radians(), None);
    close(there, 0.0054_f64.to_radians(), 1e-12);
    assert!(found[0].forward[3].is_sign_positive(), "-0.000 is 0");
}

#[test]
fn spellings_of_programs_and_manuals() {
    let text = "N10 $AN_CEC [0,0]     = 0.000 ;comment\n$AN_CEC [0.1]=-0.000\nN30 $an_cec[ 0 , 2 ] = 0.003; n=2 \"950\"\n\
                $AN_CEC_INPUT_AXIS [0] = (AX1)\n$AN_CEC_OUTPUT_AXIS[0]=( AX2 )\n$AN_CEC_STEP [0]=100\n$AN_CEC_MIN[0]=0\n$AN_CEC_MAX[0]=200\n\
                $AN_CEC_IS_MODULO[0]=-1\n$MA_ENC_COMP_ENABLE[0,AX1]=1\nM17\n";
    let (found, warnings) = tables(F, "a", text);
    assert_eq!(edges(&found[0]), [(0.0, 0.0), (100.0, 0.0), (200.0, 0.003)]);
    assert!(found[0].modulo);
    assert!(found[0].forward.iter().all(|by| by.is_sign_positive()));
    let message = warnings.join("\n");
    for words in "IS_MODULO is -1,$MA_ENC_COMP_ENABLE,METRIC is missing".split(',') {
        assert!(message.contains(words), "{message}");
    }
}

#[test]
fn a_missing_equals_sign_is_reported_once() {
    let text = framed(
        "$AA_ENC_COMP[1,0,X] 0.003\n$AA_ENC_COMP[1,1,X] 0.004\n$AA_ENC_COMP_STEP[1,X] 50\n$AA_ENC_COMP_MIN[1,X] -50\n$AA_ENC_COMP_MAX[1,X] 0\n",
    );
    let (found, warnings) = tables(F, "a", &text);
    assert_eq!(edges(&found[0]), [(-50.0, 0.003), (0.0, 0.004)]);
    assert_eq!(warnings.len(), 1);
    assert!(warnings[0].starts_with("a:5: found no `=`"), "{warnings:?}");
}

#[test]
fn tables_for_single_directions_become_one() {
    let axes = ["AX1", "AX2"];
    let (first, second) = ("$AN_CEC_DIRECTION[0]=1\n", "$AN_CEC_DIRECTION[1]=-1\n");
    let one = cec(0, &[0.0, 0.01], axes, [100.0, 0.0, 100.0], first);
    let other = cec(1, &[0.0, 0.03, 0.04], axes, [50.0, 0.0, 100.0], second);
    let (found, _) = tables(F, "a", &framed(&(one.clone() + &other)));
    assert_eq!(found.len(), 1);
    for (direction, expected) in Direction::BOTH.into_iter().zip([0.005, 0.03]) {
        close(found[0].deviation(50.0, Some(direction)), expected, 1e-12);
    }
    // The other direction is not corrected.
    let (found, _) = tables(F, "a", &framed(&one));
    assert_eq!(found[0].deviation(100.0, Some(Direction::Negative)), 0.0);
}

/// Machine axes may have their factory names, a letter and a number, as in the manual's example.
#[test]
fn machine_axes_may_be_named_by_letter_and_number() {
    let leadscrew = |axis: &str| {
        format!(
            "%_N_AX_EEC_INI\nCHANDATA(1)\n$AA_ENC_COMP[0,0,{axis}]=0.003\n$AA_ENC_COMP[0,1,{axis}]=0.01\n$AA_ENC_COMP[0,2,{axis}]=0.012\n$AA_ENC_COMP[0,3,{axis}]=-0.0\n$AA_ENC_COMP_STEP[0,{axis}]=100.0\n$AA_ENC_COMP_MIN[0,{axis}]=-200.0\n$AA_ENC_COMP_MAX[0,{axis}]=100.0\n$AA_ENC_COMP_IS_MODULO[0,{axis}]=0\nM17\n"
        )
    };
    for (name, letter) in
        [("X1", AxisName::X), ("Z1", AxisName::Z), ("C12", AxisName::C), ("Y", AxisName::Y)]
    {
        let (found, _) = tables(F, "AX_EEC.INI", &leadscrew(name));
        assert_eq!((found.len(), found[0].input, found[0].output), (1, letter, letter));
        for (at, mm) in [(-200.0, 0.003), (-100.0, 0.01), (0.0, 0.012), (50.0, 0.006), (100.0, 0.0)]
        {
            let deviation = found[0].deviation(inside(letter, at), None);
            close(deviation, inside(letter, mm), 1e-12);
        }
    }
    let (found, _) = read_cec(&[0.0, 1.0], ["Y1", "X1"], [1.0, 0.0, 1.0]);
    assert_eq!((found[0].input, found[0].output), (AxisName::Y, AxisName::X));
    let both = format!("{}{}", leadscrew("X1"), leadscrew("X2"));
    let error = refused(F, "a.ini", &both);
    assert!(error.contains("axis `X2` in addition to `X1`"), "{error}");
    for name in ["Q1", "X1Y", "1", "XX1"] {
        let error = refused(F, "a.ini", &leadscrew(name));
        assert!(error.contains("a letter with a number"), "{name}: {error}");
    }
}

#[test]
fn refusals_name_line_found_and_expected() {
    let inch = refused(F, "a.ini", "INCH\n");
    assert_eq!(inch, "a.ini:1: found INCH, expected METRIC");
    let refused_cec = |values: &[f64], axes, steps| {
        let text = framed(&cec(0, values, axes, steps, ""));
        refused(F, "a.ini", &text)
    };
    let axis = refused_cec(&[0.0, 1.0], ["AX9", "AX1"], [1.0, 0.0, 1.0]);
    let is_named = axis.contains("axis `AX9`") && axis.contains("--axis-numbers");
    assert!(is_named, "{axis}");
    let missing = refused_cec(&[0.0], ["AX1", "AX2"], [1.0, 0.0, 2.0]);
    assert!(missing.contains("without point 1"), "{missing}");
    let wrong =
        "$AN_CEC[0,0]=x y;$AN_CEC[0,0=1;hello;$AN_CEC[a,0]=1;$AN_CEC[0,0]=nan;$AN_CEC[0,0]=1e300";
    for text in wrong.split(';') {
        let message = refused(F, "a.ini", &format!("{text}\n"));
        assert!(message.starts_with("a.ini:1: found "), "{message}");
    }
    let both = (0..2)
        .map(|e| format!("$AA_ENC_COMP[{e},0,X]=0.1\n$AA_ENC_COMP[{e},1,X]=0.1\n$AA_ENC_COMP_STEP[{e},X]=1\n$AA_ENC_COMP_MIN[{e},X]=0\n$AA_ENC_COMP_MAX[{e},X]=1\n"))
        .collect::<Vec<_>>()
        .concat();
    assert!(refused(F, "a.ini", &framed(&both)).contains("--encoder 0 or 1"));
    let chosen = ReadOptions { encoder: Some(1), ..options() };
    assert!(read(F, &[file("a.ini", &framed(&both))], &chosen).is_ok());
}

#[test]
fn written_files_follow_the_documented_form() {
    let (values, modulo) = ([0.0, -0.0, 0.002], "$AN_CEC_IS_MODULO[0]=-1\n");
    let text = cec(0, &values, ["AX5", "AX3"], [30.0, 0.0, 60.0], modulo);
    let (found, _) = tables(F, "a", &framed(&text));
    let written = write(F, &Content::Axes(found), &writing()).expect("written");
    let [file] = written.files.as_slice() else { panic!("one file") };
    assert_eq!(file.name, "NC_CEC.INI");
    for part in [
        "METRIC\n\nCHANDATA(1)\n$AN_CEC[0,0]=0.000000\n$AN_CEC[0,1]=0.000000\n",
        "; ",
        "$AN_CEC: sign unproven: try with one small known value first",
    ] {
        assert!(file.text.contains(part), "{part} {}", file.text);
    }
    let ends = "$AN_CEC_IS_MODULO[0]=1\n$AN_CEC_TYPE[0]=0\nM17\n";
    assert!(file.text.ends_with(ends), "{}", file.text);
    // The header has the axis numbers, so no options are needed.
    let again = read(F, &written.files, &ReadOptions::default()).expect("read");
    assert!(again.warnings.is_empty(), "{:?}", again.warnings);
}

/// A nut with play of 3 µm: the encoder leads the slide, which is 3 µm behind after positive motion, so the backlash is positive (MD32450). For C
/// it is 0.001 deg. A table in one direction has no backlash.
#[test]
fn the_reversal_is_a_backlash_for_the_machine_data() {
    let mean = [0.0, 0.004, -0.002];
    let with_play = |axis, play: f64| AxisTable {
        forward: mean.iter().map(|value| inside(axis, value - play / 2.0)).collect(),
        backward: Some(mean.iter().map(|value| inside(axis, value + play / 2.0)).collect()),
        ..own(axis, [0.0, 100.0, 200.0].map(|at| inside(axis, at)).to_vec(), Vec::new())
    };
    let y = own(AxisName::Y, vec![0.0, 100.0, 200.0], mean.to_vec());
    let content =
        Content::Axes(vec![with_play(AxisName::X, 0.003), y, with_play(AxisName::C, -0.001)]);
    let options = WriteOptions { encoder: 1, ..writing() };
    let written = write(F, &content, &options).expect("written");
    let text = &written.files[0].text;
    for line in [
        "; MD32450 $MA_BACKLASH[1,AX1]: add 0.003000 mm to the value with which the axis was measured",
        "; MD32450 $MA_BACKLASH[1,AX4]: add -0.0010000 deg to the value with which the axis was measured",
    ] {
        assert!(text.lines().any(|found| found == line), "{line}: {text}");
    }
    assert_eq!(text.matches("MD32450").count(), 2);
    assert!(
        written.notes.join(" ").contains("$MA_BACKLASH[1,AX1]: add 0.003000 mm"),
        "{:?}",
        written.notes
    );
    // The reader ignores the comments: the mean is read back.
    let again = read(F, &written.files, &ReadOptions::default()).expect("read");
    let again = of_axes(again.content);
    close(over(&again, AxisName::X, AxisName::X).forward[1], 0.004, 1e-9);
}

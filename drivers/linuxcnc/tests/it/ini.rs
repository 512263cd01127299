//! The shipped INI file is valid, and every missing or invalid line is reported.

use volcomp_linuxcnc::{Expected, GuardMinimum, Ini, LinuxCncConfig, PORT};
use volcomp_test_support::cases;
use volcomp_vocabulary::AxisName;

use crate::{
    bridge::{KEY, KEY_TEXT},
    component::{key_file, write_key},
};

pub(crate) fn control() -> LinuxCncConfig {
    LinuxCncConfig {
        host: "127.0.0.1".to_owned(),
        port: PORT,
        key: KEY,
        remote: false,
        channel: "linuxcnc".to_owned(),
        machine: 1,
        axes: vec![AxisName::X, AxisName::Y, AxisName::Z],
        reads: Vec::new(),
        step_linear: LinuxCncConfig::STEP_LINEAR,
        step_rotary: LinuxCncConfig::step_rotary(),
    }
}

pub(crate) fn expected(control: &LinuxCncConfig) -> Expected<'_> {
    Expected {
        control,
        scan_ms: 1.0,
        least: Some(GuardMinimum {
            limit: [30.0, 0.0],
            rate: [1000.0, 0.0],
            zero_after_ms: 1000.0,
        }),
    }
}

pub(crate) fn mill() -> String {
    std::fs::read_to_string(volcomp_test_support::root().join("examples/linuxcnc/mill.ini"))
        .unwrap()
}

fn problems_of_file(file: &std::path::Path, text: &str) -> Vec<String> {
    std::fs::write(file, text).unwrap();
    key_file(file.parent().unwrap());
    let problems = Ini::read(file).unwrap().problems(&expected(&control()));
    problems.iter().map(ToString::to_string).collect()
}

fn problems_of(text: &str) -> Vec<String> {
    let problems = Ini::parse(text).problems(&expected(&control()));
    problems.iter().map(ToString::to_string).collect()
}

#[test]
fn the_shipped_file_is_valid() {
    assert_eq!(problems_of(&mill()), [""; 0]);
}

/// Checks the messages for changes of the shipped file. Each line of `changes` has the old text, the new text, and the
/// expected message.
fn assert_messages(changes: &str) {
    for [from, to, says] in &cases(changes) {
        let text = mill();
        assert!(text.contains(from), "{from}");
        let problems = problems_of(&text.replace(from, to)).join("\n");
        assert!(problems.contains(says), "{says}: {problems}");
    }
}

#[test]
fn wrong_numbers_units_and_files_are_reported() {
    assert_messages(
        r"
LIMIT_UM = 30 | LIMIT_UM = 5 | [VOLCOMP]LIMIT_UM: found 5, expected 30 or more: the limit of [guard]
LIMIT_UM = 30 | LIMIT_UM = 40 | [VOLCOMP]LIMIT_UM: found 40, expected 32.767 or less: a word
RATE_UM_PER_S = 2000 | RATE_UM_PER_S = 10 | [VOLCOMP]RATE_UM_PER_S: found 10, expected 1000 or more: twice the slew
LIMIT_UM = 30 | LIMIT_UM = 30\nHOLD_MS = 65636\nTIME_OUT_MS = 65836 | [VOLCOMP]HOLD_MS: found 65636, expected 32767 or less
LIMIT_UM = 30 | LIMIT_UM = 30\nTIME_OUT_MS = 65836 | [VOLCOMP]TIME_OUT_MS: found 65836, expected 1000 or less: guard.zero_after_ms
LIMIT_UM = 30 | LIMIT_UM = 30\nHOLD_MS = 200 | [VOLCOMP]TIME_OUT_MS: found 300, expected 400 or more: twice HOLD_MS
LIMIT_UM = 30 | LIMIT_UM = 30\nSTEP_NM = 1.5 | [VOLCOMP]STEP_NM: found 1.5, expected a whole number
[AXIS_Y]\nOFFSET_AV_RATIO = 0.02\nMAX_VELOCITY = 200 | [AXIS_Y]\nOFFSET_AV_RATIO = 0.001\nMAX_VELOCITY = 5 | [AXIS_Y]OFFSET_AV_RATIO: found 0.001, expected 0.4 or more: of MAX_VELOCITY = 5
HALFILE = ../../drivers/linuxcnc/bridge/volcomp.tcl\n | HALFILE = PATH/volcomp.tcl\nHALFILE = probe.hal\n | [HAL]HALFILE: found probe.hal after volcomp.tcl
",
    );
}

#[test]
fn missing_and_wrong_lines_are_reported() {
    assert_messages(
        r"
volcomp.tcl | other.tcl | [HAL]HALFILE: volcomp.tcl is missing
MACHINE = 1\n | MACHINE = 2\n | [VOLCOMP]MACHINE: found 2, expected 1
MACHINE = 1\n |  | [VOLCOMP]MACHINE is missing, expected a number
AXES = XYZ | AXES = X Z Y | [VOLCOMP]AXES: found XZY, expected XYZ
LIMIT_UM = 30 | STEP_NM = 10 | [VOLCOMP]STEP_NM: found 10, expected 1
LIMIT_UM = 30 |  | [VOLCOMP]LIMIT_UM is missing, expected a number
[AXIS_Y]\nOFFSET_AV_RATIO = 0.02 | [AXIS_Y] | [AXIS_Y]OFFSET_AV_RATIO is missing
[AXIS_Y]\nOFFSET_AV_RATIO = 0.02 | [AXIS_Y]\nOFFSET_AV_RATIO = 0.5 | [AXIS_Y]OFFSET_AV_RATIO: found 0.5
[JOINT_1]\n | [JOINT_1]\nCOMP_FILE = y.tbl\n | [JOINT_1]COMP_FILE: found y.tbl
[JOINT_2]\n | [JOINT_2]\nBACKLASH = 0.005\n | [JOINT_2]BACKLASH: found 0.005
KINEMATICS = trivkins coordinates=XYZ | KINEMATICS = xyzac-trt-kins | [KINS]KINEMATICS: found xyzac-trt-kins, expected trivkins
SERVO_PERIOD = 1000000 | SERVO_PERIOD = 500000 | [EMCMOT]SERVO_PERIOD: found 500000 ns
",
    );
    let right = mill().replace("[HAL]\n", "[HAL]\nTWOPASS = ON\n");
    assert_eq!(problems_of(&right), [""; 0]);
    let right = mill().replace("[JOINT_2]\n", "[JOINT_2]\nBACKLASH = 0.0\n# COMP_FILE = z.tbl\n");
    assert_eq!(problems_of(&right), [""; 0]);
}

#[test]
fn axes_that_are_read_must_be_reported() {
    let control = LinuxCncConfig { reads: vec![AxisName::A, AxisName::C], ..control() };
    let expected = expected(&control);
    let problems_of = |text: &str| {
        let problems = Ini::parse(text).problems(&expected);
        problems.iter().map(ToString::to_string).collect::<Vec<_>>()
    };
    let with = |reads: &str| mill().replace("AXES = XYZ\n", &format!("AXES = XYZ\n{reads}\n"));
    assert_eq!(problems_of(&with("READS = c A")), [""; 0]);
    let missing = |found: &str, axis: &str| {
        format!(
            "[VOLCOMP]READS: found {found}, expected {axis} among them, which the gateway's configuration reads"
        )
    };
    assert_eq!(problems_of(&with("READS = A")), [missing("A", "C")]);
    assert_eq!(problems_of(&mill()), [missing("none", "A"), missing("none", "C")]);
}

#[test]
fn included_files_are_checked() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("mill.ini");
    let problems_of = |text: &str| problems_of_file(&file, text);
    assert_eq!(problems_of(&mill()), [""; 0]);
    std::fs::write(dir.path().join("y.inc"), "COMP_FILE = y.tbl\n#INCLUDE none\n").unwrap();
    let includes = mill().replace("[JOINT_1]\n", "[JOINT_1]\n#INCLUDE y.inc\n");
    let found = problems_of(&includes).join("\n");
    assert!(found.starts_with("[JOINT_1]COMP_FILE: found y.tbl"), "{found}");
    let found = problems_of(&includes.replace("y.inc", "x.inc")).join("\n");
    assert!(found.starts_with("#INCLUDE x.inc: "), "{found}");
    assert!(Ini::read(&dir.path().join("other.ini")).is_err());
    let long = std::fs::File::create(dir.path().join("long.ini")).unwrap();
    long.set_len(1 << 40).unwrap();
    let long = |text: &str| problems_of(&text.replace("y.inc", "long.ini")).join("\n");
    let told = "long.ini: found more than 256 MiB, expected at most that";
    assert!(long(&includes).contains(told), "{}", long(&includes));
    let display = mill().replace("[HAL]\n", "[HAL]\nPOSTGUI_HALFILE = y.inc\n");
    assert!(long(&display).contains(told), "{}", long(&display));
    let error = Ini::read(&dir.path().join("long.ini")).unwrap_err().to_string();
    assert!(told.ends_with(&error), "{error}");
}

/// The HAL files of a display are loaded last. A connection to a pin of the bridge in such a file is reported with its
/// line.
#[test]
fn display_files_are_checked() {
    let dir = tempfile::tempdir().unwrap();
    let file = dir.path().join("mill.ini");
    let problems_of = |text: &str, display: &str| {
        std::fs::write(dir.path().join("display.hal"), display).unwrap();
        problems_of_file(&file, text)
    };
    std::fs::write(
        dir.path().join("mill.hal"),
        "net all-homed <= joint.0.homed\n# net x joint.1.homed\n",
    )
    .unwrap();
    let mill = mill().replace("[HAL]\n", "[HAL]\nPOSTGUI_HALFILE = display.hal\n");
    let right = "# net other motion.probe-input\nnet volcomp-probe parport.0.pin-10-in\nnet spindle spindle.0.on => pyvcp.on\n\
        net all-homed => pyvcp.homed joint.0.homed\nnet a-cmd axis.a.pos-cmd\nnet pos joint.0.pos-fb => pyvcp.x\n";
    assert_eq!(problems_of(&mill, right), [""; 0]);
    for [line, says] in &cases(
        "
net probe-in parport.0.pin-10-in => motion.probe-input | [HAL]POSTGUI_HALFILE: display.hal, line 2: found motion.probe-input connected to probe-in, expected volcomp-probe
linkps joint.1.homed y-homed | found joint.1.homed connected to y-homed, expected volcomp-homed-1
linksp x-homed joint.0.homed | found joint.0.homed connected to x-homed, expected all-homed
net off axis.z.eoffset-counts | found axis.z.eoffset-counts connected to off, expected volcomp-counts-z
",
    ) {
        let found = problems_of(&mill, &format!("# of the display\n{line}\n")).join("\n");
        assert!(found.contains(says), "{says}: {found}");
    }
    let found = problems_of(&mill, "net on motion.teleop-mode\n").join("\n");
    assert!(
        found.ends_with(
            "expected volcomp-teleop-mode: the pin already has this signal, and accepts no other"
        ),
        "{found}"
    );
    std::fs::remove_file(dir.path().join("display.hal")).unwrap();
    let problems = Ini::read(&file).unwrap().problems(&expected(&control()));
    let found = problems[0].to_string();
    assert!(found.starts_with("[HAL]POSTGUI_HALFILE: display.hal: "), "{found}");
}

proptest::proptest! {
    #[test]
    fn arbitrary_text_does_not_panic(text in "(?s).{0,300}") {
        let _ = problems_of(&text);
    }
}

#[test]
fn another_key_is_reported() {
    let dir = tempfile::tempdir().unwrap();
    let (file, key) = (dir.path().join("mill.ini"), dir.path().join("other.key"));
    std::fs::write(&file, mill().replace("[VOLCOMP]\n", "[VOLCOMP]\nKEY_FILE = other.key\n"))
        .unwrap();
    let problems_of = || {
        let problems = Ini::read(&file).unwrap().problems(&expected(&control()));
        let problems_of: Vec<String> = problems.iter().map(ToString::to_string).collect();
        problems_of.join("\n").replace(&dir.path().display().to_string(), "DIR")
    };
    assert_eq!(
        problems_of(),
        "[VOLCOMP]KEY_FILE: DIR/other.key: No such file or directory (os error 2); expected a copy of the gateway's key"
    );
    for (text, mode, says) in [
        (KEY_TEXT, 0o600, ""),
        (
            "00112233445566778899aabbccddeeff",
            0o600,
            "[VOLCOMP]KEY_FILE: DIR/other.key: found another key than the gateway's",
        ),
        (KEY_TEXT, 0o644, "[VOLCOMP]KEY_FILE: DIR/other.key: found mode 644, expected 600"),
        ("secret", 0o600, "[VOLCOMP]KEY_FILE: DIR/other.key: found another text, expected 32"),
    ] {
        write_key(&key, text, mode);
        let problems_of = problems_of();
        assert!(
            problems_of.starts_with(says) && problems_of.is_empty() == says.is_empty(),
            "{problems_of}"
        );
    }
}

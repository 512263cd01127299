//! INI files: the shipped ones are right, and each line that is missing or wrong is named.

use volcomp_linuxcnc::{Expected, Ini, PORT};
use volcomp_vocabulary::AxisName;

fn expected() -> Expected {
    Expected {
        machine: 1,
        port: PORT,
        axes: vec![AxisName::X, AxisName::Y, AxisName::Z],
        step_nm: 1.0,
        step_udeg: 1.0,
        scan_ms: 1.0,
    }
}

fn mill() -> String {
    std::fs::read_to_string(volcomp_test_support::root().join("examples/linuxcnc/mill.ini"))
        .unwrap()
}

fn told(text: &str) -> Vec<String> {
    let problems = Ini::parse(text).problems(&expected());
    problems.iter().map(ToString::to_string).collect()
}

#[test]
fn the_shipped_file_is_right() {
    assert_eq!(told(&mill()), [""; 0]);
}

#[test]
fn each_line_that_is_missing_or_wrong_is_named() {
    for (from, to, says) in [
        (
            "volcomp.tcl",
            "other.tcl",
            "[HAL]HALFILE: volcomp.tcl or volcomp-servo.tcl is missing",
        ),
        (
            "MACHINE = 1\n",
            "MACHINE = 2\n",
            "[VOLCOMP]MACHINE: found 2, expected 1",
        ),
        ("MACHINE = 1\n", "", "[VOLCOMP]MACHINE is missing"),
        (
            "AXES = XYZ",
            "AXES = X Z Y # turned",
            "[VOLCOMP]AXES: found XZY, expected XYZ",
        ),
        (
            "LIMIT_UM = 30",
            "STEP_NM = 10",
            "[VOLCOMP]STEP_NM: found 10, expected 1",
        ),
        ("LIMIT_UM = 30", "", "[VOLCOMP]LIMIT_UM is missing"),
        (
            "[AXIS_Y]\nOFFSET_AV_RATIO = 0.02",
            "[AXIS_Y]",
            "[AXIS_Y]OFFSET_AV_RATIO is missing",
        ),
        (
            "[AXIS_Y]\nOFFSET_AV_RATIO = 0.02",
            "[AXIS_Y]\nOFFSET_AV_RATIO = 0.5",
            "[AXIS_Y]OFFSET_AV_RATIO: found 0.5",
        ),
        (
            "[JOINT_1]\n",
            "[JOINT_1]\nCOMP_FILE = y.tbl\n",
            "[JOINT_1]COMP_FILE: found y.tbl",
        ),
        (
            "[JOINT_2]\n",
            "[JOINT_2]\nBACKLASH = 0.005\n",
            "[JOINT_2]BACKLASH: found 0.005",
        ),
        (
            "LINEAR_UNITS = mm",
            "LINEAR_UNITS = inch",
            "[TRAJ]LINEAR_UNITS: found inch, expected mm",
        ),
        (
            "KINEMATICS = trivkins coordinates=XYZ",
            "KINEMATICS = xyzac-trt-kins",
            "[KINS]KINEMATICS: found xyzac-trt-kins, expected trivkins",
        ),
        (
            "SERVO_PERIOD = 1000000",
            "SERVO_PERIOD = 500000",
            "[EMCMOT]SERVO_PERIOD: found 500000 ns",
        ),
    ] {
        let text = mill();
        assert!(text.contains(from), "{from}");
        let problems = told(&text.replace(from, to)).join("\n");
        assert!(problems.contains(says), "{says}: {problems}");
    }
    let right = mill().replace(
        "[JOINT_2]\n",
        "[JOINT_2]\nBACKLASH = 0.0\n# COMP_FILE = z.tbl\n",
    );
    assert_eq!(told(&right), [""; 0]);
}

proptest::proptest! {
    #[test]
    fn any_text_is_read(text in "(?s).{0,300}") {
        let _ = told(&text);
    }
}

//! Messages on invalid machine files: file, line, key, found and expected value.

use volcomp_model::Machine;
use volcomp_test_support::cases;

use crate::EXAMPLE;

/// Changes to the example: the old text | the new text. The resulting messages are in the snapshot.
const CHANGES: &str = r#"
structure = "w C' X' b Y Z t" | structure = "w C' X' Y Z t"
structure = "w C' X' b Y Z t" | structure = "w C' X' b Y' Z t"
structure = "w C' X' b Y Z t" | structure = "w C' X' b Y Z Z t"
structure = "w C' X' b Y Z t" | structure = 3
structure = "w C' X' b Y Z t" |
structure = "w C' X' b Y Z t" | type = { translational = 4 }
name = "gantry-8000" | name = "gantry-8000"\nnmae = 1
name = "gantry-8000" | name = "gantry-8000"\nname = "b"
[axes.X] | [axes.Q]
[axes.X] | [axes.A]
travel = [0.0, 8000.0] |
travel = [0.0, 8000.0] | travel = [8000.0, 8000.0]
travel = [0.0, 8000.0] | travel = [nan, 8000.0]
travel = [0.0, 8000.0] | travel = [0.0, inf]
travel = [0.0, 8000.0] | travel = [0.0]
travel = [0.0, 8000.0] | travel = "long"
travel = [0.0, 8000.0] | travel = [0.0, 8000.0]\ndirection = [0, 0, 0]
travel = [0.0, 8000.0] | travel = [0.0, 8000.0]\nmodulo = 360
travel = [0.0, 8000.0] | travel = [0.0, 8000.0]\nmotion_frame = "turning"
travel = [-360.0, 360.0] | travel = [-360.0, 360.0]\nmotion_frame = "spinning"
point = [400.0, 300.0, -200.0] | [dh]\nconvention = "paul"
point = [400.0, 300.0, -200.0] | [dh]\nrows = []
[tool]\n | [dh]\nrows = [{ axis = "C" }, { axis = "X" }, { axis = "Y" }, { axis = "Z" }]\n[tool]\n
point = [400.0, 300.0, -200.0] | direction = [0, 0, 1]\n[dh]\nrows = [{ axis = "C" }, { axis = "X" }, { axis = "Y" }, { axis = "Z" }]
point = [400.0, 300.0, -200.0] | [dh]\nrows = [{ axis = "X" }, { axis = "C" }, {}, {}]
point = [400.0, 300.0, -200.0] | [dh]\nrows = [{ axis = "C", alfa = 90 }, {}, {}, {}]
point = [400.0, 300.0, -200.0] | [dh]\nrows = [{ axis = "C", a = nan }, {}, {}, {}]
point = [400.0, 300.0, -200.0] | [dh]\nbase = { x = [0, 0, 2] }\nrows = [{}, {}, {}, {}]
axis = [0.0, 0.0, 1.0] | axis = [0, 0, 0.0]
tip = [0.0, 0.0, -150.0] | tip = [0.0, 0.0, -150.0]\ngauge = [0, 0, 0]
tip = [0.0, 0.0, -150.0] | tip = [0.0, 0.0, -150.0]\nlength = 5
name = "gantry-8000" | name = "gantry-8000"\ncorrect = ["X",\n"A"]
name = "gantry-8000" | name = "gantry-8000"\ncorrect = ["X", "C", "X"]
name = "gantry-8000" | name = "gantry-8000"\ncorrect = []
name = "gantry-8000" | name = "gantry-8000"\ncorrect = ["Q"]
name = "gantry-8000" | name = "gantry-8000"\ncorrect = "X"
lag_s = 600.0 | lag_s = -1
sensors = { spindle = 1.0, bed = -1.0 } | sensors = {}
EC0Y = 12.0 | EC0Y = nan
EC0Y = 12.0 | EC0Y = "nan"
EC0Y = 12.0 | EC0Y = { poly = [1] }
EC0Y = 12.0 | EC0Y = 12.0\n"EC(0X)Y" = 3
EC0Y = 12.0 | EY0Y = 12.0
EC0Y = 12.0 | EB0Y = 12.0
EC0Y = 12.0 | EC0C = 12.0
EC0Y = 12.0 | EXA = 12.0
EC0Y = 12.0 | EQX = 12.0
EAY = 4.0 | EAY = {}
EAY = 4.0 | EAY = { poly = [1], table = [[0, 1], [1, 2]] }
EAY = 4.0 | EAY = { poly = [] }
EAY = 4.0 | EAY = { poly = [1], order = 2 }
EAY = 4.0 | EAY = { chebyshev = [1] }
EAY = 4.0 | EAY = { table = [[0, 1], [5, 2], [5, 3]] }
EAY = 4.0 | EAY = { table = [[0, 1], [5, 2], [4, 3]] }
EAY = 4.0 | EAY = { table = [[0, 1], [5, 2, 3]] }
EAY = 4.0 | EAY = { table = [[0, 1], [5, -inf]] }
EAY = 4.0 | EAY = { table = [[0, 1], [5, 2]], interpolation = "wavy" }
EAY = 4.0 | EAY = { forward = 1 }
EAY = 4.0 | EAY = { forward = 1, backward = { forward = 1, backward = 2 } }
EAY = 4.0 | EAY = { mean = 1, reversal = inf }
EAY = 4.0 | EAY = { grid = { axes = ["Y", "A"], nodes = [[0, 1], [0, 1]], values = [[0, 1], [2, 3]] } }
EAY = 4.0 | EAY = { grid = { axes = ["Y", "Z"], nodes = [[0, 1], [0, 1]], values = [[0, 1], [2]] } }
EAY = 4.0 | EAY = { mls = { nodes = [[0, 1], [1, 2]], order = 9 } }
EAY = 4.0 | EAY = [1, 2
X = [1, 2, 3, 4, 5, 6] | X = [1, 2, 3]
X = [1, 2, 3, 4, 5, 6] | A = [1, 2, 3, 4, 5, 6]
error = "EZZ" | error = "EZA"
error = "EXX" | error = "EAX"
um_per_k = 3.2 | urad_per_k = 3.2
[thermal] | [thermal]\nrefrence = 3
"#;

#[test]
fn every_broken_file_has_its_message() {
    let mut text = String::new();
    for [from, to] in &cases(CHANGES) {
        assert!(EXAMPLE.contains(from), "{from}");
        let broken = EXAMPLE.replacen(from, to, 1);
        let message = Machine::parse(&broken, "machine.toml").expect_err(to).to_string();
        let to = to.replace('\n', " ⏎ ");
        text.extend([to.as_str(), "\n    ", message.as_str(), "\n"]);
    }
    insta::assert_snapshot!(text);
}

#[test]
fn unreadable_files_have_their_message() {
    let dir = tempfile::tempdir().unwrap();
    let latin = dir.path().join("latin.toml");
    std::fs::write(&latin, b"name = \"Fr\xe4se\"").unwrap();
    let message = Machine::read(&latin).unwrap_err().to_string();
    assert!(
        message.ends_with("latin.toml: byte 10 is not UTF-8, expected a text file in UTF-8"),
        "{message}"
    );
    for path in [dir.path().to_owned(), dir.path().join("missing.toml")] {
        let message = Machine::read(&path).unwrap_err().to_string();
        assert!(message.contains("cannot be read"), "{message}");
    }
}

proptest::proptest! {
    /// A machine file with any removal or insertion gives a machine or a message.
    #[test]
    fn damaged_files_do_not_panic(
        place in 0..crate::EXAMPLE.len(), cut in 0..40_usize,
        put in "[\\[\\]{}=,.'\"# \n0-9a-zA-Z-]{0,6}",
    ) {
        let text: Vec<char> = crate::EXAMPLE.chars().collect();
        let place = place.min(text.len());
        let end = (place + cut).min(text.len());
        let damaged: String =
            text[..place].iter().copied().chain(put.chars()).chain(text[end..].iter().copied()).collect();
        match Machine::parse(&damaged, "m.toml") {
            // Every machine that is read can be written and read again.
            Ok(machine) => {
                let again = Machine::parse(&machine.to_toml(), "m.toml");
                proptest::prop_assert_eq!(again.ok(), Some(machine));
            }
            Err(error) => proptest::prop_assert!(error.to_string().starts_with("m.toml")),
        }
    }
}

#[test]
fn the_frame_of_the_error_motions_is_part_of_the_geometry() {
    let machine = |frame: &str| {
        let text = format!(
            "structure = \"w C' b X Y Z t\"\n[axes]\nX.travel = [0, 500]\nY.travel = [0, 500]\nZ.travel = [0, 500]\n\
             C = {{ travel = [0, 360], motion_frame = \"{frame}\" }}\n"
        );
        Machine::parse(&text, "machine.toml").expect("a machine")
    };
    let turning = machine("turning");
    assert_eq!(turning.other_geometry(&machine("turning")), None);
    assert_eq!(
        turning.other_geometry(&machine("fixed")).as_deref(),
        Some("motion_frame of axis C is `turning`, expected `fixed`")
    );
}

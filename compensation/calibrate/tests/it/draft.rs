use std::fs;
use std::path::Path;

use volcomp_calibrate::{CalibrationFile, Draft, draft};
use volcomp_metrology::{DeviationUnit, Measurement, Metadata, Quantity, Reading, write_renishaw};
use volcomp_model::Machine;
use volcomp_vocabulary::Direction;

const MACHINE: &str = "structure = \"w b X Y Z t\"
axes.X.travel = [0.0, 500.0]
axes.Y.travel = [0.0, 400.0]
axes.Z.travel = [-300.0, 0.0]
";

/// File of a laser with five targets over 400 mm, and two runs in each direction; `seed` changes the readings.
fn laser(axis: &str, title: &str, unit: DeviationUnit, quantity: Quantity, seed: f64) -> String {
    let mut readings = Vec::new();
    for run in 1..=2 {
        for direction in Direction::BOTH {
            for step in 0..5 {
                let target = 100.0 * f64::from(step) * if axis == "Z" { -0.75 } else { 1.0 };
                let deviation = (seed + target * 0.01).sin() * 3.0 + f64::from(run) * 0.1;
                readings.push(Reading { target, run, direction, deviation });
            }
        }
    }
    write_renishaw(&Measurement {
        unit: Some(unit),
        quantity: Some(quantity),
        metadata: Metadata {
            axis: Some(axis.to_owned()),
            title: Some(title.to_owned()),
            ..Metadata::default()
        },
        readings,
        ..Measurement::default()
    })
}

fn linear(axis: &str, title: &str, seed: f64) -> String {
    laser(axis, title, DeviationUnit::Um, Quantity::Positioning, seed)
}

struct Shop(tempfile::TempDir);

impl Shop {
    fn new(files: &[(&str, String)]) -> Self {
        let shop = Self(tempfile::tempdir().expect("a folder"));
        shop.write("machine.toml", MACHINE);
        for (name, text) in files {
            shop.write(name, text);
        }
        shop
    }

    fn write(&self, name: &str, text: &str) {
        let path = self.0.path().join(name);
        fs::create_dir_all(path.parent().expect("a folder")).expect("made");
        fs::write(path, text).expect("written");
    }

    fn draft(&self) -> Draft {
        let machine = Machine::read(self.0.path().join("machine.toml")).expect("a machine");
        let named = |path: &Path| {
            let inside = path.strip_prefix(self.0.path()).expect("inside");
            inside.display().to_string()
        };
        let found = draft(self.0.path(), &machine, "machine.toml", named).expect("a draft");
        self.write("c.toml", &found.text);
        found
    }

    fn read(&self) -> Result<CalibrationFile, String> {
        CalibrationFile::read(&self.0.path().join("c.toml")).map_err(|error| error.to_string())
    }
}

fn keys(draft: &Draft, file: &str) -> Vec<String> {
    let of = draft.questions.iter().filter(|asked| asked.of == file);
    of.map(|asked| asked.key.clone()).collect()
}

#[test]
fn headers_and_file_names_give_proposals_and_questions() {
    let shop = Shop::new(&[
        ("laser/x-y50.rtl", linear("X", "X at Z = -20", 1.0)),
        ("eyx.rts", laser("X", "", DeviationUnit::Um, Quantity::Straightness, 2.0)),
        ("exy.rts", laser("Y", "", DeviationUnit::Um, Quantity::Straightness, 3.0)),
        ("y.rta", laser("Y", "pitch", DeviationUnit::Urad, Quantity::Angle, 4.0)),
        ("notes.pdf", "%PDF".to_owned()),
        ("c.rtl", linear("C", "", 5.0)),
        ("far.csv", "target_mm,deviation_um\n9000,1\n9100,2\n".to_owned()),
        ("ezz.csv", "target,deviation\n-10,1\n-20,2\n-30,2\n".to_owned()),
    ]);
    let found = shop.draft();
    let errors: Vec<Option<String>> =
        found.proposed.iter().map(|of| of.error.map(|error| error.to_string())).collect();
    let expected = ["EXX", "EYX", "EXY", "EZZ"].map(|name| Some(name.to_owned()));
    let unknown = errors.iter().filter(|error| error.is_none()).count();
    assert_eq!(errors.iter().flatten().count(), 4, "{errors:?}");
    assert!(expected.iter().all(|error| errors.contains(error)), "{errors:?}");
    // The errors of two files are unknown: the angular error of Y, and the table that states nothing about its content.
    assert_eq!(unknown, 2);
    // This file states the positions of both other axes.
    assert_eq!(keys(&found, "laser/x-y50.rtl"), ["point", "rides"]);
    assert!(found.text.contains("at = { Y = 50.0, Z = -20.0 }"), "{}", found.text);
    assert_eq!(keys(&found, "eyx.rts"), ["at.Y", "at.Z", "point", "rides", "sign"]);
    assert_eq!(keys(&found, "y.rta")[..1], ["error"]);
    assert!(found.text.contains("# error: one of EAY, EBY, ECY"), "{}", found.text);
    assert!(keys(&found, "ezz.csv").contains(&"unit".to_owned()));
    assert_eq!(keys(&found, "EC0Y"), ["reference_angle_urad"]);
    let left: Vec<&str> = found.left_over.iter().map(|of| of.file.as_str()).collect();
    assert_eq!(left, ["c.rtl", "notes.pdf"]);
    assert!(found.left_over[0].reason.contains("axis C"), "{:?}", found.left_over);
    // The text names the file once, before the reason.
    for of in &found.left_over {
        assert!(!of.reason.contains(&of.file), "{of:?}");
    }
    let unread = "# not used: notes.pdf: found";
    assert!(found.text.contains(unread), "{}", found.text);
    // Each question is in the text as a value and as a comment.
    assert_eq!(found.text.matches("# QUESTION").count(), found.questions.len());
    assert_eq!(found.text.matches("\"?\"").count(), found.questions.len() + 1);
    let refused = shop.read().unwrap_err();
    assert!(refused.contains("open question") && refused.contains("c.toml:"), "{refused}");
}

#[test]
fn duplicate_and_contradictory_files_are_conflicts() {
    let shop = Shop::new(&[
        ("x-y50-z0.rtl", linear("X", "", 1.0)),
        ("again/x-y50-z0.rtl", linear("X", "", 2.0)),
        ("eyy.rtl", linear("X", "", 3.0)),
        ("y.rtl", linear("Y", "", 4.0)),
        ("y-copy.rtl", linear("Y", "", 4.0)),
    ]);
    let found = shop.draft();
    let said = found.conflicts.join("\n");
    assert!(
        said.contains("again/x-y50-z0.rtl and x-y50-z0.rtl both measure EXX at the same place"),
        "{said}"
    );
    assert!(said.contains("y.rtl has the same readings as y-copy.rtl"), "{said}");
    assert!(said.contains("both measure EYY: `at` must distinguish them"), "{said}");
    assert!(
        found.text.contains("# CONTRADICTION: the file states axis X, its name or title says EYY"),
        "{}",
        found.text
    );
    let refused = shop.read().unwrap_err();
    assert!(refused.contains("open question"), "{refused}");
    assert!(found.text.contains("file = \"?\""), "{}", found.text);
}

#[test]
fn texts_from_files_stay_in_comments() {
    let shop = Shop::new(&[("exx.rtl", linear("X", "\"]]\t[[measurement]] # x\u{b}", 1.0))]);
    let found = shop.draft();
    assert_eq!(found.text.lines().filter(|line| line.starts_with("[[")).count(), 1);
    assert!(shop.read().unwrap_err().contains("open question"));
}

#[test]
fn columns_of_the_calibration_file_are_those_of_its_tables() {
    let table = "Soll;Ist\n0,0;0,001\n100,0;100,003\n200,0;200,004\n";
    let shop = Shop::new(&[
        ("x.csv", table.to_owned()),
        ("x.ren", "No. Axis position Combined\n1 0 1\n2 9 2\n".to_owned()),
    ]);
    let head = "machine = \"machine.toml\"\n[columns]\ntarget = \"Soll\"\nmeasured = \"Ist\"\nseparator = \";\"\ndecimal_comma = true\nunit = \"mm\"\n";
    shop.write("c.toml", &format!("{head}[[measurement]]\nerror = \"EXX\"\nfile = \"x.csv\"\n"));
    let file = shop.read().expect("read");
    let largest =
        file.measurements[0].readings.readings.iter().map(|r| r.deviation).fold(0.0, f64::max);
    assert!((largest - 4.0).abs() < 1e-6, "{largest}");
    // Compensation values need answers about sign and unit.
    let export = |keys: &str| {
        format!(
            "machine = \"machine.toml\"\n[[measurement]]\nerror = \"EXX\"\nfile = \"x.ren\"\n{keys}"
        )
    };
    shop.write("c.toml", &export("unit = \"um\"\n"));
    assert!(shop.read().unwrap_err().contains("compensation values for a control"));
    shop.write("c.toml", &export("unit = \"um\"\nsign = -1\n"));
    let file = shop.read().expect("read");
    assert_eq!(file.measurements[0].readings.readings[1].deviation, -2.0);
}

#[test]
fn files_of_another_machine_and_targets_beyond_the_travel_are_noted() {
    let of = |machine: &str, axis: &str, scale: f64| {
        let text = linear(axis, "", scale);
        let mut found = volcomp_metrology::parse_renishaw(
            text.as_bytes(),
            "x.rtl",
            volcomp_metrology::RenishawKind::Linear,
        )
        .expect("a file");
        found.metadata.machine = Some(machine.to_owned());
        for reading in &mut found.readings {
            reading.target *= scale;
        }
        write_renishaw(&found)
    };
    let shop = Shop::new(&[
        ("exx.rtl", of("mill-7", "X", 1.0)),
        ("eyy.rtl", of("MILL-7 ", "Y", 1.0)),
        ("ezz.rtl", of("gantry-2", "Z", 1.25)),
    ]);
    shop.write("machine.toml", &format!("name = \"mill-7\"\n{MACHINE}"));
    let found = shop.draft();
    assert_eq!(found.proposed.len(), 3, "{:?}", found.left_over);
    let notes = found.notes.join("\n");
    let other = "ezz.rtl: it states the machine `gantry-2`, and the machine file is of `mill-7`";
    assert!(notes.contains(other), "{notes}");
    assert!(
        notes.contains("ezz.rtl: targets from -375 to") && notes.contains("beyond the travel of Z"),
        "{notes}"
    );
    assert!(!notes.contains("exx.rtl") && !notes.contains("eyy.rtl"), "{notes}");
    let conflicts = found.conflicts.join("\n");
    assert!(conflicts.contains("the measurement files state different machines"), "{conflicts}");
    assert!(found.text.contains("# LOOK: it states the machine"), "{}", found.text);
}

#[test]
fn one_answer_applies_to_every_question_of_its_key() {
    let shop = Shop::new(&[
        ("exx.rtl", linear("X", "", 1.0)),
        ("eyy.rtl", linear("Y", "", 2.0)),
        ("ezz.rtl", linear("Z", "", 3.0)),
        ("ebx.rta", laser("X", "", DeviationUnit::Urad, Quantity::Angle, 4.0)),
    ]);
    let found = shop.draft();
    let before = found.questions.len();
    assert_eq!(found.for_all(None, "rides", "carriage").len(), 3);
    assert_eq!(found.for_all(Some("Y"), "at.X", "40").len(), 1);
    assert_eq!(found.for_all(Some("EXX"), "at.Y", "50").len(), 1);
    assert!(found.for_all(None, "bridge_mm", "100").is_empty());
    assert!(found.for_all(Some("EZY"), "rides", "other").is_empty());
    let mut answers = found.for_all(None, "rides", "carriage");
    answers.extend(found.for_all(Some("Y"), "at.X", "40"));
    let answered = found.answered(&answers).expect("answers");
    assert_eq!(answered.questions.len(), before - 4);
    assert!(answered.text.contains("at = { X = 40.0, Z = \"?\" }"), "{}", answered.text);
}

//! `[provenance]` is read, written, removed with its error, and rejected if invalid.

use volcomp_model::{Machine, Provenance, Source, is_date, sha256_of};
use volcomp_test_support::cases;

/// SHA-256 of the empty message and of "abc" (FIPS 180-4, examples).
const OF_NOTHING: &str = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855";
const OF_ABC: &str = "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad";

fn text(provenance: &str) -> String {
    format!(
        "structure = \"w X' b Z t\"\n[axes]\nX.travel = [0, 500]\nZ.travel = [0, 300]\n[errors]\nEXX = {{ poly = [0, 0.01] }}\nEBZ = 2\nEB0Z = 4\n{provenance}"
    )
}

fn told() -> String {
    text(&format!(
        "[provenance]\nversion = \"0.1.0\"\nserial = \"7 \\\"b\\\"\"\ndate = \"2024-02-29\"\n[[provenance.error]]\nerror = \"EXX\"\nmethod = \"polynomial of order 1\"\nrule = \"smallest\"\nresidual_um = 0.25\nleave_one_out_um = 0.5\nfrom = [{{ file = \"x.rtl\", sha256 = \"{OF_ABC}\", runs = 5, targets = 21, at = {{ Z = 120.5 }}, date = \"today\" }}]\n[[provenance.error]]\nerror = \"EBZ\"\nmethod = \"stated\"\nresidual_urad = 1\n[[provenance.error]]\nerror = \"EB0Z\"\nmethod = \"stated\"\n"
    ))
}

#[test]
fn what_is_written_is_what_was_read_and_counts_in_the_checksum() {
    let machine = Machine::parse(&told(), "m.toml").expect("a machine");
    let again = Machine::parse(&machine.to_toml(), "n.toml").expect("written");
    assert_eq!(again, machine);
    let exx = machine.provenance().of("EXX".parse().expect("a name"));
    let exx = exx.expect("told");
    assert_eq!((exx.residual, exx.leave_one_out), (Some(0.25), Some(0.5)));
    let expected = Source {
        file: "x.rtl".to_owned(),
        sha256: OF_ABC.to_owned(),
        runs: Some(5),
        targets: Some(21),
        at: vec![(volcomp_model::vocabulary::AxisName::Z, 120.5)],
        date: Some("today".to_owned()),
    };
    assert_eq!(exx.sources, [expected]);
    let other = told().replace("runs = 5", "runs = 4");
    let other = Machine::parse(&other, "m.toml").expect("a machine");
    assert_ne!(other.checksum(), machine.checksum());
    let bare = Machine::parse(&text(""), "m.toml").expect("a machine");
    assert!(!bare.to_toml().contains("provenance"));
}

#[test]
fn what_is_set_anew_loses_its_provenance() {
    let mut machine = Machine::parse(&told(), "m.toml").expect("a machine");
    let name = |text: &str| text.parse().expect("a name");
    let curve = machine.error(name("EBZ")).expect("there").clone();
    machine.set_error(name("EBZ"), curve.clone()).expect("set");
    assert!(machine.provenance().of(name("EBZ")).is_none());
    assert!(machine.provenance().of(name("EXX")).is_some());
    machine.set_location(name("EB0Z"), 5.0).expect("set");
    assert_eq!(machine.provenance().errors.len(), 1);
    machine.set_error(name("EXX"), curve).expect("set");
    assert_eq!(*machine.provenance(), Provenance::default());
    let mut machine = Machine::parse(&told(), "m.toml").expect("a machine");
    machine.clear_errors();
    assert!(machine.provenance().is_empty());
}

#[test]
fn what_cannot_be_is_refused_with_its_place() {
    for [from, to, expected] in &cases(
        r#"
2024-02-29 | 2023-02-29 | m.toml:9: provenance: date: found `2023-02-29`
error = "EBZ" | error = "EXX" | residual_urad
error = "EB0Z" | error = "EXX" | EXX appears twice
error = "EB0Z" | error = "EYX" | found EYX, expected an error of the table [errors]
residual_um = 0.25 | residual_um = -1 | EXX: found -1, expected a finite number of 0 or more
residual_um | residual_urad | residual_urad
ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad | abc | EXX: found `abc` as sha256
method = "stated"\nresidual | methode = "stated"\nresidual | methode
runs = 5 | runs = -5 | runs
{ Z = 120.5 } | { Q = 120.5 } | Q
"#,
    ) {
        let wrong = told().replacen(from, to, 1);
        assert_ne!(wrong, told(), "{from}");
        let message = Machine::parse(&wrong, "m.toml").expect_err(to).to_string();
        assert!(message.contains(expected), "{to}: {message}");
    }
}

#[test]
fn hashes_are_those_of_the_standard() {
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().join("f");
    for (bytes, hash) in [(&b""[..], OF_NOTHING), (b"abc", OF_ABC)] {
        std::fs::write(&path, bytes).expect("written");
        assert_eq!(sha256_of(&path).expect("read"), hash);
    }
    assert!(sha256_of(folder.path()).is_err());
}

/// `is_date` accepts exactly the dates of the calendar.
#[test]
fn days_are_those_of_the_calendar() {
    for day in ["2024-02-29", "2000-02-29", "2026-12-31", "0001-01-01"] {
        assert!(is_date(day), "{day}");
    }
    for day in [
        "",
        "2026",
        "2026-13-01",
        "2026-00-10",
        "2026-11-00",
        "2026-04-31",
        "2026-02-29",
        "2100-02-29",
        "26-11-25",
        "2026-1-05",
        "2026-11-25-",
        "2026-11-25T",
        "+026-11-25",
        "ä026-11-25",
    ] {
        assert!(!is_date(day), "{day}");
    }
}

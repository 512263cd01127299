//! The largest correction within the travels, compared with closed forms.

use volcomp_model::{Machine, Temperatures};

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

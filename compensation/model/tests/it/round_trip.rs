use proptest::prelude::*;
use volcomp_model::Machine;

use crate::EXAMPLE;

#[test]
fn a_written_machine_reads_back_the_same() {
    let machine = Machine::parse(EXAMPLE, "a.toml").unwrap();
    let text = machine.to_toml();
    let again = Machine::parse(&text, "b.toml").unwrap();
    assert_eq!(machine, again);
    assert_eq!(text, again.to_toml());
}

#[test]
fn comments_and_order_do_not_change_the_checksum_but_numbers_do() {
    let plain = "name = \"m\"\nstructure = \"w b X t\"\n[axes.X]\ntravel = [0, 1]\n[errors]\nEXX = 1\nEYX = 2\n";
    let other = "structure = \"w b X t\" # chain\nname = \"m\"\n[errors]\nEYX = 2.0\nEXX = 1.0\n[axes]\nX.travel = [0.0, 1.0]\n";
    let checksum = |text: &str| Machine::parse(text, "m.toml").unwrap().checksum();
    assert_eq!(checksum(plain), checksum(other));
    assert_ne!(checksum(plain), checksum(&plain.replace("EYX = 2", "EYX = 2.1")));
}

#[test]
fn a_changed_file_is_noticed() {
    let text = Machine::parse(EXAMPLE, "a.toml").unwrap().to_toml();
    let changed = text.replace("EAY = 4.0", "EAY = 4.5");
    assert_ne!(text, changed);
    let message = Machine::parse(&changed, "a.toml").unwrap_err().to_string();
    assert!(message.starts_with("a.toml:2: checksum: found sha256:"), "{message}");
}

proptest! {
    #[test]
    fn no_text_makes_the_reader_panic(text in ".{0,200}") {
        let _ = Machine::parse(&text, "f");
    }

    #[test]
    fn no_change_of_one_place_makes_the_reader_panic(place in 0..EXAMPLE.len(), with in "[ -~]{0,3}") {
        let mut text = EXAMPLE.to_owned();
        text.replace_range(place..=place, &with);
        if let Ok(machine) = Machine::parse(&text, "f") {
            prop_assert_eq!(Machine::parse(&machine.to_toml(), "g").unwrap(), machine);
        }
    }
}

#[test]
fn the_shipped_examples_are_machines() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../examples");
    for name in ["gantry.toml", "five-axis.toml"] {
        let machine = Machine::read(folder.join(name)).unwrap();
        assert!(machine.errors().count() > 0);
    }
}

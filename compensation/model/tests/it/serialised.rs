//! Machines that are written and read with serde.

use volcomp_model::{Axis, Fading, Machine, Thermal, Tool};

use crate::EXAMPLE;

#[test]
fn a_machine_reads_back_the_same() {
    let machine = Machine::parse(EXAMPLE, "m").unwrap();
    let text = serde_json::to_string(&machine).unwrap();
    assert_eq!(serde_json::from_str::<Machine>(&text).unwrap(), machine);
    // Deserialisation makes all checks of the machine file, including the checksum.
    for (from, to, told) in [
        ("w C'", "w Q'", "machine:3: structure:"),
        ("EC0Y = 12.0", "EC0Y = 13.0", "machine:2: checksum:"),
    ] {
        assert!(text.contains(from), "{text}");
        let error =
            serde_json::from_str::<Machine>(&text.replacen(from, to, 1)).expect_err(to).to_string();
        assert!(error.contains(told), "{error}");
    }
}

#[test]
fn plain_types_read_back_the_same() {
    let machine = Machine::parse(EXAMPLE, "m").unwrap();
    let axes = serde_json::to_string(machine.axes()).unwrap();
    assert_eq!(serde_json::from_str::<Vec<Axis>>(&axes).unwrap(), machine.axes());
    let thermal = serde_json::to_string(machine.thermal()).unwrap();
    assert_eq!(&serde_json::from_str::<Thermal>(&thermal).unwrap(), machine.thermal());
    let tool = serde_json::to_string(machine.tool()).unwrap();
    assert_eq!(&serde_json::from_str::<Tool>(&tool).unwrap(), machine.tool());
    let fading = serde_json::to_string(&Fading::default()).unwrap();
    assert_eq!(serde_json::from_str::<Fading>(&fading).unwrap(), Fading::default());
}

//! cantools (PyPI) decodes the same values from the same DBC file and frames.

use std::{fmt::Write, process::Command};

use volcomp_can::{BARRIER_DBC, SHIPPED_DBC, SignalTable};

/// Signals in both byte orders at unaligned positions, classic and FD.
const ODD: &str = "VERSION \"\"\n\nBU_: A\n\n\
    BO_ 100 ODD: 8 A\n SG_ A : 3|13@1- (0.25,-7) [0|0] \"\" A\n SG_ B : 20|5@0+ (1,0) [0|0] \"\" A\n SG_ C : 37|17@0- (0.001,3) [0|0] \"\" A\n SG_ D : 60|3@1+ (2,0) [0|0] \"\" A\n\n\
    BO_ 2147484748 LONG: 24 A\n SG_ E : 7|64@0- (1,0) [0|0] \"\" A\n SG_ F : 64|64@1+ (1,0) [0|0] \"\" A\n SG_ G : 133|31@0- (1e-3,0) [0|0] \"\" A\n";

#[test]
fn cantools_decodes_the_same_values() {
    let Some(python) = volcomp_test_support::peers::python() else {
        return;
    };
    let mut seed = 0x1234_5678_9abc_def0_u64;
    let mut random = || {
        seed ^= seed << 13;
        seed ^= seed >> 7;
        seed ^= seed << 17;
        seed.to_le_bytes()[3]
    };
    for text in [SHIPPED_DBC, BARRIER_DBC, ODD] {
        let table = SignalTable::parse(text).unwrap();
        let mut lines = String::new();
        for round in 0..200 {
            let message = &table.messages[round % table.messages.len()];
            let mut data: Vec<u8> = (0..message.length).map(|_| random()).collect();
            message.seal(&mut data, u64::from(random() & 15));
            write!(lines, "{} ", message.name).unwrap();
            for byte in &data {
                write!(lines, "{byte:02x}").unwrap();
            }
            for signal in &message.signals {
                write!(lines, " {}={:?}", signal.name, signal.value(&data)).unwrap();
            }
            lines.push('\n');
        }
        let folder = std::env::temp_dir().join(format!("volcomp-can-{}", std::process::id()));
        std::fs::create_dir_all(&folder).unwrap();
        let [dbc, values] = ["frames.dbc", "values.txt"].map(|name| folder.join(name));
        std::fs::write(&dbc, text).unwrap();
        std::fs::write(&values, lines).unwrap();
        let program = "import sys, cantools\n\
            db = cantools.database.load_file(sys.argv[1])\n\
            count = 0\n\
            for line in open(sys.argv[2]):\n\
            \x20   name, data, *pairs = line.split()\n\
            \x20   data = bytes.fromhex(data)\n\
            \x20   message = db.get_message_by_name(name)\n\
            \x20   found = message.decode(data, decode_choices=False)\n\
            \x20   assert len(found) == len(pairs)\n\
            \x20   for pair in pairs:\n\
            \x20       signal, value = pair.split('=')\n\
            \x20       assert abs(found[signal] - float(value)) <= 1e-9 * max(1, abs(found[signal])), (line, signal, found[signal])\n\
            \x20       count += 1\n\
            print(count)\n";
        let output =
            Command::new(&python).args(["-c", program]).args([&dbc, &values]).output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        std::fs::remove_dir_all(folder).unwrap();
    }
}

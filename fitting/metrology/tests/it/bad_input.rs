//! Broken files and their messages.

use std::fmt::Write as _;

use volcomp_metrology::{RenishawKind, parse_csv, parse_renishaw, read_file};

use crate::samples::{BIDIRECTIONAL_RTL, rtl_with};

fn rtl_message(bytes: &[u8]) -> String {
    parse_renishaw(bytes, "x.rtl", RenishawKind::Linear).unwrap_err().to_string()
}

#[test]
fn messages_about_renishaw_files() {
    let changes = [
        ("File type  : rtl", "File type  : rta"),
        ("HEADER::\r\n", "target,deviation\r\n"),
        ("TARGET DATA::", "TARGETS::"),
        ("Target-count: 3", "Target-count: three"),
        ("Target-count: 3", "Target-count: 4000000000"),
        ("Target-count: 3", "Target count 3"),
        ("Target-count: 3", "Target-count: 3\r\nTarget-count: 3"),
        ("250.500000", "25x.5"),
        ("250.500000", "nan"),
        ("\r\n-100.000000  0.000000", "\r\nnan  0.000000"),
        ("250.500000", "１２.5"),
        ("250.500000", "0.0"),
        ("250.500000", "250,5"),
        ("250.500000", ""),
        ("Flags: 0 0 2 0\r\n", ""),
        ("Flags: 0 0 2 0", "Flags: 0 0"),
        ("Flags: 0 0 2 0", "Flags: 0 x 2 0"),
        ("Run-count: 4", "Run-count: 0"),
        ("Run-count: 4", "Run-count: 4000000000"),
        ("Run-count: 4", "Run-count: 3"),
        ("   4     1   4.200000\r\n", ""),
        ("   4     1   4.200000", "   4     2   4.200000"),
        ("   4     1   4.200000", "   4     4   4.200000"),
        ("   4     1   4.200000", "   4     1   4."),
        ("   4     1   4.200000", "   4     1   1e999"),
        ("   4     1   4.200000", "   4     1   -inf"),
        ("   4     1   4.200000", "   4     1"),
        ("   4     1   4.200000", "   4     1\u{a0}4.2"),
        ("   2     3  -2.000000\r\n   2     2   3.500000", "   2     2   3.5\r\n   2     3  -2"),
        ("RUNS::", "RUNS::\r\nRUNS::"),
        ("Air temp   : 20.337280", "Air temp   : nan"),
        ("20.384956 0", "20.384956 0 1 2"),
        ("46.954897 46.893887", "46.954897 46.893887 C"),
        ("EOF::\r\n", ""),
        ("1.200000\r\n", "1.2\0\r\n"),
    ];
    let mut messages = String::new();
    for (from, to) in changes {
        let message = rtl_message(rtl_with(from, to).as_bytes());
        writeln!(messages, "{from:?} -> {to:?}\n    {message}").unwrap();
    }
    let one_way = BIDIRECTIONAL_RTL
        .replace("2     3  -2.0", "2     1  -2.0")
        .replace("2     1   4.0", "2     3   4.0")
        .replace("4     3  -1.8", "4     1  -1.8")
        .replace("4     1   4.2", "4     3   4.2");
    let cut = &BIDIRECTIONAL_RTL[..BIDIRECTIONAL_RTL.find("7000").unwrap() + 2];
    for (what, bytes) in [
        ("bidirectional flags, reverse runs sorted", one_way.as_bytes()),
        ("cut in the middle of a number", cut.as_bytes()),
        ("empty", b""),
        ("blank", b" \r\n\r\n"),
        ("UTF-16", b"\xFF\xFEH\0E\0"),
        (
            "Latin-1 in a number",
            &[b"HEADER::\r\nTARGET DATA::\r\nTarget-count: \xB2\r\nEOF::\r\n"[..].to_vec()]
                .concat(),
        ),
    ] {
        writeln!(messages, "{what}\n    {}", rtl_message(bytes)).unwrap();
    }
    insta::assert_snapshot!(messages);
}

#[test]
fn messages_about_tables() {
    let rows =
        "target,run,direction,deviation\n0,1,+,1.25\n10,1,+,2.25\n20,1,+,3.25\n30,1,+,4.25\n";
    let mut messages = String::new();
    for text in [
        "",
        "\n \n",
        "target,deviation\n",
        "target;value\n0;1\n",
        "target,deviation,run\n0,1,1\n",
        "target,value\n0,1\n",
        "0,1\n1,2\n",
        "target,target\n0,1\n",
        "HEADER::\nEOF::\n",
        "target,deviation\n0,1\n1\n",
        "target,deviation\n0,1,2\n",
        "target,deviation\n0,nan\n",
        "target,deviation\n0,Infinity\n",
        "target,deviation\n1e999,0\n",
        "target,deviation\n0,\n",
        "target,deviation\n0,2.\n",
        "target,deviation\n0,1\n-0.0,2\n",
        "target,deviation\n\"0,1\n1,2\n",
        "target,run,direction,deviation\n0,0,+,1\n",
        "target,run,direction,deviation\n0,1.5,+,1\n",
        "target,run,direction,deviation\n0,1,left,1\n",
        "target,run,direction,deviation\n0,1,+,1\n\n0,1,+,1\n",
        "target,run,direction,deviation\r\n0,1,+,1\r\n \r\n\r\n0,2,+,x\r\n",
        &format!("{rows}40,1,+,5.2"),
    ] {
        let message = parse_csv(text.as_bytes(), "x.csv").unwrap_err();
        writeln!(messages, "{text:?}\n    {message}").unwrap();
    }
    insta::assert_snapshot!(messages);
}

#[test]
fn messages_about_paths() {
    let dir = tempfile::tempdir().unwrap();
    std::fs::create_dir(dir.path().join("folder.rtl")).unwrap();
    std::fs::write(dir.path().join("a.rtm"), "x").unwrap();
    std::fs::write(dir.path().join("plain"), "x").unwrap();
    std::fs::write(dir.path().join("table.rtl"), "target,deviation\n0,1\n").unwrap();
    std::fs::write(dir.path().join("laser.csv"), BIDIRECTIONAL_RTL).unwrap();
    let mut messages = String::new();
    for name in ["folder.rtl", "a.rtm", "plain", "table.rtl", "laser.csv", "absent.csv"] {
        let message = read_file(&dir.path().join(name)).unwrap_err().to_string();
        let shown = message.replace(&dir.path().display().to_string(), "DIR");
        writeln!(messages, "{shown}").unwrap();
    }
    insta::assert_snapshot!(messages);
}

#[test]
fn the_extension_selects_the_format_in_any_case() {
    let dir = tempfile::tempdir().unwrap();
    for (name, text) in [
        ("a.RTL", BIDIRECTIONAL_RTL.to_owned()),
        ("a.Rta", rtl_with("rtl", "rta")),
        ("a.CSV", "target,deviation\n0,1\n".to_owned()),
    ] {
        let path = dir.path().join(name);
        std::fs::write(&path, text).unwrap();
        let m = read_file(&path).unwrap();
        assert_eq!(m.name, path.display().to_string());
    }
}

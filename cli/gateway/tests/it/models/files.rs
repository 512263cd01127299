//! Uploaded machine files are complete, limited in size, and only in memory until activation.

use std::{
    io::{Read, Write},
    process::Command,
    time::{Duration, Instant},
};

use super::{ENGINEER, Rig, activate, candidate, machine_file, model, upload, with_y};
use crate::program::{PATIENCE, path};

/// A truncated upload leaves no candidate. A file name with a path is reduced to its last part.
#[test]
fn a_file_is_taken_whole_under_a_plain_name() {
    let rig = Rig::new("");
    let program = rig.start();
    let mut stream = program.connect();
    let head = format!(
        "POST /api/model/upload?kind=machine&name=cut.toml HTTP/1.1\r\nHost: {}\r\nAuthorization: Bearer {ENGINEER}\r\nContent-Length: 1000\r\n\r\nhalf",
        program.address
    );
    stream.write_all(head.as_bytes()).expect("it listens");
    stream.shutdown(std::net::Shutdown::Write).expect("ours");
    let mut rest = String::new();
    let _ = stream.read_to_string(&mut rest);
    assert_eq!(program.get("/api/model/candidate").status, 404);
    let text = with_y(21.0);
    for nameless in ["..", "%2F", ""] {
        let query = format!("kind=machine&name={nameless}");
        assert_eq!(upload(&program, &query, text.as_bytes()).status, 400);
    }
    let query = "kind=machine&name=..%2F..%2F%3Cscript%3E.toml";
    let sent = upload(&program, query, text.as_bytes());
    assert_eq!(sent.status, 200, "{}", sent.body);
    assert_eq!(sent.json()["file"]["name"], "_script_.toml");
    let everything = candidate(&program).to_string();
    assert!(!everything.contains(path(rig.dir.path())), "no path of this computer: {everything}");
}

/// On a full disk (a small file system) an activation fails with status 507. The space reserved for the audit log stays
/// reserved.
#[test]
fn a_full_disk_refuses_a_model_and_keeps_the_log() {
    let rig = Rig::new("");
    let folder = rig.dir.path().join("audit");
    std::fs::create_dir_all(&folder).expect("writable");
    let mounted =
        Command::new("mount").args(["-t", "tmpfs", "-o", "size=8m", "tmpfs"]).arg(&folder).status();
    if !mounted.is_ok_and(|status| status.success()) {
        volcomp_test_support::peers::not_run("the right to mount");
        return;
    }
    let program = rig.start();
    let before = model(&program)["hash"].clone();
    // The free space is less than the audit log needs from the start.
    let made = machine_file(&program, &with_y(21.0));
    let refused = activate(&program, &made, None);
    let after = model(&program)["hash"].clone();
    program.must_arm();
    drop(program);
    // An error of `umount` cannot be handled here.
    let _ = Command::new("umount").arg("-l").arg(&folder).status();
    assert_eq!(refused.status, 507, "{}", refused.body);
    assert!(refused.body.contains("full"), "{}", refused.body);
    assert_eq!(before, after);
}

/// Four silent clients occupy the upload slots. When they time out, a fifth client is served. Disarming is never
/// delayed.
#[test]
fn silent_clients_do_not_prevent_disarming() {
    let rig = Rig::new("");
    let program = rig.start();
    let begin = |_| {
        let mut stream = program.connect();
        let head = format!(
            "POST /api/model/upload?kind=machine&name=m.toml HTTP/1.1\r\nHost: {}\r\nAuthorization: Bearer {ENGINEER}\r\nContent-Length: 8\r\n\r\n1,2\n",
            program.address
        );
        stream.write_all(head.as_bytes()).expect("it listens");
        stream
    };
    let streams: Vec<_> = (0..4).map(begin).collect();
    let text = with_y(21.0);
    let send = |name: &str| {
        let query = format!("kind=machine&name={name}");
        upload(&program, &query, text.as_bytes()).status
    };
    let end = Instant::now() + PATIENCE;
    // An upload without a valid file name creates no candidate, which would disconnect the four clients.
    while send("..") != 503 {
        assert!(Instant::now() < end, "the places are not held");
        std::thread::sleep(Duration::from_millis(20));
    }
    assert_eq!(program.post("/api/disarm", "").status, 200);
    drop(streams);
    let end = Instant::now() + PATIENCE;
    while send("m.toml") != 200 {
        assert!(Instant::now() < end, "the places are not given back");
        std::thread::sleep(Duration::from_millis(20));
    }
}

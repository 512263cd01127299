//! Files that are sent: whole, in their folder, and no more than all may be.

use std::{
    io::{Read, Write},
    process::Command,
    time::{Duration, Instant},
};

use serde_json::json;

use super::measured::{all_answers, answers, measured_rig, send_measurements};
use super::{ENGINEER, Rig, activate, candidate, post, settled, upload};
use crate::program::{PATIENCE, answer, path};

/// The largest file that is taken, bytes.
const LARGEST: usize = 4 * 1024 * 1024;

/// Names that lead elsewhere, two hundred files, one that is cut, one that is too large: nothing outside of the folder, nothing
/// half there.
#[test]
fn files_stay_in_their_folder_and_whole() {
    let rig = Rig::new("");
    let program = rig.start();
    let begun = upload(
        &program,
        "kind=measurement&name=..%2F..%2F..%2Fx.csv",
        b"1,2\n",
    )
    .json();
    let id = begun["id"].as_str().expect("named").to_owned();
    let script = upload(
        &program,
        &format!("kind=measurement&name=%3Cscript%3E.rtl&candidate={id}"),
        b"rubbish",
    );
    assert_eq!(script.status, 200, "{}", script.body);
    let folder = rig
        .dir
        .path()
        .join("audit/models/uploads")
        .join(&id)
        .join("files");
    let names = || -> Vec<String> {
        let entries = std::fs::read_dir(&folder).expect("there");
        let mut names: Vec<String> = entries
            .map(|entry| {
                entry
                    .expect("there")
                    .file_name()
                    .into_string()
                    .expect("UTF-8")
            })
            .collect();
        names.sort();
        names
    };
    // Bytes that are no text.
    let query = format!("kind=measurement&name=%ff%fex.csv&candidate={id}");
    assert_eq!(upload(&program, &query, b"1,2\n").status, 200);
    assert_eq!(names(), ["__x.csv", "_script_.rtl", "x.csv"]);
    // Cut in the middle.
    let mut stream = program.connect();
    let head = format!(
        "POST /api/model/upload?kind=measurement&name=cut.csv&candidate={id} HTTP/1.1\r\nHost: {}\r\nAuthorization: Bearer {ENGINEER}\r\nContent-Length: 1000\r\n\r\nhalf",
        program.address
    );
    stream.write_all(head.as_bytes()).expect("it listens");
    stream.shutdown(std::net::Shutdown::Write).expect("ours");
    let mut rest = String::new();
    let _ = stream.read_to_string(&mut rest);
    let end = Instant::now() + PATIENCE;
    while names().len() > 3 {
        assert!(Instant::now() < end, "{:?}", names());
        std::thread::sleep(Duration::from_millis(20));
    }
    // The name is free again.
    let end = Instant::now() + PATIENCE;
    let query = format!("kind=measurement&name=cut.csv&candidate={id}");
    while upload(&program, &query, b"1,2\n").status != 200 {
        assert!(Instant::now() < end);
        std::thread::sleep(Duration::from_millis(50));
    }
    // Too large, by its length and by what comes.
    let large = vec![b'1'; LARGEST + 1];
    let refused = upload(
        &program,
        &format!("kind=measurement&name=large.csv&candidate={id}"),
        &large,
    );
    assert_eq!(refused.status, 413, "{}", refused.body);
    assert!(!names().contains(&"large.csv".to_owned()));
    for number in 0..196 {
        let query = format!("kind=measurement&name=f{number}.csv&candidate={id}");
        let sent = upload(&program, &query, b"1,2\n");
        assert_eq!(sent.status, 200, "{number}: {}", sent.body);
    }
    let over = upload(
        &program,
        &format!("kind=measurement&name=over.csv&candidate={id}"),
        b"1,2\n",
    );
    assert_eq!(over.status, 409, "{}", over.body);
    assert!(over.body.contains("200"), "{}", over.body);
    // They are no measurements: told, and nothing else happens.
    assert_eq!(
        post(&program, "draft", &json!({ "candidate": id })).status,
        200
    );
    let made = settled(&program);
    assert!(
        made["error"].is_string() || made["draft"].is_object(),
        "{made}"
    );
    assert!(!rig.dir.path().join("x.csv").exists());
    let everything = candidate(&program).to_string();
    assert!(
        !everything.contains(path(rig.dir.path())),
        "no path of this computer: {everything}"
    );
    post(&program, "discard", &json!({ "candidate": id }));
}

/// The disk is full: the file is refused, and nothing of it stays. A small file system stands for it.
#[test]
fn a_full_disk_refuses_files_and_keeps_the_log() {
    let rig = Rig::new("");
    let folder = rig.dir.path().join("audit");
    std::fs::create_dir_all(&folder).expect("writable");
    let mounted = Command::new("mount")
        .args(["-t", "tmpfs", "-o", "size=8m", "tmpfs"])
        .arg(&folder)
        .status();
    if !mounted.is_ok_and(|status| status.success()) {
        volcomp_test_support::peers::not_run("the right to mount");
        return;
    }
    let program = rig.start();
    // Less than what the audit log needs is free from the start.
    let refused = upload(&program, "kind=measurement&name=a.csv", b"1,2\n");
    program.must_arm();
    drop(program);
    // Nothing else can be done where it fails.
    let _ = Command::new("umount").arg("-l").arg(&folder).status();
    assert_eq!(refused.status, 507, "{}", refused.body);
    assert!(refused.body.contains("full"), "{}", refused.body);
}

/// Before, answers that were given while a further file was on its way led to a model that left this file out.
#[test]
fn nobody_goes_on_while_a_file_is_on_its_way() {
    let rig = measured_rig();
    let program = rig.start();
    let id = send_measurements(&program);
    let draft = || post(&program, "draft", &json!({ "candidate": id }));
    assert_eq!(draft().status, 200);
    let made = settled(&program);
    assert_eq!(made["step"], "asking", "{made}");
    // Half of a further file.
    let mut stream = program.connect();
    let head = format!(
        "POST /api/model/upload?kind=measurement&name=late.csv&candidate={id} HTTP/1.1\r\nHost: {}\r\nAuthorization: Bearer {ENGINEER}\r\nContent-Length: 8\r\nConnection: close\r\n\r\n1,2\n",
        program.address
    );
    stream.write_all(head.as_bytes()).expect("it listens");
    let folder = rig.dir.path().join("audit/models/uploads").join(&id);
    let end = Instant::now() + PATIENCE;
    while !folder.join("files/.late.csv.part").exists() {
        assert!(Instant::now() < end, "it does not begin");
        std::thread::sleep(Duration::from_millis(20));
    }
    for refused in [
        answers(&program, &id, &all_answers(&made)),
        draft(),
        activate(&program, &made, None),
    ] {
        assert_eq!(refused.status, 409, "{}", refused.body);
        assert!(refused.body.contains("late.csv"), "{}", refused.body);
    }
    stream.write_all(b"3,4\n").expect("it listens");
    let mut told = String::new();
    let _ = stream.read_to_string(&mut told);
    assert_eq!(answer(&told).status, 200, "{told}");
    let now = candidate(&program);
    assert_eq!(now["step"], "uploading", "{now}");
    assert!(now["draft"].is_null(), "{now}");
    assert!(now["files"].to_string().contains("late.csv"), "{now}");
    assert_eq!(draft().status, 200);
}

/// Before, only whole files counted: as many as are received at one time went over what all of them together may be.
#[test]
fn files_on_their_way_count_for_what_all_may_be() {
    let rig = Rig::new("");
    let program = rig.start();
    let begun = upload(&program, "kind=measurement&name=x.csv", b"1,2\n").json();
    let id = begun["id"].as_str().expect("named").to_owned();
    let files = rig.dir.path().join("audit/models/uploads").join(&id);
    let begin = |name: &str| {
        let mut stream = program.connect();
        let head = format!(
            "POST /api/model/upload?kind=measurement&name={name}&candidate={id} HTTP/1.1\r\nHost: {}\r\nAuthorization: Bearer {ENGINEER}\r\nContent-Length: {}\r\n\r\n1,2\n",
            program.address, LARGEST
        );
        stream.write_all(head.as_bytes()).expect("it listens");
        stream
    };
    // Three of the largest, and nothing comes of them.
    let streams: Vec<_> = ["a.csv", "b.csv", "c.csv"].into_iter().map(begin).collect();
    let end = Instant::now() + PATIENCE;
    for name in ["a", "b", "c"] {
        while !files.join(format!("files/.{name}.csv.part")).exists() {
            assert!(Instant::now() < end, "{name} does not begin");
            std::thread::sleep(Duration::from_millis(20));
        }
    }
    // Four bytes are there, 16 MiB is the most.
    let whole = vec![b'1'; LARGEST];
    let query = format!("kind=measurement&name=d.csv&candidate={id}");
    let over = upload(&program, &query, &whole);
    assert_eq!(over.status, 413, "{}", over.body);
    assert!(over.body.contains("all files together"), "{}", over.body);
    let query = format!("kind=measurement&name=e.csv&candidate={id}");
    let fits = upload(&program, &query, &whole[4..]);
    assert_eq!(fits.status, 200, "{}", fits.body);
    // What is cut gives its share back.
    drop(streams);
    let end = Instant::now() + PATIENCE;
    let query = format!("kind=measurement&name=d.csv&candidate={id}");
    while upload(&program, &query, &whole).status != 200 {
        assert!(Instant::now() < end);
        std::thread::sleep(Duration::from_millis(50));
    }
}

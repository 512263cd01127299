//! `volcomp studio` as a program: its output, and the page that it serves.

use std::{
    fs,
    io::{BufRead, BufReader, Read, Write},
    net::TcpStream,
    process::{Command, Stdio},
};

use crate::{Folder, refuses, root};

#[test]
fn it_prints_where_it_listens_and_serves_the_page_there() {
    let folder = Folder::new();
    let example = root().join("examples/calibration/machine.toml");
    fs::copy(example, folder.path().join("machine.toml")).expect("copied");
    let mut program = Command::new(env!("CARGO_BIN_EXE_volcomp"))
        .arg("studio")
        .arg(folder.path())
        .arg("--no-browser")
        .stdout(Stdio::piped())
        .spawn()
        .expect("it starts");
    let mut lines = BufReader::new(program.stdout.take().expect("piped")).lines();
    let mut line = || lines.next().expect("a line").expect("UTF-8");
    let first = line();
    let address = first.strip_prefix("listening on ").expect("its address");
    let second = line();
    let path = second.strip_prefix(&format!("open http://{address}"));
    let path = path.expect("the same address");
    let mut stream = TcpStream::connect(address).expect("it listens");
    let request =
        format!("GET {path}api/state HTTP/1.1\r\nHost: {address}\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).expect("it reads");
    let mut answer = String::new();
    stream.read_to_string(&mut answer).expect("it answers");
    program.kill().expect("it runs");
    program.wait().expect("ended");
    assert!(answer.starts_with("HTTP/1.1 200") && answer.contains("\"structure\""), "{answer}");
}

#[test]
fn a_folder_that_is_not_there_and_an_address_of_others_are_refused() {
    refuses(&["studio", "no-such-folder", "--no-browser"], "no-such-folder");
    refuses(
        "studio examples --no-browser --listen 0.0.0.0:0",
        "expected an address of this computer",
    );
}

//! The `volcomp` program: its output, its JSON documents, its exit status.

mod answers;
mod check;
mod correct;
mod evaluation;
mod every_command;
mod export;
mod fit_auto;
mod fit_thermal;
mod map;
mod measurement_files;
mod nc;
mod network;
mod plots;
mod printers;
mod report;
mod simulated;
mod structures;
mod uncertainty;
mod whole_way;
mod wrong_input;

use std::{
    fs,
    ops::Deref,
    process::{Command, Output},
};

use serde_json::Value;
use tempfile::TempDir;

pub(crate) use volcomp_test_support::root;

/// A command line: one text with spaces, or a list of arguments.
pub(crate) trait Call {
    fn words(&self) -> Vec<&str>;
}

impl Call for str {
    fn words(&self) -> Vec<&str> {
        words(self)
    }
}

impl Call for String {
    fn words(&self) -> Vec<&str> {
        words(self)
    }
}

impl Call for [&str] {
    fn words(&self) -> Vec<&str> {
        self.to_vec()
    }
}

impl<const N: usize> Call for [&str; N] {
    fn words(&self) -> Vec<&str> {
        self.to_vec()
    }
}

impl Call for Vec<&str> {
    fn words(&self) -> Vec<&str> {
        self.clone()
    }
}

/// A folder that is removed on drop.
pub(crate) struct Folder(TempDir);

impl Folder {
    pub(crate) fn new() -> Self {
        Self(tempfile::tempdir().expect("a folder"))
    }

    pub(crate) fn file(&self, name: &str) -> String {
        self.path().join(name).display().to_string()
    }

    pub(crate) fn write(&self, name: &str, text: impl AsRef<[u8]>) -> String {
        let path = self.file(name);
        fs::write(&path, text).expect("written");
        path
    }
}

impl Deref for Folder {
    type Target = TempDir;

    fn deref(&self) -> &TempDir {
        &self.0
    }
}

/// Runs `volcomp` in the root folder of the repository.
pub(crate) fn volcomp(call: &(impl Call + ?Sized)) -> Output {
    Command::new(env!("CARGO_BIN_EXE_volcomp"))
        .args(call.words())
        .current_dir(root())
        .output()
        .expect("the program was built for this test")
}

pub(crate) fn words(call: &str) -> Vec<&str> {
    call.split(' ').collect()
}

/// Runs a call that must succeed: status 0, or 3 for a tolerance that is not met.
#[track_caller]
fn done(call: &(impl Call + ?Sized), first: &[&str]) -> Output {
    let words = [first, &call.words()].concat();
    let output = volcomp(&words);
    let status = output.status.code();
    let is_done = status == Some(0) || words.contains(&"--tolerance") && status == Some(3);
    assert!(is_done, "{words:?}: {output:?}");
    output
}

#[track_caller]
pub(crate) fn json(call: &(impl Call + ?Sized)) -> Value {
    serde_json::from_slice(&done(call, &["--json"]).stdout).expect("one JSON document")
}

#[track_caller]
pub(crate) fn text(call: &(impl Call + ?Sized)) -> String {
    String::from_utf8(done(call, &[]).stdout).expect("UTF-8")
}

/// Standard error of a call that must succeed, as one line.
#[track_caller]
pub(crate) fn notes(call: &(impl Call + ?Sized)) -> String {
    one_line(&String::from_utf8_lossy(&done(call, &[]).stderr))
}

pub(crate) fn one_line(text: &str) -> String {
    text.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Checks the exit status, and that the message contains `part`.
#[track_caller]
pub(crate) fn ended(output: &Output, status: i32, part: &str) {
    assert_eq!(output.status.code(), Some(status), "{output:?}");
    contains(&String::from_utf8_lossy(&output.stderr), part);
}

/// The message of a call that must fail with status 2 and no standard output.
#[track_caller]
pub(crate) fn refused(call: &(impl Call + ?Sized)) -> String {
    let output = volcomp(call);
    let stderr = String::from_utf8_lossy(&output.stderr).into_owned();
    let words = call.words();
    assert_eq!(output.status.code(), Some(2), "{words:?}: {stderr}");
    assert!(output.stdout.is_empty(), "{words:?} printed on standard output");
    assert!(!stderr.contains("panicked"), "{stderr}");
    stderr
}

#[track_caller]
pub(crate) fn refuses(call: &(impl Call + ?Sized), part: &str) {
    contains(&refused(call), part);
}

pub(crate) fn cases(table: &str) -> impl Iterator<Item = (&str, &str)> {
    let rows = table.lines().filter(|row| !row.is_empty());
    rows.map(|row| row.split_once(" => ").expect("a case and what is expected"))
}

/// Checks that each call of a table fails with a message that contains the text after `=>`. Names in `files` are replaced by paths.
#[track_caller]
pub(crate) fn refuse_each(table: &str, files: &[(&str, &str)]) {
    for (call, expected) in cases(table) {
        let named = files.iter();
        let call = named.fold(call.to_owned(), |call, (name, path)| call.replace(name, path));
        refuses(&call, expected);
    }
}

#[track_caller]
pub(crate) fn contains(text: &str, part: &str) {
    assert!(text.contains(part), "no {part:?} in\n{text}");
}

/// Seeded pseudo-random numbers, uniform from -1 to 1.
pub(crate) struct Draw(pub(crate) u64);

impl Draw {
    pub(crate) fn next(&mut self) -> f64 {
        self.0 =
            self.0.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        2.0 * ((self.0 >> 11) as f64 / (1_u64 << 53) as f64) - 1.0
    }

    /// Approximately normal noise with this standard deviation.
    pub(crate) fn noise(&mut self, deviation: f64) -> f64 {
        deviation * (0..12).map(|_| 0.5 * self.next()).sum::<f64>()
    }
}

#[track_caller]
pub(crate) fn float(value: &Value) -> f64 {
    value.as_f64().expect("a number")
}

#[track_caller]
pub(crate) fn list(value: &Value) -> &Vec<Value> {
    value.as_array().expect("a list")
}

#[track_caller]
pub(crate) fn close(value: &Value, expected: f64, tolerance: f64) {
    let found = value.as_f64().unwrap_or(f64::NAN);
    assert!((found - expected).abs() <= tolerance, "{found}, expected {expected}");
}

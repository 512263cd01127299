//! Compiles the component of the servo thread without LinuxCNC, as a program that a test runs.

use std::{
    fmt::Write as _,
    os::unix::fs::PermissionsExt as _,
    path::{Path, PathBuf},
    process::{Child, Command},
};

use volcomp_test_support::peers;

use crate::bridge::KEY_TEXT;

/// C declarations of the includes, pins and parameters in the head of the component, as halcompile generates them.
fn pins(head: &str) -> String {
    let (mut includes, mut pins) = (String::new(), String::new());
    for line in head.lines() {
        let words: Vec<&str> = line.trim_end_matches(';').split_whitespace().collect();
        match words[..] {
            ["include", file] => writeln!(includes, "#include {file}").unwrap(),
            ["pin" | "param", _, kind, name, ref rest @ ..] => {
                let kind = match kind {
                    "float" => "double",
                    "u32" => "unsigned",
                    _ => "int",
                };
                let first = match rest {
                    ["=", value, ..] => *value,
                    _ => "0",
                };
                let name = name.replace('-', "_");
                if let Some((name, many)) = name.split_once("_#[") {
                    let many = many.trim_end_matches(']');
                    writeln!(pins, "static {kind} {name}_of[{many}] = {{[0 ... {many} - 1] = {first}}};\n#define {name}(i) {name}_of[i]").unwrap();
                } else {
                    writeln!(pins, "static {kind} {name} = {first};").unwrap();
                }
            }
            _ => {}
        }
    }
    includes + &pins
}

/// Compiler option for the address and undefined-behaviour sanitizers.
pub(crate) const MEMORY: &str = "-fsanitize=address,undefined";
pub(crate) const THREADS: &str = "-fsanitize=thread";

/// Compiles the component with this C driver and this sanitizer option; `None` without a C compiler.
pub(crate) fn built(dir: &Path, driver: &str, sanitize: &str) -> Option<PathBuf> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = std::fs::read_to_string(root.join("bridge/volcomp.comp")).unwrap();
    let (head, body) = text.split_once("\n;;\n").unwrap();
    std::fs::write(dir.join("pins.h"), pins(head)).unwrap();
    std::fs::write(dir.join("body.c"), body).unwrap();
    let program = dir.join("component");
    let cc = Command::new("cc")
        .args(["-std=gnu11", "-O1", sanitize, "-fno-sanitize-recover=all"])
        .args(["-Wall", "-Wno-unused", "-Werror", "-I"])
        .arg(dir)
        .arg(root.join("tests/it").join(driver))
        .arg("-o")
        .arg(&program)
        .args(["-lm", "-pthread"])
        .output();
    let Ok(cc) = cc else {
        peers::not_run("gcc");
        return None;
    };
    assert!(cc.status.success(), "{}", String::from_utf8_lossy(&cc.stderr));
    Some(program)
}

pub(crate) fn key_file(dir: &Path) -> PathBuf {
    let file = dir.join("volcomp.key");
    write_key(&file, KEY_TEXT, 0o600);
    file
}

pub(crate) fn write_key(file: &Path, text: &str, mode: u32) {
    std::fs::write(file, text).unwrap();
    std::fs::set_permissions(file, std::fs::Permissions::from_mode(mode)).unwrap();
}

/// A process that is killed on drop.
pub(crate) struct Ended(pub(crate) Child);

impl Drop for Ended {
    fn drop(&mut self) {
        // The process may have exited already.
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

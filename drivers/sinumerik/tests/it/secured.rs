//! Tests of secured connections to servers of an independent library that accept only secured connections.

use std::{
    fs,
    os::unix::fs::PermissionsExt as _,
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

use volcomp_sinumerik::{Nodes, Security, Server, list_axes};
use volcomp_test_support::{Running, peers, root};

/// A folder with certificates of the client, created by the commands of the book.
struct Client {
    folder: tempfile::TempDir,
}

impl Client {
    /// `None` if a required program is missing.
    fn new() -> Option<Self> {
        let folder = tempfile::tempdir().unwrap();
        let book = fs::read_to_string(root().join("docs/src/gateway.md")).unwrap();
        let (_, after) = book.split_once("### Certificates of a SINUMERIK").unwrap();
        let (_, block) = after.split_once("```console,ignore\n").unwrap();
        let (block, _) = block.split_once("```").unwrap();
        let script = block.replace("$ ", "");
        if Command::new("openssl").arg("version").output().is_err() {
            peers::not_run("openssl");
            return None;
        }
        let made =
            Command::new("sh").args(["-ec", &script]).current_dir(folder.path()).output().unwrap();
        assert!(made.status.success(), "{made:?}");
        Some(Self { folder })
    }

    fn pki(&self) -> PathBuf {
        self.folder.path().join("pki")
    }

    fn own(&self) -> PathBuf {
        self.pki().join("own/cert.der")
    }

    fn files(&self, of: &str) -> Vec<PathBuf> {
        let files = fs::read_dir(self.pki().join(of)).into_iter().flatten();
        files.map(|file| file.unwrap().path()).collect()
    }

    /// Returns the names and positions of the server's axes, or the driver's error as text.
    fn list_axes(&self, url: &str, security: Security) -> Result<Vec<(String, f64)>, String> {
        let mut server = Server::new(url);
        server.security = security;
        server.pki = Some(self.pki());
        server.time_out = Duration::from_secs(5);
        list_axes(&server, &Nodes::default()).map_err(|error| error.to_string())
    }

    fn refused(&self, url: &str, words: &[&str]) -> String {
        let message = self.list_axes(url, Security::SignAndEncrypt).unwrap_err();
        for word in words {
            assert!(message.contains(word), "{word}: {message}");
        }
        message
    }
}

/// Starts a server with its files in this folder, and returns the process and its URL.
fn serve(folder: &Path, more: &[&str]) -> Option<(Running, String)> {
    let mut command = Command::new(peers::python()?);
    command
        .arg(root().join("drivers/sinumerik/tests/peer/secured.py"))
        .arg("--folder")
        .arg(folder)
        .args(more);
    let (running, line, _) = Running::start_and_hear(&mut command);
    let url = line.strip_prefix("listening on ");
    Some((running, url.unwrap_or_else(|| panic!("{line}")).to_owned()))
}

fn axes() -> Vec<(String, f64)> {
    vec![("X".to_owned(), 12.5), ("Y".to_owned(), -3.0)]
}

#[test]
fn a_server_is_trusted_after_the_operator_accepts_it() {
    let Some(client) = Client::new() else { return };
    let folder = tempfile::tempdir().unwrap();
    let own = client.own();
    let arguments = ["--trust", own.to_str().unwrap()];
    let Some((_server, url)) = serve(folder.path(), &arguments) else {
        return;
    };
    let message = client.refused(&url, &["not trusted", "compare the fingerprint", "then move"]);
    let rejected = client.files("rejected");
    assert_eq!(rejected.len(), 1, "{rejected:?}");
    assert!(message.contains(rejected[0].to_str().unwrap()), "{message}");
    let fingerprint = Command::new("openssl")
        .args(["x509", "-inform", "der", "-noout", "-fingerprint", "-sha1", "-in"])
        .arg(folder.path().join("server.der"))
        .output()
        .unwrap();
    let fingerprint = String::from_utf8(fingerprint.stdout).unwrap();
    let (_, fingerprint) = fingerprint.trim().split_once('=').unwrap();
    assert!(message.contains(fingerprint), "{fingerprint}: {message}");
    // A rejected certificate is not trusted at the second attempt either.
    client.refused(&url, &["not trusted"]);
    let name = rejected[0].file_name().unwrap();
    fs::rename(&rejected[0], client.pki().join("trusted").join(name)).unwrap();
    assert_eq!(client.list_axes(&url, Security::SignAndEncrypt), Ok(axes()));
    assert_eq!(client.list_axes(&url, Security::SignAndEncrypt), Ok(axes()));
    fs::remove_file(client.pki().join("trusted").join(name)).unwrap();
    client.refused(&url, &["not trusted"]);
    // The certificate as copied from the control: PEM with another file name, while the rejected file still exists.
    let pem = client.pki().join("trusted/mill-1.pem");
    let made = Command::new("openssl")
        .args(["x509", "-inform", "der", "-in"])
        .arg(folder.path().join("server.der"))
        .arg("-out")
        .arg(&pem)
        .status()
        .unwrap();
    assert!(made.success());
    assert_eq!(client.list_axes(&url, Security::SignAndEncrypt), Ok(axes()));
    assert_eq!(client.files("trusted").len(), 1);
    assert!(!pem.exists() && client.files("rejected").is_empty());
    // This server accepts only messages that are signed and encrypted.
    for security in [Security::Sign, Security::None] {
        let message = client.list_axes(&url, security).unwrap_err();
        assert!(message.contains("offers Basic256Sha256 sign-and-encrypt, expected"), "{message}");
    }
}

#[test]
fn certificate_errors_of_the_server_are_reported() {
    let Some(client) = Client::new() else { return };
    let own = client.own();
    let trust = ["--trust", own.to_str().unwrap()];
    for (more, words) in [
        (
            &["--days=-10:-1"][..],
            &["a certificate from 20", "is valid today", "a correct clock"][..],
        ),
        (&["--days=2:10"][..], &["is valid today"][..]),
        (
            &["--names", "IP:192.0.2.1", "DNS:mill-1"][..],
            &["the host of the URL is not in the server's certificate"][..],
        ),
    ] {
        let folder = tempfile::tempdir().unwrap();
        let arguments = [more, &trust[..]].concat();
        let Some((_server, url)) = serve(folder.path(), &arguments) else {
            return;
        };
        let trusted = client.pki().join("trusted/server.der");
        fs::copy(folder.path().join("server.der"), trusted).unwrap();
        client.refused(&url, words);
    }
    // Another certificate of the control is not trusted.
    let folder = tempfile::tempdir().unwrap();
    let Some((_server, url)) = serve(folder.path(), &trust) else {
        return;
    };
    client.refused(&url, &["not trusted"]);
}

#[test]
fn a_server_that_rejects_the_client_is_reported() {
    let Some(client) = Client::new() else { return };
    let folder = tempfile::tempdir().unwrap();
    let Some((_server, url)) = serve(folder.path(), &[]) else {
        return;
    };
    let trusted = client.pki().join("trusted/server.der");
    fs::copy(folder.path().join("server.der"), trusted).unwrap();
    client.refused(&url, &["the server rejects this client", "own/cert.der"]);
}

#[test]
fn own_certificate_and_key_are_checked_first() {
    let Some(client) = Client::new() else { return };
    let unreachable = "opc.tcp://127.0.0.1:1";
    let key = client.pki().join("private/private.pem");
    fs::set_permissions(&key, fs::Permissions::from_mode(0o640)).unwrap();
    client.refused(unreachable, &["private.pem: found mode 640, expected 600"]);
    fs::set_permissions(&key, fs::Permissions::from_mode(0o600)).unwrap();
    client.refused(unreachable, &["no connection"]);
    let kept = fs::read(&key).unwrap();
    let Some(other) = Client::new() else { return };
    fs::copy(other.pki().join("private/private.pem"), &key).unwrap();
    client.refused(unreachable, &["cert.der: found the certificate of another key"]);
    fs::write(&key, "no key").unwrap();
    client.refused(unreachable, &["private.pem: found no private key in PEM"]);
    fs::remove_file(&key).unwrap();
    client.refused(
        unreachable,
        &["private.pem: found no such file, expected the client's private key"],
    );
    fs::write(&key, kept).unwrap();
    fs::set_permissions(&key, fs::Permissions::from_mode(0o600)).unwrap();
    fs::write(client.own(), "no certificate").unwrap();
    client.refused(unreachable, &["cert.der: found no certificate in DER"]);
    fs::remove_file(client.own()).unwrap();
    client.refused(unreachable, &["cert.der: found no such file", "urn:volcomp"]);
}

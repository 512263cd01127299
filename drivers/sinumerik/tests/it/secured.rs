//! Secured connections, against servers of another library that take nothing else: whom the driver trusts, and what it says.

use std::{
    fs,
    os::unix::fs::PermissionsExt as _,
    path::{Path, PathBuf},
    process::Command,
    time::Duration,
};

use volcomp_sinumerik::{Nodes, Security, Server, look};
use volcomp_test_support::{Running, peers, root};

/// A folder with the certificates of a client, made by what the book says.
struct Client {
    folder: tempfile::TempDir,
}

impl Client {
    /// `None` where a program is missing.
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
        let made = Command::new("sh")
            .args(["-ec", &script])
            .current_dir(folder.path())
            .output()
            .unwrap();
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

    /// The positions of the server's axes, or what the driver says.
    fn look(&self, url: &str, security: Security) -> Result<Vec<(String, f64)>, String> {
        let mut server = Server::new(url);
        server.security = security;
        server.pki = Some(self.pki());
        server.time_out = Duration::from_secs(5);
        look(&server, &Nodes::default()).map_err(|error| error.to_string())
    }

    fn refused(&self, url: &str, words: &[&str]) -> String {
        let told = self.look(url, Security::SignAndEncrypt).unwrap_err();
        for word in words {
            assert!(told.contains(word), "{word}: {told}");
        }
        told
    }
}

/// A server in a folder, with further arguments; its URL.
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
fn a_server_is_trusted_when_a_person_has_said_so() {
    let Some(client) = Client::new() else { return };
    let folder = tempfile::tempdir().unwrap();
    let own = client.own();
    let arguments = ["--trust", own.to_str().unwrap()];
    let Some((_server, url)) = serve(folder.path(), &arguments) else {
        return;
    };
    let told = client.refused(
        &url,
        &["not trusted", "compare the fingerprint", "then move"],
    );
    let rejected = client.files("rejected");
    assert_eq!(rejected.len(), 1, "{rejected:?}");
    assert!(told.contains(rejected[0].to_str().unwrap()), "{told}");
    let fingerprint = Command::new("openssl")
        .args([
            "x509",
            "-inform",
            "der",
            "-noout",
            "-fingerprint",
            "-sha1",
            "-in",
        ])
        .arg(folder.path().join("server.der"))
        .output()
        .unwrap();
    let fingerprint = String::from_utf8(fingerprint.stdout).unwrap();
    let (_, fingerprint) = fingerprint.trim().split_once('=').unwrap();
    assert!(told.contains(fingerprint), "{fingerprint}: {told}");
    // Again the same: what lies among the rejected is not trusted by itself.
    client.refused(&url, &["not trusted"]);
    let name = rejected[0].file_name().unwrap();
    fs::rename(&rejected[0], client.pki().join("trusted").join(name)).unwrap();
    assert_eq!(client.look(&url, Security::SignAndEncrypt), Ok(axes()));
    assert_eq!(client.look(&url, Security::SignAndEncrypt), Ok(axes()));
    // It is taken away again.
    fs::remove_file(client.pki().join("trusted").join(name)).unwrap();
    client.refused(&url, &["not trusted"]);
    // As a person brings it from the control: in PEM, under a name of its own, and the other is left where it was.
    let pem = client.pki().join("trusted/mill-1.pem");
    let made = Command::new("openssl")
        .args(["x509", "-inform", "der", "-in"])
        .arg(folder.path().join("server.der"))
        .arg("-out")
        .arg(&pem)
        .status()
        .unwrap();
    assert!(made.success());
    assert_eq!(client.look(&url, Security::SignAndEncrypt), Ok(axes()));
    assert_eq!(client.files("trusted").len(), 1);
    assert!(!pem.exists() && client.files("rejected").is_empty());
    // This server takes no message that is only signed, or not even that.
    for security in [Security::Sign, Security::None] {
        let told = client.look(&url, security).unwrap_err();
        assert!(
            told.contains("offers Basic256Sha256 sign-and-encrypt, expected"),
            "{told}"
        );
    }
}

#[test]
fn what_is_wrong_with_the_certificate_of_the_server_is_said() {
    let Some(client) = Client::new() else { return };
    let own = client.own();
    let trust = ["--trust", own.to_str().unwrap()];
    for (more, words) in [
        (
            &["--days=-10:-1"][..],
            &[
                "a certificate from 20",
                "holds today",
                "a clock that is right",
            ][..],
        ),
        (&["--days=2:10"][..], &["holds today"][..]),
        (
            &["--names", "IP:192.0.2.1", "DNS:mill-1"][..],
            &["the host of the URL is none of the names"][..],
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
    // A new certificate at the control is another one.
    let folder = tempfile::tempdir().unwrap();
    let Some((_server, url)) = serve(folder.path(), &trust) else {
        return;
    };
    client.refused(&url, &["not trusted"]);
}

#[test]
fn a_server_that_does_not_trust_the_client_is_said_to() {
    let Some(client) = Client::new() else { return };
    let folder = tempfile::tempdir().unwrap();
    let Some((_server, url)) = serve(folder.path(), &[]) else {
        return;
    };
    let trusted = client.pki().join("trusted/server.der");
    fs::copy(folder.path().join("server.der"), trusted).unwrap();
    client.refused(
        &url,
        &["the server does not take this client", "own/cert.der"],
    );
}

/// Nothing is asked of a server before the client's own files are right.
#[test]
fn the_own_certificate_and_key_are_looked_at_first() {
    let Some(client) = Client::new() else { return };
    let nobody = "opc.tcp://127.0.0.1:1";
    let key = client.pki().join("private/private.pem");
    fs::set_permissions(&key, fs::Permissions::from_mode(0o640)).unwrap();
    client.refused(nobody, &["private.pem: found mode 640, expected 600"]);
    fs::set_permissions(&key, fs::Permissions::from_mode(0o600)).unwrap();
    client.refused(nobody, &["no connection"]);
    let kept = fs::read(&key).unwrap();
    let Some(other) = Client::new() else { return };
    fs::copy(other.pki().join("private/private.pem"), &key).unwrap();
    client.refused(nobody, &["cert.der: found the certificate of another key"]);
    fs::write(&key, "no key").unwrap();
    client.refused(nobody, &["private.pem: found no private key in PEM"]);
    fs::remove_file(&key).unwrap();
    client.refused(
        nobody,
        &["private.pem: found no such file, expected the client's private key"],
    );
    fs::write(&key, kept).unwrap();
    fs::set_permissions(&key, fs::Permissions::from_mode(0o600)).unwrap();
    fs::write(client.own(), "no certificate").unwrap();
    client.refused(nobody, &["cert.der: found no certificate in DER"]);
    fs::remove_file(client.own()).unwrap();
    client.refused(nobody, &["cert.der: found no such file", "urn:volcomp"]);
}

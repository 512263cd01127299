//! The server configurations of a cluster that `nats-config` writes, on the real server.

use std::{
    io::{Read, Write},
    net::TcpStream,
    os::unix::fs::PermissionsExt,
    path::Path,
    process::{Child, Command, Stdio},
    sync::Arc,
};

use tokio::io::AsyncReadExt;
use tokio_rustls::{
    TlsConnector,
    rustls::{
        ClientConfig, RootCertStore,
        crypto::ring,
        pki_types::{CertificateDer, pem::PemObject},
    },
};
use volcomp_fleet::server::program;
use volcomp_test_support::free_address;

use crate::{
    command::{call, done},
    shop::{self, LONG},
};

struct Running(Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

fn centre() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    configure(folder.path(), "alone", "127.0.0.1:4222", None);
    done(folder.path(), "key nkey centre.nkey");
    done(folder.path(), "tls-init 127.0.0.1");
    folder
}

/// Writes the configuration of one server. `cluster` is the index of the server and the addresses of all servers.
fn configure(folder: &Path, name: &str, listen: &str, cluster: Option<(usize, &[String])>) {
    let cluster = cluster.map_or_else(String::new, |(place, addresses)| {
        let routes: Vec<String> = addresses.iter().map(|one| format!("nats://{one}")).collect();
        format!(
            "cluster = \"shop\"\ncluster_listen = {:?}\nroutes = {routes:?}\ncertificate = \"certificate.pem\"\nkey = \"key.pem\"\n",
            addresses[place]
        )
    });
    let text = format!(
        "[nats]\nurl = \"tls://127.0.0.1:4222\"\nca = \"certificate.pem\"\n[server]\nname = {name:?}\nlisten = {listen:?}\nstore = \"streams-{name}\"\n{cluster}"
    );
    std::fs::write(folder.join("centre.toml"), text).unwrap();
}

/// Number of routes to other servers, from the server's monitoring port.
fn joined(monitor: &str) -> Option<u64> {
    let mut stream = TcpStream::connect(monitor).ok()?;
    stream.write_all(b"GET /routez HTTP/1.0\r\n\r\n").ok()?;
    let mut answer = String::new();
    stream.read_to_string(&mut answer).ok()?;
    let (_, document) = answer.split_once("\r\n\r\n")?;
    let document: serde_json::Value = serde_json::from_str(document).ok()?;
    document["num_routes"].as_u64()
}

#[test]
fn three_servers_of_one_centre_join_with_tls() {
    let Some(server) = program() else {
        volcomp_test_support::peers::not_run("nats-server is not installed");
        return;
    };
    let folder = centre();
    let folder = folder.path();
    let addresses: Vec<String> = (0..3).map(|_| free_address()).collect();
    let mut running = Vec::new();
    let mut monitors = Vec::new();
    for place in 0..3 {
        let listen = free_address();
        let name = format!("server-{place}");
        configure(folder, &name, &listen, Some((place, &addresses)));
        let file = format!("{name}.conf");
        assert_eq!(done(folder, &format!("nats-config --output {file}")), "");
        let mode = std::fs::metadata(folder.join(&file)).unwrap().permissions();
        assert_eq!(mode.mode() & 0o777, 0o600);
        let monitor = free_address();
        let port = monitor.rsplit(':').next().unwrap();
        let child = Command::new(&server)
            .args(["-m", port, "-a", "127.0.0.1", "-c"])
            .arg(folder.join(&file))
            .stdout(Stdio::null())
            .stderr(Stdio::null())
            .spawn()
            .unwrap();
        running.push(Running(child));
        monitors.push(monitor);
    }
    volcomp_test_support::until("they join", LONG, || {
        monitors.iter().all(|monitor| joined(monitor) == Some(2))
    });
    // A connection without a certificate is rejected.
    let greeted = shop::runtime().block_on(greeted(&addresses[0], &folder.join("certificate.pem")));
    assert!(greeted.is_err(), "{greeted:?}");
}

/// Connects to a cluster port with TLS and no client certificate; returns the number of received bytes.
async fn greeted(address: &str, trusted: &Path) -> std::io::Result<usize> {
    let mut roots = RootCertStore::empty();
    roots.add(CertificateDer::from_pem_file(trusted).unwrap()).unwrap();
    let config = ClientConfig::builder_with_provider(Arc::new(ring::default_provider()))
        .with_safe_default_protocol_versions()
        .unwrap()
        .with_root_certificates(roots)
        .with_no_client_auth();
    let stream = tokio::net::TcpStream::connect(address).await.unwrap();
    let name = "127.0.0.1".try_into().unwrap();
    let connector = TlsConnector::from(Arc::new(config));
    let mut stream = connector.connect(name, stream).await.unwrap();
    stream.read(&mut [0; 64]).await
}

/// The cluster password is not printed to a file that others can read. A replaced file stays private.
#[test]
fn the_password_of_a_cluster_stays_private() {
    let folder = centre();
    let folder = folder.path();
    let print_into = |file: &str, mode: u32| {
        let printed = std::fs::File::create(folder.join(file)).unwrap();
        let private = std::fs::Permissions::from_mode(mode);
        printed.set_permissions(private).unwrap();
        let mut command = Command::new(env!("CARGO_BIN_EXE_volcomp-centre"));
        command.current_dir(folder).arg("nats-config").stdout(printed);
        command.output().unwrap()
    };
    // A configuration without a cluster has no secret.
    assert!(print_into("alone.conf", 0o644).status.success());
    let addresses = ["127.0.0.1:6222".to_owned()];
    configure(folder, "one", "127.0.0.1:4222", Some((0, &addresses)));
    let refused = print_into("open.conf", 0o644);
    assert_eq!(refused.status.code(), Some(2));
    let reported = String::from_utf8(refused.stderr).unwrap();
    assert!(reported.contains("644") && reported.contains("--output"), "{reported}");
    assert_eq!(std::fs::read_to_string(folder.join("open.conf")).unwrap(), "");
    assert!(print_into("private.conf", 0o600).status.success());
    let called = call(folder, "nats-config -o open.conf");
    assert_eq!(called.status, 0, "{}", called.err);
    let written = std::fs::read_to_string(folder.join("open.conf")).unwrap();
    let printed = std::fs::read_to_string(folder.join("private.conf")).unwrap();
    assert!(written.contains("password:"));
    assert_eq!(written, printed);
    let mode = std::fs::metadata(folder.join("open.conf")).unwrap().permissions();
    assert_eq!(mode.mode() & 0o777, 0o600);
    let routes = addresses.map(|_| "nats://anna:secret@192.0.2.1:6222".to_owned());
    let text = std::fs::read_to_string(folder.join("centre.toml")).unwrap();
    let text = text.replace("nats://127.0.0.1:6222", &routes[0]);
    std::fs::write(folder.join("centre.toml"), text).unwrap();
    let called = call(folder, "nats-config");
    assert_eq!(called.status, 2);
    assert!(called.err.contains("routes: found an address with a user"), "{}", called.err);
    assert!(!called.err.contains("secret@"), "{}", called.err);
}

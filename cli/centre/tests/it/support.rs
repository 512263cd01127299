//! Common test data: gateway messages, machines and models, and a web interface with its own store and a client.

use std::{
    collections::BTreeMap,
    io::{Read, Write},
    net::{SocketAddr, TcpStream},
    sync::Arc,
    time::Duration,
};

use volcomp_centre::{
    clock::now_s,
    http::{PageSettings, PageState, router},
    ingest::Ingest,
    models::NewModel,
    records::{Machine, Origin},
    store::Store,
    users::{BootTime, Password, Role, Session, Token, hash},
};
use volcomp_fleet::{Condition, Envelope, Identity, Kind, Received};
use volcomp_test_support::until;
use volcomp_vocabulary::AxisName;

use crate::shop::LONG;

pub(crate) fn model_text(number: u32) -> String {
    format!(
        "name = \"mill\"\nstructure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 500.0]\n[axes.Y]\ntravel = [0.0, 400.0]\n[axes.Z]\ntravel = [0.0, 300.0]\n[errors]\nEC0Y = {number}.0\n"
    )
}

pub(crate) fn model(number: u32) -> NewModel {
    let origin = Origin::File { name: "mill.toml".to_owned() };
    NewModel::of_text(model_text(number), "mill.toml", origin, "anna").unwrap()
}

pub(crate) fn identity(machine: &str) -> Identity {
    Identity { site: "berlin".parse().unwrap(), machine: machine.parse().unwrap() }
}

pub(crate) fn machine(name: &str) -> Machine {
    Machine::new(
        identity(name),
        format!("serial of {name}"),
        "w X' b Y Z t".to_owned(),
        vec![AxisName::X, AxisName::Y, AxisName::Z],
    )
}

pub(crate) fn condition(residual_um: f64) -> Condition {
    Condition {
        state: "compensating".to_owned(),
        reasons: Vec::new(),
        armed: true,
        correction_um: BTreeMap::from([(AxisName::X, 12.0), (AxisName::Y, -3.5)]),
        correction_urad: BTreeMap::new(),
        residual_um: Some(residual_um),
        temperatures_degc: BTreeMap::from([("scale X".to_owned(), Some(21.5))]),
        cycle_p99_us: 180.0,
        overruns: 0,
        faults: 2,
    }
}

pub(crate) fn envelope<T>(instance: &str, number: u64, body: T) -> Envelope<T> {
    Envelope {
        instance: instance.to_owned(),
        number,
        uptime_s: number as f64,
        wall_s: 0.0,
        version: 0,
        model: String::new(),
        body,
    }
}

pub(crate) fn tell(store: &Store, batch: &[Received]) {
    let mut ingest = Ingest::of(store).unwrap();
    ingest.take(store, batch).unwrap();
    ingest.store_live(store).unwrap();
}

pub(crate) fn received<T: serde::Serialize>(
    machine: &str,
    kind: Kind,
    sequence: u64,
    stored_s: f64,
    envelope: &Envelope<T>,
) -> Received {
    Received {
        identity: identity(machine),
        kind,
        sequence,
        stored_s,
        bytes: serde_json::to_vec(envelope).unwrap().into(),
    }
}

/// Password of every test user.
pub(crate) const PASSWORD: &str = "correct horse battery";

pub(crate) struct Page {
    pub(crate) store: Arc<Store>,
    pub(crate) address: SocketAddr,
    pub(crate) folder: tempfile::TempDir,
    _runtime: tokio::runtime::Runtime,
}

#[derive(Debug)]
pub(crate) struct Answer {
    pub(crate) status: u16,
    pub(crate) head: String,
    pub(crate) body: String,
}

impl Answer {
    pub(crate) fn json(&self) -> serde_json::Value {
        serde_json::from_str(&self.body).unwrap_or_else(|e| panic!("{e}: {}", self.body))
    }

    pub(crate) fn cookie(&self) -> Option<String> {
        let line = self.head.lines().find(|line| line.starts_with("set-cookie: "))?;
        let pair = line.strip_prefix("set-cookie: ")?.split(';').next()?;
        Some(pair.to_owned())
    }
}

impl Page {
    pub(crate) fn start() -> Self {
        Self::start_with(PageSettings::default())
    }

    pub(crate) fn start_with(settings: PageSettings) -> Self {
        let folder = tempfile::tempdir().expect("writable");
        let store = Arc::new(Store::open(&folder.path().join("centre.db")).expect("a store"));
        let password = Password::chosen(PASSWORD.to_owned()).expect("long enough");
        let hash = hash(&password).expect("memory");
        for role in Role::ALL {
            let name = role.name().parse().expect("a name");
            store.add_user(&name, role, &hash, "centre", "test").expect("stored");
        }
        let runtime = tokio::runtime::Builder::new_multi_thread()
            .worker_threads(2)
            .enable_all()
            .build()
            .expect("threads");
        let page = PageState::new(Arc::clone(&store), settings);
        let listener =
            runtime.block_on(tokio::net::TcpListener::bind("127.0.0.1:0")).expect("a port");
        let address = listener.local_addr().expect("bound");
        runtime.spawn(Arc::clone(&page).refresh());
        runtime.spawn(volcomp_web::serve(listener, None, router(&page)));
        Self { store, address, folder, _runtime: runtime }
    }

    /// The cookie of a session created directly in the store, because logging in would hash a password.
    pub(crate) fn cookie_of(&self, role: Role, now: &BootTime) -> String {
        let token = Token::generate().expect("random numbers");
        let session = Session {
            user: role.name().parse().expect("a name"),
            since: now.clone(),
            used: now.clone(),
            from: "test".to_owned(),
        };
        let (_, hash) = (self.store.user(&session.user).expect("stored")).expect("a user");
        let begun = self.store.begin_session(&token, &session, &hash);
        assert!(begun.expect("stored"), "the user may log in");
        format!("volcomp-centre={}", token.text())
    }

    pub(crate) fn session(&self, role: Role) -> String {
        self.cookie_of(role, &BootTime::now())
    }

    pub(crate) fn raw(&self, bytes: &[u8]) -> Answer {
        let mut stream = TcpStream::connect(self.address).expect("it listens");
        stream.set_read_timeout(Some(Duration::from_secs(120))).expect("a socket");
        // The server does not read the rest of a rejected request, so the write may fail.
        let _ = stream.write_all(bytes);
        let mut all = Vec::new();
        let _ = stream.read_to_end(&mut all);
        let text = String::from_utf8_lossy(&all);
        let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
        let status = head.split(' ').nth(1).and_then(|status| status.parse().ok());
        Answer { status: status.unwrap_or(0), head: head.to_owned(), body: body.to_owned() }
    }

    pub(crate) fn request(&self, method: &str, path: &str, lines: &[String], body: &str) -> Answer {
        let lines: String = lines.iter().flat_map(|line| [line.as_str(), "\r\n"]).collect();
        let text = format!(
            "{method} {path} HTTP/1.1\r\nHost: {}\r\nConnection: close\r\nContent-Length: {}\r\n{lines}\r\n{body}",
            self.address,
            body.len()
        );
        self.raw(text.as_bytes())
    }

    pub(crate) fn get(&self, path: &str, cookie: &str) -> Answer {
        self.request("GET", path, &[format!("Cookie: {cookie}")], "")
    }

    /// The second overview built from now on, because the first may have been started before the latest change.
    pub(crate) fn overview(&self, cookie: &str) -> serde_json::Value {
        let (mut reported, mut made_s) = (serde_json::Value::Null, now_s());
        for _ in 0..2 {
            until("an overview is made", LONG, || {
                let answer = self.get("/api/overview", cookie);
                if answer.status == 200 {
                    reported = answer.json();
                }
                reported["made_s"].as_f64() > Some(made_s)
            });
            made_s = reported["made_s"].as_f64().expect("a time");
        }
        reported
    }

    /// Sends a change, and checks the status of the response.
    pub(crate) fn posts(
        &self,
        path: &str,
        cookie: &str,
        body: &serde_json::Value,
        status: u16,
    ) -> Answer {
        let answer = self.post(path, cookie, body);
        assert_eq!(answer.status, status, "{path} {body}: {}", answer.body);
        answer
    }

    pub(crate) fn post(&self, path: &str, cookie: &str, body: &serde_json::Value) -> Answer {
        let lines = [
            format!("Cookie: {cookie}"),
            "X-Volcomp: 1".to_owned(),
            format!("Origin: http://{}", self.address),
        ];
        self.request("POST", path, &lines, &body.to_string())
    }
}

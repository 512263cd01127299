//! A web interface with its own store, and a client.

use std::{
    io::{Read, Write},
    net::{SocketAddr, TcpStream},
    sync::Arc,
    time::Duration,
};

use volcomp_centre::{
    clock::now_s,
    http::{PageSettings, PageState, router},
    store::Store,
    users::{BootTime, Password, Role, Session, Token, hash},
};
use volcomp_test_support::until;

use crate::shop::LONG;

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

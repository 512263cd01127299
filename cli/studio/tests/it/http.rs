//! The page over real HTTP.

use std::{
    collections::BTreeMap,
    fs,
    io::{Read, Write},
    net::{SocketAddr, TcpListener, TcpStream},
    path::{Path, PathBuf},
    thread,
    time::Duration,
};

use serde_json::{Value, json};
use tempfile::TempDir;
use volcomp_studio::{Folder, Studio};

use crate::{SLOPE, small};

struct Page {
    dir: TempDir,
    address: SocketAddr,
    path: String,
}

struct Answer {
    status: u16,
    head: String,
    body: String,
}

impl Answer {
    fn json(&self) -> Value {
        serde_json::from_str(&self.body).unwrap_or_else(|e| panic!("{e}: {}", self.body))
    }

    fn has(&self, header: &str) -> bool {
        self.head.to_ascii_lowercase().contains(&header.to_ascii_lowercase())
    }
}

fn raw(address: SocketAddr, request: &str, headers: &str, body: &str) -> Answer {
    let mut stream = TcpStream::connect(address).expect("it listens");
    let length = body.len();
    let text = format!(
        "{request} HTTP/1.1\r\n{headers}Content-Length: {length}\r\nConnection: close\r\n\r\n{body}"
    );
    // The studio rejects a body that is too large before the end of the body, so that writing may fail.
    let _ = stream.write_all(text.as_bytes());
    let mut answer = String::new();
    let _ = stream.read_to_string(&mut answer);
    let (head, body) = answer.split_once("\r\n\r\n").unwrap_or((&answer, ""));
    Answer {
        status: head.split(' ').nth(1).and_then(|of| of.parse().ok()).unwrap_or(0),
        head: head.to_owned(),
        body: body.to_owned(),
    }
}

impl Page {
    fn open(dir: TempDir, folder: Folder) -> Self {
        let studio = Studio::listen(folder, "127.0.0.1:0".parse().expect("an address"));
        let studio = studio.expect("a free port");
        let (address, url) = (studio.address(), studio.url());
        let path = url.strip_prefix(&format!("http://{address}")).expect("its address");
        let path = path.to_owned();
        thread::spawn(move || studio.run());
        Self { dir, address, path }
    }

    fn send(&self, method: &str, path: &str, headers: &str, body: &str) -> Answer {
        let host = format!("Host: {}\r\n{headers}", self.address);
        raw(self.address, &format!("{method} {}{path}", self.path), &host, body)
    }

    fn get(&self, path: &str) -> Answer {
        self.send("GET", path, "", "")
    }

    fn post(&self, path: &str, body: &Value) -> Answer {
        self.send("POST", path, "", &body.to_string())
    }
}

fn page() -> Page {
    let (dir, folder) = small();
    Page::open(dir, folder)
}

/// The defaults of all open questions, as the page sends them.
fn defaults(state: &Value) -> Value {
    let questions = state["draft"]["questions"].as_array().expect("a list");
    let answers = questions
        .iter()
        .map(|of| json!({ "of": of["of"], "key": of["key"], "value": of["default"] }));
    answers.collect()
}

#[test]
fn the_http_api_turns_a_folder_into_a_machine_file() {
    let page = page();
    let html = page.get("");
    assert_eq!(html.status, 200);
    assert!(
        html.has("content-security-policy: default-src 'self'")
            && html.has("x-frame-options: DENY")
    );
    let state = page.get("api/state").json();
    let refused = page.post("api/fit", &json!({ "tolerance": "" }));
    assert_eq!(refused.status, 422);
    assert!(refused.json()["error"].as_str().expect("a text").contains("open questions"));
    assert_eq!(page.get("report.html").status, 422);
    let answered = page.post("api/answers", &defaults(&state)).json();
    assert_eq!(answered["draft"]["open"], 0, "{answered}");
    let fitted = page.post("api/fit", &json!({ "tolerance": "EXX=1" })).json();
    assert_eq!((&fitted["verdict"], &fitted["curves"]), (&json!("fail"), &json!(1)));
    // The page may show the report in a frame, but the report cannot send requests to the studio.
    let report = page.get("report.html");
    assert_eq!(report.status, 200);
    assert!(report.has("x-frame-options: SAMEORIGIN") && report.has("sandbox allow-scripts"));
    assert!(report.body.contains("<svg"));
    let file = page.get("file?name=result/machine.toml");
    assert!(file.has("attachment; filename=\"machine.toml\"") && file.body.contains("EXX"));
    for name in ["machine.toml", "../secret", "result/../machine.toml", "/etc/passwd"] {
        assert_eq!(page.get(&format!("file?name={name}")).status, 422, "{name}");
    }
    let request = json!({ "format": "csv", "step_mm": 100, "step_deg": 15, "limit_um": 250, "at": { "Y": 100 } });
    let tables = page.post("api/tables", &request).json();
    assert!(
        tables["files"][0].as_str().expect("a name").starts_with("result/tables/csv/"),
        "{tables}"
    );
    let program =
        page.send("POST", "api/nc?name=part.ngc&tolerance_um=1", "", "G21 G90\nG1 X400 F100\nM2\n");
    assert_eq!(program.json()["file"], "result/nc/part.ngc", "{}", program.body);
    assert!(page.get("file?name=result/nc/part.ngc").body.contains("X399.992"));
}

/// Every file of the folder with its content.
fn contents(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut all = BTreeMap::new();
    for entry in fs::read_dir(dir).expect("readable") {
        let path = entry.expect("readable").path();
        if path.is_dir() {
            all.extend(contents(&path));
        } else {
            all.insert(path.clone(), fs::read(path).expect("readable"));
        }
    }
    all
}

#[test]
fn a_cancelled_fit_changes_nothing() {
    let page = page();
    page.post("api/answers", &defaults(&page.get("api/state").json()));
    let before = contents(page.dir.path());
    // The second fit waits for the first.
    thread::scope(|scope| {
        let fit = || scope.spawn(|| page.post("api/fit", &json!({ "tolerance": "" })));
        let fits = [fit(), fit()];
        while !fits.iter().all(thread::ScopedJoinHandle::is_finished) {
            page.post("api/cancel", &json!({}));
            thread::sleep(Duration::from_millis(10));
        }
        for fit in fits {
            let refused = fit.join().expect("no panic");
            assert_eq!(refused.status, 409, "{}", refused.body);
            assert!(refused.body.contains("cancelled"), "{}", refused.body);
        }
    });
    assert_eq!(contents(page.dir.path()), before);
    // A later request is not cancelled.
    assert_eq!(page.post("api/fit", &json!({ "tolerance": "" })).status, 200);
}

#[test]
fn the_last_change_is_reverted_whole() {
    let page = page();
    let undo = || page.post("api/undo", &json!({}));
    let undoable = || page.get("api/state").json()["undo"]["what"].clone();
    let now = || contents(page.dir.path());
    assert_eq!(undo().status, 422, "nothing was changed yet");
    // The second answers replace the first, and undo restores the first.
    page.post("api/answers", &json!([]));
    let before = now();
    page.post("api/answers", &defaults(&page.get("api/state").json()));
    assert_eq!(undoable(), "answers");
    let answered = now();
    assert_ne!(before, answered);
    assert_eq!(undo().status, 200);
    assert_eq!(now(), before);
    assert_eq!((undo().status, undoable()), (422, Value::Null), "one level only");
    page.post("api/answers", &defaults(&page.get("api/state").json()));
    assert_eq!(now(), answered);
    // The first fit, and a fit of other readings that moves the first result aside.
    let fit = || assert_eq!(page.post("api/fit", &json!({ "tolerance": "" })).status, 200);
    fit();
    let fitted = now();
    fit();
    assert_eq!(now(), fitted, "the same input gives the same bytes");
    assert_eq!(undoable(), "fit");
    assert_eq!(undo().status, 200);
    assert_eq!(now(), answered);
    fit();
    let exx = page.dir.path().join("exx.csv");
    fs::write(&exx, SLOPE.replace(",8.1", ",8.4")).expect("writable");
    let before = now();
    fit();
    assert!(page.dir.path().join("result/before-1/machine.toml").exists());
    assert_eq!(undo().status, 200);
    assert_eq!(now(), before);
    assert_eq!(page.get("api/state").json()["is_stale"], true);
    // A program was written from the fit, so the fit can no longer be undone.
    fit();
    page.send("POST", "api/nc?name=part.ngc&tolerance_um=1", "", "G21 G90\nG1 X400 F100\nM2\n");
    assert_eq!(undoable(), Value::Null);
    // Undo of a machine file also removes the backup of the previous machine file.
    let before = now();
    let text = fs::read_to_string(page.dir.path().join("machine.toml")).expect("there");
    let machine = |text: &str| page.post("api/machine", &json!({ "text": text })).status;
    assert_eq!(machine(&text.replace("small", "other")), 200);
    assert_eq!((undoable(), undo().status), (json!("machine file"), 200));
    assert_eq!(now(), before);
    // Undo reverts the files of the last drop (`batch`) and keeps the files of the drop before.
    let upload = |name: &str, batch: u32, body: &str| {
        let path = format!("api/upload?name={name}&batch={batch}");
        assert_eq!(page.send("POST", &path, "", body).status, 200);
    };
    upload("one.csv", 1, "1");
    assert_eq!(undoable(), "file one.csv");
    assert_eq!((machine(&text), undoable()), (200, json!("file one.csv")), "the same again");
    let before = now();
    upload("two.csv", 2, "2");
    upload("machine.toml", 2, &text.replace("small", "third"));
    upload("three.csv", 2, "3");
    assert_eq!((undoable(), undo().status), (json!("3 files"), 200));
    assert_eq!(now(), before);
    // A file that another program has changed since the upload is kept, and undo is refused.
    upload("four.csv", 3, "4");
    fs::write(page.dir.path().join("four.csv"), "5").expect("writable");
    let refused = undo();
    assert_eq!(refused.status, 422);
    assert!(refused.body.contains("four.csv: was changed since"), "{}", refused.body);
    assert_eq!(fs::read_to_string(page.dir.path().join("four.csv")).expect("there"), "5");
}

#[test]
fn uploads_are_limited() {
    let page = page();
    let upload =
        |name: &str, body: &str| page.send("POST", &format!("api/upload?name={name}"), "", body);
    let other = SLOPE.replace("8.1", "8.3");
    let state = upload("..%2F..%2Feyy.csv", &other).json();
    assert_eq!(state["files"][1]["name"], "eyy.csv", "{state}");
    assert_eq!(upload("exx.csv", "0").status, 422);
    let large = "0".repeat(volcomp_studio::MAX_FILE_BYTES + 2);
    assert!([0, 413].contains(&upload("large.csv", &large).status));
    let wrong = page.post("api/machine", &json!({ "text": "structure = 3" }));
    assert_eq!(wrong.status, 422);
    assert!(wrong.body.contains("machine.toml:1"), "{}", wrong.body);
    assert_eq!(page.post("api/fit", &json!({ "tolerence": "" })).status, 400);
}

#[test]
fn other_origins_and_hosts_are_rejected() {
    let page = page();
    let (host, at) = (format!("Host: {}\r\n", page.address), page.address);
    let state = format!("GET {}api/state", page.path);
    // Without the token every path is rejected.
    for path in ["/", "/api/state", "/0123456789abcdef0123456789abcdef/api/state"] {
        assert_eq!(raw(at, &format!("GET {path}"), &host, "").status, 404, "{path}");
    }
    assert_eq!(raw(at, &state, "Host: evil.example\r\n", "").status, 421);
    assert_eq!(raw(at, &state, "", "").status, 421);
    for foreign in
        ["Origin: http://evil.example\r\n", "Origin: null\r\n", "Sec-Fetch-Site: cross-site\r\n"]
    {
        let refused = page.send("POST", "api/answers", foreign, "[]");
        assert_eq!(refused.status, 403, "{foreign}");
    }
    let own = format!("Origin: http://{at}\r\n");
    assert_eq!(page.send("POST", "api/answers", &own, "[]").status, 200);
    let (_dir, folder) = small();
    let everywhere = Studio::listen(folder, "0.0.0.0:0".parse().expect("an address"));
    assert!(everywhere.is_err());
}

/// Starts a server that answers each request with the next element of `answers`. Returns its address, and a thread that
/// ends with the received requests.
fn server(answers: Vec<(&'static str, String)>) -> (SocketAddr, thread::JoinHandle<Vec<String>>) {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("bound");
    let served = thread::spawn(move || {
        let mut received = Vec::new();
        for (head, body) in answers {
            let (mut stream, _) = listener.accept().expect("a client");
            let mut text = String::new();
            let mut buffer = vec![0; 65536];
            loop {
                let count = stream.read(&mut buffer).expect("readable");
                text += &String::from_utf8_lossy(&buffer[..count]);
                let (head, body) = text.split_once("\r\n\r\n").unwrap_or((&text, ""));
                let length = head.lines().find_map(|line| line.strip_prefix("Content-Length: "));
                let length: usize = length.and_then(|of| of.parse().ok()).unwrap_or(0);
                if text.contains("\r\n\r\n") && body.len() >= length || count == 0 {
                    break;
                }
            }
            received.push(text);
            let answer = format!("HTTP/1.1 {head}\r\n\r\n{body}");
            stream.write_all(answer.as_bytes()).expect("it reads");
        }
        received
    });
    (address, served)
}

#[test]
fn the_machine_file_is_sent_to_gateway_and_centre_with_authentication() {
    let page = page();
    page.post("api/answers", &defaults(&page.get("api/state").json()));
    let unfitted = json!({ "to": "gateway", "url": "http://127.0.0.1:1", "token": "t" });
    assert_eq!(page.post("api/send", &unfitted).status, 409);
    page.post("api/fit", &json!({ "tolerance": "" }));
    assert_eq!(page.post("api/send", &unfitted).status, 502, "no server listens");
    let done = json!({ "step": "ready", "error": null, "result": { "refusal": null, "warnings": ["look"] } });
    let (address, served) = server(vec![
        ("200 OK", json!({ "step": "working" }).to_string()),
        ("200 OK", json!({ "step": "working" }).to_string()),
        ("200 OK", done.to_string()),
    ]);
    let request = json!({ "to": "gateway", "url": format!("http://{address}/"), "token": "erna" });
    let sent = page.post("api/send", &request).json();
    assert_eq!(sent["warnings"], json!(["look"]), "{sent}");
    assert_eq!(sent["page"], format!("http://{address}/model"));
    let received = served.join().expect("no panic");
    assert!(received[0].starts_with("POST /api/model/upload?kind=machine&name=machine.toml"));
    assert!(received[0].contains("Authorization: Bearer erna") && received[0].contains("[errors]"));
    let (address, served) = server(vec![
        ("200 OK\r\nSet-Cookie: volcomp-centre=abc; Path=/; HttpOnly", "{}".to_owned()),
        ("200 OK", json!({ "added": true, "model": { "notes": [] } }).to_string()),
        ("200 OK", "{}".to_owned()),
    ]);
    let request = json!({ "to": "centre", "url": format!("http://{address}"), "name": "anna", "password": "p" });
    let sent = page.post("api/send", &request).json();
    assert!(sent["said"].as_str().expect("a text").starts_with("The centre has"), "{sent}");
    let received = served.join().expect("no panic");
    assert!(
        received[1].contains("Cookie: volcomp-centre=abc\r\n")
            && received[1].contains("X-Volcomp: 1")
    );
    assert!(received[2].starts_with("POST /api/logout"));
    // The page shows the message of a rejection.
    let refused = ("401 Unauthorized", json!({ "error": "a valid token is needed" }).to_string());
    let (address, served) = server(vec![refused]);
    let request = json!({ "to": "gateway", "url": format!("http://{address}"), "token": "no" });
    let answer = page.post("api/send", &request);
    assert_eq!(answer.status, 502);
    assert!(answer.body.contains("a valid token is needed"), "{}", answer.body);
    served.join().expect("no panic");
}

//! The HTTP interface: permissions, rejections, responses, and limits on password attempts.

use std::{io::Write as _, net::TcpStream, time::Duration};

use serde_json::json;
use volcomp_centre::{
    clock::now_s,
    http::{PageSettings, ROUTES},
    models::NewModel,
    records::{Origin, Version},
    rollout::Rules,
    users::{BootTime, Password, Role, Session, UserName, hash},
};
use volcomp_fleet::{Kind, Outcome};
use volcomp_test_support::until;

use crate::{
    shop::LONG,
    support::{Answer, PASSWORD, Page, condition, envelope, machine, model, received, tell},
};

/// Every route with every role and without a user. A forbidden request is rejected before any other check.
#[test]
fn every_role_on_every_route() {
    let page = Page::start();
    let people: Vec<(Option<Role>, String)> = std::iter::once((None, String::new()))
        .chain(Role::ALL.map(|role| (Some(role), page.session(role))))
        .collect();
    for route in ROUTES {
        // Logging out would end the session of this test.
        if route.path == "/api/logout" {
            continue;
        }
        let path = route
            .path
            .replace("{machine}", "mill-9")
            .replace("{model}", "abc")
            .replace("{file}", "x.csv")
            .replace("{rollout}", "9")
            .replace("{alarm}", "9")
            .replace("{user}", "unknown-user");
        for (role, cookie) in &people {
            let answer = match route.method {
                "GET" => page.get(&path, cookie),
                _ => page.post(&path, cookie, &json!({})),
            };
            let expected = match (route.need, role) {
                (Some(_), None) => Some(401),
                (Some(needed), Some(role)) if *role < needed => Some(403),
                _ => None,
            };
            let what = format!("{} {path} as {role:?}: {}", route.method, answer.body);
            match expected {
                Some(status) => assert_eq!(answer.status, status, "{what}"),
                None => assert!(
                    !matches!(answer.status, 0 | 401 | 403 | 405 | 500),
                    "{} {what}",
                    answer.status
                ),
            }
        }
    }
}

#[test]
fn login_creates_a_session_that_ends() {
    let page = Page::start();
    let login = |password: &str| {
        page.post("/api/login", "", &json!({ "name": "engineer", "password": password }))
    };
    let answer = login(PASSWORD);
    assert_eq!(answer.status, 200, "{}", answer.body);
    let head = answer.head.clone();
    assert!(head.contains("HttpOnly; SameSite=Strict"), "{head}");
    let cookie = answer.cookie().expect("a cookie");
    assert_eq!(page.get("/api/me", &cookie).json()["role"], "engineer");
    // The store's files do not contain the token.
    let token = cookie.split('=').nth(1).expect("a token").to_owned();
    for file in std::fs::read_dir(page.folder.path()).expect("a folder") {
        let bytes = std::fs::read(file.expect("a file").path()).expect("readable");
        let found = bytes.windows(token.len()).any(|part| part == token.as_bytes());
        assert!(!found, "the token is stored");
    }
    let ended = page.post("/api/logout", &cookie, &json!({}));
    assert!(ended.head.contains("Max-Age=0"), "{}", ended.head);
    assert_eq!(page.get("/api/me", &cookie).status, 401);
    // Wrong passwords, unknown users and garbage get the same response.
    for _ in 0..5 {
        assert_eq!(login("wrong").json()["error"], "the name or the password is wrong");
    }
    for name in ["unknown-user", "<script>alert(1)</script>"] {
        let body = json!({ "name": name, "password": "x" });
        let answer = page.post("/api/login", "", &body);
        assert_eq!(answer.status, 401);
        assert_eq!(answer.json()["error"], "the name or the password is wrong");
    }
    // The correct password is accepted after wrong ones from the same address.
    assert_eq!(login(PASSWORD).status, 200);
    // The attempts are in the audit log with their origin.
    let admin = page.session(Role::Admin);
    let audit = page.get("/api/audit", &admin).body;
    assert!(audit.contains("login.refused") && audit.contains("127.0.0.1"), "{audit}");
    assert!(!audit.contains(PASSWORD) && !audit.contains(&token));
}

/// Sends a request three times after wrong passwords, which delay it. Runs `change` while two of the requests wait;
/// both have already read the password hash. Returns the responses.
fn during_delay(
    page: &Page,
    request: impl Fn() -> Answer + Sync,
    change: impl FnOnce(),
) -> Vec<Answer> {
    let wrong = json!({ "name": "engineer", "password": "wrong" });
    for _ in 0..5 {
        page.posts("/api/login", "", &wrong, 401);
    }
    let (sender, answers) = std::sync::mpsc::channel();
    std::thread::scope(|scope| {
        for _ in 0..3 {
            let (sender, request) = (sender.clone(), &request);
            scope.spawn(move || sender.send(request()).expect("it is received"));
        }
        drop(sender);
        // At most two requests may wait, so the third is rejected immediately.
        let first = answers.recv().expect("three are sent");
        change();
        [first].into_iter().chain(answers).collect()
    })
}

/// "A session ends when the user's password changes": a login with the old password that was delayed gets no session after the change.
#[test]
fn a_login_begun_before_a_change_of_password_gets_no_session() {
    let page = Page::start();
    let engineer: UserName = "engineer".parse().expect("a name");
    let new = Password::chosen("another horse battery".to_owned()).expect("long enough");
    let new = hash(&new).expect("memory");
    let login = json!({ "name": "engineer", "password": PASSWORD });
    let answers = during_delay(
        &page,
        || page.post("/api/login", "", &login),
        || {
            let changed = page.store.set_password(&engineer, &new, "admin", "test");
            changed.expect("stored");
        },
    );
    for cookie in answers.iter().filter_map(Answer::cookie) {
        assert_eq!(page.get("/api/me", &cookie).status, 401, "{answers:?}");
    }
}

/// A delayed request with the old password does not overwrite the password that an admin has set meanwhile.
#[test]
fn a_change_of_password_begun_before_that_of_an_admin_does_not_replace_it() {
    let page = Page::start();
    let engineer: UserName = "engineer".parse().expect("a name");
    let new = Password::chosen("another horse battery".to_owned()).expect("long enough");
    let new = hash(&new).expect("memory");
    let cookie = page.session(Role::Engineer);
    let body = json!({ "old": PASSWORD, "new": "the horse of a thief" });
    let answers = during_delay(
        &page,
        || page.post("/api/password", &cookie, &body),
        || {
            let changed = page.store.set_password(&engineer, &new, "admin", "test");
            changed.expect("stored");
        },
    );
    let (_, stored) = (page.store.user(&engineer).expect("read")).expect("a user");
    assert_eq!(stored, new, "{answers:?}");
}

/// Requests that the role forbids and cross-site changes are recorded once each in the audit log.
#[test]
fn forbidden_requests_are_recorded() {
    let page = Page::start();
    let viewer = page.session(Role::Viewer);
    for _ in 0..3 {
        page.posts("/api/users", &viewer, &json!({}), 403);
    }
    let admin = page.session(Role::Admin);
    let audit = page.get("/api/audit", &admin).body;
    assert_eq!(audit.matches("request.forbidden").count(), 1, "{audit}");
    assert!(audit.contains("/api/users"), "{audit}");
}

#[test]
fn expired_sessions_are_rejected() {
    let page = Page::start();
    let now = BootTime::now();
    let ago = |by: Duration| BootTime {
        since_boot_s: now.since_boot_s - by.as_secs_f64(),
        ..now.clone()
    };
    let alive = page.cookie_of(
        Role::Admin,
        &ago(Session::IDLE_TIMEOUT.saturating_sub(Duration::from_secs(60))),
    );
    assert_eq!(page.get("/api/me", &alive).status, 200);
    let idle = page.cookie_of(Role::Admin, &ago(Session::IDLE_TIMEOUT + Duration::from_secs(1)));
    assert_eq!(page.get("/api/me", &idle).status, 401);
    let other_boot = BootTime { boot: "another".to_owned(), ..now.clone() };
    let cookie = page.cookie_of(Role::Admin, &other_boot);
    assert_eq!(page.get("/api/me", &cookie).status, 401);
    for garbage in ["volcomp-centre=", "volcomp-centre=../../etc", "x=y"] {
        assert_eq!(page.get("/api/me", garbage).status, 401);
    }
    // A disabled user loses the session immediately.
    let cookie = page.session(Role::Viewer);
    assert_eq!(page.get("/api/me", &cookie).status, 200);
    let body = json!({ "role": "viewer", "disabled": true });
    let admin = page.session(Role::Admin);
    page.posts("/api/users/viewer", &admin, &body, 200);
    assert_eq!(page.get("/api/me", &cookie).status, 401);
}

/// A database that rejects every change cannot store the alarm about the rejection either. The page shows the alarm
/// from memory until a change succeeds.
#[test]
fn a_full_disk_is_an_alarm_that_needs_no_disk() {
    let page = Page::start();
    let cookie = page.session(Role::Viewer);
    let shown = |path: &str| page.get(path, &cookie).body.contains("rejects changes");
    assert!(!shown("/api/alarms"));
    page.store.limit_pages(1).expect("limited");
    let record = json!("x".repeat(10_000));
    let mut records =
        std::iter::repeat_with(|| page.store.audit("test", "test", "test", record.clone()));
    assert!(records.by_ref().take(1000).any(|written| written.is_err()));
    assert!(shown("/api/alarms") && shown("/api/alarms?all=true"));
    until("the overview shows it", LONG, || shown("/api/overview"));
    page.store.limit_pages(u32::MAX - 1).expect("limited");
    assert!(records.next().is_some_and(|written| written.is_ok()));
    assert!(!shown("/api/alarms"));
}

/// A page of another origin makes the browser send the cookie (without SameSite). The change gets status 403.
#[test]
fn cross_site_changes_are_rejected() {
    let page = Page::start();
    let cookie = format!("Cookie: {}", page.session(Role::Admin));
    let ours = "X-Volcomp: 1".to_owned();
    let origin = format!("Origin: http://{}", page.address);
    let post = |lines: &[String]| page.request("POST", "/api/alarms/1/seen", lines, "").status;
    assert_eq!(post(&[cookie.clone(), ours.clone(), origin.clone()]), 404);
    assert_eq!(post(&[cookie.clone(), ours.clone()]), 404, "a program without a browser");
    assert_eq!(post(&[cookie.clone(), origin]), 403);
    for other in [
        "Origin: http://evil.example",
        "Origin: null",
        "Origin: http://127.0.0.1.evil.example",
        "Origin: http://127.0.0.1",
        "Sec-Fetch-Site: cross-site",
        "Sec-Fetch-Site: same-site",
    ] {
        let lines = [cookie.clone(), ours.clone(), other.to_owned()];
        assert_eq!(post(&lines), 403, "{other}");
    }
    // No response permits another origin to change or read.
    let asked =
        page.request("OPTIONS", "/api/machines", &["Origin: http://evil.example".to_owned()], "");
    assert!(!asked.head.contains("access-control-allow"), "{}", asked.head);
    let host = "GET /api/me HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n";
    assert_eq!(page.raw(host.as_bytes()).status, 421);
}

#[test]
fn malformed_requests_and_paths_are_rejected() {
    let page = Page::start();
    let admin = page.session(Role::Admin);
    let lines = [format!("Cookie: {admin}"), "X-Volcomp: 1".to_owned()];
    for route in ROUTES.iter().filter(|route| route.method == "POST") {
        if ["/api/logout", "/api/login"].contains(&route.path) {
            continue;
        }
        let path = route.path.replace(['{', '}'], "");
        for body in ["", "{", "[]", "\u{0}", "{\"a\":1}", "null", "{\"subnets\":[\"8.8.8.8/8\"]}"] {
            let answer = page.request("POST", &path, &lines, body);
            let refused = (400..500).contains(&answer.status);
            assert!(refused, "{path} {body:?}: {} {}", answer.status, answer.body);
        }
        let deep = "[".repeat(100_000);
        assert!(page.request("POST", &path, &lines, &deep).status >= 400);
    }
    for path in [
        "/../../etc/passwd",
        "/..%2f..%2fetc/passwd",
        "/%2e%2e/%2e%2e/etc/passwd",
        "/api/machines/..%2f..%2fcentre.db",
        "/api/models/..%2fcentre.db",
        "/api/models/%27%20OR%201=1",
        "/api/models/%25",
        "/api/machines/%00",
        "/api/machines/%ff",
        "/style.css/../../Cargo.toml",
        "//evil.example/",
    ] {
        let answer = page.get(path, &admin);
        assert!((400..500).contains(&answer.status), "{path}: {}", answer.status);
        assert!(!answer.body.contains("root:"), "{path}");
    }
    let large = "x".repeat(3 * 1024 * 1024);
    let refused = page.request("POST", "/api/models", &lines, &large).status;
    assert!(matches!(refused, 0 | 413), "{refused}");
    assert_eq!(page.get("/api/me", &admin).status, 200);
}

#[test]
fn the_page_loads_nothing_from_other_origins() {
    let page = Page::start();
    let html = page.get("/", "");
    assert_eq!(html.status, 200);
    for line in [
        "content-security-policy: default-src 'self'",
        "x-frame-options: DENY",
        "x-content-type-options: nosniff",
        "cache-control: no-store",
    ] {
        assert!(html.head.contains(line), "{line}: {}", html.head);
    }
    let files = html.body.split('"').filter(|part| {
        part.starts_with('/') && [".js", ".css", ".svg"].iter().any(|end| part.ends_with(end))
    });
    let mut count = 0;
    for file in files {
        count += 1;
        assert_eq!(page.get(file, "").status, 200, "{file}");
    }
    assert!(count >= 9, "{count}");
    assert!(!html.body.contains("http://") && !html.body.contains("https://"));
}

/// The last admin cannot be demoted or removed. A user who loses a role loses the session.
#[test]
fn the_last_admin_cannot_be_removed() {
    let page = Page::start();
    let admin = page.session(Role::Admin);
    for body in [
        json!({ "role": "viewer", "disabled": false }),
        json!({ "role": "admin", "disabled": true }),
    ] {
        page.posts("/api/users/admin", &admin, &body, 409);
    }
    page.posts("/api/users/admin/remove", &admin, &json!({}), 409);
    let new = json!({ "name": "anna", "role": "admin", "password": PASSWORD });
    page.posts("/api/users", &admin, &new, 200);
    page.posts("/api/users", &admin, &new, 409);
    let missing = json!({ "role": "viewer", "disabled": false, "password": PASSWORD });
    page.posts("/api/users/otto", &admin, &missing, 404);
    let short = json!({ "name": "otto", "role": "admin", "password": "short" });
    page.posts("/api/users", &admin, &short, 400);
    page.posts("/api/users/admin/remove", &admin, &json!({}), 200);
    assert_eq!(page.get("/api/me", &admin).status, 401);
}

#[test]
fn a_registered_machine_is_shown_with_unknown_values() {
    let page = Page::start();
    let engineer = page.session(Role::Engineer);
    let machine = |structure: &str, axes: &[&str], note: &str| {
        json!({
            "machine": "mill-1", "site": "hall-2", "serial": "4711", "structure": structure, "axes": axes,
            "enable": true, "note": note,
        })
    };
    let post = |body| page.post("/api/machines", &engineer, &body);
    let note = "<script>alert(1)</script>";
    for wrong in [
        machine("w X' b Y Z", &["X", "Y", "Z"], note),
        machine("w X' b Y Z t", &["Y", "X", "Z"], note),
        machine("w X' b Y Z t", &["X", "Y", "Z"], "a\nb"),
    ] {
        page.posts("/api/machines", &engineer, &wrong, 400);
    }
    let done = post(machine("w X' b Y Z t", &["X", "Y", "Z"], note));
    assert_eq!(done.status, 200, "{}", done.body);
    let viewer = page.session(Role::Viewer);
    let row = page.overview(&viewer)["machines"][0].clone();
    assert_eq!(row["state"], "never connected");
    assert_eq!(row["age_s"], serde_json::Value::Null);
    assert_eq!(row["residual_um"], serde_json::Value::Null);
    let deep = page.get("/api/machines/mill-1", &viewer).json();
    assert_eq!((&deep["live"], &deep["silent"]), (&json!(null), &json!(true)));
    let history = page.get("/api/machines/mill-1/history?resolution=raw&hours=1", &viewer);
    assert_eq!(history.json()["points"], json!([]));
    for range in [
        "resolution=raw&hours=-1",
        "resolution=year&hours=1",
        "hours=1",
        "resolution=raw&hours=NaN",
    ] {
        let path = format!("/api/machines/mill-1/history?{range}");
        assert_eq!(page.get(&path, &viewer).status, 400, "{range}");
    }
    // The actions are in the audit log with user and origin.
    let admin = page.session(Role::Admin);
    let audit = page.get("/api/audit", &admin).json();
    let records = audit.as_array().expect("a list");
    let request = records
        .iter()
        .find(|record| record["action"] == "request" && record["details"]["status"] == 200)
        .expect("a record of the request");
    assert_eq!(request["by"], "engineer");
    assert_eq!(request["details"]["from"], "127.0.0.1");
}

#[test]
fn a_machine_file_is_added_and_rolled_out() {
    let page = Page::start();
    let engineer = page.session(Role::Engineer);
    let text = "name = \"mill-1 <b>bold</b>\"\nstructure = \"w X' b Y Z t\"\naxes.X.travel = [0.0, 800.0]\naxes.Y.travel = [0.0, 600.0]\naxes.Z.travel = [-500.0, 0.0]\n[errors]\nEXX = { poly = [0.0, 0.02] }\nEC0Y = 12.0\n";
    let body = json!({ "text": text, "file": "m.toml", "measured": "2026-11-20" });
    let saved = page.posts("/api/models", &engineer, &body, 200);
    assert!(!saved.json()["model"]["notes"].to_string().contains("guard"));
    let beyond = json!({ "text": text.replace("0.02", "20.0") });
    let beyond = page.post("/api/models", &engineer, &beyond).json();
    assert!(beyond["model"]["notes"].to_string().contains("No guard corrects"), "{beyond}");
    let sha = saved.json()["model"]["sha256"].as_str().expect("a checksum").to_owned();
    let viewer = page.session(Role::Viewer);
    let model = page.get(&format!("/api/models/{}", &sha[..12]), &viewer).json();
    assert_eq!(model["model"]["measured"], "2026-11-20");
    assert_eq!(model["described"]["text"], text);
    assert_eq!(model["described"]["type_numbers"], json!([1, 0]));
    let map = page.get(&format!("/api/models/{sha}/map"), &viewer).json();
    assert_eq!(map["sections"].as_array().expect("a list").len(), 3);
    let start = json!({ "model": sha, "machines": ["mill-1"] });
    page.posts("/api/rollouts", &engineer, &start, 404);
    let machine = json!({
        "machine": "mill-1", "site": "hall-2", "serial": "4711", "structure": "w X' b Y Z t",
        "axes": ["X", "Y", "Z"], "enable": true,
    });
    page.posts("/api/machines", &engineer, &machine, 200);
    let rules = json!({ "model": sha, "machines": ["mill-1"], "rules": { "waves": [100, 25] } });
    page.posts("/api/rollouts", &engineer, &rules, 400);
    page.posts("/api/rollouts", &engineer, &start, 200);
    page.posts("/api/rollouts", &engineer, &start, 409);
    let request = json!({ "wish": "pause" });
    page.posts("/api/rollouts/1", &engineer, &request, 200);
    page.posts("/api/rollouts/2", &engineer, &request, 404);
    assert_eq!(page.get("/api/rollouts", &viewer).json()[0]["turns"][0]["machine"], "mill-1");
}

#[test]
fn a_model_is_downloaded_as_signed_and_as_tables() {
    let page = Page::start();
    let text = "name = \"../a \\\"b\\\"\"\nstructure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 500.0]\n[axes.Y]\ntravel = [0.0, 400.0]\n[axes.Z]\ntravel = [0.0, 300.0]\n[errors]\n# a comment stays\nEXX = { poly = [0.0, 0.03] }\n";
    let new = NewModel::of_text(text.to_owned(), "m", Origin::File { name: String::new() }, "test")
        .expect("a model");
    page.store.add_model(&new.model, &new.text).expect("stored");
    let viewer = page.session(Role::Viewer);
    let sha256 = &new.model.sha256;
    let file = page.get(&format!("/api/models/{sha256}/file"), &viewer);
    assert_eq!((file.status, file.body.as_str()), (200, text));
    let name = format!("filename=\"a--b-{}.toml\"", &sha256[..10]);
    assert!(file.head.contains(&name), "{}", file.head);
    let path = format!("/api/models/{sha256}/tables");
    let reported = page.get(&format!("{path}?format=csv&step_mm=100"), &viewer).json();
    assert!(
        reported["trust"].as_str().is_some_and(|text| text.starts_with("Sign proven")),
        "{reported}"
    );
    let name = reported["files"][0].as_str().expect("a file").to_owned();
    let table = page.get(&format!("{path}/{name}?format=csv&step_mm=100"), &viewer);
    // 0.03 µm/mm along X are 15 µm at 500 mm.
    let row = (table.body.lines()).find_map(|line| line.strip_prefix("X,X,500,"));
    let reported = row.and_then(|row| row.split(',').next()?.parse::<f64>().ok());
    assert!(reported.is_some_and(|um| (um - 15.0).abs() < 0.01), "{}", table.body);
    for format in page.get("/api/formats", &viewer).json().as_array().expect("formats") {
        let format = format["format"].as_str().expect("a name");
        let reported = page.get(&format!("{path}?format={format}&step_mm=50"), &viewer).json();
        let files = reported["files"].as_array().map_or(0, Vec::len);
        assert!(files > 0, "{format}: {reported}");
    }
    let wrong = page.get(&format!("{path}?format=csv&step_mm=0"), &viewer);
    assert_eq!(wrong.status, 400);
    assert!(wrong.body.contains("Step along linear axes: found 0"), "{}", wrong.body);
    assert_eq!(page.get(&format!("{path}?format=dxf"), &viewer).status, 400);
    assert_eq!(page.get(&format!("{path}/other.csv?format=csv"), &viewer).status, 404);
}

/// A rejected or unconfirmed model does not renew the due date. Returning to an earlier model and keeping a model are
/// rejected if there is no such model.
#[test]
fn a_rejected_model_does_not_renew_the_due_date() {
    let page = Page::start();
    let engineer = page.session(Role::Engineer);
    let mut machine = machine("mill-1");
    machine.due_days = Some(30);
    page.store.put_machine(&machine, "anna").expect("stored");
    let raw = rusqlite::Connection::open(page.folder.path().join("centre.db")).expect("open");
    let name = machine.identity.machine.clone();
    for (number, measured, outcome) in [
        (1_u32, "2020-01-01", Outcome::Activated),
        (2, "9999-01-01", Outcome::Refused { why: "no".into() }),
    ] {
        let mut new = model(number);
        new.model.measured = measured.to_owned();
        page.store.add_model(&new.model, &new.text).expect("stored");
        let version = Version {
            machine: name.clone(),
            version: number.into(),
            model: new.model.sha256.clone(),
            enable: true,
            confirm: None,
            condition_s: None,
            telemetry_s: None,
            value_sha256: number.to_string(),
            rollout: None,
            issued_s: 0.0,
            by: "anna".to_owned(),
            outcome: Some(outcome),
            answered_s: None,
            withdrawn: false,
        };
        let document = serde_json::to_string(&version).expect("plain data");
        raw.execute(
            "INSERT INTO versions (machine, version, model, rollout, value_sha256, document) VALUES ('mill-1', ?1, ?2, NULL, ?3, ?4)",
            rusqlite::params![number, version.model, version.value_sha256, document],
        )
        .expect("written");
        raw.execute(
            "INSERT INTO desired (machine, version, model, value) VALUES ('mill-1', ?1, ?2, 'x')
             ON CONFLICT (machine) DO UPDATE SET version = excluded.version, model = excluded.model",
            rusqlite::params![number, version.model],
        )
        .expect("written");
    }
    let row = page.overview(&engineer)["machines"][0].clone();
    assert_eq!(row["wanted"], 2);
    let due = row["due_in_days"].as_f64().expect("a number");
    assert!(due < -2000.0, "{due}");
    page.posts("/api/machines/mill-1/back", &engineer, &json!({}), 409);
    let keep = json!({ "machine": "mill-1" });
    page.posts("/api/rollouts/9/keep", &engineer, &keep, 404);
    let body = json!({ "model": model(1).model.sha256, "machines": ["mill-1"] });
    page.posts("/api/rollouts", &engineer, &body, 200);
    page.posts("/api/rollouts/1/keep", &engineer, &keep, 409);
}

/// A history has more conditions than a response has points. The points cover the whole time span, each condition
/// counts once, and the newest is included.
#[test]
fn a_long_history_is_averaged_over_its_whole_span() {
    const COUNT: u32 = 7000;
    let page = Page::start();
    // The conditions end shortly before now, so that all stay within two hours while the test runs.
    let from_s = now_s().floor() - 7100.0;
    let batch: Vec<_> = (1..=COUNT)
        .map(|number| {
            let reported = envelope("a", number.into(), condition(1.0));
            let at_s = from_s + f64::from(number);
            received("mill-1", Kind::Condition, number.into(), at_s, &reported)
        })
        .collect();
    tell(&page.store, &batch);
    page.store.close_minutes(now_s()).expect("stored");
    let viewer = page.session(Role::Viewer);
    let path = "/api/machines/mill-1/history?resolution=raw&hours=2";
    let reported = page.get(path, &viewer).json();
    let points = reported["points"].as_array().expect("a list");
    assert!((1000..=2000).contains(&points.len()), "{}", points.len());
    let number = |point: &serde_json::Value, key: &str| point[key].as_f64().expect("a number");
    let counted: f64 = points.iter().map(|point| number(point, "count")).sum();
    assert_eq!(counted, f64::from(COUNT));
    let together = number(&reported, "together");
    let [first, last] = [points.first(), points.last()].map(|point| number(point.unwrap(), "at_s"));
    assert_eq!(first, from_s + 1.0);
    assert!(last > from_s + f64::from(COUNT) - together, "{last}");
}

/// A roll-out without rules uses the configured rules, which the page shows. Invalid rules start no roll-out.
#[test]
fn a_rollout_from_the_page_uses_the_configured_rules() {
    let rules = Rules { soak_s: 42.0, waves: vec![10, 100], ..Rules::default() };
    let page = Page::start_with(PageSettings { rules: rules.clone(), ..PageSettings::default() });
    let new = model(1);
    page.store.add_model(&new.model, &new.text).expect("stored");
    let mill = machine("mill-1");
    page.store.put_machine(&mill, "anna").expect("stored");
    let engineer = page.session(Role::Engineer);
    assert_eq!(page.get("/api/rules", &engineer).json()["soak_s"], 42.0);
    let mut start = json!({ "model": new.model.sha256, "machines": ["mill-1"] });
    for (wrong, key) in [
        (json!({ "waves": [0, 100] }), "waves"),
        (json!({ "waves": [50, 50, 100] }), "waves"),
        (json!({ "waves": [50] }), "waves"),
        (json!({ "soak_s": -1.0 }), "soak_s"),
        (json!({ "answer_s": 0.0 }), "answer_s"),
        (json!({ "residual_ratio": 0.5 }), "residual_ratio"),
        (json!({ "residual_um": 1e6 }), "residual_um"),
    ] {
        start["rules"] = wrong;
        let answer = page.posts("/api/rollouts", &engineer, &start, 400);
        assert!(answer.body.contains(&format!("rules.{key}: found")), "{}", answer.body);
    }
    start["rules"] = json!(null);
    page.posts("/api/rollouts", &engineer, &start, 200);
    assert_eq!(page.store.rollouts(1).expect("a store")[0].rules, rules);
}

/// Clients that disconnect before the response: their wrong passwords are counted.
#[test]
fn wrong_passwords_of_clients_that_hang_up_are_counted() {
    let page = Page::start();
    let body = json!({ "name": "admin", "password": "wrong" }).to_string();
    let (address, length) = (page.address, body.len());
    let request = format!(
        "POST /api/login HTTP/1.1\r\nHost: {address}\r\nOrigin: http://{address}\r\nX-Volcomp: 1\r\nContent-Type: application/json\r\nContent-Length: {length}\r\n\r\n{body}"
    );
    let admin = page.session(Role::Admin);
    until("an attempt is recorded", Duration::from_secs(60), || {
        // A busy computer may not have begun the comparison of the password, which takes longer than this: then again.
        for _ in 0..5 {
            let mut stream = TcpStream::connect(address).expect("it listens");
            stream.write_all(request.as_bytes()).expect("sent");
            std::thread::sleep(Duration::from_millis(10));
        }
        page.get("/api/audit", &admin).body.contains("login.refused")
    });
}

/// Concurrent wrong passwords exceed the limit by at most one attempt.
#[test]
fn concurrent_wrong_passwords_are_counted() {
    let page = Page::start();
    let body = json!({ "name": "admin", "password": "wrong" });
    let statuses: Vec<u16> = std::thread::scope(|scope| {
        let asked: Vec<_> =
            (0..20).map(|_| scope.spawn(|| page.post("/api/login", "", &body).status)).collect();
        asked.into_iter().map(|one| one.join().unwrap()).collect()
    });
    let looked_at = statuses.iter().filter(|status| **status == 401).count();
    let turned_away = statuses.iter().filter(|status| **status == 429).count();
    // Five concurrent attempts, one attempt concurrent with the fifth, and two attempts that may wait for their delay.
    assert!((7..=8).contains(&looked_at), "{statuses:?}");
    assert_eq!(looked_at + turned_away, statuses.len(), "{statuses:?}");
}

/// A machine reconnects after an hour and sends its queue, audit records first. A condition of an hour ago is not
/// current, even if a newer audit record has arrived.
#[test]
fn a_condition_of_an_hour_ago_is_not_current() {
    let page = Page::start();
    page.store.put_machine(&machine("mill-a"), "anna").unwrap();
    let now = now_s();
    let mut first = envelope("a", 1, condition(4.0));
    first.uptime_s = 1.0;
    let mut second = envelope("a", 2, condition(4.0));
    second.uptime_s = 2.0;
    let record = envelope("a", 3, json!({ "checksum": "ab", "record": "{}" }));
    let batch = [
        received("mill-a", Kind::Condition, 1, now - 3600.0, &first),
        // The condition was created one second after the first, then queued for an hour.
        received("mill-a", Kind::Condition, 2, now, &second),
        received("mill-a", Kind::Audit, 1, now, &record),
    ];
    tell(&page.store, &batch);
    let cookie = page.session(Role::Viewer);
    let overview = page.overview(&cookie);
    let row = &overview["machines"][0];
    assert!(
        row["state"] == "unknown" || row["age_s"].as_f64().unwrap() > 3000.0,
        "state {}, armed {}, {} s old; it was made an hour ago",
        row["state"],
        row["armed"],
        row["age_s"]
    );
}

/// The database becomes unreadable. The page responds with 503 instead of serving the last overview as current.
#[test]
fn an_outdated_overview_is_not_served() {
    let page = Page::start();
    page.store.put_machine(&machine("mill-a"), "anna").unwrap();
    let one = envelope("a", 1, condition(4.0));
    let one = received("mill-a", Kind::Condition, 1, now_s(), &one);
    tell(&page.store, &[one]);
    let cookie = page.session(Role::Viewer);
    page.overview(&cookie);
    let raw = rusqlite::Connection::open(page.folder.path().join("centre.db")).unwrap();
    raw.execute_batch("ALTER TABLE live RENAME TO gone").unwrap();
    let mut answer = page.get("/api/overview", &cookie);
    until("it is no longer served", LONG, || {
        answer = page.get("/api/overview", &cookie);
        answer.status != 200
    });
    assert_eq!(answer.status, 503, "{}", answer.body);
    let why = answer.json()["error"].as_str().unwrap().to_owned();
    assert!(why.contains("the current states are unknown"), "{why}");
    raw.execute_batch("ALTER TABLE gone RENAME TO live").unwrap();
    let reported = page.overview(&cookie);
    let made_s = reported["made_s"].as_f64().unwrap();
    assert!((now_s() - made_s).abs() < 5.0, "{made_s}");
}

/// The page of a machine is served even if a stored document contains a number that cannot be parsed.
#[test]
fn an_unreadable_document_does_not_close_the_machine_page() {
    for (kind, body) in
        [(Kind::Telemetry, "1e999"), (Kind::Audit, "{\"checksum\":\"\",\"record\":\"\\ud800\"}")]
    {
        let page = Page::start();
        page.store.put_machine(&machine("mill-a"), "anna").unwrap();
        let mut message = received("mill-a", kind, 1, now_s(), &envelope("a", 1, ()));
        let text = String::from_utf8(message.bytes.to_vec()).unwrap();
        message.bytes = text.replace("null", body).into();
        tell(&page.store, &[message]);
        let cookie = page.session(Role::Viewer);
        page.overview(&cookie);
        let answer = page.get("/api/machines/mill-a", &cookie);
        assert_eq!(answer.status, 200, "{kind:?} {body}: {}", answer.body);
    }
}

//! Who may ask what, and what is refused.

use std::time::Duration;

use serde_json::json;
use volcomp_centre::{
    http::ROUTES,
    models::NewModel,
    records::{Origin, Version},
    users::{Moment, Role, Session},
};
use volcomp_fleet::Outcome;

use crate::page::{PASSWORD, Page};

/// Every role, and nobody, on every route: what is not allowed is refused before anything else is looked at.
#[test]
fn every_role_on_every_route() {
    let page = Page::start();
    let people: Vec<(Option<Role>, String)> = std::iter::once((None, String::new()))
        .chain(Role::ALL.map(|role| (Some(role), page.session(role))))
        .collect();
    for route in ROUTES {
        // Logging out ends the session of this test.
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
            .replace("{user}", "nobody");
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
fn logging_in_gives_a_session_that_ends() {
    let page = Page::start();
    let login = |password: &str| {
        page.post(
            "/api/login",
            "",
            &json!({ "name": "engineer", "password": password }),
        )
    };
    let answer = login(PASSWORD);
    assert_eq!(answer.status, 200, "{}", answer.body);
    let head = answer.head.clone();
    assert!(head.contains("HttpOnly; SameSite=Strict"), "{head}");
    let cookie = answer.cookie().expect("a cookie");
    assert_eq!(page.get("/api/me", &cookie).json()["role"], "engineer");
    // The token itself is in no file of the store.
    let token = cookie.split('=').nth(1).expect("a token").to_owned();
    for file in std::fs::read_dir(page.folder.path()).expect("a folder") {
        let bytes = std::fs::read(file.expect("a file").path()).expect("readable");
        let found = bytes
            .windows(token.len())
            .any(|part| part == token.as_bytes());
        assert!(!found, "the token is stored");
    }
    let ended = page.post("/api/logout", &cookie, &json!({}));
    assert!(ended.head.contains("Max-Age=0"), "{}", ended.head);
    assert_eq!(page.get("/api/me", &cookie).status, 401);
    // Wrong passwords, unknown users and garbage are refused alike.
    for _ in 0..5 {
        assert_eq!(
            login("wrong").json()["error"],
            "the name or the password is wrong"
        );
    }
    for name in ["nobody", "<script>alert(1)</script>"] {
        let body = json!({ "name": name, "password": "x" });
        let answer = page.post("/api/login", "", &body);
        assert_eq!(answer.status, 401);
        assert_eq!(answer.json()["error"], "the name or the password is wrong");
    }
    // The right password is accepted, although wrong ones came from the same address.
    assert_eq!(login(PASSWORD).status, 200);
    // What was tried stands in the audit log, with where it came from.
    let admin = page.session(Role::Admin);
    let audit = page.get("/api/audit", &admin).body;
    assert!(
        audit.contains("login.refused") && audit.contains("127.0.0.1"),
        "{audit}"
    );
    assert!(!audit.contains(PASSWORD) && !audit.contains(&token));
}

/// Attempts to do what the role does not permit, and changes by a page of another origin, are in the audit log.
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
fn sessions_that_are_over_are_nobody() {
    let page = Page::start();
    let now = Moment::now();
    let ago = |by: Duration| Moment {
        since_boot_s: now.since_boot_s - by.as_secs_f64(),
        ..now.clone()
    };
    let alive = page.cookie_of(
        Role::Admin,
        &ago(Session::IDLE.saturating_sub(Duration::from_secs(60))),
    );
    assert_eq!(page.get("/api/me", &alive).status, 200);
    let idle = page.cookie_of(Role::Admin, &ago(Session::IDLE + Duration::from_secs(1)));
    assert_eq!(page.get("/api/me", &idle).status, 401);
    let other_boot = Moment {
        boot: "another".to_owned(),
        ..now.clone()
    };
    let cookie = page.cookie_of(Role::Admin, &other_boot);
    assert_eq!(page.get("/api/me", &cookie).status, 401);
    for garbage in ["volcomp-centre=", "volcomp-centre=../../etc", "x=y"] {
        assert_eq!(page.get("/api/me", garbage).status, 401);
    }
    // A user who may not log in any more is out at once.
    let cookie = page.session(Role::Viewer);
    assert_eq!(page.get("/api/me", &cookie).status, 200);
    let body = json!({ "role": "viewer", "disabled": true });
    let admin = page.session(Role::Admin);
    page.posts("/api/users/viewer", &admin, &body, 200);
    assert_eq!(page.get("/api/me", &cookie).status, 401);
}

/// A page of somebody else makes the browser send the cookie (were it not for SameSite): the change is refused.
#[test]
fn changes_that_another_page_makes_are_refused() {
    let page = Page::start();
    let cookie = format!("Cookie: {}", page.session(Role::Admin));
    let ours = "X-Volcomp: 1".to_owned();
    let origin = format!("Origin: http://{}", page.address);
    let post = |lines: &[String]| page.request("POST", "/api/alarms/1/seen", lines, "").status;
    assert_eq!(post(&[cookie.clone(), ours.clone(), origin.clone()]), 404);
    assert_eq!(
        post(&[cookie.clone(), ours.clone()]),
        404,
        "a program without a browser"
    );
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
    // Nor can another page ask for permission, or read: no answer allows another origin anything.
    let asked = page.request(
        "OPTIONS",
        "/api/machines",
        &["Origin: http://evil.example".to_owned()],
        "",
    );
    assert!(
        !asked.head.contains("access-control-allow"),
        "{}",
        asked.head
    );
    let host = "GET /api/me HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n";
    assert_eq!(page.raw(host.as_bytes()).status, 421);
}

#[test]
fn garbage_and_paths_are_refused() {
    let page = Page::start();
    let admin = page.session(Role::Admin);
    let lines = [format!("Cookie: {admin}"), "X-Volcomp: 1".to_owned()];
    for route in ROUTES.iter().filter(|route| route.method == "POST") {
        if ["/api/logout", "/api/login"].contains(&route.path) {
            continue;
        }
        let path = route.path.replace(['{', '}'], "");
        for body in [
            "",
            "{",
            "[]",
            "\u{0}",
            "{\"a\":1}",
            "null",
            "{\"subnets\":[\"8.8.8.8/8\"]}",
        ] {
            let answer = page.request("POST", &path, &lines, body);
            let refused = (400..500).contains(&answer.status);
            assert!(
                refused,
                "{path} {body:?}: {} {}",
                answer.status, answer.body
            );
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
        assert!(
            (400..500).contains(&answer.status),
            "{path}: {}",
            answer.status
        );
        assert!(!answer.body.contains("root:"), "{path}");
    }
    let large = "x".repeat(3 * 1024 * 1024);
    let refused = page.request("POST", "/api/models", &lines, &large).status;
    assert!(matches!(refused, 0 | 413), "{refused}");
    assert_eq!(page.get("/api/me", &admin).status, 200);
}

#[test]
fn the_page_loads_nothing_from_elsewhere_and_says_so() {
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
        part.starts_with('/')
            && [".js", ".css", ".svg"]
                .iter()
                .any(|end| part.ends_with(end))
    });
    let mut count = 0;
    for file in files {
        count += 1;
        assert_eq!(page.get(file, "").status, 200, "{file}");
    }
    assert!(count >= 9, "{count}");
    assert!(!html.body.contains("http://") && !html.body.contains("https://"));
}

/// The last admin stays one, and a user who loses a role loses the session.
#[test]
fn somebody_can_always_say_who_may_do_what() {
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
fn a_machine_is_registered_and_shown_with_what_is_not_known() {
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
    assert_eq!(row["state"], "never heard");
    assert_eq!(row["age_s"], serde_json::Value::Null);
    assert_eq!(row["residual_um"], serde_json::Value::Null);
    let deep = page.get("/api/machines/mill-1", &viewer).json();
    assert_eq!(
        (&deep["live"], &deep["silent"]),
        (&json!(null), &json!(true))
    );
    let history = page.get(
        "/api/machines/mill-1/history?resolution=raw&hours=1",
        &viewer,
    );
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
    // What was done stands in the audit log, with who and from where.
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
    assert!(
        beyond["model"]["notes"]
            .to_string()
            .contains("No guard corrects"),
        "{beyond}"
    );
    let sha = saved.json()["model"]["sha256"]
        .as_str()
        .expect("a checksum")
        .to_owned();
    let viewer = page.session(Role::Viewer);
    let model = page
        .get(&format!("/api/models/{}", &sha[..12]), &viewer)
        .json();
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
    let wish = json!({ "wish": "pause" });
    page.posts("/api/rollouts/1", &engineer, &wish, 200);
    page.posts("/api/rollouts/2", &engineer, &wish, 404);
    assert_eq!(
        page.get("/api/rollouts", &viewer).json()[0]["turns"][0]["machine"],
        "mill-1"
    );
}

/// A model can be taken out of the centre: byte by byte as it is signed, and as tables of a control.
#[test]
fn a_model_is_taken_away_as_it_is_signed_and_as_tables() {
    let page = Page::start();
    let text = "name = \"../a \\\"b\\\"\"\nstructure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 500.0]\n[axes.Y]\ntravel = [0.0, 400.0]\n[axes.Z]\ntravel = [0.0, 300.0]\n[errors]\n# a comment stays\nEXX = { poly = [0.0, 0.03] }\n";
    let new = NewModel::of_text(
        text.to_owned(),
        "m",
        Origin::File {
            name: String::new(),
        },
        "test",
    )
    .expect("a model");
    page.store.add_model(&new.model, &new.text).expect("stored");
    let viewer = page.session(Role::Viewer);
    let sha256 = &new.model.sha256;
    let file = page.get(&format!("/api/models/{sha256}/file"), &viewer);
    assert_eq!((file.status, file.body.as_str()), (200, text));
    let name = format!("filename=\"a--b-{}.toml\"", &sha256[..10]);
    assert!(file.head.contains(&name), "{}", file.head);
    let path = format!("/api/models/{sha256}/tables");
    let told = page
        .get(&format!("{path}?format=csv&step_mm=100"), &viewer)
        .json();
    assert!(
        told["trust"]
            .as_str()
            .is_some_and(|text| text.starts_with("Sign proven")),
        "{told}"
    );
    let name = told["files"][0].as_str().expect("a file").to_owned();
    let table = page.get(&format!("{path}/{name}?format=csv&step_mm=100"), &viewer);
    // 0.03 µm/mm of X are 15 µm at 500 mm.
    let row = (table.body.lines()).find_map(|line| line.strip_prefix("X,X,500,"));
    let told = row.and_then(|row| row.split(',').next()?.parse::<f64>().ok());
    assert!(
        told.is_some_and(|um| (um - 15.0).abs() < 0.01),
        "{}",
        table.body
    );
    // Every format that is offered has files.
    for format in page
        .get("/api/formats", &viewer)
        .json()
        .as_array()
        .expect("formats")
    {
        let format = format["format"].as_str().expect("a name");
        let told = page
            .get(&format!("{path}?format={format}&step_mm=50"), &viewer)
            .json();
        let files = told["files"].as_array().map_or(0, Vec::len);
        assert!(files > 0, "{format}: {told}");
    }
    let wrong = page.get(&format!("{path}?format=csv&step_mm=0"), &viewer);
    assert_eq!(wrong.status, 400);
    assert!(
        wrong.body.contains("Step along linear axes: found 0"),
        "{}",
        wrong.body
    );
    assert_eq!(page.get(&format!("{path}?format=dxf"), &viewer).status, 400);
    assert_eq!(
        page.get(&format!("{path}/other.csv?format=csv"), &viewer)
            .status,
        404
    );
}

/// The page and the alarm go by one rule: a calibration that was refused, or that waits for a person, renews no date. And the way
/// back, and the decision to keep a model, are refused where there is nothing to decide.
#[test]
fn a_refused_model_renews_no_date_on_the_page() {
    let page = Page::start();
    let engineer = page.session(Role::Engineer);
    let mut machine = crate::support::machine("mill-1");
    machine.due_days = Some(30);
    page.store.put_machine(&machine, "anna").expect("stored");
    let raw = rusqlite::Connection::open(page.folder.path().join("centre.db")).expect("open");
    let name = machine.identity.machine.clone();
    for (number, measured, outcome) in [
        (1_u32, "2020-01-01", Outcome::Activated),
        (2, "9999-01-01", Outcome::Refused { why: "no".into() }),
    ] {
        let mut new = crate::support::model(number);
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
    let body = json!({ "model": crate::support::model(1).model.sha256, "machines": ["mill-1"] });
    page.posts("/api/rollouts", &engineer, &body, 200);
    page.posts("/api/rollouts/1/keep", &engineer, &keep, 409);
}

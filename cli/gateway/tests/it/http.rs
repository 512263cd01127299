//! Responses and rejections of the dashboard.

use std::{
    io::{Read, Write},
    time::{Duration, Instant},
};

use crate::{
    manual::{Served, served_configuration},
    program::{OPERATE, Program, VIEW, answer, change},
};

fn simulated() -> (tempfile::TempDir, Served) {
    let dir = tempfile::tempdir().expect("writable");
    let gateway = Served::simulated(dir.path());
    (dir, gateway)
}

/// Checks page, state and event stream of the built-in simulation, also under a flood of requests.
pub(crate) fn the_simulation_lives(program: &Program) {
    let state = program.wait_for("compensating");
    assert_eq!(state["simulated"], true);
    for key in ["positions_mm", "correction_um"] {
        let axes: Vec<&String> = state[key].as_object().expect("an object").keys().collect();
        assert_eq!(axes, ["X", "Y", "Z"]);
    }
    assert_eq!(state["temperatures"][2]["name"], "spindle");
    assert_eq!(state["temperatures"][2]["quality"], "good");
    let later =
        program.wait(|later| later["positions_mm"] != state["positions_mm"]).expect("it moves");
    assert!(later["cycle"]["count"].as_u64() > state["cycle"]["count"].as_u64());
    assert!(later["cycle"]["p99_us"].as_f64() >= later["cycle"]["p50_us"].as_f64());
    let metrics = program.get("/metrics");
    assert!(metrics.body.contains("volcomp_state{state=\"compensating\"} 1"), "{}", metrics.body);
    assert!(metrics.body.contains("volcomp_correction_um{axis=\"X\"}"));
    let map = program.get("/api/map").json();
    assert_eq!(map["error_um"].as_array().map(Vec::len), Some(25));
    for page in ["/", "/common.js", "/app.js", "/plot.js", "/style.css", "/icon.svg"] {
        let page = program.get(page);
        assert_eq!(page.status, 200);
        assert!(page.head.contains("content-security-policy: default-src 'self'"));
    }
    assert_eq!(program.get("/nothing").status, 404);
    the_stream_tells_the_state_again_and_again(program);
    a_flood_does_not_touch_the_correction(program);
}

fn the_stream_tells_the_state_again_and_again(program: &Program) {
    let mut stream = program.connect();
    write!(stream, "GET /api/events HTTP/1.1\r\nHost: localhost\r\n\r\n").expect("sent");
    let mut text = String::new();
    let mut buffer = [0; 4096];
    while text.matches("event: state").count() < 5 {
        let count = stream.read(&mut buffer).expect("more");
        assert!(count > 0, "it ended: {text}");
        text += &String::from_utf8_lossy(&buffer[..count]);
    }
    assert!(text.contains("\"positions_mm\""));
}

#[test]
fn tokens_decide() {
    let (dir, program) = simulated();
    program.wait_for("compensating");
    let post = |path: &str, token: Option<&str>| program.request("POST", path, token, "").status;
    assert_eq!(post("/api/arm", None), 401);
    assert_eq!(post("/api/acknowledge", None), 401);
    assert_eq!(post("/api/disarm", Some("ffffffffffffffffffffffffffffffff")), 401);
    assert_eq!(post("/api/disarm", Some(VIEW)), 403);
    assert_eq!(program.request("GET", "/api/disarm", Some(OPERATE), "").status, 405);
    assert_eq!(program.state()["state"], "compensating");
    assert_eq!(post("/api/disarm", Some(OPERATE)), 200);
    program.wait_for("disarmed");
    let armed = program.post("/api/arm", "");
    assert_eq!((armed.status, &armed.json()["state"]), (200, &"arming".into()));
    assert_eq!(program.post("/api/arm", "no json").status, 400);
    let audit = std::fs::read_to_string(dir.path().join("audit/audit.log")).expect("a log");
    assert!(audit.contains("\"who\":\"anna\",\"what\":\"disarm\""));
    assert!(!audit.contains(OPERATE));
    // The page checks a token when the operator enters it, not only when it is needed.
    for (token, status, role) in
        [(Some(OPERATE), 200, Some("operate")), (Some(VIEW), 200, Some("view")), (None, 401, None)]
    {
        let answer = program.request("GET", "/api/token", token, "");
        assert_eq!(answer.status, status, "{token:?}");
        assert_eq!(answer.json()["role"].as_str(), role, "{token:?}");
        assert!(!answer.body.contains(OPERATE), "never the token itself");
    }
    // Four more wrong tokens block this address for a minute.
    for _ in 0..4 {
        assert_eq!(post("/api/disarm", Some("wrong")), 401);
    }
    assert_eq!(post("/api/disarm", Some("wrong")), 429);
    // The correct token is accepted even from a blocked address.
    assert_eq!(post("/api/disarm", Some(OPERATE)), 200);
    assert_eq!(post("/api/disarm", Some("wrong")), 429);
    assert_eq!(program.get("/api/state").status, 200);
    program.gateway().run(Duration::from_secs(60));
    assert_eq!(post("/api/disarm", Some("wrong")), 401, "a minute later");
}

/// Clients that never read a page or send half a request do not occupy every connection. A disarm is answered within 4
/// s.
#[test]
fn hanging_clients_do_not_prevent_disarming() {
    let (_dir, program) = simulated();
    program.wait_for("compensating");
    let requests = "GET /app.js HTTP/1.1\r\nHost: localhost\r\n\r\n".repeat(200);
    let mut clients = Vec::new();
    for number in 0..100 {
        let mut client = program.connect();
        let bytes = if number % 2 == 0 { requests.as_bytes() } else { b"GET / HT" };
        client.set_nonblocking(true).expect("a socket");
        let _ = client.write(bytes);
        clients.push(client);
    }
    let begun = Instant::now();
    assert_eq!(program.post("/api/disarm", "").status, 200);
    let took = begun.elapsed();
    assert!(took < Duration::from_secs(4), "{took:?}");
    program.wait_for("disarmed");
}

/// At the gateway's own computer disarming needs no token. A page of another origin in a browser there cannot disarm.
#[test]
fn at_its_own_computer_disarming_needs_no_token() {
    for has_tokens in [true, false] {
        let dir = tempfile::tempdir().expect("writable");
        let audit = dir.path().join("audit");
        let config = served_configuration(dir.path(), "auto_arm = true");
        if !has_tokens {
            change(&config, "token_file = \"tokens\"\n", "");
        }
        let program = Served::start(&config);
        program.wait_for("compensating");
        let disarm = |host: &str, headers: &str| {
            let head = format!("POST /api/disarm HTTP/1.1\r\nHost: {host}\r\n{headers}");
            let text = format!("{head}Content-Length: 0\r\nConnection: close\r\n\r\n");
            answer(&program.raw(text.as_bytes())).status
        };
        let own = program.address.to_string();
        let foreign = [
            "http://evil.example",
            "https://localhost",
            "http://127.0.0.1:1",
            "null",
            "",
            "http://evil.example/127.0.0.1",
        ];
        for origin in foreign {
            let status = disarm(&own, &format!("Origin: {origin}\r\n"));
            assert_eq!(status, 403, "{origin}");
        }
        // DNS rebinding: a foreign host name that resolves to this address.
        let rebound = disarm("evil.example", "Origin: http://evil.example\r\n");
        assert_eq!(rebound, 421);
        assert_eq!(program.state()["state"], "compensating");
        assert_eq!(disarm(&own, &format!("Origin: http://{own}\r\n")), 200);
        program.wait_for("disarmed");
        assert_eq!(disarm(&own, ""), 200);
        let log = std::fs::read_to_string(audit.join("audit.log")).expect("a log");
        let record = "\"who\":\"local user without a token\",\"what\":\"disarm\"";
        assert!(log.contains(record), "{log}");
        // Without configured tokens no client may operate.
        for path in ["/api/arm", "/api/disarm", "/api/acknowledge", "/api/reload"] {
            let status = program.request("POST", path, Some(OPERATE), "").status;
            assert_eq!(status == 404, !has_tokens, "{path}: {status}");
        }
    }
}

#[test]
fn foreign_hosts_and_broken_requests_are_refused() {
    let (_dir, program) = simulated();
    let raw = |text: &str| answer(&program.raw(text.as_bytes())).status;
    assert_eq!(
        raw("GET /api/state HTTP/1.1\r\nHost: evil.example\r\nConnection: close\r\n\r\n"),
        421
    );
    assert_eq!(raw("GET /api/state HTTP/1.1\r\nConnection: close\r\n\r\n"), 400);
    assert_eq!(
        raw("GET /api/state HTTP/1.1\r\nHost: localhost:1\r\nConnection: close\r\n\r\n"),
        200
    );
    for garbage in [
        "\0\0\0\0\r\n\r\n",
        "GET\r\n\r\n",
        "BREW / HTTP/9.9\r\n\r\n",
        "GET / HTTP/1.1\r\nHost : x\r\n\r\n",
        "\x16\x03\x01\x02\x00\x01\r\n\r\n",
    ] {
        assert!(matches!(raw(garbage), 0 | 400 | 505), "{garbage:?}");
    }
    let headers = "X-Long: ".to_owned() + &"a".repeat(200_000);
    assert!(matches!(
        raw(&format!("GET / HTTP/1.1\r\nHost: localhost\r\n{headers}\r\n\r\n")),
        0 | 400 | 431
    ));
    let many = "X: y\r\n".repeat(500);
    assert!(matches!(
        raw(&format!("GET / HTTP/1.1\r\nHost: localhost\r\n{many}\r\n")),
        0 | 400 | 431
    ));
    let body = "a".repeat(70_000);
    assert_eq!(program.post("/api/arm", &body).status, 413);
    assert_eq!(program.get("/api/state").status, 200);
    program.wait_for("compensating");
}

#[test]
fn slow_and_many_connections_are_bounded() {
    let (_dir, program) = simulated();
    let begun = Instant::now();
    // 70 clients with endless headers, more than the server serves at a time.
    let mut slow: Vec<_> = (0..70)
        .map(|_| {
            let mut stream = program.connect();
            let _ = stream.write_all(b"GET / HTTP/1.1\r\nHost: local");
            stream
        })
        .collect();
    // At the header timeout the slow clients are disconnected, and other clients are served.
    assert_eq!(program.get("/api/state").status, 200);
    assert!(begun.elapsed() < Duration::from_secs(15));
    let mut rest = Vec::new();
    let _ = slow[0].read_to_end(&mut rest);
    assert!(rest.is_empty() || rest.starts_with(b"HTTP/1.1 408"), "{rest:?}");
    drop(slow);
    let streams: Vec<_> = (0..17)
        .map(|_| {
            let mut stream = program.connect();
            write!(stream, "GET /api/events HTTP/1.1\r\nHost: localhost\r\n\r\n").expect("sent");
            let mut start = [0; 12];
            stream.read_exact(&mut start).expect("an answer");
            (String::from_utf8_lossy(&start).into_owned(), stream)
        })
        .collect();
    let served = streams.iter().filter(|(start, _)| start.ends_with("200")).count();
    assert_eq!(served, 16);
    assert!(streams.iter().any(|(start, _)| start.ends_with("503")));
}

/// 10 000 requests over persistent connections as fast as possible. The correction continues.
fn a_flood_does_not_touch_the_correction(program: &Program) {
    let before = program.state()["cycle"].clone();
    std::thread::scope(|scope| {
        for _ in 0..8 {
            scope.spawn(|| {
                let mut stream = program.connect();
                let mut buffer = vec![0; 1 << 16];
                for _ in 0..300 {
                    write!(stream, "GET /api/state HTTP/1.1\r\nHost: localhost\r\n\r\n")
                        .expect("sent");
                    // Reads one response: the head contains the length of the body.
                    let mut text = String::new();
                    loop {
                        let count = stream.read(&mut buffer).expect("an answer");
                        assert!(count > 0);
                        text += &String::from_utf8_lossy(&buffer[..count]);
                        if is_whole(&text) {
                            break;
                        }
                    }
                    assert!(text.starts_with("HTTP/1.1 200"));
                }
            });
        }
    });
    assert_eq!(program.state()["armed"], true);
    // One late cycle on a busy computer is tolerated.
    let state = program.wait_for("compensating");
    assert!(state["cycle"]["count"].as_u64() > before["count"].as_u64());
}

fn is_whole(text: &str) -> bool {
    let Some((head, body)) = text.split_once("\r\n\r\n") else {
        return false;
    };
    let lower = head.to_ascii_lowercase();
    let length = lower.lines().find_map(|line| line.strip_prefix("content-length: ")?.parse().ok());
    length.is_some_and(|length: usize| body.len() >= length)
}

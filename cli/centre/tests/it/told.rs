//! What the page is told: a history over its whole span, rules as they are configured; and how often a password is looked at.

use serde_json::json;
use volcomp_centre::{clock::now_s, http::PageSettings, rollout::Rules, users::Role};
use volcomp_fleet::Kind;
use volcomp_test_support::until;

use crate::{
    page::Page,
    shop::LONG,
    support::{condition, envelope, machine, model, received, tell},
};

/// More conditions than are told at once: the points span all of them, each condition is in one, and the newest is among them.
#[test]
fn a_long_history_is_told_over_its_whole_span() {
    const COUNT: u32 = 7000;
    let page = Page::start();
    // They end a little before now, so that none of them falls out of the two hours while the test runs.
    let from_s = now_s().floor() - 7100.0;
    let batch: Vec<_> = (1..=COUNT)
        .map(|number| {
            let told = envelope("a", number.into(), condition(1.0));
            let at_s = from_s + f64::from(number);
            received("mill-1", Kind::Condition, number.into(), at_s, &told)
        })
        .collect();
    tell(&page.store, &batch);
    page.store.close_minutes(now_s()).expect("stored");
    let viewer = page.session(Role::Viewer);
    let path = "/api/machines/mill-1/history?resolution=raw&hours=2";
    let told = page.get(path, &viewer).json();
    let points = told["points"].as_array().expect("a list");
    assert!((1000..=2000).contains(&points.len()), "{}", points.len());
    let number = |point: &serde_json::Value, key: &str| point[key].as_f64().expect("a number");
    let counted: f64 = points.iter().map(|point| number(point, "count")).sum();
    assert_eq!(counted, f64::from(COUNT));
    let together = number(&told, "together");
    let [first, last] = [points.first(), points.last()].map(|point| number(point.unwrap(), "at_s"));
    assert_eq!(first, from_s + 1.0);
    assert!(last > from_s + f64::from(COUNT) - together, "{last}");
}

/// A roll-out that states no rules goes by those of the configuration, which the page shows, and rules that make no sense start
/// none.
#[test]
fn a_roll_out_from_the_page_goes_by_the_rules_of_the_configuration() {
    let rules = Rules {
        soak_s: 42.0,
        waves: vec![10, 100],
        ..Rules::default()
    };
    let page = Page::start_with(PageSettings {
        rules: rules.clone(),
        ..PageSettings::default()
    });
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
        assert!(
            answer.body.contains(&format!("rules.{key}: found")),
            "{}",
            answer.body
        );
    }
    start["rules"] = json!(null);
    page.posts("/api/rollouts", &engineer, &start, 200);
    assert_eq!(page.store.rollouts(1).expect("a store")[0].rules, rules);
}

/// Requests that come at one time are no way around the limit: one more than the limit may be under way beside the last.
#[test]
fn wrong_passwords_that_come_at_one_time_are_counted() {
    let page = Page::start();
    let body = json!({ "name": "admin", "password": "wrong" });
    let statuses: Vec<u16> = std::thread::scope(|scope| {
        let asked: Vec<_> = (0..20)
            .map(|_| scope.spawn(|| page.post("/api/login", "", &body).status))
            .collect();
        asked.into_iter().map(|one| one.join().unwrap()).collect()
    });
    let looked_at = statuses.iter().filter(|status| **status == 401).count();
    let turned_away = statuses.iter().filter(|status| **status == 429).count();
    // Five at once, one beside the fifth, and the two that may wait for their delay.
    assert!((7..=8).contains(&looked_at), "{statuses:?}");
    assert_eq!(looked_at + turned_away, statuses.len(), "{statuses:?}");
}

/// A machine was cut off for an hour. Now it is connected again and sends what waited: audit records first, then conditions one after the
/// other: one of an hour ago is no one of this second. An audit record that comes makes no condition younger.
#[test]
fn a_condition_of_an_hour_ago_is_not_told_as_one_of_now() {
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
        // Made a second later, and an hour on the disk of the gateway.
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

/// The database cannot be read any more (another program, a disk that fails): what was told last is not told as what holds now.
#[test]
fn an_overview_that_cannot_be_made_is_not_told_as_of_now() {
    let page = Page::start();
    page.store.put_machine(&machine("mill-a"), "anna").unwrap();
    let one = envelope("a", 1, condition(4.0));
    let one = received("mill-a", Kind::Condition, 1, now_s(), &one);
    tell(&page.store, &[one]);
    let cookie = page.session(Role::Viewer);
    page.overview(&cookie);
    let raw = rusqlite::Connection::open(page.folder.path().join("centre.db")).unwrap();
    raw.execute_batch("ALTER TABLE live RENAME TO gone")
        .unwrap();
    let mut answer = page.get("/api/overview", &cookie);
    until("it is not told any more", LONG, || {
        answer = page.get("/api/overview", &cookie);
        answer.status != 200
    });
    assert_eq!(answer.status, 503, "{}", answer.body);
    let why = answer.json()["error"].as_str().unwrap().to_owned();
    assert!(why.contains("could not look at its machines for"), "{why}");
    raw.execute_batch("ALTER TABLE gone RENAME TO live")
        .unwrap();
    let told = page.overview(&cookie);
    let made_s = told["made_s"].as_f64().unwrap();
    assert!((now_s() - made_s).abs() < 5.0, "{made_s}");
}

/// Whole states and records are kept as they came. A number that no reader takes must not close the page of the machine.
#[test]
fn a_document_that_cannot_be_read_back_does_not_close_the_page_of_its_machine() {
    for (kind, body) in [
        (Kind::Telemetry, "1e999"),
        (Kind::Audit, "{\"checksum\":\"\",\"record\":\"\\ud800\"}"),
    ] {
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

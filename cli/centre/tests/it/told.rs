//! What the page is told: a history over its whole span, rules as they are configured; and how often a password is looked at.

use serde_json::json;
use volcomp_centre::{
    clock::now_s, http::FaceSettings, ingest::Ingest, rollout::Rules, users::Role,
};
use volcomp_fleet::Kind;

use crate::{
    page::Page,
    support::{condition, envelope, machine, model, received},
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
    let mut ingest = Ingest::of(&page.store).expect("a store");
    ingest.take(&page.store, &batch).expect("stored");
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
    let page = Page::start_with(FaceSettings {
        rules: rules.clone(),
        ..FaceSettings::default()
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
        let answer = page.post("/api/rollouts", &engineer, &start);
        assert_eq!(answer.status, 400, "{start}: {}", answer.body);
        assert!(
            answer.body.contains(&format!("rules.{key}: found")),
            "{}",
            answer.body
        );
    }
    start["rules"] = json!(null);
    let started = page.post("/api/rollouts", &engineer, &start);
    assert_eq!(started.status, 200, "{}", started.body);
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
    assert!((5..=6).contains(&looked_at), "{statuses:?}");
    assert_eq!(looked_at + turned_away, statuses.len(), "{statuses:?}");
}

//! The network between a machine and its centre is cut. Each side is in a separate network namespace, connected by a
//! pair of virtual cards. The frames of one or both directions are lost without an error, as with a failing switch.
//!
//! Each test starts itself again in the namespace of the site. The centre, its server and its page are started in the
//! other namespace. Namespaces and cards end with the programs in them.

use std::{
    collections::BTreeSet,
    process::{Command, Output},
    time::{Duration, Instant},
};

use serde_json::Value;
use volcomp_test_support::{Running, peers, until};
use volcomp_vocabulary::PerChannel;

use crate::{
    fleet_bench::{compensating, corrects_y, goes_on, wait},
    fleet_whole_bench::{LONG, Place, Whole, machine_text},
    manual::{no_step, says},
    program::{Client, MACHINE},
};

/// Set if this program runs inside the namespace of the site.
const INSIDE: &str = "VOLCOMP_TEST_SITE";
const SITE: &str = "10.77.0.2";
const CENTRE: &str = "10.77.0.1";
/// A MAC address of no interface, so that frames to it are lost.
const ABSENT_MAC: &str = "02:00:00:00:00:99";
/// Server settings. The server disconnects a gateway that is silent for three seconds; the gateway drops a dead
/// connection within 30 s.
const SHORT: &str = "ping_interval: \"1s\"\nping_max: 2\nwrite_deadline: \"2s\"\n";

/// The direction in which frames are lost.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Lost {
    Everything,
    ToTheCentre,
    ToTheSite,
}

/// The namespaces of centre and site. This program runs in the namespace of the site.
struct Network {
    /// A process that keeps the centre's namespace alive.
    holder: Running,
}

impl Network {
    fn new() -> Self {
        let mut holder = Command::new("unshare");
        holder.args(["--net", "sh", "-c", "echo ready; exec sleep 600"]);
        let network = Self { holder: Running::start_ready(&mut holder) };
        let id = network.holder.id().to_string();
        ip(&["link", "add", "site", "type", "veth", "peer", "name", "centre", "netns", &id]);
        ip(&["addr", "add", &format!("{SITE}/30"), "dev", "site"]);
        ip(&["link", "set", "site", "up"]);
        network.at_centre(&["addr", "add", &format!("{CENTRE}/30"), "dev", "centre"]);
        for card in ["lo", "centre"] {
            network.at_centre(&["link", "set", card, "up"]);
        }
        network
    }

    fn namespace(&self) -> String {
        format!("--net=/proc/{}/ns/net", self.holder.id())
    }

    fn at_centre(&self, words: &[&str]) {
        let mut command = Command::new("nsenter");
        command.args([&self.namespace(), "ip"]).args(words);
        done(&mut command);
    }

    fn place(&self) -> Place {
        let through = ["nsenter", &self.namespace()];
        Place::elsewhere(&through, [&format!("{CENTRE}:4222"), "127.0.0.1:8460"], SHORT)
    }

    fn cut(&self, lost: Lost) {
        let to = ["lladdr", ABSENT_MAC, "nud", "permanent"];
        if lost != Lost::ToTheSite {
            ip(&[&["neigh", "replace", CENTRE, "dev", "site"], &to[..]].concat());
        }
        if lost != Lost::ToTheCentre {
            self.at_centre(&[&["neigh", "replace", SITE, "dev", "centre"], &to[..]].concat());
        }
    }

    fn heal(&self, lost: Lost) {
        if lost != Lost::ToTheSite {
            ip(&["neigh", "del", CENTRE, "dev", "site"]);
        }
        if lost != Lost::ToTheCentre {
            self.at_centre(&["neigh", "del", SITE, "dev", "centre"]);
        }
    }
}

fn ip(words: &[&str]) {
    done(Command::new("ip").args(words));
}

fn done(command: &mut Command) {
    let status = command.status();
    assert!(status.is_ok_and(|status| status.success()), "{command:?}");
}

/// The command that starts a program in a new network namespace; `None` if none of the candidates works.
fn into_namespace() -> Option<&'static [&'static str]> {
    const WAYS: [&[&str]; 3] = [
        &["unshare", "--net"],
        &["unshare", "--user", "--map-root-user", "--net"],
        &["sudo", "-n", "-E", "unshare", "--net"],
    ];
    // The command must permit creating virtual cards and entering another namespace.
    let probe =
        "ip link add site type veth peer name centre && nsenter --net=/proc/self/ns/net true";
    WAYS.into_iter().find(|way| {
        let tried = Command::new(way[0]).args(&way[1..]).args(["sh", "-c", probe]).output();
        tried.is_ok_and(|tried| tried.status.success())
    })
}

/// Runs a test in a separate network namespace.
fn at_site(name: &str, work: impl FnOnce()) {
    if std::env::var_os(INSIDE).is_some() {
        ip(&["link", "set", "lo", "up"]);
        return work();
    }
    if volcomp_fleet::server::program().is_none() {
        return peers::not_run("nats-server");
    }
    let Some(way) = into_namespace() else {
        return peers::not_run(
            "the right to make network namespaces (root, user namespaces or sudo -n), or ip of iproute2,",
        );
    };
    let mut command = Command::new(way[0]);
    command
        .args(&way[1..])
        .arg(std::env::current_exe().expect("this program"))
        .args(["--exact", &format!("fleet_partition::{name}"), "--nocapture"])
        .env(INSIDE, "1");
    let Output { status, stdout, stderr } = command.output().expect("just tried");
    let [out, error] = [stdout, stderr].map(|text| String::from_utf8_lossy(&text).into_owned());
    println!("{out}\n{error}");
    assert!(status.success() && out.contains("1 passed"), "{status}");
}

#[test]
fn everything_is_lost() {
    at_site("everything_is_lost", || partition(Lost::Everything));
}

/// Frames to the centre are lost. The site receives, but its messages do not arrive.
#[test]
fn what_goes_to_the_centre_is_lost() {
    at_site("what_goes_to_the_centre_is_lost", || {
        partition(Lost::ToTheCentre);
    });
}

/// Frames to the site are lost. Its messages arrive, but no acknowledgement returns.
#[test]
fn what_goes_to_the_site_is_lost() {
    at_site("what_goes_to_the_site_is_lost", || {
        partition(Lost::ToTheSite);
    });
}

/// During the partition the gateway corrects without a step. Afterwards its messages arrive, each once, and an order
/// given in between is executed.
fn partition(lost: Lost) {
    let network = Network::new();
    let whole = Whole::start_at(network.place(), &[("mill-1", "4711", MACHINE)]);
    let whole = whole.expect("its server is there");
    let dir = tempfile::tempdir().expect("writable");
    let config = whole.member(dir.path(), ("mill-1", "4711"));
    let program = compensating(&config);
    let rollout = whole.roll_out(&machine_text("small", 25.0), &["mill-1"]);
    whole.is_in(rollout, "done");
    corrects_y(&program, -25.0);

    network.cut(lost);
    let cut = Instant::now();
    alone(&whole, &program);
    println!("cut for {:.1} s", cut.elapsed().as_secs_f64());
    network.heal(lost);
    let state = program.wait_for("disarmed");
    assert!(says(&state, "disabled by the centre"), "{state}");
    wait(&program, "it is ramped out", |_| program.gateway().shifts() == PerChannel::ZERO);
    comes_later(&whole, &program, dir.path(), cut.elapsed());

    whole.done("machine enable mill-1");
    // An operator disarmed the machine, so an operator must arm it.
    wait(&program, "it may be armed", |state| !says(state, "disabled by the centre"));
    program.must_arm();
    program.wait_for("compensating");
    corrects_y(&program, -25.0);
    no_step(&program.stop());
}

/// Checks the behaviour of gateway and centre during the partition.
fn alone(whole: &Whole, program: &Client) {
    wait(program, "the gateway notices", |state| {
        goes_on(state, -25.0);
        state["fleet"]["connected"] == false
    });
    whole.wait("the centre notices", "alarms --json", |alarms| {
        let mut alarms = alarms.as_array().expect("a list").iter();
        alarms.any(|alarm| alarm["kind"] == "silent" && alarm["machine"] == "mill-1")
    });
    // One audit record and one order arise during the partition.
    assert_eq!(program.post("/api/disarm", "").status, 200);
    program.wait_for("disarmed");
    program.must_arm();
    program.wait_for("compensating");
    corrects_y(program, -25.0);
    whole.done("machine disable mill-1");
    let before = program.state()["uptime_s"].as_f64().expect("a time");
    wait(program, "it goes on for some seconds", |state| {
        goes_on(state, -25.0);
        assert_eq!(state["fleet"]["version"], 1, "{state}");
        state["uptime_s"].as_f64() > Some(before + 4.0)
    });
    let cookie = whole.log_in();
    let page = whole.page(&cookie, "/api/machines/mill-1");
    assert_eq!(page["silent"], true, "{page}");
}

/// Checks that every message of the partition arrives afterwards, once.
fn comes_later(whole: &Whole, program: &Client, dir: &std::path::Path, cut: Duration) {
    whole.machine_is("its state is reported", "mill-1", |one| {
        one["enable"] == false && one["live"]["condition"]["state"] == "disarmed"
    });
    let cookie = whole.log_in();
    // Every audit record arrives once.
    until("its audit log is there", LONG, || {
        let page = whole.page(&cookie, "/api/machines/mill-1");
        let records = page["records"].as_array().expect("a list").iter();
        let stored: Vec<String> = records
            .filter_map(|record| record["record"]["body"]["checksum"].as_str())
            .map(str::to_owned)
            .collect();
        let once: BTreeSet<&String> = stored.iter().collect();
        assert_eq!(once.len(), stored.len(), "twice: {stored:?}");
        let log = std::fs::read_to_string(dir.join("audit/audit.log")).expect("a log");
        log.lines().all(|line| {
            let checksum = line.split(' ').next().expect("a word");
            stored.iter().any(|one| one == checksum)
        })
    });
    // Conditions are sent once per second, even during the partition.
    until("its conditions are there", LONG, || {
        let history = "/api/machines/mill-1/history?resolution=raw&hours=1";
        let history = whole.page(&cookie, history);
        let points = history["points"].as_array().expect("a list");
        let times: Vec<f64> = points.iter().filter_map(|point| point["at_s"].as_f64()).collect();
        let gap = times.windows(2).map(|pair| pair[1] - pair[0]).fold(0.0, f64::max);
        times.len() as f64 > cut.as_secs_f64() && gap < 6.0
    });
    let one = whole.machine("mill-1");
    assert_eq!(one["live"]["lost"], 0, "{one}");
    assert_eq!(program.state()["fleet"]["dropped"], 0);
    let alarms = whole.document("alarms --all --json");
    let alarms = alarms.as_array().expect("a list");
    let has = |kind: &str| alarms.iter().any(|alarm: &Value| alarm["kind"] == kind);
    assert!(!has("gap") && !has("clone") && !has("unreadable"), "{alarms:?}");
}

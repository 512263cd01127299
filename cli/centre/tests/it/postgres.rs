//! What can happen to a PostgreSQL server, to the way to it, and to a change that is under way.

use std::{
    io::{Read, Write},
    net::{TcpListener, TcpStream},
    os::unix::{fs::PermissionsExt, net::UnixStream},
    sync::{
        Arc,
        atomic::{AtomicU8, Ordering},
    },
    time::Duration,
};

use volcomp_centre::{
    ingest::Ingest,
    records::{AlarmKind, Resolution},
    rollout::{Phase, Rules},
    store::{PostgresPlace, Store, StoreError},
};
use volcomp_fleet::{Kind, Received};
use volcomp_test_support::until;

use crate::{
    cluster::{Cluster, ROLE},
    command::call,
    gateway::{self, Told},
    shop::{LONG, Shop, runtime},
    support::{condition, envelope, identity, machine, received, rollout},
};

/// A cluster of its own; `None` where PostgreSQL is not installed, which fails under CI.
fn cluster(settings: &[&str]) -> Option<Cluster> {
    let cluster = Cluster::new(settings);
    if cluster.is_none() {
        volcomp_test_support::peers::not_run("postgresql is not installed");
    }
    cluster
}

fn open(connection: &str) -> Result<Store, StoreError> {
    Store::open_postgres(&PostgresPlace::of(connection, None, None).unwrap())
}

fn conditions(numbers: std::ops::Range<u64>) -> Vec<Received> {
    let one = |number: u64| {
        let envelope = envelope("run-1", number, condition(1.0));
        let at_s = 1_800_000_000.0 + number as f64;
        received("mill-a", Kind::Condition, number + 1, at_s, &envelope)
    };
    numbers.map(one).collect()
}

fn stored(store: &Store) -> usize {
    let mill = identity("mill-a").machine;
    let points = store.history(&mill, Resolution::Raw, 0.0, 2e9, 100_000);
    points.unwrap().len()
}

#[test]
fn a_restart_of_the_server_is_not_noticed() {
    let Some(cluster) = cluster(&[]) else { return };
    let store = open(&cluster.connection(&cluster.database())).unwrap();
    let mut ingest = Ingest::of(&store).unwrap();
    for round in 0..3_u64 {
        // Statements of both connections are ready on the server, and are not any more.
        store
            .put_machine(&machine(&format!("mill-{round}")), "anna")
            .unwrap();
        assert_eq!(store.machines().unwrap().len() as u64, round + 1);
        ingest
            .take(&store, &conditions(round * 10..round * 10 + 10))
            .unwrap();
        cluster.crash();
        cluster.start();
        assert_eq!(store.machines().unwrap().len() as u64, round + 1);
    }
    assert_eq!(stored(&store), 30);
    assert_eq!(store.broken_audit().unwrap(), None);
}

#[test]
fn while_the_server_is_away_it_is_named_and_nothing_is_taken() {
    let Some(cluster) = cluster(&[]) else { return };
    let connection = cluster.connection(&cluster.database());
    let store = open(&connection).unwrap();
    let mut ingest = Ingest::of(&store).unwrap();
    cluster.crash();
    let folder = cluster.socket().display().to_string();
    for told in [
        store.machines().unwrap_err(),
        store.put_machine(&machine("mill-a"), "anna").unwrap_err(),
        ingest.take(&store, &conditions(0..10)).unwrap_err(),
        open(&connection).err().unwrap(),
    ] {
        let told = told.to_string();
        assert!(
            told.contains(&folder)
                && told.contains("port 5432")
                && told.contains("expected a running server"),
            "{told}"
        );
    }
    cluster.start();
    assert_eq!(ingest.take(&store, &conditions(0..10)).unwrap().stored, 10);
    assert_eq!(store.machines().unwrap(), []);
}

/// The server crashes between two statements of a transaction: nothing of it is there, and it is said.
#[test]
fn a_change_that_is_lost_in_the_middle_is_lost_whole() {
    let Some(cluster) = cluster(&[]) else { return };
    let store = open(&cluster.connection(&cluster.database())).unwrap();
    let start = |in_the_middle: &dyn Fn()| {
        store.start_rollout(|id| {
            in_the_middle();
            rollout(id)
        })
    };
    start(&|| {}).unwrap();
    for back in [true, false] {
        let lost = start(&|| {
            cluster.crash();
            if back {
                cluster.start();
            }
        });
        assert!(matches!(lost, Err(StoreError::Postgres { .. })), "{lost:?}");
        if !back {
            cluster.start();
        }
        assert_eq!(store.rollouts(10).unwrap().len(), 1);
        assert_eq!(store.audit_records(None, 10).unwrap().len(), 1);
    }
    assert_eq!(start(&|| {}).unwrap().id, 2);
    assert_eq!(store.broken_audit().unwrap(), None);
}

/// What a commit was told to be is there after a crash that follows at once, although the database would have it later.
#[test]
fn what_is_committed_is_on_disk() {
    let Some(cluster) = cluster(&["wal_writer_delay=10s"]) else {
        return;
    };
    let name = cluster.database();
    let sql = format!("ALTER DATABASE {name} SET synchronous_commit = off");
    cluster.execute("postgres", &sql);
    let store = open(&cluster.connection(&name)).unwrap();
    for number in 0..5 {
        store
            .put_machine(&machine(&format!("mill-{number}")), "anna")
            .unwrap();
        cluster.crash();
        cluster.start();
        assert_eq!(store.machines().unwrap().len(), number + 1);
    }
}

/// What the wire does with the commit that comes next.
const PASS: u8 = 0;
/// The connection breaks before it reaches the server.
const LOSE_COMMIT: u8 = 1;
/// The connection breaks before the answer comes back.
const LOSE_ANSWER: u8 = 2;

/// A wire to the server that breaks at a commit.
struct Wire {
    address: std::net::SocketAddr,
    next: Arc<AtomicU8>,
}

impl Wire {
    fn to(cluster: &Cluster) -> Self {
        let listener = TcpListener::bind("127.0.0.1:0").unwrap();
        let address = listener.local_addr().unwrap();
        let next = Arc::new(AtomicU8::new(PASS));
        let (of_thread, socket) = (Arc::clone(&next), cluster.socket().join(".s.PGSQL.5432"));
        std::thread::spawn(move || {
            while let Ok((near, _)) = listener.accept() {
                let Ok(far) = UnixStream::connect(&socket) else {
                    continue;
                };
                let next = Arc::clone(&of_thread);
                std::thread::spawn(move || pass(near, far, &next));
            }
        });
        Self { address, next }
    }

    fn connection(&self, database: &str) -> String {
        let (ip, port) = (self.address.ip(), self.address.port());
        format!("host={ip} port={port} user={ROLE} dbname={database}")
    }
}

fn pass(mut near: TcpStream, mut far: UnixStream, next: &AtomicU8) {
    let (mut back_from, mut back_to) = (far.try_clone().unwrap(), near.try_clone().unwrap());
    let losing = Arc::new(AtomicU8::new(PASS));
    let of_thread = Arc::clone(&losing);
    let back = std::thread::spawn(move || {
        let mut bytes = [0; 8192];
        while let Ok(count @ 1..) = back_from.read(&mut bytes) {
            if of_thread.load(Ordering::SeqCst) == LOSE_ANSWER {
                // The answer is here: it is done.
                let _ = back_to.shutdown(std::net::Shutdown::Both);
                return;
            }
            if back_to.write_all(&bytes[..count]).is_err() {
                return;
            }
        }
        let _ = back_to.shutdown(std::net::Shutdown::Both);
    });
    let mut bytes = [0; 8192];
    while let Ok(count @ 1..) = near.read(&mut bytes) {
        // A statement without parameters is a message of its own.
        let commit = bytes[..count]
            .windows(7)
            .any(|window| window == b"COMMIT\0");
        let lose = if commit {
            next.swap(PASS, Ordering::SeqCst)
        } else {
            PASS
        };
        if lose == LOSE_COMMIT {
            break;
        }
        losing.store(lose, Ordering::SeqCst);
        if far.write_all(&bytes[..count]).is_err() {
            break;
        }
    }
    let _ = near.shutdown(std::net::Shutdown::Both);
    if losing.load(Ordering::SeqCst) != LOSE_ANSWER {
        let _ = far.shutdown(std::net::Shutdown::Both);
    }
    let _ = back.join();
}

/// The connection breaks at the commit of a batch, before or after the server has done it: the batch comes again, and each of
/// its messages is stored once.
#[test]
fn a_commit_in_doubt_is_stored_once() {
    let Some(cluster) = cluster(&[]) else { return };
    let wire = Wire::to(&cluster);
    let store = open(&wire.connection(&cluster.database())).unwrap();
    let mut ingest = Ingest::of(&store).unwrap();
    let mut from = 0;
    for (lose, stored_before) in [
        (LOSE_ANSWER, true),
        (LOSE_COMMIT, false),
        (LOSE_ANSWER, true),
    ] {
        let mut batch = conditions(from..from + 100);
        let answer = volcomp_fleet::Acknowledgement {
            version: 1,
            value_sha256: "00".to_owned(),
            outcome: volcomp_fleet::Outcome::Activated,
        };
        let answer = envelope("run-1", from + 100, answer);
        batch.push(received("mill-a", Kind::Ack, from + 101, 1.8e9, &answer));
        wire.next.store(lose, Ordering::SeqCst);
        let told = ingest.take(&store, &batch).unwrap_err();
        assert!(matches!(told, StoreError::InDoubt { .. }), "{told}");
        let taken = ingest.take(&store, &batch).unwrap();
        let expected = if stored_before { (0, 101) } else { (101, 0) };
        assert_eq!((taken.stored, taken.twice), expected);
        assert_eq!(taken.answers.len(), 1, "a roll-out has not heard of it yet");
        from += 101;
        assert_eq!(stored(&store) as u64, from / 101 * 100);
    }
    // Of people's changes it is said.
    wire.next.store(LOSE_ANSWER, Ordering::SeqCst);
    let told = store.put_machine(&machine("mill-b"), "anna").unwrap_err();
    assert!(
        told.to_string().contains("look before it is made again"),
        "{told}"
    );
    assert_eq!(store.machines().unwrap().len(), 1);
    assert_eq!(store.broken_audit().unwrap(), None);
}

#[test]
fn a_database_of_another_encoding_is_refused() {
    let Some(cluster) = cluster(&[]) else { return };
    cluster.execute(
        "postgres",
        "CREATE DATABASE latin TEMPLATE template0 LOCALE_PROVIDER libc ENCODING LATIN1 LOCALE 'C'",
    );
    let told = open(&cluster.connection("latin"))
        .err()
        .unwrap()
        .to_string();
    assert!(
        told.contains("found the encoding LATIN1, expected a database in UTF8"),
        "{told}"
    );
}

/// The command line over TLS, with a password: which is in a file that others cannot read, and in nothing that is printed.
#[test]
fn over_a_network_with_a_password() {
    const SECRET: &str = "correct horse 'battery' \\ staple";
    let pair = tempfile::tempdir().unwrap();
    let [certificate, key] =
        volcomp_web::tls::make(pair.path(), &["127.0.0.1".to_owned()]).unwrap();
    let port = volcomp_test_support::free_port();
    let settings = [
        "listen_addresses=127.0.0.1".to_owned(),
        format!("port={port}"),
    ];
    let settings: Vec<&str> = settings.iter().map(String::as_str).collect();
    let Some(cluster) = cluster(&settings) else {
        return;
    };
    let name = cluster.database();
    // The server reads its key as its own user, and takes nothing in the clear from the network.
    let data = cluster.data();
    let owner = std::os::unix::fs::MetadataExt::uid(&std::fs::metadata(&data).unwrap());
    for (from, to) in [(&certificate, "server.crt"), (&key, "server.key")] {
        std::fs::copy(from, data.join(to)).unwrap();
        std::os::unix::fs::chown(data.join(to), Some(owner), None).unwrap();
    }
    std::fs::write(
        data.join("pg_hba.conf"),
        "local all all trust\nhostssl all all 127.0.0.1/32 scram-sha-256\n",
    )
    .unwrap();
    let quoted = SECRET.replace('\'', "''");
    cluster.execute(&name, &format!("ALTER ROLE {ROLE} PASSWORD '{quoted}'"));
    cluster.execute(&name, "ALTER SYSTEM SET ssl = on");
    cluster.crash();
    cluster.start();

    let folder = tempfile::tempdir().unwrap();
    let folder = folder.path();
    let configure = |connection: &str, more: &str| {
        let text = format!(
            "[nats]\nurl = \"nats://127.0.0.1:4222\"\n[store]\npostgres = \"{connection}\"\n{more}"
        );
        std::fs::write(folder.join("centre.toml"), text).unwrap();
    };
    let connection = format!("host=127.0.0.1 port={port} user={ROLE} dbname={name}");
    let secret = |text: &str, mode: u32| {
        let file = folder.join("password");
        std::fs::write(&file, text).unwrap();
        std::fs::set_permissions(file, std::fs::Permissions::from_mode(mode)).unwrap();
    };
    let fails = |status: i32, told: &str| {
        let called = call(folder, "check");
        assert!(
            called.status == status && called.err.contains(told),
            "{told}: {} {}",
            called.status,
            called.err
        );
        for word in ["horse", "battery"] {
            assert!(
                !called.err.contains(word) && !called.out.contains(word),
                "{}",
                called.err
            );
        }
    };
    let with = format!(
        "password_file = \"password\"\nca = {:?}\n",
        certificate.display().to_string()
    );
    configure(&connection, &with);
    assert_eq!(call(folder, "key new main").status, 0);
    assert_eq!(call(folder, "key nkey centre.nkey").status, 0);
    fails(2, "password");
    secret(SECRET, 0o644);
    fails(2, "found mode 644, expected 600");
    secret(&format!("{SECRET}\n"), 0o600);
    let called = call(folder, "check");
    assert_eq!(called.status, 0, "{}", called.err);
    let told = format!("PostgreSQL on 127.0.0.1, port {port}, database {name}, user {ROLE}\n");
    assert!(
        called.out.contains(&told) && !called.out.contains("horse"),
        "{}",
        called.out
    );
    secret("battery wrong", 0o600);
    fails(1, "password authentication failed");
    secret(SECRET, 0o600);
    // Another certificate, and none: nobody else's server is talked to.
    let folder_of_other = tempfile::tempdir().unwrap();
    let [other, _] =
        volcomp_web::tls::make(folder_of_other.path(), &["127.0.0.1".to_owned()]).unwrap();
    configure(
        &connection,
        &with.replace(certificate.to_str().unwrap(), other.to_str().unwrap()),
    );
    fails(1, "TLS");
    configure(
        &format!("{connection} sslmode=require"),
        "password_file = \"password\"\n",
    );
    fails(1, "TLS");
    // In the clear on one computer: this server takes nothing of it.
    configure(&connection, "password_file = \"password\"\n");
    fails(1, "no encryption");
}

/// The server of the database crashes again and again while machines tell: what was acknowledged to them is stored, each once,
/// a roll-out goes on, and a person is told.
#[test]
fn crashes_while_machines_tell_lose_nothing() {
    const MACHINES: usize = 3;
    let Some(cluster) = cluster(&[]) else { return };
    let name = cluster.database();
    let connection = cluster.connection(&name);
    let Some(shop) = Shop::with_store(1, MACHINES, |_| open(&connection).unwrap()) else {
        return;
    };
    let runtime = runtime();
    let centre = runtime.block_on(shop.centre(&shop.url()));
    let gateways: Vec<_> = (0..MACHINES)
        .map(|place| {
            let mut plan = shop.plan(place, &format!("run-{place}"));
            plan.condition_every = Duration::from_millis(5);
            let told = Told::default();
            (told.clone(), runtime.spawn(gateway::run(plan, told)))
        })
        .collect();
    let told = |place: usize| gateways[place].0.conditions.load(Ordering::Relaxed);
    let rules = Rules {
        soak_s: 2.0,
        answer_s: 300.0,
        ..Rules::default()
    };
    let id = shop.roll_out(7, rules);
    // A second program on the same database.
    let command_line = open(&connection).unwrap();
    for round in 0..4 {
        let before = told(0);
        until("they tell", LONG, || told(0) > before + 50);
        cluster.crash();
        let before = told(0);
        until("they go on telling", LONG, || told(0) > before + 20);
        cluster.start();
        command_line
            .put_machine(&machine(&format!("other-{round}")), "anna")
            .unwrap();
    }
    until("the roll-out is done", LONG, || {
        shop.store.rollout(id).unwrap().unwrap().phase == Phase::Done
    });
    until("a person was told, and that it is over", LONG, || {
        let alarms = shop.store.alarms(None, 100).unwrap();
        let mut of_store = alarms
            .iter()
            .filter(|alarm| alarm.kind == AlarmKind::Store)
            .peekable();
        of_store.peek().is_some() && of_store.all(|alarm| alarm.until_s.is_some())
    });
    for (place, (told, task)) in gateways.into_iter().enumerate() {
        task.abort();
        let _ = runtime.block_on(task);
        let told = told.conditions.load(Ordering::Relaxed);
        let sql = format!(
            "SELECT (SELECT count(*) FROM recent WHERE machine = 'mill-{place}') + coalesce((SELECT
             sum(json_array_length(document::json)) FROM raw WHERE machine = 'mill-{place}'), 0)"
        );
        let stored = || -> u64 { cluster.execute(&name, &sql).trim().parse().unwrap() };
        until("everything is stored", LONG, || stored() >= told);
        let stored = stored();
        // Those that were under way may be stored although nobody was told.
        assert!(stored <= told + 1, "{stored} stored of {told}");
    }
    runtime.block_on(centre.end());
    assert_eq!(shop.store.broken_audit().unwrap(), None);
    assert_eq!(shop.store.machines().unwrap().len(), MACHINES + 4);
}

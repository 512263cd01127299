use std::time::Duration;

use volcomp_port::{Backoff, Quality, Thermometer};
use volcomp_sinumerik::{Sensor, Server, poll_temperatures};
use volcomp_test_support::until;

use crate::{Peer, TIMEOUT};

#[test]
fn temperatures_keep_their_age() {
    let sensors = ["bed=20.5", "column=30"].map(|sensor| format!("--temperature={sensor}"));
    let Some(mut peer) = Peer::start(&[&sensors[0], &sensors[1]]) else {
        return;
    };
    let sensor = |name: &str, node: &str| Sensor { name: name.to_owned(), node: node.to_owned() };
    let mut server = Server::new(&*peer.url);
    server.time_out = Duration::from_secs(5);
    server.backoff = Backoff { first: Duration::from_millis(50), most: Duration::from_millis(200) };
    let sensors = [
        sensor("column", "/Plc/DB5.DBD4:REAL"),
        sensor("bed", "/Plc/DB5.DBD0:REAL"),
        sensor("nothing", "/Plc/DB6.DBD0:REAL"),
    ];
    let mut thermometer = poll_temperatures(server, &sensors).unwrap();
    until("both are good", TIMEOUT, || thermometer.latest()[1].quality == Quality::Good);
    let [column, bed, nothing] = thermometer.latest() else { panic!("three") };
    assert_eq!([column.degc, bed.degc, nothing.degc], [Some(30.0), Some(20.5), None]);
    peer.type_in("temperature bed=24");
    until("the new value is read", TIMEOUT, || thermometer.latest()[1].degc == Some(24.0));
    peer.type_in("stall on");
    until("it ages", TIMEOUT, || {
        thermometer.latest()[1].taken.is_some_and(|taken| taken.elapsed() > Duration::from_secs(4))
    });
    drop(peer);
    until("it is bad", TIMEOUT, || matches!(thermometer.latest()[1].quality, Quality::Bad(_)));
}

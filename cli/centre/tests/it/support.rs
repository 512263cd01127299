//! Common test data: gateway messages, machines, models.

use std::collections::BTreeMap;

use volcomp_centre::{
    ingest::Ingest,
    models::NewModel,
    records::{Machine, Origin},
    store::Store,
};
use volcomp_fleet::{Condition, Envelope, Identity, Kind, Received};
use volcomp_vocabulary::AxisName;

pub(crate) fn model_text(number: u32) -> String {
    format!(
        "name = \"mill\"\nstructure = \"w X' b Y Z t\"\n[axes.X]\ntravel = [0.0, 500.0]\n[axes.Y]\ntravel = [0.0, 400.0]\n[axes.Z]\ntravel = [0.0, 300.0]\n[errors]\nEC0Y = {number}.0\n"
    )
}

pub(crate) fn model(number: u32) -> NewModel {
    let origin = Origin::File { name: "mill.toml".to_owned() };
    NewModel::of_text(model_text(number), "mill.toml", origin, "anna").unwrap()
}

pub(crate) fn identity(machine: &str) -> Identity {
    Identity { site: "berlin".parse().unwrap(), machine: machine.parse().unwrap() }
}

pub(crate) fn machine(name: &str) -> Machine {
    Machine::new(
        identity(name),
        format!("serial of {name}"),
        "w X' b Y Z t".to_owned(),
        vec![AxisName::X, AxisName::Y, AxisName::Z],
    )
}

pub(crate) fn condition(residual_um: f64) -> Condition {
    Condition {
        state: "compensating".to_owned(),
        reasons: Vec::new(),
        armed: true,
        correction_um: BTreeMap::from([(AxisName::X, 12.0), (AxisName::Y, -3.5)]),
        correction_urad: BTreeMap::new(),
        residual_um: Some(residual_um),
        temperatures_degc: BTreeMap::from([("scale X".to_owned(), Some(21.5))]),
        cycle_p99_us: 180.0,
        overruns: 0,
        faults: 2,
    }
}

pub(crate) fn envelope<T>(instance: &str, number: u64, body: T) -> Envelope<T> {
    Envelope {
        instance: instance.to_owned(),
        number,
        uptime_s: number as f64,
        wall_s: 0.0,
        version: 0,
        model: String::new(),
        body,
    }
}

pub(crate) fn tell(store: &Store, batch: &[Received]) {
    let mut ingest = Ingest::of(store).unwrap();
    ingest.take(store, batch).unwrap();
    ingest.store_live(store).unwrap();
}

pub(crate) fn received<T: serde::Serialize>(
    machine: &str,
    kind: Kind,
    sequence: u64,
    stored_s: f64,
    envelope: &Envelope<T>,
) -> Received {
    Received {
        identity: identity(machine),
        kind,
        sequence,
        stored_s,
        bytes: serde_json::to_vec(envelope).unwrap().into(),
    }
}

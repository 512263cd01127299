//! Registering machines, changing and removing them.

use std::sync::Arc;

use axum::{
    Extension,
    body::Bytes,
    extract::{Path, State},
};
use volcomp_model::kinematics::Structure;

use super::{
    answer::{Answer, Refused, done, read},
    face::Face,
    machines::named,
};
use crate::{records::Machine, users::User};

type Shared = State<Arc<Face>>;

/// The longest text of a machine that is only for people, characters.
const LONGEST: usize = 500;

pub(super) async fn machine(
    State(face): Shared,
    Extension(user): Extension<User>,
    body: Bytes,
) -> Answer {
    let machine: Machine = read(&body)?;
    check(&machine).map_err(Refused::wrong)?;
    face.ask(move |store| store.put_machine(&machine, user.name.as_str()))
        .await?;
    done()
}

/// What of a machine does not fit together.
fn check(machine: &Machine) -> Result<(), String> {
    let structure: Structure = machine
        .structure
        .parse()
        .map_err(|error| format!("structure: {error}"))?;
    if structure.axes() != machine.axes {
        let axes: Vec<String> = structure.axes().iter().map(ToString::to_string).collect();
        return Err(format!(
            "axes: expected those of the structure in its order, {}",
            axes.join(" ")
        ));
    }
    if machine.serial.trim().is_empty() {
        return Err("serial: expected the serial number of the machine tool".to_owned());
    }
    for (key, text) in [
        ("serial", &machine.serial),
        ("address", &machine.address),
        ("control", &machine.control),
        ("note", &machine.note),
    ] {
        if text.chars().count() > LONGEST || text.contains(char::is_control) {
            return Err(format!(
                "{key}: expected one line of at most {LONGEST} characters"
            ));
        }
    }
    if let Some(nkey) = &machine.nkey {
        let letters = |byte: u8| byte.is_ascii_uppercase() || (b'2'..=b'7').contains(&byte);
        if nkey.len() != 56 || !nkey.starts_with('U') || !nkey.bytes().all(letters) {
            return Err(
                "nkey: expected the public key of the gateway's user, U and 55 letters and digits"
                    .to_owned(),
            );
        }
    }
    let seconds = [machine.condition_s, machine.telemetry_s];
    if seconds.iter().flatten().any(|s| !(1..=86_400).contains(s)) {
        return Err("condition_s, telemetry_s: expected 1 to 86400 s".to_owned());
    }
    if machine
        .due_days
        .is_some_and(|days| !(1..=36_500).contains(&days))
    {
        return Err("due_days: expected 1 to 36500 days".to_owned());
    }
    Ok(())
}

pub(super) async fn remove_machine(
    State(face): Shared,
    Extension(user): Extension<User>,
    Path(name): Path<String>,
) -> Answer {
    let id = named(&name)?;
    let removed = face
        .ask(move |store| store.remove_machine(&id, user.name.as_str()))
        .await?;
    if removed {
        done()
    } else {
        Err(Refused::missing("there is no such machine"))
    }
}

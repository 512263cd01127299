//! Registering machines, changing and removing them.

use axum::{
    Extension,
    body::Bytes,
    extract::{Path, State},
};

use super::{
    answer::{Answer, Refused, done, read},
    machines::named,
    state::Shared,
};
use crate::{records::Machine, registration::check, users::User};

pub(super) async fn machine(
    State(page): Shared,
    Extension(user): Extension<User>,
    body: Bytes,
) -> Answer {
    let machine: Machine = read(&body)?;
    check(&machine).map_err(|error| Refused::wrong(error.to_string()))?;
    page.ask(move |store| store.put_machine(&machine, user.name.as_str()))
        .await?;
    done()
}

pub(super) async fn remove_machine(
    State(page): Shared,
    Extension(user): Extension<User>,
    Path(name): Path<String>,
) -> Answer {
    let id = named(&name)?;
    let removed = page
        .ask(move |store| store.remove_machine(&id, user.name.as_str()))
        .await?;
    if removed {
        done()
    } else {
        Err(Refused::missing("there is no such machine"))
    }
}

//! Alarms, and the log of changes.

use axum::{
    Extension,
    extract::{Path, Query, State},
};
use serde::Deserialize;

use super::{
    answer::{Answer, Refused, document, done},
    state::Shared,
};
use crate::users::User;

/// So many alarms are told.
const ALARMS: u32 = 500;
/// So many records of the log are told at one time.
const RECORDS: u32 = 200;

#[derive(Deserialize)]
pub(super) struct Which {
    /// Those that are over, too.
    #[serde(default)]
    all: bool,
}

pub(super) async fn alarms(State(page): Shared, Query(which): Query<Which>) -> Answer {
    let alarms = page.ask(move |store| {
        if which.all {
            store.alarms(None, ALARMS)
        } else {
            store.open_alarms()
        }
    });
    document(&alarms.await?)
}

pub(super) async fn see_alarm(
    State(page): Shared,
    Extension(user): Extension<User>,
    Path(id): Path<u64>,
) -> Answer {
    let seen = page
        .ask(move |store| store.see_alarm(id, user.name.as_str()))
        .await?;
    if seen {
        done()
    } else {
        Err(Refused::missing("there is no such alarm"))
    }
}

#[derive(Deserialize)]
pub(super) struct Before {
    /// Records with smaller numbers.
    before: Option<u64>,
}

pub(super) async fn audit(State(page): Shared, Query(range): Query<Before>) -> Answer {
    document(
        &page
            .ask(move |store| store.audit_records(range.before, RECORDS))
            .await?,
    )
}

//! One thread that stores what machines say: whatever waits goes into one transaction, so that many sites cost one commit.

use std::{
    sync::{Arc, Mutex, PoisonError, mpsc},
    time::Duration,
};

use tokio::sync::oneshot;
use volcomp_fleet::Received;

use super::Engine;
use crate::records::AlarmKind;

/// A commit holds so many messages at the most.
const MOST: usize = 8_000;
/// Where the database takes nothing it is tried again after so long. Until then the messages stay at the server.
const AGAIN: Duration = Duration::from_secs(1);

/// Messages that are to be stored, and who waits for it.
pub(super) struct Job {
    pub(super) messages: Vec<Received>,
    pub(super) stored: oneshot::Sender<()>,
}

/// Runs until nobody can send any more.
pub(super) fn run(engine: &Arc<Engine>, jobs: &mpsc::Receiver<Job>) {
    while let Ok(first) = jobs.recv() {
        let mut waiting = vec![first];
        let mut count = waiting[0].messages.len();
        while count < MOST
            && let Ok(next) = jobs.try_recv()
        {
            count += next.messages.len();
            waiting.push(next);
        }
        let mut all = Vec::with_capacity(count);
        let mut who = Vec::with_capacity(waiting.len());
        for job in waiting {
            all.extend(job.messages);
            who.push(job.stored);
        }
        if store(engine, &all) {
            for stored in who {
                // Whoever waited has gone: the messages come again, and are known.
                let _ = stored.send(());
            }
        }
    }
}

/// Returns when everything is on disk; `false`: the centre ends before that, and nothing may be acknowledged.
fn store(engine: &Engine, messages: &[Received]) -> bool {
    loop {
        let taken = lock(&engine.ingest).take(&engine.store, messages);
        match taken {
            Ok(taken) => {
                engine.counts.add(taken.stored, taken.twice);
                engine.trouble(AlarmKind::Store, None);
                return true;
            }
            Err(error) => {
                engine.trouble(AlarmKind::Store, Some(error.to_string()));
                if engine.is_ending() {
                    return false;
                }
                std::thread::sleep(AGAIN);
            }
        }
    }
}

/// A thread that ended with it in its hands has left it whole: it is changed after the transaction.
pub(super) fn lock<T>(mutex: &Mutex<T>) -> std::sync::MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

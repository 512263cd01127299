//! Parallel evaluation of many poses.

use std::{
    ops::Range,
    sync::atomic::{AtomicUsize, Ordering},
};

use rayon::prelude::*;

const CHUNK: usize = 2048;

/// Calls `work` for each chunk of the indices 0 to `count`. The results are in the order of the poses, so that joining them gives the same digits
/// in every run. `progress` receives, from any thread, the number of finished poses and their total number.
pub(crate) fn chunks<T: Send>(
    count: usize,
    progress: &(impl Fn(usize, usize) + Sync),
    work: impl Fn(Range<usize>) -> T + Sync,
) -> Vec<T> {
    let starts: Vec<usize> = (0..count).step_by(CHUNK).collect();
    let done = AtomicUsize::new(0);
    starts
        .into_par_iter()
        .map(|start| {
            let places = start..count.min(start + CHUNK);
            let more = places.len();
            let made = work(places);
            progress(done.fetch_add(more, Ordering::Relaxed) + more, count);
            made
        })
        .collect()
}

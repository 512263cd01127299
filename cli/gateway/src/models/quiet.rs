//! Threads that must not disturb the cycle: other processors, low priority.

use std::{io, thread};

use rustix::{
    process::setpriority_process,
    thread::{CpuSet, sched_getaffinity, sched_setaffinity},
};

/// Nice value of background work.
const NICE: i32 = 15;

/// Spawns a low-priority thread. `cycle_cpu` is the processor reserved for the cycle, if any.
pub(crate) fn spawn(
    name: &str,
    cycle_cpu: Option<usize>,
    work: impl FnOnce() + Send + 'static,
) -> io::Result<()> {
    // The thread logs under the span of the machine that starts it.
    let span = tracing::Span::current();
    thread::Builder::new()
        .name(name.to_owned())
        .spawn(move || {
            span.in_scope(|| {
                step_back(cycle_cpu);
                work();
            });
        })?;
    Ok(())
}

/// Moves this thread off the processor of the cycle and lowers its priority. Failures are ignored: the cycle also has
/// real-time priority.
fn step_back(cycle_cpu: Option<usize>) {
    if let (Some(cpu), Ok(set)) = (cycle_cpu, sched_getaffinity(None))
        && let Some(others) = without(set, cpu)
        && let Err(e) = sched_setaffinity(None, &others)
    {
        tracing::debug!("not off processor {cpu}: {e}");
    }
    // On Linux this affects the calling thread only.
    if let Err(e) = setpriority_process(None, NICE) {
        tracing::debug!("no lower priority: {e}");
    }
}

/// Removes a processor from a set; `None` if no other processor remains.
fn without(mut set: CpuSet, cpu: usize) -> Option<CpuSet> {
    if cpu < CpuSet::MAX_CPU {
        set.unset(cpu);
    }
    (set.count() > 0).then_some(set)
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use rustix::process::getpriority_process;

    use super::*;

    /// The thread that works is nicer than the one that asked, which stays as it was.
    #[test]
    fn only_the_quiet_thread_steps_back() {
        let before = getpriority_process(None).expect("told");
        let (tell, told) = channel();
        spawn("quiet", None, move || {
            let _ = tell.send(getpriority_process(None).expect("told"));
        })
        .expect("a thread");
        assert_eq!(told.recv().expect("it ran"), NICE.max(before));
        assert_eq!(getpriority_process(None).expect("told"), before);
    }

    #[test]
    fn the_last_processor_is_not_taken_away() {
        let mut set = CpuSet::new();
        set.set(1);
        set.set(2);
        let others = without(set, 1).expect("one is left");
        assert!(!others.is_set(1) && others.is_set(2));
        assert!(without(others, 2).is_none());
    }
}

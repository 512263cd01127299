//! Threads that must not disturb the cycle: on other processors than its own, at low priority.

use std::{io, thread};

use rustix::{
    process::setpriority_process,
    thread::{CpuSet, sched_getaffinity, sched_setaffinity},
};

/// The niceness of work that can wait.
const NICE: i32 = 15;

/// Begins work on a quiet thread. `cycle_cpu`: the processor on which the cycle stays, where it has one of its own.
pub(crate) fn spawn(
    name: &str,
    cycle_cpu: Option<usize>,
    work: impl FnOnce() + Send + 'static,
) -> io::Result<()> {
    // What it logs is of the machine of whoever starts it.
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

/// Leaves the processor of the cycle, and takes what others leave of the rest. What the operating system refuses is no reason
/// not to work: the cycle has real-time priority besides.
fn step_back(cycle_cpu: Option<usize>) {
    if let (Some(cpu), Ok(set)) = (cycle_cpu, sched_getaffinity(None))
        && let Some(others) = without(set, cpu)
        && let Err(e) = sched_setaffinity(None, &others)
    {
        tracing::debug!("not off processor {cpu}: {e}");
    }
    // Linux: of this thread alone.
    if let Err(e) = setpriority_process(None, NICE) {
        tracing::debug!("no lower priority: {e}");
    }
}

/// The other processors; `None`: there is no other.
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

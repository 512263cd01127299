//! The requests of the control thread to the operating system: real-time priority and a processor of its own.

use rustix::thread::{CpuSet, sched_setaffinity};
use thread_priority::{
    RealtimeThreadSchedulePolicy, ThreadPriority, ThreadPriorityValue, ThreadSchedulePolicy,
    set_thread_priority_and_policy, thread_native_id,
};

use crate::settings::Realtime;

/// Stack that is touched before the loop begins, bytes.
pub(crate) const STACK: usize = 256 * 1024;

/// Asks for SCHED_FIFO and a processor for this thread. Gives in words what was refused.
pub fn schedule(wanted: Realtime) -> Vec<String> {
    let mut lacking = Vec::new();
    if let Some(cpu) = wanted.cpu {
        let mut set = CpuSet::new();
        if cpu < CpuSet::MAX_CPU {
            set.set(cpu);
        }
        if let Err(e) = sched_setaffinity(None, &set) {
            lacking.push(format!("control thread is not on processor {cpu}: {e}"));
        }
    }
    if wanted.priority > 0 {
        let policy = ThreadSchedulePolicy::Realtime(RealtimeThreadSchedulePolicy::Fifo);
        let priority =
            ThreadPriorityValue::try_from(wanted.priority).map(ThreadPriority::Crossplatform);
        let set = priority.and_then(|priority| {
            set_thread_priority_and_policy(thread_native_id(), priority, policy)
                .map_err(|e| format!("{e:?}"))
        });
        if let Err(e) = set {
            lacking.push(format!(
                "control thread has no real-time priority: {e} (LimitRTPRIO)"
            ));
        }
    }
    lacking
}

/// Touches the pages of the stack, so that none is fetched in a cycle.
#[inline(never)]
#[expect(
    clippy::large_stack_arrays,
    reason = "the array is there to touch the stack"
)]
pub(crate) fn touch_stack() {
    let mut stack = [0_u8; STACK];
    for page in stack.chunks_mut(4096) {
        page[0] = 1;
    }
    std::hint::black_box(&mut stack);
}

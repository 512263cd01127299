//! The barrier under single rules, in random worlds, and in an exhaustive search.

mod explored;
mod frames;
mod lines;
mod program;
mod random;
mod rules;
mod simulated;
mod slow;
mod text;
mod tip;

use volcomp_guard::{
    barrier::{Barrier, FRAME_WORDS, Frame, Settings},
    protocol::{Counts, Layout},
    vocabulary::{AxisName, PerChannel},
};

pub(super) fn layout(axes: usize) -> Layout {
    Layout::of(AxisName::ALL[..axes].iter().copied()).expect("each once")
}

/// A barrier with a limit of 20 counts and a rate of 2 counts per scan.
pub(super) fn settings(axes: usize) -> Settings {
    Settings {
        axes: layout(axes),
        machine: 4711,
        limit: PerChannel::from_fn(|_| 20),
        rate: PerChannel::from_fn(|_| 2),
        step_scans: 1,
        hold_scans: 5,
        time_out_scans: 12,
    }
}

pub(super) fn at_zero(settings: Settings) -> Barrier {
    Barrier::start(settings, 6, 1000, &Counts::default()).expect("valid")
}

pub(super) fn words(settings: &Settings, frame: &Frame) -> Vec<u16> {
    let mut words = [0; FRAME_WORDS];
    let count = frame.encode(settings, &mut words);
    words[..count].to_vec()
}

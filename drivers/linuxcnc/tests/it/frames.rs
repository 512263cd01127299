//! Generates contents of a barrier's mailboxes: valid, old, foreign, torn and random frames.

use proptest::prelude::*;
use volcomp_guard::{
    barrier::{FRAME_WORDS, Frame, Report, Settings},
    protocol::{Head, Layout},
};
use volcomp_vocabulary::{AxisName, PerChannel};

/// Settings of a barrier for a linear and a rotary axis. `step`: number of scans per step; `hold`: maximum age of a
/// frame, in scans.
pub(crate) fn settings(
    machine: u16,
    limit: [i16; 2],
    rate: [i16; 2],
    [step, hold]: [u16; 2],
) -> Settings {
    Settings {
        axes: Layout::of([AxisName::X, AxisName::C]).unwrap(),
        machine,
        limit: PerChannel::leading(limit),
        rate: PerChannel::leading(rate),
        step_scans: step,
        hold_scans: hold,
        time_out_scans: 2 * hold + 3,
    }
}

#[derive(Clone, Copy, Debug)]
pub(crate) enum Post {
    Nothing,
    /// A frame from the gateway `owner`. `old`: age in ticks; `ahead`: distance of its sequence number from the last
    /// one; `before`: whether it has the previous epoch.
    Made {
        owner: u16,
        old: u16,
        ahead: u16,
        before: bool,
        values: [i16; 2],
        torn: Option<(usize, u16)>,
    },
    Random([u16; 8]),
}

pub(crate) fn posts() -> impl Strategy<Value = Post> {
    let value = prop_oneof![4 => -50_i16..50, 1 => any::<i16>()];
    let made = (
        prop_oneof![5 => Just(5_u16), 1 => 0_u16..8],
        prop_oneof![8 => 0_u16..3, 1 => any::<u16>()],
        // A sequence number at a distance of half the range is neither newer nor older.
        prop_oneof![8 => Just(1_u16), 1 => any::<u16>(), 1 => 0x7FFF_u16..=0x8001],
        prop::bool::weighted(0.05),
        [value.clone(), value],
        prop::option::weighted(0.1, (0..8_usize, 1_u16..)),
    );
    prop_oneof![
        3 => Just(Post::Nothing),
        8 => made.prop_map(|(owner, old, ahead, before, values, torn)| Post::Made { owner, old, ahead, before, values, torn }),
        1 => any::<[u16; 8]>().prop_map(Post::Random),
    ]
}

fn words_of(post: Post, last: &Report) -> Vec<u16> {
    match post {
        Post::Nothing => Vec::new(),
        Post::Random(words) => words.to_vec(),
        Post::Made { owner, old, ahead, before, values, torn } => {
            let frame = Frame {
                head: Head {
                    epoch: last.epoch.wrapping_sub(before.into()),
                    tick: last.tick.wrapping_sub(old),
                    sequence: last.sequence.wrapping_add(ahead),
                    owner,
                },
                values: *PerChannel::leading(values),
            };
            let mut words = [0; FRAME_WORDS];
            let length = frame.encode(&last.settings, &mut words);
            if let Some((at, by)) = torn {
                words[at] ^= by;
            }
            words[..length].to_vec()
        }
    }
}

/// Words of the mailboxes at a scan. After three repetitions all mailboxes are empty, because a gateway answers each
/// report with a new frame.
pub(crate) fn mailboxes_of(posts: [Post; 2], repeat: usize, last: &Report) -> Vec<Vec<u16>> {
    let posts = posts.into_iter().filter(|_| repeat <= 3);
    let mailboxes = posts.map(|post| words_of(post, last));
    mailboxes.filter(|words| !words.is_empty()).collect()
}

//! The nodes of a map: gone through on all cores, written in order.

use rayon::prelude::*;
use volcomp_kinematics::State;
use volcomp_model::{Ensemble, Lengths, Machine, MapGrid, RigidSums};

use super::{
    field::{Field, TextFormat},
    node::Node,
    rigid::{Beside, position},
};
use crate::{failure::Failure, progress};

/// Nodes that one core takes at a time.
const CHUNK: usize = 4096;

/// Computes position (mm) and rotation (rad) at a state.
pub(super) type ErrorAt<'a> = Box<dyn Fn(&State) -> [f64; 6] + Sync + 'a>;

/// The inputs from which a node is computed.
pub(super) struct Work<'a> {
    pub(super) machine: &'a Machine,
    pub(super) errors: ErrorAt<'a>,
    pub(super) ensemble: Option<&'a Ensemble>,
    pub(super) grid: &'a MapGrid,
}

impl Work<'_> {
    /// Every node once: in chunks on all cores, written in order.
    pub(super) fn go_through(
        &self,
        pass: usize,
        field: &mut Field,
        found: &mut Found,
    ) -> Result<(), Failure> {
        let bar = progress::bar(self.grid.len(), "nodes");
        let format = field.text_format().map(|(format, _)| format);
        let count = self.grid.len();
        // With an uncertainty a node takes as long as hundreds without.
        let size = if self.ensemble.is_some() {
            CHUNK / 64
        } else {
            CHUNK
        };
        let at_once = size * 4 * rayon::current_num_threads();
        for from in (0..count).step_by(at_once) {
            let starts: Vec<usize> = (from..count.min(from + at_once)).step_by(size).collect();
            let chunks: Vec<Chunk> = starts
                .into_par_iter()
                .map(|start| self.chunk(start..count.min(start + size), pass, format))
                .collect();
            for chunk in &chunks {
                field.write(&chunk.nodes, &chunk.text)?;
                found.largest.take(&chunk.largest);
                if pass == 0 {
                    found.sums.merge(&chunk.sums);
                    found.lengths.merge(&chunk.lengths);
                }
                bar.inc(chunk.nodes.len() as u64);
            }
        }
        bar.finish_and_clear();
        Ok(())
    }

    /// What the nodes show after one alignment of them all: every node once more.
    pub(super) fn beside(&self, found: &Found) -> Beside {
        let motion = found.sums.motion();
        let count = self.grid.len();
        let mut left = Lengths::default();
        let at_once = CHUNK * 4 * rayon::current_num_threads();
        for from in (0..count).step_by(at_once) {
            let starts: Vec<usize> = (from..count.min(from + at_once)).step_by(CHUNK).collect();
            let of_chunk = |start: usize| {
                let mut left = Lengths::default();
                for index in start..count.min(start + CHUNK) {
                    let (_, state) = self.grid.node(self.machine, index);
                    let tip_mm = self.machine.chain().ideal_tip_mm(&state);
                    left.take(&motion.left_mm(&tip_mm, &position(&(self.errors)(&state))));
                }
                left
            };
            let chunks: Vec<Lengths> = starts.into_par_iter().map(of_chunk).collect();
            for chunk in &chunks {
                left.merge(chunk);
            }
        }
        Beside {
            as_they_are: found.lengths,
            left,
        }
    }

    fn chunk(
        &self,
        nodes: core::ops::Range<usize>,
        pass: usize,
        format: Option<TextFormat>,
    ) -> Chunk {
        let nodes: Vec<Node> = nodes.map(|index| self.node(index)).collect();
        let mut largest = Largest::default();
        let (mut sums, mut lengths) = (RigidSums::default(), Lengths::default());
        for node in &nodes {
            largest.see(node);
            let error = position(&node.error);
            sums.take(&node.tip_mm, &error);
            lengths.take(&error);
        }
        let lines = |format: TextFormat| format.lines(pass, self.grid.axes.len(), &nodes);
        Chunk {
            text: format.map(lines).unwrap_or_default(),
            largest,
            sums,
            lengths,
            nodes,
        }
    }

    fn node(&self, index: usize) -> Node {
        let (at_mm, state) = self.grid.node(self.machine, index);
        Node {
            at_mm,
            tip_mm: self.machine.chain().ideal_tip_mm(&state),
            error: (self.errors)(&state),
            uncertainty: self.ensemble.map(|e| e.standard_uncertainty(&state)),
        }
    }
}

struct Chunk {
    nodes: Vec<Node>,
    text: String,
    largest: Largest,
    sums: RigidSums,
    lengths: Lengths,
}

/// What all nodes show.
#[derive(Default)]
pub(super) struct Found {
    pub(super) largest: Largest,
    /// Their position errors, for the alignment.
    sums: RigidSums,
    lengths: Lengths,
}

/// The nodes with the largest position error and its largest uncertainty; of equal ones the first.
#[derive(Clone, Copy, Default)]
pub(super) struct Largest {
    pub(super) error: Option<(f64, Node)>,
    pub(super) uncertainty: Option<(f64, Node)>,
}

impl Largest {
    fn see(&mut self, node: &Node) {
        keep(&mut self.error, length(&node.error), node);
        if let Some(uncertainty) = &node.uncertainty {
            keep(&mut self.uncertainty, length(uncertainty), node);
        }
    }

    fn take(&mut self, other: &Self) {
        for (into, found) in [
            (&mut self.error, &other.error),
            (&mut self.uncertainty, &other.uncertainty),
        ] {
            if let Some((length, node)) = found {
                keep(into, *length, node);
            }
        }
    }
}

fn keep(most: &mut Option<(f64, Node)>, length: f64, node: &Node) {
    if most.as_ref().is_none_or(|(before, _)| length > *before) {
        *most = Some((length, *node));
    }
}

/// Length of the position error, mm.
fn length([x, y, z, ..]: &[f64; 6]) -> f64 {
    (x * x + y * y + z * z).sqrt()
}

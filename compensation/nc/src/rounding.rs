//! How the numbers of a split line are rounded.

use crate::{
    contour::Contour,
    coordinates::{Axes, is_rotary},
    line::Line,
    motion::Move,
    number::of_steps,
    rewrite::Rewriter,
    shortest::through,
    words::{between, each},
};

/// How the numbers of the parts of a line are rounded.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Strategy {
    /// Each to the nearest.
    #[default]
    Plain,
    /// Together, so that the motion is nearest to the line: along it a part may end a little sooner or later, since the next one
    /// goes on from there. The shortest way through the graph of the numbers that are next to the exact ones.
    Floyd,
}

impl Rewriter {
    /// By how much the axes are to differ from the line at the end of each part, in the coordinates of the program, so that the
    /// numbers are those of the shortest way; `None` where each number is the nearest: lines of one part, rotary axes that correct,
    /// coordinates that are ways, lines whose play is taken up on the way, and beside contours.
    pub(crate) fn rounded_together(
        &mut self,
        motion: &Move,
        parts: &[f64],
        line: Line<'_>,
    ) -> Option<Vec<Axes>> {
        let frame = &self.interpreter.frame;
        let is_plain = self.strategy == Strategy::Plain
            || parts.len() < 2
            || parts.windows(2).any(|pair| pair[0] == pair[1])
            || parts[0] == 0.0
            || frame.tip.is_some()
            || self.contour != Contour::None
            || (0..9).any(|axis| {
                motion.incremental[axis] || is_rotary(axis) && self.corrector.corrects(axis)
            });
        if is_plain {
            return None;
        }
        let [from, end] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
        // The step of each axis whose words are free; of the others the nearest number is taken.
        let step: Axes<Option<f64>> = each(|axis| {
            let word = line.word(motion.words[axis])?;
            let decimals = self.numerals(axis, Some(word)).decimals;
            let decimals = decimals.max(word.decimals.unwrap_or(0));
            let is_free = self.corrector.corrects(axis) && end[axis] != from[axis];
            is_free.then(|| self.interpreter.modal.scale(axis) * of_steps(1, decimals))
        });
        let free: Vec<usize> = (0..9).filter(|axis| step[*axis].is_some()).collect();
        if free.len() < 2 {
            return None;
        }
        let way: Axes = each(|axis| end[axis] - from[axis]);
        let square: f64 = free.iter().map(|axis| way[*axis] * way[*axis]).sum();
        // What a number is off by across the line.
        let across = |off: &Axes| -> Axes {
            let along: f64 = free.iter().map(|axis| off[*axis] * way[*axis]).sum();
            each(|axis| off[axis] - along / square * way[axis])
        };
        let mut layers: Vec<Vec<(Axes, Axes)>> = Vec::with_capacity(parts.len() + 1);
        let delta = self.delta_in_program(&from);
        let carried = self
            .interpreter
            .frame
            .moved_in_program(&motion.from, &self.carried);
        let off = each(|axis| {
            if step[axis].is_some() {
                carried[axis] - delta[axis]
            } else {
                0.0
            }
        });
        layers.push(vec![(carried, across(&off))]);
        for &share in parts {
            let to = if share == 1.0 {
                end
            } else {
                between(&from, &end, share)
            };
            let delta = self.delta_in_program(&to);
            let mut candidates = vec![(delta, [0.0; 9])];
            for axis in 0..9 {
                let Some(step) = step[axis] else { continue };
                let exact = (to[axis] + delta[axis]) / step;
                let nearest = exact.round();
                let other = if exact > nearest {
                    nearest + 1.0
                } else {
                    nearest - 1.0
                };
                // The next line begins at the end of this one and may go anywhere.
                let numbers = if share == 1.0 {
                    vec![nearest]
                } else {
                    vec![nearest, other]
                };
                candidates = candidates
                    .iter()
                    .flat_map(|(delta, off)| {
                        numbers.iter().map(move |number| {
                            let (mut delta, mut off) = (*delta, *off);
                            delta[axis] = number * step - to[axis];
                            off[axis] = (number - exact) * step;
                            (delta, off)
                        })
                    })
                    .collect();
            }
            let layer = candidates
                .into_iter()
                .map(|(delta, off)| (delta, across(&off)));
            layers.push(layer.collect());
        }
        let counts: Vec<usize> = layers.iter().map(Vec::len).collect();
        let dot = |a: &Axes, b: &Axes| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let lengths = [0.0].iter().chain(parts).zip(parts);
        let lengths: Vec<f64> = lengths.map(|(from, to)| to - from).collect();
        // The mean square of a motion that is off by a at its beginning and b at its end, straight between.
        let found = through(&counts, |layer, from, to| {
            let (a, b) = (&layers[layer][from].1, &layers[layer + 1][to].1);
            lengths[layer] * (dot(a, a) + dot(a, b) + dot(b, b)) / 3.0
        })?;
        // The first candidate of each layer has the nearest numbers.
        let differs = found.nodes.iter().skip(1).any(|node| *node != 0);
        self.rounded_otherwise += u64::from(differs);
        let nodes = layers.iter().zip(&found.nodes).skip(1);
        Some(nodes.map(|(layer, node)| layer[*node].0).collect())
    }
}

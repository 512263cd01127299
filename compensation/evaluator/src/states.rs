//! States at which several machines of one structure are evaluated, one machine after another.

use std::collections::BTreeMap;
use std::vec::Vec;

use pulp::{Arch, Simd, WithSimd};
use volcomp_kinematics::State;
use volcomp_vocabulary::Direction;

use crate::{
    machine::{CompiledAxis, CompiledMachine},
    parts::branch_index,
    table::{Registers, WIDE, Wide},
};

/// States, and the distinct coordinates of the first three axes in them: on a grid they are few, and a table is looked up once for each.
#[derive(Clone, Debug)]
pub struct States {
    poses: Vec<State>,
    distinct: [Vec<(f64, Option<Direction>)>; 3],
    /// For each state, the place of its coordinates in `distinct`.
    places: Vec<[usize; 3]>,
}

impl States {
    /// Finds the distinct coordinates of the states (mm, rad).
    pub fn new(states: Vec<State>) -> Self {
        let mut distinct = [const { Vec::new() }; 3];
        let mut known = [const { BTreeMap::new() }; 3];
        let mut place = |axis: usize, state: &State| {
            let (q, approach) = (state.q[axis], state.approach[axis]);
            let distinct: &mut Vec<_> = &mut distinct[axis];
            *(known[axis].entry((q.to_bits(), branch_index(approach)))).or_insert_with(|| {
                distinct.push((q, approach));
                distinct.len() - 1
            })
        };
        let places = states.iter();
        let places = places.map(|state| core::array::from_fn(|axis| place(axis, state)));
        Self {
            places: places.collect(),
            distinct,
            poses: states,
        }
    }

    /// Number of states.
    pub fn len(&self) -> usize {
        self.poses.len()
    }

    /// Whether there is no state.
    pub fn is_empty(&self) -> bool {
        self.poses.is_empty()
    }
}

impl CompiledMachine {
    /// ΔP (mm) and ρ (rad) at each state, to the last digit those of [`evaluate`](Self::evaluate). On a grid of three linear axes several
    /// times faster.
    pub fn evaluate_states(&self, states: &States, errors: &mut [[f64; 6]]) {
        if let (true, [a, b, c]) = (self.three_slides, &self.axes[..]) {
            Arch::new().dispatch(OfSlides {
                machine: self,
                axes: [a, b, c],
                states,
                errors,
            });
            return;
        }
        for (state, error) in states.poses.iter().zip(errors) {
            *error = self.evaluate(state).into_six();
        }
    }
}

struct OfSlides<'a> {
    machine: &'a CompiledMachine,
    axes: [&'a CompiledAxis; 3],
    states: &'a States,
    errors: &'a mut [[f64; 6]],
}

impl WithSimd for OfSlides<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self {
            machine,
            axes,
            states,
            errors,
        } = self;
        let registers = Wide(simd);
        let mut looked_up: [Vec<[f64; WIDE]>; 3] = [const { Vec::new() }; 3];
        for ((looked_up, distinct), axis) in looked_up.iter_mut().zip(&states.distinct).zip(axes) {
            looked_up.reserve_exact(distinct.len());
            for &(q, approach) in distinct {
                let head = &axis.heads[branch_index(approach)];
                looked_up.push(registers.value(&machine.tables, head, q));
            }
        }
        let states = states.poses.iter().zip(&states.places);
        for ((state, &[k, l, m]), error) in states.zip(errors) {
            let &[x, y, z, ..] = &state.q.0;
            let of_axes = [&looked_up[0][k], &looked_up[1][l], &looked_up[2][m]];
            *error = CompiledMachine::sum_of_slides(axes, of_axes, [x, y, z], registers).into_six();
        }
    }
}

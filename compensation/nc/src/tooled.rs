//! The machine with a tool in its spindle, and its correction.

use volcomp_model::{
    Machine, Temperatures, Tolerance,
    evaluator::{CompiledMachine, Neglected, Slides},
    kinematics::State,
};

use crate::{
    NcError,
    coordinates::{Axes, AxisPlaces, is_rotary},
    correction::Correction,
    tip::with_tool,
};

/// Curves are compiled to 1 nm.
const COMPILED_TO_NM: f64 = 1.0;

/// The machine with a tool in its spindle.
#[derive(Clone, Debug)]
pub(crate) struct Tooled {
    /// What the control adds to the coordinates for the tool.
    pub(crate) offset: Axes,
    pub(crate) machine: Machine,
    pub(crate) compiled: CompiledMachine,
    /// How it corrects where no axis turns.
    slides: Option<Slides>,
    neglected: Neglected,
    /// Ways of each axis, mm and deg, with which no straight line has to be split, where the axis moves alone.
    pub(crate) unsplit: Axes,
    /// The longest lever, mm, and the most by which the error changes for each mm of the linear axes.
    pub(crate) reach_mm: f64,
    pub(crate) steepness: f64,
}

impl Tooled {
    /// The machine with the tool for which the control adds this offset.
    pub(crate) fn new(
        machine: &Machine,
        offset: &Axes,
        temperatures: &Temperatures,
        tolerance_mm: f64,
        places: &AxisPlaces,
    ) -> Result<Self, NcError> {
        let machine = with_tool(machine, offset)?;
        let compiled = machine.compile_at(Tolerance::from_nm(COMPILED_TO_NM), temperatures)?;
        let ways = compiled.short_ways(tolerance_mm);
        let unsplit = std::array::from_fn(|axis| match places.of_axis(axis) {
            Some(place) if is_rotary(axis) => ways[place].to_degrees(),
            Some(place) => ways[place],
            None => f64::INFINITY,
        });
        Ok(Self {
            offset: *offset,
            reach_mm: compiled.reach_mm(),
            steepness: compiled.steepness(),
            slides: compiled.slides(),
            neglected: compiled.neglected(),
            machine,
            compiled,
            unsplit,
        })
    }

    /// `None` for a machine with rotary axes.
    pub(crate) fn slides(&self) -> Option<&Slides> {
        self.slides.as_ref()
    }

    /// The correction of a state: of one step or two where these neglect no more than `most_mm`, else the exact one.
    pub(crate) fn correction(
        &self,
        state: &State,
        places: &AxisPlaces,
        temperatures: &Temperatures,
        most_mm: f64,
    ) -> Correction {
        let Self {
            machine, compiled, ..
        } = self;
        if let Some(slides) = &self.slides {
            // The errors are those where the axes go to.
            return Correction {
                delta: places.axes(&slides.two_steps(compiled, state)),
                follow: None,
            };
        }
        let mut parts = compiled.parts_of(state, compiled.correctors());
        let mut delta = parts.delta();
        let mut neglected_mm = self.neglected.mm(&delta);
        if neglected_mm > most_mm {
            // The errors are those where the axes go to.
            let first = delta;
            let mut there = *state;
            for (q, delta) in there.q.iter_mut().zip(&first) {
                *q += delta;
            }
            parts = compiled.parts_of(&there, compiled.correctors());
            delta = parts.delta();
            neglected_mm = self.neglected.there_mm(&first, &delta);
        }
        if neglected_mm > most_mm {
            let options = machine.correction_options();
            delta = machine.correction_at(state, temperatures, &options).delta;
        }
        let rotary = compiled.correctors().rotary();
        let follow = (!rotary.is_empty()).then(|| {
            std::array::from_fn(|rotary| match places.of_axis(3 + rotary) {
                // For each rad as the model has it, for each deg here; only linear axes follow.
                Some(place) => places.linear_axes(&parts.follow[place], 1.0_f64.to_radians()),
                None => [0.0; 9],
            })
        });
        Correction {
            delta: places.axes(&delta),
            follow,
        }
    }
}

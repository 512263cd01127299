//! Deviation of the tool of a virtual machine from its programmed path, with the original and with
//! the compensated program.
//!
//! Both programs are evaluated at the same fractions of each motion of the original one. These
//! positions depend only on the original program, so the deviation before compensation is
//! independent of the result and of all options.

use std::io::BufRead;

use volcomp_model::{Lengths, Machine, RigidSums, Temperatures, kinematics::nalgebra::Vector3};

use crate::{
    Average, NcError,
    control::Dialect,
    coordinates::{Axes, between, dot, each, is_rotary},
    correction::Corrector,
    inspect::{Collector, Inspected, Part},
    modal::{SYSTEMS, name_of_offset},
    motion::{ExecutedMotion, MotionReceiver, Move, Path, at_height},
    program::run_in_parallel,
    reversal::{Carriages, Reversals, SAME_SHARE, steps_of},
    setup::SetUp,
};

/// A program and its result on a virtual machine.
#[derive(Clone, Debug, Default, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
#[non_exhaustive]
pub struct Verification {
    /// Deviation with the original program.
    pub before: Deviation,
    /// Deviation with the compensated program.
    pub after: Deviation,
    /// Motions whose deviation is larger with the compensated program.
    pub further: Further,
    /// Number of evaluated motions; motions copied without correction do not count.
    pub motions: u64,
    /// Number of evaluated positions.
    pub places: u64,
    /// Some of the evaluated positions, evenly spread, in program order.
    #[cfg_attr(feature = "schema", serde(skip))]
    pub path: Vec<Place>,
    /// Features of the inspected part, if any.
    #[cfg_attr(feature = "schema", serde(skip))]
    pub features: Vec<Inspected>,
    /// True if any motion is in inches.
    #[cfg_attr(feature = "schema", serde(skip))]
    pub in_inches: bool,
}

/// Motions whose RMS or maximum tool deviation is larger with the result than with the original program, by more than the printed 0.01 µm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
#[non_exhaustive]
pub struct Further {
    /// Number of motions with a larger deviation.
    pub motions: u64,
    /// Maximum increase, µm.
    pub by_um: f64,
    /// Line of the maximum in the original program, counted from 1; `None` without such motions.
    pub line: Option<usize>,
}

/// Inputs of a verification other than the two programs.
#[derive(Clone, Copy, Debug)]
pub struct Virtual<'a> {
    /// The machine with the real errors.
    pub truth: &'a Machine,
    pub temperatures: &'a Temperatures,
    pub setup: &'a SetUp,
    /// Maximum number of executed blocks.
    pub most_blocks: u64,
    /// Language of the programs.
    pub dialect: Dialect,
    /// Part to be inspected, and the correction used for the result. The zero of each work offset that the set-up states is probed on the
    /// machine without correction; for the result the error of this correction at the zero is added to the work offset.
    pub part: Option<(&'a Part, &'a Corrector)>,
    /// Step of the control to which the correction is rounded, µm on linear and µrad on rotary axes; `None`: not rounded.
    pub resolution: Option<f64>,
}

/// Runs a program and its result on a virtual machine. `shares` are the ends of the parts of each motion,
/// [`Summary::shares`](crate::Summary::shares).
///
/// # Errors
/// The programs cannot be executed, or the result has other motions than the program.
pub fn verify(
    original: &mut (impl BufRead + Send),
    result: &mut (impl BufRead + Send),
    shares: &[f64],
    of: Virtual<'_>,
) -> Result<Verification, NcError> {
    compare(original, result, &mut shares.iter().copied(), of, None)
}

/// Verifies the result of [`average`](crate::average) with the mean corrections that it returned.
///
/// # Errors
/// Same as [`verify`].
pub fn verify_average(
    original: &mut (impl BufRead + Send),
    result: &mut (impl BufRead + Send),
    averages: &[Average],
    of: Virtual<'_>,
) -> Result<Verification, NcError> {
    let shares = &mut std::iter::repeat(1.0);
    compare(original, result, shares, of, Some(averages))
}

fn compare(
    original: &mut (dyn BufRead + Send),
    result: &mut (dyn BufRead + Send),
    shares: &mut dyn Iterator<Item = f64>,
    of: Virtual<'_>,
    averages: Option<&[Average]>,
) -> Result<Verification, NcError> {
    let truth = Corrector::new(of.truth, of.temperatures, 1.0)?;
    let comparison = Comparison::new(truth, &of, averages);
    let (compared, failed) = run_in_parallel(
        of.truth,
        of.temperatures,
        (of.dialect, of.most_blocks),
        vec![(original, of.setup), (result, of.setup)],
        |motions| comparison.all(&motions[0], &motions[1], shares),
    )?;
    failed.map_or(compared, Err)
}

fn other_motions(line: usize) -> NcError {
    NcError::not_compensated(
        line,
        "the result has other motions than the program: this is a bug in volcomp, please report it",
    )
}

const MAX_STORED_PLACES: usize = 20_000;

/// Number of positions evaluated per `LENGTH_MM` of a line or an arc; its length is rounded up to a multiple of
/// `LENGTH_MM`. Short lines have fewer (`DENSEST_MM`). The last position is at the end.
const PLACES: u32 = 8;

const LENGTH_MM: f64 = 100.0;

/// Distance of evaluated positions on a line too short for `PLACES` positions, mm. Over this distance errors are
/// linear.
const DENSEST_MM: f64 = 2.0;

/// Maximum number of lengths of `LENGTH_MM` per motion.
const MAX_LENGTHS: f64 = 64.0;

/// Number of simulation steps from one evaluated position of an arc to the next. An inspected circle has a point at
/// each step.
const STEPS_OF_ARC: u32 = 9;

/// Number of evaluated positions of a hole in addition to its plane R: half-way down and at its bottom.
const PLACES_OF_HOLE: u32 = 2;

/// Fraction of a motion, to either side, from which its direction is computed.
const NEAR: f64 = 1e-6;

/// Tip travel over twice `NEAR`, mm, below which the tip counts as resting: a smaller travel is a rounding error.
const RESTING_WITHIN_MM: f64 = 1e-11;

/// Minimum increase of the deviation, µm, to count a motion as worse than before.
const WORSE_BY_UM: f64 = 0.01;

#[derive(Clone, Copy, Debug)]
struct Stations {
    /// Index of the first evaluated position: 0 (fraction 0) for holes, otherwise 1.
    first: u32,
    last: u32,
    /// Every `stride`-th station is evaluated.
    stride: u32,
}

impl Stations {
    fn of(original: &ExecutedMotion) -> Self {
        let is_arc = matches!(original.motion.path, Path::Arc(_));
        match original.motion.path {
            Path::Hole { .. } => Self { first: 0, last: PLACES_OF_HOLE, stride: 1 },
            Path::Rapid => Self { first: 1, last: 1, stride: 1 },
            _ => {
                let (length_mm, Move { from, to, .. }) = (length_mm(original), &original.motion);
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "1 to 64"
                )]
                let whole = |parts: f64| (parts - SAME_SHARE).ceil().clamp(1.0, MAX_LENGTHS) as u32;
                // `length_mm` does not include the travel of the other axes.
                let is_curved = is_arc || from[3..] != to[3..];
                let places = if is_curved { PLACES } else { whole(length_mm / DENSEST_MM) };
                let stride = if is_arc { STEPS_OF_ARC } else { 1 };
                let last = whole(length_mm / LENGTH_MM) * places.min(PLACES) * stride;
                Self { first: 1, last, stride }
            }
        }
    }

    fn share(self, station: u32) -> f64 {
        f64::from(station) / f64::from(self.last)
    }

    fn is_evaluated(self, station: u32) -> bool {
        station.is_multiple_of(self.stride)
    }
}

/// Length of a line or an arc in program coordinates; rotary axes do not count.
fn length_mm(original: &ExecutedMotion) -> f64 {
    let [from, to] = &original.in_program;
    let squared = |axis: usize| (to[axis] - from[axis]).powi(2);
    match original.motion.path {
        Path::Arc(arc) => {
            let (radius, _) = arc.start(from);
            (radius * arc.turns_by).hypot(squared(arc.axes[2]).sqrt())
        }
        _ => (0..3).map(squared).sum::<f64>().sqrt(),
    }
}

#[derive(Debug)]
struct PartOfMotion {
    made: ExecutedMotion,
    from: f64,
    to: f64,
}

struct Comparison {
    truth: Corrector,
    before: Carriages,
    after: Carriages,
    turns: Reversals,
    parts: Vec<PartOfMotion>,
    /// Index of the part that the result has reached.
    at_part: usize,
    /// Completed fraction of the part that the result has reached.
    of_part: f64,
    found: Verification,
    cut: Option<Collector>,
    /// Correction of the result, if a part is inspected.
    corrector: Option<Corrector>,
    averages: Option<Vec<Average>>,
    /// [`Virtual::resolution`].
    resolution: Option<f64>,
    stated: [bool; SYSTEMS],
    /// Deviation of each probed zero from its work offset, mm in workpiece axes: with the original program, and with
    /// the result. The work offset of the result includes the modelled error at the zero.
    zeros: Vec<Option<[[f64; 3]; 2]>>,
    /// Every `stride`-th position is stored.
    stride: u64,
    /// Sums over all positions, with the original and with the compensated program.
    sums: [Sums; 2],
    /// Sums over the positions of the current motion, with both programs.
    of_motion: [Lengths; 2],
}

impl Comparison {
    pub(crate) fn new(truth: Corrector, of: &Virtual<'_>, averages: Option<&[Average]>) -> Self {
        Self {
            truth,
            averages: averages.map(<[_]>::to_vec),
            resolution: of.resolution,
            corrector: of.part.map(|(_, corrector)| corrector.clone()),
            stated: std::array::from_fn(|system| of.setup.offset(system).is_some()),
            zeros: vec![None; SYSTEMS],
            before: Carriages::default(),
            after: Carriages::default(),
            turns: Reversals::default(),
            parts: Vec::new(),
            at_part: 0,
            of_part: 0.0,
            found: Verification::default(),
            cut: of.part.map(|(part, _)| Collector::new(part.clone())),
            stride: 1,
            sums: Default::default(),
            of_motion: Default::default(),
        }
    }

    pub(crate) fn all(
        mut self,
        originals: &MotionReceiver,
        results: &MotionReceiver,
        shares: &mut dyn Iterator<Item = f64>,
    ) -> Result<Verification, NcError> {
        let mut is_first = true;
        while let Ok(original) = originals.recv() {
            if std::mem::take(&mut is_first) {
                // Start position before whole turns are added to a rotary axis.
                let Move { from, wraps, .. } = &original.motion;
                let begins = each(|axis| from[axis] - wraps[axis]);
                self.truth.start_at(&begins);
                self.before = Carriages::at(&begins);
                self.after = self.before.clone();
            }
            self.truth.take_tool(&original.tool)?;
            self.truth.apply_wraps(&original.motion.wraps);
            self.before.apply_wraps(&original.motion.wraps);
            self.take_parts(original.line, results, shares)?;
            self.take_zero(&original)?;
            self.motion(&original);
        }
        if results.recv().is_ok() {
            return Err(other_motions(0));
        }
        let found = &mut self.found;
        let [before, after] = [0, 1].map(|of| {
            let sums: &Sums = &self.sums[of];
            sums.deviation(&found.path, BEFORE_AND_AFTER[of])
        });
        (found.before, found.after) = (before, after);
        found.features = (self.cut.as_mut()).map(Collector::inspected).unwrap_or_default();
        Ok(self.found)
    }

    fn take_parts(
        &mut self,
        line: usize,
        results: &MotionReceiver,
        shares: &mut dyn Iterator<Item = f64>,
    ) -> Result<(), NcError> {
        self.parts.clear();
        let mut from = 0.0;
        while from < 1.0 {
            let (Ok(made), Some(to)) = (results.recv(), shares.next()) else {
                return Err(other_motions(line));
            };
            self.parts.push(PartOfMotion { made, from, to });
            from = to;
        }
        (self.at_part, self.of_part) = (0, 0.0);
        if let Some(part) = self.parts.first() {
            self.after.apply_wraps(&part.made.motion.wraps);
        }
        Ok(())
    }

    /// Probes the zero of the work offset that a motion cuts with, unless already done.
    fn take_zero(&mut self, original: &ExecutedMotion) -> Result<(), NcError> {
        let system = original.system;
        let is_stated = self.stated.get(system).is_some_and(|stated| *stated);
        let cuts = original.known && original.cuts_from_stated_zero;
        if !is_stated || !cuts || self.zeros[system].is_some() {
            return Ok(());
        }
        let Some(corrector) = &mut self.corrector else {
            return Ok(());
        };
        corrector.take_tool(&original.tool)?;
        let of_offset = original.frame.of_offset();
        let off_mm = match &self.averages {
            None => corrector.off_at_zero_mm(&of_offset),
            Some(averages) => {
                let name = name_of_offset(system);
                let of = averages.iter().find(|of| of.system == name);
                of.map_or([0.0; 3], |of| of.off_at_zero_mm)
            }
        };
        // A change of the work offset moves the part by the same amount.
        let off = each(|axis| off_mm.get(axis).copied().unwrap_or(0.0));
        let [zero, added] = [[0.0; 9], off].map(|at| of_offset.to_machine(&at));
        let probed = self.truth.tip_error_mm(&zero);
        let [from, to] = [&zero, &added].map(|at| self.truth.ideal_tip_mm(at));
        let left = std::array::from_fn(|i| probed[i] - (to[i] - from[i]));
        self.zeros[system] = Some([probed, left]);
        Ok(())
    }

    fn motion(&mut self, original: &ExecutedMotion) {
        let path = original.motion.path;
        if original.motion.in_machine || matches!(path, Path::Spline | Path::Other) {
            for (place, to) in original.motion.stops().enumerate() {
                self.begin_motion(&original.motion.arrives_from_unknown);
                self.truth.move_to(to);
                self.before.move_to(&self.truth, to);
                let part = self.parts.last();
                if let Some(to) = part.and_then(|part| part.made.motion.stops().nth(place)) {
                    self.after.move_to(&self.truth, to);
                }
            }
            return;
        }
        self.begin_motion(&original.motion.arrives_from_unknown);
        self.found.motions += 1;
        self.found.in_inches |= original.in_inches;
        self.of_motion = Default::default();
        let is_hole = matches!(path, Path::Hole { .. });
        let only_end = is_hole || path == Path::Rapid;
        if is_hole {
            self.truth.move_to(&place_of(original, 0.0));
        }
        let steps = steps(&self.truth, original, 1.0);
        self.turns = self.truth.turns(steps, |share| place_of(original, share));
        let begins = place_of(original, 0.0);
        let commanded = self.result_goes(0.0);
        let commanded = self.rounded(&begins, &commanded);
        if !only_end {
            self.cut(original, &begins, &commanded);
        }
        let stations = Stations::of(original);
        let mut passed = 0.0;
        for station in stations.first..=stations.last {
            let share = stations.share(station);
            // The direction of approach is that of the programmed motion; a lagging carriage is where its drive left it.
            let turned = self.turns.turns.iter();
            let turned = turned.take_while(|turn| only_end || turn.share < share - SAME_SHARE);
            let count = turned.map(|turn| self.truth.turn(turn)).count();
            self.turns.turns.drain(..count);
            for place in places(&self.truth, original, [passed, share]) {
                self.before.move_to(&self.truth, &place);
            }
            passed = share;
            let (wanted, commanded) = (place_of(original, share), self.result_goes(share));
            let commanded = self.rounded(&wanted, &commanded);
            if is_hole && station == stations.first {
                // Drilling starts at the plane R.
                self.begin_motion(&[false; 9]);
            }
            if stations.is_evaluated(station) {
                let begins = only_end && station == stations.first;
                self.evaluate(original, share, [&wanted, &commanded], begins);
            }
            // A hole is measured half-way down.
            if !is_hole || 2 * station == stations.last {
                self.cut(original, &wanted, &commanded);
            }
        }
        self.truth.set_furthest(&self.turns.furthest);
        self.truth.move_to(&original.motion.to);
        self.count_if_worse(original.line);
    }

    /// The command with its correction rounded to the resolution of the control.
    fn rounded(&self, wanted: &Axes, commanded: &Axes) -> Axes {
        let Some(resolution) = self.resolution else {
            return *commanded;
        };
        each(|axis| {
            let step =
                if is_rotary(axis) { (1e-6 * resolution).to_degrees() } else { 1e-3 * resolution };
            wanted[axis] + ((commanded[axis] - wanted[axis]) / step).round() * step
        })
    }

    fn begin_motion(&mut self, from_unknown: &Axes<bool>) {
        self.truth.begin_motion(from_unknown);
        self.before.begin_motion(from_unknown);
        self.after.begin_motion(from_unknown);
    }

    /// Advances the machine with the result to a fraction of the program's motion.
    fn result_goes(&mut self, share: f64) -> Axes {
        while let Some(part) = self.parts.get(self.at_part) {
            let is_last = self.at_part + 1 == self.parts.len();
            // A part that ends at a reversal ends before the reversal, however the two fractions
            // are rounded. A part of zero length crosses the backlash of an axis.
            let is_behind = share > part.to + SAME_SHARE && !is_last || part.to == part.from;
            let of_part = if is_behind || share >= part.to {
                1.0
            } else {
                (share - part.from) / (part.to - part.from)
            };
            for place in places(&self.truth, &part.made, [self.of_part, of_part]) {
                self.after.move_to(&self.truth, &place);
            }
            self.of_part = of_part;
            if !is_behind {
                return place_of(&part.made, of_part);
            }
            (self.at_part, self.of_part) = (self.at_part + 1, 0.0);
            if let Some(next) = self.parts.get(self.at_part) {
                self.after.apply_wraps(&next.made.motion.wraps);
            }
        }
        // Unreachable: the last part covers every fraction.
        [0.0; 9]
    }

    fn evaluate(
        &mut self,
        original: &ExecutedMotion,
        share: f64,
        [wanted, commanded]: [&Axes; 2],
        begins: bool,
    ) {
        let tip = self.truth.ideal_tip_mm(wanted);
        let um = |at: &Axes, off: &Axes| -> [f64; 3] {
            let actual = self.truth.actual_tip_mm(at, off);
            std::array::from_fn(|i| 1e3 * (actual[i] - tip[i]))
        };
        let place = Place {
            line: original.line,
            tip_mm: tip,
            before_um: um(wanted, &self.before.off),
            after_um: um(commanded, &self.after.off),
            begins,
        };
        let along = self.direction(original, share, &tip);
        let sums = self.sums.iter_mut().zip(&mut self.of_motion);
        for ((sums, of_motion), of) in sums.zip(BEFORE_AND_AFTER) {
            sums.take(&place, of, along);
            of_motion.take(&of(&place).into());
        }
        self.keep(place);
    }

    /// Direction of the tip path at a fraction of a motion, where the tip is, in workpiece axes; zero without a path.
    fn direction(&self, original: &ExecutedMotion, share: f64, tip_mm: &[f64; 3]) -> [f64; 3] {
        if original.motion.path == Path::Rapid {
            return [0.0; 3];
        }
        let tip_at = |share: f64| self.truth.ideal_tip_mm(&place_of(original, share));
        let before = tip_at((share - NEAR).max(0.0));
        let behind = if share == 1.0 { *tip_mm } else { tip_at((share + NEAR).min(1.0)) };
        let way: [f64; 3] = std::array::from_fn(|i| behind[i] - before[i]);
        let length = dot(way, way).sqrt();
        // The rounding error of a resting tip is not a direction.
        if length < RESTING_WITHIN_MM {
            return [0.0; 3];
        }
        way.map(|way| way / length)
    }

    /// Counts the motion just evaluated if the result deviates more than the program.
    fn count_if_worse(&mut self, line: usize) {
        let [before, after] = &self.of_motion;
        let by_um = (after.rms() - before.rms()).max(after.max() - before.max());
        if by_um <= WORSE_BY_UM {
            return;
        }
        let further = &mut self.found.further;
        further.motions += 1;
        if by_um > further.by_um {
            (further.by_um, further.line) = (by_um, Some(line));
        }
    }

    fn cut(&mut self, original: &ExecutedMotion, wanted: &Axes, commanded: &Axes) {
        let path = original.motion.path;
        let Some(cut) = self.cut.as_mut().filter(|_| path != Path::Rapid) else {
            return;
        };
        let truth = &self.truth;
        let zero = self.zeros.get(original.system).copied().flatten();
        let zero = zero.filter(|_| original.cuts_from_stated_zero);
        let [before, after] = zero.unwrap_or_default();
        let from_zero = |at: [f64; 3], zero: [f64; 3]| std::array::from_fn(|i| at[i] - zero[i]);
        cut.take(original.line, matches!(path, Path::Hole { .. }), |above_mm| {
            [
                truth.ideal_on_tool_mm(wanted, above_mm),
                from_zero(truth.on_tool_mm(wanted, &self.before.off, above_mm), before),
                from_zero(truth.on_tool_mm(commanded, &self.after.off, above_mm), after),
            ]
        });
    }

    fn keep(&mut self, place: Place) {
        let found = &mut self.found;
        if found.places.is_multiple_of(self.stride) || place.begins {
            found.path.push(place);
        }
        found.places += 1;
        if found.path.len() >= MAX_STORED_PLACES {
            self.stride *= 2;
            let mut keeps = false;
            found.path.retain(|_| {
                keeps = !keeps;
                keeps
            });
        }
    }
}

/// A position on the path, in workpiece axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Place {
    /// Line of the original program.
    pub line: usize,
    /// Nominal tip position, mm from the workpiece origin.
    pub tip_mm: [f64; 3],
    /// Tip deviation with the original program, µm.
    pub before_um: [f64; 3],
    /// Tip deviation with the compensated program, µm.
    pub after_um: [f64; 3],
    /// True at the end of a rapid motion and in the plane R of a hole: no path leads there from the previous position.
    pub begins: bool,
}

/// Tool deviation over a whole program.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
#[non_exhaustive]
pub struct Deviation {
    /// Maximum distance of the tip from its nominal position, µm.
    pub max_um: f64,
    /// RMS over all evaluated positions, µm.
    pub rms_um: f64,
    /// Maximum distance perpendicular to the path, µm; a deviation along the path changes only when the tip passes. At the ends of rapid
    /// motions and at rest there is no path, and the whole distance counts.
    pub across_max_um: f64,
    /// RMS distance perpendicular to the path, µm.
    pub across_rms_um: f64,
    /// Line of the original program with the maximum distance.
    pub line: usize,
    /// Nominal tip position there, mm from the workpiece origin in workpiece axes.
    pub tip_mm: [f64; 3],
    /// RMS distance after best-fit rigid-body alignment of the part, µm.
    pub form_rms_um: f64,
    /// Maximum distance after this alignment, µm, over the stored positions ([`Verification::path`](crate::Verification::path)) and those
    /// with the maximum deviation along an axis.
    pub form_max_um: f64,
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Sums {
    whole: Lengths,
    across: Lengths,
    line: usize,
    tip_mm: [f64; 3],
    form: RigidSums,
    farthest: [Option<Place>; 6],
}

impl Sums {
    /// Adds a position; `along` is the unit direction of the path there, or zero without a path.
    pub(crate) fn take(&mut self, place: &Place, of: DeviationOf, along: [f64; 3]) {
        let deviation_um = of(place);
        let largest = self.whole.max();
        self.whole.take(&deviation_um.into());
        if self.line == 0 || self.whole.max() > largest {
            (self.line, self.tip_mm) = (place.line, place.tip_mm);
        }
        let by = dot(deviation_um, along);
        let across: [f64; 3] = std::array::from_fn(|i| deviation_um[i] - by * along[i]);
        self.across.take(&across.into());
        let [tip_mm, error_mm] = in_mm(place, of);
        self.form.take(&tip_mm, &error_mm);
        for (side, kept) in self.farthest.iter_mut().enumerate() {
            let towards = |um: [f64; 3]| if side < 3 { um[side] } else { -um[side - 3] };
            if kept.is_none_or(|kept| towards(deviation_um) > towards(of(&kept))) {
                *kept = Some(*place);
            }
        }
    }

    /// Evaluates the sums; `path` are the stored positions.
    pub(crate) fn deviation(&self, path: &[Place], of: DeviationOf) -> Deviation {
        let motion = self.form.motion();
        let mut left = Lengths::default();
        for place in path.iter().chain(self.farthest.iter().flatten()) {
            let [tip_mm, error_mm] = in_mm(place, of);
            left.take(&motion.left_mm(&tip_mm, &error_mm));
        }
        Deviation {
            max_um: self.whole.max(),
            rms_um: self.whole.rms(),
            across_max_um: self.across.max(),
            across_rms_um: self.across.rms(),
            line: self.line,
            tip_mm: self.tip_mm,
            form_rms_um: 1e3 * self.form.rms_left_mm(),
            form_max_um: 1e3 * left.max(),
        }
    }
}

/// Selects a deviation of a position, µm.
type DeviationOf = fn(&Place) -> [f64; 3];

const BEFORE_AND_AFTER: [DeviationOf; 2] = [|place| place.before_um, |place| place.after_um];

fn in_mm(place: &Place, of: DeviationOf) -> [Vector3<f64>; 2] {
    [place.tip_mm, of(place).map(|um| 1e-3 * um)].map(Vector3::from)
}

/// Axis positions at a fraction of a motion; for a hole, on its way down from plane R.
pub(crate) fn place_of(made: &ExecutedMotion, share: f64) -> Axes {
    let ExecutedMotion { motion, frame, .. } = made;
    let [from, to] = &made.in_program;
    match motion.path {
        Path::Arc(arc) => frame.to_machine(&arc.place(from, to, share)),
        Path::Hole { bottom, clearance, depth } => {
            let height = clearance + share * (bottom - clearance);
            frame.to_machine(&at_height(to, depth, height))
        }
        _ if share == 1.0 => motion.to,
        _ => frame.to_machine(&between(from, to, share)),
    }
}

/// Positions between two fractions of a motion, so close together that no axis reversal is missed; the last one is at
/// the end.
pub(crate) fn places<'a>(
    truth: &Corrector,
    made: &'a ExecutedMotion,
    [from, to]: [f64; 2],
) -> impl Iterator<Item = Axes> + use<'a> {
    let steps = if truth.bidirectional { steps(truth, made, to - from) } else { 1 };
    (1..=steps).map(move |step| {
        let share = from + (to - from) * f64::from(step) / f64::from(steps);
        place_of(made, if step == steps { to } else { share })
    })
}

/// Number of steps with which no axis reversal of a motion is missed.
pub(crate) fn steps(truth: &Corrector, made: &ExecutedMotion, share: f64) -> u32 {
    let ExecutedMotion { motion, frame, .. } = made;
    let [from, to] = &made.in_program;
    let mut steps = 1.0_f64;
    if let Path::Arc(arc) = motion.path {
        let (radius, _) = arc.start(from);
        // Sagitta of the whole arc, approximated by a parabola.
        let turns = arc.turns_by.abs() * share;
        steps = steps_of(0.125 * radius * turns * turns);
    }
    if frame.tip.is_some() {
        let turned: f64 = (3..6)
            .filter(|axis| is_rotary(*axis))
            .map(|axis| (motion.to[axis] - motion.from[axis]).abs().to_radians())
            .sum();
        let way: f64 = (0..3).map(|axis| (to[axis] - from[axis]).powi(2)).sum();
        let bulge = truth.bulge_mm(share * turned, share * way.sqrt());
        steps = steps.max(steps_of(bulge));
    }
    #[expect(clippy::cast_possible_truncation, clippy::cast_sign_loss, reason = "1 to 1024")]
    let whole = steps.ceil() as u32;
    whole
}

//! The motions of a program and of its result, compared at the same shares of each motion of the program. Where these places are is a
//! matter of the program alone, so that what is found before is the same whatever the result is and whatever else is asked for.

use std::sync::mpsc::Receiver;

use crate::{
    Average, NcError,
    carriage::Carriages,
    coordinates::Axes,
    correction::Corrector,
    deviation::{BEFORE_AND_AFTER, MaxAndSquares, Place, Sums},
    inspect::Collector,
    made::{Made, place_of, places, steps},
    modal::SYSTEMS,
    motion::{Move, Path},
    setup::name_of_offset,
    turns::{SAME, Turns},
    vector::dot,
    verify::{Verification, Virtual, other_motions},
    words::each,
};

/// Places of a path that are kept at the most.
const MOST_PLACES: usize = 20_000;
/// On a line or an arc so many places are looked at for each of these lengths that it begins, the last one at its end.
const PLACES: u32 = 8;
const LENGTH_MM: f64 = 100.0;
/// As if no motion were longer than so many lengths.
const MOST_LENGTHS: f64 = 64.0;
/// Between two places of an arc the machine is followed in so many steps, and a circle that is to be inspected is cut in each of them.
const STEPS_OF_ARC: u32 = 9;
/// The places of a hole besides its plane R: half-way down and at its bottom.
const PLACES_OF_HOLE: u32 = 2;
/// The share of a motion over which its direction is taken.
const NEAR: f64 = 1e-6;
/// A tip that goes less far, mm, within twice that share stands still but for the rounding of numbers.
const STANDS_STILL_MM: f64 = 1e-11;
/// Motions that are further off than before by less are not: µm.
const SEEN_UM: f64 = 0.01;

/// Where a motion is followed: at equal shares of it.
#[derive(Clone, Copy, Debug)]
struct Stations {
    /// Which is the first one: share 0 is followed by holes only.
    first: u32,
    last: u32,
    /// At each so many one is looked at.
    stride: u32,
}

impl Stations {
    fn of(original: &Made) -> Self {
        let is_arc = matches!(original.motion.path, Path::Arc(_));
        match original.motion.path {
            Path::Hole { .. } => Self {
                first: 0,
                last: PLACES_OF_HOLE,
                stride: 1,
            },
            Path::Rapid => Self {
                first: 1,
                last: 1,
                stride: 1,
            },
            _ => {
                let lengths = (length_mm(original) / LENGTH_MM).clamp(1.0, MOST_LENGTHS);
                #[expect(
                    clippy::cast_possible_truncation,
                    clippy::cast_sign_loss,
                    reason = "1 to 64"
                )]
                let lengths = (lengths - SAME).ceil().max(1.0) as u32;
                let stride = if is_arc { STEPS_OF_ARC } else { 1 };
                Self {
                    first: 1,
                    last: lengths * PLACES * stride,
                    stride,
                }
            }
        }
    }

    fn share(self, station: u32) -> f64 {
        f64::from(station) / f64::from(self.last)
    }

    fn is_looked_at(self, station: u32) -> bool {
        station.is_multiple_of(self.stride)
    }
}

/// How long a line or an arc is in the coordinates of the program; rotary axes do not count.
fn length_mm(original: &Made) -> f64 {
    let Made { motion, frame, .. } = original;
    let [from, to] = [&motion.from, &motion.to].map(|at| frame.to_program(at));
    let squared = |axis: usize| (to[axis] - from[axis]).powi(2);
    match motion.path {
        Path::Arc(arc) => {
            let (radius, _) = arc.start(&from);
            (radius * arc.turns_by).hypot(squared(arc.axes[2]).sqrt())
        }
        _ => (0..3).map(squared).sum::<f64>().sqrt(),
    }
}

/// A motion of the result, which is the part of a motion of the program from one share of it to another.
#[derive(Debug)]
struct Part {
    made: Made,
    from: f64,
    to: f64,
}

/// State: the virtual machine, and what was found.
pub(crate) struct Comparison {
    truth: Corrector,
    /// With the original program, and the result.
    before: Carriages,
    after: Carriages,
    /// Where axes turn on the rest of the motion that is looked at.
    turns: Turns,
    /// The parts of the motion, in which of them the result is, and how far in it.
    parts: Vec<Part>,
    at_part: usize,
    of_part: f64,
    found: Verification,
    cut: Option<Collector>,
    /// The correction of the result, and the work offsets that the set-up states.
    corrector: Option<Corrector>,
    /// The mean corrections, where the result has these in its work offsets.
    averages: Option<Vec<Average>>,
    stated: [bool; SYSTEMS],
    /// How far a zero lies beside its work offset that was probed on the machine with its errors, with the original program and with the result, to
    /// whose work offset the error there was added; mm in workpiece axes.
    zeros: Vec<Option<[[f64; 3]; 2]>>,
    /// Of so many places one is kept.
    stride: u64,
    /// With the original and with the compensated program: all places, and those of the motion.
    sums: [Sums; 2],
    of_motion: [MaxAndSquares; 2],
}

impl Comparison {
    pub(crate) fn new(truth: Corrector, of: &Virtual<'_>, averages: Option<&[Average]>) -> Self {
        Self {
            truth,
            averages: averages.map(<[_]>::to_vec),
            corrector: of.part.map(|(_, corrector)| corrector.clone()),
            stated: std::array::from_fn(|system| of.setup.offset(system).is_some()),
            zeros: vec![None; SYSTEMS],
            before: Carriages::default(),
            after: Carriages::default(),
            turns: Turns::default(),
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
        originals: &Receiver<Made>,
        results: &Receiver<Made>,
        shares: &mut dyn Iterator<Item = f64>,
    ) -> Result<Verification, NcError> {
        let mut is_first = true;
        while let Ok(original) = originals.recv() {
            if std::mem::take(&mut is_first) {
                // Before a rotary axis gets another number.
                let Move { from, wraps, .. } = &original.motion;
                let begins = each(|axis| from[axis] - wraps[axis]);
                self.truth.begins(&begins);
                self.before = Carriages::at(&begins);
                self.after = self.before.clone();
            }
            self.truth.take_tool(&original.tool)?;
            self.truth.wraps(&original.motion.wraps);
            self.before.wraps(&original.motion.wraps);
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
        found.features = (self.cut.as_mut())
            .map(Collector::inspected)
            .unwrap_or_default();
        Ok(self.found)
    }

    /// The motions of the result that are parts of the next motion of the program.
    fn take_parts(
        &mut self,
        line: usize,
        results: &Receiver<Made>,
        shares: &mut dyn Iterator<Item = f64>,
    ) -> Result<(), NcError> {
        self.parts.clear();
        let mut from = 0.0;
        while from < 1.0 {
            let (Ok(made), Some(to)) = (results.recv(), shares.next()) else {
                return Err(other_motions(line));
            };
            self.parts.push(Part { made, from, to });
            from = to;
        }
        (self.at_part, self.of_part) = (0, 0.0);
        if let Some(part) = self.parts.first() {
            self.after.wraps(&part.made.motion.wraps);
        }
        Ok(())
    }

    /// Probes the zero of the work offset with which a motion cuts, if it was not yet.
    fn take_zero(&mut self, original: &Made) -> Result<(), NcError> {
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
        // What is added to the work offset moves the part by as much.
        let off = each(|axis| off_mm.get(axis).copied().unwrap_or(0.0));
        let [zero, added] = [[0.0; 9], off].map(|at| of_offset.to_machine(&at));
        let probed = self.truth.tip_error_mm(&zero);
        let [from, to] = [&zero, &added].map(|at| self.truth.ideal_tip_mm(at));
        let left = std::array::from_fn(|i| probed[i] - (to[i] - from[i]));
        self.zeros[system] = Some([probed, left]);
        Ok(())
    }

    /// A motion of the program.
    fn motion(&mut self, original: &Made) {
        let path = original.motion.path;
        if original.motion.in_machine || matches!(path, Path::Spline | Path::Other) {
            self.truth.goes(&original.motion.to);
            self.before.go(&self.truth, &original.motion.to);
            if let Some(part) = self.parts.last() {
                self.after.go(&self.truth, &part.made.motion.to);
            }
            return;
        }
        self.found.motions += 1;
        self.found.in_inches |= original.in_inches;
        self.of_motion = Default::default();
        let is_hole = matches!(path, Path::Hole { .. });
        let only_end = is_hole || path == Path::Rapid;
        if is_hole {
            self.truth.goes(&place_of(original, 0.0));
        }
        let steps = steps(&self.truth, original, 1.0);
        self.turns = self.truth.turns(steps, |share| place_of(original, share));
        let begins = self.result_goes(0.0);
        if !only_end {
            self.cut(original, &place_of(original, 0.0), &begins);
        }
        let stations = Stations::of(original);
        let mut passed = 0.0;
        for station in stations.first..=stations.last {
            let share = stations.share(station);
            // The side from which an axis comes is that of the programmed motion; a carriage that lags is where its drive left it.
            let turned = self.turns.turns.iter();
            let turned = turned.take_while(|turn| only_end || turn.share < share - SAME);
            let count = turned.map(|turn| self.truth.turn(turn)).count();
            self.turns.turns.drain(..count);
            for place in places(&self.truth, original, [passed, share]) {
                self.before.go(&self.truth, &place);
            }
            passed = share;
            let (wanted, commanded) = (place_of(original, share), self.result_goes(share));
            if stations.is_looked_at(station) {
                let begins = only_end && station == stations.first;
                self.look(original, share, [&wanted, &commanded], begins);
            }
            // A hole is measured half-way down.
            if !is_hole || 2 * station == stations.last {
                self.cut(original, &wanted, &commanded);
            }
        }
        self.truth.reaches(&self.turns.furthest);
        self.truth.goes(&original.motion.to);
        self.judge(original.line);
    }

    /// The result goes on to a share of the motion of the program; where its axes are commanded to there.
    fn result_goes(&mut self, share: f64) -> Axes {
        while let Some(part) = self.parts.get(self.at_part) {
            let is_last = self.at_part + 1 == self.parts.len();
            // A part that ends where an axis turns ends before it does, however the two shares are rounded. One that begins where it ends
            // takes up the play of an axis.
            let is_behind = share > part.to + SAME && !is_last || part.to == part.from;
            let of_part = if is_behind || share >= part.to {
                1.0
            } else {
                (share - part.from) / (part.to - part.from)
            };
            for place in places(&self.truth, &part.made, [self.of_part, of_part]) {
                self.after.go(&self.truth, &place);
            }
            self.of_part = of_part;
            if !is_behind {
                return place_of(&part.made, of_part);
            }
            (self.at_part, self.of_part) = (self.at_part + 1, 0.0);
            if let Some(next) = self.parts.get(self.at_part) {
                self.after.wraps(&next.made.motion.wraps);
            }
        }
        // There is a last part, which ends behind every share.
        [0.0; 9]
    }

    /// Looks at a place of the motion.
    fn look(&mut self, original: &Made, share: f64, [wanted, commanded]: [&Axes; 2], begins: bool) {
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
        let along = self.direction(original, share);
        let sums = self.sums.iter_mut().zip(&mut self.of_motion);
        for ((sums, of_motion), of) in sums.zip(BEFORE_AND_AFTER) {
            sums.take(&place, of, along);
            of_motion.take(dot(of(&place), of(&place)));
        }
        self.keep(place);
    }

    /// The direction of the path of the tip at a share of a motion, in workpiece axes; zero where there is none.
    fn direction(&self, original: &Made, share: f64) -> [f64; 3] {
        if original.motion.path == Path::Rapid {
            return [0.0; 3];
        }
        let [before, behind] = [(share - NEAR).max(0.0), (share + NEAR).min(1.0)]
            .map(|share| self.truth.ideal_tip_mm(&place_of(original, share)));
        let way: [f64; 3] = std::array::from_fn(|i| behind[i] - before[i]);
        let length = dot(way, way).sqrt();
        // What rounding makes of a tip that stands still is no direction.
        if length < STANDS_STILL_MM {
            return [0.0; 3];
        }
        way.map(|way| way / length)
    }

    /// Whether the tool is further off with the result on the motion that has ended.
    fn judge(&mut self, line: usize) {
        let [before, after] = &self.of_motion;
        let by_um = (after.rms() - before.rms()).max(after.max() - before.max());
        if by_um <= SEEN_UM {
            return;
        }
        let further = &mut self.found.further;
        further.motions += 1;
        if by_um > further.by_um {
            (further.by_um, further.line) = (by_um, Some(line));
        }
    }

    /// What the tool cuts where it is.
    fn cut(&mut self, original: &Made, wanted: &Axes, commanded: &Axes) {
        let path = original.motion.path;
        let Some(cut) = self.cut.as_mut().filter(|_| path != Path::Rapid) else {
            return;
        };
        let truth = &self.truth;
        let zero = self.zeros.get(original.system).copied().flatten();
        let zero = zero.filter(|_| original.cuts_from_stated_zero);
        let [before, after] = zero.unwrap_or_default();
        let from_zero = |at: [f64; 3], zero: [f64; 3]| std::array::from_fn(|i| at[i] - zero[i]);
        cut.take(
            original.line,
            matches!(path, Path::Hole { .. }),
            |above_mm| {
                [
                    truth.ideal_on_tool_mm(wanted, above_mm),
                    from_zero(truth.on_tool_mm(wanted, &self.before.off, above_mm), before),
                    from_zero(
                        truth.on_tool_mm(commanded, &self.after.off, above_mm),
                        after,
                    ),
                ]
            },
        );
    }

    /// Keeps some of the places, evenly spread.
    fn keep(&mut self, place: Place) {
        let found = &mut self.found;
        if found.places.is_multiple_of(self.stride) || place.begins {
            found.path.push(place);
        }
        found.places += 1;
        if found.path.len() >= MOST_PLACES {
            self.stride *= 2;
            let mut keeps = false;
            found.path.retain(|_| {
                keeps = !keeps;
                keeps
            });
        }
    }
}

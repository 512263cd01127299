//! How far the tool of a virtual machine is from where a program wants it, with the program as it is and with its result.

use std::{
    io::{self, BufRead},
    sync::mpsc::{Receiver, SyncSender, sync_channel},
    thread,
};

use volcomp_model::{
    Lengths, Machine, RigidSums, Temperatures, Thermal, kinematics::nalgebra::Vector3,
};

use crate::{
    Decimals, NcError,
    carriage::Carriages,
    coordinates::Axes,
    correction::Corrector,
    dialect::Dialect,
    inspect::{Collector, Inspected},
    made::{Made, place_of, places, steps},
    motion::{Move, Path},
    part_file::Part,
    program::execute,
    rewrite::Rewriter,
    setup::SetUp,
    turns::{SAME, Turns},
    words::each,
};

/// Motions that wait between two threads.
pub(crate) const WAITING: usize = 1024;
/// Places of a path that are kept at the most.
const MOST_PLACES: usize = 20_000;
/// Within each part of a motion so many places are looked at, the last one at its end.
const PLACES_OF_PART: u32 = 8;
/// The same of a hole, besides its plane R: half-way down and at its bottom.
const PLACES_OF_HOLE: u32 = 2;
/// The same of an arc whose form is to be inspected.
const PLACES_OF_ARC: u32 = 72;

/// A place of the path, in workpiece axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Place {
    /// The line of the original program.
    pub line: usize,
    /// Where the program wants the tip of the tool, mm from the workpiece origin.
    pub tip_mm: [f64; 3],
    /// How far from there the tip is with the original program, µm.
    pub before_um: [f64; 3],
    /// How far from there the tip is with the compensated program, µm.
    pub after_um: [f64; 3],
    /// It is the end of a rapid motion, or the plane R of a hole: no path leads to it from the place before.
    pub begins: bool,
}

/// The deviation of a whole program.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Deviation {
    /// The largest distance of the tip from where it belongs, µm.
    pub max_um: f64,
    /// The root of the mean of its squares over all places that were looked at, µm.
    pub rms_um: f64,
    /// Where it is largest: the line of the original program.
    pub line: usize,
    /// Where the tip is to be there, mm from the workpiece origin in workpiece axes.
    pub tip_mm: [f64; 3],
    /// The root of the mean square beside the best rigid motion of the part, µm: how the part lies on the table is no error of it.
    pub form_rms_um: f64,
    /// The largest distance beside that motion, µm, over the places that are kept (see [`Verification::path`]) and those where the
    /// deviation along an axis is largest.
    pub form_max_um: f64,
}

impl Deviation {
    fn take(&mut self, place: &Place, deviation_um: &[f64; 3]) {
        let squared: f64 = deviation_um.iter().map(|x| x * x).sum();
        // The sum, until all is there.
        self.rms_um += squared;
        if squared.sqrt() > self.max_um || self.line == 0 {
            (self.max_um, self.line, self.tip_mm) = (squared.sqrt(), place.line, place.tip_mm);
        }
    }
}

/// A program and its result on a virtual machine.
#[derive(Clone, Debug, Default, PartialEq)]
#[non_exhaustive]
pub struct Verification {
    /// With the original program.
    pub before: Deviation,
    /// With the compensated program.
    pub after: Deviation,
    /// Motions that were looked at; those that pass on without a correction are not among them.
    pub motions: u64,
    /// Places on them that were looked at.
    pub places: u64,
    /// Some of these places, evenly spread, in the order of the program.
    pub path: Vec<Place>,
    /// The features of the part, if one is to be inspected.
    pub features: Vec<Inspected>,
    /// Any of the motions is written in inches.
    pub in_inches: bool,
}

/// What a verification needs to know besides the two programs.
#[derive(Clone, Copy, Debug)]
pub struct Virtual<'a> {
    /// The machine whose errors are the real ones.
    pub truth: &'a Machine,
    /// The temperatures of the machine.
    pub temperatures: &'a Temperatures,
    /// What the programs rely on.
    pub setup: &'a SetUp,
    /// Blocks that are executed at the most.
    pub most_blocks: u64,
    /// The language of the programs.
    pub dialect: Dialect,
    /// The part whose features are to be inspected.
    pub part: Option<&'a Part>,
}

/// Runs a program and its result through a virtual machine. `shares` are those of
/// [`Summary`](crate::Summary): in which parts each motion was written.
///
/// # Errors
/// What executing the programs says; a result whose motions are others than those of the program.
pub fn verify(
    original: &mut (impl BufRead + Send),
    result: &mut (impl BufRead + Send),
    shares: &[f64],
    of: Virtual<'_>,
) -> Result<Verification, NcError> {
    compare(original, result, &mut shares.iter().copied(), of)
}

/// The same of a result in which each motion is what it was: that of [`average`](crate::average).
///
/// # Errors
/// As [`verify`].
pub fn verify_average(
    original: &mut (impl BufRead + Send),
    result: &mut (impl BufRead + Send),
    of: Virtual<'_>,
) -> Result<Verification, NcError> {
    compare(original, result, &mut std::iter::repeat(1.0), of)
}

fn compare(
    original: &mut (impl BufRead + Send),
    result: &mut (impl BufRead + Send),
    shares: &mut dyn Iterator<Item = f64>,
    of: Virtual<'_>,
) -> Result<Verification, NcError> {
    // Executed on a machine without errors: no line is changed.
    let mut ideal = of.truth.clone();
    ideal.clear_errors();
    ideal.set_thermal(Thermal::default())?;
    let ideal = Corrector::new(&ideal, of.temperatures, 1.0)?;
    let truth = Corrector::new(of.truth, of.temperatures, 1.0)?;
    thread::scope(|scope| {
        let (to_original, originals) = sync_channel(WAITING);
        let (to_result, results) = sync_channel(WAITING);
        let ideal = &ideal;
        let runs = [
            scope.spawn(move || {
                motions(
                    original,
                    ideal,
                    of.setup,
                    (of.dialect, of.most_blocks),
                    to_original,
                )
            }),
            scope.spawn(move || {
                motions(
                    result,
                    ideal,
                    of.setup,
                    (of.dialect, of.most_blocks),
                    to_result,
                )
            }),
        ];
        let compared = Comparison::new(truth, of.part).all(&originals, &results, shares);
        // Whoever still sends is told that nobody listens.
        drop((originals, results));
        for run in runs {
            match run.join() {
                Ok(Err(error)) if !is_end(&error) => return Err(error),
                Ok(_) => {}
                Err(panic) => std::panic::resume_unwind(panic),
            }
        }
        compared
    })
}

/// A run that was stopped since nobody listens any more.
pub(crate) fn is_end(error: &NcError) -> bool {
    matches!(error, NcError::Io(error) if error.kind() == io::ErrorKind::BrokenPipe)
}

/// Sends the motions of a program, one after the other.
pub(crate) fn motions(
    program: &mut impl BufRead,
    ideal: &Corrector,
    setup: &SetUp,
    (dialect, most_blocks): (Dialect, u64),
    to: SyncSender<Made>,
) -> Result<(), NcError> {
    let mut rewriter = Rewriter::new(setup, ideal.clone(), Decimals::default(), dialect)?;
    rewriter.tells = Some(to);
    execute(program, &mut io::sink(), rewriter, most_blocks, |_| Ok(()))?;
    Ok(())
}

/// State: the virtual machine, and what was found.
struct Comparison {
    truth: Corrector,
    /// With the original and with the compensated program.
    before: Carriages,
    after: Carriages,
    /// Where axes turn on the rest of the motion that is looked at.
    turns: Turns,
    found: Verification,
    cut: Option<Collector>,
    /// Of so many places one is kept.
    stride: u64,
    /// With the original and with the compensated program.
    forms: [FormOfPath; 2],
}

/// State: the deviations of all places, for what is left of them beside the best rigid motion.
#[derive(Default)]
struct FormOfPath {
    sums: RigidSums,
    /// The places where the deviation towards plus and minus X, Y and Z is largest.
    farthest: [Option<Place>; 6],
}

impl FormOfPath {
    fn take(&mut self, place: &Place, of: DeviationOf) {
        let deviation_um = of(place);
        let [tip_mm, error_mm] = in_mm(place, of);
        self.sums.take(&tip_mm, &error_mm);
        for (side, kept) in self.farthest.iter_mut().enumerate() {
            let towards = |um: [f64; 3]| if side < 3 { um[side] } else { -um[side - 3] };
            if kept.is_none_or(|kept| towards(deviation_um) > towards(of(&kept))) {
                *kept = Some(*place);
            }
        }
    }

    /// Root of the mean square, and the largest over these places and the farthest, µm.
    fn left_um(&self, path: &[Place], of: DeviationOf) -> [f64; 2] {
        let motion = self.sums.motion();
        let mut left = Lengths::default();
        for place in path.iter().chain(self.farthest.iter().flatten()) {
            let [tip_mm, error_mm] = in_mm(place, of);
            left.take(&motion.left_mm(&tip_mm, &error_mm));
        }
        [1e3 * self.sums.rms_left_mm(), 1e3 * left.max()]
    }
}

/// Which deviation of a place, µm.
type DeviationOf = fn(&Place) -> [f64; 3];

const BEFORE_AND_AFTER: [DeviationOf; 2] = [|place| place.before_um, |place| place.after_um];

/// A place and a deviation there, mm.
fn in_mm(place: &Place, of: DeviationOf) -> [Vector3<f64>; 2] {
    [place.tip_mm, of(place).map(|um| 1e-3 * um)].map(Vector3::from)
}

impl Comparison {
    fn new(truth: Corrector, part: Option<&Part>) -> Self {
        Self {
            truth,
            before: Carriages::default(),
            after: Carriages::default(),
            turns: Turns::default(),
            found: Verification::default(),
            cut: part.cloned().map(Collector::new),
            stride: 1,
            forms: Default::default(),
        }
    }

    fn all(
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
            let mut passed = 0.0;
            while passed < 1.0 {
                let (Ok(result), Some(share)) = (results.recv(), shares.next()) else {
                    return Err(other_motions(original.line));
                };
                self.after.wraps(&result.motion.wraps);
                self.part(&original, &result, [passed, share]);
                passed = share;
            }
        }
        if results.recv().is_ok() {
            return Err(other_motions(0));
        }
        let places = (self.found.places as f64).max(1.0);
        let Verification {
            before,
            after,
            path,
            ..
        } = &mut self.found;
        let both = [before, after].into_iter().zip(&self.forms);
        for ((deviation, form), of) in both.zip(BEFORE_AND_AFTER) {
            deviation.rms_um = (deviation.rms_um / places).sqrt();
            [deviation.form_rms_um, deviation.form_max_um] = form.left_um(path, of);
        }
        self.found.features = (self.cut.as_mut())
            .map(Collector::inspected)
            .unwrap_or_default();
        Ok(self.found)
    }

    /// A part of a motion from one share of it to another, which is a motion of its own in the result.
    fn part(&mut self, original: &Made, result: &Made, [from, to]: [f64; 2]) {
        let path = original.motion.path;
        if original.motion.in_machine || path == Path::Other {
            self.truth.goes(&original.motion.to);
            self.before.go(&self.truth, &original.motion.to);
            self.after.go(&self.truth, &result.motion.to);
            return;
        }
        self.found.motions += u64::from(to == 1.0);
        self.found.in_inches |= original.in_inches;
        let is_hole = matches!(path, Path::Hole { .. });
        let only_end = is_hole || path == Path::Rapid;
        if to == from {
            // The play of an axis is taken up.
            for place in places(&self.truth, result, [0.0, 1.0]) {
                self.after.go(&self.truth, &place);
            }
            return;
        }
        // A circle that stays one block is to show its form.
        let is_arc = matches!(path, Path::Arc(_));
        let last = match self.cut {
            _ if is_hole => PLACES_OF_HOLE,
            Some(_) if is_arc => PLACES_OF_ARC,
            _ => PLACES_OF_PART,
        };
        let first = match path {
            Path::Hole { .. } => 0,
            Path::Rapid => last,
            _ => 1,
        };
        if is_hole {
            self.truth.goes(&place_of(original, 0.0));
        }
        if from == 0.0 {
            let steps = steps(&self.truth, original, 1.0);
            let turns = |share| place_of(original, share);
            self.turns = self.truth.turns(steps, turns);
        }
        let (mut passed, mut passed_of_part) = (from, 0.0);
        for place in first..=last {
            let of_part = f64::from(place) / f64::from(last);
            let share = if place == last {
                to
            } else {
                from + of_part * (to - from)
            };
            let wanted = place_of(original, share);
            let commanded = place_of(result, of_part);
            // The side from which an axis comes is that of the programmed motion; a carriage that lags is where its drive left it.
            if from == 0.0 && place == first && !only_end {
                self.cut(original, &place_of(original, 0.0), &place_of(result, 0.0));
            }
            let turned = self.turns.turns.iter();
            // A part that ends where an axis turns ends before it does, however the two shares are rounded.
            let turned = turned.take_while(|turn| only_end || turn.share < share - SAME);
            let count = turned.map(|turn| self.truth.turn(turn)).count();
            self.turns.turns.drain(..count);
            for place in places(&self.truth, original, [passed, share]) {
                self.before.go(&self.truth, &place);
            }
            for place in places(&self.truth, result, [passed_of_part, of_part]) {
                self.after.go(&self.truth, &place);
            }
            (passed, passed_of_part) = (share, of_part);
            let tip = self.truth.ideal_tip_mm(&wanted);
            let um = |at: &Axes, off: &Axes| -> [f64; 3] {
                let actual = self.truth.actual_tip_mm(at, off);
                std::array::from_fn(|i| 1e3 * (actual[i] - tip[i]))
            };
            let found = Place {
                line: original.line,
                tip_mm: tip,
                before_um: um(&wanted, &self.before.off),
                after_um: um(&commanded, &self.after.off),
                begins: only_end && place == first,
            };
            // A hole is measured half-way down.
            if !is_hole || 2 * place == last {
                self.cut(original, &wanted, &commanded);
            }
            self.keep(found);
        }
        if to == 1.0 {
            self.truth.reaches(&self.turns.furthest);
            self.truth.goes(&original.motion.to);
        }
    }

    /// What the tool cuts where it is.
    fn cut(&mut self, original: &Made, wanted: &Axes, commanded: &Axes) {
        let path = original.motion.path;
        let Some(cut) = self.cut.as_mut().filter(|_| path != Path::Rapid) else {
            return;
        };
        let truth = &self.truth;
        cut.take(
            original.line,
            matches!(path, Path::Hole { .. }),
            |above_mm| {
                [
                    truth.ideal_on_tool_mm(wanted, above_mm),
                    truth.on_tool_mm(wanted, &self.before.off, above_mm),
                    truth.on_tool_mm(commanded, &self.after.off, above_mm),
                ]
            },
        );
    }

    fn keep(&mut self, place: Place) {
        let found = &mut self.found;
        found.before.take(&place, &place.before_um);
        found.after.take(&place, &place.after_um);
        for (form, of) in self.forms.iter_mut().zip(BEFORE_AND_AFTER) {
            form.take(&place, of);
        }
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

fn other_motions(line: usize) -> NcError {
    NcError::Flow {
        line,
        what: "the result does not make the motions of the program: this is a defect of the program that made it, please report it".to_owned(),
    }
}

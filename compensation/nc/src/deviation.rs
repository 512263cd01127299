//! What is said of the deviations of all places of a program.

use volcomp_model::{Lengths, RigidSums, kinematics::nalgebra::Vector3};

use crate::vector::dot;

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
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
#[non_exhaustive]
pub struct Deviation {
    /// The largest distance of the tip from where it belongs, µm.
    pub max_um: f64,
    /// The root of the mean of its squares over all places that were looked at, µm.
    pub rms_um: f64,
    /// The largest distance across the path, µm. What is along the path does not count here: it changes when the tip passes, not where.
    /// At the ends of rapid motions, and where the tip stands still, there is no path, and the whole distance counts.
    pub across_max_um: f64,
    /// The root of the mean of its squares, µm.
    pub across_rms_um: f64,
    /// Where the whole distance is largest: the line of the original program.
    pub line: usize,
    /// Where the tip is to be there, mm from the workpiece origin in workpiece axes.
    pub tip_mm: [f64; 3],
    /// The root of the mean square after alignment of the part, µm: how the part lies on the table is no error of it.
    pub form_rms_um: f64,
    /// The largest distance beside that motion, µm, over the places that are kept (see [`Verification::path`](crate::Verification::path))
    /// and those where the deviation along an axis is largest.
    pub form_max_um: f64,
}

/// State: the deviations of all places, summed up.
#[derive(Clone, Debug, Default)]
pub(crate) struct Sums {
    whole: MaxAndSquares,
    across: MaxAndSquares,
    line: usize,
    tip_mm: [f64; 3],
    form: FormOfPath,
}

impl Sums {
    /// Takes a place; `along` is the direction of the path there, of length 1 or, where there is none, 0.
    pub(crate) fn take(&mut self, place: &Place, of: DeviationOf, along: [f64; 3]) {
        let deviation_um = of(place);
        let squared = dot(deviation_um, deviation_um);
        if self.whole.take(squared) {
            (self.line, self.tip_mm) = (place.line, place.tip_mm);
        }
        let by = dot(deviation_um, along);
        let across: [f64; 3] = std::array::from_fn(|i| deviation_um[i] - by * along[i]);
        self.across.take(dot(across, across));
        self.form.take(place, of);
    }

    /// What they are; `path` are the places that were kept.
    pub(crate) fn deviation(&self, path: &[Place], of: DeviationOf) -> Deviation {
        let [form_rms_um, form_max_um] = self.form.left_um(path, of);
        Deviation {
            max_um: self.whole.max(),
            rms_um: self.whole.rms(),
            across_max_um: self.across.max(),
            across_rms_um: self.across.rms(),
            line: self.line,
            tip_mm: self.tip_mm,
            form_rms_um,
            form_max_um,
        }
    }
}

/// State: the largest of some lengths, and their root mean square.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct MaxAndSquares {
    largest: f64,
    squares: f64,
    count: u64,
}

impl MaxAndSquares {
    /// Takes the square of a length; whether it is the first one or the largest so far.
    pub(crate) fn take(&mut self, squared: f64) -> bool {
        let is_largest = self.count == 0 || squared > self.largest;
        if is_largest {
            self.largest = squared;
        }
        self.squares += squared;
        self.count += 1;
        is_largest
    }

    pub(crate) fn max(&self) -> f64 {
        self.largest.sqrt()
    }

    pub(crate) fn rms(&self) -> f64 {
        (self.squares / (self.count as f64).max(1.0)).sqrt()
    }
}

/// State: the deviations of all places, for what is left of them after alignment.
#[derive(Clone, Debug, Default)]
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
pub(crate) type DeviationOf = fn(&Place) -> [f64; 3];

/// With the original and with the compensated program.
pub(crate) const BEFORE_AND_AFTER: [DeviationOf; 2] =
    [|place| place.before_um, |place| place.after_um];

/// A place and a deviation there, mm.
fn in_mm(place: &Place, of: DeviationOf) -> [Vector3<f64>; 2] {
    [place.tip_mm, of(place).map(|um| 1e-3 * um)].map(Vector3::from)
}

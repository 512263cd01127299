//! Transformation between program and machine coordinates, mm and deg: work offsets, tool offsets, a rotation, and the kinematics of the
//! control.

use std::{cell::RefCell, sync::Arc};

use volcomp_model::{
    Machine, Tool,
    kinematics::{
        Chain, Pose, State,
        nalgebra::{Matrix3, Vector3},
    },
    vocabulary::{AxisKind, AxisName, MAX_AXES, PerAxis},
};

use crate::NcError;

/// One value per axis that a program can name: X Y Z A B C U V W.
pub(crate) type Axes<T = f64> = [T; MAX_AXES];

pub(crate) const LETTERS: [u8; MAX_AXES] = *b"XYZABCUVW";

#[inline]
pub(crate) fn axis_of(letter: u8) -> Option<usize> {
    match letter {
        b'X'..=b'Z' => Some(usize::from(letter - b'X')),
        b'A'..=b'C' => Some(3 + usize::from(letter - b'A')),
        b'U'..=b'W' => Some(6 + usize::from(letter - b'U')),
        _ => None,
    }
}

pub(crate) fn name_of(axis: usize) -> Option<AxisName> {
    let letter = LETTERS.get(axis)?;
    AxisName::from_letter(char::from(*letter))
}

/// True for A, B and C, whose coordinates are in deg regardless of the length unit.
pub(crate) fn is_rotary(axis: usize) -> bool {
    (3..6).contains(&axis)
}

/// Index in the machine's kinematic chain of each axis that a program can name.
#[derive(Clone, Debug)]
pub(crate) struct AxisPlaces {
    places: Axes<Option<usize>>,
    /// Axes that the machine has: (index of the axis, index in the chain).
    present: Vec<(usize, usize)>,
}

impl AxisPlaces {
    pub(crate) fn of(machine: &Machine) -> Self {
        let places = std::array::from_fn(|axis| machine.index_of(name_of(axis)?).ok());
        let present = (0..MAX_AXES).filter_map(|axis| Some((axis, places[axis]?)));
        Self { present: present.collect(), places }
    }

    pub(crate) fn axes_of_machine(&self) -> impl Iterator<Item = usize> {
        self.present.iter().map(|(axis, _)| *axis)
    }

    /// Index in the chain; `None` if the machine lacks the axis.
    pub(crate) fn of_axis(&self, axis: usize) -> Option<usize> {
        self.places[axis]
    }

    #[inline]
    pub(crate) fn state(&self, axes: &Axes) -> State {
        let mut state = State::default();
        for &(axis, place) in &self.present {
            state.q[place] = if is_rotary(axis) { axes[axis].to_radians() } else { axes[axis] };
        }
        state
    }

    /// Converts values per axis of the chain (mm, rad) to mm and deg per program axis; zero for axes that the machine
    /// lacks.
    #[inline]
    pub(crate) fn axes(&self, of_chain: &PerAxis<f64>) -> Axes {
        let mut axes = [0.0; MAX_AXES];
        for &(axis, place) in &self.present {
            axes[axis] =
                if is_rotary(axis) { of_chain[place].to_degrees() } else { of_chain[place] };
        }
        axes
    }

    /// Values per linear axis of the chain, mm, times `factor`, by program axis; zero for the other axes.
    pub(crate) fn linear_axes(&self, of_chain: &PerAxis<f64>, factor: f64) -> Axes {
        let mut axes = [0.0; MAX_AXES];
        let linear = self.present.iter().filter(|(axis, _)| !is_rotary(*axis));
        for &(axis, place) in linear {
            axes[axis] = of_chain[place] * factor;
        }
        axes
    }
}

#[derive(Clone, Debug, Default)]
pub(crate) struct Frame {
    /// Work offset with programmed shifts, mm and deg; `offset` is the work offset alone.
    pub(crate) work: Axes,
    pub(crate) offset: Axes,
    /// G92 or G52 shift.
    pub(crate) shift: Axes,
    /// Tool offset of G43.
    pub(crate) tool: Axes,
    /// Rotation about Z, deg.
    pub(crate) rotation_deg: f64,
    /// Centre of the rotation in X and Y, mm.
    pub(crate) centre: [f64; 2],
    /// Kinematics of the control, while coordinates are those of the tool centre point.
    pub(crate) tip: Option<TipFrame>,
}

impl Frame {
    #[inline]
    pub(crate) fn to_machine(&self, program: &Axes) -> Axes {
        let mut at: Axes = std::array::from_fn(|i| program[i] + self.shift[i]);
        if self.rotation_deg != 0.0 {
            self.turn_about_centre(&mut at, self.rotation_deg);
        }
        let at = std::array::from_fn(|i| at[i] + self.work[i] + self.tool[i]);
        self.tip.as_ref().map_or(at, |tip| tip.to_axes(&at))
    }

    #[inline]
    fn turn_about_centre(&self, at: &mut Axes, angle_deg: f64) {
        let [x, y] = self.centre;
        at[0] -= x;
        at[1] -= y;
        *at = turned(at, angle_deg);
        at[0] += x;
        at[1] += y;
    }

    /// The frame of the work offset and the tool alone, without shifts and rotations.
    pub(crate) fn of_offset(&self) -> Self {
        Self { work: self.offset, tool: self.tool, tip: self.tip.clone(), ..Self::default() }
    }

    #[inline]
    pub(crate) fn to_program(&self, machine: &Axes) -> Axes {
        let mut at = self.tip.as_ref().map_or(*machine, |tip| tip.of_axes(machine));
        for ((at, work), tool) in at.iter_mut().zip(&self.work).zip(&self.tool) {
            *at = *at - work - tool;
        }
        if self.rotation_deg != 0.0 {
            self.turn_about_centre(&mut at, -self.rotation_deg);
        }
        std::array::from_fn(|i| at[i] - self.shift[i])
    }

    /// Converts a displacement `by` of the axes at a machine position to program coordinates.
    #[inline]
    pub(crate) fn moved_in_program(&self, machine: &Axes, by: &Axes) -> Axes {
        if self.tip.is_none() {
            return turned(by, -self.rotation_deg);
        }
        self.moved_in_program_at([machine, &self.to_program(machine)], by)
    }

    /// Like [`moved_in_program`](Self::moved_in_program), at a position in machine and in program coordinates.
    #[inline]
    pub(crate) fn moved_in_program_at(&self, [machine, program]: [&Axes; 2], by: &Axes) -> Axes {
        if self.tip.is_none() {
            return turned(by, -self.rotation_deg);
        }
        let moved = self.to_program(&std::array::from_fn(|i| machine[i] + by[i]));
        std::array::from_fn(|i| moved[i] - program[i])
    }

    /// Like [`moved_in_program`](Self::moved_in_program) for the axes other than X, Y and Z, which kinematics do not change. X, Y and Z are
    /// 0.
    pub(crate) fn others_moved_in_program(&self, machine: &Axes, by: &Axes) -> Axes {
        if self.tip.is_none() {
            let mut moved = *by;
            moved[..3].fill(0.0);
            return moved;
        }
        std::array::from_fn(|i| {
            let in_program = |at: f64| at - self.work[i] - self.tool[i] - self.shift[i];
            if i < 3 { 0.0 } else { in_program(machine[i] + by[i]) - in_program(machine[i]) }
        })
    }

    /// Converts a displacement `by` in program coordinates at a program position to machine coordinates.
    #[inline]
    pub(crate) fn moved_in_machine(&self, program: &Axes, by: &Axes) -> Axes {
        if self.tip.is_none() {
            return turned(by, self.rotation_deg);
        }
        self.moved_in_machine_at([&self.to_machine(program), program], by)
    }

    /// Like [`moved_in_machine`](Self::moved_in_machine), at a position in machine and in program coordinates.
    #[inline]
    pub(crate) fn moved_in_machine_at(&self, [machine, program]: [&Axes; 2], by: &Axes) -> Axes {
        if self.tip.is_none() {
            return turned(by, self.rotation_deg);
        }
        let moved = self.to_machine(&std::array::from_fn(|i| program[i] + by[i]));
        std::array::from_fn(|i| moved[i] - machine[i])
    }
}

#[inline]
pub(crate) fn turned(at: &Axes, angle_deg: f64) -> Axes {
    if angle_deg == 0.0 {
        return *at;
    }
    let (sin, cos) = angle_deg.to_radians().sin_cos();
    let mut turned = *at;
    turned[0] = cos * at[0] - sin * at[1];
    turned[1] = sin * at[0] + cos * at[1];
    turned
}

/// Tool centre point on the ideal machine: position of the tip in the workpiece frame, relative to its position with all axes at zero.
/// While the rotary axes are at zero its coordinates equal X, Y and Z.
#[derive(Clone, Debug)]
pub(crate) struct Tip {
    chain: Chain,
    places: AxisPlaces,
    at_zero_mm: Vector3<f64>,
    /// Machine frame to control frame, whose axes are the directions of X, Y and Z.
    to_control: Matrix3<f64>,
}

/// Linear map from X, Y and Z to the centre point for fixed rotary axes.
#[derive(Clone, Debug)]
struct RotaryPose {
    /// Coordinates of the axes other than X, Y and Z.
    others: [f64; 6],
    /// Centre point with X, Y and Z at zero.
    base_mm: Vector3<f64>,
    /// Displacement of the centre point per unit of X, Y and Z, as columns: orthonormal, because no rotary axis is between X, Y and Z.
    columns: Matrix3<f64>,
}

/// Maximum deviation of the scalar products of the X, Y and Z directions from those of an orthonormal frame.
const PERPENDICULAR: f64 = 1e-9;

/// Number of cached kinematics: a motion evaluates its two ends many times, each with and without correction.
const KEPT: usize = 4;

/// The tool centre point in a frame. State: a cache of the kinematics at the last rotary positions, and the index of
/// its newest entry. The cache is boxed, because a frame is copied with each executed motion and most frames have no
/// `TipFrame`.
#[derive(Clone, Debug)]
pub(crate) struct TipFrame {
    pub(crate) tip: Arc<Tip>,
    last: Box<RefCell<([Option<RotaryPose>; KEPT], usize)>>,
}

impl TipFrame {
    pub(crate) fn new(tip: Arc<Tip>) -> Self {
        Self { tip, last: Box::default() }
    }

    fn with<T>(&self, axes: &Axes, take: impl FnOnce(&RotaryPose) -> T) -> T {
        let (turned, last) = &mut *self.last.borrow_mut();
        let is_it = |of: &usize| (turned[*of].as_ref()).is_some_and(|it| it.others == axes[3..]);
        // Search from the newest entry; a new one replaces the oldest.
        let back = (0..KEPT).map(|back| (*last + KEPT - back) % KEPT);
        if let Some(found) = back.into_iter().find(is_it) {
            *last = found;
        } else {
            *last = (*last + 1) % KEPT;
            turned[*last] = None;
        }
        take(turned[*last].get_or_insert_with(|| self.tip.turned_to(axes)))
    }

    /// Axis coordinates to centre-point coordinates, mm and deg. Rotary axes are unchanged.
    pub(crate) fn of_axes(&self, axes: &Axes) -> Axes {
        let [x, y, z, ..] = *axes;
        let at = self.with(axes, |turned| turned.base_mm + turned.columns * Vector3::new(x, y, z));
        let mut tip = *axes;
        tip[..3].copy_from_slice(at.as_slice());
        tip
    }

    /// Centre-point coordinates to axis coordinates, mm and deg.
    fn to_axes(&self, tip: &Axes) -> Axes {
        let [x, y, z, ..] = *tip;
        let at = self.with(tip, |turned| {
            // X, Y and Z are perpendicular, so the inverse is the transpose. One refinement step removes the remaining
            // non-orthogonality and the rounding errors.
            let at = turned.columns.tr_mul(&(Vector3::new(x, y, z) - turned.base_mm));
            let missing = Vector3::new(x, y, z) - turned.base_mm - turned.columns * at;
            at + turned.columns.tr_mul(&missing)
        });
        let mut axes = *tip;
        axes[..3].copy_from_slice(at.as_slice());
        axes
    }
}

impl Tip {
    /// `None` for machines whose control cannot have tool centre point control: without rotary axes, without X, Y and
    /// Z, with a rotary axis between X, Y and Z, or with directions of X, Y and Z that are not a right-handed frame.
    pub(crate) fn new(machine: &Machine) -> Option<Self> {
        let chain = machine.chain().clone();
        let places = AxisPlaces::of(machine);
        let [Some(x), Some(y), Some(z)] = [0, 1, 2].map(|axis| places.of_axis(axis)) else {
            return None;
        };
        let (first, last) = (x.min(y).min(z), x.max(y).max(z));
        let is_rotary = |place: usize| chain.joints()[place].kind == AxisKind::Rotary;
        let any = (0..chain.joints().len()).any(is_rotary);
        if !any || (first..=last).any(is_rotary) {
            return None;
        }
        let directions = directions(machine);
        let from_identity = directions.transpose() * directions - Matrix3::identity();
        if from_identity.amax() > PERPENDICULAR || directions.determinant() < 0.0 {
            return None;
        }
        let at_zero_mm = chain.ideal_tip_mm(&places.state(&[0.0; 9]));
        Some(Self { chain, places, at_zero_mm, to_control: directions.transpose() })
    }

    fn turned_to(&self, axes: &Axes) -> RotaryPose {
        let mut at = *axes;
        at[..3].fill(0.0);
        let state = self.places.state(&at);
        let joints = self.chain.joints();
        // X, Y and Z move along directions rotated by the rotary axes before them; they are adjacent in the chain.
        let places = [0, 1, 2].map(|axis| self.places.of_axis(axis).unwrap_or_default());
        let first = places.into_iter().min().unwrap_or_default();
        let (mut pose, mut turned) = (Pose::identity(), Matrix3::identity());
        let mut moves_nothing = true;
        for (place, (joint, q)) in joints.iter().zip(state.q).enumerate() {
            if place == first {
                turned = pose.rotation;
            }
            if joint.kind == AxisKind::Linear && q == 0.0 {
                continue;
            }
            let motion = joint.motion(q);
            pose = if moves_nothing { motion } else { pose * motion };
            moves_nothing = false;
        }
        let columns = Matrix3::from_columns(&places.map(|place| turned * joints[place].direction));
        let columns = self.to_control * columns;
        let [.., a, b, c, d, e, f] = at;
        RotaryPose {
            others: [a, b, c, d, e, f],
            base_mm: self.to_control
                * (pose.transform_point(&self.chain.tool_tip_mm())
                    - self.chain.workpiece_origin_mm()
                    - self.at_zero_mm),
            columns,
        }
    }

    /// Sum of the angles, rad, by which the rotary axes turn between two positions.
    pub(crate) fn turned(&self, from: &Axes, to: &Axes) -> f64 {
        let turns = (3..6).filter(|axis| self.places.of_axis(*axis).is_some());
        turns.map(|axis| (to[axis] - from[axis]).abs().to_radians()).sum()
    }
}

/// Tip directions of X, Y and Z with the rotary axes at zero, as columns; a default direction for an axis that the machine lacks.
fn directions(machine: &Machine) -> Matrix3<f64> {
    let places = AxisPlaces::of(machine);
    let joints = machine.chain().joints();
    let own = Matrix3::identity();
    Matrix3::from_columns(&[0, 1, 2].map(|axis| match places.of_axis(axis) {
        Some(place) => joints[place].direction,
        None => own.column(axis).into(),
    }))
}

/// The machine with a tool of the program's tool table. The control adds `offset` to the coordinates, so the tip is that far below the
/// gauge point. The tool of the machine file is used if the file has no gauge point or the offset is zero.
pub(crate) fn with_tool(machine: &Machine, offset: &Axes) -> Result<Machine, NcError> {
    let mut machine = machine.clone();
    if offset[..3] != [0.0; 3] {
        let [x, y, z, ..] = *offset;
        let tool = Tool {
            length_mm: Some(0.0),
            offset_mm: Some((-(directions(&machine) * Vector3::new(x, y, z))).into()),
            ..Tool::default()
        };
        machine.set_tool(&tool)?;
    }
    Ok(machine)
}

/// Position at a fraction (0 to 1) of a straight motion.
pub(crate) fn between(from: &Axes, to: &Axes, share: f64) -> Axes {
    each(|axis| from[axis] + share * (to[axis] - from[axis]))
}

pub(crate) fn each<T>(value: impl FnMut(usize) -> T) -> Axes<T> {
    std::array::from_fn(value)
}

pub(crate) fn dot(a: [f64; 3], b: [f64; 3]) -> f64 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

pub(crate) fn cross(a: [f64; 3], b: [f64; 3]) -> [f64; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    const MACHINE: &str = "name = \"m\"\nstructure = \"w C' A' b X Y Z t\"\n[axes.X]\ntravel = [-500, 500]\n[axes.Y]\ntravel = [-500, 500]\n[axes.Z]\ntravel = [-500, 500]\n[axes.A]\ntravel = [-120, 120]\npoint = [10, 20, -30]\n[axes.C]\ntravel = [-360, 360]\npoint = [10, 20, 0]\n[tool]\ngauge = [0, 0, 0]\nlength = 100\n";

    fn tip(offset: f64) -> TipFrame {
        let machine = Machine::parse(MACHINE, "m.toml").expect("a good machine");
        let mut of_tool = [0.0; 9];
        of_tool[2] = offset;
        let tip = Tip::new(&with_tool(&machine, &of_tool).expect("a tool"));
        TipFrame::new(Arc::new(tip.expect("five axes")))
    }

    /// A' and C' rotate the table by the negative angles about lines through given points: compared with explicit
    /// formulas.
    #[test]
    fn the_centre_point_of_a_tilting_rotary_table() {
        for offset in [0.0, 60.0] {
            let tip = tip(offset);
            let length = if offset == 0.0 { 100.0 } else { offset };
            let axes = [31.0, -42.0, 53.0, 30.0, 0.0, -70.0, 0.0, 0.0, 0.0];
            let (a, c) = (30.0_f64.to_radians(), (-70.0_f64).to_radians());
            // Seen from the table, the tool turns by +A about X through (.., 20, -30), then by +C about Z through (10, 20).
            let at = [31.0, -42.0, 53.0 - length];
            let [y, z] = [at[1] - 20.0, at[2] + 30.0];
            let at = [at[0], 20.0 + a.cos() * y - a.sin() * z, -30.0 + a.sin() * y + a.cos() * z];
            let [x, y] = [at[0] - 10.0, at[1] - 20.0];
            let at = [
                10.0 + c.cos() * x - c.sin() * y,
                20.0 + c.sin() * x + c.cos() * y,
                at[2] + length,
            ];
            let found = tip.of_axes(&axes);
            for i in 0..3 {
                assert!((found[i] - at[i]).abs() < 1e-10, "{found:?} {at:?}");
            }
            let back = tip.to_axes(&found);
            assert!((0..9).all(|i| (back[i] - axes[i]).abs() < 1e-10), "{back:?}");
        }
    }

    /// For all sign conventions of X, Y and Z, the centre point has the coordinates of the control; the tool is below the gauge point along
    /// the control's Z.
    #[test]
    fn the_centre_point_equals_the_axes_with_rotary_axes_at_zero() {
        let of = |x: &str, y: &str, z: &str| {
            let [x, y, z] = [("X", x), ("Y", y), ("Z", z)].map(|(name, direction)| {
                (format!("[axes.{name}]\n"), format!("[axes.{name}]\ndirection = {direction}\n"))
            });
            let text = MACHINE.replace(&x.0, &x.1).replace(&y.0, &y.1).replace(&z.0, &z.1);
            Machine::parse(&text, "m.toml").expect("a good machine")
        };
        let axes = [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let mut of_tool = [0.0; 9];
        of_tool[2] = 60.0;
        for ([x, y, z], tip_z) in [
            (["[1, 0, 0]", "[0, 1, 0]", "[0, 0, 1]"], -60.0),
            (["[-1, 0, 0]", "[0, -1, 0]", "[0, 0, 1]"], -60.0),
            (["[1, 0, 0]", "[0, -1, 0]", "[0, 0, -1]"], 60.0),
        ] {
            let machine = with_tool(&of(x, y, z), &of_tool).expect("a tool");
            assert!((machine.chain().tool_tip_mm().z - tip_z).abs() < 1e-12);
            let tip = TipFrame::new(Arc::new(Tip::new(&machine).expect("five axes")));
            let found = tip.of_axes(&axes);
            assert!((0..9).all(|i| (found[i] - axes[i]).abs() < 1e-12), "{found:?}");
        }
        // No control has such a frame: one axis reversed, one slanted.
        assert!(Tip::new(&of("[-1, 0, 0]", "[0, 1, 0]", "[0, 0, 1]")).is_none());
        assert!(Tip::new(&of("[1, 0, 0]", "[0, 0.866, 0.5]", "[0, 0, 1]")).is_none());
    }
}

#[cfg(test)]
mod coordinates_tests {
    use super::*;

    #[test]
    fn program_and_machine_coordinates_convert_both_ways() {
        let frame = Frame {
            offset: [0.0; MAX_AXES],
            work: [10.0, 20.0, 30.0, 1.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            shift: [1.0, 2.0, 3.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            tool: [0.0, 0.0, 100.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0],
            rotation_deg: 90.0,
            centre: [5.0, 0.0],
            tip: None,
        };
        let at = [1.0, 2.0, 3.0, 4.0, 0.0, 0.0, 0.0, 0.0, 0.0];
        let machine = frame.to_machine(&at);
        // (1 + 1 - 5, 2 + 2) = (-3, 4) turns to (-4, -3); the centre and the offset put it to (11, 17).
        assert!((machine[0] - 11.0).abs() < 1e-12 && (machine[1] - 17.0).abs() < 1e-12);
        assert_eq!(machine[2..4], [136.0, 5.0]);
        let back = frame.to_program(&machine);
        assert!((0..9).all(|i| (back[i] - at[i]).abs() < 1e-12));
    }
}

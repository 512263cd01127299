//! The compiled machine and its evaluation at one pose.

use alloc::vec::Vec;

use volcomp_kinematics::{
    Approach, AxisName, Chain, ErrorMotion, ErrorSource, Joint, JointKind, MAX_AXES, Side, State,
    nalgebra::Vector3,
};

use crate::{
    EvaluatorError, Tolerance,
    blob::ReadAxis,
    parts::{AxisParts, Branches, MachineParts, fit_or_refuse},
    patch::Patch,
    table::{LANES, Registers, Table, WIDE},
};

/// The volumetric error at one pose, first order, in workpiece axes.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Evaluation {
    /// ΔP, mm.
    pub position_mm: [f64; 3],
    /// ρ, rad.
    pub rotation_rad: [f64; 3],
}

impl Evaluation {
    /// ΔP (mm), then ρ (rad).
    #[inline(always)]
    pub fn into_six(self) -> [f64; 6] {
        let ([x, y, z], [a, b, c]) = (self.position_mm, self.rotation_rad);
        [x, y, z, a, b, c]
    }
}

/// One axis, ready to evaluate.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct CompiledAxis {
    pub(crate) joint: Joint,
    pub(crate) location: ErrorMotion,
    pub(crate) assembly: ErrorMotion,
    pub(crate) travel: [f64; 2],
    pub(crate) modulo: Option<f64>,
    /// One table, or forward, backward and mean. Errors are carried to the tool tip at machine zero,
    /// assembly errors are in.
    pub(crate) tables: Vec<Table>,
    pub(crate) patches: Vec<Patch>,
    /// What a linear axis adds for each mm of its coordinate: tilt of its line, lever of its assembly.
    pub(crate) slide: Vector3<f64>,
    /// From the axis's point to the tool tip at machine zero, mm.
    pub(crate) arm_mm: Vector3<f64>,
    /// 1 where errors act behind the slide: on the workpiece side; else 0.
    pub(crate) behind: f64,
    pub(crate) along: Along,
    /// The table of each approach.
    table_of: [usize; 3],
}

impl ReadAxis {
    /// With what follows from its joint.
    pub(crate) fn into_axis(self, joint: &Joint, tip: &Vector3<f64>) -> CompiledAxis {
        CompiledAxis {
            joint: *joint,
            slide: slide(joint, &self.location, &self.assembly),
            arm_mm: tip - joint.point_mm,
            behind: f64::from(u8::from(joint.side == Side::Workpiece)),
            along: Along::of(&joint.direction),
            table_of: if self.tables.len() == 3 {
                [0, 1, 2]
            } else {
                [0; 3]
            },
            location: self.location,
            assembly: self.assembly,
            travel: self.travel,
            modulo: self.modulo,
            tables: self.tables,
            patches: self.patches,
        }
    }
}

/// Where the curve of one component is defined.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Range {
    pub(crate) axis: usize,
    pub(crate) component: usize,
    /// The axis whose coordinate counts, and its range in mm or deg.
    pub(crate) looked_at: usize,
    pub(crate) domain: [f64; 2],
}

/// A machine whose curves are piecewise cubics and whose constants are folded: plain data, evaluated to
/// first order without allocation, lock or panic. Thermal terms are not part of it.
#[derive(Clone, Debug, PartialEq)]
pub struct CompiledMachine {
    pub(crate) chain: Chain,
    pub(crate) axes: Vec<CompiledAxis>,
    pub(crate) ranges: Vec<Range>,
    pub(crate) tolerance: Tolerance,
    /// No rotary axis and no errors over two coordinates: the sum of tables and slides.
    pub(crate) only_slides: bool,
}

impl CompiledMachine {
    /// Compiles a machine.
    ///
    /// # Errors
    /// [`EvaluatorError::TooLarge`], [`EvaluatorError::Tolerance`].
    pub fn new(parts: MachineParts<'_>, tolerance: Tolerance) -> Result<Self, EvaluatorError> {
        for found in [tolerance.linear_mm, tolerance.angular_rad] {
            if !(found > 0.0 && found.is_finite()) {
                return Err(EvaluatorError::Tolerance { found });
            }
        }
        let chain = parts.chain.clone();
        let tip = chain.tool_tip_mm();
        let mut axes = Vec::new();
        let mut ranges = Vec::new();
        for (index, (joint, parts_of)) in chain.joints().iter().zip(parts.axes).enumerate() {
            let (location, assembly) = (parts.location[index], parts.assembly[index]);
            ranges.extend(
                parts_of
                    .ranges
                    .iter()
                    .map(|&(component, looked_at, range)| Range {
                        axis: index,
                        component,
                        looked_at,
                        domain: range,
                    }),
            );
            let tables = tables(joint, &parts_of, &assembly, &tip, tolerance)?;
            let read = ReadAxis {
                location,
                assembly,
                travel: parts_of.travel,
                modulo: parts_of.modulo,
                tables,
                patches: parts_of.patches,
            };
            axes.push(read.into_axis(joint, &tip));
        }
        Ok(Self::from_axes(chain, axes, ranges, tolerance))
    }

    pub(crate) fn from_axes(
        chain: Chain,
        axes: Vec<CompiledAxis>,
        ranges: Vec<Range>,
        tolerance: Tolerance,
    ) -> Self {
        let only_slides = axes
            .iter()
            .all(|axis| axis.joint.kind == JointKind::Linear && axis.patches.is_empty());
        Self {
            chain,
            axes,
            ranges,
            tolerance,
            only_slides,
        }
    }

    /// The ideal chain, mm and rad.
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// How far its curves may be from their sources.
    pub fn tolerance(&self) -> Tolerance {
        self.tolerance
    }

    /// Cubic pieces of all tables together.
    pub fn pieces(&self) -> usize {
        self.tables().map(|table| table.pieces().len()).sum()
    }

    /// Bytes of all tables together.
    pub fn bytes(&self) -> usize {
        self.tables().map(Table::bytes).sum()
    }

    fn tables(&self) -> impl Iterator<Item = &Table> {
        self.axes.iter().flat_map(|axis| &axis.tables)
    }

    /// The volumetric error at a state (mm, rad), first order (the `twist` form).
    pub fn evaluate(&self, state: &State) -> Evaluation {
        #[cfg(feature = "std")]
        return crate::batch::one_pose(self, state);
        #[cfg(not(feature = "std"))]
        self.evaluate_with(state, crate::table::Baseline)
    }

    #[inline(always)]
    pub(crate) fn evaluate_with(&self, state: &State, registers: impl Registers) -> Evaluation {
        if self.only_slides {
            self.slides(&state.q, &state.approach, registers)
        } else {
            self.walk(state, registers, &mut ())
        }
    }

    /// From the workpiece to the tool: every slide carries the tool over the tilts before it.
    #[inline(always)]
    pub(crate) fn slides(
        &self,
        q_mm: &[f64],
        approach: &[Approach; MAX_AXES],
        registers: impl Registers,
    ) -> Evaluation {
        match (&self.axes[..], q_mm) {
            ([a, b, c], &[x, y, z, ..]) => {
                let tables = [
                    a.table(approach[0]),
                    b.table(approach[1]),
                    c.table(approach[2]),
                ];
                three_slides([a, b, c], tables, [x, y, z], registers)
            }
            (axes, q_mm) => {
                let mut sum = Slides::default();
                for ((axis, &q), &approach) in axes.iter().zip(q_mm).zip(approach) {
                    sum.add(axis, q, &registers.value(axis.table(approach), q));
                }
                sum.into()
            }
        }
    }

    /// Errors over two coordinates, carried to the tool tip like those of the tables.
    pub(crate) fn add_patches(&self, twist: &mut [f64; WIDE], index: usize, state: &State) {
        let axis = &self.axes[index];
        for patch in &axis.patches {
            let at = patch.axes.map(|looked_at| {
                self.axes
                    .get(looked_at)
                    .map_or(0.0, |axis| axis.looked_up(state.q[looked_at]))
            });
            let value = patch.value(at) * patch.weights[state.approach[index] as usize];
            twist[patch.component] += value;
            if patch.component >= 3 {
                let mut tilt = Vector3::zeros();
                tilt[patch.component - 3] = value;
                let carried = tilt.cross(&axis.arm_mm);
                for (lane, part) in twist.iter_mut().zip(carried.iter()) {
                    *lane += part;
                }
            }
        }
    }

    /// Bound of |dE/dq| of one error motion at the axis's point over all branches, mm or rad for each
    /// mm or deg; `component` 0 to 5.
    pub fn slope_bound(&self, axis: AxisName, component: usize) -> f64 {
        let Some(axis) = self.axes.iter().find(|a| a.joint.name == axis) else {
            return 0.0;
        };
        let lane = component.min(LANES - 1);
        let of_tables = axis
            .tables
            .iter()
            .map(|table| table.slope_bounds(&axis.arm_mm)[lane]);
        let patches = axis.patches.iter().filter(|p| p.component == component);
        of_tables.fold(0.0, f64::max) + patches.map(Patch::slope_bound).sum::<f64>()
    }

    /// The components whose curves are evaluated outside their range, as bits: axis × 6 + component.
    pub fn outside_range(&self, state: &State) -> u64 {
        let mut outside = 0;
        for range in &self.ranges {
            let Some(axis) = self.axes.get(range.looked_at) else {
                continue;
            };
            let [low, high] = range.domain;
            if !(low..=high).contains(&axis.looked_up(state.q[range.looked_at])) {
                outside |= 1 << (range.axis * LANES + range.component);
            }
        }
        outside
    }
}

/// The sum of a chain of slides. What the slides add is kept apart from the sum of the tables: that
/// one stays in its registers, of which only the tilts are taken out.
#[derive(Default)]
struct Slides {
    tables: [f64; WIDE],
    moved: [f64; 3],
}

impl Slides {
    #[inline(always)]
    fn add(&mut self, axis: &CompiledAxis, q_mm: f64, twist: &[f64; WIDE]) {
        // The errors of an axis ride with its carriage: on the workpiece side they act behind the
        // slide, on the tool side before it.
        let tilt = |lane: usize| self.tables[lane] + twist[lane] * axis.behind;
        let k = &axis.slide;
        let moved = &mut self.moved;
        match axis.along {
            Along::X(sense) => {
                moved[0] += k[0] * q_mm;
                moved[1] += (k[1] + tilt(5) * sense) * q_mm;
                moved[2] += (k[2] - tilt(4) * sense) * q_mm;
            }
            Along::Y(sense) => {
                moved[0] += (k[0] - tilt(5) * sense) * q_mm;
                moved[1] += k[1] * q_mm;
                moved[2] += (k[2] + tilt(3) * sense) * q_mm;
            }
            Along::Z(sense) => {
                moved[0] += (k[0] + tilt(4) * sense) * q_mm;
                moved[1] += (k[1] - tilt(3) * sense) * q_mm;
                moved[2] += k[2] * q_mm;
            }
            Along::Oblique([x, y, z]) => {
                let (a, b, c) = (tilt(3), tilt(4), tilt(5));
                moved[0] += (k[0] + b * z - c * y) * q_mm;
                moved[1] += (k[1] + c * x - a * z) * q_mm;
                moved[2] += (k[2] + a * y - b * x) * q_mm;
            }
        }
        for (lane, part) in self.tables.iter_mut().zip(twist) {
            *lane += part;
        }
    }
}

/// Three slides: all tables before any sum, so that nothing waits for anything.
#[inline(always)]
pub(crate) fn three_slides(
    axes: [&CompiledAxis; 3],
    tables: [&Table; 3],
    q_mm: [f64; 3],
    registers: impl Registers,
) -> Evaluation {
    let twists = [
        registers.value(tables[0], q_mm[0]),
        registers.value(tables[1], q_mm[1]),
        registers.value(tables[2], q_mm[2]),
    ];
    let mut sum = Slides::default();
    sum.add(axes[0], q_mm[0], &twists[0]);
    sum.add(axes[1], q_mm[1], &twists[1]);
    sum.add(axes[2], q_mm[2], &twists[2]);
    sum.into()
}

/// The direction of an axis; along a letter a cross product with it is two products.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Along {
    X(f64),
    Y(f64),
    Z(f64),
    Oblique([f64; 3]),
}

impl Along {
    pub(crate) fn of(direction: &Vector3<f64>) -> Self {
        match <[f64; 3]>::from(*direction) {
            [x, 0.0, 0.0] => Self::X(x),
            [0.0, y, 0.0] => Self::Y(y),
            [0.0, 0.0, z] => Self::Z(z),
            oblique => Self::Oblique(oblique),
        }
    }
}

impl From<Slides> for Evaluation {
    #[inline(always)]
    fn from(sum: Slides) -> Self {
        let [x, y, z, a, b, c, ..] = sum.tables;
        let [along_x, along_y, along_z] = sum.moved;
        Self {
            position_mm: [x + along_x, y + along_y, z + along_z],
            rotation_rad: [a, b, c],
        }
    }
}

impl CompiledAxis {
    #[inline(always)]
    pub(crate) fn table(&self, approach: Approach) -> &Table {
        // One table at least: `tables` makes one or three.
        &self.tables[self.table_of[approach as usize]]
    }

    /// The coordinate (mm, rad) in mm or deg, brought into travel where the axis has a modulo.
    #[inline(always)]
    pub(crate) fn looked_up(&self, q: f64) -> f64 {
        let coordinate = match self.joint.kind {
            JointKind::Linear => q,
            JointKind::Rotary => q.to_degrees(),
        };
        match self.modulo {
            Some(period) if !(self.travel[0]..=self.travel[1]).contains(&coordinate) => {
                // The Euclidean remainder, which `core` lacks.
                let rest = (coordinate - self.travel[0]) % period;
                self.travel[0] + if rest < 0.0 { rest + period } else { rest }
            }
            _ => coordinate,
        }
    }
}

/// The tables of one axis, errors carried to the tool tip at machine zero and assembly errors in.
fn tables(
    joint: &Joint,
    parts: &AxisParts<'_>,
    assembly: &ErrorMotion,
    tip: &Vector3<f64>,
    tolerance: Tolerance,
) -> Result<Vec<Table>, EvaluatorError> {
    let branches: &[Approach] = match parts.branches {
        Branches::One => &[Approach::Unknown],
        // In the order of `Approach as usize`.
        Branches::Three => &[Approach::Positive, Approach::Negative, Approach::Unknown],
    };
    let arm = tip - joint.point_mm;
    let constant = assembly.linear_mm + assembly.angular_rad.cross(tip);
    let table = |approach: &Approach| {
        let function = |x: f64| {
            let error = (parts.errors)(x, *approach);
            let linear = error.linear_mm + error.angular_rad.cross(&arm) + constant;
            let angular = error.angular_rad + assembly.angular_rad;
            [
                linear.x, linear.y, linear.z, angular.x, angular.y, angular.z,
            ]
        };
        fit_or_refuse(&function, &parts.breakpoints, tolerance, joint.name)
    };
    branches.iter().map(table).collect()
}

/// What a linear axis adds for each mm: its line is tilted, and its assembly error acts on the other end
/// of the slide than its error motions do.
fn slide(joint: &Joint, location: &ErrorMotion, assembly: &ErrorMotion) -> Vector3<f64> {
    if joint.kind == JointKind::Rotary {
        return Vector3::zeros();
    }
    let assembly_end = match joint.side {
        Side::Tool => assembly.angular_rad,
        Side::Workpiece => -assembly.angular_rad,
    };
    (location.angular_rad + assembly_end).cross(&joint.direction)
}

impl ErrorSource for CompiledMachine {
    /// The error motion at the axis's point, from its table.
    fn error_motion(&self, index: usize, state: &State) -> ErrorMotion {
        let Some(axis) = self.axes.get(index) else {
            return ErrorMotion::ZERO;
        };
        let mut twist = axis
            .table(state.approach[index])
            .value(axis.looked_up(state.q[index]));
        self.add_patches(&mut twist, index, state);
        let at_tip = Vector3::new(twist[0], twist[1], twist[2]);
        let tilt = Vector3::new(twist[3], twist[4], twist[5]) - axis.assembly.angular_rad;
        let constant =
            axis.assembly.linear_mm + axis.assembly.angular_rad.cross(&self.chain.tool_tip_mm());
        ErrorMotion {
            linear_mm: at_tip - constant - tilt.cross(&axis.arm_mm),
            angular_rad: tilt,
        }
    }

    fn location(&self, index: usize) -> ErrorMotion {
        self.axes
            .get(index)
            .map_or(ErrorMotion::ZERO, |a| a.location)
    }

    fn assembly(&self, index: usize) -> ErrorMotion {
        self.axes
            .get(index)
            .map_or(ErrorMotion::ZERO, |a| a.assembly)
    }
}

//! Builds a compiled machine from checked parts, or from the tables of a blob.

use alloc::vec::Vec;

use volcomp_kinematics::{Chain, Correctors, ErrorMotion, Joint, nalgebra::Vector3};
use volcomp_vocabulary::{Direction, Displacement, PerAxis};

use crate::{
    EvaluatorError, Tolerance,
    error::no_axis,
    fit::CurveFit,
    fold::{Folded, fold},
    machine::{CompiledAxis, CompiledMachine, Range, Thermal},
    parts::{AxisParts, Branches, MachineParts},
    patch::CompiledPatch,
    table::{Bounds, Head, Piece, Tables},
    turn::Along,
};

pub(crate) struct AxisTables {
    pub(crate) travel: [f64; 2],
    pub(crate) modulo: Option<f64>,
    /// Pieces of one table, or of three: forward, backward and mean.
    pub(crate) tables: Vec<Vec<Piece>>,
    pub(crate) patches: Vec<CompiledPatch>,
}

pub(crate) struct Frame {
    pub(crate) chain: Chain,
    pub(crate) location: PerAxis<ErrorMotion>,
    pub(crate) assembly: PerAxis<ErrorMotion>,
    pub(crate) tolerance: Tolerance,
    folded: Folded,
}

impl Frame {
    pub(crate) fn new(
        chain: Chain,
        location: &PerAxis<ErrorMotion>,
        assembly: &PerAxis<ErrorMotion>,
        tolerance: Tolerance,
    ) -> Self {
        Self {
            folded: fold(&chain, location, assembly),
            chain,
            location: *location,
            assembly: *assembly,
            tolerance,
        }
    }
}

impl CompiledMachine {
    /// Compiles a machine.
    ///
    /// # Errors
    /// [`EvaluatorError::MissingAxis`]; [`EvaluatorError::Chain`] for a range or patch over an axis that the chain lacks; [`EvaluatorError::TooLarge`],
    /// [`EvaluatorError::NotFinite`], [`EvaluatorError::Tolerance`].
    pub fn new(parts: MachineParts<'_>, tolerance: Tolerance) -> Result<Self, EvaluatorError> {
        for found in [tolerance.linear_mm, tolerance.angular_rad] {
            if !(found > 0.0 && found.is_finite()) {
                return Err(EvaluatorError::Tolerance { found });
            }
        }
        let MachineParts { chain, axes: stated, location, assembly } = parts;
        let structure = chain.structure().clone();
        let frame = Frame::new(chain, &location, &assembly, tolerance);
        let (mut axes, mut ranges) = (Vec::new(), Vec::new());
        for (index, (&axis, parts)) in structure.axes().iter().zip(stated).enumerate() {
            let parts = parts.ok_or(EvaluatorError::MissingAxis { axis })?;
            for range in &parts.ranges {
                let looked_at = structure.index_of(range.looked_at);
                ranges.push(Range {
                    axis: index,
                    component: range.component,
                    looked_at: looked_at.ok_or_else(|| no_axis(&frame.chain, range.looked_at))?,
                    domain: range.domain,
                });
            }
            let mut patches = Vec::new();
            for patch in parts.patches.iter().cloned() {
                patches.push(CompiledPatch::of(patch, &frame.chain)?);
            }
            axes.push(AxisTables {
                travel: parts.travel.map(Displacement::mm_or_deg),
                modulo: parts.modulo.map(|period| period.0),
                tables: tables(&frame, index, &parts)?,
                patches,
            });
        }
        Ok(Self::from_tables(frame, axes, ranges))
    }

    /// Builds the machine from tables that already include the constant errors.
    pub(crate) fn from_tables(frame: Frame, axes: Vec<AxisTables>, ranges: Vec<Range>) -> Self {
        let folded = frame.folded;
        let tip = frame.chain.tool_tip_mm();
        let mut tables = Tables::default();
        let compiled = |(index, (joint, axis)): (usize, (&Joint, AxisTables))| {
            let slide = &folded.slide[index];
            axis.compiled(joint, tip - joint.point_mm, slide, &mut tables)
        };
        let joints = frame.chain.joints().iter();
        let axes: Vec<CompiledAxis> = joints.zip(axes).enumerate().map(compiled).collect();
        let mut machine = Self {
            patched: false,
            three_slides: false,
            at_workpiece: folded.workpiece_end != ErrorMotion::ZERO,
            may_move: frame.chain.structure().axes().iter().copied().collect(),
            correctors: Correctors::all(&frame.chain),
            chain: frame.chain,
            location: frame.location,
            assembly: frame.assembly,
            tolerance: frame.tolerance,
            axes,
            tables,
            ranges,
            folded,
        };
        machine.choose_path();
        machine
    }
}

impl AxisTables {
    /// Compiles the axis and adds its tables to those of the machine.
    fn compiled(
        self,
        joint: &Joint,
        arm_mm: Vector3<f64>,
        slide: &Vector3<f64>,
        tables: &mut Tables,
    ) -> CompiledAxis {
        let heads: Vec<Head> = self.tables.iter().map(|pieces| tables.add(pieces)).collect();
        // `tables` and a blob have one or three tables.
        let (branches, heads) = match heads[..] {
            [forward, backward, mean] => (Branches::Three, [forward, backward, mean]),
            _ => (Branches::One, [heads[0]; 3]),
        };
        let all = self.tables.iter().flatten();
        CompiledAxis {
            joint: *joint,
            travel: self.travel,
            modulo: self.modulo,
            branches,
            heads,
            bounds: Bounds::of(all, &arm_mm, slide),
            patches: self.patches,
            arm_mm,
            before_motion: joint.errors_on_tool_side(),
            along: Along::of(&joint.direction),
            thermal: Thermal::default(),
        }
    }
}

/// Tables of one axis: one, or one for each branch. Errors are transformed to the tool tip at machine zero, and constant errors are included.
fn tables(
    frame: &Frame,
    index: usize,
    parts: &AxisParts<'_>,
) -> Result<Vec<Vec<Piece>>, EvaluatorError> {
    let branches: &[Option<Direction>] = match parts.branches {
        Branches::One => &[None],
        // In the order of `branch_index`.
        Branches::Three => &[Some(Direction::Positive), Some(Direction::Negative), None],
    };
    let joint = &frame.chain.joints()[index];
    let slope = frame.folded.slide[index] + Vector3::from(parts.slope_mm);
    let table = |approach: &Option<Direction>| {
        let curve_fit = CurveFit {
            errors: &|x| (parts.errors)(x, *approach),
            travel: parts.travel.map(Displacement::mm_or_deg),
            breakpoints: &parts.breakpoints,
            arm_mm: frame.chain.tool_tip_mm() - joint.point_mm,
            constant: frame.folded.constant[index],
            tolerance: frame.tolerance,
            axis: joint.name,
        };
        let mut pieces = curve_fit.fit()?;
        for piece in &mut pieces {
            piece.add_slope(&slope);
        }
        Ok(pieces)
    };
    branches.iter().map(table).collect()
}

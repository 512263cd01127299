//! A machine: its chain, its errors in the units of the file, its thermal terms.

use std::{collections::BTreeMap, path::Path};

use volcomp_curve::{Curve, ErrorCurve, Field};
use volcomp_document::Document;
use volcomp_kinematics::{
    Chain, Correction, CorrectionOptions, ErrorMotion, Form, State, Structure, VolumetricError,
    correct, nalgebra::Vector3, volumetric_error,
};
use volcomp_vocabulary::{AxisKind, AxisName, Component, ErrorName, MAX_AXES};

use crate::{
    error::ModelError,
    source::MachineErrors,
    thermal::{Temperatures, Thermal},
};

/// One axis as the machine file states it.
#[derive(Clone, Debug, PartialEq)]
pub struct Axis {
    /// Its letter.
    pub name: AxisName,
    /// Lower and upper end of travel, mm or deg.
    pub travel: [f64; 2],
    /// Period that brings a rotary coordinate into travel before curves are looked up, deg.
    pub modulo: Option<f64>,
    /// Direction in MCS as written; `None`: the letter's.
    pub direction: Option<[f64; 3]>,
    /// Point in MCS at machine zero, mm.
    pub point_mm: Option<[f64; 3]>,
}

impl Axis {
    /// The coordinate at which curves are looked up: brought into travel by `modulo`.
    pub(crate) fn looked_up(&self, coordinate: f64) -> f64 {
        match self.modulo {
            Some(period) if !self.contains(coordinate) => {
                self.travel[0] + (coordinate - self.travel[0]).rem_euclid(period)
            }
            _ => coordinate,
        }
    }

    fn contains(&self, coordinate: f64) -> bool {
        (self.travel[0]..=self.travel[1]).contains(&coordinate)
    }
}

/// A tool as the machine file states it; keys that are `None` come from `[tool]` or the default.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tool {
    /// Tip, mm in MCS at machine zero.
    pub tip_mm: Option<[f64; 3]>,
    /// Spindle gauge point, mm in MCS at machine zero; instead of `tip_mm`.
    pub gauge_mm: Option<[f64; 3]>,
    /// Length from the gauge point to the tip, mm.
    pub length_mm: Option<f64>,
    /// Added to the tip, mm.
    pub offset_mm: Option<[f64; 3]>,
    /// From the tip to the spindle.
    pub axis: Option<[f64; 3]>,
}

impl Tool {
    /// This tool's keys over those of `base`.
    fn over(&self, base: &Self) -> Self {
        // A tip replaces the gauge point with all that belongs to it, and the other way round.
        let (keeps_tip, keeps_gauge) = (self.gauge_mm.is_none(), self.tip_mm.is_none());
        Self {
            tip_mm: self.tip_mm.or(base.tip_mm.filter(|_| keeps_tip)),
            gauge_mm: self.gauge_mm.or(base.gauge_mm.filter(|_| keeps_gauge)),
            length_mm: self.length_mm.or(base.length_mm.filter(|_| keeps_gauge)),
            offset_mm: self.offset_mm.or(base.offset_mm.filter(|_| keeps_gauge)),
            axis: self.axis.or(base.axis),
        }
    }

    /// Tip and axis: tip = gauge − length·axis + offset.
    pub(crate) fn tip_and_axis(&self) -> ([f64; 3], [f64; 3]) {
        let axis = self.axis.unwrap_or([0.0, 0.0, 1.0]);
        let Some(gauge) = self.gauge_mm else {
            return (self.tip_mm.unwrap_or_default(), axis);
        };
        let unit = Vector3::from(axis).try_normalize(0.0).unwrap_or_default();
        let tip = Vector3::from(gauge) - unit * self.length_mm.unwrap_or(0.0)
            + Vector3::from(self.offset_mm.unwrap_or_default());
        (tip.into(), axis)
    }
}

/// A machine with its errors. Coordinates, curves and numbers here are in the units of the file
/// (mm, deg, µm, µrad); the chain inside is in mm and rad.
#[derive(Clone, Debug, PartialEq)]
pub struct Machine {
    /// Its name.
    pub name: String,
    /// Its thermal terms.
    pub thermal: Thermal,
    chain: Chain,
    axes: Vec<Axis>,
    tool: Tool,
    tools: BTreeMap<String, Tool>,
    workpiece_origin_mm: [f64; 3],
    motions: Vec<[Option<ErrorCurve>; 6]>,
    locations: BTreeMap<ErrorName, f64>,
    assembly: Vec<[f64; 6]>,
}

/// The parts that a machine is built from, as the file states them.
pub(crate) struct Parts {
    pub(crate) name: String,
    pub(crate) structure: Structure,
    pub(crate) axes: Vec<Axis>,
    pub(crate) tool: Tool,
    pub(crate) tools: BTreeMap<String, Tool>,
    pub(crate) workpiece_origin_mm: [f64; 3],
}

impl Machine {
    /// Reads a machine file.
    ///
    /// # Errors
    /// A file that cannot be read, is no UTF-8 or no valid machine: with file, line and key.
    pub fn read(path: &Path) -> Result<Self, ModelError> {
        Self::decode(&Document::read(path)?)
    }

    /// A machine without errors.
    pub(crate) fn from_parts(parts: Parts) -> Result<Self, ModelError> {
        let mut chain = Chain::new(parts.structure);
        for axis in &parts.axes {
            if let Some(direction) = axis.direction {
                chain.set_direction(axis.name, direction)?;
            }
            if let Some(point) = axis.point_mm {
                chain.set_point(axis.name, point)?;
            }
        }
        let (tip, tool_axis) = parts.tool.tip_and_axis();
        chain.set_tool(tip, tool_axis)?;
        chain.set_workpiece_origin(parts.workpiece_origin_mm)?;
        let count = parts.axes.len();
        Ok(Self {
            name: parts.name,
            thermal: Thermal::default(),
            chain,
            axes: parts.axes,
            tool: parts.tool,
            tools: parts.tools,
            workpiece_origin_mm: parts.workpiece_origin_mm,
            motions: vec![Default::default(); count],
            locations: BTreeMap::new(),
            assembly: vec![[0.0; 6]; count],
        })
    }

    /// The ideal chain, mm and rad.
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// The axes in chain order.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// One axis.
    pub fn axis(&self, name: AxisName) -> Option<&Axis> {
        self.axes.iter().find(|axis| axis.name == name)
    }

    /// The tool of `[tool]`.
    pub fn tool(&self) -> &Tool {
        &self.tool
    }

    /// The tools of `[tools]`.
    pub fn tools(&self) -> &BTreeMap<String, Tool> {
        &self.tools
    }

    /// The workpiece origin, mm in MCS at machine zero.
    pub fn workpiece_origin_mm(&self) -> [f64; 3] {
        self.workpiece_origin_mm
    }

    /// Puts a tool of `[tools]` into the spindle.
    ///
    /// # Errors
    /// [`ModelError::NoSuchTool`], or a tool that makes no chain.
    pub fn select_tool(&mut self, name: &str) -> Result<(), ModelError> {
        let Some(tool) = self.tools.get(name) else {
            return Err(ModelError::NoSuchTool {
                machine: self.name.clone(),
                tool: name.to_owned(),
                known: self.tools.keys().cloned().collect::<Vec<_>>().join(", "),
            });
        };
        let (tip, axis) = tool.over(&self.tool).tip_and_axis();
        Ok(self.chain.set_tool(tip, axis)?)
    }

    /// Puts the tool that is in the spindle of another machine into this one's.
    ///
    /// # Errors
    /// None for a tool that stands in a machine already.
    pub fn use_tool_of(&mut self, other: &Self) -> Result<(), ModelError> {
        let (tip, axis) = (other.chain.tool_tip_mm(), other.chain.tool_axis());
        Ok(self.chain.set_tool(tip.into(), axis.into())?)
    }

    /// Every error motion with its curve (argument mm or deg, value µm or µrad), sorted by axis in
    /// chain order and component.
    pub fn errors(&self) -> impl Iterator<Item = (ErrorName, &ErrorCurve)> {
        self.axes
            .iter()
            .zip(&self.motions)
            .flat_map(|(axis, curves)| {
                let named = Component::ALL.into_iter().zip(curves);
                named.filter_map(|(component, curve)| {
                    Some((ErrorName::motion(component, axis.name), curve.as_ref()?))
                })
            })
    }

    /// The curve of one error motion.
    pub fn error(&self, name: ErrorName) -> Option<&ErrorCurve> {
        let index = self.chain.structure().index_of(name.axis)?;
        self.motions[index][name.component.index()]
            .as_ref()
            .filter(|_| !name.location)
    }

    /// The location errors, µm or µrad.
    pub fn locations(&self) -> &BTreeMap<ErrorName, f64> {
        &self.locations
    }

    /// The assembly errors of the axis at `index`: µm, µm, µm, µrad, µrad, µrad.
    pub fn assembly(&self, index: usize) -> [f64; 6] {
        self.assembly.get(index).copied().unwrap_or_default()
    }

    /// Sets the curve of an error motion.
    ///
    /// # Errors
    /// An axis that is not there, the name of a location error, or, on an axis with `modulo`, a
    /// table whose first and last value differ.
    pub fn set_error(&mut self, name: ErrorName, curve: ErrorCurve) -> Result<(), ModelError> {
        let index = self.index_of(name.axis)?;
        if name.location {
            return Err(refused(
                name,
                "a location error is one number, never a curve",
            ));
        }
        if self.axes[index].modulo.is_some() {
            for field in curve.fields() {
                check_closed(name, field)?;
            }
        }
        self.motions[index][name.component.index()] = Some(curve);
        Ok(())
    }

    /// Sets a location error, µm or µrad.
    ///
    /// # Errors
    /// An axis that is not there, the name of an error motion, a value that is not finite, or an
    /// error without effect.
    pub fn set_location(&mut self, name: ErrorName, value: f64) -> Result<(), ModelError> {
        let index = self.index_of(name.axis)?;
        let joint = &self.chain.joints()[index];
        if !name.location || !value.is_finite() {
            return Err(refused(
                name,
                "expected a location error E?0N and a finite number",
            ));
        }
        let along_itself = joint.direction[name.component.mcs_index()].abs() > 1.0 - 1e-12;
        match (joint.kind, name.component.is_angular()) {
            (AxisKind::Linear, false) => {
                let constant = ErrorName::motion(name.component, name.axis);
                let reason =
                    format!("has no effect; put a zero offset into the constant of {constant}");
                return Err(refused(name, reason));
            }
            (AxisKind::Rotary, _) if along_itself => {
                let about = Component::ALL[3 + name.component.mcs_index()];
                let constant = ErrorName::motion(about, name.axis);
                let reason = format!(
                    "lies along the axis itself and has no effect; put a zero offset into the constant of {constant}"
                );
                return Err(refused(name, reason));
            }
            (AxisKind::Linear, true) if along_itself => {
                let constant =
                    ErrorName::motion(Component::ALL[name.component.mcs_index()], name.axis);
                let reason = format!(
                    "turns the axis about itself and has no effect; put a zero offset into the constant of {constant}"
                );
                return Err(refused(name, reason));
            }
            _ => {}
        }
        self.locations.insert(name, value);
        Ok(())
    }

    /// Sets the assembly errors of an axis: µm, µm, µm, µrad, µrad, µrad.
    ///
    /// # Errors
    /// An axis that is not there, or numbers that are not finite.
    pub fn set_assembly(&mut self, axis: AxisName, six: [f64; 6]) -> Result<(), ModelError> {
        let index = self.index_of(axis)?;
        if let Some(&found) = six.iter().find(|x| !x.is_finite()) {
            return Err(ModelError::Coordinate { axis, found });
        }
        self.assembly[index] = six;
        Ok(())
    }

    /// Takes every error motion, location and assembly error away.
    pub fn clear_errors(&mut self) {
        self.motions.fill(Default::default());
        self.locations.clear();
        self.assembly.fill([0.0; 6]);
    }

    /// A state from coordinates in mm and deg; axes not named stand at 0, approach unknown.
    ///
    /// # Errors
    /// An axis that is not there, a coordinate that is not finite.
    pub fn state(&self, coordinates: &[(AxisName, f64)]) -> Result<State, ModelError> {
        let mut state = State::default();
        for &(axis, found) in coordinates {
            let index = self.index_of(axis)?;
            if !found.is_finite() {
                return Err(ModelError::Coordinate { axis, found });
            }
            state.q[index] = match axis.kind() {
                AxisKind::Linear => found,
                AxisKind::Rotary => found.to_radians(),
            };
        }
        Ok(state)
    }

    /// The place of an axis in the chain.
    ///
    /// # Errors
    /// [`ModelError::NoSuchAxis`].
    pub fn index_of(&self, axis: AxisName) -> Result<usize, ModelError> {
        self.chain
            .structure()
            .index_of(axis)
            .ok_or_else(|| ModelError::NoSuchAxis {
                machine: self.name.clone(),
                structure: self.chain.structure().to_string(),
                axis,
            })
    }

    /// The coordinates of a state in the units of the curves (mm, deg), brought into travel where an
    /// axis has a `modulo`.
    pub fn curve_coordinates(&self, state: &State) -> [f64; MAX_AXES] {
        let mut coordinates = [0.0; MAX_AXES];
        for ((place, axis), &q) in coordinates.iter_mut().zip(&self.axes).zip(&state.q) {
            *place = axis.looked_up(file_units(axis.name, q));
        }
        coordinates
    }

    /// The errors as kinematics asks for them, at steady temperatures.
    pub fn source(&self, temperatures: &Temperatures) -> MachineErrors<'_> {
        MachineErrors::new(self, temperatures)
    }

    pub(crate) fn curve(&self, axis: usize, component: usize) -> Option<&ErrorCurve> {
        self.motions.get(axis)?[component].as_ref()
    }

    pub(crate) fn location_of(&self, axis: usize) -> ErrorMotion {
        let mut six = [0.0; 6];
        for (name, &value) in &self.locations {
            if self.axes.get(axis).is_some_and(|a| a.name == name.axis) {
                six[name.component.index()] = value;
            }
        }
        ErrorMotion::from_um_urad(six)
    }

    /// The volumetric error (mm, rad, workpiece axes) at a state.
    pub fn error_at(
        &self,
        state: &State,
        form: Form,
        temperatures: &Temperatures,
    ) -> VolumetricError {
        volumetric_error(&self.chain, &self.source(temperatures), state, form)
    }

    /// The correction at a command.
    pub fn correction_at(
        &self,
        state: &State,
        temperatures: &Temperatures,
        options: &CorrectionOptions,
    ) -> Correction {
        correct(&self.chain, &self.source(temperatures), state, options)
    }

    /// The error motions whose curves are evaluated outside their range at a state, sorted by name.
    pub fn outside_range(&self, state: &State) -> Vec<ErrorName> {
        let coordinates = self.curve_coordinates(state);
        let mut outside: Vec<ErrorName> = self
            .errors()
            .filter(|(name, curve)| {
                let own = self.chain.structure().index_of(name.axis).unwrap_or(0);
                !curve.contains(own, &coordinates)
            })
            .map(|(name, _)| name)
            .collect();
        outside.sort_unstable_by_key(ErrorName::to_string);
        outside
    }

    /// The axes that stand outside their travel at a state, in chain order.
    pub fn outside_travel(&self, state: &State) -> Vec<AxisName> {
        let outside =
            |&(axis, &q): &(&Axis, &f64)| !axis.contains(axis.looked_up(file_units(axis.name, q)));
        let stands = self.axes.iter().zip(&state.q);
        stands.filter(outside).map(|(axis, _)| axis.name).collect()
    }
}

/// A coordinate of the chain (mm, rad) in the units of the file (mm, deg).
pub(crate) fn file_units(axis: AxisName, q: f64) -> f64 {
    match axis.kind() {
        AxisKind::Linear => q,
        AxisKind::Rotary => q.to_degrees(),
    }
}

fn refused(name: ErrorName, reason: impl Into<String>) -> ModelError {
    ModelError::Error {
        error: name.to_string(),
        reason: reason.into(),
    }
}

/// On an axis that goes round, a curve given by nodes must close.
fn check_closed(name: ErrorName, field: &Field) -> Result<(), ModelError> {
    let nodes = match field {
        Field::Curve(Curve::Table(table)) => table.nodes(),
        Field::Curve(Curve::MovingLeastSquares(mls)) => mls.nodes(),
        _ => return Ok(()),
    };
    match (nodes.first(), nodes.last()) {
        (Some(first), Some(last)) if (first[1] - last[1]).abs() > 1e-9 => Err(refused(
            name,
            format!(
                "first value {} and last value {} differ, expected the same: the axis has a modulo",
                first[1], last[1]
            ),
        )),
        _ => Ok(()),
    }
}

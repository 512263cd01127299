//! A machine: its kinematic chain, its errors in the units of the machine file, its thermal terms.

use std::{collections::BTreeMap, f64::consts::TAU, fmt};

use volcomp_curve::{Curve, ErrorCurve, Field};
use volcomp_document::{InputError, Value};
use volcomp_kinematics::{
    Chain, Correction, CorrectionOptions, ErrorMotion, ErrorSource, Form, MotionFrame, State,
    Structure, VolumetricError, correct, nalgebra::Vector3, volumetric_error,
};
use volcomp_vocabulary::{
    AxisKind, AxisName, Component, Displacement, ErrorName, MAX_AXES, PerAxis, UnknownErrorName,
};

use crate::{
    axis::{Axis, Tool, curve_refusal, is_number, location_refusal},
    error::{CorrectRefusal, ModelError},
    provenance::{Provenance, ProvenanceRefusal},
    thermal::{Temperatures, Thermal},
};

/// A machine with its errors. Coordinates, curves and errors are in the units of the machine file (mm, deg, µm, µrad); only the chain is in mm
/// and rad.
///
/// A machine is serialised as the text of its machine file, and deserialised with all checks of that file. The
/// selected tool is not included.
///
/// Two machines are equal if their machine files are equal in content and the same tool is in the spindle.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
#[serde(into = "String", try_from = "String")]
pub struct Machine {
    /// The name of the machine; any text.
    pub name: String,
    thermal: Thermal,
    correct: Option<Vec<AxisName>>,
    chain: Chain,
    axes: Vec<Axis>,
    tool: Tool,
    tools: BTreeMap<String, Tool>,
    workpiece_origin_mm: [f64; 3],
    motions: Vec<[Option<ErrorCurve>; 6]>,
    locations: BTreeMap<ErrorName, f64>,
    assembly: Vec<[f64; 6]>,
    provenance: Provenance,
}

pub(crate) struct Parts {
    pub(crate) name: String,
    pub(crate) structure: Structure,
    pub(crate) axes: Vec<Axis>,
    pub(crate) tool: Tool,
    pub(crate) tools: BTreeMap<String, Tool>,
    pub(crate) workpiece_origin_mm: [f64; 3],
}

impl Machine {
    /// Builds a machine without errors.
    pub(crate) fn from_parts(parts: Parts) -> Result<Self, ModelError> {
        let mut chain = Chain::new(parts.structure);
        for axis in &parts.axes {
            if let Some(direction) = axis.direction {
                chain.set_direction(axis.name, direction)?;
            }
            if let Some(point) = axis.point_mm {
                chain.set_point(axis.name, point)?;
            }
            if axis.motion_frame != MotionFrame::Fixed {
                chain.set_motion_frame(axis.name, axis.motion_frame)?;
            }
        }
        let (tip, tool_axis) = parts.tool.tip_and_axis();
        chain.set_tool(tip, tool_axis)?;
        chain.set_workpiece_origin(parts.workpiece_origin_mm)?;
        let count = parts.axes.len();
        Ok(Self {
            name: parts.name,
            thermal: Thermal::default(),
            correct: None,
            chain,
            axes: parts.axes,
            tool: parts.tool,
            tools: parts.tools,
            workpiece_origin_mm: parts.workpiece_origin_mm,
            motions: vec![Default::default(); count],
            locations: BTreeMap::new(),
            assembly: vec![[0.0; 6]; count],
            provenance: Provenance::default(),
        })
    }

    /// The ideal chain with the tool that is in the spindle, mm and rad.
    pub fn chain(&self) -> &Chain {
        &self.chain
    }

    /// The axes in chain order.
    pub fn axes(&self) -> &[Axis] {
        &self.axes
    }

    /// The axis with this letter; `None` if the structure lacks it.
    pub fn axis(&self, name: AxisName) -> Option<&Axis> {
        self.axes.iter().find(|axis| axis.name == name)
    }

    /// Notes on suspicious but valid input: travels and periods that look like radians, location errors that look like mm or deg, curves
    /// that cover only part of the travel.
    pub fn notes(&self) -> Vec<String> {
        let mut notes = self.notes_on_travel();
        notes.extend(unit_notes(self));
        let partly = self.partly_measured().into_iter();
        notes.extend(partly.map(|(error, axis, share)| {
            format!(
                "{error} is known on {:.0} % of the travel of {axis}: beyond, it keeps its end values",
                100.0 * share
            )
        }));
        notes
    }

    /// The error motions whose curves cover less than 90 % of the travel of an axis, with that axis and the covered fraction; for a grid, the axis
    /// with the smaller fraction. Sorted by name.
    pub fn partly_measured(&self) -> Vec<(ErrorName, AxisName, f64)> {
        let share = |(error, curve): (ErrorName, &ErrorCurve)| {
            let own = self.index_of(error.axis).ok()?;
            let domains = curve.fields().flat_map(|field| field.domains(own));
            let shares = domains.filter_map(|(place, [from, to])| {
                let axis = self.axes.get(place)?;
                let [low, high] = axis.travel;
                let covered = (to.min(high) - from.max(low)).max(0.0);
                // An axis without travel is always covered.
                let share = if high > low {
                    covered / (high - low)
                } else {
                    f64::from(u8::from(from <= low && low <= to))
                };
                Some((error, axis.name, share))
            });
            shares.min_by(|one, other| one.2.total_cmp(&other.2))
        };
        let mut found: Vec<_> = self.errors().filter_map(share).collect();
        found.retain(|(_, _, share)| *share < 0.9);
        found.sort_unstable_by_key(|(error, ..)| error.to_string());
        found
    }

    /// Whether an error motion of the axis depends on its direction of approach.
    pub fn has_directions(&self, axis: AxisName) -> bool {
        self.errors().any(|(name, curve)| name.axis == axis && curve.has_directions())
    }

    /// The error motions that were measured in one direction only: their provenance lists runs, but they have one curve
    /// for both directions.
    pub fn read_in_one_direction(&self) -> Vec<ErrorName> {
        let origins = self.provenance.errors.iter();
        let read = origins.filter(|of| of.sources.iter().any(|source| source.runs.is_some()));
        let errors = read.map(|of| of.error);
        errors
            .filter(|error| self.error(*error).is_some_and(|curve| !curve.has_directions()))
            .collect()
    }

    /// Whether the machine has error motions, or location or assembly errors that are not 0; thermal terms do not count.
    pub fn states_errors(&self) -> bool {
        let is_some = |value: &f64| *value != 0.0;
        self.errors().next().is_some()
            || self.locations.values().any(is_some)
            || self.assembly.as_flattened().iter().any(is_some)
    }

    fn notes_on_travel(&self) -> Vec<String> {
        let axes = self.axes.iter();
        let note = |axis: &Axis| {
            let [low, high] = axis.travel;
            let [low_deg, high_deg] = axis.travel_as_if_in_radians()?;
            Some(format!(
                "travel of {}: {low} to {high} deg, which in radians would be {low_deg} to {high_deg} deg: is it stated in radians? Coordinates of rotary axes are in deg",
                axis.name
            ))
        };
        axes.filter_map(note).collect()
    }

    /// The tool of `[tool]`, which supplies missing keys of named tools.
    pub fn tool(&self) -> &Tool {
        &self.tool
    }

    pub fn tools(&self) -> &BTreeMap<String, Tool> {
        &self.tools
    }

    /// The workpiece origin, mm in MCS at machine zero.
    pub fn workpiece_origin_mm(&self) -> [f64; 3] {
        self.workpiece_origin_mm
    }

    /// Puts a named tool of `[tools]` into the spindle.
    ///
    /// # Errors
    /// [`ModelError::NoSuchTool`], or a tool from which no chain can be built.
    pub fn select_tool(&mut self, name: &str) -> Result<(), ModelError> {
        let tool = self.tool_named(name)?.clone();
        self.set_tool(&tool)
    }

    fn tool_named(&self, name: &str) -> Result<&Tool, ModelError> {
        self.tools.get(name).ok_or_else(|| ModelError::NoSuchTool {
            machine: self.name.clone(),
            tool: name.to_owned(),
            known: self.tools.keys().cloned().collect::<Vec<_>>().join(", "),
        })
    }

    /// Tip of a named tool of `[tools]`, mm in MCS at machine zero; does not change the tool in the spindle.
    ///
    /// # Errors
    /// [`ModelError::NoSuchTool`], or a tool from which no chain can be built.
    pub fn tip_of(&self, name: &str) -> Result<Vector3<f64>, ModelError> {
        let (tip, axis) = self.tool_named(name)?.over(&self.tool).tip_and_axis();
        let mut chain = self.chain.clone();
        chain.set_tool(tip, axis)?;
        Ok(chain.tool_tip_mm())
    }

    /// The tools of `[tools]` with which an error can be largest, by name. The error of the tip is
    /// linear in the position of the tip, so a tool whose tip lies between the tips of two others
    /// is omitted (of straight tools the shortest and the longest remain). At least one tool is
    /// kept for each direction of the tool axis. Empty if the file states no tools.
    ///
    /// # Errors
    ///
    /// A tool from which no chain can be built.
    pub fn extreme_tools(&self) -> Result<Vec<&str>, ModelError> {
        let mut tools: Vec<(&str, Vector3<f64>, Vector3<f64>)> = Vec::new();
        for (name, tool) in &self.tools {
            let (_, axis) = tool.over(&self.tool).tip_and_axis();
            let axis = Vector3::from(axis).normalize();
            tools.push((name.as_str(), self.tip_of(name)?, axis));
        }
        let mut tips: Vec<Vector3<f64>> = Vec::new();
        for (_, tip, _) in &tools {
            if !tips.iter().any(|other| (other - tip).norm() < SAME_TIP_MM) {
                tips.push(*tip);
            }
        }
        let is_between = |tip: &Vector3<f64>| {
            let of_others = tips.iter().map(|other| other - tip);
            let directions: Vec<Vector3<f64>> =
                of_others.filter(|to| to.norm() >= SAME_TIP_MM).collect();
            let mut pairs = directions.iter().flat_map(|a| directions.iter().map(move |b| (a, b)));
            pairs.any(|(a, b)| a.dot(b) < 0.0 && a.cross(b).norm() < SAME_TIP_MM * (a - b).norm())
        };
        let (mut held, mut axes): (Vec<Vector3<f64>>, Vec<Vector3<f64>>) = Default::default();
        let mut extremes = Vec::new();
        for (name, tip, axis) in tools {
            let is_new = |all: &[Vector3<f64>], one: &Vector3<f64>, within: f64| {
                !all.iter().any(|other| (other - one).norm() < within)
            };
            let is_outer = is_new(&held, &tip, SAME_TIP_MM) && !is_between(&tip);
            if is_outer || is_new(&axes, &axis, SAME_AXIS) {
                extremes.push(name);
                held.push(tip);
                axes.push(axis);
            }
        }
        Ok(extremes)
    }

    /// Puts a tool into the spindle; `[tool]` supplies its missing keys.
    ///
    /// # Errors
    /// A tool with an invalid tip or axis.
    pub fn set_tool(&mut self, tool: &Tool) -> Result<(), ModelError> {
        let (tip, axis) = tool.over(&self.tool).tip_and_axis();
        Ok(self.chain.set_tool(tip, axis)?)
    }

    /// The first difference from `expected` in geometry: the structure, the direction of an axis, the point of a rotary
    /// axis, or the frame of the error motions of a rotary axis. `None` if both machines have the same geometry.
    pub fn other_geometry(&self, expected: &Self) -> Option<String> {
        let (found, expected) = (self.chain(), expected.chain());
        let differs = |what: &str, found: &dyn fmt::Display, expected: &dyn fmt::Display| {
            Some(format!("{what} is `{found}`, expected `{expected}`"))
        };
        if found.structure() != expected.structure() {
            return differs("structure", &found.structure(), &expected.structure());
        }
        for (found, expected) in found.joints().iter().zip(expected.joints()) {
            let name = found.name;
            let shown = |v: &[f64; 3]| format!("[{}, {}, {}]", v[0], v[1], v[2]);
            let [direction, asked] = [found.direction.into(), expected.direction.into()];
            if direction != asked {
                let what = format!("direction of axis {name}");
                return differs(&what, &shown(&direction), &shown(&asked));
            }
            let [point, asked] = [found.point_mm.into(), expected.point_mm.into()];
            if found.kind == AxisKind::Rotary && point != asked {
                let what = format!("point of axis {name}");
                return differs(&what, &shown(&point), &shown(&asked));
            }
            if found.motion_frame != expected.motion_frame {
                let word = |frame| match frame {
                    MotionFrame::Fixed => "fixed",
                    MotionFrame::Turning => "turning",
                };
                let [frame, asked] = [found.motion_frame, expected.motion_frame].map(word);
                return differs(&format!("motion_frame of axis {name}"), &frame, &asked);
            }
        }
        None
    }

    /// Puts the tool in the spindle of another machine into the spindle of this one.
    ///
    /// # Errors
    /// Never for a tool that is already in the spindle of a valid machine.
    pub fn use_tool_of(&mut self, other: &Self) -> Result<(), ModelError> {
        let (tip, axis) = (other.chain.tool_tip_mm(), other.chain.tool_axis());
        Ok(self.chain.set_tool(tip.into(), axis.into())?)
    }

    /// Every error motion with its curve (argument mm or deg, value µm or µrad), sorted by axis in chain order, then by component.
    pub fn errors(&self) -> impl Iterator<Item = (ErrorName, &ErrorCurve)> {
        self.axes.iter().zip(&self.motions).flat_map(|(axis, curves)| {
            let named = Component::ALL.into_iter().zip(curves);
            named.filter_map(|(component, curve)| {
                Some((ErrorName::motion(component, axis.name), curve.as_ref()?))
            })
        })
    }

    /// The curve of an error motion (argument mm or deg, value µm or µrad); `None` if it is zero.
    pub fn error(&self, name: ErrorName) -> Option<&ErrorCurve> {
        let index = self.chain.structure().index_of(name.axis)?;
        self.motions[index][name.component.index()].as_ref().filter(|_| !name.location)
    }

    /// The location errors, µm or µrad.
    pub fn locations(&self) -> &BTreeMap<ErrorName, f64> {
        &self.locations
    }

    /// Length of the diagonal of the travels of the linear axes, mm; 0 without linear axes.
    pub fn diagonal_of_travels_mm(&self) -> f64 {
        let linear = self.axes.iter();
        let linear = linear.filter(|axis| axis.name.kind() == AxisKind::Linear);
        let squares = linear.map(|axis| (axis.travel[1] - axis.travel[0]).powi(2));
        squares.sum::<f64>().sqrt()
    }

    /// The assembly errors of the axis at `index`: µm, µm, µm, µrad, µrad, µrad.
    pub fn assembly(&self, index: usize) -> [f64; 6] {
        self.assembly.get(index).copied().unwrap_or_default()
    }

    /// Sets the curve of an error motion: argument mm or deg, value µm or µrad.
    ///
    /// # Errors
    /// A missing axis, or [`ModelError::Refused`]: the name of a location error; numbers that are not finite; a grid over a missing axis;
    /// along an axis with `modulo`, nodes whose first and last value differ, or a jump of more than 1 µm or 1 µrad at the roll-over.
    pub fn set_error(&mut self, name: ErrorName, curve: ErrorCurve) -> Result<(), ModelError> {
        let index = self.index_of(name.axis)?;
        if let Some(reason) = curve_refusal(name, &curve, index, &self.axes) {
            return Err(ModelError::Refused { error: name, reason });
        }
        self.motions[index][name.component.index()] = Some(curve);
        self.provenance.forget(name);
        Ok(())
    }

    /// Sets a location error, µm or µrad.
    ///
    /// # Errors
    /// A missing axis, or [`ModelError::Refused`]: the name of an error motion, a value that is not finite, or an error without effect.
    pub fn set_location(&mut self, name: ErrorName, value: f64) -> Result<(), ModelError> {
        let index = self.index_of(name.axis)?;
        let joint = &self.chain.joints()[index];
        if let Some(reason) = location_refusal(name, value, joint) {
            return Err(ModelError::Refused { error: name, reason });
        }
        self.locations.insert(name, value);
        self.provenance.forget(name);
        Ok(())
    }

    /// Sets the assembly errors of an axis, constant over its travel: three offsets (µm) and three angles (µrad) along and about the axes
    /// of the machine coordinate system.
    ///
    /// # Errors
    /// A missing axis, or [`ModelError::Assembly`]: numbers that are not finite.
    pub fn set_assembly(&mut self, axis: AxisName, six: [f64; 6]) -> Result<(), ModelError> {
        let index = self.index_of(axis)?;
        if let Some(&found) = six.iter().find(|x| !is_number(**x)) {
            return Err(ModelError::Assembly { axis, found });
        }
        self.assembly[index] = six;
        Ok(())
    }

    /// The thermal terms: temperature-dependent contributions to the error motions.
    pub fn thermal(&self) -> &Thermal {
        &self.thermal
    }

    /// Replaces the thermal terms.
    ///
    /// # Errors
    /// [`ModelError::Thermal`]: a term of an error motion that the machine does not have, an expansion of an angle or of a rotary axis,
    /// numbers that are not finite, a negative lag, a drift without a sensor.
    pub fn set_thermal(&mut self, thermal: Thermal) -> Result<(), ModelError> {
        thermal.check(self.chain.structure())?;
        self.thermal = thermal;
        Ok(())
    }

    /// The axes that corrections may move, from the key `correct` of the machine file, in order of preference; `None`: every axis.
    pub fn correct(&self) -> Option<&[AxisName]> {
        self.correct.as_deref()
    }

    /// Sets the axes that corrections may move; `None`: every axis. Errors that these axes cannot correct remain as residual.
    ///
    /// # Errors
    /// A missing axis, or [`ModelError::Correct`]: an empty list, or one axis twice.
    pub fn set_correct(&mut self, axes: Option<&[AxisName]>) -> Result<(), ModelError> {
        for (place, &axis) in axes.unwrap_or_default().iter().enumerate() {
            self.index_of(axis)?;
            if axes.is_some_and(|axes| axes[..place].contains(&axis)) {
                return Err(ModelError::Correct(CorrectRefusal::Twice { axis }));
            }
        }
        if axes.is_some_and(<[AxisName]>::is_empty) {
            return Err(ModelError::Correct(CorrectRefusal::Empty));
        }
        self.correct = axes.map(<[AxisName]>::to_vec);
        Ok(())
    }

    /// Sources of the errors; empty if unknown.
    pub fn provenance(&self) -> &Provenance {
        &self.provenance
    }

    /// Replaces the provenance of the errors.
    ///
    /// # Errors
    /// An invalid date, an error listed twice or not stated by the machine, negative numbers, invalid hashes.
    pub fn set_provenance(&mut self, provenance: Provenance) -> Result<(), ProvenanceRefusal> {
        let stated = |name: ErrorName| {
            if name.location {
                self.locations.contains_key(&name)
            } else {
                self.error(name).is_some()
            }
        };
        if let Some(refusal) = provenance.refusal(stated) {
            return Err(refusal);
        }
        self.provenance = provenance;
        Ok(())
    }

    /// Adds errors that the measurements do not determine to the provenance.
    pub fn leave_undecided(&mut self, errors: impl IntoIterator<Item = ErrorName>) {
        self.provenance.leave_undecided(errors);
    }

    /// Removes all error motions, location and assembly errors; thermal terms stay.
    pub fn clear_errors(&mut self) {
        self.motions.fill(Default::default());
        self.locations.clear();
        self.assembly.fill([0.0; 6]);
        self.provenance = Provenance::default();
    }

    /// The index of an axis in the chain.
    ///
    /// # Errors
    /// [`ModelError::NoSuchAxis`].
    pub fn index_of(&self, axis: AxisName) -> Result<usize, ModelError> {
        self.chain.structure().index_of(axis).ok_or_else(|| ModelError::NoSuchAxis {
            machine: self.name.clone(),
            structure: self.chain.structure().to_string(),
            axis,
        })
    }

    /// The coordinates of a state in the units of the curves (mm, deg), reduced into travel for an axis with `modulo`.
    pub fn curve_coordinates(&self, state: &State) -> PerAxis<f64> {
        let mut coordinates = PerAxis::ZERO;
        for ((place, axis), &q) in coordinates.iter_mut().zip(&self.axes).zip(&state.q) {
            *place = axis.looked_up(Displacement::new(axis.name.kind(), q).mm_or_deg());
        }
        coordinates
    }

    pub(crate) fn curve(&self, axis: usize, component: usize) -> Option<&ErrorCurve> {
        self.motions.get(axis)?[component].as_ref()
    }

    fn location_of(&self, axis: usize) -> ErrorMotion {
        let mut six = [0.0; 6];
        for (name, &value) in &self.locations {
            if self.axes.get(axis).is_some_and(|a| a.name == name.axis) {
                six[name.component.index()] = value;
            }
        }
        ErrorMotion::from_um_urad(six)
    }
}

/// Tips closer than this are treated as equal, mm.
const SAME_TIP_MM: f64 = 1e-6;
/// Tool axis directions closer than this are treated as equal, as a difference of unit vectors.
const SAME_AXIS: f64 = 1e-9;
/// Maximum coordinate, mm or deg: beyond it, rounding errors of the products of a chain exceed a
/// micrometre.
const MAX_COORDINATE: f64 = 1e9;

impl Machine {
    /// A state with these coordinates in mm and deg; other axes are at 0, and the approach is unknown.
    ///
    /// # Errors
    /// [`ModelError::NoSuchAxis`]; [`ModelError::Coordinate`] for a coordinate that is not a number from −1e9 to 1e9 mm or deg;
    /// [`ModelError::AxisTwice`] for an axis with two coordinates.
    pub fn state(&self, coordinates: &[(AxisName, f64)]) -> Result<State, ModelError> {
        let mut state = State::default();
        for (place, &(axis, found)) in coordinates.iter().enumerate() {
            let index = self.index_of(axis)?;
            // The range check is false for NaN, so NaN is rejected too.
            if !(-MAX_COORDINATE..=MAX_COORDINATE).contains(&found) {
                return Err(ModelError::Coordinate { axis, found });
            }
            if coordinates[..place].iter().any(|(before, _)| *before == axis) {
                return Err(ModelError::AxisTwice { axis });
            }
            state.q[index] = Displacement::from_coordinate(axis.kind(), found).mm_or_rad();
        }
        Ok(state)
    }

    /// The coordinates of every axis at a state, mm and deg.
    pub fn coordinates(&self, state: &State) -> BTreeMap<AxisName, f64> {
        let axes = self.axes().iter().zip(&state.q);
        axes.map(|(axis, &q)| (axis.name, Displacement::new(axis.name.kind(), q).mm_or_deg()))
            .collect()
    }

    /// The errors as an `ErrorSource` of kinematics, at steady temperatures.
    pub fn source(&self, temperatures: &Temperatures) -> MachineErrors<'_> {
        MachineErrors::new(self, temperatures)
    }

    /// Volumetric error (mm and rad in workpiece axes) at a state, at steady temperatures.
    pub fn error_at(
        &self,
        state: &State,
        form: Form,
        temperatures: &Temperatures,
    ) -> VolumetricError {
        volumetric_error(self.chain(), &self.source(temperatures), state, form)
    }

    /// The correction options of the machine file: its key `correct`, else the defaults.
    pub fn correction_options(&self) -> CorrectionOptions {
        CorrectionOptions {
            // The list fits: a machine has at most one axis per letter.
            correct: self.correct().map(|axes| axes.iter().copied().take(MAX_AXES).collect()),
            ..CorrectionOptions::default()
        }
    }

    /// The displacement to add to a command. It corrects with the axes in `options`, or, if `options` names none, with
    /// the axes of the machine file's key `correct`.
    pub fn correction_at(
        &self,
        state: &State,
        temperatures: &Temperatures,
        options: &CorrectionOptions,
    ) -> Correction {
        let source = self.source(temperatures);
        if options.correct.is_some() || self.correct().is_none() {
            return correct(self.chain(), &source, state, options);
        }
        let options =
            CorrectionOptions { correct: self.correction_options().correct, ..options.clone() };
        correct(self.chain(), &source, state, &options)
    }

    /// The error motions whose curves are evaluated outside their range at a state, sorted by name.
    pub fn outside_range(&self, state: &State) -> Vec<ErrorName> {
        let coordinates = self.curve_coordinates(state);
        let mut outside: Vec<ErrorName> = self
            .errors()
            .filter(|(name, curve)| {
                let own = self.chain().structure().index_of(name.axis).unwrap_or(0);
                !curve.contains(own, &coordinates[..])
            })
            .map(|(name, _)| name)
            .collect();
        outside.sort_unstable_by_key(ErrorName::to_string);
        outside
    }

    /// The axes outside their travel at a state, in chain order.
    pub fn outside_travel(&self, state: &State) -> Vec<AxisName> {
        let outside = |&(axis, &q): &(&Axis, &f64)| {
            let coordinate = Displacement::new(axis.name.kind(), q).mm_or_deg();
            !axis.may_stand_at(coordinate)
        };
        let stands = self.axes().iter().zip(&state.q);
        stands.filter(outside).map(|(axis, _)| axis.name).collect()
    }
}

impl Machine {
    /// Decodes an error name whose axis must exist.
    ///
    /// # Errors
    /// Not an error name, or an axis that the machine does not have.
    pub fn decode_error(&self, value: &Value<'_>) -> Result<ErrorName, InputError> {
        let name: ErrorName = value
            .text()?
            .parse()
            .map_err(|error: UnknownErrorName| value.error(error.to_string()))?;
        if self.axis(name.axis).is_none() {
            return Err(value.error(self.lacks(name.axis)));
        }
        Ok(name)
    }

    pub(crate) fn lacks(&self, axis: AxisName) -> String {
        let structure = self.chain().structure();
        format!("the structure `{structure}` has no axis {axis}")
    }
}

impl From<Machine> for String {
    fn from(machine: Machine) -> Self {
        machine.to_toml()
    }
}

impl TryFrom<String> for Machine {
    type Error = ModelError;

    fn try_from(text: String) -> Result<Self, ModelError> {
        Self::parse(&text, "machine")
    }
}

/// The errors of a machine at steady temperatures: an [`ErrorSource`] in mm and rad over curves in
/// µm and µrad.
#[derive(Clone, Debug)]
pub struct MachineErrors<'a> {
    machine: &'a Machine,
    /// Offset (µm or µrad) and slope (per mm) that the thermal terms add.
    thermal: [[[f64; 2]; 6]; MAX_AXES],
    location: [ErrorMotion; MAX_AXES],
}

impl<'a> MachineErrors<'a> {
    pub(crate) fn new(machine: &'a Machine, temperatures: &Temperatures) -> Self {
        let mut thermal = [[[0.0; 2]; 6]; MAX_AXES];
        let mut location = [ErrorMotion::ZERO; MAX_AXES];
        for index in 0..machine.axes().len() {
            thermal[index] = machine.thermal_of(index, temperatures);
            location[index] = machine.location_of(index);
        }
        Self { machine, thermal, location }
    }
}

impl Machine {
    /// Offset (µm or µrad) and slope (per mm) that the thermal terms add to each error motion of an axis.
    pub(crate) fn thermal_of(&self, axis: usize, temperatures: &Temperatures) -> [[f64; 2]; 6] {
        let name = self.axes()[axis].name;
        let direction = self.chain().joints()[axis].direction;
        Component::ALL.map(|component| {
            let error = ErrorName::motion(component, name);
            self.thermal().offset_and_slope(error, &direction, temperatures)
        })
    }
}

impl ErrorSource for MachineErrors<'_> {
    fn error_motion(&self, axis: usize, state: &State) -> ErrorMotion {
        if axis >= self.machine.axes().len() {
            return ErrorMotion::ZERO;
        }
        let coordinates = self.machine.curve_coordinates(state);
        let branch = state.approach[axis];
        let mut six = [0.0; 6];
        for (component, value) in six.iter_mut().enumerate() {
            let [offset, slope] = self.thermal[axis][component];
            *value = offset + slope * coordinates[axis];
            if let Some(curve) = self.machine.curve(axis, component) {
                *value += curve.value(axis, &coordinates[..], branch);
            }
        }
        ErrorMotion::from_um_urad(six)
    }

    fn location(&self, axis: usize) -> ErrorMotion {
        self.location.get(axis).copied().unwrap_or_default()
    }

    fn assembly(&self, axis: usize) -> ErrorMotion {
        ErrorMotion::from_um_urad(self.machine.assembly(axis))
    }
}

/// If even the largest location error is below this bound, the location errors are probably stated in mm or deg: 0.1 µm
/// or 0.1 µrad is less than any measurement uncertainty of an axis location.
const SMALLEST_MEASURABLE_UM: f64 = 0.1;
/// Maximum relative deviation of a period that is a rounded 2π, such as 6.28.
const ROUNDED_TAU_WITHIN: f64 = 6e-4;

/// Notes on location errors that are too small to be measured, and on waves with a period of 2π degrees.
fn unit_notes(machine: &Machine) -> Vec<String> {
    let stated = machine.locations().iter().filter(|(_, value)| **value != 0.0);
    let largest = stated.max_by(|a, b| a.1.abs().total_cmp(&b.1.abs()));
    let small = largest.filter(|(_, value)| value.abs() < SMALLEST_MEASURABLE_UM);
    let of_locations = small.map(|(name, value)| {
        format!(
            "{name} = {value} is the largest location error: is it in mm or deg? Errors in machine files are in µm and µrad"
        )
    });
    let rotary = machine.errors().filter(|(name, _)| name.axis.is_rotary());
    let of_periods = rotary.filter_map(|(name, curve)| {
        let period = curve.fields().find_map(|field| match field {
            Field::Curve(Curve::Fourier(series)) => Some(series.period()),
            _ => None,
        })?;
        ((period - TAU).abs() <= ROUNDED_TAU_WITHIN * TAU).then(|| {
            format!(
                "{name}: the period of {period} deg would be one turn in radians: is it meant so? Coordinates of rotary axes are in deg"
            )
        })
    });
    of_locations.into_iter().chain(of_periods).collect()
}

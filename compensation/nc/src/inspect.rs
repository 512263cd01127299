//! Features of a part, and the result of measuring them on the virtually machined part.
//!
//! The surface points are on the path of the tool axis, at each height of the feature. A tool of constant radius cuts at a constant
//! distance from that path, so form, location and orientation are the same; only the size differs.

use volcomp_metrology::form::{
    Axis, CoordinatePlane, DatumAxis, Feature, Form, FormError, evaluate_form,
};
use volcomp_model::{
    RigidMotion, RigidSums,
    document::{Document, InputError, Section, Value},
    kinematics::nalgebra::Vector3,
};

use crate::coordinates::{cross, dot};

/// Maximum number of heights along the tool at which a flank is evaluated.
const MAX_HEIGHTS: usize = 100;

const LARGEST_HEIGHT_MM: f64 = 1e4;

/// Property of a feature that is inspected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Measured {
    /// Form, location and orientation of the machined surface.
    Form(Feature),
    /// Location of a drilled hole, at half its depth.
    Hole,
}

/// A feature of a part: the surface or hole to be inspected.
#[derive(Clone, Debug, PartialEq)]
pub struct PartFeature {
    /// Name in the part file.
    pub name: String,
    /// Property that is inspected.
    pub measured: Measured,
    /// First and last program line that cut the feature, counted from 1.
    pub lines: [usize; 2],
    /// Heights above the tip, along the tool, at which the feature is cut, mm: one for a cut by the tip or a ball, several for a flank.
    pub above_mm: Vec<f64>,
    /// Index of an earlier feature whose axis is the datum.
    pub datum: Option<usize>,
}

/// Coordinate system of the inspection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Alignment {
    /// Coordinate system of the program: misplacement of the part on the machine contributes to its location and
    /// orientation errors.
    #[default]
    Program,
    /// Coordinate system of the part: after best-fit rigid-body alignment of all points (least squares), as on a
    /// measuring machine.
    BestFit,
}

/// Features of a part whose errors are computed from the program and the machine.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Part {
    /// Coordinate system of the inspection.
    pub alignment: Alignment,
    /// Features in file order.
    pub features: Vec<PartFeature>,
}

impl Part {
    /// Reads a part file; `file` is its name in messages.
    ///
    /// # Errors
    /// Unknown, missing or contradictory keys, and invalid values (such as an empty list of features or a height out of
    /// range), with file, line and key.
    pub fn parse(text: &str, file: &str) -> Result<Self, InputError> {
        Document::new(file, text).decode(|root| {
            root.allow(&["alignment", "feature"])?;
            let alignment = match root.get("alignment") {
                Some(value) => value
                    .one_of(&[("program", Alignment::Program), ("best-fit", Alignment::BestFit)])?,
                None => Alignment::default(),
            };
            let mut features: Vec<PartFeature> = Vec::new();
            let items = root.require("feature")?;
            if items.items()?.is_empty() {
                return Err(
                    items.error("found an empty list, expected a table [[feature]] at least")
                );
            }
            for item in items.items()? {
                let feature = feature(&item.section()?, &features)?;
                features.push(feature);
            }
            Ok(Self { alignment, features })
        })
    }
}

fn height(value: &Value<'_>) -> Result<f64, InputError> {
    let height = value.number()?;
    if height.abs() > LARGEST_HEIGHT_MM {
        return Err(value.error(format!(
            "found {height}, expected mm from -{LARGEST_HEIGHT_MM} to {LARGEST_HEIGHT_MM}"
        )));
    }
    Ok(height)
}

fn feature(section: &Section<'_>, before: &[PartFeature]) -> Result<PartFeature, InputError> {
    section.allow(&["name", "kind", "plane", "lines", "above_mm", "datum"])?;
    let name_value = section.require("name")?;
    let name = name_value.text()?.to_owned();
    if before.iter().any(|other| other.name == name) {
        return Err(name_value.error(format!("found {name:?} twice, expected unique names")));
    }
    let plane_value = section.get("plane");
    let plane = match &plane_value {
        Some(value) => Some(value.one_of(&[
            ("xy", CoordinatePlane::Xy),
            ("yz", CoordinatePlane::Yz),
            ("zx", CoordinatePlane::Zx),
        ])?),
        None => None,
    };
    let measured = section.require("kind")?.one_of(&[
        ("circle", Measured::Form(Feature::Circle { plane })),
        ("line", Measured::Form(Feature::Line { plane })),
        ("plane", Measured::Form(Feature::Plane)),
        ("cylinder", Measured::Form(Feature::Cylinder)),
        ("cone", Measured::Form(Feature::Cone)),
        ("hole", Measured::Hole),
    ])?;
    let has_plane =
        matches!(measured, Measured::Form(Feature::Circle { .. } | Feature::Line { .. }));
    if let Some(value) = plane_value.filter(|_| !has_plane) {
        return Err(value.error("found it for another kind, expected only for circles and lines"));
    }
    let lines_value = section.require("lines")?;
    let [first, last] = lines_value.vector::<2>()?;
    let line = |number: f64| -> Option<usize> {
        let is_line = (1.0..=1e9).contains(&number) && number.fract() == 0.0;
        is_line.then(|| format!("{number:.0}").parse().ok()).flatten()
    };
    let lines = line(first).zip(line(last)).filter(|(first, last)| first <= last);
    let (first, last) = lines.ok_or_else(|| {
        lines_value.error(format!(
            "found [{first}, {last}], expected the numbers of the first and the last line that cut it, from 1"
        ))
    })?;
    let above_mm = match section.get("above_mm") {
        None => vec![0.0],
        Some(value) => {
            let items = value.items()?;
            if items.is_empty() || items.len() > MAX_HEIGHTS {
                return Err(value
                    .error(format!("found {} heights, expected 1 to {MAX_HEIGHTS}", items.len())));
            }
            items.iter().map(height).collect::<Result<_, _>>()?
        }
    };
    let datum = match section.get("datum") {
        None => None,
        Some(value) => {
            let name = value.text()?;
            let place = before.iter().position(|other| other.name == name);
            let has_axis = |place: &usize| {
                !matches!(before[*place].measured, Measured::Hole | Measured::Form(Feature::Plane))
            };
            Some(place.filter(has_axis).ok_or_else(|| {
                value.error(format!(
                    "found {name:?}, expected the name of a feature above it that has an axis"
                ))
            })?)
        }
    };
    Ok(PartFeature { name, measured, lines: [first, last], above_mm, datum })
}

const MAX_POINTS: usize = 2000;

/// One point of a feature, mm from the workpiece origin in workpiece axes: nominal, with the original program, with the compensated
/// program.
type Three = [[f64; 3]; 3];

#[derive(Clone, Debug)]
pub(crate) struct Collector {
    part: Part,
    points: Vec<Vec<Three>>,
    /// Per feature: sampling stride (every n-th position is stored), and number of positions so far.
    strides: Vec<[u64; 2]>,
}

impl Collector {
    pub(crate) fn new(part: Part) -> Self {
        let count = part.features.len();
        Self { part, points: vec![Vec::new(); count], strides: vec![[1, 0]; count] }
    }

    /// Stores the surface points that the tool cuts at one path position of `line`, for every feature that contains the
    /// line. `points(h)` is the point h mm above the tip.
    pub(crate) fn take(
        &mut self,
        line: usize,
        is_hole: bool,
        mut points: impl FnMut(f64) -> Three,
    ) {
        for (place, feature) in self.part.features.iter().enumerate() {
            let [first, last] = feature.lines;
            let is_of_it = (first..=last).contains(&line);
            if !is_of_it || is_hole != (feature.measured == Measured::Hole) {
                continue;
            }
            let [stride, count] = &mut self.strides[place];
            let keeps = count.is_multiple_of(*stride);
            *count += 1;
            if !keeps {
                continue;
            }
            let own = &mut self.points[place];
            own.extend(feature.above_mm.iter().map(|above| points(*above)));
            let heights = feature.above_mm.len();
            if own.len() + heights > MAX_POINTS {
                // Keep every other path position, with all its heights.
                *stride *= 2;
                let kept: Vec<Three> = own.chunks(heights).step_by(2).flatten().copied().collect();
                *own = kept;
            }
        }
    }

    pub(crate) fn inspected(&mut self) -> Vec<Inspected> {
        if self.part.alignment == Alignment::BestFit {
            self.align();
        }
        let features = self.part.features.iter().zip(&self.points);
        let forms: Vec<Option<[Result<Form, FormError>; 3]>> = features
            .map(|(feature, points)| match feature.measured {
                Measured::Hole => None,
                Measured::Form(of) => Some([0, 1, 2].map(|which| form(points, which, of))),
            })
            .collect();
        let features = self.part.features.iter().enumerate();
        features.map(|(place, feature)| self.one(place, feature, &forms)).collect()
    }

    /// Best-fit rigid-body alignment of all points, separately for both programs; all points have equal weight.
    fn align(&mut self) {
        let motions = [1, 2].map(|which| {
            let mut sums = RigidSums::default();
            for three in self.points.iter().flatten() {
                let [wanted, cut] = [three[0], three[which]].map(Vector3::from);
                sums.take(&wanted, &(cut - wanted));
            }
            sums.motion()
        });
        let aligned = |motion: &RigidMotion, wanted: [f64; 3], cut: [f64; 3]| {
            let [wanted, cut] = [wanted, cut].map(Vector3::from);
            (wanted + motion.left_mm(&wanted, &(cut - wanted))).into()
        };
        for three in self.points.iter_mut().flatten() {
            for (motion, which) in motions.iter().zip([1, 2]) {
                three[which] = aligned(motion, three[0], three[which]);
            }
        }
    }

    fn one(
        &self,
        place: usize,
        feature: &PartFeature,
        forms: &[Option<[Result<Form, FormError>; 3]>],
    ) -> Inspected {
        let points = &self.points[place];
        let found = match &forms[place] {
            _ if points.is_empty() => Err(InspectError::NothingCut { lines: feature.lines }),
            None => Ok([1, 2].map(|which| Found {
                position_um: Some(1e3 * mean_distance(points, which)),
                ..Found::default()
            })),
            Some([Ok(nominal), Ok(before), Ok(after)]) => {
                let datum_of = |which: usize| {
                    let forms = forms[feature.datum?].as_ref()?;
                    forms[which].as_ref().ok()
                };
                Ok([(before, 1), (after, 2)]
                    .map(|(form, which)| found(feature, nominal, form, datum_of(which))))
            }
            Some([Err(error), ..] | [_, Err(error), _] | [_, _, Err(error)]) => {
                Err(InspectError::Form(error.clone()))
            }
        };
        Inspected { name: feature.name.clone(), points: points.len(), found }
    }
}

/// Inspection result of a feature, with the original and with the compensated program.
#[derive(Clone, Debug, PartialEq)]
#[non_exhaustive]
pub struct Inspected {
    /// Name in the part file.
    pub name: String,
    /// Number of points evaluated.
    pub points: usize,
    /// Results with the original and with the compensated program, or the reason why they are missing.
    pub found: Result<[Found; 2], InspectError>,
}

/// Reason why a feature has no inspection result.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum InspectError {
    /// No motion of these lines cuts (or drills, for a hole).
    #[error("lines {} to {} of the program have no motion that cuts it", lines[0], lines[1])]
    NothingCut {
        /// First and last line, counted from 1.
        lines: [usize; 2],
    },
    /// The points do not determine the feature.
    #[error(transparent)]
    Form(#[from] FormError),
}

/// Measured deviations of a feature.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
#[cfg_attr(feature = "schema", derive(serde::Serialize, schemars::JsonSchema))]
#[non_exhaustive]
pub struct Found {
    /// Form deviation from the least-squares feature, µm; `None` for a hole.
    pub form_um: Option<f64>,
    /// Form deviation of the minimum zone, µm, where it is evaluated.
    pub minimum_zone_um: Option<f64>,
    /// Distance of the centre or axis from its nominal, µm; for an axis the distance at its farther end.
    pub position_um: Option<f64>,
    /// Angle between actual and nominal direction, µrad.
    pub direction_urad: Option<f64>,
    /// Actual minus nominal radius, µm.
    pub radius_um: Option<f64>,
    /// Coaxiality (concentricity) to the actual datum axis, µm.
    pub coaxiality_um: Option<f64>,
}

fn form(points: &[Three], which: usize, of: Feature) -> Result<Form, FormError> {
    let points: Vec<[f64; 3]> = points.iter().map(|three| three[which]).collect();
    evaluate_form(&points, of)
}

/// Distance between the mean of the points and the mean of their nominal positions, mm.
fn mean_distance(points: &[Three], which: usize) -> f64 {
    let mut sum = [0.0; 3];
    for three in points {
        for axis in 0..3 {
            sum[axis] += (three[which][axis] - three[0][axis]) / points.len() as f64;
        }
    }
    sum.iter().map(|x| x * x).sum::<f64>().sqrt()
}

fn found(feature: &PartFeature, nominal: &Form, form: &Form, datum: Option<&Form>) -> Found {
    let um = |mm: f64| 1e3 * mm;
    let angle = || {
        let cosine: f64 = dot(nominal.direction, form.direction).abs();
        let [a, b] = [nominal.direction, form.direction];
        let sine = cross(a, b).iter().map(|x| x * x).sum::<f64>().sqrt();
        1e6 * sine.atan2(cosine)
    };
    let distance = |of: &Axis, to: &Form| -> Option<f64> {
        let axis = DatumAxis::new(to.position_mm, to.direction).ok()?;
        Some(um(of.coaxiality_mm(&axis)))
    };
    let (position_um, direction_urad) = match feature.measured {
        Measured::Form(Feature::Circle { plane }) => {
            let by = [0, 1, 2].map(|k| form.position_mm[k] - nominal.position_mm[k]);
            // A roundness measurement does not give the position along the circle's normal.
            let normal = plane.map_or(nominal.direction, CoordinatePlane::normal);
            let out = dot(by, normal);
            let within = [0, 1, 2].map(|k| by[k] - out * normal[k]);
            (Some(um(dot(within, within).sqrt())), None)
        }
        Measured::Form(Feature::Cylinder | Feature::Cone) => {
            let axis = form.axis.as_ref();
            (axis.and_then(|axis| distance(axis, nominal)).map(|um| 0.5 * um), Some(angle()))
        }
        Measured::Form(Feature::Line { .. } | Feature::Plane) => (None, Some(angle())),
        Measured::Hole => (None, None),
    };
    Found {
        form_um: Some(um(form.deviation_mm)),
        minimum_zone_um: form.minimum_zone.as_ref().map(|zone| um(zone.deviation_mm)),
        position_um,
        direction_urad,
        radius_um: form.radius_mm.zip(nominal.radius_mm).map(|(found, wanted)| um(found - wanted)),
        coaxiality_um: datum.and_then(|datum| distance(form.axis.as_ref()?, datum)),
    }
}

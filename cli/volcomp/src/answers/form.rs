//! The JSON document of `volcomp form`.

use schemars::JsonSchema;
use serde::Serialize;
use volcomp_metrology::form::{FeatureKind, Form as Evaluated};

/// The document of `volcomp form`.
#[derive(Debug, Serialize, JsonSchema)]
pub(crate) struct Form {
    /// `circle`, `line`, `plane`, `cylinder` or `cone`.
    pub(crate) feature: String,
    /// The number of points.
    pub(crate) points: usize,
    /// Centre of a circle, apex of a cone, mean of the points of a plane, middle of a line or of the axis of a cylinder, mm.
    pub(crate) position_mm: [f64; 3],
    /// Unit vector: along a line or an axis, at right angles to a plane or to the plane of a circle; of a cone from the
    /// apex into it, of all others with the largest component positive.
    pub(crate) direction: [f64; 3],
    /// Radius of a circle or a cylinder, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) radius_mm: Option<f64>,
    /// Half of the angle at the apex of a cone, deg.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) half_angle_deg: Option<f64>,
    /// The two ends of a line or an axis over the extent of the points, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) axis_mm: Option<[[f64; 3]; 2]>,
    /// The form deviation.
    pub(crate) deviation_um: Deviation,
    /// Range of the points at right angles to the plane of a circle, or of a line in a plane, µm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) out_of_plane_um: Option<f64>,
    /// The narrowest ring, layer or strip that holds all points; null where none is evaluated.
    pub(crate) minimum_zone: Option<Zone>,
    /// Coaxiality (concentricity of a circle's centre) to the axis of `--datum`, µm; only with `--datum`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) coaxiality_um: Option<f64>,
    /// What a person should know besides.
    pub(crate) notes: Vec<String>,
}

/// Roundness, straightness, flatness, cylindricity or the form deviation of a cone, µm.
#[derive(Clone, Copy, Debug, Serialize, JsonSchema)]
pub(crate) struct Deviation {
    /// About the feature of least squares: the range of the distances from it; of a line in space the diameter of the
    /// cylinder about it that holds all points.
    pub(crate) least_squares: f64,
    /// By the minimum zone; null where none is evaluated.
    pub(crate) minimum_zone: Option<f64>,
    /// Root mean square of the distances from the feature of least squares.
    pub(crate) rms: f64,
}

/// A minimum zone.
#[derive(Clone, Debug, Serialize, JsonSchema)]
pub(crate) struct Zone {
    /// Centre of the ring, or a point in the middle of the layer or strip, mm.
    pub(crate) position_mm: [f64; 3],
    /// Unit vector at right angles to the ring or layer, along the strip.
    pub(crate) direction: [f64; 3],
    /// Inner and outer radius of the ring, mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub(crate) radii_mm: Option<[f64; 2]>,
    /// Lines of the file whose points touch the borders and hold the zone from becoming narrower.
    pub(crate) contact_lines: Vec<usize>,
}

impl Form {
    /// The document of an evaluation; `lines` are those of the points in the file.
    pub(crate) fn new(
        form: &Evaluated,
        lines: &[usize],
        coaxiality_mm: Option<f64>,
        notes: Vec<String>,
    ) -> Self {
        const UM_PER_MM: f64 = 1e3;
        let zone = form.minimum_zone.as_ref();
        let line_of = |&point: &usize| lines.get(point).copied();
        Self {
            feature: form.feature.to_string(),
            points: form.points,
            position_mm: form.position_mm,
            direction: form.direction,
            radius_mm: form.radius_mm,
            half_angle_deg: form.half_angle_rad.map(f64::to_degrees),
            axis_mm: (form.axis)
                .filter(|_| form.feature != FeatureKind::Circle)
                .map(|axis| axis.ends_mm),
            deviation_um: Deviation {
                least_squares: form.deviation_mm * UM_PER_MM,
                minimum_zone: zone.map(|zone| zone.deviation_mm * UM_PER_MM),
                rms: form.rms_mm * UM_PER_MM,
            },
            out_of_plane_um: form.out_of_plane_mm.map(|mm| mm * UM_PER_MM),
            minimum_zone: zone.map(|zone| Zone {
                position_mm: zone.position_mm,
                direction: zone.direction,
                radii_mm: zone.radii_mm,
                contact_lines: zone.contacts.iter().filter_map(line_of).collect(),
            }),
            coaxiality_um: coaxiality_mm.map(|mm| mm * UM_PER_MM),
            notes,
        }
    }
}

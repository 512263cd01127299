//! The part of `volcomp nc --inspect`: what a measuring machine would find of it, before and after.

use std::path::Path;

use volcomp_document::read_text;
use volcomp_nc::{Found, InspectError, Inspected, Part};

use super::{fixed, table, table_text};
use crate::{
    answers::nc::{NcFeature, NcFound},
    failure::Failure,
};

pub(super) fn read(path: &Path) -> Result<Part, Failure> {
    Ok(Part::parse(&read_text(path)?, &path.display().to_string())?)
}

/// What was found; of what could not be evaluated the reason names the key of the part file.
pub(super) fn document(features: &[Inspected], part: &Path) -> Vec<NcFeature> {
    let reason = |place: usize, error: &InspectError| {
        let key = match error {
            InspectError::NothingCut { .. } => "lines",
            _ => "kind",
        };
        format!("{}: feature[{place}].{key}: {error}", part.display())
    };
    let feature = |(place, of): (usize, &Inspected)| {
        let [before, after] = match &of.found {
            Ok(found) => found.map(|found| Some(numbers(found))),
            Err(_) => [None; 2],
        };
        NcFeature {
            name: of.name.clone(),
            points: of.points,
            before,
            after,
            reason: (of.found.as_ref().err()).map(|error| reason(place, error)),
        }
    };
    features.iter().enumerate().map(feature).collect()
}

fn numbers(found: Found) -> NcFound {
    NcFound {
        form_um: found.form_um,
        minimum_zone_um: found.minimum_zone_um,
        position_um: found.position_um,
        direction_urad: found.direction_urad,
        radius_um: found.radius_um,
        coaxiality_um: found.coaxiality_um,
    }
}

/// What is read of one kind of number.
type Take = fn(&NcFound) -> Option<f64>;

/// Each number of each feature, before and after.
pub(super) fn text(features: &[NcFeature], best_fit: bool) -> String {
    const NUMBERS: [(&str, Take, &str); 6] = [
        ("form", |f| f.form_um, "µm"),
        ("minimum zone", |f| f.minimum_zone_um, "µm"),
        ("position", |f| f.position_um, "µm"),
        ("direction", |f| f.direction_urad, "µrad"),
        ("radius", |f| f.radius_um, "µm"),
        ("coaxiality", |f| f.coaxiality_um, "µm"),
    ];
    let mut rows = table(&["feature", "", "before", "after", ""]);
    let mut reasons = String::new();
    for feature in features {
        let mut name = feature.name.as_str();
        for (what, of, unit) in NUMBERS {
            let both = feature
                .before
                .as_ref()
                .and_then(of)
                .zip(feature.after.as_ref().and_then(of));
            if let Some((before, after)) = both {
                let [before, after] = [before, after].map(|number| fixed(number, 2));
                rows.add_row([name, what, &before, &after, unit]);
                name = "";
            }
        }
        if let Some(reason) = &feature.reason {
            reasons += &crate::table::folded(&format!("{}: {reason}", feature.name), "");
        }
    }
    let part = if rows.is_empty() {
        String::new()
    } else {
        table_text(&rows)
    };
    let aligned = if best_fit {
        ", aligned by all its points"
    } else {
        ""
    };
    format!("\nThe part as a measuring machine would find it{aligned}:\n{part}{reasons}")
}

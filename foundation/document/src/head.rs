//! Column heads, which are a name alone, or a name followed by a unit.

/// Units and their spellings, in lower case. The case of a spelling is ignored.
const UNITS: [(&str, &[&str]); 14] = [
    ("mm", &["mm"]),
    // Lower case does not turn the micro sign into the Greek letter, so both are listed.
    ("um", &["um", "µm", "μm", "micron", "microns"]),
    ("nm", &["nm"]),
    ("cm", &["cm"]),
    ("m", &["m"]),
    ("in", &["in", "inch"]),
    ("ft", &["ft"]),
    ("deg", &["deg", "°"]),
    ("rad", &["rad"]),
    ("mrad", &["mrad"]),
    ("urad", &["urad", "µrad", "μrad"]),
    ("arcsec", &["arcsec"]),
    ("gon", &["gon"]),
    ("degc", &["degc", "°c"]),
];

/// Splits a column head after its first word. Returns the name and the remaining text (a unit, or empty) without
/// surrounding blanks and punctuation: `X` and `mm` for `X mm`, `dx` and `um` for `dx_um`, `C` and `deg` for `C (deg)`.
pub fn split_head(head: &str) -> (&str, &str) {
    let is_mark = |c: char| c.is_whitespace() || "_-/,:.[](){}".contains(c);
    let end = head.find(|c: char| !c.is_alphanumeric());
    let (name, behind) = head.split_at(end.unwrap_or(head.len()));
    (name, behind.trim_matches(is_mark))
}

/// Splits a head that ends in a known unit into name and unit: `dz` and `um` for `dz_um` and `dz [µm]`, `spindle front`
/// and `degc` for `spindle front °C`. `None` if the head does not end in a known unit.
pub fn split_unit(head: &str) -> Option<(&str, &'static str)> {
    let is_mark = |c: char| c.is_whitespace() || "_-/,:.[](){}".contains(c);
    let (name, behind) = split_head(head);
    let (name, unit) = if let Some(unit) = unit_named(behind) {
        (name, unit)
    } else {
        // The name itself may contain blanks and punctuation.
        let head = head.trim_end_matches(is_mark);
        let (name, behind) = head.rsplit_once(is_mark)?;
        (name.trim_end_matches(is_mark), unit_named(behind)?)
    };
    (!name.is_empty()).then_some((name, unit))
}

/// Unit with any of its names: `um` for `µm`, `deg` for `°`; `None` for an unknown unit.
pub fn unit_named(text: &str) -> Option<&'static str> {
    let small = text.to_lowercase();
    let is_it = |(_, names): &&(&str, &[&str])| names.contains(&small.as_str());
    UNITS.iter().find(is_it).map(|(unit, _)| *unit)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_are_names_alone_or_with_a_unit() {
        for (head, name, behind) in [
            ("target", "target", ""),
            ("Target mm", "Target", "mm"),
            ("dx_um", "dx", "um"),
            ("deviation [µm]", "deviation", "µm"),
            ("C°", "C", "°"),
            ("X, mm", "X", "mm"),
            ("dead_length_mm", "dead", "length_mm"),
            ("targetµ", "targetµ", ""),
            ("", "", ""),
            ("_mm", "", "mm"),
        ] {
            assert_eq!(split_head(head), (name, behind), "{head}");
        }
    }

    #[test]
    fn names_may_have_marks_before_their_unit() {
        for (head, expected) in [
            ("dz_um", Some(("dz", "um"))),
            ("dz µm", Some(("dz", "um"))),
            ("rot [µrad]", Some(("rot", "urad"))),
            ("spindle_front_degc", Some(("spindle_front", "degc"))),
            ("spindle front °C", Some(("spindle front", "degc"))),
            ("spindle front [°C]", Some(("spindle front", "degc"))),
            ("t1°C", Some(("t1", "degc"))),
            ("time_s", None),
            ("dz", None),
            ("um", None),
            ("_um", None),
            ("µm", None),
            ("", None),
        ] {
            assert_eq!(split_unit(head), expected, "{head}");
        }
    }

    #[test]
    fn units_have_several_names() {
        for (text, unit) in [
            ("MM", Some("mm")),
            ("µm", Some("um")),
            ("Microns", Some("um")),
            ("μrad", Some("urad")),
            ("°", Some("deg")),
            ("inch", Some("in")),
            ("", None),
            ("thou", None),
        ] {
            assert_eq!(unit_named(text), unit, "{text}");
        }
    }
}

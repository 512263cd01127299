//! The head of a column of readings: its name, alone or with a unit behind it.

/// A head is a name alone or with its unit behind a blank or a mark: `target`, `target mm`, `target_mm`,
/// `deviation [µm]`. The unit; `None` where the head is another one.
pub(crate) fn unit_of<'a>(head: &'a str, name: &str) -> Option<&'a str> {
    let behind = head.get(name.len()..)?;
    let is_mark = |c: char| c.is_whitespace() || "_-/,:[](){}".contains(c);
    let is_named = head[..name.len()].eq_ignore_ascii_case(name);
    let ends_there = behind.is_empty() || behind.starts_with(is_mark);
    (is_named && ends_there).then(|| behind.trim_matches(is_mark))
}

/// Whether targets may be in this unit, which the file then states.
pub(crate) fn is_target_unit(unit: &str) -> bool {
    ["", "mm", "deg", "°"].contains(&unit.to_lowercase().as_str())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn heads_are_names_alone_or_with_a_unit() {
        for (head, unit) in [
            ("target", Some("")),
            ("Target mm", Some("mm")),
            ("target_mm", Some("mm")),
            ("target [deg]", Some("deg")),
            ("targets", None),
            ("tar", None),
            ("deviation", None),
            ("targeµ", None),
        ] {
            assert_eq!(unit_of(head, "target"), unit, "{head}");
        }
    }
}

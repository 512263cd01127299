//! The tables `[tool]` and `[tools]` of a machine file.

use std::collections::BTreeMap;

use volcomp_document::{InputError, Section, Value};

use super::axes::decode_direction;
use crate::tool::Tool;

pub(super) fn decode_tool(section: &Section<'_>) -> Result<Tool, InputError> {
    section.allow(&["tip", "axis", "gauge", "length", "offset"])?;
    if let (Some(tip), Some(_)) = (section.get("tip"), section.get("gauge")) {
        return Err(tip.error("found tip and gauge together, expected one of them"));
    }
    let vector = |key: &str| section.optional(key, Value::vector);
    Ok(Tool {
        tip_mm: vector("tip")?,
        gauge_mm: vector("gauge")?,
        length_mm: section.optional("length", Value::number)?,
        offset_mm: vector("offset")?,
        axis: section.optional("axis", decode_direction)?,
    })
}

/// `length` and `offset` require a gauge point.
pub(super) fn check_gauge_keys(
    root: &Section<'_>,
    tool: &Tool,
    tools: &BTreeMap<String, Tool>,
) -> Result<(), InputError> {
    let without_gauge =
        |t: &Tool| t.gauge_mm.is_none() && (t.length_mm.is_some() || t.offset_mm.is_some());
    let message = "length and offset need a gauge point: key `gauge` is missing";
    if let (true, Some(section)) = (without_gauge(tool), root.section("tool")?) {
        return Err(section.error(message));
    }
    if tool.gauge_mm.is_some() {
        return Ok(());
    }
    for (name, other) in tools {
        if without_gauge(other)
            && let Some(section) = root.section("tools")?.and_then(|s| s.get(name))
        {
            return Err(section.error(message));
        }
    }
    Ok(())
}

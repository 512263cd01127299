//! The tables `[[controller]]` and `[[thermometer]]`.

use std::collections::BTreeMap;

use volcomp_digital_io::{Coherence, CorrectionCode, PositionCode};
use volcomp_document::{InputError, Section, Value};
use volcomp_focas::{PmcAddress, PmcArea, Width};
use volcomp_vocabulary::{AxisName, MAX_AXES};

use super::{ControllerConfig, DigitalConfig, ThermometerConfig};

pub(super) fn controller(section: &Section<'_>) -> Result<ControllerConfig, InputError> {
    section.allow(&[
        "url",
        "channel",
        "axes",
        "fixed",
        "area",
        "resolution_um",
        "resolution_urad",
        "heartbeat",
        "unwatched",
        "includes_correction",
        "test_shift",
        "referenced",
        "digital",
    ])?;
    let area = |value: Value<'_>| -> Result<_, InputError> {
        let section = value.section()?;
        section.allow(&["pmc", "first", "width"])?;
        let first = pmc_address(&section, "first")?;
        let width = match section
            .get("width")
            .map(|w| Ok::<_, InputError>((w.count(4)?, w)))
            .transpose()?
        {
            None | Some((2, _)) => Width::Word,
            Some((1, _)) => Width::Byte,
            Some((4, _)) => Width::Long,
            Some((found, width)) => {
                return Err(width.error(format!("found {found}, expected 1, 2 or 4 bytes")));
            }
        };
        Ok((first, width))
    };
    let byte = |value: Value<'_>| -> Result<PmcAddress, InputError> {
        let section = value.section()?;
        section.allow(&["pmc", "at"])?;
        pmc_address(&section, "at")
    };
    let fixed = match section.section("fixed")? {
        None => BTreeMap::new(),
        Some(fixed) => fixed
            .values()
            .map(|(name, value)| Ok((axis_name(&value, name)?, value.number()?)))
            .collect::<Result<_, InputError>>()?,
    };
    let referenced = match section.get("referenced") {
        None => None,
        Some(value) if value.truth().is_ok_and(|asked| !asked) => Some(None),
        Some(value) => Some(Some(byte(value)?)),
    };
    let heartbeat = section.get("heartbeat").map(byte).transpose()?;
    let unwatched = section.truth_or("unwatched", false)?;
    if heartbeat.is_some() && unwatched {
        return Err(
            section.error("found both heartbeat and unwatched = true, expected one of them")
        );
    }
    Ok(ControllerConfig {
        url: section.require("url")?.text()?.to_owned(),
        channel: section
            .get("channel")
            .map(|value| value.text().map(str::to_owned))
            .transpose()?,
        axes: axes(&section.require("axes")?)?,
        fixed,
        resolution_um: section.optional("resolution_um", |v| v.number_in(1e-4..=1000.0))?,
        resolution_urad: section.optional("resolution_urad", |v| v.number_in(1e-4..=1e5))?,
        includes_correction: section.truth_or("includes_correction", false)?,
        unwatched,
        proves: section.optional("test_shift", Value::truth)?,
        area: section.get("area").map(area).transpose()?,
        heartbeat,
        referenced,
        digital: section
            .section("digital")?
            .map(|section| digital(&section))
            .transpose()?
            .unwrap_or_default(),
    })
}

fn axes(value: &Value<'_>) -> Result<Vec<AxisName>, InputError> {
    let names = value.texts()?;
    let letters = names
        .iter()
        .map(|name| axis_name(value, name))
        .collect::<Result<Vec<AxisName>, _>>()?;
    for (index, name) in letters.iter().enumerate() {
        if letters[..index].contains(name) {
            return Err(value.error(format!("axis {name} stands twice")));
        }
    }
    if letters.is_empty() || letters.len() > MAX_AXES {
        return Err(value.error(format!(
            "found {} axes, expected 1 to {}",
            letters.len(),
            MAX_AXES
        )));
    }
    Ok(letters)
}

fn axis_name(value: &Value<'_>, name: &str) -> Result<AxisName, InputError> {
    name.parse()
        .map_err(|e| value.error(format!("found the axis `{name}`, {e}")))
}

fn pmc_address(section: &Section<'_>, key: &str) -> Result<PmcAddress, InputError> {
    let value = section.require("pmc")?;
    let area = value.one_of(&[
        ("G", PmcArea::G),
        ("F", PmcArea::F),
        ("R", PmcArea::R),
        ("D", PmcArea::D),
    ])?;
    let at = section.require(key)?.whole(0..=u16::MAX)?;
    Ok(PmcAddress { area, at })
}

fn digital(section: &Section<'_>) -> Result<DigitalConfig, InputError> {
    section.allow(&[
        "position_bits",
        "position_mm_per_count",
        "position_zero_mm",
        "position_code",
        "correction_bits",
        "correction_code",
        "coherence",
    ])?;
    let published = DigitalConfig::default();
    let bits = |key: &str, default: u32| section.whole_or(key, 0..=32, default);
    Ok(DigitalConfig {
        position_bits: bits("position_bits", published.position_bits)?,
        position_mm_per_count: section.number_or(
            "position_mm_per_count",
            1e-6..=100.0,
            published.position_mm_per_count,
        )?,
        position_zero_mm: section.number_or("position_zero_mm", -1e6..=1e6, 0.0)?,
        position_code: section.one_of(
            "position_code",
            &[
                ("binary", PositionCode::Binary),
                ("gray", PositionCode::Gray),
            ],
            published.position_code,
        )?,
        correction_bits: bits("correction_bits", published.correction_bits)?,
        correction_code: section.one_of(
            "correction_code",
            &[
                ("twos-complement", CorrectionCode::TwosComplement),
                ("sign-magnitude", CorrectionCode::SignMagnitude),
            ],
            published.correction_code,
        )?,
        coherence: section.one_of(
            "coherence",
            &[
                ("two-agree", Coherence::TwoAgree),
                ("latched", Coherence::Latched),
            ],
            published.coherence,
        )?,
    })
}

pub(super) fn thermometer(section: &Section<'_>) -> Result<ThermometerConfig, InputError> {
    section.allow(&["url", "names"])?;
    let names = section.require("names")?.texts()?;
    Ok(ThermometerConfig {
        url: section.require("url")?.text()?.to_owned(),
        names: names.into_iter().map(str::to_owned).collect(),
    })
}

//! `[[controller]]` and `[[thermometer]]`.

use std::collections::BTreeMap;

use volcomp_digital_io::{Coherence, CorrectionCode, PositionCode};
use volcomp_document::{InputError, Section, Value};
use volcomp_focas::{PmcAddress, PmcArea, Width};

use super::{
    ControllerConfig, DigitalConfig, ThermometerConfig, number_in, number_or, one_of, truth_or,
};

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
            .map(|(name, value)| Ok((letter(&value, name)?, value.number()?)))
            .collect::<Result<_, InputError>>()?,
    };
    let referenced = match section.get("referenced") {
        None => None,
        Some(value) if value.truth().is_ok_and(|asked| !asked) => Some(None),
        Some(value) => Some(Some(byte(value)?)),
    };
    let heartbeat = section.get("heartbeat").map(byte).transpose()?;
    let unwatched = truth_or(section, "unwatched", false)?;
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
        resolution_um: section
            .get("resolution_um")
            .map(|v| number_in(&v, [1e-4, 1000.0]))
            .transpose()?,
        resolution_urad: section
            .get("resolution_urad")
            .map(|v| number_in(&v, [1e-4, 1e5]))
            .transpose()?,
        includes_correction: truth_or(section, "includes_correction", false)?,
        unwatched,
        proves: section
            .get("test_shift")
            .map(|value| value.truth())
            .transpose()?,
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

fn axes(value: &Value<'_>) -> Result<Vec<char>, InputError> {
    let names = value.texts()?;
    let letters = names
        .iter()
        .map(|name| letter(value, name))
        .collect::<Result<Vec<char>, _>>()?;
    for (index, name) in letters.iter().enumerate() {
        if letters[..index].contains(name) {
            return Err(value.error(format!("axis {name} stands twice")));
        }
    }
    if letters.is_empty() || letters.len() > volcomp_guard::MAX_AXES {
        return Err(value.error(format!(
            "found {} axes, expected 1 to {}",
            letters.len(),
            volcomp_guard::MAX_AXES
        )));
    }
    Ok(letters)
}

fn letter(value: &Value<'_>, name: &str) -> Result<char, InputError> {
    let mut letters = name.chars();
    match (letters.next(), letters.next()) {
        (Some(letter), None) if letter.is_ascii_uppercase() => Ok(letter),
        _ => Err(value.error(format!(
            "found the axis `{name}`, expected a letter such as X"
        ))),
    }
}

fn pmc_address(section: &Section<'_>, key: &str) -> Result<PmcAddress, InputError> {
    let value = section.require("pmc")?;
    let area = match value.text()? {
        "G" => PmcArea::G,
        "R" => PmcArea::R,
        "D" => PmcArea::D,
        "F" => PmcArea::F,
        other => return Err(value.error(format!("found `{other}`, expected one of G, F, R, D"))),
    };
    let at = section.require(key)?.count(usize::from(u16::MAX))?;
    Ok(PmcAddress {
        area,
        at: u16::try_from(at).unwrap_or(u16::MAX),
    })
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
    let bits = |key: &str, default: u32| match section.get(key) {
        None => Ok(default),
        Some(value) => Ok::<u32, InputError>(u32::try_from(value.count(32)?).unwrap_or(32)),
    };
    Ok(DigitalConfig {
        position_bits: bits("position_bits", published.position_bits)?,
        position_mm_per_count: number_or(
            section,
            "position_mm_per_count",
            [1e-6, 100.0],
            published.position_mm_per_count,
        )?,
        position_zero_mm: number_or(section, "position_zero_mm", [-1e6, 1e6], 0.0)?,
        position_code: one_of(
            section,
            "position_code",
            published.position_code,
            &[
                ("binary", PositionCode::Binary),
                ("gray", PositionCode::Gray),
            ],
        )?,
        correction_bits: bits("correction_bits", published.correction_bits)?,
        correction_code: one_of(
            section,
            "correction_code",
            published.correction_code,
            &[
                ("twos-complement", CorrectionCode::TwosComplement),
                ("sign-magnitude", CorrectionCode::SignMagnitude),
            ],
        )?,
        coherence: one_of(
            section,
            "coherence",
            published.coherence,
            &[
                ("two-agree", Coherence::TwoAgree),
                ("latched", Coherence::Latched),
            ],
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

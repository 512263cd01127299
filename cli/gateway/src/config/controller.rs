//! The tables `[[controller]]` and `[[thermometer]]`.

use std::{collections::BTreeMap, ops::RangeInclusive, path::Path, time::Duration};

use volcomp_devices::{Address, Scheme};
use volcomp_digital_io::{
    Coherence, CorrectionCode, CorrectionWord, DigitalAxis, PositionCode, PositionWord,
};
use volcomp_document::{InputError, Section, Value};
use volcomp_focas::{PmcAddress, PmcArea, Width};
use volcomp_guard::{barrier::LARGEST_MACHINE, ceiling};
use volcomp_port::ShownStates;
use volcomp_vocabulary::{AxisKind, AxisName, Deg, Displacement, MAX_AXES};

use super::{
    AreaConfig, BarrierConfig, ControllerConfig, ControllerKind, DigitalConfig, LinuxCncTable,
    ThermometerConfig, is_blank, kinds, sinumerik,
};

pub(super) fn controller(
    section: &Section<'_>,
    cycle_ms: f64,
    folder: &Path,
) -> Result<ControllerConfig, InputError> {
    kinds::check(section)?;
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
        Some(value) => Some(Some(byte(&value)?)),
    };
    let heartbeat = section
        .get("heartbeat")
        .map(|value| byte(&value))
        .transpose()?;
    let unwatched = section.truth_or("unwatched", false)?;
    if heartbeat.is_some() && unwatched {
        return Err(
            section.error("found both heartbeat and unwatched = true, expected one of them")
        );
    }
    let barrier = section
        .section("barrier")?
        .map(|table| barrier(section, &table))
        .transpose()?;
    let area = section.get("area").map(|value| area(&value)).transpose()?;
    let (written, reads) = axes(section)?;
    if written.is_empty() {
        kinds::check_reader(section)?;
    }
    let names: Vec<AxisName> = written.iter().chain(&reads).copied().collect();
    for (key, kind) in [
        ("resolution_um", AxisKind::Linear),
        ("resolution_urad", AxisKind::Rotary),
    ] {
        if let Some(value) = section.get(key) {
            has_axis(&value, kind, &written)?;
        }
    }
    let not_driven = section.optional("not_driven", letters)?;
    let (only_thermal, hold) = terms_and_hold(section, cycle_ms)?;
    let table = section.section("sinumerik")?;
    let table = table
        .map(|table| sinumerik::table(&table, folder))
        .transpose()?;
    let table = table.unwrap_or_default();
    if kinds::address(section)?.scheme == Scheme::OpcUa && !written.is_empty() {
        sinumerik::check_path(section, only_thermal, hold, &table)?;
    }
    Ok(ControllerConfig {
        url: kinds::address(section)?.text,
        channel: section.optional("channel", |value| match value.text()? {
            name if is_blank(name) => Err(value.error(format!(
                "found {name:?}, expected a name of visible characters"
            ))),
            name => Ok(name.to_owned()),
        })?,
        axes: written,
        reads,
        fixed,
        not_driven: not_driven.unwrap_or_default().into_iter().collect(),
        resolution_um: section.optional("resolution_um", |v| v.number_in(1e-4..=1000.0))?,
        resolution_urad: section.optional("resolution_urad", |v| v.number_in(1e-4..=1e5))?,
        includes_correction: section.truth_or("includes_correction", false)?,
        unwatched,
        unseen: section
            .optional("unseen", |value| unseen(value))?
            .unwrap_or(ShownStates::NONE),
        only_thermal,
        hold,
        proves: section.optional("test_shift", Value::truth)?,
        area,
        barrier,
        heartbeat,
        referenced,
        digital: section
            .section("digital")?
            .map(|section| digital(&section, &names))
            .transpose()?
            .unwrap_or_default(),
        sinumerik: table,
        linuxcnc: linuxcnc(section, folder)?,
    })
}

/// The files of the table `linuxcnc`.
fn linuxcnc(section: &Section<'_>, folder: &Path) -> Result<LinuxCncTable, InputError> {
    let Some(table) = section.section("linuxcnc")? else {
        return Ok(LinuxCncTable::default());
    };
    table.allow(&["key_file", "ini"])?;
    let file = |value: &Value<'_>| Ok(folder.join(value.text()?));
    Ok(LinuxCncTable {
        key_file: table.optional("key_file", file)?,
        ini: table.optional("ini", file)?,
    })
}

/// The words of the shifts, `{ pmc = "R", first = 100, width = 2 }`.
fn area(value: &Value<'_>) -> Result<AreaConfig, InputError> {
    let section = value.section()?;
    section.allow(&["pmc", "first", "width", "copied"])?;
    let width = match section
        .get("width")
        .map(|w| Ok::<_, InputError>((w.count(4)?, w)))
    {
        None => Width::Word,
        Some(width) => match width? {
            (1, _) => Width::Byte,
            (2, _) => Width::Word,
            (4, _) => Width::Long,
            (found, width) => {
                return Err(width.error(format!("found {found}, expected 1, 2 or 4 bytes")));
            }
        },
    };
    Ok(AreaConfig {
        first: pmc_address(&section, "first")?,
        width,
        copied: section.truth_or("copied", false)?,
    })
}

/// Whether the controller carries thermal terms alone, and how long it may hold.
fn terms_and_hold(
    section: &Section<'_>,
    cycle_ms: f64,
) -> Result<(bool, Option<Duration>), InputError> {
    let only_thermal = section.optional("terms", |value| match value.texts()?[..] {
        ["thermal"] => Ok(true),
        _ => Err(value.error("expected [\"thermal\"], or no such key: all terms")),
    })?;
    let only_thermal = only_thermal.unwrap_or(false);
    let longest = if only_thermal {
        ceiling::HOLD_THERMAL
    } else {
        ceiling::HOLD
    };
    let hold_ms = section.optional("hold_ms", |value| {
        value.number_in(cycle_ms..=longest.as_secs_f64() * 1e3)
    })?;
    let hold = hold_ms.map(|ms| Duration::from_secs_f64(ms * 1e-3));
    Ok((only_thermal, hold))
}

/// A byte of the PMC, `{ pmc = "R", at = 120 }`.
pub(super) fn byte(value: &Value<'_>) -> Result<PmcAddress, InputError> {
    let section = value.section()?;
    section.allow(&["pmc", "at"])?;
    pmc_address(&section, "at")
}

/// The table `barrier` of a controller. The keys of the plain scheme have no place beside it.
fn barrier(controller: &Section<'_>, section: &Section<'_>) -> Result<BarrierConfig, InputError> {
    section.allow(&["machine", "scan_ms", "frame", "report"])?;
    for key in ["area", "heartbeat", "unwatched"] {
        if let Some(value) = controller.get(key) {
            return Err(value.error(
                "found this key beside barrier, expected it only where corrections are written as plain values",
            ));
        }
    }
    let is_focas = kinds::address(controller)?.scheme == Scheme::Focas;
    let words = |key: &str| {
        match (section.get(key), is_focas) {
        (Some(value), true) => byte(&value).map(Some),
        (None, true) => section.require(key).map(|_| None),
        (Some(value), false) => Err(value.error(
            "found this key for a controller that is no FANUC control, expected it only for focas://",
        )),
        (None, false) => Ok(None),
    }
    };
    let scan_ms = section.require("scan_ms")?.number_in(0.1..=100.0)?;
    Ok(BarrierConfig {
        machine: section.require("machine")?.whole(0..=LARGEST_MACHINE)?,
        scan: Duration::from_secs_f64(scan_ms * 1e-3),
        frame: words("frame")?,
        report: words("report")?,
    })
}

/// Refuses lines without a latch beside a barrier: without an edge it never takes their words.
pub(super) fn check_latches(
    root: &Section<'_>,
    controllers: &[ControllerConfig],
) -> Result<(), InputError> {
    let has_barrier = controllers.iter().any(|one| one.barrier.is_some());
    let never_taken = |one: &&ControllerConfig| {
        let kind = Address::parse(&one.url).map(|url| ControllerKind::of(url.scheme));
        kind.is_ok_and(|kind| kind == ControllerKind::Lines)
            && !one.axes.is_empty()
            && one.digital.latch.is_none()
    };
    match controllers.iter().find(never_taken).filter(|_| has_barrier) {
        None => Ok(()),
        Some(lines) => Err(root.error(format!(
            "{}: digital.latch: missing, expected the line that the gateway turns once the word has settled: the barrier of the control takes words of lines at its edges only",
            lines.url
        ))),
    }
}

/// The axes that a controller writes, and those that it only reads.
fn axes(section: &Section<'_>) -> Result<(Vec<AxisName>, Vec<AxisName>), InputError> {
    let (value, further) = (section.require("axes")?, section.get("reads"));
    let written = letters(&value)?;
    let reads = further
        .as_ref()
        .map(letters)
        .transpose()?
        .unwrap_or_default();
    if let Some(further) = &further {
        if reads.is_empty() {
            return Err(
                further.error("found no axis, expected the letters of axes that are only read")
            );
        }
        if let Some(name) = reads.iter().find(|name| written.contains(name)) {
            return Err(further.error(format!(
                "axis {name} stands among axes, too: an axis that is written is read anyway"
            )));
        }
    }
    let found = written.len() + reads.len();
    if !(1..=MAX_AXES).contains(&found) {
        return Err(value.error(format!("found {found} axes, expected 1 to {MAX_AXES}")));
    }
    Ok((written, reads))
}

/// Letters of axes, each once.
fn letters(value: &Value<'_>) -> Result<Vec<AxisName>, InputError> {
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
    Ok(letters)
}

fn axis_name(value: &Value<'_>, name: &str) -> Result<AxisName, InputError> {
    name.parse()
        .map_err(|e| value.error(format!("found the axis `{name}`, {e}")))
}

/// The names of states, each once.
fn unseen(value: &Value<'_>) -> Result<ShownStates, InputError> {
    let mut unseen = ShownStates::NONE;
    for name in value.texts()? {
        let state = match name {
            "referenced" => &mut unseen.referenced,
            "alarm" => &mut unseen.alarm,
            "emergency_stop" => &mut unseen.emergency_stop,
            other => {
                return Err(value.error(format!(
                    "found {other:?}, expected referenced, alarm or emergency_stop"
                )));
            }
        };
        if std::mem::replace(state, true) {
            return Err(value.error(format!("{name} stands twice")));
        }
    }
    Ok(unseen)
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

/// Refuses a key whose unit none of the axes has.
fn has_axis(value: &Value<'_>, kind: AxisKind, axes: &[AxisName]) -> Result<(), InputError> {
    if axes.iter().any(|name| name.kind() == kind) {
        return Ok(());
    }
    let names: Vec<String> = axes.iter().map(ToString::to_string).collect();
    Err(value.error(format!(
        "found this key for the axes {}, expected it only where an axis is {kind}",
        names.join(" ")
    )))
}

/// A coordinate that has a key in mm for linear and one in deg for rotary axes.
fn coordinate(
    section: &Section<'_>,
    axes: &[AxisName],
    keys: [&str; 2],
    range: RangeInclusive<f64>,
) -> Result<Option<Displacement>, InputError> {
    let mut found = None;
    for (key, kind) in keys.into_iter().zip([AxisKind::Linear, AxisKind::Rotary]) {
        if let Some(value) = section.get(key) {
            has_axis(&value, kind, axes)?;
            let number = value.number_in(range.clone())?;
            found = Some(Displacement::from_coordinate(kind, number));
        }
    }
    Ok(found)
}

fn digital(section: &Section<'_>, axes: &[AxisName]) -> Result<DigitalConfig, InputError> {
    section.allow(&[
        "position_bits",
        "position_mm_per_count",
        "position_deg_per_count",
        "position_zero_mm",
        "position_zero_deg",
        "position_code",
        "correction_bits",
        "correction_code",
        "latch",
        "time_out_ms",
        "coherence",
    ])?;
    let published = DigitalConfig::default();
    let latch = section.optional("latch", |value| value.whole(0..=63))?;
    let time_out_ms = section.optional("time_out_ms", |value| match latch {
        Some(_) => value.number_in(10.0..=600_000.0),
        None => Err(value.error(
            "found this key without latch, expected it only where the control sees edges of a latch that may fail to come",
        )),
    })?;
    let bits = |key: &str, default: u32| section.whole_or(key, 0..=32, default);
    Ok(DigitalConfig {
        position_bits: bits("position_bits", published.position_bits)?,
        position_step: coordinate(
            section,
            axes,
            ["position_mm_per_count", "position_deg_per_count"],
            1e-6..=100.0,
        )?,
        position_zero: coordinate(
            section,
            axes,
            ["position_zero_mm", "position_zero_deg"],
            -1e6..=1e6,
        )?,
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
        latch,
        time_out: time_out_ms.map(|ms| Duration::from_secs_f64(ms * 1e-3)),
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

pub(super) fn thermometer(
    section: &Section<'_>,
    folder: &Path,
) -> Result<ThermometerConfig, InputError> {
    let address = kinds::address(section)?;
    let is_sinumerik = address.scheme == Scheme::OpcUa;
    section.allow(&["url", "names", "nodes", "sinumerik"])?;
    for key in ["nodes", "sinumerik"] {
        if let Some(value) = section.get(key).filter(|_| !is_sinumerik) {
            return Err(value.error(
                "found this key for another thermometer than a SINUMERIK control, expected it only for opc.tcp://",
            ));
        }
    }
    let names = section.require("names")?.texts()?;
    let mut nodes = Vec::new();
    if is_sinumerik {
        let value = section.require("nodes")?;
        nodes.extend(value.texts()?.into_iter().map(str::to_owned));
        if nodes.len() != names.len() || nodes.is_empty() {
            return Err(value.error(format!(
                "found {} nodes for {} names, expected one node for each name",
                nodes.len(),
                names.len()
            )));
        }
    }
    let table = section.section("sinumerik")?;
    let table = table
        .map(|table| sinumerik::server(&table, folder))
        .transpose()?;
    Ok(ThermometerConfig {
        url: address.text,
        names: names.into_iter().map(str::to_owned).collect(),
        nodes,
        sinumerik: table.unwrap_or_default(),
    })
}

impl ControllerConfig {
    /// The smallest step of a correction that the configuration states for this kind of axis.
    pub fn resolution(&self, kind: AxisKind) -> Option<Displacement> {
        let micro = match kind {
            AxisKind::Linear => self.resolution_um,
            AxisKind::Rotary => self.resolution_urad,
        };
        micro.map(|micro| Displacement::from_micro(kind, micro))
    }

    /// The words of one axis on digital lines. No position is published for a rotary axis, so its step must be stated.
    ///
    /// # Errors
    /// The key that is missing.
    pub fn digital_axis(&self, name: AxisName) -> Result<DigitalAxis, MissingKey> {
        let (kind, digital) = (name.kind(), &self.digital);
        let published = Some(PositionWord::PUBLISHED.step).filter(|step| step.kind() == kind);
        let step = digital.position_step.or(published).ok_or(MissingKey {
            axis: name,
            key: "digital.position_deg_per_count",
        })?;
        let correction_step = self.resolution(kind).unwrap_or(match kind {
            AxisKind::Linear => CorrectionWord::PUBLISHED.step,
            AxisKind::Rotary => Displacement::Angle(LINE_STEP.to_rad()),
        });
        Ok(DigitalAxis {
            position: PositionWord {
                bits: digital.position_bits,
                code: digital.position_code,
                step,
                zero: digital
                    .position_zero
                    .unwrap_or(Displacement::new(kind, 0.0)),
            },
            correction: CorrectionWord {
                bits: digital.correction_bits,
                code: digital.correction_code,
                step: correction_step,
            },
            includes_correction: self.includes_correction,
            ..DigitalAxis::published(name)
        })
    }
}

/// The step of a correction of a rotary axis on digital lines where the configuration states none.
const LINE_STEP: Deg = Deg(1e-3);

/// A key that a rotary axis on digital lines needs.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("[[controller]]: {key}: missing, expected a number, since axis {axis} is rotary")]
pub struct MissingKey {
    /// The rotary axis that needs the key.
    pub axis: AxisName,
    /// The key that is missing.
    pub key: &'static str,
}

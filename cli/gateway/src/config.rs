//! The configuration of a gateway: TOML, every mistake named with file, line and key.

use std::{
    collections::BTreeMap,
    net::SocketAddr,
    path::{Path, PathBuf},
    time::Duration,
};

use volcomp_digital_io::{Coherence, CorrectionCode, PositionCode};
use volcomp_focas::{PmcAddress, PmcArea, Width};
use volcomp_model::{
    Fading, InputError,
    document::{Document, Section, Value},
};

use crate::error::GatewayError;

/// Everything a gateway is told.
#[derive(Clone, Debug, PartialEq)]
pub struct Config {
    /// The machine file; relative to the configuration.
    pub machine: PathBuf,
    /// Time of a cycle.
    pub cycle: Duration,
    /// Arm as soon as it can be.
    pub auto_arm: bool,
    /// Limits; without them it does not arm.
    pub guard: Option<GuardConfig>,
    /// Controllers in the order of preference.
    pub controllers: Vec<ControllerConfig>,
    /// Thermometers.
    pub thermometers: Vec<ThermometerConfig>,
    /// The dashboard.
    pub dashboard: DashboardConfig,
    /// Folder of the audit log.
    pub audit_dir: PathBuf,
    /// The control thread.
    pub realtime: RealtimeConfig,
}

/// `[guard]`: um, urad, s.
#[derive(Clone, Debug, PartialEq)]
pub struct GuardConfig {
    /// Of linear axes.
    pub linear: AxisGuard,
    /// Of rotary axes; a machine with some needs it.
    pub rotary: Option<AxisGuard>,
    /// Positions older than this: held.
    pub hold: Duration,
    /// Older than this: ramped to zero.
    pub zero_after: Duration,
    /// Time of a ramp.
    pub ramp: Duration,
    /// So long a stop may ramp out.
    pub stop: Duration,
    /// So long a better controller must be usable before it takes over again.
    pub hand_back: Duration,
    /// The fastest change of a temperature, K in a minute.
    pub max_degc_per_min: f64,
    /// What a temperature may be, degC.
    pub range_degc: [f64; 2],
    /// A temperature older than this is stale.
    pub temperature_stale: Duration,
    /// What becomes of terms without a sensor.
    pub fading: Fading,
}

/// Limits of one kind of axis: um or urad.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct AxisGuard {
    /// The largest correction.
    pub limit: f64,
    /// From here on it is reported.
    pub warn: f64,
    /// In a second.
    pub slew_per_s: f64,
    /// In a second, in a second.
    pub accel_per_s2: f64,
    /// A change of model that moves a corner further needs a confirmation.
    pub confirm: f64,
    /// The shift that proves at arming whether positions contain it.
    pub test_shift: f64,
}

/// `[[controller]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct ControllerConfig {
    /// Its device URL.
    pub url: String,
    /// Its channel.
    pub channel: Option<String>,
    /// The axes it corrects.
    pub axes: Vec<char>,
    /// Machine axes that stand where they are told: mm, deg.
    pub fixed: BTreeMap<char, f64>,
    /// Smallest step, um.
    pub resolution_um: Option<f64>,
    /// Smallest step of rotary axes, urad.
    pub resolution_urad: Option<f64>,
    /// Whether positions contain the correction.
    pub includes_correction: bool,
    /// Nobody watches it, and that is known.
    pub unwatched: bool,
    /// Whether the test shift is made.
    pub proves: Option<bool>,
    /// First byte of the shifts and bytes of each (FOCAS).
    pub area: Option<(PmcAddress, Width)>,
    /// Byte that every correction moves on (FOCAS).
    pub heartbeat: Option<PmcAddress>,
    /// Byte with the referenced axes (FOCAS); `None`: as the driver has it, `Some(None)`: not asked.
    pub referenced: Option<Option<PmcAddress>>,
    /// Digital lines.
    pub digital: DigitalConfig,
}

/// The words on digital lines.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DigitalConfig {
    /// Bits of the position.
    pub position_bits: u32,
    /// mm of one count.
    pub position_mm_per_count: f64,
    /// Position at count 0, mm.
    pub position_zero_mm: f64,
    /// Code of the position.
    pub position_code: PositionCode,
    /// Bits of the correction.
    pub correction_bits: u32,
    /// Code of the correction.
    pub correction_code: CorrectionCode,
    /// How a word is known to be whole.
    pub coherence: Coherence,
}

impl Default for DigitalConfig {
    /// The published scheme.
    fn default() -> Self {
        Self {
            position_bits: 15,
            position_mm_per_count: 1.0 / 32.0,
            position_zero_mm: 0.0,
            position_code: PositionCode::Binary,
            correction_bits: 8,
            correction_code: CorrectionCode::TwosComplement,
            coherence: Coherence::TwoAgree,
        }
    }
}

/// `[[thermometer]]`.
#[derive(Clone, Debug, PartialEq)]
pub struct ThermometerConfig {
    /// Its device URL.
    pub url: String,
    /// Names of its sensors.
    pub names: Vec<String>,
}

/// `[dashboard]`.
#[derive(Clone, Debug, PartialEq)]
pub struct DashboardConfig {
    /// Where it listens.
    pub listen: SocketAddr,
    /// Named tokens, mode 0600.
    pub token_file: Option<PathBuf>,
    /// Certificate and key, PEM.
    pub tls: Option<(PathBuf, PathBuf)>,
    /// Names besides addresses under which browsers may ask for it.
    pub hosts: Vec<String>,
}

/// `[realtime]`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RealtimeConfig {
    /// SCHED_FIFO priority, 1 to 99; 0: none is asked for.
    pub priority: u8,
    /// The processor it stays on.
    pub cpu: Option<usize>,
}

impl Default for DashboardConfig {
    fn default() -> Self {
        Self {
            listen: SocketAddr::from(([127, 0, 0, 1], 8080)),
            token_file: None,
            tls: None,
            hosts: Vec::new(),
        }
    }
}

impl Config {
    /// Reads a configuration file.
    ///
    /// # Errors
    /// A file that cannot be read, or with file, line and key what is wrong in it.
    pub fn read(path: &Path) -> Result<Self, GatewayError> {
        let file = path.display().to_string();
        let text = std::fs::read_to_string(path).map_err(|source| GatewayError::Read {
            file: file.clone(),
            source,
        })?;
        let folder = path.parent().unwrap_or(Path::new(""));
        Ok(Self::parse(&text, &file, folder)?)
    }

    /// Takes the text of a configuration; paths in it are relative to `folder`.
    ///
    /// # Errors
    /// With file, line and key what is wrong.
    pub fn parse(text: &str, file: &str, folder: &Path) -> Result<Self, InputError> {
        Document::new(file, text).decode(|root| Self::decode(&root, folder))
    }

    fn decode(root: &Section<'_>, folder: &Path) -> Result<Self, InputError> {
        root.allow(&[
            "machine",
            "cycle_ms",
            "auto_arm",
            "guard",
            "controller",
            "thermometer",
            "dashboard",
            "audit",
            "realtime",
        ])?;
        let controllers = tables(root, "controller", controller)?;
        if controllers.is_empty() {
            return Err(root.error("found no [[controller]], expected at least one"));
        }
        if controllers.len() > volcomp_guard::MAX_PATHS {
            return Err(root.error(format!(
                "found {} controllers, expected {} at the most",
                controllers.len(),
                volcomp_guard::MAX_PATHS
            )));
        }
        let cycle_ms = number_or(root, "cycle_ms", [0.1, 1000.0], 4.0)?;
        let audit = root.section("audit")?;
        let audit_dir = match &audit {
            Some(audit) => {
                audit.allow(&["dir"])?;
                folder.join(audit.require("dir")?.text()?)
            }
            None => folder.join("audit"),
        };
        Ok(Self {
            machine: folder.join(root.require("machine")?.text()?),
            cycle: Duration::from_secs_f64(cycle_ms * 1e-3),
            auto_arm: truth_or(root, "auto_arm", false)?,
            guard: root
                .section("guard")?
                .map(|section| guard(&section, cycle_ms))
                .transpose()?,
            controllers,
            thermometers: tables(root, "thermometer", thermometer)?,
            dashboard: root
                .section("dashboard")?
                .map(|section| dashboard(&section, folder))
                .transpose()?
                .unwrap_or_default(),
            audit_dir,
            realtime: root
                .section("realtime")?
                .map(|section| realtime(&section))
                .transpose()?
                .unwrap_or(RealtimeConfig {
                    priority: 60,
                    cpu: None,
                }),
        })
    }
}

/// Every table of an array.
fn tables<T>(
    root: &Section<'_>,
    key: &str,
    decode: impl Fn(&Section<'_>) -> Result<T, InputError>,
) -> Result<Vec<T>, InputError> {
    let Some(value) = root.get(key) else {
        return Ok(Vec::new());
    };
    value
        .items()?
        .iter()
        .map(|item| decode(&item.section()?))
        .collect()
}

fn number_in(value: &Value<'_>, [low, high]: [f64; 2]) -> Result<f64, InputError> {
    let found = value.number()?;
    if (low..=high).contains(&found) {
        return Ok(found);
    }
    Err(value.error(format!(
        "found {found}, expected a number from {low} to {high}"
    )))
}

fn number_or(
    section: &Section<'_>,
    key: &str,
    range: [f64; 2],
    default: f64,
) -> Result<f64, InputError> {
    section
        .get(key)
        .map_or(Ok(default), |value| number_in(&value, range))
}

fn truth_or(section: &Section<'_>, key: &str, default: bool) -> Result<bool, InputError> {
    section.get(key).map_or(Ok(default), |value| value.truth())
}

fn guard(section: &Section<'_>, cycle_ms: f64) -> Result<GuardConfig, InputError> {
    section.allow(&[
        "limit_um",
        "warn_um",
        "slew_um_per_s",
        "accel_um_per_s2",
        "confirm_um",
        "test_shift_um",
        "limit_urad",
        "warn_urad",
        "slew_urad_per_s",
        "accel_urad_per_s2",
        "confirm_urad",
        "test_shift_urad",
        "hold_ms",
        "zero_after_ms",
        "ramp_s",
        "stop_s",
        "hand_back_s",
        "max_degc_per_min",
        "range_degc",
        "temperature_stale_s",
        "temperature_hold_s",
        "temperature_fade_s",
    ])?;
    let hold_ms = number_in(&section.require("hold_ms")?, [cycle_ms, 60_000.0])?;
    let zero_after_ms = number_in(&section.require("zero_after_ms")?, [hold_ms, 600_000.0])?;
    let seconds = |key: &str, range, default| {
        number_or(section, key, range, default).map(Duration::from_secs_f64)
    };
    let range_degc = match section.get("range_degc") {
        Some(value) => {
            let [low, high] = value.vector::<2>()?;
            if low >= high {
                return Err(value.error(format!(
                    "found {low} to {high}, expected the lower temperature first"
                )));
            }
            [low, high]
        }
        None => [-20.0, 120.0],
    };
    let fading = Fading::default();
    let rotary = section.get("limit_urad").is_some();
    Ok(GuardConfig {
        linear: axis_guard(section, "um", 5.0)?,
        rotary: rotary
            .then(|| axis_guard(section, "urad", 20.0))
            .transpose()?,
        hold: Duration::from_secs_f64(hold_ms * 1e-3),
        zero_after: Duration::from_secs_f64(zero_after_ms * 1e-3),
        ramp: seconds("ramp_s", [0.0, 600.0], 0.5)?,
        stop: seconds("stop_s", [0.0, 600.0], 5.0)?,
        hand_back: seconds("hand_back_s", [0.0, 3600.0], 2.0)?,
        max_degc_per_min: number_or(section, "max_degc_per_min", [0.01, 1000.0], 5.0)?,
        range_degc,
        temperature_stale: seconds("temperature_stale_s", [0.1, 3600.0], 30.0)?,
        fading: Fading {
            hold_s: number_or(section, "temperature_hold_s", [0.0, 1e6], fading.hold_s)?,
            fade_s: number_or(section, "temperature_fade_s", [1.0, 1e6], fading.fade_s)?,
        },
    })
}

/// The keys that end in `unit`; the test shift is 0 or this where it is not named, if the limit allows.
fn axis_guard(section: &Section<'_>, unit: &str, test_shift: f64) -> Result<AxisGuard, InputError> {
    let key = |name: &str| match name.split_once("_per") {
        Some((name, per)) => format!("{name}_{unit}_per{per}"),
        None => format!("{name}_{unit}"),
    };
    let limit = number_in(&section.require(&key("limit"))?, [1e-3, 10_000.0])?;
    Ok(AxisGuard {
        limit,
        warn: number_or(section, &key("warn"), [0.0, limit], limit)?,
        slew_per_s: number_in(&section.require(&key("slew_per_s"))?, [1e-3, 1e7])?,
        accel_per_s2: number_or(section, &key("accel_per_s2"), [1e-3, 1e12], f64::INFINITY)?,
        confirm: number_or(section, &key("confirm"), [0.0, 1e6], limit)?,
        test_shift: number_or(
            section,
            &key("test_shift"),
            [0.0, limit],
            test_shift.min(limit),
        )?,
    })
}

fn controller(section: &Section<'_>) -> Result<ControllerConfig, InputError> {
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

fn one_of<T: Copy>(
    section: &Section<'_>,
    key: &str,
    default: T,
    known: &[(&str, T)],
) -> Result<T, InputError> {
    let Some(value) = section.get(key) else {
        return Ok(default);
    };
    let found = value.text()?;
    known
        .iter()
        .find(|(name, _)| *name == found)
        .map(|(_, known)| *known)
        .ok_or_else(|| {
            let names: Vec<&str> = known.iter().map(|(name, _)| *name).collect();
            value.error(format!(
                "found `{found}`, expected one of {}",
                names.join(", ")
            ))
        })
}

fn thermometer(section: &Section<'_>) -> Result<ThermometerConfig, InputError> {
    section.allow(&["url", "names"])?;
    let names = section.require("names")?.texts()?;
    Ok(ThermometerConfig {
        url: section.require("url")?.text()?.to_owned(),
        names: names.into_iter().map(str::to_owned).collect(),
    })
}

fn dashboard(section: &Section<'_>, folder: &Path) -> Result<DashboardConfig, InputError> {
    section.allow(&[
        "listen",
        "token_file",
        "tls_certificate",
        "tls_key",
        "hosts",
    ])?;
    let path = |key: &str| {
        section
            .get(key)
            .map(|value| Ok::<_, InputError>(folder.join(value.text()?)))
            .transpose()
    };
    let listen = match section.get("listen") {
        None => DashboardConfig::default().listen,
        Some(value) => {
            let text = value.text()?;
            text.parse().map_err(|_| {
                value.error(format!(
                    "found `{text}`, expected an address and port such as 127.0.0.1:8080"
                ))
            })?
        }
    };
    let tls = match (path("tls_certificate")?, path("tls_key")?) {
        (Some(certificate), Some(key)) => Some((certificate, key)),
        (None, None) => None,
        _ => {
            return Err(
                section.error("found one of tls_certificate and tls_key, expected both or neither")
            );
        }
    };
    let hosts = section
        .get("hosts")
        .map(|value| value.texts())
        .transpose()?
        .unwrap_or_default();
    Ok(DashboardConfig {
        listen,
        token_file: path("token_file")?,
        tls,
        hosts: hosts.into_iter().map(str::to_owned).collect(),
    })
}

fn realtime(section: &Section<'_>) -> Result<RealtimeConfig, InputError> {
    section.allow(&["priority", "cpu"])?;
    let count = |key: &str, most| section.get(key).map(|value| value.count(most)).transpose();
    Ok(RealtimeConfig {
        priority: u8::try_from(count("priority", 99)?.unwrap_or(60)).unwrap_or(99),
        cpu: count("cpu", 1023)?,
    })
}

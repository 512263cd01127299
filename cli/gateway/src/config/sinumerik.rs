//! The tables `[controller.sinumerik]` and `[thermometer.sinumerik]`: how the OPC UA server of a SINUMERIK control is
//! reached, and which of its nodes are used.

use std::{
    path::{Path, PathBuf},
    time::Duration,
};

use volcomp_document::{InputError, Section, Value};
use volcomp_guard::ceiling;
use volcomp_sinumerik::{Nodes, SHORTEST_PERIOD, Security, Server, Sign, lag};

/// The speed for which a message tells how far a correction would lag behind, mm/s: 10 m/min.
const TOLD_SPEED_MM_PER_S: f64 = 10_000.0 / 60.0;

/// How the server of a control is reached, without its URL.
#[derive(Clone, Debug, PartialEq)]
pub struct ServerConfig {
    /// The namespace of the nodes; `None`: the driver's own.
    pub namespace: Option<String>,
    /// Who logs in; `None`: anonymous.
    pub user: Option<String>,
    /// The file with the user's password.
    pub password_file: Option<PathBuf>,
    /// How messages are protected.
    pub security: Security,
    /// The folder with certificates.
    pub certificates: Option<PathBuf>,
    /// The time from one reading to the next.
    pub period: Duration,
    /// How long a request may take.
    pub time_out: Duration,
    /// Whether the server's source timestamps are believed.
    pub source_timestamps: bool,
}

impl Default for ServerConfig {
    fn default() -> Self {
        let server = Server::new("");
        Self {
            namespace: None,
            user: None,
            password_file: None,
            security: server.security,
            certificates: None,
            period: server.period,
            time_out: server.time_out,
            source_timestamps: server.source_timestamps,
        }
    }
}

/// The table `[controller.sinumerik]`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SinumerikTable {
    /// How the server is reached.
    pub server: ServerConfig,
    /// The numbers of the axes in the control; empty: 1, 2, 3 and so on.
    pub numbers: Vec<u16>,
    /// How SD43900 moves an axis.
    pub sign: Sign,
    /// The node ids.
    pub nodes: Nodes,
}

pub(super) const SERVER_KEYS: [&str; 8] = [
    "namespace",
    "user",
    "password_file",
    "security",
    "certificates",
    "period_ms",
    "time_out_ms",
    "source_timestamps",
];

/// The table `[controller.sinumerik]`.
pub(super) fn table(section: &Section<'_>, folder: &Path) -> Result<SinumerikTable, InputError> {
    let keys: Vec<&str> = SERVER_KEYS
        .into_iter()
        .chain(["numbers", "sign", "nodes"])
        .collect();
    section.allow(&keys)?;
    let numbers = section.optional("numbers", |value| {
        value
            .items()?
            .iter()
            .map(|item| item.whole(1..=31))
            .collect::<Result<Vec<u16>, _>>()
    })?;
    Ok(SinumerikTable {
        server: keys_of_server(section, folder)?,
        numbers: numbers.unwrap_or_default(),
        sign: section.one_of(
            "sign",
            &[("adds", Sign::Adds), ("subtracts", Sign::Subtracts)],
            Sign::Adds,
        )?,
        nodes: section
            .section("nodes")?
            .map(|nodes| nodes_of(&nodes))
            .transpose()?
            .unwrap_or_default(),
    })
}

/// The table `[thermometer.sinumerik]`.
pub(super) fn server(section: &Section<'_>, folder: &Path) -> Result<ServerConfig, InputError> {
    section.allow(&SERVER_KEYS)?;
    keys_of_server(section, folder)
}

pub(super) fn keys_of_server(
    section: &Section<'_>,
    folder: &Path,
) -> Result<ServerConfig, InputError> {
    let default = ServerConfig::default();
    let text = |value: &Value<'_>| match value.text()? {
        "" => Err(value.error("found an empty text, expected a name")),
        text => Ok(text.to_owned()),
    };
    let path = |value: &Value<'_>| text(value).map(|text| folder.join(text));
    let ms = |key: &str, range, default: Duration| {
        let ms = section.number_or(key, range, default.as_secs_f64() * 1e3)?;
        Ok::<_, InputError>(Duration::from_secs_f64(ms * 1e-3))
    };
    let user = section.optional("user", text)?;
    let password_file = section.optional("password_file", path)?;
    if user.is_some() != password_file.is_some() {
        return Err(section.error("found one of user and password_file, expected both or none"));
    }
    let security = section.one_of(
        "security",
        &[
            ("none", Security::None),
            ("sign", Security::Sign),
            ("sign-and-encrypt", Security::SignAndEncrypt),
        ],
        default.security,
    )?;
    let certificates = section.optional("certificates", path)?;
    if certificates.is_some() != (security != Security::None) {
        return Err(section.error(
            "found one of security and certificates, expected both or none: a secured connection needs the folder, and no other uses it",
        ));
    }
    let shortest = SHORTEST_PERIOD.as_secs_f64() * 1e3;
    Ok(ServerConfig {
        namespace: section.optional("namespace", text)?,
        user,
        password_file,
        security,
        certificates,
        period: ms("period_ms", shortest..=1000.0, default.period)?,
        time_out: ms("time_out_ms", 10.0..=2000.0, default.time_out)?,
        source_timestamps: section.truth_or("source_timestamps", default.source_timestamps)?,
    })
}

fn nodes_of(section: &Section<'_>) -> Result<Nodes, InputError> {
    section.allow(&[
        "position",
        "name",
        "setting",
        "kind",
        "share",
        "speed",
        "emergency_stop",
        "alarm",
        "referenced",
    ])?;
    let default = Nodes::default();
    let text = |key: &str, default: String| match section.get(key) {
        Some(value) => value.text().map(str::to_owned),
        None => Ok(default),
    };
    let state = |key: &str| section.optional(key, |value| value.text().map(str::to_owned));
    Ok(Nodes {
        position: text("position", default.position)?,
        name: text("name", default.name)?,
        setting: text("setting", default.setting)?,
        kind: text("kind", default.kind)?,
        share: text("share", default.share)?,
        speed: text("speed", default.speed)?,
        emergency_stop: state("emergency_stop")?,
        alarm: state("alarm")?,
        referenced: state("referenced")?,
    })
}

/// Refuses a path through SD43900 that is to carry more than thermal terms, and one that holds too early or does not say
/// when.
pub(super) fn check_path(
    controller: &Section<'_>,
    only_thermal: bool,
    hold: Option<Duration>,
    table: &SinumerikTable,
) -> Result<(), InputError> {
    let period = table.server.period;
    let ms = period.as_secs_f64() * 1e3;
    if !only_thermal {
        return Err(controller.error(format!(
            "terms: missing, expected [\"thermal\"]: this control is read and written every {ms} ms, and at 10 m/min an axis is {:.1} mm further by then, so what depends on the position would come too late",
            lag(TOLD_SPEED_MM_PER_S, period).0
        )));
    }
    let fewest = 3 * period;
    let longest = ceiling::HOLD_THERMAL.as_secs_f64();
    let expected = format!(
        "{} to {}: three readings at least, 1500 is usual",
        fewest.as_secs_f64() * 1e3,
        longest * 1e3
    );
    match hold {
        None => Err(controller.error(format!("hold_ms: missing, expected {expected}"))),
        Some(hold) if hold < fewest => {
            let found = hold.as_secs_f64() * 1e3;
            Err(controller.error(format!("hold_ms: found {found}, expected {expected}")))
        }
        Some(_) => Ok(()),
    }
}

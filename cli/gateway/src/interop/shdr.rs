//! An MTConnect adapter: agents read the gateway over TCP as SHDR lines.

use std::{
    collections::VecDeque,
    fmt::Write,
    net::SocketAddr,
    sync::Arc,
    time::{Duration, SystemTime},
};

use tokio::{
    io::{AsyncReadExt, AsyncWriteExt},
    net::{TcpListener, TcpStream},
    task::AbortHandle,
    time::{MissedTickBehavior, interval, timeout},
};

use crate::{
    audit::utc,
    config::ShdrConfig,
    documents::{StateName, Status},
    error::GatewayError,
    interop::{
        InterfaceThread,
        quantities::{
            Alarm, Kind, Level, Part, Place, Quantity, Shape, Unit, Value, condition_key, key_of,
            places, quantities,
        },
        start,
    },
    published::Published,
};

/// The bound socket. [`serve`](Self::serve) accepts clients.
pub(super) struct Bound(std::net::TcpListener);

impl Bound {
    pub(super) fn new(config: &ShdrConfig) -> Result<Self, GatewayError> {
        // A small send buffer limits the memory per client and detects early that a client does not read.
        let listener = std::net::TcpListener::bind(config.listen).and_then(|listener| {
            rustix::net::sockopt::set_socket_send_buffer_size(&listener, 64 * 1024)?;
            listener.set_nonblocking(true)?;
            Ok(listener)
        });
        let failed = |e| GatewayError::system(format!("shdr {}", config.listen), e);
        Ok(Self(listener.map_err(failed)?))
    }

    pub(super) fn serve(
        self,
        shape: &Shape,
        published: Published,
    ) -> Result<InterfaceThread, GatewayError> {
        let items = Arc::new(Items::of(shape));
        start("volcomp-shdr", move || async move {
            match TcpListener::from_std(self.0) {
                Ok(listener) => serve(listener, items, published).await,
                Err(e) => tracing::error!("SHDR: {e}"),
            }
        })
    }
}

const UNAVAILABLE: &str = "UNAVAILABLE";
/// Key of the item that reports whether the gateway is available.
const AVAILABILITY: &str = "avail";

/// The data items of a gateway, in the order of their lines.
pub struct Items {
    /// Data items that report a value.
    pub quantities: Vec<Quantity>,
    /// Data items that report conditions: key of the item, and the place whose alarms it reports.
    pub conditions: Vec<(String, Place)>,
}

impl Items {
    pub fn of(shape: &Shape) -> Self {
        let mut quantities = quantities(shape);
        // Conditions report the reasons.
        quantities.retain(|quantity| quantity.row != "reasons");
        let key = |place| match place {
            Place::Guard => "guard".to_owned(),
            // The list of quantities has numbered sensors with equal keys, so take the keys from there.
            Place::Sensor(sensor) => {
                let own = quantities.iter().find(|quantity| quantity.part == Part::Sensor(sensor));
                condition_key(own.map_or("", |own| own.key.as_str()))
            }
            Place::Controller(place) => format!("path_{place}_condition"),
        };
        let places = places(shape).into_iter();
        let conditions = places.map(|place| (key(place), place)).collect();
        Self { quantities, conditions }
    }
}

/// The state last sent to one client.
pub struct SentState {
    available: Option<bool>,
    values: Vec<Option<String>>,
    conditions: Vec<Condition>,
}

#[derive(Clone, PartialEq)]
enum Condition {
    Nothing,
    Unavailable,
    Normal,
    Active(Vec<Alarm>),
}

impl SentState {
    /// The initial state, in which nothing has been sent.
    pub fn nothing(items: &Items) -> Self {
        Self {
            available: None,
            values: vec![None; items.quantities.len()],
            conditions: vec![Condition::Nothing; items.conditions.len()],
        }
    }

    /// The lines for all changes since the last call, each with a line feed. The changes are recorded as sent.
    pub fn changes(&mut self, items: &Items, status: &Status, now: SystemTime) -> String {
        let mut text = String::new();
        let available = status.state != StateName::Unknown;
        if self.available.replace(available) != Some(available) {
            let word = if available { "AVAILABLE" } else { UNAVAILABLE };
            line(&mut text, now, status.age_ms, &[AVAILABILITY, word]);
        }
        for (quantity, sent) in items.quantities.iter().zip(&mut self.values) {
            let reading = quantity.read(status);
            let value =
                reading.current().map_or(UNAVAILABLE.to_owned(), |value| shown(quantity, value));
            if sent.as_deref() != Some(value.as_str()) {
                line(&mut text, now, reading.age_ms, &[&quantity.key, &value]);
                *sent = Some(value);
            }
        }
        for ((key, place), sent) in items.conditions.iter().zip(&mut self.conditions) {
            let found = match place.alarms(status) {
                None => Condition::Unavailable,
                Some(alarms) if alarms.is_empty() => Condition::Normal,
                Some(alarms) => Condition::Active(alarms),
            };
            if *sent != found {
                condition(&mut text, now, status.age_ms, key, sent, &found);
                *sent = found;
            }
        }
        text
    }
}

/// Appends the lines for a changed condition: a normal line by code for each ended alarm, and a line for each alarm
/// that is new or has changed its level.
fn condition(
    text: &mut String,
    now: SystemTime,
    age_ms: f64,
    key: &str,
    before: &Condition,
    found: &Condition,
) {
    let mut tell = |level: &str, code: &str, words: &str| {
        line(text, now, age_ms, &[key, level, code, "", "", words]);
    };
    let alarms = match found {
        Condition::Active(alarms) => alarms,
        Condition::Unavailable => return tell(UNAVAILABLE, "", ""),
        Condition::Normal | Condition::Nothing => return tell("NORMAL", "", ""),
    };
    let known: &[Alarm] = match before {
        Condition::Active(known) => known,
        _ => &[],
    };
    for ended in known {
        if !alarms.iter().any(|alarm| alarm.code == ended.code) {
            tell("NORMAL", &ended.code, "");
        }
    }
    for alarm in alarms.iter().filter(|alarm| !known.contains(alarm)) {
        let level = match alarm.level {
            Level::Warning => "WARNING",
            Level::Fault => "FAULT",
        };
        tell(level, &alarm.code, &alarm.text);
    }
}

fn shown(quantity: &Quantity, value: &Value) -> String {
    match (value, quantity.kind) {
        (Value::Number(value), Kind::Number(unit)) => in_unit(*value, unit),
        (Value::Number(value), _) => value.to_string(),
        (Value::Whole(value), _) => value.to_string(),
        (Value::Truth(yes), _) => if *yes { "TRUE" } else { "FALSE" }.to_owned(),
        (Value::Text(text), _) if quantity.row == "state" => key_of(text).to_uppercase(),
        (Value::Text(text), _) => text.clone(),
    }
}

/// Formats a number in MILLIMETER, DEGREE, CELSIUS or SECOND. Times are rounded to whole seconds, so that an age does
/// not change with every update.
fn in_unit(value: f64, unit: Unit) -> String {
    let text = match unit {
        Unit::Mm | Unit::Deg | Unit::Degc => format!("{value:.3}"),
        Unit::Um => format!("{:.6}", value * 1e-3),
        Unit::Urad => format!("{:.8}", (value * 1e-6).to_degrees()),
        Unit::Ms => format!("{:.0}", value * 1e-3),
    };
    let digits = match text.split_once('.') {
        Some(_) => text.trim_end_matches('0').trim_end_matches('.'),
        None => &text,
    };
    if digits == "-0" { "0" } else { digits }.to_owned()
}

/// Appends one line: timestamp, then fields.
fn line(text: &mut String, now: SystemTime, age_ms: f64, fields: &[&str]) {
    let age = Duration::try_from_secs_f64(age_ms * 1e-3).unwrap_or_default();
    text.push_str(&utc(now.checked_sub(age).unwrap_or(now)));
    for field in fields {
        text.push('|');
        text.push_str(&escaped(field));
    }
    text.push('\n');
}

/// Escapes a field. Only `|`, `"` and `\` have an escaped form. Control characters, such as line ends, become spaces,
/// and surrounding spaces are removed.
pub fn escaped(text: &str) -> String {
    let plain: String = text.chars().map(|c| if c.is_control() { ' ' } else { c }).collect();
    let plain = plain.trim_matches(|c: char| c.is_ascii_whitespace());
    // A backslash escapes the next character only within quotation marks.
    if !plain.contains('|') && !plain.starts_with('"') {
        return plain.to_owned();
    }
    let mut quoted = String::from("\"");
    for c in plain.chars() {
        if matches!(c, '|' | '"' | '\\') {
            quoted.push('\\');
        }
        quoted.push(c);
    }
    quoted.push('"');
    quoted
}

const SEND_INTERVAL: Duration = Duration::from_millis(100);
/// Clients that do not read for this long are disconnected.
const WRITE_TIMEOUT: Duration = Duration::from_secs(5);
/// Maximum number of clients; a further one replaces the oldest.
const MAX_CLIENTS: usize = 16;
/// Requested interval between two `* PING`. A client without a ping for twice this time is disconnected.
const HEARTBEAT: Duration = Duration::from_secs(10);
/// Maximum length of a line from a client, bytes.
const MAX_LINE: usize = 1024;

/// Serves until the runtime ends. Each client has its own task and its own state of sent values, so that clients do not
/// delay each other.
async fn serve(listener: TcpListener, items: Arc<Items>, published: Published) {
    let mut open: VecDeque<AbortHandle> = VecDeque::new();
    loop {
        let (stream, from) = match listener.accept().await {
            Ok(accepted) => accepted,
            Err(e) => {
                // No file descriptor is free: retry later.
                tracing::warn!("SHDR: {e}");
                tokio::time::sleep(SEND_INTERVAL).await;
                continue;
            }
        };
        open.retain(|client| !client.is_finished());
        if open.len() >= MAX_CLIENTS
            && let Some(oldest) = open.pop_front()
        {
            oldest.abort();
        }
        let task = client(stream, from, Arc::clone(&items), published.clone());
        open.push_back(tokio::spawn(task).abort_handle());
    }
}

async fn client(stream: TcpStream, from: SocketAddr, items: Arc<Items>, published: Published) {
    let why = exchange(stream, &items, &published).await;
    tracing::debug!("SHDR: {from}: {why}");
}

/// Sends changes to a client until it disconnects. Returns why the connection ended.
async fn exchange(stream: TcpStream, items: &Items, published: &Published) -> String {
    let _ = stream.set_nodelay(true);
    let (mut reader, mut writer) = stream.into_split();
    let mut sent = SentState::nothing(items);
    let mut received = Vec::with_capacity(MAX_LINE);
    let mut last_ping: Option<Duration> = None;
    let mut tick = interval(SEND_INTERVAL);
    tick.set_missed_tick_behavior(MissedTickBehavior::Delay);
    loop {
        let text = tokio::select! {
            read = reader.read_buf(&mut received) => match read {
                Ok(0) => return "closed".to_owned(),
                Err(e) => return e.to_string(),
                Ok(_) => match answers(&mut received) {
                    None => return "a line is too long".to_owned(),
                    Some(text) => {
                        if !text.is_empty() {
                            last_ping = Some(published.clock().elapsed());
                        }
                        text
                    }
                },
            },
            _ = tick.tick() => {
                let now = published.clock().elapsed();
                if last_ping.is_some_and(|last_ping| now.saturating_sub(last_ping) > 2 * HEARTBEAT) {
                    return "no PING".to_owned();
                }
                sent.changes(items, &published.latest(), SystemTime::now())
            }
        };
        match timeout(WRITE_TIMEOUT, writer.write_all(text.as_bytes())).await {
            Ok(Ok(())) => {}
            Ok(Err(e)) => return e.to_string(),
            Err(_) => return "it does not read".to_owned(),
        }
    }
}

/// Removes complete lines from the received bytes and returns the responses; `None` if a line is too long. Only `*
/// PING` has a response; all other lines are ignored.
fn answers(received: &mut Vec<u8>) -> Option<String> {
    let mut text = String::new();
    let pong = format!("* PONG {}\n", HEARTBEAT.as_millis());
    while let Some(end) = received.iter().position(|byte| *byte == b'\n') {
        let line: Vec<u8> = received.drain(..=end).collect();
        if line.trim_ascii().starts_with(b"* PING") {
            text += &pong;
        }
    }
    (received.len() < MAX_LINE).then_some(text)
}

/// The MTConnect name of a quantity. Types with the prefix `x:` are extensions of the standard.
struct Item {
    category: &'static str,
    kind: String,
    sub: Option<&'static str>,
    units: Option<&'static str>,
}

/// The `Devices.xml` for an agent that reads this gateway. `name` is the device name that the agent shows.
pub fn device(shape: &Shape, name: &str) -> String {
    let items = Items::of(shape);
    let of = |parts: &[Part]| -> Vec<String> {
        let own = items.quantities.iter();
        let own = own.filter(|own| parts.contains(&own.part));
        own.map(data_item).collect()
    };
    let with_condition = |mut own: Vec<String>, wanted: Place, kind: &str| {
        let conditions = items.conditions.iter().filter(|(_, place)| *place == wanted);
        own.extend(conditions.map(|(key, _)| {
            format!(r#"<DataItem category="CONDITION" id="{key}" name="{key}" type="{kind}"/>"#)
        }));
        own
    };
    let mut xml = Xml::default();
    xml.line(r#"<?xml version="1.0" encoding="UTF-8"?>"#);
    xml.open(
        r#"MTConnectDevices xmlns="urn:mtconnect.org:MTConnectDevices:1.5" xmlns:x="urn:volcomp:VolcompDevices:1""#,
    );
    xml.line(
        r#"<Header creationTime="1970-01-01T00:00:00Z" sender="volcomp-gateway" instanceId="0" version="1.5" assetBufferSize="0" assetCount="0" bufferSize="1"/>"#,
    );
    xml.open("Devices");
    let name = xml_escaped(name);
    xml.open(&format!(r#"Device id="d" name="{name}" uuid="volcomp-{name}""#));
    xml.line("<Description manufacturer=\"volcomp\">Volumetric compensation</Description>");
    xml.data_items(&[format!(
        r#"<DataItem category="EVENT" id="{AVAILABILITY}" name="{AVAILABILITY}" type="AVAILABILITY"/>"#
    )]);
    xml.open("Components");
    xml.open(r#"Axes id="a" name="axes""#);
    xml.open("Components");
    for &axis in &shape.axes {
        let tag = if axis.is_rotary() { "Rotary" } else { "Linear" };
        let own = of(&[Part::Axis(axis)]);
        xml.component(tag, &format!("a_{axis}"), &axis.to_string(), &own);
    }
    xml.close("Components");
    xml.close("Axes");
    let own = with_condition(of(&[Part::Gateway, Part::Tool]), Place::Guard, "SYSTEM");
    xml.component("Controller", "c_gateway", "gateway", &own);
    for place in 0..shape.controllers {
        let own = of(&[Part::Controller(place)]);
        let own = with_condition(own, Place::Controller(place), "COMMUNICATIONS");
        let name = format!("path_{place}");
        xml.component("Controller", &format!("c_{name}"), &name, &own);
    }
    for (place, sensor) in shape.sensors.iter().enumerate() {
        let own = of(&[Part::Sensor(place)]);
        let own = with_condition(own, Place::Sensor(place), "TEMPERATURE");
        xml.component("Sensor", &format!("s_{place}"), sensor, &own);
    }
    for tag in ["Components", "Device", "Devices", "MTConnectDevices"] {
        xml.close(tag);
    }
    xml.text
}

#[derive(Default)]
struct Xml {
    text: String,
    depth: usize,
}

impl Xml {
    fn line(&mut self, text: &str) {
        // Writing to a string never fails.
        let _ = writeln!(self.text, "{:1$}{text}", "", 2 * self.depth);
    }

    fn open(&mut self, tag: &str) {
        self.line(&format!("<{tag}>"));
        self.depth += 1;
    }

    fn close(&mut self, tag: &str) {
        self.depth = self.depth.saturating_sub(1);
        self.line(&format!("</{tag}>"));
    }

    fn component(&mut self, tag: &str, id: &str, name: &str, items: &[String]) {
        let name = xml_escaped(name);
        self.open(&format!(r#"{tag} id="{id}" name="{name}""#));
        self.data_items(items);
        self.close(tag);
    }

    fn data_items(&mut self, items: &[String]) {
        self.open("DataItems");
        for item in items {
            self.line(item);
        }
        self.close("DataItems");
    }
}

fn data_item(quantity: &Quantity) -> String {
    let Item { category, kind, sub, units } = item(quantity);
    let key = &quantity.key;
    let sub = sub.map_or(String::new(), |sub| format!(r#" subType="{sub}""#));
    let units = units.map_or(String::new(), |units| format!(r#" units="{units}""#));
    format!(
        r#"<DataItem category="{category}" id="{key}" name="{key}" type="{kind}"{sub}{units}/>"#
    )
}

fn item(quantity: &Quantity) -> Item {
    let Kind::Number(unit) = quantity.kind else {
        return Item { category: "EVENT", kind: own_type(quantity), sub: None, units: None };
    };
    let units = match unit {
        Unit::Mm | Unit::Um => "MILLIMETER",
        Unit::Deg | Unit::Urad => "DEGREE",
        Unit::Degc => "CELSIUS",
        Unit::Ms => "SECOND",
    };
    let (kind, sub) = match (quantity.row, unit) {
        ("position", Unit::Deg) => ("ANGLE".to_owned(), Some("ACTUAL")),
        ("position", _) => ("POSITION".to_owned(), Some("ACTUAL")),
        ("temperature", _) => ("TEMPERATURE".to_owned(), None),
        _ => (own_type(quantity), None),
    };
    Item { category: "SAMPLE", kind, sub, units: Some(units) }
}

/// Extension type for a quantity without a type in the standard. The prefix `COMPENSATION_` distinguishes it from
/// states and errors of other devices.
fn own_type(quantity: &Quantity) -> String {
    format!("x:COMPENSATION_{}", quantity.row.to_ascii_uppercase())
}

fn xml_escaped(text: &str) -> String {
    let mut xml = String::new();
    for c in text.chars().filter(|c| !c.is_control()) {
        match c {
            '&' => xml += "&amp;",
            '<' => xml += "&lt;",
            '>' => xml += "&gt;",
            '"' => xml += "&quot;",
            // Noncharacters, which XML forbids.
            '\u{fffe}' | '\u{ffff}' => {}
            c => xml.push(c),
        }
    }
    xml
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_whole_pings_are_answered() {
        for (received, expected, rest) in [
            ("* PING\n", Some("* PONG 10000\n"), ""),
            ("* PING\r\n* PI", Some("* PONG 10000\n"), "* PI"),
            ("* PING\n* PING\n", Some("* PONG 10000\n* PONG 10000\n"), ""),
            ("* arm\n|x|1\n", Some(""), ""),
            ("PING\n", Some(""), ""),
        ] {
            let mut bytes = received.as_bytes().to_vec();
            assert_eq!(answers(&mut bytes).as_deref(), expected, "{received:?}");
            assert_eq!(bytes, rest.as_bytes(), "{received:?}");
        }
        assert_eq!(answers(&mut vec![b'x'; MAX_LINE]), None);
    }
}

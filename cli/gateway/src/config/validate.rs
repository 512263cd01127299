//! The rules of a configuration, each checked against the whole file, so that every mistake is reported at once.

use std::{net::SocketAddr, path::Path};

use volcomp_devices::{Address, Scheme};
use volcomp_document::{LARGEST_NUMBER, Mistakes};
use volcomp_fleet::{ADDRESSES, MachineId, SiteId, trusted_key, wrong_address};
use volcomp_guard::{barrier::LARGEST_MACHINE, ceiling};
use volcomp_sinumerik::{SHORTEST_PERIOD, Security, lag};
use volcomp_vocabulary::{AxisKind, AxisName, MAX_AXES};

use super::{
    Config, ControllerConfig, ControllerKind, DashboardConfig, FleetConfig, Referenced,
    SinumerikTable, ThermometerConfig, is_blank, kinds,
    tables::{ms, of_ms},
};

/// The speed for which a message says how far a correction would lag behind, mm/s: 10 m/min.
const LAG_SPEED_MM_PER_S: f64 = 10_000.0 / 60.0;

pub(super) fn validate(config: &Config, found: &mut Mistakes<'_>) {
    found.require("", "machine");
    let [shortest, longest] = [ceiling::SHORTEST_CYCLE, ceiling::LONGEST_CYCLE].map(ms);
    found.range("cycle_ms", config.cycle_ms, shortest..=longest);
    if let Some(guard) = &config.guard {
        guard.validate(config.cycle_ms, found);
    }
    let count = config.controllers.len();
    if count == 0 {
        found.add("", "found no [[controller]], expected at least one");
    }
    if count > volcomp_guard::MAX_PATHS {
        let most = volcomp_guard::MAX_PATHS;
        found.add(
            "controller",
            format!("found {count} controllers, expected at most {most}"),
        );
    }
    for (index, own) in config.controllers.iter().enumerate() {
        controller(own, &format!("controller[{index}]"), config.cycle_ms, found);
    }
    latches(&config.controllers, found);
    for (index, own) in config.thermometers.iter().enumerate() {
        thermometer(own, &format!("thermometer[{index}]"), found);
    }
    dashboard(&config.dashboard, found);
    path("audit.dir", &config.audit.dir, found);
    found.whole("realtime.priority", config.realtime.priority, 0..=99);
    if let Some(cpu) = config.realtime.cpu {
        found.whole("realtime.cpu", cpu, 0..=1023);
    }
    if let Some(own) = &config.fleet {
        fleet(own, found);
    }
    if let Some(own) = &config.shdr {
        open_address("shdr.listen", own.listen, own.anyone_may_read, found);
        if let Some(name) = own.device.as_deref().filter(|name| is_blank(name)) {
            found.add("shdr.device", format!("found `{name}`, expected a name"));
        }
    }
    if let Some(own) = &config.opc_ua {
        open_address("opc_ua.listen", own.listen, own.anyone_may_read, found);
    }
}

pub(super) fn dashboard(own: &DashboardConfig, found: &mut Mistakes<'_>) {
    let stated = [own.tls_certificate.is_some(), own.tls_key.is_some()];
    both(
        found,
        "dashboard",
        ["tls_certificate", "tls_key"],
        stated,
        "",
    );
}

/// Refuses one of two keys without the other.
fn both(found: &mut Mistakes<'_>, at: &str, keys: [&str; 2], stated: [bool; 2], why: &str) {
    let [one, other] = keys;
    if let [true, false] | [false, true] = stated {
        let key = if stated[0] { one } else { other };
        found.add(
            &format!("{at}.{key}"),
            format!("found one of {one} and {other}, expected both or neither{why}"),
        );
    }
}

/// The address of a server without passwords: on this computer, or stated as open to anyone.
fn open_address(key: &str, listen: SocketAddr, anyone: bool, found: &mut Mistakes<'_>) {
    if !anyone && !listen.ip().is_loopback() {
        found.add(
            key,
            format!(
                "found `{listen}`, which other computers reach, without a password and without encryption: expected an address such as 127.0.0.1:{}, or anyone_may_read = true",
                listen.port()
            ),
        );
    }
}

/// A path that must not be empty.
pub(super) fn path(key: &str, path: &Path, found: &mut Mistakes<'_>) {
    if path.as_os_str().is_empty() {
        found.add(key, "found an empty text, expected a path");
    }
}

/// The kind of a device by its URL; a URL that is none is a mistake.
fn address(at: &str, url: &str, found: &mut Mistakes<'_>) -> Option<Address> {
    let key = format!("{at}.url");
    if !found.states(&key) {
        found.require(at, "url");
        return None;
    }
    if url.starts_with("sinumerik-s7") {
        found.add(
            &key,
            format!("found {url:?}, the S7 protocol, which is gone, expected opc.tcp://HOST:4840, the control's OPC UA server"),
        );
        return None;
    }
    Address::parse(url)
        .map_err(|error| found.add(&key, error.to_string()))
        .ok()
}

/// The letters of axes, each once.
fn letters(key: &str, axes: &[AxisName], found: &mut Mistakes<'_>) {
    for (index, name) in axes.iter().enumerate() {
        if axes[..index].contains(name) {
            found.add(key, format!("axis {name} stands twice"));
        }
    }
}

/// Refuses a key whose unit none of the axes has.
fn has_axis(key: &str, kind: AxisKind, axes: &[AxisName], found: &mut Mistakes<'_>) {
    // Without axes there is another mistake.
    if !axes.is_empty() && !axes.iter().any(|name| name.kind() == kind) {
        let names: Vec<String> = axes.iter().map(ToString::to_string).collect();
        found.add(
            key,
            format!(
                "found this key for the axes {}, expected it only where an axis is {kind}",
                names.join(" ")
            ),
        );
    }
}

fn controller(own: &ControllerConfig, at: &str, cycle_ms: f64, found: &mut Mistakes<'_>) {
    let key = |name: &str| format!("{at}.{name}");
    let is_reader = found.is_read(&key("axes")) && own.axes.is_empty();
    let address = address(at, &own.url, found);
    let kind = address
        .as_ref()
        .map(|address| ControllerKind::of(address.scheme));
    if let Some(kind) = kind {
        kinds::check(found, at, kind, is_reader);
    }
    axes(own, at, found);
    if own.heartbeat.is_some() && own.unwatched {
        found.add(
            &key("heartbeat"),
            "found both heartbeat and unwatched = true, expected one of them",
        );
    }
    if let Some(name) = own.channel.as_deref().filter(|name| is_blank(name)) {
        found.add(
            &key("channel"),
            format!("found {name:?}, expected a name of visible characters"),
        );
    }
    for (name, position) in &own.fixed {
        let key = key(&format!("fixed.{name}"));
        found.range(&key, *position, -LARGEST_NUMBER..=LARGEST_NUMBER);
    }
    letters(&key("not_driven"), &own.not_driven, found);
    for (index, state) in own.unseen.iter().enumerate() {
        if own.unseen[..index].contains(state) {
            let name = serde_json::to_string(state).unwrap_or_default();
            found.add(
                &key("unseen"),
                format!("{} stands twice", name.trim_matches('"')),
            );
        }
    }
    for (name, step, kind, most) in [
        ("resolution_um", own.resolution_um, AxisKind::Linear, 1000.0),
        (
            "resolution_urad",
            own.resolution_urad,
            AxisKind::Rotary,
            1e5,
        ),
    ] {
        if let Some(step) = step {
            has_axis(&key(name), kind, &own.axes, found);
            found.range(&key(name), step, 1e-4..=most);
        }
    }
    if own
        .terms
        .as_ref()
        .is_some_and(|terms| *terms != ["thermal"])
    {
        found.add(
            &key("terms"),
            "expected [\"thermal\"], or no such key: all terms",
        );
    }
    let longest = if own.only_thermal() {
        ceiling::HOLD_THERMAL
    } else {
        ceiling::HOLD
    };
    if let Some(hold_ms) = own.hold_ms {
        found.range(&key("hold_ms"), hold_ms, cycle_ms..=ms(longest));
    }
    if let Some(area) = own.area.filter(|area| ![1, 2, 4].contains(&area.width)) {
        let message = format!("found {}, expected 1, 2 or 4 bytes", area.width);
        found.add(&key("area.width"), message);
    }
    if own.referenced == Some(Referenced::Not(true)) {
        found.add(
            &key("referenced"),
            "found true, expected false or a byte such as { pmc = \"F\", at = 94 }",
        );
    }
    barrier(own, at, kind == Some(ControllerKind::Focas), found);
    digital(own, at, found);
    if let Some(table) = &own.sinumerik {
        server(table, &key("sinumerik"), found);
    }
    if kind == Some(ControllerKind::Sinumerik) && !is_reader {
        thermal_path(own, at, found);
    }
}

/// The axes that a controller writes, and those that it only reads.
fn axes(own: &ControllerConfig, at: &str, found: &mut Mistakes<'_>) {
    found.require(at, "axes");
    let (axes, reads) = (format!("{at}.axes"), format!("{at}.reads"));
    letters(&axes, &own.axes, found);
    letters(&reads, &own.reads, found);
    if found.states(&reads) && own.reads.is_empty() {
        found.add(
            &reads,
            "found no axis, expected the letters of axes that are only read",
        );
    }
    if let Some(name) = own.reads.iter().find(|name| own.axes.contains(name)) {
        let message =
            format!("axis {name} stands among axes, too: an axis that is written is read anyway");
        found.add(&reads, message);
    }
    let count = own.axes.len() + own.reads.len();
    if found.states(&axes) && !(1..=MAX_AXES).contains(&count) {
        found.add(
            &axes,
            format!("found {count} axes, expected 1 to {MAX_AXES}"),
        );
    }
}

/// The table `barrier` of a controller. The keys of the plain scheme have no place beside it.
fn barrier(own: &ControllerConfig, at: &str, is_focas: bool, found: &mut Mistakes<'_>) {
    let Some(barrier) = &own.barrier else {
        return;
    };
    for key in ["area", "heartbeat", "unwatched"] {
        let key = format!("{at}.{key}");
        if found.states(&key) {
            found.add(
                &key,
                "found this key beside barrier, expected it only where corrections are written as plain values",
            );
        }
    }
    let table = format!("{at}.barrier");
    for key in ["machine", "scan_ms"] {
        found.require(&table, key);
    }
    found.whole(
        &format!("{table}.machine"),
        barrier.machine,
        0..=LARGEST_MACHINE,
    );
    found.range(&format!("{table}.scan_ms"), barrier.scan_ms, 0.1..=100.0);
    for (key, byte) in [("frame", barrier.frame), ("report", barrier.report)] {
        match (byte, is_focas) {
            (None, true) => found.require(&table, key),
            (Some(_), false) => found.add(
                &format!("{table}.{key}"),
                "found this key for a controller that is no FANUC control, expected it only for focas://",
            ),
            _ => {}
        }
    }
}

fn digital(own: &ControllerConfig, at: &str, found: &mut Mistakes<'_>) {
    let Some(digital) = &own.digital else {
        return;
    };
    let key = |name: &str| format!("{at}.digital.{name}");
    let axes: Vec<AxisName> = own.axes.iter().chain(&own.reads).copied().collect();
    found.whole(&key("position_bits"), digital.position_bits, 0..=32);
    found.whole(&key("correction_bits"), digital.correction_bits, 0..=32);
    let (step, zero) = (1e-6..=100.0, -1e6..=1e6);
    let coordinates = [
        (
            "position_mm_per_count",
            digital.position_mm_per_count,
            &step,
            AxisKind::Linear,
        ),
        (
            "position_deg_per_count",
            digital.position_deg_per_count,
            &step,
            AxisKind::Rotary,
        ),
        (
            "position_zero_mm",
            digital.position_zero_mm,
            &zero,
            AxisKind::Linear,
        ),
        (
            "position_zero_deg",
            digital.position_zero_deg,
            &zero,
            AxisKind::Rotary,
        ),
    ];
    for (name, number, range, kind) in coordinates {
        if let Some(number) = number {
            if found.states(&key(name)) {
                has_axis(&key(name), kind, &axes, found);
            }
            found.range(&key(name), number, range.clone());
        }
    }
    if let Some(latch) = digital.latch {
        found.whole(&key("latch"), latch, 0..=63);
    }
    if let Some(time_out_ms) = digital.time_out_ms {
        found.range(&key("time_out_ms"), time_out_ms, 10.0..=600_000.0);
        if !found.states(&key("latch")) {
            found.add(
                &key("time_out_ms"),
                "found this key without latch, expected it only where the control sees edges of a latch that may fail to come",
            );
        }
    }
}

/// Refuses lines without a latch beside a barrier: without an edge it never takes their words.
fn latches(controllers: &[ControllerConfig], found: &mut Mistakes<'_>) {
    if controllers.iter().all(|one| one.barrier.is_none()) {
        return;
    }
    for (index, one) in controllers.iter().enumerate() {
        let is_lines = one.kind() == Some(ControllerKind::Lines);
        let latch = one.digital.and_then(|digital| digital.latch);
        if is_lines && one.barrier.is_none() && !one.axes.is_empty() && latch.is_none() {
            found.add(
                &format!("controller[{index}].digital.latch"),
                format!(
                    "missing for {}, expected the line that the gateway turns once the word has settled: the barrier of the control takes words of lines at its edges only",
                    one.url
                ),
            );
        }
    }
}

/// How the OPC UA server of a SINUMERIK control is reached. `at` is its table.
pub(super) fn server(table: &SinumerikTable, at: &str, found: &mut Mistakes<'_>) {
    let key = |name: &str| format!("{at}.{name}");
    let user = [table.user.is_some(), table.password_file.is_some()];
    both(found, at, ["user", "password_file"], user, "");
    let secured = [
        table.security != Security::None,
        table.certificates.is_some(),
    ];
    let why = ": a secured connection needs the folder, and no other uses it";
    both(found, at, ["security", "certificates"], secured, why);
    for (name, text) in [
        ("namespace", Some(&table.namespace)),
        ("user", table.user.as_ref()),
    ] {
        if text.is_some_and(String::is_empty) {
            found.add(&key(name), "found an empty text, expected a name");
        }
    }
    let files = [
        ("password_file", &table.password_file),
        ("certificates", &table.certificates),
    ];
    for (name, file) in files {
        if let Some(file) = file {
            path(&key(name), file, found);
        }
    }
    found.range(
        &key("period_ms"),
        table.period_ms,
        ms(SHORTEST_PERIOD)..=1000.0,
    );
    found.range(&key("time_out_ms"), table.time_out_ms, 10.0..=2000.0);
    for number in &table.numbers {
        found.whole(&key("numbers"), *number, 1..=31);
    }
}

/// Refuses a path through SD43900 that is to carry more than thermal terms, and one that holds too early or does not say
/// when.
fn thermal_path(own: &ControllerConfig, at: &str, found: &mut Mistakes<'_>) {
    let period_ms = own.sinumerik.clone().unwrap_or_default().period_ms;
    if !found.states(&format!("{at}.terms")) {
        let key = format!("{at}.terms");
        let behind = lag(LAG_SPEED_MM_PER_S, of_ms(period_ms)).0;
        found.add(
            &key,
            format!(
                "missing, expected [\"thermal\"]: this control is read and written every {period_ms} ms, and at 10 m/min an axis is {behind:.1} mm further by then, so what depends on the position would come too late"
            ),
        );
        return;
    }
    let fewest = 3.0 * period_ms;
    let longest = ms(ceiling::HOLD_THERMAL);
    let expected =
        format!("expected {fewest} to {longest}: three readings at least, 1500 is usual");
    let key = format!("{at}.hold_ms");
    match own.hold_ms {
        None => found.add(&key, format!("missing, {expected}")),
        Some(hold) if hold < fewest => found.add(&key, format!("found {hold}, {expected}")),
        Some(_) => {}
    }
}

fn thermometer(own: &ThermometerConfig, at: &str, found: &mut Mistakes<'_>) {
    let key = |name: &str| format!("{at}.{name}");
    found.require(at, "names");
    let Some(address) = address(at, &own.url, found) else {
        return;
    };
    if address.scheme != Scheme::OpcUa {
        for key in ["nodes", "sinumerik"].map(key) {
            if found.states(&key) {
                found.add(
                    &key,
                    "found this key for another thermometer than a SINUMERIK control, expected it only for opc.tcp://",
                );
            }
        }
        return;
    }
    found.require(at, "nodes");
    let (nodes, names) = (own.nodes.len(), own.names.len());
    if found.states(&key("nodes")) && (nodes != names || nodes == 0) {
        let message =
            format!("found {nodes} nodes for {names} names, expected one node for each name");
        found.add(&key("nodes"), message);
    }
    if let Some(table) = &own.sinumerik {
        server(table, &key("sinumerik"), found);
    }
    for key in ["numbers", "sign", "nodes"].map(|name| key(&format!("sinumerik.{name}"))) {
        if found.states(&key) {
            found.add(
                &key,
                "found this key for a thermometer, expected it only for a controller",
            );
        }
    }
}

fn fleet(own: &FleetConfig, found: &mut Mistakes<'_>) {
    for key in [
        "url",
        "site",
        "machine",
        "serial",
        "nkey_file",
        "trusted_keys",
    ] {
        found.require("fleet", key);
    }
    let stated = |key: &str, found: &Mistakes<'_>| found.states(&format!("fleet.{key}"));
    if stated("url", found)
        && let Some(wrong) = wrong_address(&own.url)
    {
        found.add(
            "fleet.url",
            format!("found {wrong:?}, expected {ADDRESSES}"),
        );
    }
    if stated("site", found)
        && let Err(error) = own.site.parse::<SiteId>()
    {
        found.add("fleet.site", error.to_string());
    }
    if stated("machine", found)
        && let Err(error) = own.machine.parse::<MachineId>()
    {
        found.add("fleet.machine", error.to_string());
    }
    if stated("serial", found) && is_blank(&own.serial) {
        let message = format!(
            "found {:?}, expected the serial number of the machine tool",
            own.serial
        );
        found.add("fleet.serial", message);
    }
    if stated("nkey_file", found) {
        path("fleet.nkey_file", &own.nkey_file, found);
    }
    path("fleet.dir", &own.dir, found);
    if let Some(ca) = &own.ca {
        path("fleet.ca", ca, found);
        if !own.url.contains("tls://") {
            found.add(
                "fleet.ca",
                "found this key without a tls:// in url, expected it only there",
            );
        }
    }
    if stated("trusted_keys", found) && own.trusted_keys.is_empty() {
        found.add(
            "fleet.trusted_keys",
            "found no key, expected at least one public key",
        );
    }
    for (index, text) in own.trusted_keys.iter().enumerate() {
        if let Err(error) = trusted_key(text) {
            found.add("fleet.trusted_keys", format!("found {text:?}: {error}"));
        } else if own.trusted_keys[..index].contains(text) {
            found.add("fleet.trusted_keys", format!("the key {text} stands twice"));
        }
    }
}

//! Validation rules of a configuration. Every rule is checked, so that all errors are reported at once.

use std::net::SocketAddr;

use volcomp_devices::{
    Rules,
    config::{both, check_keys, has_axis, ms, path},
};
use volcomp_document::{LARGEST_NUMBER, Mistakes};
use volcomp_fleet::{ADDRESSES, MachineId, SiteId, trusted_key, wrong_address};
use volcomp_guard::{barrier::LARGEST_MACHINE, ceiling};
use volcomp_vocabulary::{AxisKind, AxisName, MAX_AXES};

use super::{Config, ControllerConfig, DashboardConfig, FleetConfig, is_blank};

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
        found.add("controller", format!("found {count} controllers, expected at most {most}"));
    }
    let has_barrier = config.controllers.iter().any(|own| own.barrier.is_some());
    for (index, own) in config.controllers.iter().enumerate() {
        let rules = Rules {
            at: &format!("controller[{index}]"),
            longest_hold: ceiling::HOLD_THERMAL,
            has_barrier,
        };
        controller(own, config.cycle_ms, &rules, found);
    }
    for (index, own) in config.thermometers.iter().enumerate() {
        own.validate(&format!("thermometer[{index}]"), found);
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
    both(found, "dashboard", ["tls_certificate", "tls_key"], stated, "");
}

/// Requires that a server without authentication listens on loopback, or that its key `anyone`
/// permits other addresses.
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

fn letters(key: &str, axes: &[AxisName], found: &mut Mistakes<'_>) {
    for (index, name) in axes.iter().enumerate() {
        if axes[..index].contains(name) {
            found.add(key, format!("duplicate axis {name}"));
        }
    }
}

fn controller(own: &ControllerConfig, cycle_ms: f64, rules: &Rules<'_>, found: &mut Mistakes<'_>) {
    let at = rules.at;
    let key = |name: &str| format!("{at}.{name}");
    let is_reader = found.is_read(&key("axes")) && own.axes.is_empty();
    let driver = check_keys(own, at, is_reader, found);
    axes(own, at, found);
    if let Some(name) = own.channel.as_deref().filter(|name| is_blank(name)) {
        found
            .add(&key("channel"), format!("found {name:?}, expected a name of visible characters"));
    }
    for (name, position) in &own.fixed {
        let key = key(&format!("fixed.{name}"));
        found.range(&key, *position, -LARGEST_NUMBER..=LARGEST_NUMBER);
    }
    letters(&key("not_driven"), &own.not_driven, found);
    for (index, state) in own.unseen.iter().enumerate() {
        if own.unseen[..index].contains(state) {
            let name = serde_json::to_string(state).unwrap_or_default();
            found.add(&key("unseen"), format!("duplicate {}", name.trim_matches('"')));
        }
    }
    for (name, step, kind, most) in [
        ("resolution_um", own.resolution_um, AxisKind::Linear, 1000.0),
        ("resolution_urad", own.resolution_urad, AxisKind::Rotary, 1e5),
    ] {
        if let Some(step) = step {
            has_axis(&key(name), kind, &own.axes, found);
            found.range(&key(name), step, 1e-4..=most);
        }
    }
    if own.terms.as_ref().is_some_and(|terms| *terms != ["thermal"]) {
        found.add(&key("terms"), "expected [\"thermal\"], or no such key: all terms");
    }
    let longest = if own.terms.is_some() { ceiling::HOLD_THERMAL } else { ceiling::HOLD };
    if let Some(hold_ms) = own.hold_ms {
        found.range(&key("hold_ms"), hold_ms, cycle_ms..=ms(longest));
    }
    barrier(own, at, found);
    if let Some(driver) = driver {
        (driver.validate)(own, rules, found);
    }
}

fn axes(own: &ControllerConfig, at: &str, found: &mut Mistakes<'_>) {
    found.require(at, "axes");
    let (axes, reads) = (format!("{at}.axes"), format!("{at}.reads"));
    letters(&axes, &own.axes, found);
    letters(&reads, &own.reads, found);
    if found.states(&reads) && own.reads.is_empty() {
        found.add(&reads, "found no axis, expected the letters of axes that are only read");
    }
    if let Some(name) = own.reads.iter().find(|name| own.axes.contains(name)) {
        let message = format!("axis {name} is also in axes: written axes are read anyway");
        found.add(&reads, message);
    }
    let count = own.axes.len() + own.reads.len();
    if found.states(&axes) && !(1..=MAX_AXES).contains(&count) {
        found.add(&axes, format!("found {count} axes, expected 1 to {MAX_AXES}"));
    }
}

/// Checks the table `barrier` of a controller, which excludes the keys of the plain scheme.
fn barrier(own: &ControllerConfig, at: &str, found: &mut Mistakes<'_>) {
    let Some(barrier) = &own.barrier else {
        return;
    };
    for key in ["area", "heartbeat", "unwatched"] {
        let key = format!("{at}.{key}");
        if found.states(&key) {
            found.add(
                &key,
                "found this key together with barrier, expected it only where corrections are written as plain values",
            );
        }
    }
    let table = format!("{at}.barrier");
    for key in ["machine", "scan_ms"] {
        found.require(&table, key);
    }
    found.whole(&format!("{table}.machine"), barrier.machine, 0..=LARGEST_MACHINE);
    found.range(&format!("{table}.scan_ms"), barrier.scan_ms, 0.1..=100.0);
}

fn fleet(own: &FleetConfig, found: &mut Mistakes<'_>) {
    for key in ["url", "site", "machine", "serial", "nkey_file", "trusted_keys"] {
        found.require("fleet", key);
    }
    let stated = |key: &str, found: &Mistakes<'_>| found.states(&format!("fleet.{key}"));
    if stated("url", found)
        && let Some(wrong) = wrong_address(&own.url)
    {
        found.add("fleet.url", format!("found {wrong:?}, expected {ADDRESSES}"));
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
        let message =
            format!("found {:?}, expected the serial number of the machine tool", own.serial);
        found.add("fleet.serial", message);
    }
    if stated("nkey_file", found) {
        path("fleet.nkey_file", &own.nkey_file, found);
    }
    path("fleet.dir", &own.dir, found);
    if let Some(ca) = &own.ca {
        path("fleet.ca", ca, found);
        if !own.url.contains("tls://") {
            found.add("fleet.ca", "found this key without a tls:// in url, expected it only there");
        }
    }
    if stated("trusted_keys", found) && own.trusted_keys.is_empty() {
        found.add("fleet.trusted_keys", "found no key, expected at least one public key");
    }
    for (index, text) in own.trusted_keys.iter().enumerate() {
        if let Err(error) = trusted_key(text) {
            found.add("fleet.trusted_keys", format!("found {text:?}: {error}"));
        } else if own.trusted_keys[..index].contains(text) {
            found.add("fleet.trusted_keys", format!("duplicate key {text}"));
        }
    }
}

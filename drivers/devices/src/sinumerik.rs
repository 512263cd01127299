//! SINUMERIK controls over OPC UA.

use std::{collections::BTreeMap, path::Path, time::Duration};

use volcomp_document::Mistakes;
use volcomp_port::{Controller, Description, DeviceError};
use volcomp_sinumerik::{
    Nodes, SHORTEST_PERIOD, Security, Sensor, Server, SinumerikConfig, SinumerikController, User,
    inspect, lag, list_axes, poll_temperatures,
};
use volcomp_vocabulary::{AxisKind, AxisName, Displacement, Um, Urad};

use crate::{
    address::{Address, hosts},
    driver::{
        ControllerDevice, Driver, GuardRequirements, Inspected, MapDevice, MapError, MapWords,
        Rules, Settings, ThermometerDevice, USUAL,
    },
    first_config::{FirstConfig, FirstMachine, Setting, includes_correction, unseen, unwatched},
    keys::{
        CONTROLLER_ONLY, ControllerConfig, MapKeys, PLAIN_KEYS, SinumerikTable, ThermometerConfig,
        both, ms, of_ms, path,
    },
    probe::Probe,
};

/// Example speed in messages about the lag of a correction, mm/s: 10 m/min.
const LAG_SPEED_MM_PER_S: f64 = 10_000.0 / 60.0;

pub(crate) const DRIVER: Driver = Driver {
    name: "a SINUMERIK control (opc.tcp://)",
    keys: &["sinumerik"],
    writer_keys: PLAIN_KEYS,
    map_tables: &["sinumerik", "nodes"],
    port: volcomp_sinumerik::PORT,
    devices: |address| hosts(address, volcomp_sinumerik::PORT),
    validate: |own, rules, found| {
        if let Some(table) = &own.sinumerik {
            validate_server(table, &format!("{}.sinumerik", rules.at), found);
        }
        let is_reader = found.is_read(&format!("{}.axes", rules.at)) && own.axes.is_empty();
        if !is_reader {
            thermal_path(own, rules, found);
        }
    },
    complete: |own, folder| own.sinumerik.get_or_insert_default().join(folder),
    controller: |address, own| Ok(Box::new(control(&address, own)?)),
    thermometer,
    validate_map,
    map: |address, keys| {
        let server = server(address, &keys.sinumerik)?;
        let (nodes, capacity) = (keys.nodes.clone(), keys.capacity);
        Ok(MapDevice {
            period: server.period,
            open: Box::new(move || {
                let words = volcomp_sinumerik::MapWords::open(&server, nodes.clone(), capacity);
                Ok(Box::new(words.map_err(MapError::of)?))
            }),
        })
    },
    example: "opc.tcp://192.0.2.20:4840",
    first: |_, machine| first(machine),
    first_thermometer,
    probe,
    ..USUAL
};

fn first(machine: &FirstMachine<'_>) -> FirstConfig {
    let shown = 1..=machine.travel.len();
    let numbers: Vec<String> = shown.map(|number| number.to_string()).collect();
    let mut settings = vec![
        Setting::list(
            "terms",
            ["thermal"],
            "Only the thermal terms: the control is too slow to follow the position",
        ),
        Setting::number("hold_ms", 1500.0, "Maximum age of positions, ms: to 5000"),
        includes_correction(false),
        unwatched(),
        unseen(),
        Setting::new(
            "sinumerik.numbers",
            format_args!("[{}]", numbers.join(", ")),
            "Axis numbers in the control: of axes, then of reads",
        ),
        Setting::text(
            "sinumerik.sign",
            "adds",
            "\"adds\": a positive SD43900 moves the axis in its positive direction; \"subtracts\": in its negative one",
        ),
        Setting::text(
            "sinumerik.nodes.emergency_stop",
            "/Plc/DB10.DBX106.1",
            "Node of the emergency stop; then take it out of unseen",
        )
        .example(),
    ];
    settings.extend(first_login());
    FirstConfig { cycle_ms: 100.0, settings, ..FirstConfig::default() }
}

fn first_login() -> [Setting; 2] {
    [
        Setting::text(
            "sinumerik.user",
            "volcomp",
            "User of the OPC UA server; without it anonymous",
        )
        .example(),
        Setting::text(
            "sinumerik.password_file",
            "sinumerik-password",
            "File with the password in its first line, mode 0600",
        )
        .example(),
    ]
}

fn first_thermometer(sensors: usize) -> Vec<Setting> {
    let nodes = (0..sensors).map(|index| format!("/Plc/DB5.DBD{}:REAL", 4 * index));
    let nodes = Setting::list("nodes", nodes, "The node of each name, °C");
    [nodes].into_iter().chain(first_login()).collect()
}

fn thermometer(
    address: Address,
    own: &ThermometerConfig,
) -> Result<ThermometerDevice, DeviceError> {
    let server = server(&address, &own.sinumerik.clone().unwrap_or_default())?;
    let sensors = own.names.iter().cloned().zip(own.nodes.iter().cloned());
    let sensors: Vec<Sensor> = sensors.map(|(name, node)| Sensor { name, node }).collect();
    Ok(ThermometerDevice {
        address,
        names: own.names.clone(),
        open: Box::new(move || {
            let thermometer = poll_temperatures(server.clone(), &sensors)?;
            Ok(Box::new(thermometer))
        }),
    })
}

fn validate_map(keys: &MapKeys, _sizes: [usize; 2], found: &mut Mistakes<'_>) {
    validate_server(&keys.sinumerik, "sinumerik", found);
    for key in CONTROLLER_ONLY.map(|key| format!("sinumerik.{key}")) {
        if found.states(&key) {
            found.add(&key, "found this key, expected it only for a controller");
        }
    }
    let nodes = &keys.nodes;
    for (key, node) in [("mailbox", &nodes.mailbox), ("report", &nodes.report)] {
        if node.is_empty() {
            found.add(&format!("nodes.{key}"), "found an empty text, expected a name");
        }
    }
    if !(nodes.buffers.contains("{byte}") && nodes.buffers.contains("{count}")) {
        let message = format!(
            "found {:?}, expected {{byte}} and {{count}} in it: the buffers are read in pieces",
            nodes.buffers
        );
        found.add("nodes.buffers", message);
    }
}

impl ControllerDevice for SinumerikConfig {
    fn describe(&self) -> Result<Description, DeviceError> {
        Self::describe(self).map_err(|error| error.of(self.device()))
    }

    fn open(&self) -> Result<Box<dyn Controller>, DeviceError> {
        Ok(Box::new(SinumerikController::new(self.clone())?))
    }

    fn settings(&self) -> Settings {
        let axes = self.axes.iter().chain(&self.reads);
        Settings {
            shown_within: Some(self.server.read_back()),
            // The resolution of positions is three decimals or, if larger, the step of the corrections.
            position_steps: axes.map(|name| (*name, self.position_step(*name))).collect(),
            ..Settings::default()
        }
    }

    fn inspect(&self, needs: Option<&GuardRequirements>) -> Result<Option<Inspected>, DeviceError> {
        let found = inspect(self).map_err(|error| error.of(self.device()))?;
        let mut notes = found.notes;
        let mut fastest = BTreeMap::new();
        for (place, axis) in found.axes.iter().enumerate() {
            let Some(per_min) = axis.fastest_per_min else {
                continue;
            };
            fastest.insert(axis.axis.to_string(), per_min);
            let slew = needs.and_then(|needs| needs.slew_per_min.get(place));
            // The rate of rotary axes, in rev/min, is not compared, because their slews are tiny.
            if let Some(slew) =
                slew.filter(|slew| axis.axis.kind() == AxisKind::Linear && **slew > per_min)
            {
                notes.push(format!(
                    "axis {}: the control applies a correction at {per_min} mm/min at most (MD32760 times MD32000), but slew_um_per_s requests {slew} mm/min: the axis lags behind",
                    axis.axis
                ));
            }
        }
        let name = |axis: &volcomp_sinumerik::InspectedAxis| {
            axis.name.clone().unwrap_or_else(|| axis.axis.to_string())
        };
        Ok(Some(Inspected {
            axes: found.axes.iter().map(name).collect(),
            fastest_per_min: Some(fastest),
            notes,
            ..Inspected::default()
        }))
    }
}

impl MapWords for volcomp_sinumerik::MapWords {
    fn report(&mut self, _count: usize) -> Result<Vec<u16>, MapError> {
        Self::report(self).map_err(MapError::of)
    }

    fn write(&mut self, frame: &[u16]) -> Result<(), MapError> {
        Self::write(self, frame).map_err(MapError::of)
    }

    fn buffer(&mut self, buffer: u16, count: usize) -> Result<Vec<u16>, MapError> {
        Self::buffer(self, buffer, count).map_err(MapError::of)
    }

    fn close(self: Box<Self>) {
        Self::close(*self);
    }
}

/// Settings of the control in a `[[controller]]`. Errors: a password file that is readable by others or cannot be read;
/// a `channel` other than the only one of the control.
fn control(address: &Address, config: &ControllerConfig) -> Result<SinumerikConfig, DeviceError> {
    let table = config.sinumerik.clone().unwrap_or_default();
    let mut control = SinumerikConfig::new(server(address, &table)?, &config.axes);
    config.only_channel(address, &control.channel, "a SINUMERIK control")?;
    control.reads.clone_from(&config.reads);
    control.numbers = table.numbers;
    control.nodes = table.nodes;
    control.sign = table.sign;
    control.includes_correction = config.includes_correction;
    if let Some(um) = config.resolution_um {
        control.step_linear = Um(um).to_mm();
    }
    if let Some(urad) = config.resolution_urad {
        control.step_rotary = Urad(urad).to_rad();
    }
    Ok(control)
}

/// Connection settings of a control's server. Errors: a password file that is readable by others or cannot be read.
pub(crate) fn server(address: &Address, config: &SinumerikTable) -> Result<Server, DeviceError> {
    let mut server = Server::new(&*address.text);
    server.namespace.clone_from(&config.namespace);
    server.user = match (&config.user, &config.password_file) {
        (Some(name), Some(file)) => {
            Some(User { name: name.clone(), password: password(address, file)? })
        }
        _ => None,
    };
    server.security = config.security;
    server.pki.clone_from(&config.certificates);
    server.period = of_ms(config.period_ms);
    server.time_out = of_ms(config.time_out_ms);
    server.source_timestamps = config.source_timestamps;
    Ok(server)
}

/// First line of a file that only its owner may read.
fn password(address: &Address, file: &Path) -> Result<String, DeviceError> {
    let text = volcomp_document::private::read(file).map_err(|error| {
        let expected = "expected a file with the password in its first line";
        address.wrong(format!("password_file: {error}"), expected).caused_by(error)
    })?;
    Ok(text.lines().next().unwrap_or_default().to_owned())
}

/// Checks the connection settings of the OPC UA server of a SINUMERIK control. `at` is the key of their table.
pub(crate) fn validate_server(table: &SinumerikTable, at: &str, found: &mut Mistakes<'_>) {
    let key = |name: &str| format!("{at}.{name}");
    let user = [table.user.is_some(), table.password_file.is_some()];
    both(found, at, ["user", "password_file"], user, "");
    let secured = [table.security != Security::None, table.certificates.is_some()];
    let why = ": a secured connection needs the folder, and no other uses it";
    both(found, at, ["security", "certificates"], secured, why);
    for (name, text) in [("namespace", Some(&table.namespace)), ("user", table.user.as_ref())] {
        if text.is_some_and(String::is_empty) {
            found.add(&key(name), "found an empty text, expected a name");
        }
    }
    let files = [("password_file", &table.password_file), ("certificates", &table.certificates)];
    for (name, file) in files {
        if let Some(file) = file {
            path(&key(name), file, found);
        }
    }
    found.range(&key("period_ms"), table.period_ms, ms(SHORTEST_PERIOD)..=1000.0);
    found.range(&key("time_out_ms"), table.time_out_ms, 10.0..=2000.0);
    for number in &table.numbers {
        found.whole(&key("numbers"), *number, 1..=31);
    }
}

/// Reports an error if a controller that corrects through SD43900 receives more than thermal terms, or if its hold time
/// is missing or too short.
fn thermal_path(own: &ControllerConfig, rules: &Rules<'_>, found: &mut Mistakes<'_>) {
    let at = rules.at;
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
    let longest = ms(rules.longest_hold);
    let expected =
        format!("expected {fewest} to {longest}: three readings at least, 1500 is usual");
    let key = format!("{at}.hold_ms");
    match own.hold_ms {
        None => found.add(&key, format!("missing, {expected}")),
        Some(hold) if hold < fewest => found.add(&key, format!("found {hold}, {expected}")),
        Some(_) => {}
    }
}

pub(crate) fn validate_thermometer(
    own: &ThermometerConfig,
    scheme: &str,
    at: &str,
    found: &mut Mistakes<'_>,
) {
    let key = |name: &str| format!("{at}.{name}");
    if scheme != "opc.tcp" {
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
        validate_server(table, &key("sinumerik"), found);
    }
    for key in CONTROLLER_ONLY.map(|name| key(&format!("sinumerik.{name}"))) {
        if found.states(&key) {
            found.add(&key, "found this key for a thermometer, expected it only for a controller");
        }
    }
}

fn probe(address: &Address, at_most: Duration) -> Result<Probe, DeviceError> {
    let mut server = Server::new(&*address.text);
    server.time_out = at_most;
    let found = list_axes(&server, &Nodes::default()).map_err(|error| error.of(&*address.text))?;
    let mut probe = Probe::of(&address.text);
    for (name, at) in found {
        // The first letter of an axis name decides whether the axis is rotary.
        let known = name.chars().next().and_then(AxisName::from_letter);
        let kind = known.map_or(AxisKind::Linear, AxisName::kind);
        probe.add_position(name, Displacement::from_coordinate(kind, at));
    }
    Ok(probe)
}

//! A plan for a terminal of 80 columns.

use std::path::Path;

use volcomp_vocabulary::AxisName;

use crate::{
    config::Config,
    documents::{
        AxisPlan, BarrierPlan, ByAxis, ControllerPlan, FleetPlan, GuardPlan, OnlineBarrier,
        OpcUaPlan, PlanDocument, PmcPlan, Source, Stated,
    },
};

/// Lines of a label, a value, and where the value comes from.
struct Lines {
    file: String,
    text: String,
}

pub(super) fn text(plan: &PlanDocument, config: &Config) -> String {
    let mut lines = Lines {
        file: name_of(&config.file),
        text: String::new(),
    };
    lines.plain("machine", &plan.machine.name);
    lines.plain("  file", &plan.machine.file);
    // The beginning tells files apart; the whole stands in the JSON document.
    let start: String = plan.machine.hash.chars().take(23).collect();
    lines.plain("  checksum", &format!("{start}…"));
    lines.plain("  structure", &plan.machine.structure);
    let axes: Vec<String> = plan.machine.axes.iter().map(ToString::to_string).collect();
    lines.plain("  axes", &axes.join(" "));
    lines.stated("cycle", &plan.cycle_ms, |ms| format!("{ms} ms"));
    lines.stated("arms itself", &plan.auto_arm, |yes| yes_no(*yes).to_owned());
    if let Some(guard) = &plan.guard {
        lines.guard(guard, plan);
    }
    for (index, controller) in plan.controllers.iter().enumerate() {
        lines.controller(index + 1, controller, plan.guard.is_some());
    }
    for thermometer in &plan.thermometers {
        lines.plain("thermometer", &thermometer.url);
        lines.plain("  sensors", &thermometer.sensors.join(", "));
    }
    for sensor in &plan.sensors {
        let feeds = if sensor.feeds.is_empty() {
            "shown only; no thermal term uses it".to_owned()
        } else {
            sensor.feeds.join(", ")
        };
        lines.plain(&format!("sensor {}", sensor.name), &feeds);
    }
    lines.stated("dashboard", &plan.dashboard.listen, Clone::clone);
    lines.plain("  TLS", yes_no(plan.dashboard.tls));
    let needs = if plan.dashboard.reading_needs_token {
        "needs a token"
    } else {
        "open to programs on this computer"
    };
    lines.plain("  reading", needs);
    for token in &plan.dashboard.tokens {
        lines.plain(&format!("  token {}", token.name), &token.role);
    }
    lines.stated("audit log", &plan.audit.dir, Clone::clone);
    if let Some(fleet) = &plan.fleet {
        lines.fleet(fleet);
    }
    for way in &plan.interop {
        lines.plain(&way.table, &format!("{} as {}", way.address, way.name));
    }
    for control in plan.online.iter().flatten() {
        lines.plain("control", &control.url);
        lines.plain("  axes", &control.axes.join(" "));
        if let Some(fastest) = &control.fastest_per_min {
            lines.plain("  SD43900", "in use (MD32750)");
            for (axis, per_min) in fastest {
                let per_min = format!("{per_min} mm/min or rev/min at the most");
                lines.plain(&format!("    axis {axis}"), &per_min);
            }
        } else if let Some(version) = control.protocol {
            lines.plain("  protocol", &format!("version {version}"));
            lines.plain("  state", control.state.as_deref().unwrap_or("not told"));
        } else {
            let words = match (control.shift_in_use, control.shift_words) {
                (Some(true), Some(first)) => format!("from R{first} on (parameter 1280)"),
                (Some(false), _) => "not in use (parameter 1203#0)".to_owned(),
                _ => "not told".to_owned(),
            };
            lines.plain("  shift words", &words);
        }
        if let Some(barrier) = &control.barrier {
            lines.online_barrier(barrier);
        }
        for note in &control.notes {
            lines.note(note);
        }
    }
    for note in &plan.notes {
        lines.note(note);
    }
    lines.text
}

impl Lines {
    fn plain(&mut self, label: &str, value: &str) {
        let line = format!("{label:<21} {value}");
        self.text += line.trim_end();
        self.text += "\n";
    }

    /// A value, and behind it where it comes from.
    fn stated<T>(&mut self, label: &str, value: &Stated<T>, show: impl Fn(&T) -> String) {
        let from = match value.source {
            Source::Configuration => self.file.as_str(),
            Source::Default => "default",
            Source::Device => "device",
        };
        let asked = match &value.asked {
            Some(asked) => format!(" ({} asked)", show(asked)),
            None => String::new(),
        };
        let line = format!("{label:<21} {:<29} {from}{asked}", show(&value.value));
        self.text += line.trim_end();
        self.text += "\n";
    }

    /// A note over as many lines as it needs.
    fn note(&mut self, note: &str) {
        let mut line = "note:".to_owned();
        for word in note.split(' ') {
            if line.chars().count() + 1 + word.chars().count() > 79 {
                self.text += &line;
                self.text += "\n";
                "     ".clone_into(&mut line);
            }
            line += " ";
            line += word;
        }
        self.text += &line;
        self.text += "\n";
    }

    fn fleet(&mut self, fleet: &FleetPlan) {
        let servers = fleet.url.split(',').map(str::trim);
        let mut label = "fleet";
        for server in servers {
            self.plain(std::mem::take(&mut label), server);
        }
        self.plain("  machine", &format!("{} at {}", fleet.machine, fleet.site));
        self.plain("  serial number", &fleet.serial);
        self.plain("  nkey", &fleet.nkey);
        for key in &fleet.trusted_keys {
            self.plain("  trusts", key);
        }
        if let Some(ca) = &fleet.ca {
            self.plain("  certificates", ca);
        }
        self.stated("  folder", &fleet.dir, Clone::clone);
        let version = match (fleet.version, fleet.accepted) {
            (0, 0) => "none yet: the configured machine file corrects".to_owned(),
            (0, accepted) => format!("none of {accepted}: the configured machine file corrects"),
            (version, accepted) if version == accepted => format!("{version} is in force"),
            (version, accepted) => format!("{version} is in force, {accepted} was accepted"),
        };
        self.plain("  manifest", &version);
        self.plain(
            "  correcting",
            if fleet.enabled {
                "allowed"
            } else {
                "disabled by the centre"
            },
        );
    }

    fn guard(&mut self, guard: &GuardPlan, plan: &PlanDocument) {
        let ms = |ms: &f64| format!("{ms} ms");
        let s = |s: &f64| format!("{s} s");
        self.plain("guard", "");
        self.stated("  hold after", &guard.hold_ms, ms);
        self.stated("  zero after", &guard.zero_after_ms, ms);
        self.stated("  ramp", &guard.ramp_s, s);
        self.stated("  stop within", &guard.stop_s, s);
        if plan.machine.axes.iter().any(|axis| axis.is_rotary()) {
            self.stated("  half a rotary step", &guard.rotary_step_um, |um| {
                format!("{um} µm at the tool tip")
            });
            self.stated("  rotary axes turn at most", &guard.rapid_rpm, |rpm| {
                format!("{rpm}/min")
            });
        }
        self.stated("  hand back after", &guard.hand_back_s, s);
        self.stated("  axes move at most", &guard.rapid_m_per_min, |speed| {
            format!("{speed} m/min")
        });
        if !plan.sensors.is_empty() {
            self.temperatures(guard);
        }
    }

    fn temperatures(&mut self, guard: &GuardPlan) {
        let s = |s: &f64| format!("{s} s");
        self.stated("  temperatures", &guard.range_degc, |[low, high]| {
            format!("{low} to {high} °C")
        });
        self.stated("  change at most", &guard.max_degc_per_min, |k| {
            format!("{k} K/min")
        });
        self.stated("  stale after", &guard.temperature_stale_s, s);
        self.stated("  stuck after", &guard.temperature_stuck_s, |s| {
            if *s > 0.0 {
                format!("{s} s")
            } else {
                "never".to_owned()
            }
        });
        let neighbours = &guard.temperature_neighbours_k;
        self.stated("  neighbours within", neighbours, |k| {
            k.map_or_else(|| "not compared".to_owned(), |k| format!("{k} K"))
        });
        self.stated("  terms held for", &guard.temperature_hold_s, s);
        self.stated("  terms fade over", &guard.temperature_fade_s, s);
    }

    fn controller(&mut self, number: usize, controller: &ControllerPlan, has_limits: bool) {
        self.plain(&format!("controller {number}"), &controller.url);
        if controller.axes.is_empty() && controller.held.is_empty() {
            return self.reads(controller);
        }
        self.stated("  channel", &controller.channel, Clone::clone);
        match &controller.barrier {
            Some(barrier) => self.barrier(barrier),
            None => self.plain(
                "  heartbeat",
                if controller.watched {
                    "watched, no barrier"
                } else {
                    "not watched, no barrier"
                },
            ),
        }
        self.plain(
            "  other gateways",
            if controller.sees_other_gateways {
                "noticed"
            } else {
                "not noticed"
            },
        );
        self.plain(
            "  shortest cycle",
            &format!("{} ms", controller.shortest_cycle_ms),
        );
        if controller.only_thermal {
            self.plain("  terms", "thermal only");
        }
        if let Some(ms) = controller.hold_ms {
            self.plain("  hold after", &format!("{ms} ms"));
        }
        if let Some(pmc) = &controller.pmc {
            self.pmc(pmc);
        }
        if let Some(opc_ua) = &controller.opc_ua {
            self.opc_ua(opc_ua);
        }
        let mut axes: Vec<&AxisPlan> = controller.axes.iter().collect();
        if let Some(barrier) = &controller.barrier {
            axes.sort_by_key(|axis| barrier.axes.iter().position(|name| *name == axis.name));
        }
        // Axes for which the same holds stand together.
        let mut groups: Vec<(String, &AxisPlan)> = Vec::new();
        for axis in axes {
            let same = |(_, first): &&mut (String, &AxisPlan)| {
                AxisPlan {
                    name: axis.name,
                    ..(*first).clone()
                } == *axis
            };
            match groups.iter_mut().find(same) {
                Some((letters, _)) => {
                    letters.push(' ');
                    letters.push(axis.name.letter());
                }
                None => groups.push((axis.name.to_string(), axis)),
            }
        }
        for (letters, axis) in groups {
            let axes = if letters.contains(' ') {
                "axes"
            } else {
                "axis"
            };
            self.plain(&format!("  {axes} {letters}"), &axis.kind);
            self.axis(axis, has_limits);
        }
        for (letters, needs) in needs(controller) {
            self.plain(&letters, &needs);
        }
        if !controller.held.is_empty() {
            let letters: Vec<String> = controller.held.iter().map(ToString::to_string).collect();
            let axes = if letters.len() > 1 { "axes" } else { "axis" };
            self.plain(
                &format!("  {axes} {}", letters.join(" ")),
                "held, not corrected",
            );
        }
        self.reads(controller);
        for (name, at) in &controller.fixed {
            let unit = if name.is_rotary() { "deg" } else { "mm" };
            self.plain(&format!("  axis {name}"), &format!("stands at {at} {unit}"));
        }
    }

    fn barrier(&mut self, barrier: &BarrierPlan) {
        let letters: Vec<String> = barrier.axes.iter().map(ToString::to_string).collect();
        self.plain("  barrier", &format!("machine {}", barrier.machine));
        let layout = format!("{}: {} in this order", barrier.layout, letters.join(" "));
        self.plain("    layout", &layout);
        self.plain("    scan", &format!("{} ms", barrier.scan_ms));
    }

    fn opc_ua(&mut self, opc_ua: &OpcUaPlan) {
        let every = format!(
            "every {} ms, answers within {} ms",
            opc_ua.period_ms, opc_ua.time_out_ms
        );
        self.plain("  read and written", &every);
        let user = opc_ua.user.as_deref().unwrap_or("anonymous");
        self.plain("    user", &format!("{user}, security {}", opc_ua.security));
        self.plain(
            "    ages",
            if opc_ua.source_timestamps {
                "by the server's timestamps"
            } else {
                "by the exchange"
            },
        );
        self.plain("    namespace", &opc_ua.namespace);
        self.plain("    positions", &opc_ua.positions);
        self.plain("    corrections", &opc_ua.settings);
        self.plain("    sign", &opc_ua.sign);
    }

    fn online_barrier(&mut self, barrier: &OnlineBarrier) {
        let (machine, layout) = (barrier.machine, barrier.layout);
        self.plain(
            "  barrier",
            &format!("machine {machine}, layout {layout}: fits"),
        );
        let scan = barrier.scan_ms;
        let scan = scan.map_or("not counted".to_owned(), |ms| format!("{ms} ms, counted"));
        self.plain("    scan", &scan);
        self.plain(
            "    owner",
            &match barrier.owner {
                0 => "0: free, no gateway sends".to_owned(),
                owner => format!("{owner}: a gateway sends, or did just before"),
            },
        );
        self.plain("    oldest frame", &format!("{} ms", barrier.hold_ms));
        self.plain("    time-out", &format!("{} ms", barrier.time_out_ms));
        for axis in &barrier.axes {
            let unit = AxisPlan::unit_of(axis.name.kind());
            let (limit, rate) = (axis.limit, axis.rate_per_s);
            let text = format!("limit {limit} {unit}, rate {rate} {unit}/s");
            self.plain(&format!("    axis {}", axis.name), &text);
        }
    }

    fn reads(&mut self, controller: &ControllerPlan) {
        if controller.reads.is_empty() {
            return;
        }
        let letters: Vec<String> = controller.reads.iter().map(ToString::to_string).collect();
        let axes = if letters.len() > 1 { "axes" } else { "axis" };
        let label = format!("  {axes} {}", letters.join(" "));
        self.plain(&label, "only read, never written");
    }

    fn pmc(&mut self, pmc: &PmcPlan) {
        if let Some((first, bytes)) = pmc.shift_words.as_ref().zip(pmc.shift_bytes) {
            let each = if bytes == 1 { "byte" } else { "bytes" };
            let copied = if pmc.copied {
                ", copied on by the ladder"
            } else {
                ""
            };
            let text = format!("from {first} on, {bytes} {each} an axis{copied}");
            self.plain("  shift words", &text);
        }
        let bytes = [("frame from", &pmc.frame), ("report from", &pmc.report)];
        for (label, at) in bytes {
            if let Some(at) = at {
                self.plain(&format!("  {label}"), at);
            }
        }
        if pmc.frame.is_none() {
            let heartbeat = pmc.heartbeat.as_deref().unwrap_or("none");
            self.plain("  heartbeat byte", heartbeat);
        }
        let referenced = pmc.referenced.as_deref();
        self.plain("  referenced axes", referenced.unwrap_or("not asked"));
    }

    fn axis(&mut self, axis: &AxisPlan, has_limits: bool) {
        let unit = &axis.unit;
        let show = |value: &f64| format!("{value} {unit}");
        if has_limits {
            self.stated("    limit", &axis.limit, show);
            self.stated("    warning above", &axis.warn, show);
            self.stated("    slew", &axis.slew_per_s, |v| format!("{v} {unit}/s"));
            self.stated(
                "    acceleration",
                &axis.accel_per_s2,
                |accel| match accel {
                    Some(accel) => format!("{accel} {unit}/s²"),
                    None => "not limited".to_owned(),
                },
            );
            self.stated("    confirm above", &axis.confirm, show);
            let shift = if axis.test_shift == 0.0 {
                "not made".to_owned()
            } else {
                show(&axis.test_shift)
            };
            self.plain("    test shift", &shift);
        }
        self.stated("    step", &axis.resolution, show);
        self.stated("    shows correction", &axis.includes_correction, |yes| {
            yes_no(*yes).to_owned()
        });
    }
}

/// What the machine file asks for at the most, and what each kelvin may change of it: linear axes, then rotary ones.
fn needs(controller: &ControllerPlan) -> Vec<(String, String)> {
    let mut lines = Vec::new();
    for (rotary, unit) in [(false, "µm"), (true, "µrad")] {
        let of_kind = |needs: &ByAxis, word: &dyn Fn(AxisName, f64) -> String| {
            let of_kind = needs.iter().filter(|(name, _)| name.is_rotary() == rotary);
            let words: Vec<String> = of_kind.map(|(name, most)| word(*name, *most)).collect();
            words.join("  ")
        };
        let up_to = of_kind(&controller.needs, &|name, most| format!("{name} {most}"));
        let per_k = of_kind(&controller.needs_per_k, &|name, per_k| {
            let most = controller.needs.get(&name).copied().unwrap_or_default();
            let axis = controller.axes.iter().find(|axis| axis.name == name);
            let left = axis.map_or(0.0, |axis| axis.limit.value - most);
            if left > 0.0 {
                let left_k = (10.0 * left / per_k).floor() / 10.0;
                format!("{name} {per_k} (limit after {left_k:.1} K)")
            } else {
                format!("{name} {per_k}")
            }
        });
        for (label, words) in [("needs up to", up_to), ("more per K", per_k)] {
            if !words.is_empty() {
                lines.push((format!("  {label}, {unit}"), words));
            }
        }
    }
    lines
}

fn yes_no(yes: bool) -> &'static str {
    if yes { "yes" } else { "no" }
}

fn name_of(file: &str) -> String {
    let path = Path::new(file);
    path.file_name().map_or_else(
        || file.to_owned(),
        |name| name.to_string_lossy().into_owned(),
    )
}

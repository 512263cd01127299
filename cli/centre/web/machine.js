"use strict";
// One machine: state, history, models and versions, alarms, registration.

const MACHINE_EVERY_MS = 2000, HISTORY_EVERY_MS = 15000;
const SPANS = [["raw", 0.25, "15 min"], ["raw", 2, "2 h"], ["minute", 24, "day"], ["minute", 168, "week"], ["hour", 2160, "90 days"]];

/** "2026-11-26 13:57 to 14:12": the period of a history, with the zone of its times. */
function periodOf(from, to) {
  const [first, last] = [clock(from).slice(0, 16), clock(to).slice(0, 16)];
  const minutes = -new Date(to * 1000).getTimezoneOffset();
  const zone = `UTC${minutes < 0 ? "−" : "+"}${Math.floor(Math.abs(minutes) / 60)}${minutes % 60 ? `:${two(Math.abs(minutes) % 60)}` : ""}`;
  return `${first} to ${first.slice(0, 10) === last.slice(0, 10) ? last.slice(11) : last}, by the clock of this computer (${zone})`;
}

function chart(title, series, kind = "") {
  const canvas = make("canvas", { class: kind, role: "img" });
  canvas.setAttribute("aria-label", title);
  const keys = make("div", { class: "keys" }, ...series.map(({ name, colour }) => {
    const key = make("span", { textContent: name });
    key.style.setProperty("--key", colour);
    return key;
  }));
  return [make("div", {}, make("h2", { textContent: title }), keys, canvas), canvas];
}

/** Series of one key of every point, by its inner names. */
function byName(points, key) {
  const names = [...new Set(points.flatMap((point) => Object.keys(point[key] || {})))];
  const sorted = names.every((name) => LETTERS.includes(name)) ? inOrder(names) : names.sort();
  return sorted.map((name, index) => ({ name, colour: COLOURS[index % COLOURS.length], points: points.map((point) => [point.at_s, (point[key] || {})[name] ?? null]) }));
}

function showHistory(place, { now_s: to, together, points }, [resolution, hours]) {
  const from = to - hours * 3600;
  const gap = { raw: 10, minute: 150, hour: 7300 }[resolution] * together;
  const residual = [
    { name: "mean", colour: COLOURS[1], points: points.map((point) => [point.at_s, point.residual_um]) },
    { name: "largest", colour: COLOURS[3], points: points.map((point) => [point.at_s, point.residual_max_um]) },
  ];
  const states = [...new Set(points.map((point) => point.state))];
  const drawn = [];
  const [ribbon, ribbonCanvas] = chart("State", states.map((state) => ({ name: state, colour: STATE_COLOURS[state] || "#b3261e" })), "ribbon");
  drawn.push([ribbonCanvas, () => drawRibbon(ribbonCanvas, from, to, points, gap)]);
  const charts = [ribbon];
  for (const [title, series] of [
    ["Residual by the model, µm", residual],
    ["Correction, µm", byName(points, "correction_um")],
    ["Correction, µrad", byName(points, "correction_urad")],
    ["Temperatures, °C", byName(points, "temperatures_degc")],
    ["Time within which 99 % of the cycles end, µs", [{ name: "p99", colour: COLOURS[2], points: points.map((point) => [point.at_s, point.cycle_p99_us]) }]],
  ]) {
    if (series.length === 0) continue;
    const [shown, canvas] = chart(title, series);
    charts.push(shown);
    drawn.push([canvas, () => drawHistory(canvas, from, to, series, gap)]);
  }
  place.replaceChildren(make("p", { class: "soft wide period", textContent: periodOf(from, to) }), ...charts);
  for (const [canvas, draw] of drawn) drawOn(canvas, draw);
}

function outcomeOf(version, isKnown) {
  const { outcome } = version;
  if (!outcome) return [badge("sent", "not answered"), isKnown ? "" : "sent; no message from the machine yet"];
  if (outcome.outcome === "activated") return [badge("activated"), clock(version.answered_s)];
  if (outcome.outcome === "refused") return [badge("refused"), outcome.why];
  return [badge("needs-confirmation", "needs confirmation"), `It would move the axes by up to ${movesOf(outcome)}: a user must confirm it in its roll-out.`];
}

function alarmRow(alarm, withMachine) {
  const seen = make("span", { class: "said", textContent: alarm.seen_by ? `seen by ${alarm.seen_by}` : "" });
  const button = may("engineer") && !alarm.seen_by ? make("button", { class: "quiet", textContent: "Acknowledge", onclick: () => act(button, seen, () => post(`/api/alarms/${alarm.id}/seen`), () => {
    button.remove();
    return `seen by ${me.name}`;
  }) }) : null;
  const until = alarm.until_s === null ? "open" : `until ${clock(alarm.until_s)}`;
  const machine = alarm.machine ? make("a", { href: `#machine/${encodeURIComponent(alarm.machine)}`, textContent: alarm.machine }) : "the centre";
  return make("tr", {}, ...(withMachine ? [cell(machine)] : []), cell(badge(alarm.severity, alarm.severity)), cell(alarm.text, { class: "text" }), cell(`${clock(alarm.since_s)}, ${until}`), cell(make("div", {}, seen, button)));
}

function machinePage(page, name) {
  const id = decodeURIComponent(name);
  const place = (kind) => make("div", { id: `machine-${kind}` });
  const span = { chosen: SPANS[0] };
  const spans = make("div", { class: "buttons" }, ...SPANS.map((one) => make("button", { class: "quiet", textContent: one[2], ariaPressed: String(one === span.chosen), onclick: (event) => {
    span.chosen = one;
    for (const button of spans.children) button.ariaPressed = String(button === event.target);
    history();
  } })));
  const charts = make("div", { class: "panels" });
  const map = make("div", {}, make("p", { class: "soft", textContent: "No model was sent to this machine." }));
  page.replaceChildren(
    place("head"),
    make("div", { class: "panels tight" }, place("now"), place("degc"), place("cycle"), place("facts")),
    make("section", { class: "panel" }, make("h2", { textContent: "History" }), spans, charts),
    make("section", { class: "panel", id: "machine-map" }, make("h2", { textContent: "Error over the work space by the model, µm" }), map),
    place("versions"), place("alarms"), place("records"), place("change"),
  );
  let drawn = "";
  let changeShown = false;
  const history = async () => {
    const chosen = span.chosen;
    try {
      const answer = await get(`/api/machines/${encodeURIComponent(id)}/history?resolution=${chosen[0]}&hours=${chosen[1]}`);
      if (chosen === span.chosen) showHistory(charts, answer, chosen);
    } catch (error) {
      charts.replaceChildren(make("p", { class: "bad", textContent: error.message }));
    }
  };
  const endHistory = repeat(history, HISTORY_EVERY_MS);
  const endState = repeat(async () => {
    const answer = await get(`/api/machines/${encodeURIComponent(id)}`);
    showMachine(id, answer);
    if (!changeShown) {
      changeShown = true;
      if (may("engineer")) element("machine-change").replaceChildren(make("details", { class: "panel" }, make("summary", { textContent: "Registration" }), machineForm(answer.machine, false)));
    }
    const origin = originOf(answer);
    if (answer.model && drawn !== `${answer.model} ${origin}`) {
      drawn = `${answer.model} ${origin}`;
      try {
        drawSections(map, await get(`/api/models/${answer.model}/map`), origin);
      } catch (error) {
        map.replaceChildren(make("p", { class: "bad", textContent: error.message }));
      }
    }
  }, MACHINE_EVERY_MS, () => {
    element("machine-now").replaceChildren(panel("Now", make("p", { class: "unknown", textContent: "unknown: the centre does not answer" })));
    for (const part of ["degc", "cycle"]) element(`machine-${part}`).replaceChildren();
  });
  return () => {
    endHistory();
    endState();
  };
}

function showMachine(id, { machine, live, age_s: age, silent, versions, telemetry, alarms, records }) {
  const condition = live && !silent ? live.condition : null;
  const state = condition ? condition.state : live ? "unknown" : "never connected";
  const conditionAge = age === null || age === undefined ? "" : `, condition of ${lasting(age)} ago`;
  element("machine-head").replaceChildren(make("div", { class: "head" }, make("h1", { textContent: id }), badge(state), make("span", { class: "soft", textContent: `${machine.site}, ${machine.structure}${conditionAge}` }), machine.enable ? null : make("span", { class: "bad", textContent: "correction disabled" })));
  const corrections = condition ? [...Object.entries(condition.correction_um).map(([axis, um]) => [axis, `${signed(um, 1)} µm`]), ...Object.entries(condition.correction_urad || {}).map(([axis, urad]) => [axis, `${signed(urad, 1)} µrad`])] : [];
  const report = telemetry && telemetry.state ? telemetry.state.body || telemetry.state : {};
  // A gateway knows the residual of its model; only a simulated machine can report its true error.
  const truth = !silent && report.simulated && Array.isArray(report.true_residual_um) ? Math.hypot(...report.true_residual_um) : null;
  if (!live) {
    element("machine-now").replaceChildren(panel("Now", make("p", { class: "unknown", textContent: "Never connected: no message from its gateway yet, so the state of the machine is unknown. Its gateway needs the nkey file of this machine, the address of the server and the public key of the centre in its table [fleet]; the server needs a configuration that names the machine (nats-config)." })));
  } else element("machine-now").replaceChildren(panel("Now", facts([
    ["state", state],
    ["why", condition ? condition.reasons.join(", ") : live && live.condition ? `silent; last: ${live.condition.state}` : ""],
    ["armed", condition ? (condition.armed ? "yes" : "no") : "unknown"],
    ["residual", condition && isNumber(condition.residual_um) ? `${fixed(condition.residual_um, 1)} µm: error after correction at this position, by the model` : "unknown"],
    ...(isNumber(truth) ? [["true error", `${fixed(truth, 1)} µm, known in this simulation only; ${lasting(telemetry.age_s)} ago`]] : []),
    ...(corrections.length ? inOrder(corrections.map(([axis]) => axis)).map((axis) => [`correction ${axis}`, corrections.find(([one]) => one === axis)[1]]) : [["correction", "unknown"]]),
    ["version", live && !silent ? `${live.version || "none"}${versions.length && versions[0].version !== live.version ? `, ${versions[0].version} desired` : ""}` : "unknown"],
    ["overruns, faults", condition ? `${condition.overruns}, ${condition.faults}` : "unknown"],
    ["messages lost", live ? String(live.lost) : "unknown"],
  ])));
  const degc = condition ? Object.entries(condition.temperatures_degc) : [];
  element("machine-degc").replaceChildren(panel("Temperatures", degc.length ? facts(degc.map(([name, value]) => [name, value === null ? make("span", { class: "bad", textContent: "broken" }) : `${fixed(value, 2)} °C`])) : make("p", { class: "soft", textContent: condition ? "no thermometer" : live ? "unknown" : "never connected" })));
  showCycle(telemetry, live ? silent && "unknown" : "never connected");
  element("machine-facts").replaceChildren(panel("Registered", facts([
    ["serial", machine.serial], ["control", machine.control], ["address", machine.address], ["axes", machine.axes.join(" ")],
    ["key", machine.nkey ? short(machine.nkey) + "…" : "none: it cannot reach the server"], ["first in roll-outs", machine.canary ? "yes" : "no"],
    ["calibration due", machine.due_days ? `${machine.due_days} d after the last one` : "never"], ["note", machine.note],
  ])));
  element("machine-versions").replaceChildren(panel("Models and versions", versions.length === 0 ? make("p", { class: "soft", textContent: "No version was sent yet." }) : table(["version", "model", "issued", "answer", ""], versions.slice(0, 20).map((version) => {
    const [shown, why] = outcomeOf(version, Boolean(live));
    return make("tr", {}, cell(`${version.version}${live && live.version === version.version ? " (active)" : ""}`), cell(make("a", { href: `#model/${version.model}`, textContent: short(version.model) })), cell(`${clock(version.issued_s)}, ${version.by}`), cell(shown), cell(why, { class: "text" }));
  }))));
  element("machine-alarms").replaceChildren(panel("Alarms", alarms.length === 0 ? make("p", { class: "soft", textContent: "none" }) : table(["", "what", "when", ""], alarms.slice(0, 20).map((alarm) => alarmRow(alarm, false)))));
  const open = element("machine-records").querySelector("details")?.open || false;
  element("machine-records").replaceChildren(make("details", { class: "panel", open }, make("summary", { textContent: "Audit log of the gateway" }), make("pre", { textContent: records.map(({ at_s: at, record }) => `${clock(at)}  ${JSON.stringify(record)}`).join("\n") || "nothing yet" })));
}

function showCycle(telemetry, otherwise) {
  const place = element("machine-cycle");
  const cycle = telemetry && telemetry.state && (telemetry.state.body || telemetry.state).cycle;
  if (!cycle || !Array.isArray(cycle.histogram_us)) {
    place.replaceChildren(panel("Cycle time, µs", make("p", { class: "soft", textContent: otherwise || "no data yet" })));
    return;
  }
  if (!place.querySelector("canvas")) place.replaceChildren(panel("Cycle time, µs", make("canvas", { role: "img", ariaLabel: "Histogram of cycle times" }), make("p", {})));
  const canvas = place.querySelector("canvas");
  drawOn(canvas, () => drawBars(canvas, cycle.histogram_us));
  setText(place.querySelector("p"), `p99 ${fixed(cycle.p99_us, 0)} µs; ${cycle.count} cycles, ${cycle.overruns} overruns; ${lasting(telemetry.age_s)} ago`);
}

/** Label and hint of each field of a registration. */
const REGISTRATION = {
  machine: ["Name", "Lower-case letters, digits and hyphens, such as mill-1. Its gateway has the same name in machine of [fleet]."],
  site: ["Site", "Location: lower-case letters, digits and hyphens, such as berlin. Its gateway has the same in site of [fleet]."],
  serial: ["Serial number of the machine tool", "As on its name plate and in serial of [fleet], such as 4711. A gateway rejects a model for another one."],
  structure: ["Structure code", "The axes from the workpiece (w) over the bed (b) to the tool (t), such as w X' b Y Z t; a dash ' marks an axis that carries the workpiece."],
  control: ["Control", "Make and type as on its name plate, such as SINUMERIK ONE; for display only."],
  address: ["Address of the control", "Host and port, such as 192.0.2.17:4840; for display only."],
  nkey: ["Public key of its gateway", "Begins with U, as printed by volcomp-centre key nkey. Empty: it cannot reach the server yet."],
  due_days: ["Next calibration due after, days", "Days after the last calibration until an alarm is raised, such as 365. Empty: never."],
  note: ["Note", "Free text, for display."],
};

/** The registration form of a new or a known machine. */
function machineForm(machine, isNew) {
  const input = (value, properties = {}) => make("input", { value: value ?? "", ...properties });
  const inputs = {
    machine: input(machine.machine, { required: true, readOnly: !isNew, pattern: "[a-z0-9][a-z0-9\\-]{0,63}", title: "lower-case letters, digits and hyphens" }),
    site: input(machine.site, { required: true, pattern: "[a-z0-9][a-z0-9\\-]{0,63}", title: "lower-case letters, digits and hyphens" }),
    serial: input(machine.serial, { required: true }),
    structure: input(machine.structure, { required: true, placeholder: "w X' b Y Z t" }),
    control: input(machine.control),
    address: input(machine.address),
    nkey: input(machine.nkey, { placeholder: "U…" }),
    due_days: input(machine.due_days, { type: "number", min: 1, max: 36500 }),
    note: input(machine.note),
  };
  const canary = make("input", { type: "checkbox", checked: Boolean(machine.canary) });
  const enable = make("input", { type: "checkbox", checked: machine.enable !== false });
  const said = make("p", { class: "said" });
  const button = make("button", { class: "main", textContent: isNew ? "Register" : "Save" });
  const remove = isNew ? null : make("button", { class: "stop", type: "button", textContent: "Remove the machine", onclick: () => {
    if (window.confirm(`Remove ${machine.machine}? Its gateway continues with its active model.`)) {
      act(remove, said, () => post(`/api/machines/${encodeURIComponent(machine.machine)}/remove`), () => {
        location.hash = "#shop";
      });
    }
  } });
  return make("form", { class: "machine-form", onsubmit: (event) => {
    event.preventDefault();
    const text = (key) => inputs[key].value.trim();
    const structure = text("structure");
    act(button, said, () => post("/api/machines", {
      ...machine,
      machine: text("machine"), site: text("site"), serial: text("serial"), structure, axes: axesOf(structure),
      control: text("control"), address: text("address"), nkey: text("nkey") || null, note: text("note"),
      due_days: text("due_days") ? Number(text("due_days")) : null, canary: canary.checked, enable: enable.checked,
    }), () => {
      if (isNew) location.hash = `#machine/${encodeURIComponent(text("machine"))}`;
      return "saved";
    });
  } },
  make("div", { class: "fields" }, ...Object.keys(inputs).map((key) => field(REGISTRATION[key][0], inputs[key], key === "control" && isNew && machine.address && !machine.control ? "The search could not determine it: enter make and type as on its name plate, such as SINUMERIK ONE." : REGISTRATION[key][1]))),
  make("div", { class: "fields" }, make("label", { class: "row" }, enable, "Correction enabled"), make("label", { class: "row" }, canary, "Canary: among the first machines of each roll-out")),
  make("div", { class: "buttons" }, button, remove, said));
}

/** The letters of a structure code, in its order. */
function axesOf(structure) {
  return [...structure].filter((letter) => LETTERS.includes(letter));
}

function registerPage(page) {
  const known = registerPage.proposed || {};
  registerPage.proposed = null;
  const { proposals, ...machine } = known;
  const form = machineForm({ enable: true, canary: false, control: "", address: "", note: "", ...machine }, true);
  const structure = form.querySelectorAll("input")[3];
  const candidates = proposals && proposals.length ? field("Possible structures: choose one, and compare it with the machine", choose([["", "–"], ...proposals.map((one) => [one.structure, `${one.structure}: ${one.design}`])], structure.value)) : null;
  if (candidates) candidates.querySelector("select").addEventListener("change", (event) => {
    structure.value = event.target.value;
  });
  page.replaceChildren(make("div", { class: "head" }, make("h1", { textContent: "Register a machine" })), panel("", candidates, form));
}

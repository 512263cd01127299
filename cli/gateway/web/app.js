"use strict";
/* global drawLines, drawBars, drawMap */

const SPAN_S = 120, HOLD_MS = 1000, LOST_AFTER_MS = 2000;
const element = (id) => document.getElementById(id);
const trend = { before: [], after: [] };
let map = null, mapAxes = null, lastHeard = 0, current = null;

// The token stays in this tab only; it is never in an address.
const token = () => sessionStorage.getItem("token") || "";
const headers = () => (token() ? { Authorization: `Bearer ${token()}` } : {});

const length = (v) => Math.hypot(...v);
const fixed = (value, digits) => (value === null || value === undefined ? "–" : value.toFixed(digits).replace("-", "−"));

function text(id, value) {
  const target = element(id);
  if (target.textContent !== value) target.textContent = value;
}

function make(tag, name, parent) {
  const made = document.createElement(tag);
  if (name) made.className = name;
  parent.append(made);
  return made;
}

function showAxes(state) {
  const rows = [["mm", "um", 3], ["deg", "urad", 4]].flatMap(([unit, small, digits]) =>
    Object.keys(state[`correction_${small}`] || {}).map((name) => ({
      name, digits, unit, small,
      position: (state[`positions_${unit}`] || {})[name],
      correction: state[`correction_${small}`][name],
    })));
  const list = element("axes");
  for (const row of rows) {
    let card = list.querySelector(`[data-axis="${row.name}"]`);
    if (!card) {
      card = make("div", "axis", list);
      card.dataset.axis = row.name;
      make("div", "name", card).textContent = row.name;
      for (const [kind, unit] of [["position", row.unit], ["correction", row.small.replace("u", "µ")]]) {
        const cell = make("div", kind, card);
        make("span", "value", cell);
        make("small", "", cell).textContent = ` ${unit}`;
      }
    }
    card.querySelector(".position .value").textContent = fixed(row.position, row.digits);
    card.querySelector(".correction .value").textContent = (row.correction > 0 ? "+" : "") + fixed(row.correction, 1);
  }
}

function showTemperatures(list) {
  const body = element("temperatures").tBodies[0];
  while (body.rows.length > list.length) body.deleteRow(-1);
  list.forEach((temperature, index) => {
    const row = body.rows[index] || body.insertRow();
    while (row.cells.length < 2) row.insertCell();
    row.className = temperature.quality;
    row.cells[0].textContent = temperature.name;
    row.cells[1].textContent = temperature.degc === null ? temperature.reason : `${fixed(temperature.degc, 2)} °C`;
  });
  if (list.length === 0 && body.rows.length === 0) make("td", "", body.insertRow()).textContent = "no thermometer is configured";
}

function showError(state) {
  // On a real machine nobody knows what is left: what the model corrects, and what of it is not applied.
  const before = state.true_error_um || state.error_um;
  const axes = Object.keys(state.correction_um);
  const after = state.residual_um || axes.map((name) => (state.wanted_um[name] || 0) - state.correction_um[name]);
  const now = state.uptime_s;
  if (trend.before.length && trend.before[trend.before.length - 1][0] > now) trend.before = trend.after = [];
  for (const [name, value] of [["before", length(before)], ["after", length(after)]]) {
    trend[name] = trend[name].filter((point) => point[0] > now - SPAN_S).concat([[now, value]]);
  }
  drawLines(element("trend"), now, SPAN_S, [
    { points: trend.before, colour: "#b3261e" },
    { points: trend.after, colour: "#0b6e3a" },
  ]);
  const mean = (points) => points.reduce((sum, point) => sum + point[1], 0) / points.length;
  const [b, a] = [mean(trend.before), mean(trend.after)];
  const what = state.residual_um ? "" : " (of the model; what is really left needs a measurement)";
  text("reduction", `now ${fixed(length(before), 1)} → ${fixed(length(after), 1)} µm; mean of what is shown ${fixed(b, 1)} → ${fixed(a, 1)} µm, ${fixed(100 * (a / Math.max(b, 1e-9) - 1), 0)} %${what}`);
}

function showCycle(cycle) {
  drawBars(element("histogram"), cycle.histogram_us);
  const late = cycle.overruns === 1 ? "1 overrun" : `${cycle.overruns} overruns`;
  text("cycle", `period ${cycle.period_us / 1000} ms, half within ${fixed(cycle.p50_us, 0)} µs, 99 % within ${fixed(cycle.p99_us, 0)} µs, own work 99 % within ${fixed(cycle.own.p99_us, 1)} µs; ${cycle.count} cycles, ${late}`);
}

function showMap() {
  if (!map || !map.error_um || !current) return;
  const here = map.axes.map(({ name, travel }) => (current.positions_mm[name] - travel[0]) / (travel[1] - travel[0]));
  const largest = drawMap(element("map"), map.error_um, here.some(Number.isNaN) ? null : here);
  text("map-title", `over ${map.axes[0].name} and ${map.axes[1].name}, the others as they stand`);
  text("map-scale", `white 0, dark ${largest} µm; the cross is where the machine stands`);
}

function showButtons(state) {
  const may = token() !== "";
  element("arm").disabled = !may || state.armed || state.state === "faulted";
  element("disarm").disabled = !may || !state.armed;
  element("acknowledge").disabled = !may || state.state !== "faulted";
  element("reload").disabled = !may;
}

function show(state) {
  current = state;
  lastHeard = Date.now();
  element("banner").dataset.state = state.state;
  text("state", state.state.replace("-", " "));
  text("reasons", state.reasons.join(" · "));
  text("machine-name", state.machine.name);
  text("controller", state.controller && !state.simulated ? state.controller.device : "");
  element("simulated").hidden = !state.simulated;
  document.title = `${state.state} – ${state.machine.name}`;
  showAxes(state);
  showTemperatures(state.temperatures);
  showError(state);
  showCycle(state.cycle);
  showMap();
  showButtons(state);
}

function lost(why) {
  element("banner").dataset.state = "lost";
  text("state", "no connection");
  text("reasons", why);
  for (const button of document.querySelectorAll("#operate > button")) button.disabled = true;
}

/** The event stream, by fetch: an EventSource cannot send the token. */
async function listen() {
  for (;;) {
    try {
      const response = await fetch("/api/events", { headers: headers(), cache: "no-store" });
      if (response.status === 401 || response.status === 403) {
        lost("a token is needed to look: enter it below");
      } else if (!response.ok) {
        lost(`the gateway answers ${response.status}`);
      } else {
        await follow(response.body.getReader());
      }
    } catch {
      lost("the gateway does not answer; what the machine does now is not known here");
    }
    await new Promise((done) => setTimeout(done, 1000));
  }
}

async function follow(reader) {
  const decoder = new TextDecoder();
  let rest = "";
  for (;;) {
    const { value, done } = await reader.read();
    if (done) return lost("the gateway ended the connection");
    rest += decoder.decode(value, { stream: true });
    const events = rest.split("\n\n");
    rest = events.pop();
    for (const event of events.slice(-1)) {
      const data = event.split("\n").filter((l) => l.startsWith("data:")).map((l) => l.slice(5)).join("\n");
      if (data) show(JSON.parse(data));
    }
  }
}

async function refreshMap() {
  try {
    const response = await fetch("/api/map", { headers: headers(), cache: "no-store" });
    if (response.ok) map = await response.json();
  } catch {
    // The stream tells that the gateway is gone.
  }
  showMap();
}

async function operate(what, body) {
  text("answer", `${what} …`);
  try {
    const response = await fetch(`/api/${what}`, { method: "POST", headers: headers(), body });
    const answer = await response.json();
    if (response.status === 409 && answer.model) return confirmModel(what, answer);
    const said = answer.error || (answer.reasons || []).join(", ") || answer.state || "done";
    text("answer", response.ok ? `${what}: ${answer.state || "done"}` : `${what} refused: ${said}`);
  } catch {
    text("answer", `${what}: the gateway does not answer`);
  }
}

function confirmModel(what, answer) {
  text("answer", `${what} refused: the machine file moves a corner by ${answer.worst_corner_um === null ? "an unknown distance" : `${fixed(answer.worst_corner_um, 1)} µm`}`);
  const question = `The new machine file moves a corner of the work space by ${fixed(answer.worst_corner_um, 1)} µm (allowed without asking: ${answer.confirm_um} µm).\n\nUse it?\n${answer.model}`;
  if (window.confirm(question)) operate(what, JSON.stringify({ confirm: answer.model }));
}

/** A press counts after a second: a glove or a tool that touches the glass does nothing. */
function guard(button, act) {
  let timer = null;
  const begin = (event) => {
    if (button.disabled || (event.type === "keydown" && event.key !== "Enter" && event.key !== " ") || event.repeat) return;
    event.preventDefault();
    button.classList.add("holding");
    timer = timer || setTimeout(() => { end(); act(); }, HOLD_MS);
  };
  const end = () => {
    clearTimeout(timer);
    timer = null;
    button.classList.remove("holding");
  };
  for (const name of ["pointerdown", "keydown"]) button.addEventListener(name, begin);
  for (const name of ["pointerup", "pointerleave", "pointercancel", "keyup", "blur"]) button.addEventListener(name, end);
  button.addEventListener("contextmenu", (event) => event.preventDefault());
}

for (const button of document.querySelectorAll("button[data-hold]")) guard(button, () => operate(button.id));
element("disarm").addEventListener("click", () => operate("disarm"));
element("token-form").addEventListener("submit", (event) => {
  event.preventDefault();
  sessionStorage.setItem("token", element("token").value.trim());
  element("token").value = "";
  text("answer", token() ? "the token is kept until this tab is closed" : "no token");
  if (current) showButtons(current);
});
setInterval(() => {
  if (lastHeard && Date.now() - lastHeard > LOST_AFTER_MS) lost("nothing was heard for two seconds; what the machine does now is not known here");
}, 500);
setInterval(refreshMap, 2000);
refreshMap();
listen();

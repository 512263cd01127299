"use strict";
/* global drawBars, drawMap, clearMap, drawScale, element, token, headers, fixed, text, answerBriefly, make, movesOf, guard, showHistory, addState, endHistory, refreshLog */

const LOST_AFTER_MS = 2000, SILENT_MS = 2000, POLL_MS = 3000, LOG_AFTER_MS = 300;
const LETTERS = "XYZABCUVW";
let map = null, lastHeard = 0, current = null;
/** Whether the token that was entered may operate: the gateway said so. */
let mayOperate = false;

const inOrder = (names) => [...names].sort((a, b) => LETTERS.indexOf(a) - LETTERS.indexOf(b));
/** A change, with its sign also where it is positive. */
const signed = (value, digits) => (value > 0 ? "+" : "") + fixed(value, digits);

const KINDS = [
  { unit: "mm", small: "um", digits: 3 },
  { unit: "deg", small: "urad", digits: 4 },
];

/** What the last test shift showed of the position of an axis. */
const SHOWN = {
  contained: "verified: the position includes the correction",
  "not-contained": "verified: the position does not include the correction",
  "not-proven": "unverified: the position may already include the correction",
};

function showAxes(state) {
  const list = element("axes");
  const names = inOrder(state.machine.axes);
  const isStale = state.reasons.some((reason) => reason === "positions stale" || reason === "positions lost");
  for (const card of [...list.children]) if (!names.includes(card.dataset.axis)) card.remove();
  for (const name of names) {
    const { unit, small, digits } = KINDS["ABC".includes(name) ? 1 : 0];
    let card = list.querySelector(`[data-axis="${name}"]`);
    if (!card) {
      card = make("div", "axis", list);
      card.dataset.axis = name;
      make("div", "name", card).textContent = name;
      for (const [kind, shown] of [["position", unit], ["correction", small.replace("u", "µ")]]) {
        const cell = make("div", kind, card);
        if (kind === "correction") make("small", "label", cell).textContent = "correction ";
        make("span", "value", cell);
        make("small", "", cell).textContent = ` ${shown}`;
      }
      make("div", "shown", card);
    }
    const position = (state[`positions_${unit}`] || {})[name];
    const correction = (state[`correction_${small}`] || {})[name];
    put(card.querySelector(".position"), position === undefined || isStale ? null : fixed(position, digits));
    put(card.querySelector(".correction"), state.correction_known && correction !== undefined ? signed(correction, 1) : null);
    const proven = state.proven[name];
    const shown = card.querySelector(".shown");
    shown.textContent = SHOWN[proven] || "";
    shown.classList.toggle("not-proven", proven === "not-proven");
  }
}

/** A value with its unit, or the word that it is not known. */
function put(cell, value) {
  cell.querySelector(".value").textContent = value === null ? "unknown" : value;
  cell.classList.toggle("unknown", value === null);
}

/** "12 ms", "1.3 s", "13 s". */
const ago = (ms) => (ms < 1000 ? `${fixed(ms, 0)} ms` : `${fixed(ms / 1000, ms < 10000 ? 1 : 0)} s`);

/** How each controller is: text and whether it deserves attention. */
function healthOf(path, state) {
  const { answered_ms: answered, positions_ms: positions, confirmed_ms: confirmed, holds_correction: holds } = path;
  const never = answered === null;
  const role = !path.active ? "standby" : state === "compensating" ? "corrects" : "in use";
  const unknown = `applied correction unknown, ${confirmed === null ? "never confirmed" : `last confirmed ${ago(confirmed)} ago`}`;
  return [
    ["device", `${path.number + 1} ${role}: ${path.device}`],
    [path.scheme === "barrier" ? "" : "bad", path.scheme === "barrier" ? "barrier in the control" : path.scheme === "no-read-back" ? "no barrier, its correction cannot be read back" : "no barrier"],
    [never || answered > SILENT_MS ? "bad" : "ages", never ? "has never answered" : `answered ${ago(answered)} ago`],
    ["ages", `positions ${positions === null ? "unknown" : `${ago(positions)} old`}, correction ${confirmed === null ? "never confirmed" : `confirmed ${ago(confirmed)} ago`}`],
    [holds === null || (holds && !path.active) ? "bad" : "ages", holds === null ? unknown : `holds ${holds ? "a" : "no"} correction`],
    ["ages", path.reasons.filter((reason) => reason !== "no barrier").join(", ")],
  ];
}

function showPaths({ controllers: paths, state }) {
  const list = element("paths");
  while (list.children.length > paths.length) list.lastChild.remove();
  paths.forEach((path, index) => {
    const item = list.children[index] || make("li", "", list);
    healthOf(path, state).forEach(([kind, said], line) => {
      const row = item.children[line] || make("div", "", item);
      row.className = kind;
      row.textContent = said;
    });
  });
  element("no-barrier").hidden = !paths.some((path) => path.active && path.scheme !== "barrier");
}

/** How it stands with the centre of the fleet: lines of a kind and a text. */
function standingOf(fleet) {
  const inForce = fleet.version === 0 ? "the configured machine file is active, none of the centre" : `version ${fleet.version} of the machine file is active`;
  const lines = [["", `${fleet.machine} of ${fleet.site}`], fleet.connected ? ["", "connected"] : ["bad", "not connected: it corrects alone"], ["", inForce]];
  if (!fleet.enabled) lines.push(["bad", "the centre does not allow correcting"]);
  if (fleet.outcome !== null) lines.push(["", `version ${fleet.accepted}: ${fleet.outcome}`]);
  if (fleet.trouble !== null) lines.push(["bad", `retrying: ${fleet.trouble}`]);
  if (fleet.refused !== null) lines.push(["bad", `not accepted: ${fleet.refused}`]);
  if (fleet.waiting !== null) lines.push(["", `messages to the centre wait: ${fleet.waiting}`]);
  if (fleet.dropped > 0) lines.push(["bad", `${fleet.dropped} messages were dropped for lack of space`]);
  return lines;
}

function showFleet(fleet) {
  element("fleet-panel").hidden = !fleet;
  const list = element("fleet"), lines = fleet ? standingOf(fleet) : [];
  while (list.children.length > lines.length) list.lastChild.remove();
  lines.forEach(([kind, said], index) => {
    const item = list.children[index] || make("li", "", list);
    item.className = kind;
    item.textContent = said;
  });
}

function showTemperatures(list) {
  const body = element("temperatures").tBodies[0];
  while (body.rows.length > list.length) body.deleteRow(-1);
  list.forEach((temperature, index) => {
    const row = body.rows[index] || body.insertRow();
    while (row.cells.length < 2) row.insertCell();
    row.className = temperature.quality;
    row.cells[0].textContent = temperature.name;
    row.cells[1].textContent = temperature.degc === null ? temperature.reason : `${fixed(temperature.degc, 2)} °C${temperature.reason ? `, ${temperature.reason}` : ""}`;
  });
  if (list.length === 0 && body.rows.length === 0) make("td", "", body.insertRow()).textContent = "no thermometer is configured";
}

function showCycle(cycle) {
  drawBars(element("histogram"), cycle.histogram_us);
  const late = cycle.overruns === 1 ? "1 overrun" : `${cycle.overruns} overruns`;
  const took = (us) => us < 1000 ? `${fixed(us, 0)} µs` : `${fixed(us / 1000, 1)} ms`;
  text("cycle", `period ${cycle.period_us / 1000} ms, p50 ${took(cycle.p50_us)}, p99 ${took(cycle.p99_us)}, compute time p99 ${fixed(cycle.own.p99_us, 1)} µs; ${cycle.count} cycles, ${late}`);
}

function showMap() {
  if (!map || !current) return;
  if (map.axes.length < 2) {
    // The panel stays where it was, so that nothing on the page jumps.
    clearMap(element("map"));
    clearMap(element("map-bar"));
    text("map-title", "");
    text("map-scale", "unknown: a position is missing");
    return;
  }
  const isLost = element("banner").dataset.state === "lost";
  const here = map.axes.map(({ name }) => (isLost ? undefined : current.positions_mm[name]));
  const isHere = here.every(Number.isFinite);
  const largest = drawMap(element("map"), map.error_um, map.axes, isHere ? here : null);
  drawScale(element("map-bar"), largest);
  const others = inOrder(current.machine.axes).filter((name) => !map.axes.some((axis) => axis.name === name));
  const stand = others.length ? `, at the present position of ${others.join(", ").replace(/, (?=[^,]*$)/, " and ")}` : "";
  text("map-title", `over ${map.axes[0].name} and ${map.axes[1].name}${stand}`);
  text("map-scale", `without correction, by the model; ${isHere ? "the cross marks the present position" : "the present position is unknown"}`);
}

function showButtons(state) {
  const isOpen = Boolean(state.demo && state.demo.token);
  for (const part of document.querySelectorAll("#acknowledge, #operate > button")) part.hidden = !state.operable;
  element("token-form").hidden = !state.operable || isOpen;
  element("not-operable").hidden = state.operable;
  const may = mayOperate;
  const jumped = state.temperatures.some((temperature) => temperature.reason === "jumped");
  element("arm").disabled = !may || state.armed || state.state === "faulted";
  // The gateway knows what waits to be acknowledged besides, and answers where nothing does.
  element("acknowledge").disabled = !may || (state.state === "compensating" && !jumped);
  element("reload").disabled = !may;
  showDemo(state.demo, may);
}

/** What can be done to the simulated machine: words while it is off, and while it is on. */
const DISTURBANCES = { cable: ["Pull cable", "Plug cable in"], freeze: ["Freeze position", "Release position"], heat: ["Heat spindle", "Cool spindle"] };

function showDemo(demo, may) {
  element("demo").hidden = !demo;
  if (!demo) return;
  for (const button of document.querySelectorAll("#demo button")) {
    const isOn = demo.disturbances.includes(button.value);
    button.disabled = !may;
    button.ariaPressed = String(isOn);
    button.firstChild.textContent = DISTURBANCES[button.value][isOn ? 1 : 0];
  }
}

/** The first is the cause or the action to take, on a separate line. */
function showReasons([cause, ...further]) {
  text("cause", cause || "");
  text("further", further.join(" · "));
}

const degradedOf = (state) => state.reasons.find((reason) => reason.startsWith("degraded"));

function show(state) {
  const before = current;
  current = state;
  lastHeard = Date.now();
  // The built-in simulation hands out its token, which is no secret.
  if (state.demo && state.demo.token && !token()) {
    sessionStorage.setItem("token", state.demo.token);
    checkToken();
  }
  if (!before || before.state !== state.state || degradedOf(before) !== degradedOf(state)) setTimeout(refreshLog, LOG_AFTER_MS);
  element("banner").dataset.state = state.state;
  const gone = state.controllers.find((path) => path.active && path.answered_ms !== null && path.holds_correction === null);
  element("banner").classList.toggle("gone", Boolean(gone));
  text("state", state.state.replace("-", " "));
  // A missing barrier is shown on a separate line.
  const reasons = state.reasons.filter((reason) => reason !== "no barrier");
  if (gone) reasons.unshift(`check the cable and the control: the applied correction is unknown, last confirmed ${gone.confirmed_ms === null ? "never" : `${ago(gone.confirmed_ms)} ago`}`);
  showReasons(reasons);
  if (before && before.state !== state.state) text("advice", "");
  text("machine-name", state.machine.name);
  text("controller", state.controller && !state.simulated ? `${state.controller.device}` : "");
  element("simulated").hidden = !state.simulated;
  document.title = `${state.state} – ${state.machine.name}`;
  showAxes(state);
  showPaths(state);
  showFleet(state.fleet);
  showTemperatures(state.temperatures);
  addState(state);
  showCycle(state.cycle);
  showMap();
  showButtons(state);
}

/** Nothing is known any more: no number of before stays on the page. */
function lost(why) {
  if (element("banner").dataset.state !== "lost") text("answer", "");
  text("advice", "");
  element("banner").dataset.state = "lost";
  element("banner").classList.remove("gone");
  text("state", "no connection");
  showReasons([why]);
  for (const cell of document.querySelectorAll("#axes .position, #axes .correction")) put(cell, null);
  for (const shown of document.querySelectorAll("#axes .shown")) shown.textContent = "";
  for (const row of document.querySelectorAll("#paths li :not(.device)")) row.textContent = "";
  for (const device of document.querySelectorAll("#paths .device")) {
    device.textContent = device.textContent.replace(/ (corrects|in use|standby): /, ": ");
    device.nextSibling.textContent = "unknown";
  }
  for (const line of document.querySelectorAll("#fleet li")) line.textContent = "";
  for (const cell of document.querySelectorAll("#temperatures td:last-child")) cell.textContent = "unknown";
  endHistory();
  text("cycle", "unknown");
  for (const button of document.querySelectorAll("button[id]:not(#disarm)")) button.disabled = true;
  showMap();
}

/** Asks the gateway what the token allows. */
async function checkToken() {
  mayOperate = false;
  if (current) showButtons(current);
  if (!token()) return text("answer", "no token");
  try {
    const response = await fetch("/api/token", { headers: headers(), cache: "no-store" });
    const answer = await response.json();
    if (response.ok) {
      mayOperate = answer.role === "operate" || answer.role === "engineer";
      if (!(current && current.demo && current.demo.token)) text("answer", `token of ${answer.name}, kept until this tab is closed${mayOperate ? "" : ": it permits reading, not operating"}`);
    } else {
      sessionStorage.removeItem("token");
      text("answer", `this token is refused: ${answer.error}`);
    }
  } catch {
    text("answer", "the token could not be checked: the gateway does not answer");
  }
  if (current && element("banner").dataset.state !== "lost") showButtons(current);
}

/** The event stream, by fetch: an EventSource cannot send the token. */
async function listen() {
  for (;;) {
    try {
      const response = await fetch("/api/events", { headers: headers(), cache: "no-store" });
      if (response.status === 401 || response.status === 403) {
        lost("reading needs a token: enter it below");
      } else if (response.status === 503) {
        await poll();
      } else if (!response.ok) {
        lost(`the gateway answers ${response.status}`);
      } else {
        if (current) showHistory();
        await follow(response.body.getReader());
      }
    } catch {
      lost("the gateway does not answer; the state of the machine is unknown here");
    }
    await new Promise((done) => setTimeout(done, 1000));
  }
}

/** As many event streams as there may be are open: asks for the state until one has ended. */
async function poll() {
  const end = Date.now() + POLL_MS;
  while (Date.now() < end) {
    const response = await fetch("/api/state", { headers: headers(), cache: "no-store" });
    if (!response.ok) return lost(`the gateway answers ${response.status}`);
    show(await response.json());
    await new Promise((done) => setTimeout(done, 500));
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
    // The stream reports that the gateway is gone.
  }
  showMap();
}

async function operate(what, body) {
  text("answer", `${what} …`);
  try {
    const send = (headers) => fetch(`/api/${what}`, { method: "POST", headers, body });
    let response = await send(headers());
    // On the gateway's own computer disarming needs no token, also where the one that was entered does not allow it.
    if (what === "disarm" && !response.ok && token()) {
      const without = await send({});
      if (without.ok) response = without;
    }
    const answer = await response.json();
    if (response.status === 409 && answer.model) return confirmModel(what, answer);
    const said = [answer.error, (answer.reasons || []).join(", ")].filter(Boolean).join(": ") || answer.state || "done";
    if (!response.ok) return text("answer", `${what} refused: ${said}`);
    setTimeout(refreshLog, LOG_AFTER_MS);
    // The button shows a disturbance, and the banner the state.
    if (what === "disturb") return text("answer", "");
    answerBriefly(`${what}: ${answer.note || "accepted"}`);
  } catch {
    text("answer", `${what}: the gateway does not answer`);
  }
}

/** What a change does, in lines: signs of another machine, how far it moves the correction, and the limits that change. */
function changesOf(answer) {
  const lines = [...(answer.differences || []), ...movesOf(answer)];
  const value = (number) => (number === null ? "none" : number);
  for (const [key, [from, to]] of Object.entries(answer.limits || {})) lines.push(`${key}: ${value(from)} → ${value(to)}`);
  return lines;
}

function confirmModel(what, answer) {
  const changes = changesOf(answer);
  text("answer", `${what} must be confirmed. ${changes.join(" ")}`);
  const question = `${changes.join("\n")}\n\nUse it?\n${answer.model}`;
  if (window.confirm(question)) operate(what, JSON.stringify({ confirm: answer.model }));
}

for (const button of document.querySelectorAll("button[data-hold]")) guard(button, () => operate(button.id));
element("disarm").addEventListener("click", () => operate("disarm"));
for (const button of document.querySelectorAll("#demo button")) {
  button.addEventListener("click", () => operate("disturb", JSON.stringify({ what: button.value, on: button.ariaPressed !== "true" })));
}
if (token()) checkToken();
setInterval(() => {
  if (lastHeard && Date.now() - lastHeard > LOST_AFTER_MS) lost("nothing received for two seconds; the state of the machine is unknown here");
}, 500);
setInterval(refreshMap, 2000);
refreshMap();
showHistory();
listen();

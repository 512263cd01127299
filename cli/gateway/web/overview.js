"use strict";
// All machines of one gateway at a glance. Nothing can be operated from here.

const EVERY_MS = 1000;
const LOST_AFTER_MS = 4000;
const element = (id) => document.getElementById(id);
const token = () => sessionStorage.getItem("token") || "";
let lastHeard = 0;

/** The words of a state, from what wants a person most to what wants one least. */
const STATES = [
  ["failed", "does not run", "do not run"],
  ["unknown", "unknown", "unknown"],
  ["faulted", "faulted", "faulted"],
  ["holding", "holding", "holding"],
  ["starting", "starting", "starting"],
  ["ramping-out", "ramping out", "ramping out"],
  ["arming", "arming", "arming"],
  ["disarmed", "disarmed", "disarmed"],
  ["ended", "ended", "ended"],
  ["compensating", "compensating", "compensating"],
];
const WORDS = new Map(STATES.map(([state, word]) => [state, word]));

/** The state of a machine, or how far it is where it does not run. */
const stateOf = (machine) => (machine.phase === "running" ? machine.state : machine.phase);

/** A dashboard that listens on every address is reached by the one by which this page was. */
function link(url) {
  if (!url) return null;
  const to = new URL(url);
  if (["0.0.0.0", "[::]"].includes(to.hostname)) to.hostname = location.hostname;
  return to.href;
}

/** "X −12.0  Y 3.0 µm". */
function values(byAxis, digits, unit) {
  const words = Object.entries(byAxis).map(([axis, value]) => `${axis}\u00a0${value.toFixed(digits).replace("-", "\u2212")}`);
  return words.length ? `${words.join(" \u2002")}\u00a0${unit}` : "";
}

function correction(machine) {
  if (machine.phase !== "running") return "";
  if (!machine.correction_known) return "correction unknown";
  return [values(machine.correction_um, 1, "µm"), values(machine.correction_urad, 0, "µrad")].filter(Boolean).join("\n");
}

function age(ms) {
  if (ms === null) return "";
  return ms < 10000 ? `${(Math.round(ms / 10) * 10).toFixed(0)} ms ago` : `${(ms / 1000).toFixed(0)} s ago`;
}

function why(machine) {
  if (machine.phase === "failed") {
    return `${machine.trouble}${machine.starts_again ? "; it is tried again every 10 s" : "; it is started again with the next reload"}`;
  }
  return machine.reasons.join(", ");
}

function show(card, machine) {
  const put = (name, text) => {
    const part = card.querySelector(name);
    if (part.textContent !== text) part.textContent = text;
    return part;
  };
  const state = stateOf(machine);
  card.dataset.state = state;
  const name = put(".name", machine.name);
  const to = link(machine.dashboard);
  if (to) name.href = to;
  else name.removeAttribute("href");
  put(".state", WORDS.get(state) || state);
  put(".why", why(machine)).title = why(machine);
  put(".correction", correction(machine)).classList.toggle("unknown", machine.phase === "running" && !machine.correction_known);
  put(".file", [machine.machine, machine.simulated ? "simulated" : null].filter(Boolean).join(", "));
  put(".age", age(machine.age_ms));
}

function showAll(machines) {
  const list = element("machines");
  while (list.children.length > machines.length) list.lastElementChild.remove();
  while (list.children.length < machines.length) list.append(element("card").content.cloneNode(true));
  machines.forEach((machine, index) => show(list.children[index], machine));
  const counts = new Map();
  for (const machine of machines) counts.set(stateOf(machine), (counts.get(stateOf(machine)) || 0) + 1);
  const worst = STATES.find(([state]) => counts.has(state));
  element("banner").dataset.state = worst ? (worst[0] === "failed" ? "faulted" : worst[0]) : "unknown";
  element("summary").textContent = machines.length === 1 ? "1 machine" : `${machines.length} machines`;
  const words = STATES.filter(([state]) => counts.has(state));
  element("counts").textContent = words.map(([state, one, many]) => `${counts.get(state)} ${counts.get(state) === 1 ? one : many}`).join(", ");
}

/** What is not heard any more is not known here. */
function lost(what) {
  element("banner").dataset.state = "lost";
  element("summary").textContent = "no connection";
  element("counts").textContent = what;
  for (const card of element("machines").children) {
    card.dataset.state = "unknown";
    card.querySelector(".state").textContent = "unknown";
    for (const name of [".why", ".correction", ".age"]) card.querySelector(name).textContent = "";
  }
}

async function refresh() {
  try {
    const headers = token() ? { Authorization: `Bearer ${token()}` } : {};
    const response = await fetch("/api/machines", { headers, cache: "no-store", signal: AbortSignal.timeout(LOST_AFTER_MS) });
    if (response.ok) {
      lastHeard = Date.now();
      element("token-form").hidden = true;
      showAll((await response.json()).machines);
    } else {
      const { error } = await response.json();
      element("token-form").hidden = response.status !== 401 && response.status !== 429;
      element("answer").textContent = token() || response.status !== 401 ? error : "";
      lost(response.status === 401 ? "a token is needed to see the machines" : error);
    }
  } catch (failure) {
    if (Date.now() - lastHeard > LOST_AFTER_MS) lost("the gateway is not heard; what the machines do now is not known here");
  }
  setTimeout(refresh, EVERY_MS);
}

element("token-form").addEventListener("submit", (event) => {
  event.preventDefault();
  sessionStorage.setItem("token", element("token").value.trim());
  element("token").value = "";
});
refresh();

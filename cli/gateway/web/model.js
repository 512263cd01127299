"use strict";
/* global diagonalOf, leftOf, ends, element, token, headers, text, make, movesOf, guard */

const LOOK_MS = 1000;
let isEngineer = false, mayOperate = false, state = null, candidate = null;
/** What a person has to confirm: the request that is repeated with the hash. */
let pending = null;
let drawn = "", busy = false, wantsResult = false;

const short = (hash) => hash.replace("sha256:", "").slice(0, 12);
const when = (time) => time.replace("T", " ").slice(0, 19);
const size = (bytes) => (bytes < 1024 ? `${bytes} B` : bytes < 1048576 ? `${(bytes / 1024).toFixed(0)} KiB` : `${(bytes / 1048576).toFixed(1)} MiB`);
const SOURCES = { file: "machine file", upload: "upload", centre: "centre" };
/** What becomes of a configured file that is not active. */
const DIFFERS = {
  file: "It has been changed since it was read: “Reload” on the dashboard takes it.",
  upload: "It is not used until you press “Use the configured file” below.",
  centre: "It is not used: the centre decides which model is active.",
};
const OUTCOMES = { "in-force": "activated", refused: "refused", "must-be-confirmed": "not confirmed" };

async function ask(path, body) {
  const response = await fetch(path, { method: body === undefined ? "GET" : "POST", headers: headers(), cache: "no-store", body: body === undefined ? undefined : JSON.stringify(body) });
  let answer = {};
  try { answer = await response.json(); } catch { answer = { error: `the gateway answers ${response.status}` }; }
  return { ok: response.ok, status: response.status, answer };
}

function pairs(list, rows) {
  list.replaceChildren();
  for (const [key, value] of rows) {
    make("dt", "", list, key);
    make("dd", "", list, value);
  }
}

function showState() {
  const from = state.put_in_force;
  const rows = [["Name", state.name || "–"], ["From", SOURCES[state.from]]];
  if (state.from === "upload" && from) rows.push(["Activated", `by ${from.who}, ${when(from.time)} UTC, ${from.file}`]);
  rows.push(["Hash", state.hash]);
  rows.push(["Configured", state.configured.file]);
  pairs(element("in-force"), rows);
  element("trouble").hidden = !state.trouble;
  text("trouble", state.trouble || "");
  element("differs").hidden = !state.configured.differs && !state.configured.error;
  text("differs", state.configured.error
    ? `The configured machine file cannot be read: ${state.configured.error}`
    : `The configured machine file, as it is on disk now, differs from the active model. ${DIFFERS[state.from]}`);
  element("no-files").hidden = !state.no_files;
  text("no-files", state.no_files ? `No files are taken here: ${state.no_files}.` : "");
  const body = element("history").tBodies[0];
  body.replaceChildren();
  const now = state.history.find((entry) => entry.outcome === "in-force" && entry.hash === state.hash);
  for (const entry of state.history) {
    const row = body.insertRow();
    make("td", "", row, when(entry.time));
    make("td", "", row, `${entry.name || "–"} ${short(entry.hash)}`).title = entry.hash;
    make("td", "", row, entry.from === "file" ? SOURCES.file : `${SOURCES[entry.from]}: ${entry.file}`).title = entry.file;
    make("td", "", row, entry.who);
    make("td", entry.outcome === "refused" ? "refused" : "", row, OUTCOMES[entry.outcome]);
    const moves = [[entry.worst_um, "µm"], [entry.worst_urad, "µrad"]].filter(([value]) => value !== null);
    make("td", "", row, moves.map(([value, unit]) => `${value.toFixed(1)} ${unit}`).join(", "));
    const cell = make("td", "", row);
    if (entry.outcome === "in-force" && entry.hash !== state.hash && state.kept.includes(entry.hash)) {
      const button = make("button", "plain", cell, "Back to this");
      make("small", "", button, "hold for 1 s");
      button.disabled = !isEngineer;
      guard(button, () => putInForce("back", { hash: entry.hash }));
    } else if (entry === now) {
      cell.textContent = "active";
    }
    // A reason is long: it has the whole width below.
    if (entry.why) {
      row.className = "with-why";
      const below = body.insertRow();
      below.className = "why";
      make("td", "refused", below, entry.why).colSpan = 7;
    }
  }
}

function list(id, lines) {
  const target = element(id);
  target.replaceChildren();
  for (const line of lines) make("li", "", target, line);
}

function showCandidate() {
  const step = candidate ? candidate.step : null;
  const takesFiles = isEngineer && !(state && state.no_files);
  text("candidate", !candidate && state && state.no_files ? "" : !candidate ? "Send a machine file."
    : `${candidate.file.name}, ${size(candidate.file.bytes)}, from ${candidate.who}, ${when(candidate.since)} UTC${step === "working" ? "; it is being compared with the active model …" : ""}`);
  element("machine-file").disabled = !takesFiles || Boolean(candidate) || busy;
  element("choose").hidden = Boolean(candidate);
  const error = (candidate && candidate.error) || "";
  element("error").hidden = !error;
  text("error", error);
  element("discard").hidden = !candidate;
  element("discard").disabled = !isEngineer;
  const result = candidate && candidate.result, refusal = (result && result.refusal) || "";
  element("activate").disabled = !isEngineer || step !== "ready" || Boolean(refusal);
  element("refusal").hidden = !refusal;
  text("refusal", refusal);
  element("configured").disabled = !takesFiles || !state || !(state.from === "upload" || state.configured.differs) || state.from === "centre";
  element("result-panel").hidden = !result;
  // A button that is held must not be drawn anew.
  const now = JSON.stringify(candidate && [candidate.id, result]);
  if (now === drawn) return;
  drawn = now;
  if (result) showResult(result);
  if (result && wantsResult) element("result-panel").scrollIntoView();
  wantsResult = wantsResult && !result;
}

function showResult(result) {
  text("result-name", result.name);
  text("result-hash", result.hash);
  list("warnings", result.warnings);
  drawPlots(result);
}

/** Diagonals in the width of the window. */
function drawPlots(result) {
  const range = ends(result.diagonals.flatMap((diagonal) => leftOf(diagonal).flatMap((p) => p.slice(1))));
  element("diagonals-part").hidden = result.diagonals.length === 0;
  element("diagonals").replaceChildren(...result.diagonals.map((diagonal) => diagonalOf(diagonal, range)));
}

function question(answer, repeat) {
  pending = repeat;
  element("confirm-panel").hidden = !answer;
  if (!answer) return;
  list("confirm-lines", [...(answer.differences || []), ...movesOf(answer)]);
  text("confirm-hash", answer.model);
  pending.hash = answer.model;
  element("confirm-panel").scrollIntoView({ block: "center" });
}

/** Activates a model; a large change of the correction, or signs of another machine, must be confirmed first. */
async function putInForce(what, body) {
  text("answer", "comparing with the active model …");
  try {
    const { ok, status, answer } = await ask(`/api/model/${what}`, body);
    if (status === 409 && answer.model) {
      text("answer", `${(answer.differences || []).length ? "This may be a model of another machine" : "This changes the correction by a large amount"} and must be confirmed.`);
      return question(answer, { what, body });
    }
    question(null, null);
    text("answer", ok ? `active: ${short(answer.model)}${answer.unchanged ? ", as before" : ""}${answer.note ? `. ${answer.note}` : ""}` : `not activated: ${answer.error || (answer.reasons || []).join(", ")}`);
  } catch {
    text("answer", "the gateway does not answer: the history shows whether it is active");
  }
  look();
}

async function upload(input) {
  busy = true;
  const [file] = input.files;
  try {
    text("answer", `sending ${file.name} …`);
    const response = await fetch(`/api/model/upload?kind=machine&name=${encodeURIComponent(file.name)}`, { method: "POST", headers: headers(), body: file });
    const answer = await response.json();
    wantsResult = response.ok;
    text("answer", response.ok ? "" : `${file.name}: ${answer.error}`);
  } catch {
    text("answer", "the file was cut: the gateway does not answer, or ended the connection");
  } finally {
    input.value = "";
    busy = false;
    look();
  }
}

async function post(what, body) {
  try {
    const { ok, answer } = await ask(`/api/model/${what}`, body);
    text("answer", ok ? "" : answer.error);
  } catch {
    text("answer", "the gateway does not answer");
  }
  await look();
}

async function look() {
  try {
    const [machine, model] = await Promise.all([ask("/api/state"), ask("/api/model")]);
    if (!machine.ok) {
      text("state", "unknown");
      element("state").dataset.state = "unknown";
      text("answer", machine.answer.error);
      return;
    }
    text("machine-name", machine.answer.machine.name);
    text("state", machine.answer.state.replace("-", " "));
    element("state").dataset.state = machine.answer.state;
    document.title = `Model – ${machine.answer.machine.name}`;
    const before = JSON.stringify(state);
    state = model.answer;
    // It may be gone by now, which the next look shows.
    const made = state.candidate ? await ask("/api/model/candidate") : { ok: false };
    candidate = made.ok ? made.answer : null;
    // A button that is being held must not be drawn anew under the finger.
    if (JSON.stringify(state) !== before) showState();
    showCandidate();
  } catch {
    text("state", "no connection");
    element("state").dataset.state = "unknown";
  }
}

async function checkToken() {
  [isEngineer, mayOperate] = [false, false];
  if (token()) {
    const { ok, answer } = await ask("/api/token");
    if (!ok) sessionStorage.removeItem("token");
    isEngineer = ok && answer.role === "engineer";
    mayOperate = ok && (answer.role === "engineer" || answer.role === "operate");
    text("role", !ok ? `this token is refused: ${answer.error}` : `token of ${answer.name}${isEngineer ? "" : `, role ${answer.role}: a new model needs a token of the role engineer`}`);
  } else {
    text("role", "a new model needs a token of the role engineer");
  }
  state = null;
  await look();
}

element("disarm").addEventListener("click", async () => {
  let { ok, answer } = await ask("/api/disarm", {});
  // On the gateway's own computer disarming needs no token, also where the one that was entered does not allow it.
  if (!ok && token()) ok = (await fetch("/api/disarm", { method: "POST" })).ok;
  text("answer", ok ? "" : `disarm refused: ${answer.error || answer.state}`);
  look();
});
element("machine-file").addEventListener("change", () => upload(element("machine-file")));
element("discard").addEventListener("click", () => post("discard", { candidate: candidate.id }));
element("not-now").addEventListener("click", () => { question(null, null); text("answer", ""); });
guard(element("activate"), (shown) => putInForce("activate", shown), () => ({ candidate: candidate.id, hash: candidate.result.hash }));
guard(element("configured"), () => putInForce("back", { hash: null }));
guard(element("confirm"), () => putInForce(pending.what, { ...pending.body, confirm: pending.hash }));
window.addEventListener("resize", () => { if (candidate && candidate.result) drawPlots(candidate.result); });
checkToken();
setInterval(look, LOOK_MS);

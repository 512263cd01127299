"use strict";
/* global foldedCurves, diagonalOf, leftOf, ends */

const HOLD_MS = 1000, LOOK_MS = 1000;
const element = (id) => document.getElementById(id);
// The token stays in this tab only; it is never in an address.
const token = () => sessionStorage.getItem("token") || "";
const headers = () => (token() ? { Authorization: `Bearer ${token()}` } : {});
let isEngineer = false, mayOperate = false, state = null, candidate = null;
/** What a person has to confirm: the request that is repeated with the hash. */
let asked = null;
/** The answers that were typed, by files and key: neither a look at the gateway nor a reload of the page must take them away. */
const typed = new Map();
/** Questions whose answers differ from file to file. */
const OF_ONE = ["error", "file"];
let drawn = "", marked = "", busy = false, wantsResult = false;

function text(id, value) {
  const target = element(id);
  if (target.textContent !== value) target.textContent = value;
}

function make(tag, name, parent, said) {
  const made = document.createElement(tag);
  if (name) made.className = name;
  if (said !== undefined) made.textContent = said;
  parent.append(made);
  return made;
}

const short = (hash) => hash.replace("sha256:", "").slice(0, 12);
const when = (time) => time.replace("T", " ").slice(0, 19);
const size = (bytes) => (bytes < 1024 ? `${bytes} B` : bytes < 1048576 ? `${(bytes / 1024).toFixed(0)} KiB` : `${(bytes / 1048576).toFixed(1)} MiB`);
const SOURCES = { file: "machine file", upload: "upload", centre: "centre" };
/** What becomes of a configured file that is not in force. */
const DIFFERS = {
  file: "It has been changed since it was read: “Reload” on the dashboard takes it.",
  upload: "It is not used until somebody presses “Use the configured file” below.",
  centre: "It is not used: the centre decides which model is in force.",
};
const OUTCOMES = { "in-force": "put in force", refused: "refused", "must-be-confirmed": "not confirmed" };

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
  if (state.from === "upload" && from) rows.push(["Put in force", `by ${from.who}, ${when(from.time)} UTC, ${from.file}`]);
  rows.push(["Hash", state.hash]);
  rows.push(["Configured", state.configured.file]);
  pairs(element("in-force"), rows);
  element("trouble").hidden = !state.trouble;
  text("trouble", state.trouble || "");
  element("differs").hidden = !state.configured.differs && !state.configured.error;
  text("differs", state.configured.error
    ? `The configured machine file cannot be read: ${state.configured.error}`
    : `The configured machine file, as it is on disk now, is another model than the one in force. ${DIFFERS[state.from]}`);
  element("no-files").hidden = !state.no_files;
  text("no-files", state.no_files ? `No files are taken here: ${state.no_files}.` : "");
  text("most", `at most ${state.most_files} files, each up to ${size(state.largest_file_bytes)}`);
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
      cell.textContent = "in force";
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

/** The files, each with a button that takes it off. The last one is discarded. */
function showFiles(files, may) {
  const target = element("files"), now = JSON.stringify([files, may]);
  if (target.dataset.shown === now) return;
  target.dataset.shown = now;
  target.replaceChildren();
  for (const file of files) {
    const line = make("li", "", target, `${file.name}, ${size(file.bytes)}`);
    if (files.length === 1) continue;
    const off = make("button", "plain", line, "take off");
    off.title = `take ${file.name} off the list`;
    off.disabled = !may;
    off.addEventListener("click", () => post("take-off", { candidate: candidate.id, name: file.name }));
  }
}

function showCandidate() {
  const step = candidate ? candidate.step : null;
  const isWorking = step === "working";
  text("candidate", !candidate && state && state.no_files ? "" : !candidate ? "Upload what was measured, or a machine file that is ready."
    : isWorking ? "The gateway looks at the files …"
      : `Begun by ${candidate.who}, ${when(candidate.since)} UTC.`);
  const hasMachine = candidate && candidate.files.some((file) => file.name.toLowerCase().endsWith(".toml"));
  const takesFiles = isEngineer && !(state && state.no_files);
  element("measurements").disabled = !takesFiles || isWorking || busy || hasMachine;
  element("machine-file").disabled = !takesFiles || Boolean(candidate) || busy;
  element("machine-file").parentElement.hidden = Boolean(candidate);
  showFiles(candidate ? candidate.files : [], isEngineer && !isWorking && !busy);
  // What went wrong is said where it can be mended.
  const error = (candidate && candidate.error) || "", hasDraft = Boolean(candidate && candidate.draft);
  for (const [id, isHere] of [["error", !hasDraft], ["open", hasDraft]]) {
    element(id).hidden = !error || !isHere;
    text(id, error);
  }
  element("working").hidden = !isWorking;
  element("draft").hidden = !candidate || hasMachine || step !== "uploading";
  element("draft").disabled = !isEngineer || busy || !candidate || candidate.files.length === 0;
  element("discard").hidden = !candidate;
  element("discard").disabled = !isEngineer;
  element("calibrate").disabled = !isEngineer || isWorking;
  const refusal = (candidate && candidate.result && candidate.result.refusal) || "";
  element("activate").disabled = !isEngineer || step !== "ready" || Boolean(refusal);
  element("refusal").hidden = !refusal;
  text("refusal", refusal);
  element("configured").disabled = !takesFiles || !state || !(state.from === "upload" || state.configured.differs) || state.from === "centre";
  const draft = candidate && candidate.draft;
  element("questions-panel").hidden = !draft;
  const result = candidate && candidate.result;
  element("result-panel").hidden = !result;
  // What is drawn already stays, with what is being typed into it.
  const now = JSON.stringify(candidate && [candidate.id, draft && { ...draft, answers: [] }, result, isEngineer]);
  if (now === drawn) {
    if (error !== marked) markOpen();
    marked = error;
    return;
  }
  [drawn, marked] = [now, error];
  if (draft) showDraft(draft);
  // Answered, they are out of the way of the result.
  element("questions-fold").open = !result;
  if (result) showResult(result);
  if (result && wantsResult) element("result-panel").scrollIntoView();
  wantsResult = wantsResult && !result;
}

/** Where the gateway says no to the answers, the first field that keeps it from going on is shown. */
function showOpen() {
  if (!wantsResult || !candidate || candidate.step === "working" || !candidate.error) return;
  wantsResult = false;
  const first = element("questions").querySelector(".open-field");
  if (first) first.scrollIntoView({ block: "center" });
}

/** What an answer is kept under: numbers of measurements become others where a file is added or taken off. */
function keyOf(draft, of, key) {
  const measurement = draft.measurements[Number(of)];
  return `${measurement ? measurement.files.join(" ") : of} ${key}`;
}

function keep(key, value) {
  typed.set(key, value);
  sessionStorage.setItem("typed", JSON.stringify({ candidate: candidate.id, answers: [...typed] }));
}

/** What was typed before the page was loaded anew. */
function recall() {
  try {
    const kept = JSON.parse(sessionStorage.getItem("typed") || "null");
    if (kept && kept.candidate === candidate.id) for (const [key, value] of kept.answers) typed.set(key, value);
  } catch { /* nothing that could be used */ }
}

function fieldOf(question, parent) {
  let field;
  if (question.choices.length) {
    field = make("select", "", parent);
    make("option", "", field, "").value = "";
    for (const choice of question.choices) make("option", "", field, choice).value = choice;
  } else {
    field = make("input", "", parent);
    field.autocomplete = "off";
    field.inputMode = question.key === "error" || question.key.startsWith("channels") ? "text" : "decimal";
    if (question.key === "point") field.placeholder = "x, y, z";
  }
  return field;
}

function lineOf(question, parent) {
  const line = make("label", "question", parent);
  const words = make("span", "", line, `${question.question} `);
  make("code", "", words, question.key);
  return line;
}

/** A field for each question that many measurements have: it fills those that are empty. */
function showForAll(questions, form) {
  const kinds = new Map();
  for (const question of questions) if (!OF_ONE.includes(question.key)) kinds.set(question.key, [...(kinds.get(question.key) || []), question]);
  const many = [...kinds.values()].filter((of) => of.length > 1);
  if (many.length === 0) return;
  const group = make("fieldset", "for-all", form);
  make("legend", "", group, "The same for all of these");
  make("p", "said", group, "What stands here is filled into the fields below that are empty. What was typed there stays.");
  const fields = many.map((of) => {
    const line = lineOf({ ...of[0], question: `${of.length} times: ${of[0].question}` }, group);
    const field = fieldOf(of[0], line);
    field.dataset.all = of[0].key;
    return field;
  });
  const fill = make("button", "plain", make("div", "row", group), "Fill the empty fields");
  fill.type = "button";
  fill.addEventListener("click", () => {
    for (const all of fields.filter((field) => field.value.trim())) {
      for (const field of form.querySelectorAll(`[data-key="${all.dataset.all}"]`)) {
        if (field.value.trim() || field.closest(".left-out")) continue;
        field.value = all.value.trim();
        field.dispatchEvent(new Event("input"));
      }
    }
  });
}

/** Marks the fields that keep the gateway from making a model: those that are empty, or the one that it names. */
function markOpen() {
  const error = (candidate && candidate.error) || "";
  for (const field of element("questions").querySelectorAll("[data-key]:not([data-key=leave_out])")) {
    const isWrong = error.startsWith(field.dataset.named) || (error.includes("open question") && !field.value.trim());
    field.classList.toggle("open-field", isWrong && !field.closest(".left-out"));
  }
}

function showDraft(draft) {
  recall();
  for (const answer of draft.answers) {
    const key = keyOf(draft, answer.of, answer.key);
    if (!typed.has(key)) typed.set(key, answer.value);
  }
  for (const [id, lines] of [["conflicts", draft.conflicts], ["left-over", draft.left_over], ["notes", draft.notes]]) {
    list(id, lines);
    element(id).parentElement.hidden = lines.length === 0;
  }
  text("text", draft.text);
  const form = element("questions");
  form.replaceChildren();
  const groups = new Map();
  for (const question of draft.questions) groups.set(question.of, [...(groups.get(question.of) || []), question]);
  if (groups.size === 0) make("p", "", form, "None: the files say everything.");
  showForAll(draft.questions, form);
  for (const [of, questions] of groups) {
    const group = make("fieldset", "", form);
    const measurement = draft.measurements[Number(of)];
    make("legend", "", group, measurement ? `${measurement.error || "unknown error"}: ${measurement.files.join(" or ")}` : `Squareness ${of}`);
    if (measurement) for (const said of measurement.said) make("p", "said", group, said);
    for (const question of questions) {
      const field = fieldOf(question, lineOf(question, group));
      const key = keyOf(draft, of, question.key);
      field.dataset.of = of;
      field.dataset.key = question.key;
      // As a refusal of the gateway names it.
      field.dataset.named = `${measurement ? measurement.files.join(", ") : of}: ${question.key}: `;
      field.value = typed.get(key) || "";
      field.addEventListener("input", () => {
        keep(key, field.value);
        field.classList.remove("open-field");
      });
    }
    const out = make("label", "out", group);
    const box = make("input", "", out);
    box.type = "checkbox";
    box.dataset.of = of;
    box.dataset.key = "leave_out";
    const outKey = keyOf(draft, of, "leave_out");
    box.checked = typed.get(outKey) === "true";
    make("span", "", out, "leave this out");
    const mark = () => group.classList.toggle("left-out", box.checked);
    box.addEventListener("change", () => { keep(outKey, String(box.checked)); mark(); markOpen(); });
    mark();
  }
  markOpen();
}

function answers() {
  const found = [];
  for (const field of element("questions").querySelectorAll("[data-key]")) {
    const value = field.type === "checkbox" ? (field.checked ? "true" : "") : field.value.trim();
    if (value) found.push({ of: field.dataset.of, key: field.dataset.key, value });
  }
  return found;
}

function showResult(result) {
  text("result-name", result.name);
  text("result-hash", result.hash);
  list("warnings", result.warnings);
  const table = element("fits"), body = table.tBodies[0];
  table.hidden = result.fits.length === 0;
  body.replaceChildren();
  const fixed = (value, unit) => (value === null ? "–" : `${value.toFixed(2)} ${unit}`);
  for (const fit of result.fits) {
    const unit = fit.unit === "urad" ? "µrad" : "µm";
    const row = body.insertRow();
    const largest = Math.max(Math.abs(fit.residual_min), Math.abs(fit.residual_max));
    for (const cell of [`${fit.error}${fit.direction ? ` ${fit.direction}` : ""}`, fit.curve, fit.readings.length, fixed(fit.residual_rms, unit), fixed(largest, unit), fixed(fit.leave_one_out, unit)]) make("td", "", row, String(cell));
  }
  const square = Object.entries(result.squareness_urad).map(([error, value]) => `${error} ${value.toFixed(1)} µrad`.replace("-", "−"));
  text("squareness", square.length ? `Squareness: ${square.join(", ")}` : "");
  drawPlots(result);
}

/** Curves and diagonals in the width of the window; what was unfolded stays so. */
function drawPlots(result) {
  const isOpen = new Set([...element("curves").querySelectorAll("details[open]")].map((fold) => fold.dataset.axis));
  element("curves").replaceChildren(...foldedCurves(result.fits));
  for (const fold of element("curves").children) fold.open = isOpen.has(fold.dataset.axis);
  const range = ends(result.diagonals.flatMap((diagonal) => leftOf(diagonal).flatMap((p) => p.slice(1))));
  element("diagonals-part").hidden = result.diagonals.length === 0;
  element("diagonals").replaceChildren(...result.diagonals.map((diagonal) => diagonalOf(diagonal, range)));
}

/** What a change does, in lines. */
function changesOf(answer) {
  const moved = [[answer.worst_corner_um, answer.confirm_um, "µm"], [answer.worst_corner_urad, answer.confirm_urad, "µrad"]];
  const differences = answer.differences || [];
  if (answer.worst_corner_um === null) return [...differences, "The machine has other axes than before: how far the correction moves is unknown."];
  const moves = moved.filter(([worst]) => worst !== null)
    .map(([worst, least, unit]) => `At the worst place of the work space the correction moves by ${worst.toFixed(1).replace("-", "−")} ${unit}` + (least === null ? "." : ` (allowed without asking: ${least} ${unit}).`));
  return [...differences, ...moves];
}

function question(answer, repeat) {
  asked = repeat;
  element("confirm-panel").hidden = !answer;
  if (!answer) return;
  list("confirm-lines", changesOf(answer));
  text("confirm-hash", answer.model);
  asked.hash = answer.model;
  element("confirm-panel").scrollIntoView({ block: "center" });
}

/** Puts a model in force; where it moves the correction far, or may be of another machine, it is asked first. */
async function putInForce(what, body) {
  text("answer", "comparing with the model in force …");
  try {
    const { ok, status, answer } = await ask(`/api/model/${what}`, body);
    if (status === 409 && answer.model) {
      text("answer", `${(answer.differences || []).length ? "This may be a model of another machine" : "This moves the correction far"} and must be confirmed.`);
      return question(answer, { what, body });
    }
    question(null, null);
    text("answer", ok ? `in force: ${short(answer.model)}${answer.unchanged ? ", as before" : ""}${answer.note ? `. ${answer.note}` : ""}` : `not put in force: ${answer.error || (answer.reasons || []).join(", ")}`);
  } catch {
    text("answer", "the gateway does not answer: look at the history whether it is in force");
  }
  look();
}

async function upload(kind, input) {
  busy = true;
  const files = [...input.files];
  try {
    for (const [index, file] of files.entries()) {
      text("answer", `uploading ${file.name} (${index + 1} of ${files.length}) …`);
      const at = candidate ? `&candidate=${candidate.id}` : "";
      const response = await fetch(`/api/model/upload?kind=${kind}&name=${encodeURIComponent(file.name)}${at}`, { method: "POST", headers: headers(), body: file });
      const answer = await response.json();
      if (!response.ok) {
        text("answer", `${file.name}: ${answer.error}`);
        return;
      }
      candidate = answer;
    }
    text("answer", "");
  } catch {
    text("answer", "the upload was cut: the gateway does not answer, or ended the connection");
  } finally {
    input.value = "";
    busy = false;
    look();
  }
}

async function post(what, body, then = () => null) {
  try {
    const { ok, answer } = await ask(`/api/model/${what}`, body);
    if (ok) then();
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
    const before = JSON.stringify(state), was = candidate && candidate.id;
    state = model.answer;
    // It may be gone by now, which the next look shows.
    const made = state.candidate ? await ask("/api/model/candidate") : { ok: false };
    candidate = made.ok ? made.answer : null;
    if (was && (!candidate || candidate.id !== was)) typed.clear();
    // A button that is being held must not be drawn anew under the finger.
    if (JSON.stringify(state) !== before) showState();
    showCandidate();
    showOpen();
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

/** A press counts after a second: a glove or a tool that touches the glass does nothing. */
/** A button that is held. `what` is asked as the press begins: what is shown then is meant, whatever comes meanwhile. */
function guard(button, act, what = () => null) {
  let timer = null;
  const end = () => {
    clearTimeout(timer);
    timer = null;
    button.classList.remove("holding");
  };
  const begin = (event) => {
    if (button.disabled || (event.type === "keydown" && event.key !== "Enter" && event.key !== " ") || event.repeat) return;
    event.preventDefault();
    button.classList.add("holding");
    const meant = what();
    timer = timer || setTimeout(() => { end(); act(meant); }, HOLD_MS);
  };
  for (const name of ["pointerdown", "keydown"]) button.addEventListener(name, begin);
  for (const name of ["pointerup", "pointerleave", "pointercancel", "keyup", "blur"]) button.addEventListener(name, end);
  button.addEventListener("contextmenu", (event) => event.preventDefault());
}

element("disarm").addEventListener("click", async () => {
  let { ok, answer } = await ask("/api/disarm", {});
  // On the gateway's own computer disarming needs no token, also where the one that was entered does not allow it.
  if (!ok && token()) ok = (await fetch("/api/disarm", { method: "POST" })).ok;
  text("answer", ok ? "" : `disarm refused: ${answer.error || answer.state}`);
  look();
});
element("measurements").addEventListener("change", () => upload("measurement", element("measurements")));
element("machine-file").addEventListener("change", () => upload("machine", element("machine-file")));
element("draft").addEventListener("click", () => post("draft", { candidate: candidate.id }));
element("discard").addEventListener("click", () => post("discard", { candidate: candidate.id }));
element("questions").addEventListener("submit", (event) => {
  event.preventDefault();
  post("answers", { candidate: candidate.id, answers: answers() }, () => { wantsResult = true; });
});
element("not-now").addEventListener("click", () => { question(null, null); text("answer", ""); });
guard(element("activate"), (shown) => putInForce("activate", shown), () => ({ candidate: candidate.id, hash: candidate.result.hash }));
guard(element("configured"), () => putInForce("back", { hash: null }));
guard(element("confirm"), () => putInForce(asked.what, { ...asked.body, confirm: asked.hash }));
element("token-form").addEventListener("submit", (event) => {
  event.preventDefault();
  sessionStorage.setItem("token", element("token").value.trim());
  element("token").value = "";
  checkToken();
});
window.addEventListener("resize", () => { if (candidate && candidate.result) drawPlots(candidate.result); });
checkToken();
setInterval(look, LOOK_MS);

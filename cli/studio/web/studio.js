"use strict";

const element = (id) => document.getElementById(id);
const UNITS = { um: "µm", urad: "µrad" };
const VERDICTS = { pass: "Every tolerance is met.", fail: "A tolerance is not met.", undecided: "Whether the tolerances are met is not proven.", none: "No tolerance was stated." };
/** As the studio bounds it, bytes. */
const LARGEST_FILE = 8 * 1024 * 1024;
/** Questions whose answers differ from file to file. */
const OF_ONE = ["error", "file"];
/** Shorter work is not shown, ms. */
const SHOWN_AFTER = 300;
/** Changes of a model that the table names. */
const LISTED_CHANGES = 6;
let state = null, busy = false;
/** Whether the user has cancelled the request, or the requests of one action. */
let cancelled = false;
/** What was typed and is not saved yet, by subject and key. */
const typed = new Map();
const keyOf = (of, key) => `${of}\n${key}`;

function make(tag, name, parent, said) {
  const made = document.createElement(tag);
  if (name) made.className = name;
  if (said !== undefined) made.textContent = said;
  parent.append(made);
  return made;
}

function showMessage(said) {
  element("answer").hidden = !said;
  element("answer").textContent = said || "";
}

/** Shows what runs, and since how many seconds; returns how to end it. */
function showProgress(doing) {
  const begun = performance.now();
  element("doing").textContent = `${doing} …`;
  element("cancel").disabled = false;
  const tick = () => {
    const ms = performance.now() - begun;
    element("running").hidden = ms < SHOWN_AFTER;
    element("seconds").textContent = `${Math.floor(ms / 1000)} s`;
  };
  const timer = setInterval(tick, 100);
  return () => { clearInterval(timer); element("running").hidden = true; };
}

/** A request; what it refuses is shown, and `null` returned. */
async function ask(path, body, doing = "Reading the folder") {
  busy = true;
  cancelled = false;
  const focused = document.activeElement, ended = showProgress(doing);
  for (const button of document.querySelectorAll("button:not(#cancel)")) button.disabled = true;
  try {
    const sent = body instanceof Blob || typeof body === "string" ? body : JSON.stringify(body);
    const response = await fetch(path, body === undefined ? {} : { method: "POST", body: sent });
    const said = await response.text();
    let answer = { error: `${said} (status ${response.status})` };
    // What is refused before the studio reads it, a body that is too large, is no document.
    try { answer = JSON.parse(said); } catch { /* said as it is */ }
    showMessage(response.ok ? "" : answer.error);
    return response.ok ? answer : null;
  } catch {
    showMessage("The studio does not answer: check the terminal in which `volcomp studio` runs.");
    return null;
  } finally {
    busy = false;
    ended();
    for (const button of document.querySelectorAll("button")) button.disabled = false;
    // A disabled button loses the focus.
    if (focused && document.activeElement === document.body) focused.focus({ preventScroll: true });
  }
}

function list(id, lines) {
  const target = element(id);
  target.replaceChildren();
  for (const line of lines) make("li", "", target, line);
  if (target.parentElement.tagName === "DIV") target.parentElement.hidden = lines.length === 0;
}

function show(now) {
  if (!now) return;
  state = now;
  element("folder").textContent = state.folder;
  element("undo").hidden = !state.undo;
  if (state.undo) element("undo").textContent = `Undo: ${state.undo.what} of ${new Date(state.undo.at_s * 1000).toLocaleTimeString([], { hour: "2-digit", minute: "2-digit" })}`;
  showFiles();
  showMachine();
  const draft = state.draft;
  list("conflicts", draft ? draft.conflicts : []);
  list("notes", draft ? draft.notes : []);
  element("questions-panel").hidden = !draft && !state.by_hand;
  element("by-hand").hidden = !state.by_hand;
  for (const id of ["questions-fold", "questions-row", "calibration-fold"]) element(id).hidden = !draft;
  if (draft) showQuestions(draft);
  element("fit-panel").hidden = !state.machine;
  element("fit").textContent = state.files.length || state.by_hand ? "Fit the measurements" : "Take the errors that the machine file states";
  showEarlier();
  const hasReport = state.results.includes("result/report.html");
  element("stale").hidden = !state.is_stale;
  element("report-part").hidden = !hasReport;
  if (hasReport && !element("report").src) element("report").src = "report.html";
  for (const panel of document.querySelectorAll(".results")) panel.hidden = !state.results.includes("result/machine.toml");
}

function showFiles() {
  const target = element("files");
  target.replaceChildren();
  for (const file of state.files) {
    const line = make("li", file.not_used ? "not-used" : file.error || !state.machine ? "" : "open-question", target, file.name);
    const what = file.not_used ? `not used: ${file.not_used}` : [file.error || (state.machine ? "its error is one of the questions below" : ""), ...file.said].filter(Boolean).join("; ");
    if (what) make("small", "", line, what);
  }
  if (state.files.length === 0) make("li", "not-used", target, "no files yet");
}

const dateOf = (model) => new Date(model.written_s * 1000).toLocaleString();

/** The models that later fits replaced, by the time at which they were written. */
function showEarlier() {
  element("earlier-line").hidden = element("models-part").hidden = state.models.length === 0;
  const models = JSON.stringify(state.models);
  if (element("models").dataset.of !== models) element("models").hidden = true;
  element("models").dataset.of = models;
  const field = element("earlier"), chosen = field.value;
  field.replaceChildren();
  make("option", "", field, "none").value = "";
  for (const model of state.models) make("option", "", field, `${dateOf(model)}: ${model.name}`).value = model.name;
  field.value = state.models.some((model) => model.name === chosen) ? chosen : "";
}

/** The largest differences of a model from the newest. */
function differences(changes) {
  const shown = changes.filter((of) => of.largest >= 0.05).slice(0, LISTED_CHANGES);
  const more = changes.length - shown.length;
  if (shown.length === 0) return more ? "none of 0.05 or more" : "none";
  return shown.map((of) => `${of.error} ${of.largest.toFixed(1)} ${of.unit}`).join(", ") + (more ? `, and ${more} smaller` : "");
}

/** A table of all models with their volumetric error and what has changed since. */
async function compare() {
  const target = element("models"), all = [{ name: "result/machine.toml" }, ...state.models];
  target.replaceChildren();
  target.hidden = false;
  const table = make("table", "", target), head = make("tr", "", table);
  for (const word of ["Model", "Volumetric error V, µm", "Largest differences from the newest"]) make("th", "", head, word).scope = "col";
  for (const [index, model] of all.entries()) {
    const drift = await ask("api/drift", { model: model.name }, `Comparing model ${index + 1} of ${all.length}`);
    if (cancelled) return;
    const row = make("tr", "", table);
    make("th", "", row, index ? dateOf(model) : "the newest").scope = "row";
    make("td", "", row, drift && drift.position_um !== null ? drift.position_um.toFixed(1) : "");
    make("td", "", row, !drift ? element("answer").textContent : index ? differences(drift.changes) : "");
    // The reason is in its row.
    showMessage("");
  }
}

function showMachine() {
  const machine = state.machine;
  element("machine-form").hidden = Boolean(machine || state.machine_text);
  element("machine-fold").hidden = !state.machine_text;
  element("machine-error").hidden = !state.machine_error;
  element("machine-error").textContent = state.machine_error || "";
  if (state.machine_error) element("machine-fold").open = true;
  element("machine").textContent = machine
    ? `${machine.name || "without a name"}: ${machine.structure}; ${machine.axes.map(([axis, travel]) => `${axis} ${travel.join(" to ")}`).join(", ")}`
    : "";
  const text = element("machine-text");
  if (document.activeElement !== text) text.value = state.machine_text;
  const places = element("places");
  const now = JSON.stringify(machine && machine.axes);
  if (!machine || places.dataset.of === now) return;
  places.dataset.of = now;
  places.replaceChildren();
  for (const [axis, [low, high]] of machine.axes) {
    const line = make("label", "question", places);
    make("span", "", line, `${axis}, ${"ABC".includes(axis) ? "deg" : "mm"}`);
    const field = make("input", "", line);
    field.dataset.axis = axis;
    field.value = "ABC".includes(axis) && low <= 0 && high >= 0 ? 0 : +((low + high) / 2).toFixed(3);
  }
}

/** Fields for the travels of the axes that the structure names. */
function showTravels() {
  const target = element("travels");
  const known = new Map([...target.querySelectorAll("input")].map((field) => [field.dataset.of, field.value]));
  target.replaceChildren();
  for (const axis of element("structure").value.match(/[XYZABCUVW]/g) || []) {
    const line = make("label", "question", target);
    const isRotary = "ABC".includes(axis);
    make("span", "", line, `Travel of ${axis}, ${isRotary ? "deg" : "mm"}`);
    const two = make("span", "two", line);
    for (const [end, otherwise] of [["from", isRotary ? "-180" : "0"], ["to", isRotary ? "180" : ""]]) {
      const field = make("input", "", two);
      field.placeholder = end;
      field.inputMode = "decimal";
      field.dataset.of = `${axis} ${end}`;
      field.value = known.get(field.dataset.of) ?? otherwise;
    }
    if (!isRotary) continue;
    const point = make("label", "question", target);
    make("span", "", point, `A point on the centre line of ${axis}: x, y, z, mm`);
    const field = make("input", "", point);
    field.dataset.of = `${axis} point`;
    field.value = known.get(field.dataset.of) ?? "0, 0, 0";
  }
}

/** The machine file of the form; JSON writes texts as TOML does. */
function machineText() {
  const numbers = (text) => `[${text.split(",").map((number) => number.trim().replace("−", "-")).join(", ")}]`;
  const of = (name) => element("travels").querySelector(`[data-of="${name}"]`);
  const lines = [`name = ${JSON.stringify(element("name").value.trim())}`, `structure = ${JSON.stringify(element("structure").value.trim().replaceAll("′", "'"))}`, ""];
  for (const axis of element("structure").value.match(/[XYZABCUVW]/g) || []) {
    lines.push(`[axes.${axis}]`, `travel = ${numbers(`${of(`${axis} from`).value},${of(`${axis} to`).value}`)}`);
    if (of(`${axis} point`)) lines.push(`point = ${numbers(of(`${axis} point`).value)}`);
  }
  lines.push("", "[tool]", `tip = ${numbers(element("tip").value)}`, "");
  return lines.join("\n");
}

function fieldOf(question, parent) {
  let field;
  if (question.choices.length) {
    field = make("select", "", parent);
    make("option", "", field, question.default === null ? "" : `open; default: ${question.default}`).value = "";
    for (const choice of question.choices) make("option", "", field, choice).value = choice;
  } else {
    field = make("input", "", parent);
    field.autocomplete = "off";
    if (question.default !== null) field.placeholder = `open; default: ${question.default}`;
  }
  field.dataset.key = question.key;
  return field;
}

function lineOf(question, parent) {
  const line = make("label", "question", parent);
  const words = make("span", "", line, `${question.question} `);
  make("code", "", words, question.key);
  return line;
}

/** One field for a question that several measurements have: it fills the empty ones. */
function showForAll(questions, form) {
  const kinds = new Map();
  for (const question of questions) if (!OF_ONE.includes(question.key)) kinds.set(question.key, [...(kinds.get(question.key) || []), question]);
  const many = [...kinds.values()].filter((of) => of.length > 1);
  if (many.length === 0) return;
  const group = make("fieldset", "for-all", form);
  make("legend", "", group, "The same for all measurements");
  make("p", "said", group, "Fills the fields below that are empty.");
  for (const of of many) {
    const field = fieldOf({ ...of[0], default: null }, lineOf({ ...of[0], question: `${of.length} times: ${of[0].question}` }, group));
    field.dataset.all = field.dataset.key;
    delete field.dataset.key;
    field.addEventListener("change", () => {
      for (const one of form.querySelectorAll(`[data-key="${field.dataset.all}"]`)) if (!one.value && !one.closest(".left-out")) fill(one, field.value.trim());
    });
  }
}

function fill(field, value) {
  field.value = value;
  field.dispatchEvent(new Event("input"));
}

function showQuestions(draft) {
  element("text").textContent = draft.text;
  if (draft.open) element("questions-fold").open = true;
  element("open").textContent = draft.open ? `(${draft.open} open)` : "(none open)";
  const form = element("questions");
  form.replaceChildren();
  if (draft.questions.length === 0) make("p", "", form, state.files.length ? "None: the files say everything." : "No files yet.");
  const saved = new Map(draft.answers.map((answer) => [keyOf(answer.of, answer.key), answer.value]));
  element("rides").hidden = !draft.questions.some((question) => question.key === "rides");
  showForAll(draft.questions, form);
  const groups = new Map();
  for (const question of draft.questions) groups.set(question.of, [...(groups.get(question.of) || []), question]);
  for (const [of, questions] of groups) {
    const group = make("fieldset", "", form);
    const file = state.files.find((known) => of.split(", ").includes(known.name));
    make("legend", "", group, file ? `${file.error || "unknown error"}: ${of}` : `Squareness ${of}`);
    if (file && file.said.length) make("p", "said", group, file.said.join("; "));
    for (const question of questions) {
      const field = fieldOf(question, lineOf(question, group));
      field.dataset.of = of;
      field.dataset.default = question.default ?? "";
      const key = keyOf(of, question.key);
      field.value = typed.get(key) ?? saved.get(key) ?? "";
      const mark = () => field.classList.toggle("open-field", !field.value);
      field.addEventListener("input", () => { typed.set(key, field.value); mark(); });
      mark();
    }
    const out = make("label", "out", group);
    const box = make("input", "", out);
    box.type = "checkbox";
    Object.assign(box.dataset, { of, key: "leave_out" });
    const key = keyOf(of, "leave_out");
    box.checked = (typed.get(key) ?? saved.get(key)) === "true";
    make("span", "", out, "leave this out");
    const mark = () => group.classList.toggle("left-out", box.checked);
    box.addEventListener("change", () => { typed.set(key, String(box.checked)); mark(); });
    mark();
  }
}

function answers() {
  const found = [];
  for (const field of element("questions").querySelectorAll("[data-key]")) {
    const value = field.type === "checkbox" ? (field.checked ? "true" : "") : field.value.trim();
    if (value) found.push({ of: field.dataset.of, key: field.dataset.key, value });
  }
  return found;
}

/** Saves what was typed; whether it was taken. */
async function save() {
  if (!state.draft) return true;
  const now = await ask("api/answers", answers(), "Saving the answers");
  if (!now) return false;
  typed.clear();
  show(now);
  return true;
}

async function fit() {
  if (!await save()) return;
  if (state.draft && state.draft.open) {
    showMessage(`${state.draft.open} questions are open: answer them, take their defaults, or leave the measurement out.`);
    const first = element("questions").querySelector("fieldset:not(.left-out) .open-field");
    if (first) first.scrollIntoView({ block: "center" });
    return;
  }
  const used = state.files.filter((file) => !file.not_used).length;
  const fitted = await ask("api/fit", { tolerance: element("tolerance").value, earlier: element("earlier").value || null }, used ? `Fitting ${used} file${used > 1 ? "s" : ""}` : "Evaluating the machine file");
  element("fitted").hidden = !fitted;
  if (!fitted) return;
  const verdict = element("verdict");
  verdict.dataset.verdict = fitted.verdict;
  verdict.textContent = `${VERDICTS[fitted.verdict]} ${fitted.curves} curves` + (fitted.position_um === null ? "." : `; the tool tip errs by up to ${fitted.position_um.toFixed(1)} µm after best-fit alignment, at ${fitted.worst_at}${fitted.before_um === null ? "" : `; by the earlier model by up to ${fitted.before_um.toFixed(1)} µm`}.`);
  list("checks", fitted.checks);
  list("warnings", fitted.warnings);
  element("report").src = `report.html?${fitted.machine.slice(-12)}${Date.now()}`;
  show(await ask("api/state"));
  // Hide answered questions, so that the result is visible.
  element("questions-fold").open = false;
  element("fit-panel").scrollIntoView();
}

/** Reverts the last change; a fit that is reverted is no longer shown. */
async function undo() {
  const now = await ask("api/undo", {}, "Reverting the last change");
  if (!now) return;
  element("fitted").hidden = true;
  element("report").removeAttribute("src");
  show(now);
}

async function upload(files) {
  // One that is refused does not stop the others.
  const refused = [], batch = Date.now(), all = [...files];
  for (const [index, file] of all.entries()) {
    if (file.size > LARGEST_FILE) {
      refused.push(`${file.name}: larger than 8 MiB, the most that is taken`);
      continue;
    }
    const now = await ask(`api/upload?name=${encodeURIComponent(file.name)}&batch=${batch}`, file, `Copying ${file.name} (${index + 1} of ${all.length})`);
    if (now) show(now);
    else refused.push(element("answer").textContent);
    if (cancelled) break;
  }
  showMessage(refused.join("; "));
}

function saved(parent, files) {
  const target = make("ul", "files", parent);
  for (const file of files) {
    const link = make("a", "", make("li", "", target), file);
    link.href = `file?name=${encodeURIComponent(file)}`;
  }
}

async function tables(event) {
  event.preventDefault();
  const at = {};
  for (const field of element("places").querySelectorAll("input")) {
    // An empty field is no position.
    if (field.value.trim() === "") return showMessage(`${field.dataset.axis}: the position is missing`);
    at[field.dataset.axis] = Number(field.value);
  }
  const number = (id) => Number(element(id).value);
  const done = await ask("api/tables", { format: element("format").value, step_mm: number("step-mm"), step_deg: number("step-deg"), limit_um: number("limit"), at }, "Writing tables");
  const target = element("tables-done");
  target.replaceChildren();
  if (!done) return;
  saved(target, done.files);
  const table = make("table", "", make("div", "scroll", target));
  const head = make("tr", "", table);
  for (const word of ["Axis", "Largest error without tables", "left with them"]) make("th", "", head, word);
  for (const of of done.left) {
    const row = make("tr", "", table);
    for (const cell of [of.axis, `${of.without.toFixed(1)} ${UNITS[of.unit]}`, `${of.largest.toFixed(1)} ${UNITS[of.unit]}`]) make("td", "", row, cell);
  }
  for (const note of [`Sign: ${done.sign}.`, done.trust, ...done.notes]) make("p", "said", target, note);
}

async function nc(event) {
  event.preventDefault();
  const [program] = element("program").files;
  if (!program) return showMessage("Choose a program first.");
  const done = await ask(`api/nc?name=${encodeURIComponent(program.name)}&tolerance_um=${encodeURIComponent(element("nc-tolerance").value)}`, program, `Compensating ${program.name}`);
  const target = element("nc-done");
  target.replaceChildren();
  if (!done) return;
  saved(target, [done.file]);
  make("p", "", target, `${done.lines} lines with ${done.motions} motions read, ${done.changed} lines changed, ${done.added} added.`);
  for (const note of done.notes) make("p", "said", target, `line ${note.line}: ${note.text}`);
}

async function send(event, to, fields) {
  event.preventDefault();
  const request = { to };
  for (const field of fields) request[field] = element(`${to}-${field}`).value.trim();
  const [certificate] = element(`${to}-certificate`).files;
  if (certificate) request.certificate = await certificate.text();
  const sent = await ask("api/send", request, `Sending to the ${to}`);
  const target = element(`${to}-done`);
  target.replaceChildren();
  if (!sent) return;
  make("p", "", target, sent.said);
  const link = make("a", "", make("p", "", target), sent.page);
  Object.assign(link, { href: sent.page, target: "_blank", rel: "noreferrer" });
  const warnings = make("ul", "notes", target);
  for (const warning of sent.warnings) make("li", "", warnings, warning);
}

element("cancel").addEventListener("click", () => {
  cancelled = true;
  element("cancel").disabled = true;
  element("doing").textContent = "Cancelling …";
  // The cancelled request says whether it was stopped or already finished.
  fetch("api/cancel", { method: "POST" }).catch(() => {});
});
const drop = element("drop");
for (const name of ["dragover", "dragleave", "drop"]) {
  document.addEventListener(name, (event) => {
    event.preventDefault();
    drop.classList.toggle("over", name === "dragover");
    if (name === "drop" && !busy) upload(event.dataTransfer.files);
  });
}
element("choose").addEventListener("change", async () => { await upload([...element("choose").files]); element("choose").value = ""; });
element("compare").addEventListener("click", compare);
element("undo").addEventListener("click", undo);
element("structure").addEventListener("input", showTravels);
element("machine-form").addEventListener("submit", async (event) => { event.preventDefault(); show(await ask("api/machine", { text: machineText() }, "Writing machine.toml")); });
element("machine-edit").addEventListener("submit", async (event) => { event.preventDefault(); show(await ask("api/machine", { text: element("machine-text").value }, "Writing machine.toml")); });
element("questions").addEventListener("submit", (event) => { event.preventDefault(); save(); });
element("defaults").addEventListener("click", () => {
  for (const field of element("questions").querySelectorAll("[data-default]")) if (!field.value && field.dataset.default) fill(field, field.dataset.default);
});
element("fit-form").addEventListener("submit", (event) => { event.preventDefault(); fit(); });
element("tables").addEventListener("submit", tables);
element("nc").addEventListener("submit", nc);
element("gateway").addEventListener("submit", (event) => send(event, "gateway", ["url", "token"]));
element("centre").addEventListener("submit", (event) => send(event, "centre", ["url", "name", "password"]));
ask("api/state").then(show);

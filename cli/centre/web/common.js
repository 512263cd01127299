"use strict";
// Common to all pages: requests, elements, formatting, maps.

const LETTERS = "XYZABCUVW";
const ROLES = ["viewer", "engineer", "admin"];
const element = (id) => document.getElementById(id);
/** Who is logged in: {name, role}. */
let me = null;
const may = (role) => Boolean(me) && ROLES.indexOf(me.role) >= ROLES.indexOf(role);

/** Makes an element. Texts are only ever texts: nothing that comes from elsewhere becomes part of the page's structure. */
function make(tag, properties = {}, ...children) {
  const made = document.createElement(tag);
  for (const [key, value] of Object.entries(properties)) {
    if (value === undefined || value === null) continue;
    if (key === "data") Object.assign(made.dataset, value);
    else if (key === "class") made.className = value;
    else if (key.startsWith("on")) made.addEventListener(key.slice(2), value);
    else if (key in made && key !== "list") made[key] = value;
    else made.setAttribute(key, value);
  }
  made.append(...children.filter((child) => child !== null && child !== undefined));
  return made;
}

function setText(target, value) {
  if (target.textContent !== value) target.textContent = value;
}

class Refused extends Error {
  constructor(status, why) {
    super(why);
    this.status = status;
  }
}

/** Sends a request to the centre. Throws its error message. */
async function call(method, path, body) {
  let response;
  try {
    response = await fetch(path, {
      method,
      cache: "no-store",
      headers: { "X-Volcomp": "1", ...(body === undefined ? {} : { "Content-Type": "application/json" }) },
      body: body === undefined ? undefined : JSON.stringify(body),
    });
  } catch {
    throw new Refused(0, "the centre does not answer");
  }
  let answer = null;
  try {
    answer = await response.json();
  } catch {
    // No document: the status alone counts.
  }
  if (response.status === 401 && path !== "/api/login") askForLogin();
  if (!response.ok) throw new Refused(response.status, (answer && answer.error) || `the centre answers ${response.status}`);
  return answer;
}
const get = (path) => call("GET", path);
const post = (path, body = {}) => call("POST", path, body);

/** Shows an error at the top of the page, or hides it. */
function trouble(why) {
  const place = element("trouble");
  place.hidden = !why;
  setText(place, why || "");
}

/** Runs the action of a button, and shows the result in `said`. */
async function act(button, said, work, done) {
  button.disabled = true;
  said.className = "said";
  setText(said, "…");
  try {
    const answer = await work();
    setText(said, typeof done === "function" ? done(answer) || "" : done || "");
    return answer;
  } catch (error) {
    said.classList.add("bad");
    setText(said, error.message);
    if (!(error instanceof Refused)) throw error;
    return null;
  } finally {
    button.disabled = false;
  }
}

const fixed = (value, digits) => (isNumber(value) ? value.toFixed(digits).replace("-", "−") : "unknown");
const signed = (value, digits) => (isNumber(value) && value > 0 ? "+" : "") + fixed(value, digits);
const inOrder = (names) => [...names].sort((a, b) => LETTERS.indexOf(a) - LETTERS.indexOf(b));
const short = (sha256) => (sha256 ? sha256.slice(0, 10) : "");

/** "3 s", "12 min", "5 h", "9 d". */
function lasting(seconds) {
  if (!isNumber(seconds)) return "unknown";
  if (seconds < 10) return `${seconds.toFixed(1)} s`;
  if (seconds < 120) return `${Math.round(seconds)} s`;
  if (seconds < 7200) return `${Math.round(seconds / 60)} min`;
  if (seconds < 172800) return `${Math.round(seconds / 3600)} h`;
  return `${Math.round(seconds / 86400)} d`;
}

/** A time by the clock of the centre. */
function clock(seconds) {
  if (!isNumber(seconds)) return "unknown";
  const at = new Date(seconds * 1000);
  const two = (value) => String(value).padStart(2, "0");
  return `${at.getFullYear()}-${two(at.getMonth() + 1)}-${two(at.getDate())} ${two(at.getHours())}:${two(at.getMinutes())}:${two(at.getSeconds())}`;
}

const badge = (state, text) => make("span", { class: "badge", data: { state }, textContent: text || state });

/** A cell of a value: what is not known is the word, softer. */
function cell(value, properties = {}) {
  const made = make("td", properties, value instanceof Node ? value : String(value));
  if (value === "unknown") made.classList.add("unknown");
  return made;
}

/** A table; on a telephone each row of it is a card whose values have their headings before them. */
function table(heads, rows, kind = "cards") {
  const head = make("tr", {}, ...heads.map((text) => make("th", { textContent: text, scope: "col" })));
  for (const row of rows) [...row.cells].forEach((cell, index) => { if (heads[index]) cell.dataset.label = heads[index]; });
  return make("div", { class: `scroll ${kind}` }, make("table", {}, make("thead", {}, head), make("tbody", {}, ...rows)));
}

/** An input with what it is (with its unit), and beneath what is meant by it, with an example. */
function field(text, input, hint) {
  return make("label", {}, make("span", { class: "what", textContent: text }), input, hint ? make("span", { class: "hint", textContent: hint }) : null);
}

function choose(options, value) {
  return make("select", {}, ...options.map(([key, text]) => make("option", { value: key, textContent: text, selected: key === value })));
}

function panel(title, ...children) {
  return make("section", { class: "panel" }, title ? make("h2", { textContent: title }) : null, ...children);
}

function facts(pairs) {
  return make("dl", { class: "facts" }, ...pairs.flatMap(([name, value]) => {
    const shown = value instanceof Node ? value : document.createTextNode(value === "" || value === null || value === undefined ? "–" : String(value));
    return [make("dt", { textContent: name }), make("dd", value === "unknown" ? { class: "unknown" } : {}, shown)];
  }));
}

/** Origin of a map, by the state of the model on the machine. No map is a measurement. */
const ORIGINS = {
  model: "Computed from the model, not measured.",
  active: "Computed from the active model of this machine, not measured.",
  silent: "Computed from the last known active model of this machine, not measured.",
  sent: "Computed from the model that was sent last, not measured. This machine has not reported it as active.",
  never: "Computed from the model that was sent, not measured. This machine has never connected: it is unknown whether it has the model or corrects.",
};

/** The origin for a machine. */
function originOf({ live, silent, versions }) {
  if (!live) return "never";
  if (!versions.some((one) => one.version === live.version)) return "sent";
  return silent ? "silent" : "active";
}

/** Draws on a canvas now, and again whenever its size or the colours of the page change. */
function drawOn(canvas, draw) {
  canvas.redraw = () => {
    // One that is not shown has no size to draw in.
    if (canvas.clientWidth > 100 && canvas.clientHeight > 20) draw();
  };
  requestAnimationFrame(canvas.redraw);
}

function redrawAll() {
  for (const canvas of document.querySelectorAll("canvas")) if (canvas.redraw) canvas.redraw();
}

/** Three sections of the map, before and after the correction, to one scale. */
function drawSections(place, map, origin = "model") {
  place.replaceChildren(make("p", { class: origin === "never" ? "bad origin" : "origin", textContent: ORIGINS[origin] }));
  // One scale for both maps, with a round maximum, so that the improvement is visible.
  const scale = roundUp(Math.max(...map.largest_um, 0.1), [1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10]);
  const key = make("canvas", { class: "scale", role: "img", ariaLabel: `Colour scale of both maps: 0 to ${scale} µm` });
  place.append(make("p", { class: "soft", textContent: "Length of the position error, one scale for both maps:" }), key);
  drawOn(key, () => drawScale(key, scale));
  const turn = (state) => make("h2", { class: "turn", textContent: state });
  for (const [state, words] of [["before_um", "Without correction, computed"], ["after_um", "With correction in steps of 1 µm, computed"]]) {
    const largest = map.largest_um[state === "before_um" ? 0 : 1];
    place.append(turn(`${words}: up to ${fixed(largest, 1)} µm`));
    const row = make("div", { class: "maps" });
    place.append(row);
    for (const section of map.sections) {
      const canvas = make("canvas", { class: "map", role: "img" }), values = section[state];
      canvas.setAttribute("aria-label", `Position error over ${section.axes.map((axis) => axis.name).join(" and ")}, ${words.toLowerCase()}`);
      row.append(make("figure", {}, canvas, make("figcaption", { class: "soft", textContent: section.at ? `at ${section.at[0]} = ${fixed(section.at[1], 0)} mm` : "" })));
      drawOn(canvas, () => drawMap(canvas, values, section.axes, null, scale));
    }
  }
  const others = map.others.map(([name, at]) => `${name} = ${fixed(at, 0)}`).join(", ");
  place.append(make("p", { class: "soft", textContent: `At the reference temperature of the model${others ? `, with ${others}` : ""}. Only a measurement shows the true residual error.` }));
  if (map.diagonals_um.length) {
    place.append(table(["body diagonal", "range before, µm", "range after, µm"], map.diagonals_um.map(([name, [before, after]]) => make("tr", {}, cell(name), cell(fixed(before, 1)), cell(fixed(after, 1)))), "narrow"));
  }
}

/** Numbers separated by blanks or semicolons, not by commas: 0,035 would become two numbers. */
const numbersIn = (text) => text.split(/[\s;]+/).filter(Boolean).map((word) => {
  if (word.includes(",")) throw new Refused(0, `found ${JSON.stringify(word)}, expected a point as the decimal sign, and blanks or semicolons between numbers: no comma`);
  const number = Number(word.replace("−", "-"));
  if (!Number.isFinite(number)) throw new Refused(0, `found ${JSON.stringify(word)}, expected a number`);
  return number;
});

"use strict";
// The history on the dashboard: time range, curves with limits, states and events.
/* global drawHistory, drawRibbon, isNumber, two, COLOURS, STATE_COLOURS, LETTERS, inOrder, signed, element, headers, fixed, text, make */

const LIVE_S = 120;
/** Ranges: length in s, words, and how often they are read again, ms. */
const SPANS = [[LIVE_S, "2 min", 0], [900, "15 min", 5000], [3600, "1 h", 15000], [28800, "8 h", 30000], [86400, "1 day", 60000], [604800, "7 days", 60000], [2592000, "30 days", 60000]];
const LOG_COUNT = 200, LOG_EVERY_MS = 10000, FEW_EVENTS = 6, DRAW_EVERY_MS = 200;
// A reduction in % of an error below this says nothing: µm.
const LEAST_FOR_PERCENT_UM = 1;
/** Single states further apart, s, are not joined. */
const LIVE_GAP_S = 2;
const WARN = "#dd9500", LIMIT = "#e0443a";
/** Events that are marked on the axis of time. */
const MARKS = { arming: ["A", "#3b8fd6", "ramps in"], "test-shift": ["T", "#a0743c", "test shift"], reload: ["R", "#cc79a7", "reload"], faulted: ["!", LIMIT, "fault"] };

/** Points of the chosen range, oldest first; `start_s` is the time (s since 1970) of `at_s` 0; with `step_s` 0 they are single states. */
const shownHistory = { span_s: LIVE_S, every_ms: 0, start_s: null, step_s: 0, points: [] };
/** The single states of the last two minutes, whichever range is shown. */
let livePoints = [];
/** Kinds of the events at which a state begins, by its name. */
const STATE_KINDS = ["test-shift", "arming", "compensating", "holding", "ramping-out", "disarmed", "faulted"];
let logEvents = [], eventsShown = FEW_EVENTS, lastDrawn = 0, timer = null;

const length = (v) => (v ? Math.hypot(...v) : null);
const colour = (name) => getComputedStyle(document.documentElement).getPropertyValue(name).trim();

/** A state as a point: lengths of the errors, of the simulated machine the true ones. While nothing is applied there is no residual. */
function pointOf(state) {
  const corrections = state.correction_known ? { ...state.correction_um, ...state.correction_urad } : {};
  const isApplied = Object.values(corrections).some((value) => value !== 0);
  return {
    at_s: state.uptime_s,
    state: state.state,
    error_um: length(state.true_error_um || state.error_um),
    residual_um: isApplied ? length(state.true_residual_um || state.residual_um) : null,
    error_axis_urad: length(state.error_axis_urad),
    residual_axis_urad: isApplied ? length(state.residual_axis_urad) : null,
    correction_um: state.correction_known ? state.correction_um : {},
    correction_urad: state.correction_known ? state.correction_urad || {} : {},
    temperatures_degc: Object.fromEntries(state.temperatures.filter((one) => one.degc !== null).map((one) => [one.name, one.degc])),
    isIdle: state.correction_known && !isApplied,
  };
}

let lastState = null;

/** Adds the present state. */
function addState(state) {
  lastState = state;
  const point = pointOf(state);
  const last = livePoints[livePoints.length - 1];
  if (last && point.at_s < last.at_s) {
    livePoints = [];
    shownHistory.start_s = null;
  }
  if (last && point.at_s === last.at_s) livePoints.pop();
  livePoints.push(point);
  while (livePoints[0].at_s < point.at_s - LIVE_S) livePoints.shift();
  if (shownHistory.start_s === null) shownHistory.start_s = Date.now() / 1000 - state.uptime_s;
  showReduction(state, point);
  if (shownHistory.span_s === LIVE_S && Date.now() - lastDrawn > DRAW_EVERY_MS) drawAll();
}

/** Nothing is known any more: the curves of before stay, without a last value. */
function endHistory() {
  const isNew = lastState !== null;
  lastState = null;
  if (isNew) drawAll();
  for (const id of ["reduction", "axis-reduction"]) text(id, "unknown");
}

/** Reads the chosen range, and reads it again as time goes on. */
async function showHistory() {
  clearTimeout(timer);
  const { span_s: span, every_ms: every } = shownHistory;
  try {
    const response = await fetch(`/api/history?span_s=${span}`, { headers: headers(), cache: "no-store" });
    if (response.ok && span === shownHistory.span_s) {
      const history = await response.json();
      shownHistory.start_s = history.start_s;
      shownHistory.step_s = history.step_s;
      shownHistory.points = history.points;
      if (span === LIVE_S) {
        const first = livePoints.length ? livePoints[0].at_s : Infinity;
        livePoints = history.points.filter((point) => point.at_s < first).concat(livePoints);
      }
      drawAll();
    }
  } catch {
    // The stream reports that the gateway is gone.
  }
  if (every && span === shownHistory.span_s) timer = setTimeout(showHistory, every);
}

function choose([span, , every]) {
  Object.assign(shownHistory, { span_s: span, every_ms: every, step_s: 0, points: [] });
  for (const button of element("spans").children) button.ariaPressed = String(Number(button.value) === span);
  // The last two minutes are here already.
  if (span === LIVE_S) drawAll();
  showHistory();
}

/** Series of one key of every point, by its inner names. */
function byName(points, key, range) {
  const names = [...new Set(points.flatMap(([, point]) => Object.keys(point[key] || {})))];
  const sorted = names.every((name) => LETTERS.includes(name)) ? inOrder(names) : names.sort();
  return sorted.map((name, index) => ({
    name, colour: COLOURS[index % COLOURS.length],
    points: points.map(([at, point]) => [at, (point[key] || {})[name] ?? null, ...((range && (point[range] || {})[name]) || [])]),
  }));
}

/** Without correction, and with it; the band reaches from the mean to the maximum. */
function errorSeries(points, kind, unit) {
  const of = (what) => points.map(([at, point]) => {
    const [mean, most] = [point[`${what}${kind}_${unit}`] ?? null, point[`${what}${kind}_max_${unit}`]];
    return isNumber(most) ? [at, mean, mean, most] : [at, mean];
  });
  const both = [{ name: "without correction", colour: colour("--before"), points: of("error") }, { name: "with correction", colour: colour("--after"), points: of("residual") }];
  // While nothing is applied there is no curve with correction.
  return both.filter((one, index) => index === 0 || one.points.some((point) => isNumber(point[1])));
}

/** Lines at a limit and its warning, on both sides; the warning band lies beyond the warning. */
function limitLines(limit, warn) {
  const both = (value, tint, isBand) => (isNumber(value) ? [{ value, colour: tint, isBand }, { value: -value, colour: tint, isBand, isLower: true }] : []);
  return [...both(warn, WARN, true), ...both(limit, LIMIT, !isNumber(warn))];
}

/** A chart with its legend: last, mean and maximum of each series, the maximum by magnitude. */
function drawChart(panel, from, to, series, options, digits, notes = []) {
  const place = element(panel);
  drawHistory(place.querySelector("canvas"), from, to, series, options.gap, options);
  const table = place.querySelector("table");
  const rows = series.map(({ name, colour: tint, points }) => {
    const known = points.filter((point) => isNumber(point[1]));
    const most = known.flatMap((point) => point.slice(1)).reduce((found, value) => (found === null || Math.abs(value) > Math.abs(found) ? value : found), null);
    const mean = known.length ? known.reduce((sum, point) => sum + point[1], 0) / known.length : null;
    const shown = options.isSigned ? signed : fixed;
    const last = lastState && points.length ? points[points.length - 1][1] : null;
    return [tint, name, ...[last, mean, most].map((value) => (isNumber(value) ? shown(value, digits) : "–"))];
  });
  showTable(table, [["", "", "last", "mean", "max"], ...rows, ...notes.map(([tint, said, value]) => [tint, said, "", "", value])]);
}

/** Writes cells in place, so that nothing flickers. */
function showTable(table, rows) {
  while (table.rows.length > rows.length) table.deleteRow(-1);
  rows.forEach(([tint, ...cells], index) => {
    const row = table.rows[index] || table.insertRow();
    cells.forEach((said, place) => {
      const cell = row.cells[place] || row.appendChild(document.createElement(index === 0 && said ? "th" : "td"));
      if (cell.textContent !== said) cell.textContent = said;
    });
    row.cells[0].className = tint ? "key" : "";
    row.cells[0].style.setProperty("--key", tint || "transparent");
  });
}

function drawAll() {
  lastDrawn = Date.now();
  const isLive = shownHistory.span_s === LIVE_S;
  const step = isLive ? 0 : shownHistory.step_s;
  const uptime = lastState ? lastState.uptime_s : livePoints.length ? livePoints[livePoints.length - 1].at_s : 0;
  const start = shownHistory.start_s ?? Date.now() / 1000 - uptime;
  const to = start + uptime, from = to - shownHistory.span_s;
  const states = (isLive ? livePoints : shownHistory.points).map((point) => ({ ...point, at_s: start + point.at_s }));
  // The mean of a period stands in its middle.
  const points = states.map((point) => [step ? Math.min(point.at_s + step / 2, to) : point.at_s, point]);
  const events = logEvents.filter(({ kind, time_s: at }) => MARKS[kind] && at >= from && at <= to).map(({ kind, time_s: at }) => ({ at, mark: MARKS[kind][0], colour: MARKS[kind][1] }));
  const gap = step ? 1.6 * step : LIVE_GAP_S;
  const limits = (lastState && lastState.limits) || {};
  text("period", periodOf(from, to));
  drawChart("error-panel", from, to, errorSeries(points, "", "um"), { gap, events, low: 0 }, 1);
  const hasAxis = points.some(([, point]) => isNumber(point.error_axis_urad));
  element("axis-panel").hidden = !hasAxis;
  if (hasAxis) drawChart("axis-panel", from, to, errorSeries(points, "_axis", "urad"), { gap, events, low: 0 }, 1);
  for (const unit of ["um", "urad"]) {
    const series = byName(points, `correction_${unit}`, `correction_range_${unit}`);
    element(`${unit}-panel`).hidden = unit === "urad" && series.length === 0;
    const [limit, warn] = [limits[`limit_${unit}`], limits[`warn_${unit}`]];
    const notes = [["warning", warn, WARN], ["limit", limit, LIMIT]].filter(([, value]) => isNumber(value)).map(([said, value, tint]) => [tint, said, `±${value}`]);
    if (!element(`${unit}-panel`).hidden) drawChart(`${unit}-panel`, from, to, series, { gap, events, limits: limitLines(limit, warn), isSigned: true }, 1, notes);
  }
  const degc = byName(points, "temperatures_degc");
  element("degc-panel").hidden = degc.length === 0;
  const [coldest, hottest] = limits.range_degc || [];
  const valid = isNumber(hottest) ? [{ value: coldest, colour: LIMIT, isBand: true, isLower: true }, { value: hottest, colour: LIMIT, isBand: true }] : [];
  const range = valid.length ? [[LIMIT, "valid", `${coldest} to ${hottest}`.replaceAll("-", "−")]] : [];
  if (degc.length) drawChart("degc-panel", from, to, degc, { gap, events, limits: valid }, 2, range);
  // A ribbon without marks and one with marks have the same height.
  drawRibbon(element("states"), from, to, states, gap, events.length ? events : [{ at: -Infinity, mark: "", colour: "" }]);
}

/** "12:04 to 12:06", "11-02 12:06 to 12-02 12:06". */
function periodOf(from, to) {
  const shown = (at) => {
    const date = new Date(at * 1000);
    const day = `${two(date.getMonth() + 1)}-${two(date.getDate())} `;
    return `${to - from > 43200 ? day : ""}${two(date.getHours())}:${two(date.getMinutes())}`;
  };
  return `${shown(from)} to ${shown(to)}`;
}

/** "without → with correction, before alignment: now 12.3 → 0.8 µm, average of the trend 10.1 → 0.9 µm, −91 %". Small errors get no percentage. */
function inWords(now, without, with_, unit) {
  if (!isNumber(now[without])) return "unknown: a position is missing";
  if (now.isIdle) return `now ${fixed(now[without], 1)} ${unit} without correction; none is applied`;
  if (!isNumber(now[with_])) return `now ${fixed(now[without], 1)} ${unit} without correction; the residual is unknown because the correction is not confirmed`;
  const corrected = livePoints.filter((point) => isNumber(point[without]) && isNumber(point[with_]));
  const [b, a] = [without, with_].map((key) => corrected.reduce((sum, point) => sum + point[key], 0) / corrected.length);
  const percent = b > LEAST_FOR_PERCENT_UM ? `, ${signed(100 * (a / b - 1), 0)} %` : "";
  return `without → with correction, before alignment: now ${fixed(now[without], 1)} → ${fixed(now[with_], 1)} ${unit}, 2-min average ${fixed(b, 1)} → ${fixed(a, 1)} ${unit}${percent}`;
}

function showReduction(state, now) {
  if (state.state === "unknown") {
    for (const id of ["reduction", "axis-reduction"]) text(id, "unknown: the control thread does not respond");
    return;
  }
  const what = state.simulated ? " (of the simulated machine)" : " (by the model; the true residual needs a measurement)";
  text("reduction", inWords(now, "error_um", "residual_um", "µm") + what);
  if (isNumber(now.error_axis_urad)) text("axis-reduction", inWords(now, "error_axis_urad", "residual_axis_urad", "µrad") + " (by the model)");
}

async function refreshLog() {
  try {
    const response = await fetch(`/api/log?count=${LOG_COUNT}`, { headers: headers(), cache: "no-store" });
    if (!response.ok) return;
    logEvents = (await response.json()).events;
    showLog();
    showAdvice();
    drawAll();
  } catch {
    // The stream reports that the gateway is gone.
  }
}

/** What to do about the present state, in the banner: the advice of the event at which it began. */
function showAdvice() {
  const began = logEvents.find((event) => STATE_KINDS.includes(event.kind));
  text("advice", lastState && began && began.kind === lastState.state ? (began.advice || []).join(" ") : "");
}

function showLog() {
  const list = element("events"), shown = logEvents.slice(0, eventsShown);
  while (list.children.length > shown.length) list.lastChild.remove();
  shown.forEach((event, index) => {
    const item = list.children[index] || make("li", "", list);
    if (item.dataset.seq === String(event.seq)) return;
    item.dataset.seq = event.seq;
    item.dataset.kind = event.kind;
    const date = new Date(event.time_s * 1000);
    const day = date.toDateString() === new Date().toDateString() ? "" : `${date.getFullYear()}-${two(date.getMonth() + 1)}-${two(date.getDate())} `;
    item.replaceChildren();
    make("time", "", item, `${day}${two(date.getHours())}:${two(date.getMinutes())}:${two(date.getSeconds())}`);
    const said = make("div", "", item, event.text);
    if (event.who) make("span", "who", said, ` (${event.who})`);
    for (const advice of event.advice || []) make("div", "advice", said, advice);
  });
  element("more").hidden = logEvents.length <= eventsShown;
}

for (const span of SPANS) {
  const button = make("button", "", element("spans"), span[1]);
  button.value = span[0];
  button.ariaPressed = String(span[0] === LIVE_S);
  button.addEventListener("click", () => choose(span));
}
for (const [mark, tint, said] of Object.values(MARKS)) {
  const shown = make("span", "", element("marks"));
  make("b", "", shown, mark).style.color = tint;
  shown.append(` ${said}`);
}
for (const [states, said] of [["compensating", "corrects"], ["arming", "ramps"], ["holding", "holds"], ["disarmed", "disarmed"], ["faulted", "fault, unknown"]]) {
  make("span", "key", element("marks"), said).style.setProperty("--key", STATE_COLOURS[states]);
}
element("more").addEventListener("click", () => {
  eventsShown = LOG_COUNT;
  showLog();
});
window.addEventListener("resize", drawAll);
setInterval(refreshLog, LOG_EVERY_MS);

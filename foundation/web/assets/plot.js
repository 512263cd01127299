"use strict";
// Drawing on canvases: lines and states over time, bars, a map and its scale. Every function takes a canvas and plain numbers.

const isNumber = (value) => typeof value === "number" && Number.isFinite(value);
const two = (value) => String(value).padStart(2, "0");
// Distinguishable without red-green vision, on light and on dark backgrounds.
const COLOURS = ["#d55e00", "#009e73", "#3b8fd6", "#dd9500", "#cc79a7", "#56b4e9", "#a0743c", "#8a8f00", "#7b8794"];
const STATE_COLOURS = { compensating: "#009e73", arming: "#3b8fd6", "ramping-out": "#3b8fd6", holding: "#c77700", faulted: "#b3261e", disarmed: "#7b8794" };

let ink = "#10181f", line = "#c3ccd4", soft = "#52606d";

/** Takes the colours of the page, which may be light or dark. */
function takeColours() {
  const style = getComputedStyle(document.documentElement);
  const of = (name, otherwise) => style.getPropertyValue(name).trim() || otherwise;
  [ink, line, soft] = [of("--ink", ink), of("--line", line), of("--soft", soft)];
}

/** A context in CSS pixels, cleared; its size. */
function surface(canvas) {
  takeColours();
  const ratio = window.devicePixelRatio || 1;
  const { clientWidth: width, clientHeight: height } = canvas;
  if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
    canvas.width = Math.round(width * ratio);
    canvas.height = Math.round(height * ratio);
  }
  const context = canvas.getContext("2d");
  context.setTransform(ratio, 0, 0, ratio, 0, 0);
  context.clearRect(0, 0, width, height);
  context.font = "14px system-ui, sans-serif";
  return { context, width, height };
}

/** A round number that is not smaller: 1, 2 or 5 times a power of ten. */
function roundUp(value, steps = [1, 2, 5, 10]) {
  const power = 10 ** Math.floor(Math.log10(Math.max(value, 1e-9)));
  return steps.map((step) => step * power).find((step) => step >= value * 0.999);
}

/** Steps of an axis of time, s: round ones by the clock. */
const TIME_STEPS = [10, 30, 60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400, 172800, 432000, 604800, 1209600, 2592000];

/** Round times within a span (s since 1970), by the clock of this computer: {at, text, isDay}. */
function timeTicks(from, to, most) {
  const step = TIME_STEPS.find((one) => (to - from) / one <= most) || TIME_STEPS[TIME_STEPS.length - 1];
  const shift = -60 * new Date(from * 1000).getTimezoneOffset();
  const made = [];
  for (let at = Math.ceil((from + shift) / step) * step - shift; at <= to; at += step) {
    const date = new Date(at * 1000), seconds = step < 60 ? `:${two(date.getSeconds())}` : "";
    const isDay = step >= 86400 || (date.getHours() === 0 && date.getMinutes() === 0 && date.getSeconds() === 0);
    made.push({ at, isDay, text: isDay ? `${two(date.getMonth() + 1)}-${two(date.getDate())}` : `${two(date.getHours())}:${two(date.getMinutes())}${seconds}` });
  }
  return made;
}

/** The place of an axis of time in its canvas, so that all charts of a period line up. */
const TIME_LEFT = 52, TIME_RIGHT = 8;
/** Maximum number of steps of a scale of values, but for its rounded ends. */
const MOST_STEPS = 5.2;
const timeScale = (width, from, to) => (at) => TIME_LEFT + (width - TIME_LEFT - TIME_RIGHT) * (at - from) / (to - from);

/**
 * Lines over time, from `from` to `to` (s since 1970), each {name, colour, points: [[s, value or null, lowest, highest]]}; between lowest
 * and highest, where given, lies a band. A gap of time is a gap. `limits` are {value, colour, isBand, isLower}: a line, shown where the values come
 * near it; with `isBand` all beyond it is tinted, below a lower limit and above any other. `events` are {at, colour}. `low` is the lowest end of the scale.
 */
function drawHistory(canvas, from, to, series, gap, { limits = [], events = [], low: least = Infinity } = {}) {
  const { context, width, height } = surface(canvas);
  const bottom = height - 22, top = 8;
  const values = series.flatMap((one) => one.points.flatMap((point) => point.slice(1))).filter(isNumber);
  if (values.length === 0) {
    context.fillStyle = soft;
    context.textAlign = "center";
    context.fillText("no data in this period", width / 2, height / 2);
    return;
  }
  let [low, high] = [Math.min(least, ...values), Math.max(...values)];
  for (const { value, isLower } of limits) {
    const margin = 0.5 * Math.abs(value);
    if (isLower && low < value + margin) low = Math.min(low, value - 0.04 * margin);
    if (!isLower && high > value - margin) high = Math.max(high, value + 0.04 * margin);
  }
  const step = roundUp(Math.max(high - low, 0.4) / MOST_STEPS);
  [low, high] = [Math.floor(low / step) * step, Math.ceil(high / step) * step];
  if (low === high) high = low + step;
  const x = timeScale(width, from, to);
  const y = (value) => bottom - (bottom - top) * (value - low) / (high - low);
  context.save();
  context.beginPath();
  context.rect(TIME_LEFT, top, width - TIME_LEFT, bottom - top);
  context.clip();
  for (const { value, colour, isBand, isLower } of limits) {
    if (!isBand) continue;
    context.globalAlpha = 0.16;
    context.fillStyle = colour;
    context.fillRect(TIME_LEFT, isLower ? y(value) : top, width - TIME_LEFT, isLower ? bottom - y(value) : y(value) - top);
  }
  context.restore();
  context.strokeStyle = line;
  context.fillStyle = soft;
  context.lineWidth = 1;
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (let value = low; value <= high + step / 2; value += step) {
    context.beginPath();
    context.moveTo(TIME_LEFT, y(value));
    context.lineTo(width, y(value));
    context.stroke();
    context.fillText(String(+value.toPrecision(4)).replace("-", "−"), TIME_LEFT - 6, y(value));
  }
  drawTimes(context, timeTicks(from, to, (width - TIME_LEFT) / 70), x, top, bottom, width);
  context.save();
  context.beginPath();
  context.rect(TIME_LEFT, 0, width - TIME_LEFT, height);
  context.clip();
  for (const one of series) drawBand(context, one, x, y, gap);
  for (const one of series) drawSeries(context, one, x, y, gap);
  context.setLineDash([7, 5]);
  context.lineWidth = 1.5;
  for (const { value, colour } of limits) {
    if (value < low || value > high) continue;
    context.strokeStyle = colour;
    context.beginPath();
    context.moveTo(TIME_LEFT, y(value));
    context.lineTo(width, y(value));
    context.stroke();
  }
  context.setLineDash([2, 3]);
  for (const { at, colour } of events) {
    context.strokeStyle = colour;
    context.beginPath();
    context.moveTo(x(at), top);
    context.lineTo(x(at), bottom);
    context.stroke();
  }
  context.restore();
}

function drawSeries(context, { points, colour }, x, y, gap) {
  context.strokeStyle = colour;
  context.lineWidth = 2;
  context.beginPath();
  let before = null;
  for (const [at, value] of points) {
    if (!isNumber(value)) {
      before = null;
      continue;
    }
    if (before !== null && at - before <= gap) context.lineTo(x(at), y(value));
    else {
      context.moveTo(x(at) - 1, y(value));
      context.lineTo(x(at), y(value));
    }
    before = at;
  }
  context.stroke();
}

/** The band from the lowest to the highest value of each point. */
function drawBand(context, { points, colour }, x, y, gap) {
  context.fillStyle = colour;
  context.globalAlpha = 0.2;
  let run = [];
  const end = () => {
    if (run.length > 1) {
      context.beginPath();
      for (const [at, , , highest] of run) context.lineTo(x(at), y(highest));
      for (const [at, , lowest] of run.reverse()) context.lineTo(x(at), y(lowest));
      context.fill();
    }
    run = [];
  };
  for (const point of points) {
    const isKnown = isNumber(point[2]) && isNumber(point[3]);
    if (!isKnown || (run.length && point[0] - run[run.length - 1][0] > gap)) end();
    if (isKnown) run.push(point);
  }
  end();
  context.globalAlpha = 1;
}

/** The axis of time: a mark and its time by the clock, days with their date. */
function drawTimes(context, marks, x, top, bottom, width) {
  context.textBaseline = "alphabetic";
  context.textAlign = "center";
  for (const { at, text, isDay } of marks) {
    context.strokeStyle = line;
    context.beginPath();
    context.moveTo(x(at), isDay ? top : bottom);
    context.lineTo(x(at), bottom + 5);
    context.stroke();
    context.fillStyle = isDay ? ink : soft;
    context.fillText(text, Math.min(Math.max(x(at), 20), width - 30), bottom + 18);
  }
}

/**
 * The states over time as a ribbon, empty where none was received. A point holds until the next one; after a gap for a third of it. Events
 * {at, colour, mark} stand below the ribbon with their mark.
 */
function drawRibbon(canvas, from, to, points, gap, events = []) {
  const { context, width, height } = surface(canvas);
  const x = timeScale(width, from, to);
  const bottom = height - 22 - (events.length ? 18 : 0);
  context.lineWidth = 1;
  context.strokeStyle = line;
  context.strokeRect(TIME_LEFT, 4, width - TIME_LEFT - TIME_RIGHT, bottom - 4);
  points.forEach((point, index) => {
    const next = points[index + 1];
    const end = next && next.at_s - point.at_s <= gap ? next.at_s : point.at_s + gap / 3;
    const left = Math.max(TIME_LEFT, x(point.at_s));
    context.fillStyle = STATE_COLOURS[point.state] || "#b3261e";
    if (end > from) context.fillRect(left, 4, Math.max(1, x(Math.min(end, to)) - left + 0.5), bottom - 4);
  });
  drawTimes(context, timeTicks(from, to, (width - TIME_LEFT) / 70), x, 4, height - 22, width);
  context.textAlign = "center";
  context.font = "bold 13px system-ui, sans-serif";
  let last = -Infinity;
  for (const { at, colour, mark } of [...events].sort((a, b) => a.at - b.at)) {
    // Marks that would cover one another are one.
    if (x(at) < TIME_LEFT || x(at) - last < 11) continue;
    last = x(at);
    context.fillStyle = colour;
    context.fillText(mark, last, bottom + 14);
  }
}

/** Bars over [upper edge in us, count]. */
function drawBars(canvas, bins) {
  const { context, width, height } = surface(canvas);
  const used = bins.filter((bin) => bin[1] > 0);
  if (used.length === 0) return;
  const first = Math.max(0, bins.indexOf(used[0]) - 1);
  const last = Math.min(bins.length - 1, bins.indexOf(used[used.length - 1]) + 1);
  const shown = bins.slice(first, last + 1);
  const bottom = height - 22, each = width / shown.length;
  // Roots: rare long cycles must be seen beside thousands of short ones.
  const largest = Math.sqrt(Math.max(...shown.map((bin) => bin[1])));
  context.textAlign = "center";
  shown.forEach(([edge, count], index) => {
    const tall = count === 0 ? 0 : Math.max(3, (bottom - 6) * (Math.sqrt(count) / largest));
    context.fillStyle = COLOURS[2];
    context.fillRect(index * each + 2, bottom - tall, each - 4, tall);
    context.fillStyle = soft;
    const label = edge < 1000 ? `${edge}` : `${+(edge / 1000).toPrecision(3)}k`;
    if (each > 34 || index % 2 === 0) context.fillText(label, Math.min((index + 0.5) * each, width - 20), height - 4);
  });
}

/** An empty map. */
function clearMap(canvas) {
  surface(canvas);
}

/** Light to dark, for 0 to 1. */
function shade(share) {
  const from = [237, 246, 250], to = [122, 16, 60];
  const mixed = from.map((a, i) => Math.round(a + (to[i] - a) * share));
  return `rgb(${mixed.join(",")})`;
}

/** The colours of a map with their values, from 0 to the largest. */
function drawScale(canvas, largest) {
  const { context, width, height } = surface(canvas);
  const left = 14, right = width - 48, bottom = height - 24;
  for (let px = left; px < right; px += 1) {
    context.fillStyle = shade((px - left) / (right - left));
    context.fillRect(px, 2, 1.5, bottom - 2);
  }
  context.strokeStyle = line;
  context.lineWidth = 1;
  context.strokeRect(left, 2, right - left, bottom - 2);
  context.fillStyle = ink;
  context.textAlign = "center";
  context.textBaseline = "alphabetic";
  const marks = ticks([0, largest], Math.max(2, Math.floor((right - left) / 70)));
  for (const um of marks) {
    const x = left + (right - left) * um / largest;
    context.fillRect(x - 0.5, bottom, 1, 5);
    context.fillText(String(+um.toPrecision(3)), x, height - 4);
  }
  context.textAlign = "left";
  context.fillText("µm", right + 10, (bottom + 2) / 2 + 5);
}

/** Round positions within [low, high], some `count` of them. */
function ticks([low, high], count) {
  const step = roundUp((high - low) / count);
  const first = Math.ceil(low / step);
  const last = Math.floor(high / step);
  return Array.from({ length: Math.max(0, last - first + 1) }, (_, i) => (first + i) * step);
}

/**
 * Rows of values over the travels of two axes ({name, travel}), with their positions in mm, and a cross at `here`
 * ([mm, mm] or null). Returns the value of the darkest shade, which is `scale` where that is given.
 */
function drawMap(canvas, rows, [across, up], here, scale) {
  const { context, width, height } = surface(canvas);
  const largest = scale || roundUp(Math.max(...rows.flat()), [1, 1.2, 1.5, 2, 2.5, 3, 4, 5, 6, 8, 10]);
  const left = 70, bottom = height - 40, top = 10, right = width - 14;
  const x = (mm) => left + (right - left) * (mm - across.travel[0]) / (across.travel[1] - across.travel[0]);
  const y = (mm) => bottom - (bottom - top) * (mm - up.travel[0]) / (up.travel[1] - up.travel[0]);
  const [wide, tall] = [(right - left) / rows[0].length, (bottom - top) / rows.length];
  rows.forEach((row, j) => row.forEach((value, i) => {
    context.fillStyle = shade(Math.min(1, value / largest));
    context.fillRect(left + i * wide, bottom - (j + 1) * tall, wide + 1, tall + 1);
  }));
  context.strokeStyle = line;
  context.lineWidth = 1;
  context.strokeRect(left, top, right - left, bottom - top);
  context.fillStyle = soft;
  context.textBaseline = "alphabetic";
  context.textAlign = "center";
  const number = (mm) => String(mm).replace("-", "−");
  for (const mm of ticks(across.travel, (right - left) / 55)) {
    context.fillRect(x(mm) - 0.5, bottom, 1, 5);
    context.fillText(number(mm), Math.min(x(mm), width - 18), bottom + 18);
  }
  context.fillText(`${across.name}, mm`, (left + right) / 2, height - 4);
  context.textAlign = "right";
  context.textBaseline = "middle";
  for (const mm of ticks(up.travel, (bottom - top) / 50)) {
    context.fillRect(left - 5, y(mm) - 0.5, 5, 1);
    context.fillText(number(mm), left - 8, Math.max(y(mm), 8));
  }
  context.save();
  context.translate(12, (top + bottom) / 2);
  context.rotate(-Math.PI / 2);
  context.textAlign = "center";
  context.fillText(`${up.name}, mm`, 0, 0);
  context.restore();
  if (here) {
    const [cx, cy] = [x(here[0]), y(here[1])];
    context.strokeStyle = "#fff";
    context.lineWidth = 6;
    cross(context, cx, cy);
    context.strokeStyle = ink;
    context.lineWidth = 3;
    cross(context, cx, cy);
  }
  return largest;
}

function cross(context, x, y) {
  context.beginPath();
  context.moveTo(x - 11, y);
  context.lineTo(x + 11, y);
  context.moveTo(x, y - 11);
  context.lineTo(x, y + 11);
  context.stroke();
}

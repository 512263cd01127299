"use strict";
// Drawing on canvases: lines over time, bars, a map. Every function takes a canvas and plain numbers.

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

/** Series of [seconds, value or null] over the last `span` seconds up to `now`. */
function drawLines(canvas, now, span, series) {
  const { context, width, height } = surface(canvas);
  const left = 44, bottom = height - 22;
  const largest = Math.max(1, ...series.flatMap((s) => s.points.map((p) => p[1])));
  const top = roundUp(largest);
  const x = (t) => left + (width - left - 6) * (1 - (now - t) / span);
  const y = (v) => bottom - (bottom - 8) * (v / top);
  context.lineWidth = 1;
  context.strokeStyle = line;
  context.fillStyle = soft;
  context.textBaseline = "middle";
  context.textAlign = "right";
  for (const share of [0, 0.5, 1]) {
    context.beginPath();
    context.moveTo(left, y(top * share));
    context.lineTo(width, y(top * share));
    context.stroke();
    context.fillText(String(+(top * share).toPrecision(2)), left - 6, y(top * share));
  }
  context.textAlign = "center";
  context.textBaseline = "alphabetic";
  const marks = width < 420 ? 2 : 4;
  for (let ago = 0; ago <= span; ago += span / marks) {
    context.fillText(ago === 0 ? "now" : `−${ago} s`, Math.min(Math.max(x(now - ago), left + 16), width - 18), height - 4);
  }
  for (const { points, colour } of series) {
    context.strokeStyle = colour;
    context.lineWidth = 2.5;
    context.beginPath();
    // A value that is not known leaves a gap.
    let down = false;
    for (const [t, v] of points) {
      if (v === null) {
        down = false;
      } else {
        if (down) context.lineTo(x(t), y(v));
        else context.moveTo(x(t), y(v));
        down = true;
      }
    }
    context.stroke();
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
    context.fillStyle = "#0b4f8a";
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

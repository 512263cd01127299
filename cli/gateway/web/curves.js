"use strict";
// Drawing as SVG: fitted curves with their readings and residuals, and diagonals. Every function takes plain numbers and gives
// an element.
/* global roundUp, ticks */

const SVG = "http://www.w3.org/2000/svg";
const LEFT = 52, RIGHT = 10;
/** The width of a drawing in its own units: less on a narrow screen, so that its numbers can be read there, too. */
let wide = 460;
const takeWidth = () => { wide = window.innerWidth < 640 ? 320 : 460; };

function part(name, attributes, parent) {
  const made = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(attributes)) made.setAttribute(key, value);
  if (parent) parent.append(made);
  return made;
}

function label(text, attributes, parent) {
  part("text", attributes, parent).textContent = text;
}

const minus = (text) => String(text).replace("-", "−");

/** A scale from values to places, with room for the outermost mark. */
function scale(low, high, from, to) {
  const span = high - low || 1;
  return (value) => from + (to - from) * (value - low) / span;
}

/** The ends of an axis of values: zero is on it, the ends are round, and what is next to nothing looks like it: at least `least`. */
function ends(values, least = 1) {
  const known = values.filter(Number.isFinite);
  const largest = Math.max(least, ...known.map(Math.abs));
  const step = roundUp(largest / 3);
  const low = Math.min(0, Math.floor(Math.min(...known, 0) / step) * step);
  const high = Math.max(step, Math.ceil(Math.max(...known, 0) / step) * step);
  return [low, high];
}

const path = (points, x, y) => points.map(([a, b], i) => `${i ? "L" : "M"}${x(a).toFixed(1)} ${y(b).toFixed(1)}`).join("");

/** A frame with grid and numbers: the scales of both axes. */
function frame(svg, [low, high], [bottom, top], { from, to, unit, along }) {
  const x = scale(low, high, LEFT, wide - RIGHT);
  const y = scale(bottom, top, to, from);
  // A low frame has room for its ends and zero; round numbers between them may be zero alone.
  const isLow = to - from < 100;
  const marks = isLow ? [...new Set([bottom, 0, top])] : ticks([bottom, top], Math.max(3, (to - from) / 42));
  for (const value of marks) {
    part("line", { class: Math.abs(value) < 1e-9 ? "zero" : "grid", x1: LEFT, x2: wide - RIGHT, y1: y(value), y2: y(value) }, svg);
    label(minus(+value.toPrecision(3)), { x: LEFT - 6, y: y(value) + 4, "text-anchor": "end" }, svg);
  }
  label(unit, { x: LEFT + 5, y: isLow ? from - 5 : from + 14 }, svg);
  if (along) {
    for (const value of ticks([low, high], wide < 400 ? 3 : 5)) label(minus(+value.toPrecision(6)), { x: Math.min(x(value), wide - 22), y: to + 17, "text-anchor": "middle" }, svg);
    label(along, { x: wide - RIGHT, y: to + 34, "text-anchor": "end" }, svg);
  }
  return [x, y];
}

/** A fitted curve over its readings, and what is left below it. */
function curveOf(fit) {
  takeWidth();
  const unit = fit.unit === "urad" ? "µrad" : "µm";
  const figure = document.createElement("figure");
  const caption = document.createElement("figcaption");
  caption.textContent = `${fit.error}${fit.direction ? `, ${fit.direction}` : ""} `;
  const detail = document.createElement("span");
  detail.textContent = `${fit.curve}, residual ${fit.residual_rms.toFixed(2)} ${unit} rms`;
  caption.append(detail);
  figure.append(caption);
  const keys = document.createElement("div");
  keys.className = "keys";
  const key = (name, text) => { const made = document.createElement("span"); made.className = `key ${name}`; made.textContent = text; keys.append(made); };
  key("dot", "readings");
  key("after", "new curve");
  if (fit.before.length) key("now", "in force");
  if (fit.band) key("band", "uncertainty, k = 2");
  figure.append(keys);
  const svg = part("svg", { viewBox: `0 0 ${wide} 330`, role: "img", "aria-label": `${fit.error}: readings, curve and residuals` });
  const travel = fit.fit.length > 1 ? fit.fit : fit.readings;
  const span = [Math.min(...travel.map((p) => p[0])), Math.max(...travel.map((p) => p[0]))];
  const values = [...fit.readings, ...fit.fit, ...fit.before].map((p) => p[1]).concat((fit.band || []).flatMap((p) => p.slice(1)));
  const [x, y] = frame(svg, span, ends(values), { from: 10, to: 200, unit });
  if (fit.band) {
    const back = [...fit.band].reverse();
    part("path", { class: "band", d: `${path(fit.band, x, y)}${path(back.map((p) => [p[0], p[2]]), x, y).replace("M", "L")}Z` }, svg);
  }
  if (fit.before.length) part("path", { class: "now", d: path(fit.before, x, y) }, svg);
  part("path", { class: "after", d: path(fit.fit, x, y) }, svg);
  for (const [at, value] of fit.readings) part("circle", { class: "reading", cx: x(at).toFixed(1), cy: y(value).toFixed(1), r: 3.4 }, svg);
  const [, r] = frame(svg, span, ends([fit.residual_min, fit.residual_max, -fit.residual_max, -fit.residual_min], 0.2), { from: 224, to: 292, unit: "residual", along: `${fit.error[2]}, ${fit.along === "deg" ? "°" : "mm"}` });
  for (const [at, value] of fit.residuals) {
    part("line", { class: "residual", x1: x(at).toFixed(1), x2: x(at).toFixed(1), y1: r(0).toFixed(1), y2: r(value).toFixed(1) }, svg);
    part("circle", { class: "reading", cx: x(at).toFixed(1), cy: r(value).toFixed(1), r: 2.4 }, svg);
  }
  figure.append(svg);
  return figure;
}

/** The signs in which the axes move on a diagonal of a name such as `NPP`; nothing of other names. */
const signsOf = (name) => [...name].map((sign, i) => ({ P: `+${"XYZ"[i]}`, N: `−${"XYZ"[i]}` })[sign]).filter(Boolean).join(" ");

/** The curves of each axis that moves, folded: the errors and their largest residuals stand in the summary. */
function foldedCurves(fits) {
  const groups = new Map();
  for (const fit of fits) groups.set(fit.error[2], [...(groups.get(fit.error[2]) || []), fit]);
  return [...groups].map(([axis, of]) => {
    const fold = document.createElement("details");
    fold.dataset.axis = axis;
    const summary = document.createElement("summary");
    const strong = document.createElement("strong");
    strong.textContent = axis;
    const detail = document.createElement("span");
    const largest = (unit, sign) => {
      const sizes = of.filter((fit) => fit.unit === unit).flatMap((fit) => [fit.residual_min, fit.residual_max].map(Math.abs));
      return sizes.length ? [`${Math.max(...sizes).toFixed(2)} ${sign}`] : [];
    };
    const names = [...new Set(of.map((fit) => fit.error))].join(" ");
    detail.textContent = ` ${names}; largest residual ${[...largest("um", "µm"), ...largest("urad", "µrad")].join(", ")}`;
    summary.append(strong, detail);
    const plots = document.createElement("div");
    plots.className = "plots";
    plots.append(...of.map(curveOf));
    fold.append(summary, plots);
    return fold;
  });
}

/** What the machine errs along a diagonal if the new model is right: distance, without correction, and what is left with correction
    by the model in force and by the new one. A model takes away the error that it describes. */
const leftOf = (diagonal) => diagonal.points.map(([at, inForce, byNew]) => [at, byNew, byNew - inForce, 0]);

/** A diagonal over the same values as its neighbours: `range` is that of all of them. */
function diagonalOf(diagonal, range) {
  takeWidth();
  const figure = document.createElement("figure");
  const caption = document.createElement("figcaption");
  caption.textContent = `${diagonal.name} `;
  const left = leftOf(diagonal), last = left[left.length - 1];
  const detail = document.createElement("span");
  const signs = signsOf(diagonal.name);
  const [without, now, after] = last.slice(1).map((value) => minus((value.toFixed(1) === "-0.0" ? 0 : value).toFixed(1)));
  detail.textContent = `${signs ? `${signs}; ` : ""}${last[0].toFixed(0)} mm long; at its end without → with correction: ${without} → ${now} µm by the model in force, ${without} → ${after} µm by the new one`;
  caption.append(detail);
  figure.append(caption);
  const svg = part("svg", { viewBox: `0 0 ${wide} 220`, role: "img", "aria-label": `diagonal ${diagonal.name}` });
  const [x, y] = frame(svg, [0, last[0]], range, { from: 10, to: 180, unit: "µm", along: "along the diagonal, mm" });
  for (const [place, name] of [[1, "before"], [2, "now"], [3, "after"]]) part("path", { class: name, d: path(left.map((p) => [p[0], p[place]]), x, y) }, svg);
  figure.append(svg);
  return figure;
}

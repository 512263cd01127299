"use strict";
// Diagonals of the work space as SVG. Every function takes plain numbers and returns an element.
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

/** The ends of an axis of values: zero is on it, the ends are round, and it is at least 1 long. */
function ends(values) {
  const known = values.filter(Number.isFinite);
  const largest = Math.max(1, ...known.map(Math.abs));
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
  for (const value of ticks([bottom, top], Math.max(3, (to - from) / 42))) {
    part("line", { class: Math.abs(value) < 1e-9 ? "zero" : "grid", x1: LEFT, x2: wide - RIGHT, y1: y(value), y2: y(value) }, svg);
    label(minus(+value.toPrecision(3)), { x: LEFT - 6, y: y(value) + 4, "text-anchor": "end" }, svg);
  }
  label(unit, { x: LEFT + 5, y: from + 14 }, svg);
  for (const value of ticks([low, high], wide < 400 ? 3 : 5)) label(minus(+value.toPrecision(6)), { x: Math.min(x(value), wide - 22), y: to + 17, "text-anchor": "middle" }, svg);
  label(along, { x: wide - RIGHT, y: to + 34, "text-anchor": "end" }, svg);
  return [x, y];
}

/** The signs in which the axes move on a diagonal of a name such as `NPP`; nothing of other names. */
const signsOf = (name) => [...name].map((sign, i) => ({ P: `+${"XYZ"[i]}`, N: `−${"XYZ"[i]}` })[sign]).filter(Boolean).join(" ");

/** What the machine errs along a diagonal if the new model is right: distance, without correction, and what is left with correction
    by the active and by the new model. A model removes the error that it describes. */
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
  detail.textContent = `${signs ? `${signs}; ` : ""}${last[0].toFixed(0)} mm long; at its end without → with correction: ${without} → ${now} µm by the active model, ${without} → ${after} µm by the new one`;
  caption.append(detail);
  figure.append(caption);
  const svg = part("svg", { viewBox: `0 0 ${wide} 220`, role: "img", "aria-label": `diagonal ${diagonal.name}` });
  const [x, y] = frame(svg, [0, last[0]], range, { from: 10, to: 180, unit: "µm", along: "along the diagonal, mm" });
  for (const [place, name] of [[1, "before"], [2, "now"], [3, "after"]]) part("path", { class: name, d: path(left.map((p) => [p[0], p[place]]), x, y) }, svg);
  figure.append(svg);
  return figure;
}

"use strict";
// What the dashboard and the page of the model share: the token, the parts of a page, and buttons that are held.
/* global checkToken */

const HOLD_MS = 1000, ANSWER_MS = 5000;
const element = (id) => document.getElementById(id);

// The token stays in this tab only; it is never in an address.
const token = () => sessionStorage.getItem("token") || "";
const headers = () => (token() ? { Authorization: `Bearer ${token()}` } : {});

const fixed = (value, digits) => (value === null || value === undefined ? "–" : value.toFixed(digits).replace("-", "−"));

function text(id, value) {
  const target = element(id);
  if (target.textContent !== value) target.textContent = value;
}

/** An answer that holds for a moment only. */
function answerBriefly(said) {
  text("answer", said);
  setTimeout(() => { if (element("answer").textContent === said) text("answer", ""); }, ANSWER_MS);
}

function make(tag, name, parent, said) {
  const made = document.createElement(tag);
  if (name) made.className = name;
  if (said !== undefined) made.textContent = said;
  parent.append(made);
  return made;
}

/** How far a change moves the correction, in lines. */
function movesOf(answer) {
  if (answer.worst_corner_um === null) return ["The machine has other axes than before: the change of the correction is unknown."];
  // Rotary axes are omitted if none is corrected.
  return [[answer.worst_corner_um, answer.confirm_um, "µm"], [answer.worst_corner_urad, answer.confirm_urad, "µrad"]]
    .filter(([worst]) => worst !== null)
    .map(([worst, least, unit]) => `At the worst point of the work space the correction changes by ${fixed(worst, 1)} ${unit}` + (least === null ? "." : ` (allowed without confirmation: ${least} ${unit}).`));
}

/** A press counts after a second: a glove or a tool that touches the glass does nothing. `what` is evaluated when the press begins, so
    that it refers to what is shown then. */
function guard(button, act, what = () => null) {
  let timer = null;
  const end = (event) => {
    if (timer && event && (event.type === "pointerup" || event.type === "keyup")) answerBriefly(`hold ${button.firstChild.textContent} for 1 s`);
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

element("token-form").addEventListener("submit", (event) => {
  event.preventDefault();
  sessionStorage.setItem("token", element("token").value.trim());
  element("token").value = "";
  checkToken();
});

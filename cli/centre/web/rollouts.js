"use strict";
// Roll-outs: progress, stops, and the form that starts one.

const ROLLOUTS_EVERY_MS = 2000;
const STEP_COLOURS = { done: "#0b6e3a", soaking: "#2f7fd0", sent: "#7cb8f2", "needs-confirmation": "#c77700", out: "#b3261e" };

/** Largest change of the axis positions, and signs of another machine, as reported by the machine. */
const movesOf = ({ worst_um: um, worst_urad: urad, differences }) => [[um && `${um} µm`, urad && `${urad} µrad`].filter(Boolean).join(" and ") || "a distance that is not finite", ...(differences || [])].join("; ");

/** Names of the steps on the page. */
const STEP_NAMES = { waiting: "not sent yet", sent: "sent", "needs-confirmation": "needs confirmation", soaking: "observed", done: "done", out: "dropped out" };

function stepWords(turn) {
  if (turn.step === "sent") return `Version ${turn.version} was sent; no answer for ${lasting(turn.waited_s)}.`;
  if (turn.step === "soaking") return `Version ${turn.version} is active, observed for ${lasting(turn.soaked_s)}${turn.idle_s > 0 ? `, without compensation for ${lasting(turn.idle_s)}` : ""}; mean residual ${turn.known_s > 0 ? `${fixed(turn.residual_um, 1)} µm` : "unknown"}${isNumber(turn.before_um) ? `, before the change ${fixed(turn.before_um, 1)} µm` : ""}.`;
  if (turn.step === "done") return `Version ${turn.version} is active.`;
  if (turn.step === "out") return `${turn.why.slice(0, 1).toUpperCase()}${turn.why.slice(1)}${turn.excused ? " (the roll-out was resumed in spite of it)" : ""}.`;
  if (turn.step === "needs-confirmation") return `Version ${turn.version} would move the axes by up to ${movesOf(turn)}. It becomes active when a user confirms it: check the map of the model first.`;
  return "Nothing was sent to it yet.";
}

/** Groups of the machines of a roll-out: description, and condition on the step. */
const HOLDS = [
  ["have activated the new model, and keep it until a user decides", (turn) => turn.step === "soaking" || turn.step === "done"],
  ["received the new model and dropped out; the page of each shows the active version", (turn) => turn.step === "out" && turn.version !== null],
  ["wait for confirmation, and keep the previous model", (turn) => turn.step === "needs-confirmation"],
  ["received the new model, and have not answered yet", (turn) => turn.step === "sent"],
  ["received nothing, or a version that was withdrawn, and keep the previous model", (turn) => turn.step === "waiting" || (turn.step === "out" && turn.version === null)],
];

/** A stopped roll-out: consequences, state of each machine, and options. */
function stoppedPanel(rollout, wish) {
  const links = (turns) => turns.slice(0, 30).flatMap((turn, index) => [index ? ", " : "", make("a", { href: `#machine/${encodeURIComponent(turn.machine)}`, textContent: turn.machine })]);
  const late = (turn) => rollout.in_force_on.includes(turn.machine) && !["soaking", "done"].includes(turn.step);
  const groups = HOLDS.map(([words, belongs]) => [words, rollout.turns.filter((turn) => belongs(turn) && !late(turn))]);
  groups.splice(1, 0, ["report the new model as active although they did not answer in time, and keep it until a user decides", rollout.turns.filter(late)]);
  const ways = may("engineer") ? [
    [wish("Resume", { wish: "resume" }), "The dropouts are ignored, and the next machines receive the model. Choose this only if you know that the model is not the cause."],
    [wish("Stop for good", { wish: "abort" }, "stop"), "Nothing more is sent. Then each machine with the new model can return to the previous one or keep this one: use the buttons in the list of machines."],
  ] : [];
  return make("div", { class: "lead" },
    make("p", { textContent: "The roll-out has stopped, and nothing more is sent. Versions that are not active yet are withdrawn. Machines with the new model keep it and are listed as suspect until a user decides." }),
    make("ul", {}, ...groups.filter(([, turns]) => turns.length).map(([words, turns]) => make("li", {}, make("strong", { textContent: `${turns.length} of ${rollout.turns.length} ` }), `${words}: `, ...links(turns), turns.length > 30 ? " …" : ""))),
    ways.length ? make("div", { class: "ways" }, ...ways.flatMap(([button, words]) => [button, make("p", { textContent: words })])) : make("p", { class: "soft", textContent: "An engineer must decide how to continue." }));
}

/** Buttons for a machine with the model of a stopped or aborted roll-out. */
function decide(rollout, turn, said) {
  // A machine may have activated the model although its answer was late or the version was withdrawn: the reported version counts.
  const has = rollout.in_force_on.includes(turn.machine) || turn.step === "done" || turn.step === "soaking" || (turn.step === "out" && turn.version !== null);
  if (turn.kept_by) return make("span", { class: "soft", textContent: `kept by ${turn.kept_by}` });
  if (!has || !may("engineer") || !["aborted", "stopped"].includes(rollout.phase.is)) return "";
  const keep = make("button", { textContent: "Keep this model", onclick: () => act(keep, said, () => post(`/api/rollouts/${rollout.id}/keep`, { machine: turn.machine }), "applied within a second") });
  // Until the roll-out is over, its machines cannot be in another one.
  if (rollout.phase.is === "stopped") return keep;
  const back = make("button", { textContent: "Back to the previous model", onclick: () => act(back, said, () => post(`/api/machines/${encodeURIComponent(turn.machine)}/back`, {}), "a roll-out of it was started") });
  return make("div", { class: "buttons" }, back, keep);
}

function rolloutPanel(rollout) {
  const { id, turns } = rollout;
  const { is: phase } = rollout.phase;
  const said = make("span", { class: "said", role: "status" });
  const wish = (words, body, kind) => {
    const button = make("button", { class: kind || "", textContent: words, onclick: () => act(button, said, () => post(`/api/rollouts/${id}`, body), "applied within a second") });
    return button;
  };
  const buttons = [];
  if (may("engineer")) {
    if (phase === "running") buttons.push(wish("Pause", { wish: "pause" }));
    if (phase === "paused") buttons.push(wish("Resume", { wish: "resume" }));
    if (!["aborted", "done", "stopped"].includes(phase)) buttons.push(wish("Stop for good", { wish: "abort" }, "stop"));
  }
  const counts = Object.keys(STEP_COLOURS).map((step) => [step, turns.filter((turn) => turn.step === step).length]).filter(([, count]) => count);
  const bar = make("div", { class: "bar", role: "img", ariaLabel: counts.map(([step, count]) => `${count} ${step}`).join(", ") }, ...counts.map(([step, count]) => {
    const part = make("i", {});
    part.style.width = `${100 * count / turns.length}%`;
    part.style.background = STEP_COLOURS[step];
    return part;
  }));
  const { why: cause, by } = rollout.phase;
  const why = cause || (by ? `${phase === "paused" ? "paused" : "ended"} by ${by}` : "");
  const rows = turns.map((turn) => make("tr", {}, cell(make("a", { href: `#machine/${turn.machine}`, textContent: turn.machine })), cell(turn.wave === 0 ? "first" : String(turn.wave)), cell(badge(turn.step, STEP_NAMES[turn.step] || turn.step)), cell(stepWords(turn), { class: "text" }), cell(turn.step === "needs-confirmation" && may("engineer") && ["running", "paused"].includes(phase) ? wish("Confirm", { wish: "confirm", machine: turn.machine, hash: turn.hash }) : decide(rollout, turn, said))));
  const list = table(["machine", "wave", "step", "details", ""], rows.slice(0, 200));
  return make("section", { class: "panel", data: { rollout: id } },
    make("div", { class: "head" }, make("h2", { textContent: `Roll-out ${id}` }), badge(phase, phase === "aborted" ? "ended" : phase), make("a", { href: `#model/${rollout.model}`, textContent: short(rollout.model) }), make("span", { class: "soft", textContent: `${clock(rollout.since_s)}, ${rollout.by}; ${turns.filter((turn) => turn.step === "done").length} of ${turns.length} done` })),
    why ? make("p", { class: phase === "stopped" ? "bad" : "soft", textContent: why }) : "", bar,
    phase === "stopped" ? stoppedPanel(rollout, wish) : "",
    turns.length > 8 ? make("details", {}, make("summary", { textContent: "Machines" }), list) : list,
    make("div", { class: "buttons" }, ...buttons, said));
}

function rolloutsPage(page) {
  const place = make("div", { class: "lines" });
  page.replaceChildren(make("div", { class: "head" }, make("h1", { textContent: "Roll-outs" }), may("engineer") ? make("a", { href: "#rollout/", textContent: "Start a roll-out" }) : null), place);
  const shown = new Map();
  return repeat(async () => {
    const rollouts = await get("/api/rollouts");
    if (rollouts.length === 0) place.replaceChildren(make("p", { class: "soft", textContent: "No roll-outs yet." }));
    rollouts.forEach((rollout, index) => {
      const key = JSON.stringify(rollout);
      const known = shown.get(rollout.id);
      if (known && known.key === key) return;
      const made = rolloutPanel(rollout);
      const open = known && known.made.querySelector("details")?.open;
      if (open) made.querySelector("details").open = true;
      if (known) known.made.replaceWith(made);
      else place.insertBefore(made, place.children[index] || null);
      shown.set(rollout.id, { key, made });
    });
  }, ROLLOUTS_EVERY_MS);
}

async function startPage(page, checksum) {
  const [models, { machines }, rules] = await Promise.all([get("/api/models"), get("/api/overview"), get("/api/rules")]);
  const model = choose(models.map((one) => [one.sha256, `${one.name || "model"} ${short(one.sha256)}, ${one.structure}`]), checksum || (models[0] || {}).sha256);
  const choices = make("div", { class: "choices" });
  const same = (one, other) => one.split(/\s+/).join(" ") === other.split(/\s+/).join(" ");
  const number = (value, properties = {}) => make("input", { type: "number", step: "any", min: 0, value, ...properties });
  const soak = number(rules.soak_s / 60), answer = number(rules.answer_s / 60), tolerate = number(rules.tolerate, { step: 1 }), ratio = number(rules.residual_ratio, { min: 1 }), rise = number(rules.residual_um);
  const first = number(1, { step: 1, min: 1 });
  const waves = make("input", { value: rules.waves.join(" ") });
  const said = make("p", { class: "said", role: "status" });
  const fill = () => {
    const chosen = models.find((one) => one.sha256 === model.value);
    const fit = machines.filter((row) => chosen && same(row.structure, chosen.structure));
    choices.replaceChildren(...fit.map((row) => make("label", { class: "row" }, make("input", { type: "checkbox", value: row.machine, checked: fit.length === 1 }), row.machine)));
    if (fit.length === 0) choices.append(make("p", { class: "soft", textContent: "No machine has the structure of this model." }));
  };
  model.addEventListener("change", fill);
  fill();
  const all = make("button", { type: "button", class: "quiet", textContent: "Choose all", onclick: () => {
    for (const box of choices.querySelectorAll("input")) box.checked = true;
  } });
  const button = make("button", { class: "main", textContent: "Start the roll-out" });
  page.replaceChildren(make("div", { class: "head" }, make("h1", { textContent: "Start a roll-out" })), make("p", { class: "soft", textContent: "The canaries receive the model first and are observed; then the other machines follow in waves. If a stop rule applies, the roll-out stops, and a user decides." }), make("form", { class: "panel", onsubmit: (event) => {
    event.preventDefault();
    const chosen = [...choices.querySelectorAll("input:checked")].map((box) => box.value);
    act(button, said, () => post("/api/rollouts", {
      model: model.value, machines: chosen, canaries: chosen.slice(0, first.valueAsNumber || 1),
      rules: { waves: numbersIn(waves.value), soak_s: soak.valueAsNumber * 60, answer_s: answer.valueAsNumber * 60, tolerate: tolerate.valueAsNumber, residual_ratio: ratio.valueAsNumber, residual_um: rise.valueAsNumber },
    }), () => {
      location.hash = "#rollouts";
    });
  } },
  make("div", { class: "fields one" }, field("Model", model, "Name, beginning of the checksum and structure of each model.")),
  make("h2", { textContent: "Machines: those with the structure of the model" }), make("p", { class: "soft", textContent: "A model describes the errors of one machine. Send it to several only if you know that it is valid for each." }), choices, make("div", { class: "buttons" }, all),
  make("h2", { textContent: "The first machines (canaries)" }),
  make("div", { class: "fields" },
    field("Number of canaries", first, "The first in the list above, in addition to machines registered as canaries. Such as 1."),
    field("Observation time of each machine, min", soak, "Time that it must compensate with the model and send conditions before the next ones receive it. Such as 10."),
    field("Answer timeout, min", answer, "A canary that does not answer in time stops the roll-out. Such as 5.")),
  make("h2", { textContent: "The other machines" }),
  make("div", { class: "fields" },
    field("Waves, % of the other machines", waves, "Cumulative percentage at the end of each wave, ascending to 100. Such as 25 100."),
    field("Tolerated dropouts", tolerate, "Maximum number of machines that may drop out before the roll-out stops. Such as 0.")),
  make("h2", { textContent: "Residual limits" }),
  make("p", { class: "soft", textContent: "The residual is the error that remains after the correction according to the model, as reported by the gateway. The roll-out stops if its mean exceeds both limits." }),
  make("div", { class: "fields" },
    field("Limit as a multiple of the previous residual", ratio, "Such as 1.5."),
    field("Limit above the previous residual, µm", rise, "Such as 2.")),
  make("div", { class: "buttons" }, button, said)));
}

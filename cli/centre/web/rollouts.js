"use strict";
// Roll-outs: the first machines, then the others, and what stops them.

const ROLLOUTS_EVERY_MS = 2000;
const STEP_COLOURS = { done: "#0b6e3a", soaking: "#2f7fd0", sent: "#7cb8f2", "needs-confirmation": "#c77700", out: "#b3261e" };

/** How far a change moves the axes, as the machine tells it. */
const movesOf = ({ worst_um: um, worst_urad: urad }) => [um && `${um} µm`, urad && `${urad} µrad`].filter(Boolean).join(" and ") || "a distance that is not finite";

/** What each step is called on the page. */
const STEP_NAMES = { waiting: "not sent yet", sent: "sent", "needs-confirmation": "needs confirmation", soaking: "watched", done: "done", out: "out" };

function stepWords(turn) {
  if (turn.step === "sent") return `Version ${turn.version} was sent; its answer has been awaited for ${lasting(turn.waited_s)}.`;
  if (turn.step === "soaking") return `Version ${turn.version} is in force. The machine has been watched for ${lasting(turn.soaked_s)}${turn.idle_s > 0 ? `, and has not compensated for ${lasting(turn.idle_s)}` : ""}; its mean residual is ${turn.known_s > 0 ? `${fixed(turn.residual_um, 1)} µm` : "unknown"}${isNumber(turn.before_um) ? `, before it was ${fixed(turn.before_um, 1)} µm` : ""}.`;
  if (turn.step === "done") return `Version ${turn.version} is in force.`;
  if (turn.step === "out") return `${turn.why.slice(0, 1).toUpperCase()}${turn.why.slice(1)}${turn.excused ? " (the roll-out was let go on in spite of it)" : ""}.`;
  if (turn.step === "needs-confirmation") return `Version ${turn.version} would move the axes by up to ${movesOf(turn)}. It is not in force before a person confirms it: look at the map of the model first.`;
  return "It was sent nothing yet.";
}

/** Which machines of a roll-out have what, in groups: words, and whether a machine's turn belongs there. */
const HOLDS = [
  ["have the new model in force, and keep it until somebody decides", (turn) => turn.step === "soaking" || turn.step === "done"],
  ["were sent the new model, and are out; whether they have it in force shows the page of each", (turn) => turn.step === "out" && turn.version !== null],
  ["wait for a confirmation, and keep what they had before", (turn) => turn.step === "needs-confirmation"],
  ["were sent the new model, and have not answered yet", (turn) => turn.step === "sent"],
  ["were sent nothing, or what was sent was taken back, and keep what they had before", (turn) => turn.step === "waiting" || (turn.step === "out" && turn.version === null)],
];

/** Where a roll-out has stopped by itself: what that means, which machine has what, and the ways on. */
function leadOn(rollout, wish) {
  const links = (turns) => turns.slice(0, 30).flatMap((turn, index) => [index ? ", " : "", make("a", { href: `#machine/${encodeURIComponent(turn.machine)}`, textContent: turn.machine })]);
  const late = (turn) => rollout.in_force_on.includes(turn.machine) && !["soaking", "done"].includes(turn.step);
  const groups = HOLDS.map(([words, belongs]) => [words, rollout.turns.filter((turn) => belongs(turn) && !late(turn))]);
  groups.splice(1, 0, ["tell that they have the new model in force although they did not answer in time, and keep it until somebody decides", rollout.turns.filter(late)]);
  const ways = may("engineer") ? [
    [wish("Go on in spite of it", { wish: "resume" }), "What has stopped it is let go for the machines that are out, and the next ones get the model. Choose this where you know the cause, and it is not the model."],
    [wish("Stop for good", { wish: "abort" }, "stop"), "Nothing more is sent. Then each machine that has the new model in force can be given back the one before, or keep this one: the buttons stand in the list of its machines."],
  ] : [];
  return make("div", { class: "lead" },
    make("p", { textContent: "It has stopped by itself, and nothing more is sent. What was sent and is not in force yet is taken back; what is in force stays, and its machines are told as suspect until somebody decides." }),
    make("ul", {}, ...groups.filter(([, turns]) => turns.length).map(([words, turns]) => make("li", {}, make("strong", { textContent: `${turns.length} of ${rollout.turns.length} ` }), `${words}: `, ...links(turns), turns.length > 30 ? " …" : ""))),
    ways.length ? make("div", { class: "ways" }, ...ways.flatMap(([button, words]) => [button, make("p", { textContent: words })])) : make("p", { class: "soft", textContent: "An engineer decides how it goes on." }));
}

/** What an engineer can decide for a machine that has the model of a roll-out that was broken off. */
function decide(rollout, turn, said) {
  // A machine may have taken the model although its answer came too late, or was taken back: what it tells counts.
  const has = rollout.in_force_on.includes(turn.machine) || turn.step === "done" || turn.step === "soaking" || (turn.step === "out" && turn.version !== null);
  if (turn.kept_by) return make("span", { class: "soft", textContent: `kept by ${turn.kept_by}` });
  if (!has || !may("engineer") || !["aborted", "stopped"].includes(rollout.phase.is)) return "";
  const keep = make("button", { textContent: "Keep this model", onclick: () => act(keep, said, () => post(`/api/rollouts/${rollout.id}/keep`, { machine: turn.machine }), "taken up within a second") });
  // While the roll-out is not over its machines can take part in no other.
  if (rollout.phase.is === "stopped") return keep;
  const back = make("button", { textContent: "Back to the model before", onclick: () => act(back, said, () => post(`/api/machines/${encodeURIComponent(turn.machine)}/back`, {}), "a roll-out to it was started") });
  return make("div", { class: "buttons" }, back, keep);
}

function rolloutPanel(rollout) {
  const { id, turns } = rollout;
  const { is: phase } = rollout.phase;
  const said = make("span", { class: "said", role: "status" });
  const wish = (words, body, kind) => {
    const button = make("button", { class: kind || "", textContent: words, onclick: () => act(button, said, () => post(`/api/rollouts/${id}`, body), "taken up within a second") });
    return button;
  };
  const buttons = [];
  if (may("engineer")) {
    if (phase === "running") buttons.push(wish("Hold", { wish: "pause" }));
    if (phase === "paused") buttons.push(wish("Go on", { wish: "resume" }));
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
  const why = cause || (by ? `${phase === "paused" ? "held" : "ended"} by ${by}` : "");
  const rows = turns.map((turn) => make("tr", {}, cell(make("a", { href: `#machine/${turn.machine}`, textContent: turn.machine })), cell(turn.wave === 0 ? "first" : String(turn.wave)), cell(badge(turn.step, STEP_NAMES[turn.step] || turn.step)), cell(stepWords(turn), { class: "text" }), cell(turn.step === "needs-confirmation" && may("engineer") && ["running", "paused"].includes(phase) ? wish("Confirm", { wish: "confirm", machine: turn.machine, hash: turn.hash }) : decide(rollout, turn, said))));
  const list = table(["machine", "wave", "step", "what that means", ""], rows.slice(0, 200));
  return make("section", { class: "panel", data: { rollout: id } },
    make("div", { class: "head" }, make("h2", { textContent: `Roll-out ${id}` }), badge(phase, phase === "aborted" ? "ended" : phase), make("a", { href: `#model/${rollout.model}`, textContent: short(rollout.model) }), make("span", { class: "soft", textContent: `${clock(rollout.since_s)}, ${rollout.by}; ${turns.filter((turn) => turn.step === "done").length} of ${turns.length} done` })),
    why ? make("p", { class: phase === "stopped" ? "bad" : "soft", textContent: why }) : "", bar,
    phase === "stopped" ? leadOn(rollout, wish) : "",
    turns.length > 8 ? make("details", {}, make("summary", { textContent: "Machines" }), list) : list,
    make("div", { class: "buttons" }, ...buttons, said));
}

function rolloutsPage(page) {
  const place = make("div", { class: "lines" });
  page.replaceChildren(make("div", { class: "head" }, make("h1", { textContent: "Roll-outs" }), may("engineer") ? make("a", { href: "#rollout/", textContent: "Start one" }) : null), place);
  const shown = new Map();
  return repeat(async () => {
    const rollouts = await get("/api/rollouts");
    if (rollouts.length === 0) place.replaceChildren(make("p", { class: "soft", textContent: "There was none yet." }));
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
  page.replaceChildren(make("div", { class: "head" }, make("h1", { textContent: "Start a roll-out" })), make("p", { class: "soft", textContent: "The model goes to the first machines, which are watched; then to the others, in waves. Where something speaks against it the roll-out stops by itself, and a person decides." }), make("form", { class: "panel", onsubmit: (event) => {
    event.preventDefault();
    const chosen = [...choices.querySelectorAll("input:checked")].map((box) => box.value);
    act(button, said, () => post("/api/rollouts", {
      model: model.value, machines: chosen, canaries: chosen.slice(0, first.valueAsNumber || 1),
      rules: { waves: numbersIn(waves.value), soak_s: soak.valueAsNumber * 60, answer_s: answer.valueAsNumber * 60, tolerate: tolerate.valueAsNumber, residual_ratio: ratio.valueAsNumber, residual_um: rise.valueAsNumber },
    }), () => {
      location.hash = "#rollouts";
    });
  } },
  make("div", { class: "fields one" }, field("Model", model, "Name, beginning of the checksum and structure of each model that the centre has.")),
  make("h2", { textContent: "Machines that shall get it: those with its structure" }), make("p", { class: "soft", textContent: "A model holds the errors of one machine. Give it to several only where you know that it is true for each." }), choices, make("div", { class: "buttons" }, all),
  make("h2", { textContent: "The first machines (canaries)" }),
  make("div", { class: "fields" },
    field("How many machines go first", first, "The first of the list above, besides those that are registered as canaries. Such as 1."),
    field("Each machine is watched for, min", soak, "So long it must correct with the model and be heard before the next ones get it. Such as 10."),
    field("It must answer within, min", answer, "One of the first machines that does not answer in time stops the roll-out. Such as 5.")),
  make("h2", { textContent: "The other machines" }),
  make("div", { class: "fields" },
    field("Waves, percent of the others", waves, "How many percent have had their turn at the end of each wave, rising to 100. Such as 25 100."),
    field("How many of them may stay out", tolerate, "So many may not answer before the roll-out stops. Such as 0.")),
  make("h2", { textContent: "It stops where the residual rises" }),
  make("p", { class: "soft", textContent: "The residual is the error that the model leaves with the correction that is applied, as the gateway tells it. The roll-out stops where its mean is above both bounds." }),
  make("div", { class: "fields" },
    field("Bound as a multiple of the residual before", ratio, "Such as 1.5: half as much again."),
    field("Bound above the residual before, µm", rise, "Such as 2.")),
  make("div", { class: "buttons" }, button, said)));
}

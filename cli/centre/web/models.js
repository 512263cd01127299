"use strict";
// Models: the list, one model with its formula, map and tables, and the upload form.

const TURNS = ["there are no rotary axes", "both turn the workpiece", "both turn the tool", "one turns the workpiece, one the tool"];

function formulaPanel(described) {
  const tool = ["Xt", "Yt", "Zt"].map((symbol, place) => `${symbol} = ${described.tool_mm[place]}`).join(", ");
  const type = described.type_numbers ? `linear type number ${described.type_numbers[0]} (number of linear axes that carry the workpiece), rotary type number ${described.type_numbers[1]} (${TURNS[described.type_numbers[1]]})` : "none of the sixteen machines that type numbers name";
  return panel("Formula", make("p", { textContent: `${described.structure}: ${type}` }), make("pre", { id: "formula", textContent: described.formula.join("\n\n") }), make("p", { class: "soft", textContent: `First order; lengths in mm, angles in rad; ${tool}.` }));
}

async function modelsPage(page) {
  const models = await get("/api/models");
  const pick = make("input", { type: "file", accept: ".toml" });
  const measured = make("input", { type: "date" });
  const said = make("p", { class: "said", role: "status" });
  const button = make("button", { textContent: "Add", onclick: () => act(button, said, async () => {
    if (!pick.files[0]) throw new Refused(0, "choose a machine file");
    return post("/api/models", { text: await pick.files[0].text(), file: pick.files[0].name, measured: measured.value });
  }, ({ model, added }) => {
    location.hash = `#model/${model.sha256}`;
    return added ? "added" : "already stored";
  }) });
  const origin = ({ kind, name: file, path }) => ({ file: file ? `file ${file}` : "a text", calibration: `calibration ${path}` })[kind] || kind;
  page.replaceChildren(
    make("div", { class: "head" }, make("h1", { textContent: "Models" })),
    panel("", models.length === 0 ? make("p", { class: "soft", textContent: "No models yet." }) : table(["model", "name", "structure", "from", "measured", "added"], models.map((model) => make("tr", {}, cell(make("a", { href: `#model/${model.sha256}`, textContent: short(model.sha256) })), cell(model.name || "–", { class: "text" }), cell(model.structure), cell(origin(model.origin), { class: "text" }), cell(model.measured || "unknown"), cell(`${clock(model.added_s)}, ${model.by}`))))),
    may("engineer") ? panel("Add a machine file", make("div", { class: "fields" }, field("Machine file", pick, "A .toml file, as volcomp studio and volcomp calibrate write it. volcomp studio makes it from measurement files and sends it here, too."), field("Day of the measurements", measured, "From it the next calibration falls due. Empty: unknown.")), make("div", { class: "buttons" }, button, said)) : "",
  );
}

/** Compensation tables of a model for a control, as downloads. */
async function tablesPanel(model) {
  const formats = await get("/api/formats");
  const format = choose(formats.map((one) => [one.format, one.format]), formats[0].format);
  const number = (value) => make("input", { type: "number", step: "any", min: 0, value, required: true });
  const stepMm = number(50), stepDeg = number(15);
  const said = make("p", { class: "said", role: "status" });
  const place = make("div", { class: "lines" });
  const button = make("button", { textContent: "Make the tables" });
  const shown = panel("Tables for a control", make("p", { class: "soft", textContent: "For the built-in compensation of a control, with tables over one axis. They contain less than the model, and none was tried on a real control." }),
    make("form", { onsubmit: (event) => {
      event.preventDefault();
      place.replaceChildren();
      const query = new URLSearchParams({ format: format.value, step_mm: stepMm.value, step_deg: stepDeg.value });
      act(button, said, () => get(`/api/models/${model.sha256}/tables?${query}`), (tables) => {
        const at = tables.at.map(([axis, value]) => `${axis} = ${fixed(value, 0)}`).join(", ");
        place.replaceChildren(
          make("p", {}, ...tables.files.flatMap((name) => [make("a", { class: "download", href: `/api/models/${model.sha256}/tables/${encodeURIComponent(name)}?${query}`, download: "", textContent: name }), " "])),
          make("p", { class: "soft", textContent: `A number: ${tables.sign}. Axes without a table are at ${at} (mm, deg).` }),
          make("p", { class: "soft", textContent: tables.trust }),
          ...tables.notes.map((note) => make("p", { class: "soft", textContent: `${note}.` })),
          make("p", { class: "soft", textContent: `For other axis positions, axis numbers, and the loss against the model: volcomp export -m FILE --format ${tables.format} -o FOLDER, with the machine file from above.` }),
        );
      });
    } }, make("div", { class: "fields" }, field("Format", format, "The name that volcomp export has for it."), field("Step along linear axes, mm", stepMm, "From position to position of a table, such as 50."), field("Step along rotary axes, deg", stepDeg, "From position to position of a table, such as 15.")), make("div", { class: "buttons" }, button, said)), place);
  shown.classList.add("wide");
  return shown;
}

async function modelPage(page, checksum) {
  const { model, described } = await get(`/api/models/${encodeURIComponent(checksum)}`);
  const map = make("div", {}, make("p", { textContent: "…" }));
  const mapPanel = panel("Error over the work space, µm", map);
  mapPanel.classList.add("wide");
  page.replaceChildren(
    make("div", { class: "head" }, make("h1", { textContent: model.name || "Model" }), make("span", { class: "soft", textContent: short(model.sha256) }), may("engineer") ? make("a", { href: `#rollout/${model.sha256}`, textContent: "Roll it out" }) : null),
    make("div", { class: "panels" }, mapPanel, formulaPanel(described),
      panel("Notes on this model", model.notes.length ? make("ul", {}, ...model.notes.map((note) => make("li", { textContent: note }))) : make("p", { class: "soft", textContent: "nothing" })),
      panel("Machine file", facts([["checksum", model.sha256], ["measured", model.measured || "unknown"], ["added", `${clock(model.added_s)}, ${model.by}`]]), make("p", {}, make("a", { class: "download", href: `/api/models/${model.sha256}/file`, download: "", textContent: "Download the machine file" }), ": every byte as it is signed and sent."), make("details", {}, make("summary", { textContent: "Show it" }), make("pre", { textContent: described.text }))),
      await tablesPanel(model)),
  );
  drawSections(map, await get(`/api/models/${model.sha256}/map`));
}

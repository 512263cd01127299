"use strict";
// A model by form: how the axes are stacked, their travels, the component errors typed or from files; its formula and its map.

const CARRIES = ["none: the tool moves in X, Y and Z", "X carries the workpiece", "X and Y carry the workpiece", "X, Y and Z carry the workpiece"];
const TURNS = ["there are no rotary axes", "both turn the workpiece", "both turn the tool", "one turns the workpiece, one the tool"];
const HINTS = {
  number: ["One number for the whole travel, such as 12.5", (value) => `in ${value}`],
  poly: ["Coefficients c0 c1 c2 … of c0 + c1·q + c2·q² + …, such as 0 0.0073 -2.1e-7", (value, position) => `in ${value}, ${value}/${position}, ${value}/${position}² …; q is the coordinate of the axis in ${position}`],
  table: ["Coordinate and value, a pair in each line, straight between them; such as 0 0, then 250 4.1", (value, position) => `in ${position} and ${value}`],
  cubic: ["Coordinate and value, a pair in each line, a smooth curve through them; such as 0 0, then 250 4.1", (value, position) => `in ${position} and ${value}`],
};
const MOTIONS = { X: "along X", Y: "along Y", Z: "along Z", A: "rotation about X", B: "rotation about Y", C: "rotation about Z" };
const isRotary = (axis) => "ABC".includes(axis);

/** What an error of ISO 230-1 is, in words: `EXX` positioning deviation, `EYX` straightness, `EAX` roll and so on. */
function errorWords(name) {
  const kind = name[1], axis = name[name.length - 1];
  if (name.length === 4) {
    if (!isRotary(axis)) return `squareness of ${axis} to ${{ A: "YZ", B: "XZ", C: "XY" }[kind].replace(axis, "")}`;
    return "XYZ".includes(kind) ? `offset of the centre line of ${axis} along ${kind}` : `tilt of the centre line of ${axis} about ${"XYZ"["ABC".indexOf(kind)]}`;
  }
  if (kind === axis) return isRotary(axis) ? `angular positioning deviation of ${axis}` : `positioning deviation of ${axis}`;
  if (isRotary(axis)) return "XYZ".includes(kind) ? `motion of the table or head ${axis} ${MOTIONS[kind]}` : `tilt of ${axis}: ${MOTIONS[kind]}`;
  if ("XYZ".includes(kind)) return `straightness of ${axis}: motion ${MOTIONS[kind]}`;
  if ("XYZ"["ABC".indexOf(kind)] === axis) return `roll of ${axis}: ${MOTIONS[kind]}`;
  return `tilt of ${axis}: ${MOTIONS[kind]}`;
}

/** The unit of an error, and of the position over which it is stated. */
const unitsOf = (name) => ["ABC".includes(name[1]) ? "µrad" : "µm", isRotary(name[name.length - 1]) ? "deg" : "mm"];

/** The names of the errors of these axes: motions, squareness, locations. */
function errorNames(axes) {
  const motions = axes.flatMap((axis) => ["EX", "EY", "EZ", "EA", "EB", "EC"].map((kind) => kind + axis));
  const square = [["EC0Y", "Y"], ["EB0Z", "Z"], ["EA0Z", "Z"]].filter(([, axis]) => axes.includes(axis)).map(([name]) => name);
  const about = { A: ["EY0A", "EZ0A", "EB0A", "EC0A"], B: ["EX0B", "EZ0B", "EA0B", "EC0B"], C: ["EX0C", "EY0C", "EA0C", "EB0C"] };
  return [...square, ...axes.flatMap((axis) => about[axis] || []), ...motions];
}

/** Numbers between blanks or semicolons. A comma is none of both: whoever writes 0,035 would get two numbers. */
const numbersIn = (text) => text.split(/[\s;]+/).filter(Boolean).map((word) => {
  if (word.includes(",")) throw new Refused(0, `found ${JSON.stringify(word)}, expected a point as the decimal sign, and blanks or semicolons between numbers: no comma`);
  const number = Number(word.replace("−", "-"));
  if (!Number.isFinite(number)) throw new Refused(0, `found ${JSON.stringify(word)}, expected a number`);
  return number;
});

/** Does something with what was typed into a field: what is wrong is told with its name. */
function inField(name, work) {
  try {
    return work();
  } catch (problem) {
    throw new Refused(0, `${name}: ${problem.message}`);
  }
}

/** What was typed for an error, as the centre takes it. */
function curveOf(kind, text) {
  if (kind === "number") {
    const list = numbersIn(text);
    if (list.length !== 1) throw new Refused(0, `found ${list.length} numbers, expected one, such as 12.5`);
    return { number: list[0] };
  }
  if (kind === "poly") return { poly: numbersIn(text) };
  const nodes = text.split("\n").map((row) => row.trim()).filter(Boolean).map((row) => {
    const node = numbersIn(row);
    if (node.length !== 2) throw new Refused(0, `found ${JSON.stringify(row)}, expected a coordinate and a value, such as 250 4.1`);
    return node;
  });
  return { [kind]: nodes };
}

function buildPage(page) {
  const name = make("input", { maxLength: 100 });
  const way = choose([["type", "two type numbers: the usual machines"], ["code", "a structure code: any machine"]], "type");
  const translational = choose(CARRIES.map((text, number) => [String(number), `${number}: ${text}`]), "2");
  const rotary = choose(TURNS.map((text, number) => [String(number), `${number}: ${text}`]), "0");
  const pairs = ["C A", "A C", "C B", "B C", "B A", "A B"];
  const letters = choose(pairs.map((pair) => [pair, pair]), "C A");
  const code = make("input", { placeholder: "w C' A' b X Y Z t", value: "w X' Y' b Z t" });
  const tip = make("input", { placeholder: "0 0 0" });
  const axesPlace = make("div", { class: "lines" });
  const typed = new Map();
  const errors = make("div", { class: "lines" });
  const files = make("div", { class: "lines" });
  const result = make("div", { class: "panels", id: "built" });
  const said = make("p", { class: "said", role: "status" });
  const lettersField = field("Rotary axes, from the workpiece to the tool", letters, "The first one is nearer to the workpiece, such as C A for a trunnion: the table C on the cradle A.");
  const typeFields = [field("Linear type number", translational, "How many of X, Y, Z carry the workpiece, in this order; the others carry the tool."), field("Rotary type number", rotary, "What the two rotary axes of a five-axis machine turn. A machine with one rotary axis needs a structure code."), lettersField];
  const codeField = field("Structure code", code, "The axes from the workpiece (w) over the bed (b) to the tool (t), such as w C' A' b X Y Z t; a dash ' marks an axis that carries the workpiece.");

  const axes = () => (way.value === "code" ? axesOf(code.value) : ["X", "Y", "Z", ...(rotary.value === "0" ? [] : letters.value.split(" "))]);

  function showAxes() {
    typeFields.forEach((one) => { one.hidden = way.value === "code"; });
    lettersField.hidden = way.value === "code" || rotary.value === "0";
    codeField.hidden = way.value !== "code";
    axesPlace.replaceChildren(...inOrder([...new Set(axes())]).map((axis) => {
      if (!typed.has(axis)) {
        const turns = isRotary(axis);
        typed.set(axis, {
          low: make("input", { type: "number", step: "any", value: turns ? "-120" : "0", required: true }),
          high: make("input", { type: "number", step: "any", value: turns ? "120" : "500", required: true }),
          point: turns ? make("input", { placeholder: "0 0 0" }) : null,
        });
      }
      const { low, high, point } = typed.get(axis);
      const unit = isRotary(axis) ? "deg" : "mm";
      return make("div", { class: "axis-line" }, make("strong", { textContent: axis }), field(`from, ${unit}`, low), field(`to, ${unit}`, high), point ? make("div", { class: "points" }, field("A point on its centre line: x y z, mm", point, "In machine coordinates with all axes at zero, such as 0 0 -350. Empty: 0 0 0.")) : null);
    }));
    for (const select of document.querySelectorAll("select.error-name")) select.replaceWith(errorSelect(select.value));
  }

  function errorSelect(chosen) {
    const names = errorNames(axes()).map((one) => [one, `${one}: ${errorWords(one)}`]);
    // An error that nobody has named is asked for.
    const known = names.some(([one]) => one === chosen);
    const select = choose(known ? names : [["", "Which error does it hold?"], ...names], known ? chosen : "");
    select.className = "error-name";
    select.ariaLabel = "Error";
    return select;
  }

  function addError(chosen = "EXX") {
    const kind = choose([["number", "one number"], ["poly", "a polynomial"], ["table", "a table, straight lines"], ["cubic", "a table, smooth curve"]], /0/.test(chosen) ? "number" : "poly");
    kind.ariaLabel = "How the error is stated";
    const text = make("textarea", { rows: 2, ariaLabel: "Values of the error" });
    const said = make("span", { class: "hint soft" });
    const row = make("div", { class: "line" }, errorSelect(chosen), kind, make("button", { type: "button", class: "quiet", textContent: "Remove", onclick: () => row.remove() }), text, said);
    const hint = () => {
      const [what, units] = HINTS[kind.value];
      setText(said, `${what}; ${units(...unitsOf(row.querySelector(".error-name").value || "EXX"))}.`);
    };
    row.addEventListener("change", hint);
    hint();
    errors.append(row);
  }

  function errorOf(row, what) {
    const { value } = row.querySelector(".error-name");
    if (!value) throw new Refused(0, `${what}: expected the error that it holds, such as EXX, the positioning deviation of X: choose it from the list`);
    return value;
  }

  function addFile(file) {
    const guessed = (file.name.toUpperCase().match(/E[ABCXYZ]0?[ABCUVWXYZ]/) || [""])[0];
    const unit = choose([["", "as the file states it"], ["um", "µm"], ["mm", "mm"], ["urad", "µrad"], ["mrad", "mrad"], ["arcsec", "arcsec"], ["deg", "deg"]], "");
    const side = make("input", { type: "checkbox" });
    const at = make("input", { type: "text", placeholder: "Y=400 Z=-200" });
    const row = make("div", { class: "line file" }, make("strong", { class: "said", textContent: file.name }), make("div", { class: "fields" },
      field("Error that it holds", errorSelect(guessed), "Name of ISO 230-1"),
      field("Unit of its readings", unit, "Needed only where the file states none."),
      field("Where the other axes stood, mm or deg", at, "Such as Y=400 Z=-200. Needed for the Abbe offset and for straightness; empty: at zero."),
      make("label", { class: "row" }, side, "The instrument measured the motion of the workpiece's side: the sign is turned.")), make("button", { type: "button", class: "quiet", textContent: "Remove", onclick: () => row.remove() }));
    row.read = async () => ({
      error: errorOf(row, file.name), name: file.name, text: await file.text(), unit: unit.value || null, workpiece_side: side.checked,
      at: Object.fromEntries(at.value.replace(/\s*=\s*/g, "=").split(/[\s;]+/).filter(Boolean).map((part) => {
        const [axis, value] = part.split("=");
        const [number, ...more] = inField(file.name, () => numbersIn(value || ""));
        if (number === undefined || more.length) throw new Refused(0, `${file.name}: found ${JSON.stringify(part)}, expected an axis and where it stood, such as Y=400`);
        return [axis, number];
      })),
    });
    files.append(row);
  }

  async function formOf() {
    const point = (text) => {
      if (!text.trim()) return undefined;
      const list = numbersIn(text);
      if (list.length !== 3) throw new Refused(0, `found ${JSON.stringify(text)}, expected three numbers x y z in mm, such as 0 0 -150`);
      return list;
    };
    return {
      name: name.value.trim(),
      structure: way.value === "code" ? { code: code.value } : { translational: Number(translational.value), rotary: Number(rotary.value), rotary_axes: rotary.value === "0" ? [] : letters.value.split(" ") },
      axes: inOrder([...new Set(axes())]).map((axis) => {
        const one = typed.get(axis);
        return { axis, travel: [one.low.valueAsNumber, one.high.valueAsNumber], point_mm: one.point ? inField(`${axis}, a point on its centre line`, () => point(one.point.value)) : undefined };
      }),
      tip_mm: inField("Tool tip at machine zero", () => point(tip.value)),
      errors: [...errors.children].filter((row) => row.querySelector("textarea").value.trim()).map((row) => {
        const [error, kind] = row.querySelectorAll("select");
        return { error: errorOf(row, "an error that is typed"), value: inField(error.value, () => curveOf(kind.value, row.querySelector("textarea").value)) };
      }),
      uploads: await Promise.all([...files.children].map((row) => row.read())),
    };
  }

  for (const select of [way, translational, rotary, letters]) select.addEventListener("change", showAxes);
  code.addEventListener("input", showAxes);
  const pick = make("input", { type: "file", multiple: true, accept: ".rtl,.rta,.csv", onchange: () => {
    for (const file of pick.files) addFile(file);
    pick.value = "";
  } });
  const button = make("button", { class: "main", textContent: "Show the model" });
  page.replaceChildren(
    make("div", { class: "head" }, make("h1", { textContent: "Build a model" })),
    make("form", { onsubmit: (event) => {
      event.preventDefault();
      result.replaceChildren();
      act(button, said, async () => post("/api/form", await formOf()), (built) => {
        showBuilt(result, built);
        return "";
      });
    } },
    make("div", { class: "panels" },
      panel("Machine", make("div", { class: "fields" }, field("Name of the model", name, "For people, such as mill-1, March 2026."), field("How the axes are stacked is stated by", way, "Which axis sits on which, from the workpiece to the tool."), ...typeFields, codeField, field("Tool tip at machine zero: x y z, mm", tip, "Where the tip stands when all axes are at zero, in machine coordinates, such as 400 325 -150. Empty: 0 0 0.")), make("h2", { textContent: "Travels: the lowest and the highest coordinate of each axis" }), axesPlace),
      panel("Component errors, typed", make("p", { class: "soft", textContent: "The names are those of ISO 230-1: E, then the direction (X, Y, Z along an axis; A, B, C about X, Y, Z), then the axis that moves. EXX is the positioning deviation of X, EYX its straightness along Y, EAX its roll; EC0Y is the squareness of Y to X. A value is actual less commanded, of the tool relative to the workpiece. What stays empty counts as 0." }), errors, make("div", { class: "buttons" }, make("button", { type: "button", textContent: "Add an error", onclick: () => addError("EXX") }))),
      panel("Component errors from measurement files", make("p", { class: "soft", textContent: "Files of laser interferometers (Renishaw .rtl, .rta) and tables (.csv with the columns target and deviation). A curve is fitted through each; the part that comes from angular errors over the Abbe offset, and the slope of straightness lines, are taken out." }), files, make("div", { class: "buttons" }, field("Measurement files", pick, "Several at once; exx.rtl is taken for EXX by its name.")))),
    make("div", { class: "buttons" }, button, said)),
    result,
  );
  showAxes();
  for (const chosen of ["EXX", "EYY", "EZZ", "EC0Y"]) addError(chosen);
}

function formulaPanel(described) {
  const tool = ["Xt", "Yt", "Zt"].map((symbol, place) => `${symbol} = ${described.tool_mm[place]}`).join(", ");
  const type = described.type_numbers ? `linear type number ${described.type_numbers[0]} (so many of X, Y, Z carry the workpiece), rotary type number ${described.type_numbers[1]} (${TURNS[described.type_numbers[1]]})` : "none of the sixteen machines that type numbers name";
  return panel("Formula", make("p", { textContent: `${described.structure}: ${type}` }), make("pre", { id: "formula", textContent: described.formula.join("\n\n") }), make("p", { class: "soft", textContent: `First order; lengths in mm, angles in rad; ${tool}.` }));
}

function showBuilt(place, built) {
  const map = make("div", {});
  const measured = make("input", { type: "date" });
  const said = make("p", { class: "said", role: "status" });
  const understood = make("input", { type: "checkbox", onchange: () => { save.disabled = !understood.checked; } });
  const save = make("button", { class: "main", textContent: "Save as a model", disabled: Boolean(built.warning), onclick: () => act(save, said, () => post("/api/models", { text: built.text, measured: measured.value, notes: built.notes }), ({ model, added }) => {
    const link = make("a", { href: `#model/${model.sha256}`, textContent: short(model.sha256) });
    requestAnimationFrame(() => said.append(" ", link));
    return added ? "saved:" : "it was there already:";
  }) });
  const mapPanel = panel("Error over the work space, µm", map);
  mapPanel.classList.add("wide");
  place.replaceChildren(
    built.warning ? panel("Is this right?", make("p", { class: "bad", id: "warning", textContent: built.warning })) : "",
    built.notes.length ? panel("Notes on this model", make("ul", {}, ...built.notes.map((note) => make("li", { textContent: note })))) : "",
    formulaPanel(built),
    mapPanel,
    panel("Machine file", make("details", {}, make("summary", { textContent: "Show it" }), make("pre", { textContent: built.text }))),
    panel("Save", make("div", { class: "fields" }, field("Day of the measurements", measured, "From it the next calibration falls due. Empty: unknown.")), built.warning ? make("label", { class: "row" }, understood, "The numbers are right: save it all the same.") : "", make("div", { class: "buttons" }, save, said)),
  );
  drawSections(map, built.map);
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
    return added ? "added" : "it was there already";
  }) });
  const origin = ({ kind, name: file, path }) => ({ form: "form", file: `file ${file}`, calibration: `calibration ${path}` })[kind] || kind;
  page.replaceChildren(
    make("div", { class: "head" }, make("h1", { textContent: "Models" }), may("engineer") ? make("a", { href: "#build", textContent: "Build one by form" }) : null),
    panel("", models.length === 0 ? make("p", { class: "soft", textContent: "There is none yet." }) : table(["model", "name", "structure", "from", "measured", "added"], models.map((model) => make("tr", {}, cell(make("a", { href: `#model/${model.sha256}`, textContent: short(model.sha256) })), cell(model.name || "–", { class: "text" }), cell(model.structure), cell(origin(model.origin), { class: "text" }), cell(model.measured || "unknown"), cell(`${clock(model.added_s)}, ${model.by}`))))),
    may("engineer") ? panel("Add a machine file", make("div", { class: "fields" }, field("Machine file", pick, "A .toml file, as volcomp calibrate writes it."), field("Day of the measurements", measured, "From it the next calibration falls due. Empty: unknown.")), make("div", { class: "buttons" }, button, said)) : "",
  );
}

/** The tables of a model for a control that compensates by itself, as files to be taken away. */
async function tablesPanel(model) {
  const formats = await get("/api/formats");
  const format = choose(formats.map((one) => [one.format, one.format]), formats[0].format);
  const number = (value) => make("input", { type: "number", step: "any", min: 0, value, required: true });
  const stepMm = number(50), stepDeg = number(15);
  const said = make("p", { class: "said", role: "status" });
  const place = make("div", { class: "lines" });
  const button = make("button", { textContent: "Make the tables" });
  const shown = panel("Tables for a control", make("p", { class: "soft", textContent: "A control that compensates by itself holds tables over one axis. They say less than the model, and none was tried on a real control." }),
    make("form", { onsubmit: (event) => {
      event.preventDefault();
      place.replaceChildren();
      const query = new URLSearchParams({ format: format.value, step_mm: stepMm.value, step_deg: stepDeg.value });
      act(button, said, () => get(`/api/models/${model.sha256}/tables?${query}`), (told) => {
        const at = told.at.map(([axis, value]) => `${axis} = ${fixed(value, 0)}`).join(", ");
        place.replaceChildren(
          make("p", {}, ...told.files.flatMap((name) => [make("a", { class: "download", href: `/api/models/${model.sha256}/tables/${encodeURIComponent(name)}?${query}`, download: "", textContent: name }), " "])),
          make("p", { class: "soft", textContent: `A number: ${told.sign}. The axes that a table does not go over stand at ${at} (mm, deg).` }),
          make("p", { class: "soft", textContent: told.trust }),
          ...told.notes.map((note) => make("p", { class: "soft", textContent: `${note}.` })),
          make("p", { class: "soft", textContent: `For other places of the axes, axis numbers, and what the tables lose against the model: volcomp export -m FILE --format ${told.format} -o FOLDER, with the machine file from above.` }),
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

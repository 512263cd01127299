"use strict";
// The overview: one row for each machine, updated and sorted.

const SHOP_EVERY_MS = 2000;
const WORST = ["faulted", "unknown", "never connected", "ramping-out", "holding", "arming", "disarmed", "compensating"];
const shop = { rows: new Map(), sort: "state", down: false, filter: "", only: "", document: null };

const badness = (row) => {
  const place = WORST.indexOf(row.state);
  return place < 0 ? 1 : place;
};
const isNeverConnected = (row) => row.state === "never connected";
const known = (row, text) => (isNeverConnected(row) ? "–" : row.silent ? "unknown" : text);

function versionOf(row) {
  if (isNeverConnected(row)) return row.wanted === null ? "–" : `${row.wanted} sent`;
  if (row.silent) return row.wanted === null ? "unknown" : `unknown → ${row.wanted}`;
  if (row.version === row.wanted || row.wanted === null) return row.version ? String(row.version) : "none";
  return `${row.version || "none"} → ${row.wanted}`;
}

function degreesOf(row) {
  if (row.silent) return known(row);
  const broken = row.broken_sensors ? ` (${row.broken_sensors} broken)` : "";
  if (!isNumber(row.coldest_degc)) return row.broken_sensors ? "broken" : "–";
  return `${fixed(row.coldest_degc, 1)}…${fixed(row.warmest_degc, 1)}${broken}`;
}

function dueOf(row) {
  if (!isNumber(row.due_in_days)) return "–";
  const days = Math.floor(row.due_in_days);
  return days < 0 ? `${-days} d ago` : `in ${days} d`;
}

/** Key, heading, class, text, what it is sorted by. */
const COLUMNS = [
  ["machine", "machine", "", (row) => row.machine, (row) => row.machine],
  ["site", "site", "tertiary", (row) => row.site, (row) => row.site],
  ["state", "state", "", (row) => row.state, badness],
  ["why", "why", "text tertiary", (row) => (row.silent && row.was ? `last: ${row.was}` : row.reasons.join(", ")), (row) => row.reasons.join()],
  ["age", "age", "number", (row) => (row.age_s === null ? (isNeverConnected(row) ? "never" : "unknown") : lasting(row.age_s)), (row) => row.age_s ?? Infinity],
  ["version", "version", "number tertiary", versionOf, (row) => row.version ?? -1],
  ["correction", "correction, µm", "number secondary", (row) => known(row, fixed(row.correction_um, 1)), (row) => row.correction_um ?? -1],
  ["residual", "residual, µm", "number secondary", (row) => known(row, fixed(row.residual_um, 1)), (row) => row.residual_um ?? -1],
  ["degc", "°C", "number secondary", degreesOf, (row) => row.warmest_degc ?? -300],
  ["alarms", "alarms", "number", (row) => (row.alarms ? String(row.alarms) : "0"), (row) => -row.alarms],
  ["due", "due", "number secondary", dueOf, (row) => row.due_in_days ?? Infinity],
];

function shopPage(page) {
  shop.rows.clear();
  const filter = make("input", { type: "search", placeholder: "name, site, reason", value: shop.filter, oninput: () => {
    shop.filter = filter.value;
    showShop();
  } });
  filter.setAttribute("aria-label", "Show only machines with");
  const heads = COLUMNS.map(([key, text, kind]) => make("th", { class: kind.replace("text", ""), scope: "col", data: { key } }, make("button", { textContent: text, onclick: () => {
    shop.down = shop.sort === key && !shop.down;
    shop.sort = key;
    showShop();
  } })));
  const buttons = may("engineer") ? make("a", { href: "#register", textContent: "Register a machine" }) : null;
  page.replaceChildren(
    make("div", { class: "head" }, make("h1", { id: "shop-title", textContent: "Shop" }), filter, buttons),
    make("div", { id: "tally", class: "tally" }),
    make("div", { id: "centre-alarms" }),
    make("div", { class: "panel scroll" }, make("p", { class: "soft narrow-only", textContent: "A wider screen shows more columns. Touch a machine for all that is known of it." }), make("table", { id: "shop-table" }, make("thead", {}, make("tr", {}, ...heads)), make("tbody", {})), make("p", { id: "nothing", class: "soft" })),
  );
  return repeat(async () => {
    shop.document = await get("/api/overview");
    showShop();
  }, SHOP_EVERY_MS, () => {
    // Nothing is known any more: no number of before stays.
    if (!shop.document) return;
    for (const row of shop.document.machines) Object.assign(row, { was: row.silent ? row.was : row.state, state: "unknown", silent: true, reasons: [], age_s: null, correction_um: null, residual_um: null });
    showShop();
  });
}

function showShop() {
  const body = document.querySelector("#shop-table tbody");
  if (!body || !shop.document) return;
  const { machines, centre } = shop.document;
  showTally(machines);
  element("centre-alarms").replaceChildren(...centre.map((alarm) => make("p", { class: "bad", textContent: alarm.text })));
  const text = shop.filter.toLowerCase();
  const shown = machines.filter((row) => (!shop.only || row.state === shop.only) && (!text || [row.machine, row.site, row.state, row.control, ...row.reasons].some((part) => part.toLowerCase().includes(text))));
  const by = COLUMNS.find(([key]) => key === shop.sort)[4];
  const compare = (a, b) => {
    const [x, y] = [by(a), by(b)];
    return x < y ? -1 : x > y ? 1 : a.machine < b.machine ? -1 : 1;
  };
  shown.sort((a, b) => (shop.down ? -compare(a, b) : compare(a, b)));
  for (const head of document.querySelectorAll("#shop-table th")) {
    if (head.dataset.key === shop.sort) head.setAttribute("aria-sort", shop.down ? "descending" : "ascending");
    else head.removeAttribute("aria-sort");
  }
  const kept = new Set(shown.map((row) => row.machine));
  for (const [name, line] of shop.rows) {
    if (!kept.has(name)) {
      line.remove();
      shop.rows.delete(name);
    }
  }
  let place = body.firstElementChild;
  for (const row of shown) {
    let line = shop.rows.get(row.machine);
    if (!line) {
      line = lineOf(row);
      shop.rows.set(row.machine, line);
    }
    fillLine(line, row);
    if (line === place) place = place.nextElementSibling;
    else body.insertBefore(line, place);
  }
  setText(element("nothing"), machines.length === 0 ? "No machine is registered yet." : shown.length === 0 ? "No machine fits." : "");
  element("nothing").hidden = shown.length > 0;
}

function lineOf(row) {
  const cells = COLUMNS.map(([key, , kind]) => {
    const made = make("td", { class: kind, data: { key } });
    if (key === "machine") made.append(make("a", { href: `#machine/${encodeURIComponent(row.machine)}` }));
    if (key === "state") made.append(make("span", { class: "badge" }));
    return made;
  });
  return make("tr", { data: { machine: row.machine } }, ...cells);
}

function fillLine(line, row) {
  COLUMNS.forEach(([key, , , words], index) => {
    const place = line.cells[index], said = words(row);
    if (key === "machine" || key === "state") setText(place.firstChild, said);
    else {
      setText(place, said);
      place.classList.toggle("unknown", said.startsWith("unknown"));
    }
    if (key === "state") place.firstChild.dataset.state = row.state;
    if (key === "alarms") place.classList.toggle("bad", row.worst === "alarm" || row.worst === "warning");
    if (key === "due") place.classList.toggle("bad", row.due_in_days !== null && row.due_in_days < 0);
  });
}

/** How many machines are in which state; a touch shows only these. */
function showTally(machines) {
  const counts = new Map();
  for (const row of machines) counts.set(row.state, (counts.get(row.state) || 0) + 1);
  const place = element("tally");
  const states = [...counts.keys()].sort((a, b) => WORST.indexOf(a) - WORST.indexOf(b));
  const key = JSON.stringify([states.map((state) => [state, counts.get(state)]), shop.only]);
  if (place.dataset.key === key) return;
  place.dataset.key = key;
  setText(element("shop-title"), machines.length === 1 ? "1 machine" : `${machines.length} machines`);
  place.replaceChildren(...states.map((state) => make("button", {
    class: "badge",
    data: { state },
    ariaPressed: String(shop.only === state),
    textContent: `${counts.get(state)} ${state}`,
    onclick: () => {
      shop.only = shop.only === state ? "" : state;
      showShop();
    },
  })));
}

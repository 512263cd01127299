"use strict";
// Alarms, the search of the network, the audit log, users, and one's own password.

function alarmsPage(page) {
  const all = make("input", { type: "checkbox", onchange: () => show() });
  const place = make("div", { class: "panel" });
  page.replaceChildren(make("div", { class: "head" }, make("h1", { textContent: "Alarms" }), make("label", { class: "row" }, all, "include closed alarms")), place);
  let before = "";
  const show = async () => {
    const alarms = await get(`/api/alarms?all=${all.checked}`);
    const key = JSON.stringify([alarms, all.checked]);
    if (key === before) return;
    before = key;
    place.replaceChildren(alarms.length === 0 ? make("p", { class: "soft", textContent: "none" }) : table(["machine", "", "what", "when", ""], alarms.map((alarm) => alarmRow(alarm, true))));
  };
  return repeat(show, 3000);
}

const LANGUAGES = { gateway: "gateway", focas: "FOCAS", "opc-ua": "OPC UA", modbus: "Modbus TCP" };

function networkPage(page) {
  const subnets = make("textarea", { placeholder: "192.0.2.0/24", rows: 3, required: true, spellcheck: false });
  const mine = make("input", { type: "checkbox" });
  const pace = make("input", { type: "number", min: 1, max: 1000, value: 50 });
  const said = make("p", { class: "said", role: "status" });
  const state = make("p", { role: "status" });
  const place = make("div", {});
  const button = make("button", { class: "main", textContent: "Search" });
  page.replaceChildren(make("div", { class: "head" }, make("h1", { textContent: "Search the network" })),
    make("form", { class: "panel", onsubmit: (event) => {
      event.preventDefault();
      act(button, said, () => post("/api/discovery", { subnets: subnets.value.split(/[\s,;]+/).filter(Boolean), mine: mine.checked, per_second: pace.valueAsNumber }), "");
    } },
    make("p", { class: "soft", textContent: "Finds gateways, FANUC controls (FOCAS), OPC UA servers and Modbus modules in the stated subnets only. Nothing is written to them; the results are proposals." }),
    make("div", { class: "fields" }, field("Subnets or addresses, one per line", subnets, "Such as 192.168.10.0/24 or 192.168.10.17; at most 65 536 addresses each."), field("New connections per second", pace, "1 to 1000, such as 50. Use a low rate on a busy network."), make("label", { class: "row" }, mine, "The public addresses among them belong to us: search them too.")),
    make("div", { class: "buttons" }, button, said)), make("section", { class: "panel" }, state, place));
  let before = "";
  return repeat(async () => {
    const latest = await get("/api/discovery");
    setText(state, latest.subnets.length === 0 ? "No search yet." : `${latest.subnets.join(", ")}: ${latest.done} of ${latest.of} addresses${latest.running ? "…" : `, ${latest.devices.length} found`}`);
    const key = JSON.stringify(latest.devices);
    if (key === before) return;
    before = key;
    place.replaceChildren(latest.devices.length === 0 ? "" : table(["address", "answers as", "control", "axes", "structure, proposed", ""], latest.devices.map((device) => {
      const first = device.structure || (device.proposals[0] || {}).structure || "";
      const register = make("button", { class: "quiet", textContent: "Register…", onclick: () => {
        registerPage.proposed = { address: `${device.address}:${device.port}`, control: device.control, structure: first, proposals: device.proposals, note: "" };
        location.hash = "#register";
      } });
      const structure = device.structure || (first ? `${first}? ${device.proposals.length > 1 ? `or one of ${device.proposals.length - 1} others` : ""}` : "–");
      return make("tr", {}, cell(`${device.address}:${device.port}`), cell(`${device.answers ? "" : "not "}${LANGUAGES[device.kind] || device.kind}`), cell([device.control, device.name, device.note].filter(Boolean).join(", ") || "–", { class: "text" }), cell(device.axes.join(" ") || "–"), cell(structure), cell(device.answers && device.kind !== "modbus" ? register : ""));
    })));
  }, 1000);
}

async function auditPage(page) {
  const rows = make("tbody", {});
  const more = make("button", { textContent: "Older", onclick: () => load() });
  const shown = table(["no.", "when", "who", "what", "object", "facts"], [], "");
  shown.querySelector("tbody").replaceWith(rows);
  let last = null;
  const load = async () => {
    const records = await get(`/api/audit${last === null ? "" : `?before=${last}`}`);
    for (const record of records) {
      last = record.number;
      rows.append(make("tr", {}, cell(record.number), cell(clock(record.at_s)), cell(record.by), cell(record.action), cell(record.object, { class: "text" }), cell(make("pre", { textContent: JSON.stringify(record.details) }), { class: "text details" })));
    }
    more.hidden = records.length === 0 || last <= 1;
  };
  page.replaceChildren(make("div", { class: "head" }, make("h1", { textContent: "Audit log of the centre" })), make("div", { class: "panel audit" }, shown, more));
  await load();
}

async function usersPage(page) {
  const users = await get("/api/users");
  const rows = users.map((user) => {
    const role = choose(ROLES.map((one) => [one, one]), user.role);
    role.ariaLabel = "Role";
    const disabled = make("input", { type: "checkbox", checked: user.disabled });
    const password = make("input", { type: "password", placeholder: "a new password", autocomplete: "new-password", minLength: 12, ariaLabel: "New password" });
    const said = make("span", { class: "said", role: "status" });
    const save = make("button", { class: "quiet", textContent: "Save", onclick: () => act(save, said, () => post(`/api/users/${user.name}`, { role: role.value, disabled: disabled.checked, password: password.value || null }), () => {
      password.value = "";
      return "saved";
    }) });
    const remove = make("button", { class: "quiet bad", textContent: "Remove", onclick: () => {
      if (window.confirm(`Remove ${user.name}?`)) act(remove, said, () => post(`/api/users/${user.name}/remove`), () => usersPage(page));
    } });
    return make("tr", {}, cell(user.name), cell(role), cell(make("label", { class: "row" }, disabled, "may not log in")), cell(password), cell(`${clock(user.added_s)}, ${user.added_by}`), cell(make("div", { class: "buttons" }, save, remove, said)));
  });
  const name = make("input", { required: true, pattern: "[a-z][a-z0-9._\\-]{0,63}", title: "lower-case letters, digits, dots, hyphens, underscores", autocomplete: "off" });
  const role = choose(ROLES.map((one) => [one, one]), "viewer");
  const password = make("input", { type: "password", required: true, minLength: 12, autocomplete: "new-password" });
  const said = make("p", { class: "said", role: "status" });
  const add = make("button", { class: "main", textContent: "Add" });
  page.replaceChildren(make("div", { class: "head" }, make("h1", { textContent: "Users" })),
    panel("", table(["name", "role", "", "password", "added", ""], rows)),
    make("form", { class: "panel", onsubmit: (event) => {
      event.preventDefault();
      act(add, said, () => post("/api/users", { name: name.value, role: role.value, password: password.value }), () => usersPage(page));
    } }, make("h2", { textContent: "Add a user" }), make("div", { class: "fields" }, field("Name", name), field("Role", role), field("Password, 12 characters or more", password)), make("div", { class: "buttons" }, add, said)));
}

function accountPage(page) {
  const old = make("input", { type: "password", required: true, autocomplete: "current-password" });
  const fresh = make("input", { type: "password", required: true, minLength: 12, autocomplete: "new-password" });
  const said = make("p", { class: "said", role: "status" });
  const button = make("button", { class: "main", textContent: "Change" });
  page.replaceChildren(make("div", { class: "head" }, make("h1", { textContent: me.name }), make("span", { class: "soft", textContent: me.role })), make("form", { class: "panel", onsubmit: (event) => {
    event.preventDefault();
    act(button, said, () => post("/api/password", { old: old.value, new: fresh.value }), () => {
      askForLogin("The password was changed: log in with the new one.");
    });
  } }, make("h2", { textContent: "Change the password" }), make("div", { class: "fields" }, field("The old one", old), field("The new one, 12 characters or more", fresh)), make("div", { class: "buttons" }, button, said)));
}

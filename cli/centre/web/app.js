"use strict";
// Navigation, login, and periodic requests.

/** Hash, tab or none, role, page. */
const PAGES = [
  ["shop", "Shop", "viewer", shopPage],
  ["machine", null, "viewer", machinePage],
  ["register", null, "engineer", registerPage],
  ["rollouts", "Roll-outs", "viewer", rolloutsPage],
  ["rollout", null, "engineer", startPage],
  ["models", "Models", "viewer", modelsPage],
  ["model", null, "viewer", modelPage],
  ["network", "Network", "engineer", networkPage],
  ["alarms", "Alarms", "viewer", alarmsPage],
  ["users", "Users", "admin", usersPage],
  ["audit", "Audit", "admin", auditPage],
  ["account", null, "viewer", accountPage],
];
let endPage = null, shownPages = 0;

/** Runs `work` now and periodically, and shows errors; returns the function that ends it. */
function repeat(work, every, lost) {
  const of = shownPages;
  let ended = false;
  const turn = async () => {
    while (!ended && of === shownPages) {
      if (!document.hidden) {
        try {
          await work();
          if (!ended && of === shownPages) trouble("");
        } catch (error) {
          if (ended || of !== shownPages || error.status === 401) return;
          trouble(error.message);
          if (error.status === 0 && lost) lost();
          if (!(error instanceof Refused)) console.error(error);
        }
      }
      await new Promise((done) => setTimeout(done, every));
    }
  };
  turn();
  return () => { ended = true; };
}

function askForLogin(why = "") {
  me = null;
  shownPages += 1;
  if (endPage) endPage();
  endPage = null;
  for (const id of ["tabs", "person", "page", "trouble"]) element(id).hidden = true;
  element("login").hidden = false;
  setText(element("refused"), why);
  document.title = "volcomp centre";
}

function showTabs(current) {
  element("tabs").hidden = false;
  element("tabs").replaceChildren(...PAGES.filter(([, tab, role]) => tab && may(role)).map(([hash, tab]) => make("a", { href: `#${hash}`, textContent: tab, ...(hash === current ? { ariaCurrent: "page" } : {}) })));
  for (const tab of element("tabs").children) {
    if (tab.getAttribute("href") !== `#${current}`) continue;
    tab.setAttribute("aria-current", "page");
    // On a telephone the tabs are wider than the screen.
    tab.parentElement.scrollLeft = tab.offsetLeft - tab.parentElement.offsetLeft - (tab.parentElement.clientWidth - tab.offsetWidth) / 2;
  }
  element("person").hidden = false;
  element("who").replaceChildren(me.name, make("span", { class: "role", textContent: ` (${me.role})` }));
}

async function showPage() {
  if (!me) return;
  const [hash, ...rest] = location.hash.slice(1).split("/");
  const [name, tab, , page] = PAGES.find(([one, , role]) => one === hash && may(role)) || PAGES[0];
  shownPages += 1;
  const shown = shownPages;
  if (endPage) endPage();
  endPage = null;
  trouble("");
  showTabs(name);
  const place = element("page");
  place.hidden = false;
  element("login").hidden = true;
  place.replaceChildren(make("p", { class: "soft", textContent: "…" }));
  document.title = `${tab || rest.join("/") || name} – volcomp centre`;
  window.scrollTo(0, 0);
  try {
    const end = await page(place, rest.join("/"));
    if (shown === shownPages) endPage = end || null;
    else if (end) end();
  } catch (error) {
    if (!(error instanceof Refused)) throw error;
    if (shown === shownPages && me) place.replaceChildren(make("p", { class: "bad", textContent: error.message }));
  }
}

async function begin() {
  try {
    me = await get("/api/me");
  } catch (error) {
    if (error.status !== 401) askForLogin(error.message);
    return;
  }
  const notice = element("notice");
  notice.hidden = !me.notice;
  setText(notice, me.notice || "");
  showPage();
}

element("login").addEventListener("submit", async (event) => {
  event.preventDefault();
  const form = event.target;
  const button = form.querySelector("button");
  button.disabled = true;
  try {
    await post("/api/login", { name: form.elements.name.value.trim(), password: form.elements.password.value });
    form.elements.password.value = "";
    setText(element("refused"), "");
    await begin();
  } catch (error) {
    setText(element("refused"), error.message);
  } finally {
    button.disabled = false;
  }
});
element("logout").addEventListener("click", async () => {
  try {
    await post("/api/logout");
  } catch {
    // The session is over in any case for this page.
  }
  askForLogin();
});
window.addEventListener("hashchange", showPage);
// Canvases keep the colours and the width of their last drawing.
matchMedia("(prefers-color-scheme: dark)").addEventListener("change", redrawAll);
window.addEventListener("resize", redrawAll);
begin();

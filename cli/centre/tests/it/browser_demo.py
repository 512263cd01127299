"""The demonstration in a headless Chromium: `browser_demo.py URL PASSWORD FOLDER`. Its machines correct already."""
import sys

from playwright.sync_api import sync_playwright

from browser_shots import SIZES, shot

url, password, folder = sys.argv[1:4]

with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
    page = browser.new_page(viewport=SIZES[0])
    page.set_default_timeout(90_000)
    errors = []
    page.on("pageerror", lambda e: errors.append(f"{page.url}: {e} {e.stack}"))
    page.goto(url)
    page.fill("input[name=name]", "demo")
    page.fill("input[name=password]", password)
    page.click("#login button")
    page.wait_for_selector("#shop-table tbody tr")
    # The notice announces automatic confirmations.
    assert "confirms it automatically" in page.inner_text("#notice"), page.inner_text("#notice")
    shot(page, folder, "demo-shop")
    page.click("tr[data-machine=five-1] a")
    page.wait_for_selector("#machine-now:has-text('known in this simulation only')")
    now = page.inner_text("#machine-now")
    assert "error after correction at this position" in now, now
    page.wait_for_selector("#machine-map canvas.map")
    assert "Computed from the active model of this machine, not measured" in page.inner_text("#machine-map .origin")
    origins = """(version) => originOf({ live: version === null ? null : { version }, silent: false, versions: [{ version: 2 }, { version: 1 }] })"""
    assert [page.evaluate(origins, version) for version in (None, 0, 2)] == ["never", "sent", "active"]
    shot(page, folder, "demo-machine")
    page.click("#tabs a[href='#rollouts']")
    page.wait_for_selector("section[data-rollout='3']")
    shot(page, folder, "demo-rollouts")
    page.click("section[data-rollout='1'] a[href^='#model/']")
    page.wait_for_selector("text=nothing was measured")
    # A machine without messages is marked; its map is labelled as computed from the sent model.
    model = page.evaluate("location.hash").split("/")[1]
    ask = """async ([path, body]) => {
        const headers = { "X-Volcomp": "1", "Content-Type": "application/json" };
        const answer = await fetch(path, { method: body ? "POST" : "GET", headers, body: body && JSON.stringify(body) });
        return [answer.status, await answer.json()];
    }"""
    like = page.evaluate(ask, ["/api/machines/mill-1", None])[1]["machine"]
    assert page.evaluate(ask, ["/api/machines", {**like, "machine": "ghost", "nkey": None}])[0] == 200
    assert page.evaluate(ask, ["/api/rollouts", {"model": model, "machines": ["ghost"]}])[0] == 200
    page.click("#tabs a[href='#shop']")
    page.wait_for_selector("tr[data-machine=ghost] [data-key=version]:has-text('sent')")
    row = page.locator("tr[data-machine=ghost]")
    assert row.locator("[data-key=state]").inner_text() == "never connected"
    assert row.locator("[data-key=residual]").inner_text() == "–"
    page.click("tr[data-machine=ghost] a")
    page.wait_for_selector("#machine-now:has-text('Never connected')")
    page.wait_for_selector("#machine-map canvas.map")
    origin = page.inner_text("#machine-map .origin")
    assert "Computed from the model that was sent" in origin and "has never connected" in origin, origin
    heads = page.locator("#machine-map h2").all_inner_texts()
    assert sum("computed" in head for head in heads) == 2, heads
    shot(page, folder, "demo-never")
    assert not errors, errors
    browser.close()
print("done", flush=True)

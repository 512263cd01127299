"""The page of the centre in a headless Chromium: `browser.py URL PASSWORD COUNT FOLDER`.

Every assertion is about what a person sees or touches. The last machine is silent.
"""
import re
import sys

from playwright.sync_api import sync_playwright

import browser_shots
from browser_shots import SIZES

url, password, count, folder = sys.argv[1:5]
count = int(count)
WAIT = 90_000


def log_error(message):
    """Collects console errors, except the status of an overview that is built too slowly on this computer."""
    is_late = "503" in message.text and message.location["url"] == f"{url}api/overview"
    if message.type in ("error", "warning") and "willReadFrequently" not in message.text and not is_late:
        errors.append(message.text)


def until_rows(page, number):
    page.wait_for_function(f"document.querySelectorAll('#shop-table tbody tr').length === {number}")


def shot(page, name):
    browser_shots.shot(page, folder, f"{count}-{name}", whole=count < 10)


with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
    page = browser.new_page(viewport=SIZES[0])
    page.set_default_timeout(WAIT)
    errors, foreign = [], []
    page.on("console", log_error)
    page.on("pageerror", lambda e: errors.append(str(e)))
    page.on("request", lambda r: foreign.append(r.url) if not r.url.startswith(url) else None)
    page.on("dialog", lambda dialog: errors.append(f"a dialog: {dialog.message}"))
    page.goto(url)
    page.wait_for_selector("#login:not([hidden])")
    # Before login the browser logs the status 401.
    assert all("401" in error for error in errors), errors
    shot(page, "login")
    page.fill("input[name=name]", "engineer")
    page.fill("input[name=password]", "wrong wrong wrong")
    page.click("#login button")
    page.wait_for_selector("#refused:has-text('wrong')")
    page.fill("input[name=password]", password)
    page.click("#login button")
    page.wait_for_selector("#shop-table tbody tr")
    errors.clear()
    # The cookie is for no script.
    assert page.evaluate("document.cookie") == ""
    until_rows(page, count)
    assert f"{count} machines" in page.inner_text("#shop-title")
    # The silent machine is unknown, with its age, and none of its numbers is shown.
    silent = page.locator(f"tr[data-machine=mill-{count - 1}]")
    assert silent.locator("[data-key=state]").inner_text() == "unknown"
    assert silent.locator("[data-key=age]").inner_text() == "10 h"
    for key in ("correction", "residual", "degc"):
        assert silent.locator(f"[data-key={key}]").inner_text() == "unknown", key
    page.wait_for_function("document.querySelector('tr[data-machine=mill-0] [data-key=state]').textContent === 'compensating'")
    assert page.locator("tr[data-machine=mill-0] [data-key=correction]").inner_text() == "12.5"
    # Sorting by a column.
    page.click("th[data-key=correction] button")
    page.wait_for_selector("th[data-key=correction][aria-sort=ascending]")
    page.click("th[data-key=correction] button")
    page.wait_for_selector("th[data-key=correction][aria-sort=descending]")
    first = page.locator("#shop-table tbody tr").first.get_attribute("data-machine")
    assert first == f"mill-{count - 2}", first
    page.click("th[data-key=state] button")
    page.wait_for_selector("th[data-key=state][aria-sort=ascending]")
    # A click on a state shows only its machines: two of five, without the silent one.
    page.click("#tally .badge[data-state=compensating]")
    until_rows(page, sum(number % 5 < 2 for number in range(count - 1)))
    page.click("#tally .badge[data-state=compensating]")
    until_rows(page, count)
    page.fill("input[type=search]", "mill-1")
    until_rows(page, sum(str(number).startswith("1") for number in range(count)))
    page.fill("input[type=search]", "")
    until_rows(page, count)
    shot(page, "shop")
    # One machine in depth.
    page.click("tr[data-machine=mill-0] a")
    page.wait_for_selector("#machine-now dl")
    assert "mill-0" in page.inner_text("h1")
    assert "12.5" in page.inner_text("#machine-now")
    degc = page.inner_text("#machine-degc")
    assert "<b>spindle</b>" in degc and "broken" in degc, degc
    # The history shows its period.
    page.wait_for_selector(".period")
    period = page.inner_text(".period")
    assert re.fullmatch(r"\d{4}-\d\d-\d\d \d\d:\d\d to (\d{4}-\d\d-\d\d )?\d\d:\d\d, by the clock of this computer \(UTC.*\)", period), period
    ticks = page.evaluate("() => { const from = new Date(2026, 2, 5, 22, 13).getTime() / 1000; return timeTicks(from, from + 4 * 3600, 6).map((one) => one.text); }")
    assert ticks == ["23:00", "03-06", "01:00", "02:00"], ticks
    shot(page, "machine")
    if count < 10:
        # The model with its map, before and after.
        page.click("#tabs a[href='#models']")
        page.click("main table a")
        page.wait_for_selector("canvas.map")
        assert page.locator("canvas.map").count() == 6
        # A colour scale in numbers, whose colours fall in lightness all the way: they can be told apart without seeing colours.
        label = page.get_attribute("canvas.scale", "aria-label")
        assert label == "Colour scale of both maps: 0 to 25 µm", label
        page.wait_for_timeout(300)
        light = page.evaluate("""() => {
            const canvas = document.querySelector("canvas.scale"), ratio = window.devicePixelRatio;
            const wide = canvas.clientWidth - 14 - 48 - 4;
            const { data } = canvas.getContext("2d").getImageData(16 * ratio, 8 * ratio, wide * ratio, 1);
            return [...Array(20).keys()].map((step) => {
                const [r, g, b] = data.subarray(4 * Math.floor((wide - 1) * ratio * step / 19));
                return 0.2126 * r + 0.7152 * g + 0.0722 * b;
            });
        }""")
        # Its numbers can be read in the dark, too, also where the colours change while it is looked at.
        page.emulate_media(color_scheme="dark")
        page.wait_for_timeout(300)
        brightest = page.evaluate("""() => {
            const canvas = document.querySelector("canvas.scale"), ratio = window.devicePixelRatio;
            const { data } = canvas.getContext("2d").getImageData(0, (canvas.clientHeight - 18) * ratio, canvas.width, 14 * ratio);
            return Math.max(...data.filter((_, index) => index % 4 === 0));
        }""")
        assert brightest > 180, brightest
        page.emulate_media(color_scheme="light")
        assert all(one - other > 3 for one, other in zip(light, light[1:])), light
        assert "<script>" in page.inner_text("h1")
        assert "dX = " in page.inner_text("#formula")
        # Downloads: the machine file as signed, and tables for a control.
        with page.expect_download() as coming:
            page.click("text=Download the machine file")
        assert "EC0Y = 15.0" in open(coming.value.path()).read()
        page.select_option("main form select", "csv")
        page.click("text=Make the tables")
        page.wait_for_selector("main form + .lines a.download")
        with page.expect_download() as coming:
            page.click("main form + .lines a.download")
        # EXX is 24 µm at 800 mm.
        row = next(row for row in open(coming.value.path()) if row.startswith("X,X,800,"))
        assert abs(float(row.split(",")[3]) - 24) < 0.01, row
        shot(page, "model")
        # A roll-out waits for a centre that runs; it can be held.
        page.click("#tabs a[href='#rollouts']")
        page.click("a[href='#rollout/']")
        page.wait_for_selector(".choices input")
        page.click("text=Choose all")
        bare = page.evaluate("() => [...document.querySelectorAll('main form label')].filter((one) => one.querySelector('.what') && !one.querySelector('.hint')).map((one) => one.querySelector('.what').textContent)")
        assert not bare, bare
        shot(page, "start")
        page.click("button.main")
        page.wait_for_selector("section[data-rollout='1']")
        assert "0 of 3 done" in page.inner_text("section[data-rollout='1']")
        shot(page, "rollouts")
        # The network: public ranges are refused in words.
        page.click("#tabs a[href='#network']")
        page.fill("main textarea", "8.8.8.0/24")
        page.click("button.main")
        page.wait_for_selector(".said.bad:has-text('private'):has-text('tick the box')")
        shot(page, "network")
        errors[:] = [error for error in errors if "400" not in error]
        # An OPC UA server that does not name its control: the field is empty, with a hint.
        devices = [{"address": "192.0.2.17", "port": 4840, "kind": "opc-ua", "answers": True, "control": "", "name": "server", "axes": [], "note": "product urn:server", "proposals": []}]
        latest = {"running": False, "by": "", "subnets": ["192.0.2.17"], "done": 1, "of": 1, "devices": devices}
        page.route("**/api/discovery", lambda route: route.fulfill(json=latest))
        page.click("text=Register…")
        field = page.locator("label:has(.what:text-is('Control'))")
        assert field.locator("input").input_value() == ""
        assert "enter make and type" in field.locator(".hint").inner_text()
        shot(page, "register")
        page.unroute("**/api/discovery")
        page.click("#tabs a[href='#alarms']")
        page.wait_for_selector("main h1:has-text('Alarms')")
    # An engineer sees no users and no audit log.
    assert page.locator("#tabs a[href='#users']").count() == 0
    assert not errors, errors
    page.click("#logout")
    page.wait_for_selector("#login:not([hidden])")
    assert page.locator("main").is_hidden()
    page.fill("input[name=name]", "admin")
    page.fill("input[name=password]", password)
    page.click("#login button")
    page.click("#tabs a[href='#users']")
    page.wait_for_selector("main table select")
    # A request sent just before the logout gets the status 401.
    errors[:] = [error for error in errors if "401" not in error]
    shot(page, "users")
    page.click("#tabs a[href='#audit']")
    page.wait_for_selector(".panel.audit tbody tr:has-text('login.refused')")
    if count < 10:
        shot(page, "audit")
        # On a telephone the facts of a record have a line of their own, and the tab of the page is on the screen.
        page.set_viewport_size(SIZES[1])
        page.reload()
        page.wait_for_selector(".panel.audit tbody tr")
        narrow = page.evaluate("() => Math.min(...[...document.querySelectorAll('td.details')].map((cell) => cell.clientWidth))")
        assert narrow > 250, narrow
        left, right = page.evaluate("() => { const { left, right } = document.querySelector('#tabs a[aria-current]').getBoundingClientRect(); return [left, right]; }")
        assert 0 <= left and right <= SIZES[1]["width"], (left, right)
        page.set_viewport_size(SIZES[0])
    assert page.title() != "hit" and not errors, errors
    assert not foreign, foreign
    browser.close()
print("done", flush=True)

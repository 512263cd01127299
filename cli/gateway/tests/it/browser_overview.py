"""The overview of several machines in a headless Chromium: `browser_overview.py URL SCREENSHOT`.

Two machines that run, as they are; then forty that the gateway is made to tell, wide and narrow.
"""
import json
import sys

from playwright.sync_api import sync_playwright

url, screenshot = sys.argv[1:3]
STATES = ["compensating", "holding", "faulted", "disarmed", "arming", "ramping-out", "unknown"]


def machine(number):
    runs = number % 13 != 12
    state = STATES[number // 6] if number % 6 == 5 else "compensating"
    return {
        "name": f"mill-{number + 1}" if number else "grinding-centre-with-the-longest-name.01",
        "phase": "running" if runs else "failed",
        "trouble": None if runs else "can0: no such interface: is it up? (ip link set can0 up type can bitrate 500000)",
        "starts_again": not runs,
        "dashboard": f"http://0.0.0.0:{9000 + number}" if runs else None,
        "state": state if runs else "unknown",
        "reasons": ["positions lost", "controller does not answer", "applied correction not confirmed"] if state == "holding" else [],
        "machine": f"machine {number}" if runs else None,
        "simulated": False,
        "age_ms": 12.0 if runs else None,
        "correction_known": runs and state != "unknown",
        "correction_um": {"X": -12.3, "Y": 4.0, "Z": 0.0} if runs else {},
        "correction_urad": {"A": -104.0, "C": 7.0} if runs and number % 4 == 1 else {},
    }


def fits(page):
    """Nothing is wider than the page."""
    width, within = page.evaluate("[document.documentElement.scrollWidth, document.documentElement.clientWidth]")
    assert width <= within, (width, within)
    for card in page.locator(".machine").all():
        box = card.bounding_box()
        for part in (".name", ".state", ".age", ".why", ".correction", ".file"):
            inner = card.locator(part).bounding_box()
            if inner:
                assert inner["x"] >= box["x"] and inner["x"] + inner["width"] <= box["x"] + box["width"] + 0.5, (part, inner, box)


with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
    page = browser.new_page(viewport={"width": 1440, "height": 900})
    page.set_default_timeout(90_000)
    errors, foreign = [], []
    page.on("console", lambda m: errors.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda e: errors.append(str(e)))
    page.on("request", lambda r: foreign.append(r.url) if not r.url.startswith(url) else None)
    page.goto(url)
    page.wait_for_selector("#banner[data-state=compensating]")
    assert page.inner_text("#summary") == "2 machines"
    assert page.inner_text("#counts") == "2 compensating"
    assert page.locator(".machine").count() == 2
    # The link leads to the machine's own dashboard.
    with page.expect_navigation():
        page.click(".machine >> nth=0")
    page.wait_for_selector("#banner[data-state=compensating]")
    assert page.is_visible("#disarm")
    foreign.clear()
    page.goto(url)
    page.wait_for_selector(".machine")
    # Forty.
    told = {"machines": [machine(number) for number in range(40)]}
    page.route("**/api/machines", lambda route: route.fulfill(status=200, content_type="application/json", body=json.dumps(told)))
    page.wait_for_selector(".machine >> nth=39")
    assert page.inner_text("#summary") == "40 machines"
    assert page.inner_text("#counts").startswith("3 do not run, "), page.inner_text("#counts")
    assert page.get_attribute("#banner", "data-state") == "faulted"
    assert page.get_attribute(".machine >> nth=3 >> .name", "href") == "http://127.0.0.1:9003/"
    assert page.get_attribute(".machine >> nth=12 >> .name", "href") is None
    assert "tried again" in page.inner_text(".machine >> nth=12 >> .why")
    for width, height in ((1440, 900), (768, 1024), (360, 740)):
        page.set_viewport_size({"width": width, "height": height})
        fits(page)
        page.screenshot(path=screenshot.replace(".png", f"-{width}.png"), full_page=True)
    page.set_viewport_size({"width": 1440, "height": 900})
    assert page.evaluate("document.querySelector('main').getBoundingClientRect().height") < 2600
    # Nothing is heard any more: nothing is claimed.
    page.unroute("**/api/machines")
    page.route("**/api/machines", lambda route: route.abort())
    page.wait_for_selector("#banner[data-state=lost]")
    assert page.inner_text(".machine >> nth=0 >> .state") == "unknown"
    assert page.inner_text(".machine >> nth=0 >> .correction") == ""
    errors = [error for error in errors if "ERR_FAILED" not in error]
    assert not errors, errors
    assert not foreign, foreign
    browser.close()

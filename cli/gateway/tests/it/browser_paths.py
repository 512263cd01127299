"""The dashboard of a control without a barrier, with a path that never answers and no token: `browser_paths.py URL SCREENSHOT`.

Every assertion is about what a person sees.
"""
import sys

from playwright.sync_api import sync_playwright

url, screenshot = sys.argv[1:3]

with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
    page = browser.new_page(viewport={"width": 1280, "height": 800})
    page.set_default_timeout(90_000)
    errors = []
    page.on("pageerror", lambda e: errors.append(str(e)))
    page.goto(url)
    page.wait_for_selector("#reasons:has-text('a standby path does not answer')")
    assert page.is_visible("#no-barrier")
    assert "no barrier" not in page.inner_text("#reasons"), "it is shown once"
    for path in (
        ("1 in use", "no barrier", "holds no correction"),
        ("2 standby", "has never answered", "applied correction unknown, never confirmed"),
    ):
        shown = page.locator("#paths li")
        for words in path:
            shown = shown.filter(has_text=words)
        shown.wait_for()
    assert page.locator("#paths li").count() == 2
    for axis in "XY":
        page.wait_for_selector(f".axis[data-axis={axis}] .shown:text-matches('^unverified')")
    # Without a token there is only Disarm to press, and it is said why.
    assert page.locator("button:visible:not(#spans button, #more)").all_inner_texts() == ["Disarm"] and page.is_enabled("#disarm")
    assert page.is_visible("#not-operable")
    print("ready", flush=True)
    # The control is gone now: what it applies is not known.
    sys.stdin.readline()
    page.wait_for_selector(".axis[data-axis=Y] .correction.unknown")
    page.wait_for_selector(".axis[data-axis=Y] .position.unknown")
    assert page.inner_text(".axis[data-axis=Y] .correction .value") == "unknown"
    # What is to be done stands first, what follows from it after.
    page.wait_for_selector("#cause:has-text('check the cable and the control')")
    assert page.inner_text("#further").startswith("controller does not answer"), page.inner_text("#further")
    assert "applied correction unknown, last confirmed" in page.inner_text("#paths li:first-child")
    # Nothing jumps: the map keeps its place.
    assert page.is_visible("#map-panel")
    for width in (1280, 390):
        page.set_viewport_size({"width": width, "height": 844})
        page.wait_for_timeout(300)
        page.screenshot(path=screenshot.replace(".png", f"-{width}.png"), full_page=True)
        wide = page.evaluate("() => document.documentElement.scrollWidth")
        assert wide <= width, f"{wide} px do not fit {width}"
    assert not errors, errors
    browser.close()
print("done", flush=True)

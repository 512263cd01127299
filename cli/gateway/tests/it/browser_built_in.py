"""The page *Model* of the built-in simulation in a headless Chromium: `browser_built_in.py URL TOKEN SCREENSHOT`.

It takes no files, which stands there before anybody has chosen one.
"""
import sys

from playwright.sync_api import sync_playwright

url, token, screenshot = sys.argv[1:4]

with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.set_default_timeout(90_000)
    page.goto(f"{url}model")
    # Even before a token is given.
    page.wait_for_selector("#no-files:not([hidden])")
    page.fill("#token", token)
    page.click("#token-form button")
    page.wait_for_selector("#role:has-text('token of erna')")
    # It looks at the gateway again and again.
    page.wait_for_timeout(2500)
    for control in ("#machine-file", "#configured"):
        assert page.is_disabled(control), control
    assert "built-in simulation cannot be replaced" in page.inner_text("#no-files"), page.inner_text("#no-files")
    assert not page.is_visible("#differs"), page.inner_text("#differs")
    page.screenshot(path=screenshot, full_page=True)
    page.set_viewport_size({"width": 420, "height": 900})
    wide = page.evaluate("[document.documentElement.scrollWidth, window.innerWidth]")
    assert wide[0] <= wide[1], wide
    page.screenshot(path=screenshot.replace(".png", "-420.png"), full_page=True)
    browser.close()

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
    page.on("pageerror", lambda e: errors.append(str(e)))
    page.goto(url)
    page.fill("input[name=name]", "demo")
    page.fill("input[name=password]", password)
    page.click("#login button")
    page.wait_for_selector("#shop-table tbody tr")
    # What it confirms by itself it says.
    assert "confirms it by itself" in page.inner_text("#notice"), page.inner_text("#notice")
    shot(page, folder, "demo-shop")
    page.click("tr[data-machine=five-1] a")
    page.wait_for_selector("#machine-now:has-text('known in this simulation only')")
    now = page.inner_text("#machine-now")
    assert "the error that the model leaves here" in now, now
    page.wait_for_selector("#machine-map canvas.map")
    shot(page, folder, "demo-machine")
    page.click("#tabs a[href='#rollouts']")
    page.wait_for_selector("section[data-rollout='3']")
    shot(page, folder, "demo-rollouts")
    page.click("section[data-rollout='1'] a[href^='#model/']")
    page.wait_for_selector("text=nothing was measured")
    assert not errors, errors
    browser.close()
print("done", flush=True)

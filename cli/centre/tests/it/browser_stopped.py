"""A roll-out that has stopped, in a headless Chromium: `browser_stopped.py URL PASSWORD FOLDER`."""
import sys

from playwright.sync_api import sync_playwright

from browser_shots import SIZES, shot

url, password, folder = sys.argv[1:4]


def late(route):
    """The response if a machine has activated a withdrawn version: only its reported version shows it."""
    response = route.fetch()
    rollouts = response.json()
    rollouts[0]["in_force_on"] = ["mill-2"]
    route.fulfill(response=response, json=rollouts)


def at_rollouts(page, name):
    page.set_default_timeout(90_000)
    page.goto(url)
    page.fill("input[name=name]", name)
    page.fill("input[name=password]", password)
    page.click("#login button")
    page.click("#tabs a[href='#rollouts']")
    page.wait_for_selector("section[data-rollout='1'] .lead")
    return page.inner_text("section[data-rollout='1'] .lead")


with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
    page = browser.new_page(viewport=SIZES[0])
    page.route("**/api/rollouts", late)
    lead = at_rollouts(page, "engineer")
    assert "1 of 4 report the new model as active although they did not answer in time, and keep it until a user decides: mill-2" in lead, lead
    assert page.locator("section[data-rollout='1'] tr:has(a:text-is('mill-2')) >> text=Keep this model").count() == 1
    page.close()
    for name in ("viewer", "engineer"):
        page = browser.new_page(viewport=SIZES[0])
        lead = at_rollouts(page, name)
        for part in (
            "1 of 4 have activated the new model, and keep it until a user decides: mill-0",
            "1 of 4 received the new model and dropped out; the page of each shows the active version: mill-1",
            "2 of 4 received nothing, or a version that was withdrawn, and keep the previous model: mill-2, mill-3",
        ):
            assert part in lead, lead
        # A viewer sees no buttons.
        assert page.locator(".lead button").count() == (2 if name == "engineer" else 0)
        if name == "engineer":
            shot(page, folder, "stopped")
            # While stopped, a machine may keep the model; the return to the previous one requires the roll-out to be over.
            row = "section[data-rollout='1'] tr:has(a:text-is('%s'))"
            assert page.locator("text=Back to the previous model").count() == 0
            assert page.locator("text=Keep this model").count() == 2
            page.click((row % "mill-0") + " >> text=Keep this model")
            page.wait_for_selector((row % "mill-0") + " >> text=kept by engineer")
            assert page.locator("text=Keep this model").count() == 1
            page.click("text=Stop for good")
            page.wait_for_selector("text=applied within a second")
        page.close()
    browser.close()
print("done", flush=True)

"""A roll-out that has stopped, in a headless Chromium: `browser_stopped.py URL PASSWORD FOLDER`."""
import sys

from playwright.sync_api import sync_playwright

from browser_shots import SIZES, shot

url, password, folder = sys.argv[1:4]


def late(route):
    """The answer where a machine has taken the model that was taken back: nothing but what it tells says so."""
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
    assert "1 of 4 tell that they have the new model in force although they did not answer in time, and keep it until somebody decides: mill-2" in lead, lead
    assert page.locator("section[data-rollout='1'] tr:has(a:text-is('mill-2')) >> text=Keep this model").count() == 1
    page.close()
    for name in ("viewer", "engineer"):
        page = browser.new_page(viewport=SIZES[0])
        lead = at_rollouts(page, name)
        for part in (
            "1 of 4 have the new model in force, and keep it until somebody decides: mill-0",
            "1 of 4 were sent the new model, and are out; whether they have it in force shows the page of each: mill-1",
            "2 of 4 were sent nothing, or what was sent was taken back, and keep what they had before: mill-2, mill-3",
        ):
            assert part in lead, lead
        # A viewer is offered nothing that is refused.
        assert page.locator(".lead button").count() == (2 if name == "engineer" else 0)
        if name == "engineer":
            shot(page, folder, "stopped")
            # Stopped, a machine may keep the model; the way back is open once the roll-out is over.
            row = "section[data-rollout='1'] tr:has(a:text-is('%s'))"
            assert page.locator("text=Back to the model before").count() == 0
            assert page.locator("text=Keep this model").count() == 2
            page.click((row % "mill-0") + " >> text=Keep this model")
            page.wait_for_selector((row % "mill-0") + " >> text=kept by engineer")
            assert page.locator("text=Keep this model").count() == 1
            page.click("text=Stop for good")
            page.wait_for_selector("text=taken up within a second")
        page.close()
    browser.close()
print("done", flush=True)

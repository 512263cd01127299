"""The page *Model* in a headless Chromium: `browser_model.py URL TOKEN FOLDER SCREENSHOT`.

Measurement files are uploaded, questions answered, the model put in force and gone back from, as a person does it.
"""
import pathlib
import re
import sys

from playwright.sync_api import sync_playwright

url, token, folder, screenshot = sys.argv[1:5]
chromium = "/usr/bin/chromium"
files = [str(pathlib.Path(folder) / name) for name in ("ebx.csv", "exx.csv", "eyx.csv", "exy.csv", "ezx-level.csv")]


def hold(page, selector, hold_ms=1300):
    button = page.locator(selector).first
    button.scroll_into_view_if_needed()
    box = button.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] / 2)
    page.mouse.down()
    page.wait_for_timeout(hold_ms)
    page.mouse.up()


def shot(page, name):
    page.evaluate("window.scrollTo(0, 0)")
    page.screenshot(path=screenshot.replace(".png", f"-{name}.png"), full_page=True)


def fits(page):
    wide = page.evaluate("[document.documentElement.scrollWidth, window.innerWidth]")
    assert wide[0] <= wide[1], f"the page is wider than its window: {wide}"


def until(page, what, seconds=90):
    # The page's own rules forbid to wait by an expression in it.
    for _ in range(seconds * 10):
        if what():
            return
        page.wait_for_timeout(100)
    raise AssertionError("waited in vain")


def answer(about, key):
    """What the calibration file of the example says."""
    if key == "point":
        return "0, 0, -350" if "exx" in about else "0, 0, -420"
    if key == "rides":
        return "carriage" if "exx" in about else "other"
    if key == "sign":
        return "-1" if "ebx" in about or "ezx" in about else "1"
    if key == "error":
        return pathlib.Path(about.split()[-1]).name.split(".")[0].split("-")[0].upper()
    if key == "unit":
        return "urad" if "ebx" in about or "ezx" in about else "um"
    return {"at.X": "300", "at.Y": "200", "at.Z": "-300", "bridge_mm": "150", "reading": "slope", "reference_angle_urad": "2"}[key]


def fill(page):
    for field in page.locator("#questions [data-key]:not([data-key=leave_out])").all():
        about = field.evaluate("of => of.closest('fieldset').querySelector('legend').textContent")
        value = answer(about, field.get_attribute("data-key"))
        if field.evaluate("of => of.tagName") == "SELECT":
            field.select_option(value)
        else:
            field.fill(value)


with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
    page = browser.new_page(viewport={"width": 1280, "height": 900})
    page.set_default_timeout(90_000)
    errors, foreign = [], []
    # What is not confirmed yet is answered by 409, which the browser tells.
    page.on("console", lambda m: errors.append(m.text) if m.type in ("error", "warning") and "409" not in m.text else None)
    page.on("pageerror", lambda e: errors.append(str(e)))
    page.on("request", lambda r: foreign.append(r.url) if not r.url.startswith(url) else None)
    page.goto(url)
    page.click("#to-model a")
    page.wait_for_selector("#in-force dd")
    # Without an engineer's token nothing can be done.
    for control in ("#measurements", "#machine-file", "#configured"):
        assert page.is_disabled(control), control
    assert page.is_enabled("#disarm")
    page.fill("#token", token)
    page.click("#token-form button")
    page.wait_for_selector("#measurements:not([disabled])")
    assert token not in page.url and token not in page.content()
    shot(page, "1280-begin")
    page.set_input_files("#measurements", files)
    page.wait_for_selector("#draft:not([disabled])")
    until(page, lambda: page.locator("#files li").count() == 5)
    page.wait_for_selector("#draft:not([disabled])")
    # One that cannot be used is told apart from conflicts and notes, and can be taken off.
    page.set_input_files("#measurements", {"name": "EYZ-Bericht.xlsx", "mimeType": "application/octet-stream", "buffer": b"rubbish"})
    until(page, lambda: page.locator("#files li").count() == 6)
    page.wait_for_selector("#draft:not([disabled])")
    page.click("#draft")
    page.wait_for_selector("#questions fieldset")
    assert page.is_visible("text=Not used") and not page.is_visible("text=Conflicts")
    said = page.inner_text("#left-over")
    assert said.count("Bericht") == 1 and "it would have given EYZ" in said, said
    shot(page, "1280-not-used")
    page.click("#files li:has-text('Bericht') button")
    until(page, lambda: page.locator("#files li").count() == 5)
    page.wait_for_selector("#draft:not([disabled])")
    page.click("#draft")
    page.wait_for_selector("#questions fieldset")
    assert not page.is_visible("text=Not used")
    # One field for many: it fills those that are empty, and no others.
    places = page.locator("#questions [data-key='at.Z']")
    many = places.count()
    assert many > 2
    places.first.fill("-299")
    page.fill("#questions [data-all='at.Z']", "-300")
    page.click("#questions .for-all button")
    assert [field.input_value() for field in places.all()] == ["-299"] + ["-300"] * (many - 1)
    assert page.locator("#questions [data-all=error]").count() == 0
    # Refused, the open fields are marked, and what was typed outlives a reload of the page: the gateway keeps it.
    page.click("#calibrate")
    page.wait_for_selector("#questions .open-field")
    said = page.inner_text("#open")
    assert "open questions: leave none empty" in said and ".toml" not in said, said
    fields = page.locator("#questions [data-key]:not([data-key=leave_out])").all()
    for field in fields:
        is_marked = "open-field" in (field.get_attribute("class") or "")
        assert is_marked == (field.input_value() == ""), field.get_attribute("data-named")
    shot(page, "1280-open")
    page.evaluate("sessionStorage.removeItem('typed')")
    page.reload()
    page.wait_for_selector("#questions .open-field")
    assert [field.input_value() for field in places.all()] == ["-299"] + ["-300"] * (many - 1)
    # What was typed and not sent is kept by the tab.
    page.locator("#questions [data-key='at.Y']").first.fill("123")
    page.reload()
    page.wait_for_selector("#questions .open-field")
    assert page.locator("#questions [data-key='at.Y']").first.input_value() == "123"
    page.wait_for_selector("#calibrate:not([disabled])")
    page.set_viewport_size({"width": 420, "height": 900})
    fits(page)
    shot(page, "420-open")
    page.set_viewport_size({"width": 1280, "height": 900})
    fill(page)
    assert page.locator("#questions .open-field").count() == 0
    # What was typed stays while the page looks at the gateway.
    page.wait_for_timeout(1500)
    assert page.locator("#questions [data-key='at.Y']").first.input_value() == "200"
    shot(page, "1280-questions")
    fits(page)
    page.click("#calibrate")
    # The unit of the level says that it stood on a bridge: that is asked now, and said where the button is.
    page.wait_for_selector("#questions [data-key=bridge_mm]")
    assert "open question" in page.inner_text("#open"), page.inner_text("#open")
    fill(page)
    page.click("#calibrate")
    page.wait_for_selector("#result-panel:not([hidden])")
    page.wait_for_selector("#activate:not([disabled])")
    assert page.locator("#curves svg").count() == page.locator("#fits tbody tr").count() > 0
    assert page.locator("#diagonals svg").count() == 4
    assert page.locator("#warnings li").count() > 0
    assert "NaN" not in page.inner_html("#curves") + page.inner_html("#diagonals")
    shot(page, "1280-result")
    fits(page)
    assert not page.is_visible("#questions fieldset"), "the answered questions are folded"
    # The curves are folded by the axis that moves; unfolded, every frame has more than a zero on its axis.
    tall = page.evaluate("document.documentElement.scrollHeight")
    assert page.locator("#curves details").count() > 0 and page.locator("#curves details[open]").count() == 0
    for summary in page.locator("#curves summary").all():
        assert "largest residual" in summary.inner_text()
        summary.click()
    assert page.evaluate("document.documentElement.scrollHeight") > tall
    for of in page.locator("#curves svg").all():
        at = {label.get_attribute("y"): None for label in of.locator("text[text-anchor=end]").all()}
        assert len(at) >= 6, at
    names = page.locator("#diagonals figcaption").all_inner_texts()
    assert [name.split(";")[0] for name in names] == ["PPP +X +Y +Z", "NPP −X +Y +Z", "PNP +X −Y +Z", "PPN +X +Y −Z"], names
    # Another width of the window leaves the curves unfolded.
    unfolded = page.locator("#curves details[open]").count()
    page.set_viewport_size({"width": 900, "height": 700})
    page.wait_for_timeout(300)
    assert page.locator("#curves details[open]").count() == unfolded > 0
    page.set_viewport_size({"width": 1280, "height": 900})
    # The arrow means without -> with correction; in force is a model without these errors, which leaves all of them.
    for said in page.locator("#diagonals figcaption").all_inner_texts():
        numbers = re.search(r"without → with correction: (\S+) → (\S+) µm by the model in force, (\S+) → (\S+) µm by the new one", said)
        assert numbers, said
        without, left, again, new = numbers.groups()
        assert without == left == again != "0.0" and new == "0.0", said
    assert "without correction → with correction" in page.inner_text("#diagonals-part")
    fits(page)
    page.emulate_media(color_scheme="dark")
    shot(page, "1280-result-dark")
    page.set_viewport_size({"width": 390, "height": 844})
    fits(page)
    shot(page, "390-result-dark")
    page.emulate_media(color_scheme="light")
    shot(page, "390-result")
    page.set_viewport_size({"width": 1280, "height": 900})
    # A short touch does nothing, a second puts it in force, after a question where it moves far.
    hash_before = page.inner_text("#in-force")
    hold(page, "#activate", 300)
    page.wait_for_timeout(700)
    assert page.inner_text("#in-force") == hash_before
    hold(page, "#activate")
    page.wait_for_selector("#confirm-panel:not([hidden])")
    assert "moves by" in page.inner_text("#confirm-lines")
    shot(page, "1280-confirm")
    hold(page, "#confirm", 300)
    page.wait_for_timeout(700)
    assert page.is_visible("#confirm-panel"), "a short touch confirms nothing"
    hold(page, "#confirm")
    page.wait_for_selector("#result-panel", state="hidden")
    until(page, lambda: "erna" in page.inner_text("#in-force"))
    # Back to the configured file.
    page.wait_for_selector("#configured:not([disabled])")
    hold(page, "#configured")
    page.wait_for_selector("#confirm-panel:not([hidden])")
    hold(page, "#confirm")
    until(page, lambda: "erna" not in page.inner_text("#in-force"))
    # And forward again from the history.
    page.wait_for_selector("#history td button:not([disabled])")
    assert "hold for 1 s" in page.locator("#history td button").first.inner_text()
    hold(page, "#history td button")
    page.wait_for_selector("#confirm-panel:not([hidden])")
    page.click("#not-now")
    assert page.is_hidden("#confirm-panel")
    shot(page, "1280-history")
    fits(page)
    page.set_viewport_size({"width": 390, "height": 844})
    fits(page)
    shot(page, "390-history")
    page.emulate_media(color_scheme="dark")
    shot(page, "390-history-dark")
    assert not errors, errors
    assert not foreign, foreign
    browser.close()

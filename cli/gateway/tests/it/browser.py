"""The dashboard in a headless Chromium: `browser.py URL TOKEN SCREENSHOT`.

Every assertion is about what a person sees or touches.
"""
import sys
import threading
import urllib.error
import urllib.request

from playwright.sync_api import sync_playwright

url, token, screenshot = sys.argv[1:4]
chromium = "/usr/bin/chromium"


def streams_left(url):
    try:
        urllib.request.urlopen(url + "api/events").close()
    except urllib.error.HTTPError as refused:
        assert refused.code == 503, refused
        return False
    return True


def state(page, name):
    page.locator(f"#banner[data-state={name}] #state").filter(has_text=name.replace("-", " ")).wait_for()


def touches(page, selector):
    """A short touch, in one turn of the page: no computer is so slow that it becomes a long one. Returns the answer to it."""
    return page.locator(selector).evaluate("""(button) => {
        for (const name of ["pointerdown", "pointerup"]) button.dispatchEvent(new PointerEvent(name));
        return document.getElementById("answer").innerText;
    }""")


def holds(page, selector):
    """Presses a button until the page takes it for held."""
    page.hover(selector)
    page.mouse.down()
    page.wait_for_selector(f"{selector}:not(.holding)")
    page.mouse.up()


def listens(stream, ends):
    with stream:
        while not ends.is_set() and stream.readline():
            pass


with sync_playwright() as playwright:
    browser = playwright.chromium.launch(executable_path=chromium, args=["--no-sandbox"])
    page = browser.new_page(viewport={"width": 1024, "height": 768})
    page.set_default_timeout(90_000)
    errors, foreign = [], []
    page.on("console", lambda m: errors.append(m.text) if m.type in ("error", "warning") else None)
    page.on("pageerror", lambda e: errors.append(str(e)))
    page.on("request", lambda r: foreign.append(r.url) if not r.url.startswith(url) else None)
    page.goto(url)
    state(page, "compensating")
    assert page.locator(".axis").count() == 3
    assert page.is_visible("#simulated")
    positions = page.inner_text(".axis[data-axis=X] .position .value")
    page.wait_for_function("before => document.querySelector('.axis[data-axis=X] .position .value').innerText !== before", arg=positions)
    assert page.locator("#temperatures tr").count() == 5
    page.wait_for_selector("#reduction:has-text('%')")
    # Every range shows its period, what the curves are, and the limits.
    for span in page.locator("#spans button").all():
        span.click()
        page.wait_for_selector(f"#spans button[value='{span.get_attribute('value')}'][aria-pressed=true]")
        page.wait_for_selector("#error-panel .legend:has-text('without correction')")
        page.wait_for_selector("#um-panel .legend:has-text('±250')")
        assert page.locator("#spans button[aria-pressed=true]").count() == 1
    page.click("#spans button >> nth=0")
    page.wait_for_selector("#error-panel .legend:has-text('with correction')")
    page.wait_for_selector("#degc-panel .legend:has-text('spindle')")
    # What has happened, newest first, and marked on the axis of time.
    page.wait_for_selector("#events li:first-child:has-text('follows the model')")
    events = page.locator("#events li").all_inner_texts()
    assert any("Gateway" in event and "started" in event for event in events), events
    assert any("Test shift" in event for event in events), events
    # The way to the control: it has a barrier, and answers.
    assert page.locator("#paths li").count() == 1
    path = page.inner_text("#paths li")
    assert "barrier" in path and "no barrier" not in path and "answered" in path, path
    assert page.is_hidden("#no-barrier")
    for axis in "XYZ":
        page.wait_for_selector(f".axis[data-axis={axis}] .shown:text-matches('^verified')")
    # Nothing but Disarm can be pressed without a token.
    for button in ("arm", "acknowledge", "reload"):
        assert page.is_disabled(f"#{button}"), button
    assert page.is_enabled("#disarm")
    page.fill("#token", token)
    page.click("#token-form button")
    page.wait_for_selector("#reload:not([disabled])")
    assert page.is_disabled("#arm") and page.is_disabled("#acknowledge")
    assert token not in page.url and token not in page.content()
    page.wait_for_timeout(4000)
    page.screenshot(path=screenshot, full_page=True)
    # Stopping is in view at every size, wherever the page is scrolled to, also with every reason at once.
    for size in ({"width": 1280, "height": 800}, {"width": 400, "height": 750}, {"width": 375, "height": 667}, {"width": 360, "height": 740}, {"width": 750, "height": 400}):
        page.set_viewport_size(size)
        at_first = {}
        for reasons in (None, ["emergency stop", *["a reason that is as long as most of them"] * 12]):
            for to in (0, 1e6):
                page.evaluate("([to, reasons]) => { window.scrollTo(0, to); if (reasons) showReasons(reasons); }", [to, reasons])
                for button in ("#disarm", "#acknowledge", "#state"):
                    box = page.locator(button).bounding_box()
                    seen = 0 <= box["x"] and box["x"] + box["width"] <= size["width"] and 0 <= box["y"] and box["y"] + box["height"] <= size["height"]
                    assert seen, f"{button} at {box} of {size}"
                    assert box == at_first.setdefault(button, box), f"{button} jumps at {size}"
                most = (0.4 if size["width"] <= 400 else 0.7) * size["height"]
                assert page.locator("#banner").bounding_box()["height"] <= most, f"the banner covers {size}"
                # Nothing lies over it.
                assert page.evaluate("""() => {
                    const { x, y, width, height } = document.getElementById("disarm").getBoundingClientRect();
                    return document.elementFromPoint(x + width / 2, y + height / 2).id;
                }""") == "disarm", size
        page.screenshot(path=screenshot.replace(".png", f"-at-hand-{size['width']}.png"))
    page.set_viewport_size({"width": 1024, "height": 768})
    page.evaluate("window.scrollTo(0, 0)")
    # A question about a machine without corrected rotary axes says nothing of them.
    asked = {"worst_corner_um": 7.5, "worst_corner_urad": None, "confirm_um": 5, "confirm_urad": None, "limits": {"limit_um": [20, 40]}}
    assert page.evaluate("changesOf", asked) == [
        "At the worst point of the work space the correction changes by 7.5 µm (allowed without confirmation: 5 µm).",
        "limit_um: 20 → 40",
    ]
    # Stopping is one touch; starting is a second of holding.
    page.click("#disarm")
    page.wait_for_selector("#answer:has-text('disarm: accepted')")
    state(page, "disarmed")
    page.wait_for_selector("#reduction:has-text('none is applied')")
    # What may be left over in the control can still be ramped out.
    page.wait_for_selector("#arm:not([disabled])")
    assert page.is_enabled("#disarm")
    page.wait_for_selector("#arm:not([disabled])")
    assert touches(page, "#arm") == "hold Arm for 1 s"
    page.wait_for_timeout(1500)
    assert page.get_attribute("#banner", "data-state") == "disarmed", "a short touch does nothing"
    holds(page, "#arm")
    state(page, "compensating")
    # A pulled cable: the banner is red, and the event says what to do; it corrects again once the cable is back.
    page.click("#demo button[value=cable]")
    page.wait_for_selector("#banner.gone")
    red = page.evaluate("() => getComputedStyle(document.getElementById('banner')).backgroundColor")
    assert red == "rgb(179, 38, 30)", red
    page.wait_for_selector("#events .advice:has-text('Check the cable')")
    # The cause names the cable: the advice does not repeat it. On a phone all of it is seen, and most of the page.
    page.wait_for_selector("#further:has-text('applied correction not confirmed')")
    assert page.inner_text("#why").lower().count("check the cable") == 1, page.inner_text("#why")
    page.set_viewport_size({"width": 390, "height": 844})
    page.screenshot(path=screenshot.replace(".png", "-gone-390.png"))
    assert page.locator("#banner").bounding_box()["height"] <= 0.4 * 844
    assert page.evaluate("(({ scrollHeight, clientHeight }) => scrollHeight <= clientHeight)(document.getElementById('why'))")
    page.set_viewport_size({"width": 1024, "height": 768})
    page.click("#demo button[value=cable][aria-pressed=true]")
    state(page, "compensating")
    page.wait_for_selector("#banner:not(.gone)")
    page.click("#demo button[value=heat]")
    page.wait_for_selector("#temperatures tr:has-text('jumped')")
    page.wait_for_selector("#events li:has-text('Degraded: spindle') .advice:has-text('Check the sensor')")
    page.wait_for_selector("#demo button[value=heat]:has-text('Cool')")
    page.click("#demo button[value=heat]")
    # Who acknowledges before the sensor is read again has accepted the heat, and the way back is the next jump.
    for _ in range(20):
        if page.is_enabled("#acknowledge"):
            holds(page, "#acknowledge")
        page.wait_for_timeout(2000)
        if not page.locator("#temperatures:has-text('jumped')").count():
            break
    page.wait_for_selector("#events li:has-text('No longer degraded')")
    # While a button is held it fills.
    filled = page.locator("#reload").evaluate("""(button) => {
        button.dispatchEvent(new PointerEvent("pointerdown"));
        const [filling] = button.getAnimations();
        filling.currentTime = 500;
        const filled = parseFloat(getComputedStyle(button).backgroundPositionX);
        button.dispatchEvent(new PointerEvent("pointerup"));
        return filled;
    }""")
    assert 10 < filled < 90, filled
    # Every button is a target for a glove: 48 px of CSS or more.
    for size in ({"width": 1280, "height": 800}, {"width": 768, "height": 1024}, {"width": 390, "height": 844}, {"width": 360, "height": 740}):
        page.set_viewport_size(size)
        page.wait_for_timeout(300)
        page.screenshot(path=screenshot.replace(".png", f"-{size['width']}.png"), full_page=True)
        # What is written beside a heading stays in its panel.
        for key in page.locator(".key:visible").all():
            box, panel = key.bounding_box(), key.locator("xpath=ancestor::section").bounding_box()
            assert box["x"] + box["width"] <= panel["x"] + panel["width"], f"{size}: {key.inner_text()}"
        wide = page.evaluate("() => document.documentElement.scrollWidth")
        assert wide <= size["width"], f"{wide} px do not fit {size['width']}"
        for button in page.locator("button:visible").all():
            assert button.bounding_box()["height"] >= 48, button.inner_text()
    # A wrong token is said at once, and nothing can be pressed with it.
    errors.clear()
    page.fill("#token", "0" * 32)
    page.click("#token-form button")
    page.wait_for_selector("#answer:has-text('refused')")
    for button in ("arm", "acknowledge", "reload"):
        assert page.is_disabled(f"#{button}"), button
    assert page.is_enabled("#disarm")
    assert "the cross marks" in page.inner_text("#map-scale")
    assert "corrects:" in page.inner_text("#paths")
    # A refused request is an error to the browser, not of the page.
    assert all("401" in error for error in errors), errors
    errors.clear()
    # Others keep every event stream open: the page goes on showing what is so, and disarms, without a token here.
    ends = threading.Event()
    for _ in range(15):
        # The gateway closes a stream that is not read.
        threading.Thread(target=listens, args=(urllib.request.urlopen(url + "api/events"), ends), daemon=True).start()
    assert not streams_left(url)
    late = browser.new_page(viewport={"width": 1024, "height": 768})
    late.set_default_timeout(90_000)
    late.goto(url)
    state(late, "compensating")
    shown = late.inner_text(".axis[data-axis=X] .position .value")
    late.wait_for_function("shown => document.querySelector('.axis[data-axis=X] .position .value').innerText !== shown", arg=shown)
    assert late.is_enabled("#disarm") and not streams_left(url)
    late.click("#disarm")
    state(late, "disarmed")
    late.close()
    ends.set()
    print("ready", flush=True)
    # The gateway ends now: the page must not go on showing its last words.
    sys.stdin.readline()
    page.wait_for_selector("#banner[data-state=lost]")
    # Whatever the page hears, Disarm can be pressed.
    assert page.is_enabled("#disarm") and page.is_disabled("#arm")
    # Nothing is told of a machine that is not heard.
    assert "the present position is unknown" in page.inner_text("#map-scale")
    assert "corrects" not in page.inner_text("#paths"), page.inner_text("#paths")
    assert page.inner_text("#answer") == ""
    assert page.inner_text("#reduction") == "unknown"
    assert all("ERR_" in error for error in errors), errors
    assert not foreign, foreign
    browser.close()
print("done", flush=True)

"""Pictures of a page at two widths, light and dark: nothing may be wider than the screen."""

SIZES = ({"width": 1280, "height": 800}, {"width": 390, "height": 844})
# Frames that scroll sideways: on a telephone a table folds to cards, and everything of it is on the screen.
CUT = """() => [...document.querySelectorAll('.scroll, .facts, pre, .panel')]
    .filter((one) => one.offsetParent && one.scrollWidth > one.clientWidth + 1)
    .map((one) => `${one.tagName}.${one.className} ${one.scrollWidth} > ${one.clientWidth}: ${one.textContent.slice(0, 60)}`)"""


def shot(page, folder, name, whole=True):
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        for size in SIZES:
            page.set_viewport_size(size)
            page.wait_for_timeout(400)
            page.screenshot(path=f"{folder}/centre-{name}-{size['width']}-{scheme}.png", full_page=whole)
            wide = page.evaluate("() => document.documentElement.scrollWidth")
            assert wide <= size["width"], f"{name}: {wide} px do not fit {size['width']}"
            cut = page.evaluate(CUT)
            assert not cut, f"{name}: cut at {size['width']} px: {cut}"
    page.emulate_media(color_scheme="light")
    page.set_viewport_size(SIZES[0])

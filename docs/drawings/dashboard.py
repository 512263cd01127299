#!/usr/bin/env python3
"""Takes docs/src/pictures/dashboard.png: the gateway's dashboard while it corrects the simulated machine.

    target/test-venv/bin/python docs/drawings/dashboard.py [PROGRAM]

PROGRAM is volcomp-gateway, by default that of target/debug. Playwright is one of the packages in tests/peers.txt.
"""

import json
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

from playwright.sync_api import sync_playwright

ROOT = Path(__file__).resolve().parents[2]
PICTURE = ROOT / "docs/src/pictures/dashboard.png"
# The trend shows two minutes.
TREND_S = 130


def state(url):
    with urllib.request.urlopen(url + "/api/state", timeout=5) as answer:
        return json.load(answer)["state"]


def main():
    program = sys.argv[1] if len(sys.argv) > 1 else ROOT / "target/debug/volcomp-gateway"
    gateway = subprocess.Popen(
        [program, "--simulate", "--listen", "127.0.0.1:0"], stdout=subprocess.PIPE, text=True
    )
    try:
        url = gateway.stdout.readline().split()[-1]
        with sync_playwright() as playwright:
            browser = playwright.chromium.launch(executable_path="/usr/bin/chromium", args=["--no-sandbox"])
            page = browser.new_page(viewport={"width": 1440, "height": 1020})
            page.goto(url)
            time.sleep(TREND_S)
            found = state(url)
            if found != "compensating":
                sys.exit(f"the gateway is {found}, expected compensating")
            page.screenshot(path=PICTURE)
    finally:
        gateway.terminate()
        gateway.wait()
    print(f"wrote {PICTURE.relative_to(ROOT)}")


if __name__ == "__main__":
    main()

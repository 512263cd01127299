# SPDX-License-Identifier: GPL-2.0-or-later
"""The bridge in user space beside a LinuxCNC that does what the test says, without HAL and sockets. It imports the bridge, and
is under its licence. The lines on standard input, and the answers, are those of scans.c, and:

    torn N    in the next N tries to read the pins, the servo thread goes on meanwhile
    disk 0|1  whether the epoch can be written down"""

import os
import sys
import tempfile
import types

sys.dont_write_bytecode = True
for name in ("hal", "linuxcnc"):
    module = types.ModuleType(name)
    module.error = RuntimeError
    sys.modules[name] = module
sys.path.insert(0, sys.argv[1])
import volcomp_bridge as bridge  # noqa: E402
from barrier import Settings  # noqa: E402


FOLDER = tempfile.TemporaryDirectory()


class Pins(dict):
    """Those of the bridge's component."""

    torn = 0

    def __getitem__(self, name):
        if name == "begin" and self.torn > 0:
            self.torn -= 1
            return super().__getitem__("begin") + 1
        return super().__getitem__(name)


class Senders:
    def __init__(self):
        self.frames, self.sent = [], ""

    def mailboxes(self):
        frames, self.frames = self.frames, []
        return frames

    def send(self, data):
        self.sent = data.hex()


class Kept(bridge.KeptEpoch):
    """Writes at once, or not at all."""

    disk = True

    def write(self):
        pass

    def keep(self, epoch):
        self.epoch = epoch
        if self.disk:
            self.store(epoch)


def whole(text):
    return [int(word) for word in text]


def settled(words):
    letters, (machine, step, hold, time_out, kept, size, *values) = words[0], whole(words[1:])
    n = len(letters)
    c = object.__new__(bridge.Configuration)
    c.axes, c.reads, c.machine, c.joints = list(letters), [], machine, 1
    c.steps, c.period_s, c.period_ns = [size] * n, 1e-3, 1000000
    c.settings = Settings(c.axes, machine, values[:n], values[n:2 * n], step, hold, time_out)
    c.epoch_file = os.path.join(FOLDER.name, "epoch")
    with open(c.epoch_file, "w", encoding="ascii") as file:
        file.write(f"{(kept - bridge.EPOCHS_AHEAD) & 0xFFFF}\n")
    return c


def main():
    bridge.KeptEpoch = Kept
    pins = Pins(begin=0.0, end=0.0, trusted=True, factor=1.0, trust=False, alive=False, holds=False, owner=0, epoch=0, unread=0,
                limited=False, enabled=False)
    pins.update({"estop-ok": True, "user-ok": True, "homed-0": False, "coord-mode": False, "teleop-mode": True,
                 "motion-type": 1, "probe-input": False})
    senders, made, old, letters, c = Senders(), None, [], [], None
    for line in sys.stdin:
        kind, *words = line.split()
        if kind == "set":
            c = settled(words)
            letters = [letter.lower() for letter in c.axes]
            old = [0] * len(letters)
            for letter in letters:
                for name in ("pos-cmd", "eoffset", "request", "origin", "counts", "absorbed", "probed-offset"):
                    pins[f"{name}-{letter}"] = 0.0
            print(1)
        elif kind == "torn":
            pins.torn = int(words[0])
            print(0)
        elif kind == "disk":
            Kept.disk = words[0] == "1"
            if Kept.disk and made:
                made.kept.store(made.kept.epoch)
            print(0)
        else:
            on, cut, mode, does, period, motion_type, touching = whole(words[:7])
            c.period_s, c.period_ns = period * 1e-9, period
            pins.update({"enabled": bool(on), "homed-0": bool(on), "limited": bool(cut), "teleop-mode": bool(mode),
                         "motion-type": motion_type, "probe-input": bool(touching)})
            if made is None:
                made = bridge.Bridge(pins, c, senders)
            pins["begin"] = pins["end"] = dict.__getitem__(pins, "end") + 1.0
            senders.frames, senders.sent = [whole(frame.split(",")) for frame in words[7:]], ""
            made.scan()
            print(int(pins["holds"]), int(pins[f"counts-{letters[0]}"]), senders.sent or "-", *(
                f"{pins[f'request-{letter}']:.9f} {pins[f'probed-offset-{letter}']:.9f}" for letter in letters),
                int(pins["alive"]), pins["unread"])
            for at, letter in enumerate(letters):
                counts = int(pins[f"counts-{letter}"])
                if on:
                    pins[f"request-{letter}"] += (counts - old[at]) * 1e-6
                old[at] = counts
                if does == 1:
                    pins[f"request-{letter}"] = pins[f"eoffset-{letter}"] = 0.0
                if does == 3:
                    pins[f"eoffset-{letter}"] += (pins[f"request-{letter}"] - pins[f"eoffset-{letter}"]) * 0.01
                elif does != 2 and mode:
                    pins[f"eoffset-{letter}"] = pins[f"request-{letter}"]
        sys.stdout.flush()


main()

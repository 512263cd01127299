#!/usr/bin/python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The bridge between LinuxCNC and a volcomp gateway, in user space.

Started by volcomp.tcl, or again while LinuxCNC runs by its own name. It takes its settings
from the section [VOLCOMP] of the INI file, which it is given as its argument or finds in INI_FILE_NAME.
"""

import errno
import math
import os
import random
import re
import select
import signal
import socket
import subprocess
import sys
import threading
import time

import hal
import linuxcnc

sys.path.insert(0, os.path.dirname(os.path.realpath(__file__)))
import datagram  # noqa: E402
from barrier import EPOCH, Barrier, Settings  # noqa: E402

# Cycles of the servo thread after which a change of the counts must be seen in the control's request.
LANDS_WITHIN = 5
# How often the pins are read until all are of one cycle, and how long that may take at the start.
READ_TRIES = 10
STARTS_WITHIN_S = 10.0
# Cycles for which nothing moves after the machine was switched on.
SETTLES = 20
# For how long nothing moves after an offset was lost.
LOST_FOR_S = 1.0
# How far an offset may be off besides what its value moved in the time of the way, and for how long: some counts, and what the
# planner leaves where it stops (nm or millionths of a degree).
OFF_BY_COUNTS = 3
OFF_BY = 10.0
WAY_S = 0.25
OFF_FOR_S = 0.5
# For how long a sender that says nothing hears states.
LISTENS_FOR_S = 1.0
SENDERS = 4
PROBING = 5
# Epochs that the one in the file may be behind: as many starts and time-outs as can come while a disk hangs.
EPOCHS_AHEAD = 16
AXES = "XYZABCUVW"
# The units that the bridge counts in, by the words that LinuxCNC takes for them in any case. It takes numbers, too, and what
# stands behind a number: those are refused.
UNITS = {"LINEAR_UNITS": ("mm", "metric"), "ANGULAR_UNITS": ("degree", "deg")}
MOST_JOINTS = 16
# Python alone takes others: 1_000, nan.
NUMBER = re.compile(r"[+-]?([0-9]+[.]?[0-9]*|[.][0-9]+)([eE][+-]?[0-9]+)?", re.ASCII)
# Parts of a unit (mm or degree) in the unit of steps and offsets, and scale of the control's counts.
NANO = 1e6


def tell(what):
    print(f"volcomp bridge: {what}", file=sys.stderr, flush=True)


class Configuration:
    """The section [VOLCOMP] and what else of the INI file is needed."""

    def __init__(self, path):
        self.path = path
        self.ini = linuxcnc.ini(path)
        self.units()
        self.axes = self.letters("AXES", "XYZ")
        self.reads = self.letters("READS", "")
        both = self.axes + self.reads
        if not self.axes or len(set(both)) != len(both):
            raise ValueError(f"[VOLCOMP]AXES and READS: found {''.join(self.axes)} and {''.join(self.reads)}, "
                             "expected one or more axes, each once")
        self.machine = self.whole("MACHINE")
        self.port = self.whole("PORT", 47001)
        if not 0 <= self.port <= 65535:
            raise ValueError(f"[VOLCOMP]PORT: found {self.port}, expected 0 to 65535")
        self.listen = self.text("LISTEN", "127.0.0.1")
        expected = f"the number of joints, 1 to {MOST_JOINTS}"
        joints = self.number_of("KINS", "JOINTS", None, expected)
        if joints != int(joints) or not 1 <= joints <= MOST_JOINTS:
            raise ValueError(f"[KINS]JOINTS: found {joints:g}, expected {expected} and nothing behind it")
        self.joints = int(joints)
        expected = "the period of the servo thread in ns"
        period_ns = self.number_of("EMCMOT", "SERVO_PERIOD", 1000000, expected)
        if period_ns <= 0:
            raise ValueError(f"[EMCMOT]SERVO_PERIOD: found {period_ns:g}, expected {expected}")
        self.period_s = period_ns * 1e-9
        folder = os.path.dirname(os.path.abspath(path))
        self.epoch_file = os.path.join(folder, self.text("EPOCH_FILE", "volcomp.epoch"))
        rotary = [letter in "ABC" for letter in self.axes]
        keys = ["STEP_UDEG" if turns else "STEP_NM" for turns in rotary]
        self.steps = [self.whole(key, 1) for key in keys]
        for key, step in zip(keys, self.steps):
            if step < 1:
                raise ValueError(f"[VOLCOMP]{key}: found {step}, expected 1 or more")
        milli = 1000.0  # nm of a um, millionths of a degree of a millidegree
        limit = [self.number("LIMIT_MDEG") if turns else self.number("LIMIT_UM") for turns in rotary]
        rate = [self.number("RATE_MDEG_PER_S") if turns else self.number("RATE_UM_PER_S") for turns in rotary]
        # The largest rate, and the smallest number of cycles from step to step with which it is a count or more.
        per_scan = [value * milli * self.period_s / step for value, step in zip(rate, self.steps)]
        step_scans = max(1, int(max(-(-1.0 // value) for value in per_scan)))

        def scans(key, default):
            return int(round(self.number(key, default) * 1e-3 / self.period_s))

        self.settings = Settings(
            self.axes, self.machine,
            # No more than was said, but for what a decimal number cannot hold.
            [int(value * milli / step + 1e-6) for value, step in zip(limit, self.steps)],
            [int(value * step_scans + 1e-9) for value in per_scan],
            step_scans, scans("HOLD_MS", 100), scans("TIME_OUT_MS", 300))
        self.period_ns = int(round(self.period_s * 1e9))

    def units(self):
        """Counts are nm and millionths of a degree: with other units every correction would be another one."""
        for key, names in UNITS.items():
            found, expected = self.ini.find("TRAJ", key), " or ".join(names)
            if found is None:
                raise ValueError(f"[TRAJ]{key} is missing, expected {expected}: the bridge counts in this unit")
            if found.lower() not in names:
                raise ValueError(
                    f"[TRAJ]{key}: found {found}, expected {expected}: the bridge counts in this unit, and no other is supported. "
                    "Do not change this key alone: all lengths or angles of the INI file are in it"
                )

    def letters(self, key, default):
        found = list(self.text(key, default).upper().replace(" ", ""))
        for letter in found:
            if letter not in AXES:
                raise ValueError(f"[VOLCOMP]{key}: found {letter}, expected axes of {' '.join(AXES)}")
        return found

    def text(self, key, default):
        return self.ini.find("VOLCOMP", key) or default

    def number_of(self, section, key, default, expected):
        """A number of a section; without a default it has to be there."""
        text = self.ini.find(section, key)
        if text is None and default is None:
            raise ValueError(f"[{section}]{key} is missing, expected {expected}")
        is_number = text is None or NUMBER.fullmatch(text)
        found = default if text is None else float(text) if is_number else math.nan
        if not abs(found) <= 1e9:
            raise ValueError(f"[{section}]{key}: found {text}, expected {expected} and nothing behind it")
        return found

    def number(self, key, default=None):
        return self.number_of("VOLCOMP", key, default, "a number")

    def whole(self, key, default=None):
        found = self.number_of("VOLCOMP", key, default, "a whole number")
        if found != int(found):
            raise ValueError(f"[VOLCOMP]{key}: found {found}, expected a whole number and nothing behind it")
        return int(found)


class KeptEpoch:
    """The epoch in a file. A start or time-out that is not written down could let an old frame pass after the next one: so a
    start goes on further than by one, and no frame is taken while the file is further behind than that. A thread writes: a
    disk may hang for seconds, and the servo thread takes the offsets away from a bridge that waits for it."""

    def __init__(self, path):
        self.path = path
        try:
            with open(path, encoding="ascii") as file:
                kept = int(file.read())
        except FileNotFoundError:
            kept = 0
        self.epoch = self.kept = (kept + EPOCHS_AHEAD) & 0xFFFF
        self.store(self.epoch)
        self.moved = threading.Event()
        threading.Thread(target=self.write, daemon=True).start()

    def keep(self, epoch):
        if epoch != self.epoch:
            self.epoch = epoch
            self.moved.set()

    def is_behind(self):
        return (self.epoch - self.kept) & 0xFFFF >= EPOCHS_AHEAD

    def store(self, epoch):
        beside = self.path + ".new"
        with open(beside, "w", encoding="ascii") as file:
            file.write(f"{epoch}\n")
            file.flush()
            os.fsync(file.fileno())
        os.replace(beside, self.path)
        self.kept = epoch

    def write(self):
        while True:
            self.moved.wait()
            self.moved.clear()
            epoch = self.epoch
            try:
                self.store(epoch)
            except OSError as error:
                tell(f"{self.path}: {error}")
                time.sleep(1.0)
                self.moved.set()


class Control:
    """What the bridge reads of LinuxCNC, and what it writes: pins of its own alone, which are memory. To read others by their
    names takes HAL's lock, for longer the more pins there are; killed meanwhile, it would leave all of HAL locked for ever, and
    whoever waits for that lock spins, so that a thread in real time keeps from the processor the one that has it."""

    def __init__(self, component, configuration):
        self.component, self.configuration = component, configuration
        self.letters = [letter.lower() for letter in configuration.axes]
        self.counts = [f"counts-{letter}" for letter in self.letters]
        self.joints = [f"homed-{joint}" for joint in range(configuration.joints)]
        self.positions = [f"pos-cmd-{letter.lower()}" for letter in configuration.axes + configuration.reads]
        self.offsets = [f"eoffset-{letter}" for letter in self.letters]
        self.requests = [f"request-{letter}" for letter in self.letters]
        self.origins = [f"origin-{letter}" for letter in self.letters]

    def cycle(self):
        """The number of cycles that the servo thread has finished."""
        return int(self.component["end"])

    def read(self):
        """Everything of one cycle: read again where the servo thread went on meanwhile. `None` where it did so each time: a
        mixture of two cycles is no reading."""
        pins = self.component
        for _ in range(READ_TRIES):
            cycle = self.cycle()
            position = [pins[pin] for pin in self.positions]
            offset = [pins[pin] for pin in self.offsets]
            request = [pins[pin] for pin in self.requests]
            flags = self.flags()
            if int(pins["begin"]) == cycle:
                return cycle, time.monotonic_ns(), position, offset, request, flags
        return None

    def first(self):
        """The reading with which the bridge starts."""
        end = time.monotonic() + STARTS_WITHIN_S
        while time.monotonic() < end:
            read = self.read()
            if read is not None:
                return read
            time.sleep(0.0003)
        raise RuntimeError(f"found no whole cycle of the servo thread in {STARTS_WITHIN_S:.0f} s, expected one: it may stand in the middle of one")

    def flags(self):
        pins = self.component
        flags = 0
        if not (pins["estop-ok"] and pins["user-ok"]):
            flags |= datagram.EMERGENCY_STOP
        if pins["enabled"]:
            flags |= datagram.ENABLED
        if all(pins[joint] for joint in self.joints):
            flags |= datagram.HOMED
        if pins["limited"]:
            flags |= datagram.LIMITED
        if pins["motion-type"] == PROBING:
            flags |= datagram.PROBING
        return flags

    def moves_offsets(self):
        """Whether LinuxCNC's planner moves offsets: elsewhere they stand, and come all at once when one of these returns."""
        return bool(self.component["coord-mode"] or self.component["teleop-mode"])

    def is_trusted(self):
        """Whether the servo thread lets everything through that the bridge writes."""
        return bool(self.component["trusted"]) and self.component["factor"] == 1.0


class Senders:
    """Those who hear states, and the last frame of each since the last scan."""

    def __init__(self, configuration):
        self.machine = configuration.machine
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind((configuration.listen, configuration.port))
        self.socket.setblocking(False)
        self.heard = {}
        self.frames = {}

    def receive(self):
        now = time.monotonic()
        for _ in range(64):
            try:
                data, sender = self.socket.recvfrom(512)
            except (BlockingIOError, ConnectionRefusedError):
                break
            told = datagram.command(data)
            # Who only listens moves nothing: it may be told that this is another machine.
            if told is None or told[1] == datagram.FRAME and told[0] != self.machine:
                continue
            if sender not in self.heard and len(self.heard) >= SENDERS:
                continue
            self.heard[sender] = now
            if told[1] == datagram.FRAME:
                self.frames[sender] = told[2]
        self.heard = {sender: at for sender, at in self.heard.items() if now - at < LISTENS_FOR_S}

    def mailboxes(self):
        frames, self.frames = self.frames, {}
        return list(frames.values())

    def send(self, data):
        for sender in self.heard:
            try:
                self.socket.sendto(data, sender)
            except OSError:
                pass  # One that is gone, or a full queue: the next state says more.


class Bridge:
    def __init__(self, component, configuration, senders):
        self.component, self.configuration = component, configuration
        self.control = Control(component, configuration)
        self.senders = senders
        self.kept = KeptEpoch(configuration.epoch_file)
        self.run = random.SystemRandom().getrandbits(32)
        self.sequence = 0
        self.cycle, _, self.position, _, request, _ = self.control.first()
        self.unread = None
        self.velocity = [0.0] * len(self.position)
        applied = self.whole(request)
        self.barrier = Barrier(configuration.settings, self.kept.epoch, self.cycle & 0xFFFF, applied)
        self.kept.keep(self.barrier.epoch)
        self.base = self.based(applied)
        self.written = [applied]
        self.strange = self.settle = self.lost = self.asks_nothing = 0
        self.off_s = 0.0
        # What was applied in the time of the way, in nm or millionths of a degree.
        self.moved = [0.0] * len(applied)
        self.was_enabled = self.was_probing = self.touched = False
        self.was_trusted = self.control.is_trusted()
        self.was_behind = False

    def whole(self, request):
        """What the control is asked for, in counts of the barrier."""
        steps = self.configuration.steps
        return [int(round(value * NANO / step)) for value, step in zip(request, steps)]

    def based(self, applied):
        """The control's counts at which the barrier's are zero: only changes of its counts move it."""
        steps = self.configuration.steps
        return [self.component[pin] - value * step
                for pin, value, step in zip(self.control.counts, applied, steps)]

    def write(self, applied):
        for pin, base, value, step in zip(self.control.counts, self.base, applied, self.configuration.steps):
            self.component[pin] = base + value * step
        # The values that the control may show as its request while the last ones are on their way.
        self.written = (self.written + [list(applied)])[-LANDS_WITHIN:]

    def watch(self, request, flags):
        """Whether the control's request is what was written; begins anew from it where it is not for some cycles."""
        found = self.whole(request)
        is_on = flags & datagram.ENABLED and flags & datagram.HOMED
        # Axis by axis: the servo thread may come between the writing of two.
        landing = zip(found, *self.written, self.barrier.applied)
        if all(value in known for value, *known in landing):
            self.strange = 0
            return
        self.strange += 1
        if self.strange <= LANDS_WITHIN or not is_on:
            return
        gone = [was - now for was, now in zip(self.barrier.applied, found)]
        for letter, value, step in zip(self.control.letters, gone, self.configuration.steps):
            self.component[f"absorbed-{letter}"] += value * step / NANO
        shown = ", ".join(f"{letter.upper()} {value * step / 1000:+.3f}"
                          for letter, value, step in zip(self.control.letters, gone, self.configuration.steps))
        tell(f"the control has lost an offset, or taken it into its position: {shown} um or mdeg; "
             "nothing moves for a second, then the correction is ramped in anew")
        self.begin_anew(found)
        self.lost = round(LOST_FOR_S / self.configuration.period_s)

    def begin_anew(self, found):
        """Goes on from what the control is asked for: no frame of before is taken any more."""
        self.barrier.begin_anew(found)
        self.kept.keep(self.barrier.epoch)
        self.base = self.based(found)
        self.written = [found]
        self.strange = 0

    def recover(self, request, passed):
        """While the servo thread takes away what the bridge had written, or has taken it: nothing of it is given back. At zero
        the counts are put where nothing is asked for, and only then the bridge asks to be trusted again."""
        if self.was_trusted:
            tell("the bridge came too late, and the offsets are taken out; then the correction is ramped in anew")
            self.begin_anew(self.whole(request))
        self.was_trusted = False
        self.barrier.stand(self.whole(request))
        if self.component["trusted"] or self.component["factor"] != 0.0:
            self.asks_nothing = 0
        else:
            for counts, origin in zip(self.control.counts, self.control.origins):
                self.component[counts] = round(self.component[origin])
            self.asks_nothing += passed
        # It is the rising edge that counts, and one may come while the servo thread has not heard the bridge yet: again and again.
        self.component["trust"] = self.asks_nothing % (4 * LANDS_WITHIN) > LANDS_WITHIN

    def is_off(self, offset, passed):
        """Whether an axis has for long not had what is told of it: further off than what moved on the way explains."""
        steps = self.configuration.steps
        passed_s = passed * self.configuration.period_s
        is_far = any(not abs(has * NANO - value * step) <= OFF_BY + OFF_BY_COUNTS * step + moved
                     for has, value, step, moved in zip(offset, self.barrier.applied, steps, self.moved))
        # A look that comes late is one look, not a long time.
        self.off_s = self.off_s + min(passed_s, 0.01) if is_far else 0.0
        return self.off_s >= OFF_FOR_S

    def probe(self, flags, offset):
        """The offset at the instant of the contact: probed positions contain it."""
        is_probing = bool(flags & datagram.PROBING)
        touches = bool(self.component["probe-input"])
        if is_probing and not self.was_probing:
            self.latched, self.touched = False, touches
        # G38.2 and G38.3 wait for a contact, G38.4 and G38.5 for its loss: the first change is what the control notes.
        if is_probing and touches != self.touched and not self.latched:
            self.latched = True
            for letter, value in zip(self.control.letters, offset):
                self.component[f"probed-offset-{letter}"] = value
        self.was_probing = is_probing

    def miss(self):
        """No reading: no state is sent, whose number is left out, so that the gateway sees one missing; and the servo thread
        does not hear that the bridge lives, and takes the offsets away where that goes on."""
        self.component["unread"] += 1
        cycle = self.control.cycle()
        if self.unread is None:
            tell("the servo thread goes on while its pins are read: no state is sent for such a cycle; volcomp.unread counts them")
        if cycle != self.unread:
            self.unread = cycle
            self.sequence += 1

    def frames(self, trusted):
        """The frames that the barrier judges: none while the bridge is not trusted. While the file of the epoch is too far behind
        all are refused as such of an epoch that does not count."""
        mailboxes = self.senders.mailboxes()
        is_behind = self.kept.is_behind()
        if is_behind and not self.was_behind:
            tell(f"{self.kept.path}: the epoch in it is {EPOCHS_AHEAD} or more behind, and cannot be written; frames are refused until it is")
        self.was_behind = is_behind
        if is_behind and mailboxes:
            self.barrier.refusal = EPOCH
        return mailboxes if trusted and not is_behind else []

    def scan(self):
        read = self.control.read()
        if read is None:
            self.miss()
            return
        cycle, now, position, offset, request, flags = read
        passed = cycle - self.cycle
        is_on = bool(flags & datagram.ENABLED and flags & datagram.HOMED)
        self.settle = max(self.settle - passed, 0) if is_on and self.was_enabled else SETTLES
        self.was_enabled = is_on
        self.lost = max(self.lost - passed, 0)
        trusted = self.control.is_trusted()
        if not trusted:
            self.recover(request, passed)
        elif not self.was_trusted:
            # Nothing is asked for, but by what LinuxCNC had swallowed meanwhile: the barrier begins there.
            self.was_trusted = True
            self.component["trust"] = False
            self.begin_anew(self.whole(request))
        else:
            self.watch(request, flags)
        stands = is_on and not self.control.moves_offsets()
        is_off = self.is_off(offset, passed) if is_on else False
        self.probe(flags, offset)
        waits = bool(flags & (datagram.EMERGENCY_STOP | datagram.LIMITED)) or not is_on or not trusted or stands \
            or self.settle > 0 or self.strange > 0
        if stands or is_off or not trusted or self.lost:
            flags |= datagram.LOST
        # What no word can tell goes towards zero: that is the one movement while an offset counts as lost.
        holds = waits or bool(flags & datagram.LOST) and not self.barrier.is_beyond()
        if self.barrier.is_beyond():
            flags |= datagram.LOST
        before = list(self.barrier.applied)
        report = self.barrier.scan(self.frames(trusted), holds, min(passed, 32767))
        self.kept.keep(self.barrier.epoch)
        if trusted and (self.barrier.applied != self.written[-1] or len(self.written) > 1):
            self.write(self.barrier.applied)
        passed_s = passed * self.configuration.period_s
        self.moved = [moved * max(0.0, 1.0 - passed_s / WAY_S) + abs(now - was) * step for moved, now, was, step in zip(
            self.moved, self.barrier.applied, before, self.configuration.steps)]
        self.velocity = [(at - was) / passed_s for at, was in zip(position, self.position)]
        self.position, self.cycle = position, cycle
        self.sequence += 1
        c = self.configuration
        axes = [(letter, step, at, velocity, int(round(moved * NANO)))
                for letter, step, at, velocity, moved in zip(
                    c.axes + c.reads, c.steps + [1] * len(c.reads), position, self.velocity, offset + [0] * len(c.reads))]
        self.senders.send(datagram.state(
            c.machine, self.run, self.sequence, flags, now, c.period_ns, axes, report))
        self.component["alive"] = not self.component["alive"]
        self.component["holds"] = holds
        self.component["owner"] = self.barrier.owner
        self.component["epoch"] = self.barrier.epoch

    def go(self):
        while True:
            select.select([self.senders.socket], [], [], 0.0003)
            self.senders.receive()
            if self.control.cycle() != self.cycle:
                self.scan()


def names():
    """The names that a bridge may have. One that was killed leaves its own behind, as LinuxCNC has no way to take it away."""
    return ["volcomp"] + [f"volcomp-{number}" for number in range(2, 100)]


def component(configuration):
    """Only one bridge gets here, since only one has the port: what has an earlier name is dead, and lets go of its signals."""
    made = None
    for name in names():
        try:
            made = hal.component(name)
            break
        except (hal.error, RuntimeError):
            for pin, _, begins in written_pins(configuration):
                if begins is not None:
                    subprocess.run(["halcmd", "unlinkp", f"{name}.{pin}"], check=False, capture_output=True)
    if made is None:
        raise RuntimeError("too many bridges have died: start LinuxCNC anew")
    for pin, kind, _ in written_pins(configuration):
        made.newpin(pin, kind, hal.HAL_OUT)
    for pin, kind in servo_pins(configuration):
        made.newpin(pin, kind, hal.HAL_IN)
    for pin, _, _, kind in read_pins(configuration):
        made.newpin(pin, kind, hal.HAL_IN)
    return made, name


# A pin that begins with the value that its signal has.
HELD = object()


def written_pins(configuration):
    """What the bridge writes: pin, kind, and with what it begins on the signal of volcomp.tcl that has its name, or `None` for a pin
    that has no signal."""
    pins = []
    for letter in configuration.axes:
        letter = letter.lower()
        pins += [(f"counts-{letter}", hal.HAL_FLOAT, HELD), (f"probed-offset-{letter}", hal.HAL_FLOAT, 0.0),
                 (f"absorbed-{letter}", hal.HAL_FLOAT, None)]
    return pins + [
        ("trust", hal.HAL_BIT, False), ("alive", hal.HAL_BIT, HELD), ("enable", hal.HAL_BIT, True), ("holds", hal.HAL_BIT, None),
        ("unread", hal.HAL_U32, None), ("owner", hal.HAL_U32, None), ("epoch", hal.HAL_U32, None)]


def servo_pins(configuration):
    """What is read of volcomp.tcl, each from the signal of the same name, and its kind."""
    origins = [(f"origin-{letter.lower()}", hal.HAL_FLOAT) for letter in configuration.axes]
    return origins + [("factor", hal.HAL_FLOAT), ("trusted", hal.HAL_BIT), ("begin", hal.HAL_FLOAT), ("end", hal.HAL_FLOAT)]


def read_pins(configuration):
    """What is read: pin of the bridge, pin of LinuxCNC, signal between them where there is none, kind."""
    axes = [letter.lower() for letter in configuration.axes]
    pins = [(f"pos-cmd-{letter}", f"axis.{letter}.pos-cmd", f"volcomp-cmd-{letter}", hal.HAL_FLOAT)
            for letter in axes + [letter.lower() for letter in configuration.reads]]
    for letter in axes:
        pins += [(f"eoffset-{letter}", f"axis.{letter}.eoffset", f"volcomp-eoffset-{letter}", hal.HAL_FLOAT),
                 (f"request-{letter}", f"axis.{letter}.eoffset-request", f"volcomp-request-{letter}", hal.HAL_FLOAT)]
    pins += [(f"homed-{joint}", f"joint.{joint}.homed", f"volcomp-homed-{joint}", hal.HAL_BIT)
             for joint in range(configuration.joints)]
    return pins + [
        ("enabled", "motion.motion-enabled", "volcomp-enabled", hal.HAL_BIT),
        ("estop-ok", "iocontrol.0.emc-enable-in", "volcomp-estop", hal.HAL_BIT),
        ("user-ok", "iocontrol.0.user-enable-out", "volcomp-user", hal.HAL_BIT),
        ("coord-mode", "motion.coord-mode", "volcomp-coord-mode", hal.HAL_BIT),
        ("teleop-mode", "motion.teleop-mode", "volcomp-teleop-mode", hal.HAL_BIT),
        ("limited", "motion.eoffset-limited", "volcomp-limited", hal.HAL_BIT),
        ("motion-type", "motion.motion-type", "volcomp-type", hal.HAL_S32),
        ("probe-input", "motion.probe-input", "volcomp-probe", hal.HAL_BIT)]


def signals():
    """The signal of each pin that has one."""
    shown = subprocess.run(["halcmd", "-s", "show", "pin"], check=True, capture_output=True, text=True).stdout
    rows = [line.split() for line in shown.splitlines()]
    # Owner, type, direction, value, name, arrow, signal.
    return {row[4]: row[6] for row in rows if len(row) == 7}


def connect(made, configuration, component_name):
    """Connects to the signals of volcomp.tcl without moving anything: with the values that they have."""
    of_pins = signals()
    for pin, source, signal_name, kind in read_pins(configuration):
        # A pin that the machine's own files have connected keeps its signal.
        if source not in of_pins:
            hal.new_sig(signal_name, kind)
            hal.connect(source, signal_name)
        hal.connect(f"{component_name}.{pin}", of_pins.get(source, signal_name))
    for pin, _ in servo_pins(configuration):
        hal.connect(f"{component_name}.{pin}", f"volcomp-{pin}")

    for pin, kind, begins in written_pins(configuration):
        if begins is None:
            continue
        value = hal.get_value(f"volcomp-{pin}") if begins is HELD else begins
        if kind == hal.HAL_BIT:
            value = bool(value)
        # Before it is connected, so that the signal does not change, and after, since connecting takes the value of the signal.
        made[pin] = value
        hal.connect(f"{component_name}.{pin}", f"volcomp-{pin}")
        made[pin] = value


def main():
    path = sys.argv[1] if len(sys.argv) > 1 else os.environ.get("INI_FILE_NAME")
    if not path:
        tell("found no INI file, expected its path as the argument or in INI_FILE_NAME")
        return 2
    try:
        configuration = Configuration(path)
    except (ValueError, OverflowError, ZeroDivisionError, linuxcnc.error) as error:
        tell(f"{path}: {error}")
        return 2
    try:
        senders = Senders(configuration)
    except OSError as error:
        taken = "; does a bridge run already?" if error.errno == errno.EADDRINUSE else ""
        tell(f"UDP port {configuration.listen}:{configuration.port}: {error}{taken}")
        return 1
    made, name = component(configuration)
    try:
        connect(made, configuration, name)
        bridge = Bridge(made, configuration, senders)
    except (OSError, ValueError, RuntimeError) as error:
        tell(f"{error}")
        made.exit()
        return 1
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: sys.exit(0))
    made.ready()
    try:
        bridge.go()
    finally:
        made.exit()
    return 0


if __name__ == "__main__":
    sys.exit(main())

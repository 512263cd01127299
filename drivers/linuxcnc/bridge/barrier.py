# SPDX-License-Identifier: GPL-2.0-or-later
"""The barrier: which frame is taken, and how the applied correction moves.

Whole counts and 16-bit words only; the time is the number of scans. Nothing here knows HAL, sockets or clocks.
"""

NONE, CHECKSUM, EPOCH, TICK, OWNER, SEQUENCE, VALUE = range(7)
MAILBOXES = 4
DIGITS = {"X": 1, "Y": 2, "Z": 3, "A": 4, "B": 5, "C": 6, "U": 7, "V": 8, "W": 9}


def layout(axes):
    """The number of these axes in this order."""
    number = 0
    for letter in axes:
        number = 10 * number + DIGITS[letter]
    return number


def checksum(machine, number, words):
    """Fletcher's checksum modulo 65535, started from the machine's number and the layout's."""
    total = (machine + number // 65535) % 65535
    of_sums = number % 65535
    for word in words:
        total = (total + word) % 65535
        of_sums = (of_sums + total) % 65535
    return [total, of_sums]


def signed(word):
    return word - 65536 if word > 32767 else word


class Settings:
    """Limits and rates are counts, for each axis; the others scans."""

    def __init__(self, axes, machine, limit, rate, step_scans, hold_scans, time_out_scans):
        self.axes, self.machine = axes, machine
        self.limit, self.rate = list(limit), list(rate)
        self.step_scans, self.hold_scans, self.time_out_scans = step_scans, hold_scans, time_out_scans
        for letter in axes:
            if letter not in DIGITS:
                raise ValueError(f"axis {letter}: expected one of {', '.join(DIGITS)}")
        self.layout = layout(axes)
        if not 1 <= len(axes) <= 9 or len(set(axes)) != len(axes):
            raise ValueError(f"found the axes {''.join(axes)}, expected 1 to 9, each once")
        if not 0 <= machine <= 65534:
            raise ValueError(f"found the machine {machine}, expected 0 to 65534")
        for what, values in (("limit", self.limit), ("rate", self.rate)):
            for letter, value in zip(axes, values):
                if not 1 <= value <= 32767:
                    raise ValueError(f"axis {letter}: found a {what} of {value} counts, expected 1 to 32767")
        if step_scans < 1:
            raise ValueError("found no scan from step to step, expected one or more")
        if hold_scans < 1 or time_out_scans < 2 * hold_scans or time_out_scans > 32767:
            raise ValueError(
                f"found a time-out of {time_out_scans} scans, expected at least twice the age of a frame, "
                f"which is {hold_scans} scans, and less than 32768")


class Barrier:
    def __init__(self, settings, epoch, tick, applied):
        """`epoch` is the one that was kept: it moves on here. `applied` is what the axes have, counts."""
        self.settings = settings
        self.epoch, self.tick = (epoch + 1) & 0xFFFF, tick & 0xFFFF
        self.owner = self.sequence = 0
        self.refusal = NONE
        self.waited = self.silent = 0
        self.found = [None] * MAILBOXES
        self.stand(applied)

    def stand(self, applied):
        """The axes stand here, and there is no line."""
        self.applied, self.start, self.goal = list(applied), list(applied), list(applied)
        self.steps = self.done = 0

    def begin_anew(self, applied):
        """A reset: nothing that was sent before is taken any more, and the axes have this."""
        self.epoch = (self.epoch + 1) & 0xFFFF
        self.owner = self.sequence = self.silent = self.waited = 0
        self.refusal = NONE
        self.stand(applied)

    def scan(self, mailboxes, holds, passed=1):
        """One scan with what came since the last one. `passed` of the control's cycles went by: they count for ages and
        the time-out, and at most one step is made."""
        s = self.settings
        self.tick = (self.tick + passed) & 0xFFFF
        goal = None
        for mailbox, words in enumerate(mailboxes[:MAILBOXES]):
            taken = self.judge(mailbox, words)
            if isinstance(taken, list):
                goal = taken
            elif taken is not None:
                self.refusal = taken
        if goal is not None:
            self.silent = 0
        elif self.silent < s.time_out_scans:
            self.silent = min(self.silent + passed, s.time_out_scans)
            if self.silent == s.time_out_scans:
                # Nobody sends: to zero, and no frame that was made before can be taken any more.
                self.epoch = (self.epoch + 1) & 0xFFFF
                self.owner = 0
                goal = [0] * len(s.axes)
        if self.is_beyond():
            goal = [0] * len(s.axes)
        if goal is not None:
            self.aim(goal)
        if not holds:
            self.waited = min(self.waited + passed, 65535)
            if self.waited >= s.step_scans:
                self.waited = 0
                self.step()
        return self.report()

    def judge(self, mailbox, words):
        """The values that are taken, the reason why not, or `None` for what was judged before."""
        s = self.settings
        count = len(s.axes)
        body = 4 + count
        if len(words) < body + 2 or checksum(s.machine, s.layout, words[:body]) != list(words[body:body + 2]):
            return CHECKSUM
        epoch, tick, sequence, owner = words[:4]
        before, self.found[mailbox] = self.found[mailbox], (tick, sequence)
        if before == (tick, sequence):
            return None
        if epoch != self.epoch:
            return EPOCH
        if owner == 0 or self.owner not in (0, owner):
            return OWNER
        if self.owner != 0 and sequence == self.sequence:
            return None
        if (self.tick - tick) & 0xFFFF > s.hold_scans:
            return TICK
        if self.owner != 0 and (sequence - self.sequence) & 0xFFFF >= 32768:
            return SEQUENCE
        values = [signed(word) for word in words[4:body]]
        if any(abs(value) > limit for value, limit in zip(values, s.limit)):
            return VALUE
        self.owner, self.sequence, self.refusal = owner, sequence, NONE
        return values

    def aim(self, goal):
        """Begins a line to other values; a line to the same values goes on."""
        if goal == self.goal:
            return
        self.start, self.goal, self.done = list(self.applied), list(goal), 0
        ways = zip(goal, self.applied, self.settings.rate)
        self.steps = max(-(-abs(to - at) // rate) for to, at, rate in ways)

    def step(self):
        if self.done >= self.steps:
            return
        self.done += 1
        for axis, (start, goal) in enumerate(zip(self.start, self.goal)):
            way = abs(goal - start)
            moved = (way * self.done + self.steps // 2) // self.steps
            self.applied[axis] = start + (moved if goal >= start else -moved)

    def is_beyond(self):
        """Whether an axis stands where no word of 16 bits can tell it."""
        return any(not -32768 <= applied <= 32767 for applied in self.applied)

    def report(self):
        """The words that are published; none while an axis stands where no word can tell it."""
        if self.is_beyond():
            return []
        s = self.settings
        words = [self.epoch, self.tick, self.owner, self.sequence, self.refusal,
                 s.step_scans, s.hold_scans, s.time_out_scans]
        for applied, limit, rate in zip(self.applied, s.limit, s.rate):
            words += (applied & 0xFFFF, limit, rate)
        return words + checksum(s.machine, s.layout, words)

"""The PLC of the simulated SINUMERIK in map mode: a second implementation of docs/src/map-mode.md.

It was written from that page, in floating point where the control's program has whole numbers, and shares nothing with
plc/map.st and the library volcomp-tables. One call of `scan` is one scan of the PLC.
"""

import math

MAGIC, HEAD, DATA, FRAME, REPORT = 0x564D, 68, 64, 72, 24
LETTERS = " XYZABCUVW"
KEYS = {
    "machine": 1, "capacity": 2000, "limit": 150, "rate": 5, "turned": 5, "step_scans": 1, "hold": 50,
    "time_out": 200, "scan_ms": 10,
}


def signed(word):
    return word - 65536 if word > 32767 else word


def long(words, at):
    return words[at] + 65536 * words[at + 1]


def long_signed(words, at):
    return words[at] + 65536 * signed(words[at + 1])


class MapControl:
    """Mailbox, report, two buffers, and what the axes get of the map in use. Steps: 1 um of position and of correction."""

    def __init__(self, axes, settings):
        self.axes = axes
        self.s = {**KEYS, **settings}
        self.layout = int("".join(str(LETTERS.index(a)) for a in axes))
        self.mailbox = [0] * FRAME
        self.report = [0] * REPORT
        self.memory = [0] * (2 * self.s["capacity"])
        self.applied = dict.fromkeys(axes, 0)
        self.epoch = 4711
        self.start()

    def start(self):
        """Power-up: nothing that lies in the memory is used; the axes have what their words hold."""
        self.epoch = (self.epoch + 1) % 65536
        self.tick, self.owner, self.sequence, self.refusal = 100, 0, 0, 0
        self.head, self.counter, self.buffer = None, 0, 0
        self.loading = None
        self.judged = None
        self.silent, self.waited = 0, 0
        self.goal = dict.fromkeys(self.axes, 0)
        self.direction = dict.fromkeys(self.axes, 0)
        self.extreme = None
        self.swaps, self.largest_move = 0, 0
        self.publish()

    def checksum(self, words):
        first, second = (self.s["machine"] + self.layout // 65535) % 65535, self.layout % 65535
        for word in words:
            first = (first + word) % 65535
            second = (second + first) % 65535
        return [first, second]

    def scan(self, position, holds):
        """One scan, with the commanded coordinates in mm."""
        self.tick = (self.tick + 1) % 65536
        frame = list(self.mailbox)
        verdict = self.judge(frame)
        if verdict is not None:
            self.refusal = verdict
        if verdict == 0:
            self.owner, self.sequence, self.silent = frame[3], frame[2], 0
        elif self.silent < self.s["time_out"]:
            self.silent += 1
            if self.silent == self.s["time_out"]:
                self.epoch = (self.epoch + 1) % 65536
                self.owner, self.loading, self.head = 0, None, None
        self.look_up({a: round(1000 * at) for a, at in position.items()})
        if not holds:
            self.move()
        self.publish()

    def judge(self, frame):
        """0: taken; None: nothing new; otherwise why not."""
        if self.checksum(frame[:70]) != frame[70:]:
            return 1
        if self.judged == (frame[1], frame[2]):
            return None
        self.judged = (frame[1], frame[2])
        if frame[0] != self.epoch:
            return 2
        if frame[3] == 0 or self.owner not in (0, frame[3]):
            return 4
        ahead = (frame[2] - self.sequence) % 65536
        if self.owner and ahead == 0:
            return None
        if (self.tick - frame[1]) % 65536 > self.s["hold"]:
            return 3
        if self.owner and ahead > 32767:
            return 5
        verdict = {1: self.begin, 2: self.words, 3: self.swap, 4: self.keep}.get(frame[4], lambda _: 10)(frame)
        if verdict in (6, 8) or (verdict == 9 and frame[4] == 3):
            self.loading = None
        return verdict

    def begin(self, frame):
        if frame[6] == 0 or not HEAD < frame[7] <= self.s["capacity"]:
            return 8
        self.loading = {"counter": frame[6], "count": frame[7], "words": []}
        return 0

    def words(self, frame):
        loading = self.loading
        if not loading or frame[5] != len(loading["words"]) or frame[5] >= loading["count"]:
            return 7
        new = frame[6 : 6 + min(DATA, loading["count"] - frame[5])]
        loading["words"] += new
        base = (1 - self.buffer) * self.s["capacity"] + frame[5]
        self.memory[base : base + len(new)] = new
        scale = (loading["words"] + [0] * 10)[9]
        for place, word in enumerate(new, frame[5]):
            if place >= HEAD and abs(signed(word)) > self.s["limit"] * scale:
                return 6
        return 0

    def swap(self, frame):
        loading = self.loading
        if not loading or frame[6] != loading["counter"] or len(loading["words"]) != loading["count"]:
            return 7
        words = loading["words"]
        if self.checksum(words) != frame[7:9]:
            return 9
        if words[0] != MAGIC or words[1] != 1 or words[2] != loading["counter"] or words[10] != len(words):
            return 8
        if long(words, 5) != self.layout or long(words, 7) != self.layout or not 1 <= words[9] <= 64:
            return 8
        head, nodes = {"lines": [], "scale": words[9], "reversal": []}, 1
        for place in range(len(self.axes)):
            at = 11 + 7 * place
            part, parts, count = words[at + 2 : at + 5]
            fits = 1 <= part <= 32767 and 1 <= parts <= 32767 and 2 <= count <= 32767
            if not fits or long(words, at + 5) != 1000 or abs(long_signed(words, at)) > 10**9:
                return 8
            if (count - 1) * part * parts > 10**9:
                return 8
            head["lines"].append((long_signed(words, at), part * parts, count))
            reversal = [signed(words[46 + 3 * place + output]) for output in range(3)]
            if any(abs(value) > self.s["limit"] * words[9] for value in reversal[: len(self.axes)]):
                return 8
            head["reversal"].append(reversal)
            nodes *= count
        if any(long(words, 61 + 2 * output) != 1000 for output in range(len(self.axes))):
            return 8
        if HEAD + nodes * len(self.axes) != len(words):
            return 8
        self.head, self.counter, self.buffer, self.loading = head, loading["counter"], 1 - self.buffer, None
        self.swaps += 1
        return 0

    def keep(self, frame):
        return 0 if self.head and frame[6] == self.counter else 9

    def look_up(self, position):
        """The goal of each axis, steps."""
        if self.extreme is None:
            self.extreme = dict(position)
        for axis, at in position.items():
            way = at - self.extreme[axis]
            turned = self.s["turned"]
            if self.direction[axis] <= 0 and way >= turned:
                self.direction[axis], self.extreme[axis] = 1, at
            elif self.direction[axis] >= 0 and way <= -turned:
                self.direction[axis], self.extreme[axis] = -1, at
            elif way * self.direction[axis] > 0:
                self.extreme[axis] = at
        if not self.head:
            self.goal = dict.fromkeys(self.axes, 0)
            return
        cells, shares = [], []
        for axis, (origin, pitch, count) in zip(self.axes, self.head["lines"]):
            place = min(max((position[axis] - origin) / pitch, 0.0), count - 1.0)
            cells.append(min(int(place), count - 2))
            shares.append(place - cells[-1])
        values = self.buffer * self.s["capacity"] + HEAD
        for output, axis in enumerate(self.axes):
            parts = 0.0
            for corner in range(2 ** len(self.axes)):
                node, weight = 0, 1.0
                for place, (_, _, count) in enumerate(self.head["lines"]):
                    upper = corner >> place & 1
                    node = node * count + cells[place] + upper
                    weight *= shares[place] if upper else 1 - shares[place]
                if weight:
                    parts += weight * signed(self.memory[values + node * len(self.axes) + output])
            for place, other in enumerate(self.axes):
                parts += self.direction[other] * self.head["reversal"][place][output]
            steps = parts / self.head["scale"]
            if abs(steps - self.goal[axis]) > 0.6:
                limit = self.s["limit"]
                self.goal[axis] = max(-limit, min(limit, math.floor(steps + 0.5)))

    def move(self):
        """Every axis goes the same share of its way, none faster than its rate."""
        self.waited += 1
        if self.waited < self.s["step_scans"]:
            return
        self.waited = 0
        ways = {a: self.goal[a] - self.applied[a] for a in self.axes}
        times = max(1, *(math.ceil(abs(way) / self.s["rate"]) for way in ways.values()))
        for axis, way in ways.items():
            step = int(way / times)
            self.applied[axis] += step
            self.largest_move = max(self.largest_move, abs(step))

    def publish(self):
        loading = self.loading
        body = [
            self.epoch, self.tick, self.owner, self.sequence, self.refusal, 1 if self.head else 0, self.counter,
            loading["counter"] if loading else 0, len(loading["words"]) if loading else 65535, self.buffer,
            self.s["step_scans"], self.s["hold"], self.s["time_out"],
        ]
        body += [self.applied[a] % 65536 for a in self.axes]
        body += [self.s["limit"]] * len(self.axes) + [self.s["rate"]] * len(self.axes)
        body += self.checksum(body)
        self.report = body + [0] * (REPORT - len(body))

    def told(self):
        """What a line of report says of it."""
        return {
            "valid": self.head is not None, "counter": self.counter, "owner": self.owner, "sequence": self.sequence,
            "refusal": self.refusal, "swaps": self.swaps, "loaded": len(self.loading["words"]) if self.loading else -1,
            "largest_move_um": self.largest_move,
        }

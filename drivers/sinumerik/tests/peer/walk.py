"""A program that is gone through once, at whose named targets the machine stands until the correction has settled."""

import math


class Walk:
    """Where the axes are commanded to be. Rows: the place (mm), the feed (mm/min), the dwell (s) and the target's line."""

    def __init__(self, rows, start, settle_s, at_most_s):
        self.rows, self.settle_s, self.at_most_s = rows, settle_s, at_most_s
        self.here = dict(start)
        self.found = None

    def position(self, _time):
        return dict(self.here)

    def run(self, now):
        self.index, self.found, self.missed = 0, [], 0
        self.begin_move(now)

    def begin_move(self, now):
        self.begun, self.start, self.stood = now, dict(self.here), None

    def step(self, now, correction):
        """Moves on; the rows of the targets when the last one was reached, otherwise None."""
        if self.found is None:
            return None
        place, feed, dwell, line = self.rows[self.index]
        there = {**self.start, **place}
        seconds = math.dist(list(self.start.values()), list(there.values())) / feed * 60
        share = 1.0 if seconds == 0 else min(1.0, (now - self.begun) / seconds)
        self.here = {a: self.start[a] + share * (there[a] - self.start[a]) for a in there}
        if share < 1.0:
            return None
        if self.stood is None:
            self.here = dict(there)
            self.stood, self.since, self.last = now, now, dict(correction)
        if correction != self.last:
            self.since, self.last = now, dict(correction)
        settled = now - self.since >= self.settle_s
        waits = bool(line) and not settled and now - self.stood < self.at_most_s
        if now - self.stood < dwell or waits:
            return None
        if line:
            self.missed += not settled
            self.found.append((line, dict(self.here), dict(correction)))
        self.index += 1
        if self.index < len(self.rows):
            self.begin_move(now)
            return None
        found, self.found = self.found, None
        return found

"""An agent of MTConnect as far as a test needs it: reads lines of SHDR, judges their form, asks for the heartbeat.

Reads from standard input what is awaited, one JSON list [KEY, [WORDS…]] a line: the fields behind the key must begin with
these words, where null stands for any text and "number" for any number. Prints `ok` and the time of that line once it came.
"""

import json
import re
import socket
import sys
import threading
import time

TIME = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{3}Z")


def fields(line):
    """The fields of a line, by the rules of the protocol: split at each pipe that stands in no quoted field."""
    found, rest = [], line
    while True:
        if rest.startswith('"'):
            text, place = "", 1
            while rest[place] != '"':
                place += rest[place] == "\\"
                text += rest[place]
                place += 1
            found.append(text)
            rest = rest[place + 1:]
        else:
            end = rest.find("|")
            end = len(rest) if end < 0 else end
            found.append(rest[:end])
            rest = rest[end:]
        if not rest:
            return found
        assert rest[0] == "|", line
        rest = rest[1:]


def fits(told, wanted):
    if len(told) < len(wanted):
        return False
    for word, expected in zip(told, wanted):
        if expected == "number":
            try:
                float(word)
            except ValueError:
                return False
        elif expected is not None and word != expected:
            return False
    return True


host, port = sys.argv[1].rsplit(":", 1)
stream = socket.create_connection((host, int(port)), timeout=60)


def ask():
    """Asks for the heartbeat until the program ends, as an agent does."""
    while True:
        stream.sendall(b"* PING\n")
        time.sleep(5)


threading.Thread(target=ask, daemon=True).start()
lines = stream.makefile("r", encoding="utf-8", newline="\n")
last, pongs = {}, 0


def hear():
    """The next line that tells something: its key."""
    global pongs
    while True:
        line = next(lines).rstrip("\n")
        if line.startswith("* "):
            assert line == "* PONG 10000", line
            pongs += 1
            continue
        at, key, *rest = fields(line)
        assert TIME.fullmatch(at), line
        assert len(rest) in (1, 5), line
        if len(rest) == 5:
            # Conditions are told by code.
            last.setdefault(key, {})[rest[1]] = (at, rest)
        else:
            last[key] = {"": (at, rest)}
        return


print("ready", flush=True)
for wish in sys.stdin:
    key, wanted = json.loads(wish)
    while True:
        found = [at for at, told in last.get(key, {}).values() if fits(told, wanted)]
        if found:
            break
        hear()
    print("ok", found[0], flush=True)
while not pongs:
    hear()
print(json.dumps({"keys": sorted(last), "pongs": pongs}), flush=True)

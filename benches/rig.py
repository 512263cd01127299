"""What benches/faults starts: a simulated control, a gateway, and a wire between them."""
import http.client, json, os, pathlib, queue, socket, subprocess, threading, time

ROOT = pathlib.Path(__file__).resolve().parent.parent
TOKEN = "0123456789abcdef0123456789abcdef"
# Corrections of up to 120 µm, most of the limit of 150 µm, so that a step would be seen.
MACHINE = """
name = "bench"
structure = "w X' b Y Z t"
[axes.X]
travel = [-100.0, 600.0]
[axes.Y]
travel = [-100.0, 400.0]
[axes.Z]
travel = [-100.0, 350.0]
[errors]
EXX = { poly = [60.0, 0.2] }
EYX = 100.0
EZX = { poly = [-70.0, 0.25] }
"""


class Missing(Exception):
    """Something that this computer has not got."""


def listening(run):
    """The address that a program says that it listens on."""
    line = run.stdout.readline().strip()
    if not line:
        raise SystemExit(f"{run.args[0]} did not start")
    return line.rsplit("/", 1)[-1].rsplit(" ", 1)[-1]


class Control:
    """The simulated control and the log of its axes."""

    def __init__(self, rig, before=(), listen="127.0.0.1:0", moves=True):
        self.log = rig.folder / "axes.csv"
        motion = ["--stroke-mm", "200", "--period-s", "7"] if moves else ["--at", "X=300,Y=150,Z=50"]
        command = [*before, rig.programs / "focas-sim", "--listen", listen, "--axes", "X,Y,Z", "--axis-log", self.log, *motion]
        self.run = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        rig.running.append(self.run)
        self.address = listening(self.run)
        self.rows, self.read = [], 0

    def type(self, line):
        self.run.stdin.write(line + "\n")
        self.run.stdin.flush()

    def axes(self):
        """Lines of the log so far: time, whether it was switched on just before, corrections in µm."""
        with open(self.log) as file:
            file.seek(self.read)
            text = file.read()
        whole = text.rfind("\n") + 1
        for line in text[:whole].splitlines():
            if not line.startswith("monotonic"):
                fields = line.split(",")
                self.rows.append((float(fields[0]), fields[1] == "1", [float(um) for um in fields[2:]]))
        self.read += len(text[:whole].encode())
        return self.rows

    def largest_step(self, begin, end):
        """By axis, from scan to scan, µm."""
        largest, rows = [0.0] * 3, self.axes()
        for (_, _, before), (when, switched_on, now) in zip(rows, rows[1:]):
            if begin <= when < end and not switched_on:
                largest = [max(l, abs(n - b)) for l, n, b in zip(largest, now, before)]
        return largest


class Gateway:
    """The gateway as it is shipped, with a folder of its own."""

    def __init__(self, rig, address, guard="", environment={}):
        machine = rig.folder / "machine.toml"
        machine.write_text(MACHINE)
        text = (ROOT / "examples/gateway.toml").read_text()
        for old, new in (
            ('machine = "mill.toml"', f'machine = "{machine}"'),
            ("127.0.0.1:8193", address),
            ("confirm_um = 50.0", "confirm_um = 50.0\ntest_shift_um = 0\n" + guard),
            ('listen = "127.0.0.1:8080"', 'listen = "127.0.0.1:0"\ntoken_file = "tokens"'),
            ("audit/mill-600", "audit"),
        ):
            assert old in text, old
            text = text.replace(old, new)
        if guard:
            text = text.replace("accel_um_per_s2 = 20000.0", "").replace("ramp_s = 0.5", "")
        (rig.folder / "gateway.toml").write_text(text)
        tokens = rig.folder / "tokens"
        tokens.write_text(f"bench operate {TOKEN}\n")
        tokens.chmod(0o600)
        self.rig, self.environment = rig, environment
        self.start()

    def start(self):
        with open(self.rig.folder / "gateway.log", "a") as log:
            command = [self.rig.programs / "volcomp-gateway", "--config", self.rig.folder / "gateway.toml"]
            environment = {**os.environ, **self.environment}
            self.run = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=log, text=True, env=environment)
        self.rig.running.append(self.run)
        self.address = listening(self.run)

    def connection(self):
        connection = http.client.HTTPConnection(self.address, timeout=5)
        connection.connect()
        return connection

    def ask(self, method, path, connection=None):
        connection = connection or self.connection()
        connection.request(method, path, headers={"Authorization": f"Bearer {TOKEN}"})
        body = connection.getresponse().read()
        return json.loads(body) if body else None

    def corrects(self, patience_s=30):
        """Waits until it compensates, and does what a person has to do for that: what that was, or None."""
        needed, begun = [], time.monotonic()
        asked = begun
        while time.monotonic() < begun + patience_s:
            state = self.ask("GET", "/api/state")["state"]
            if state == "compensating":
                return needed
            if state in ("faulted", "disarmed") and time.monotonic() > asked + 3:
                needed.append("acknowledge" if state == "faulted" else "arm")
                asked = time.monotonic()
                self.ask("POST", "/api/" + needed[-1])
            time.sleep(0.02)
        return None


class Wire:
    """Passes segments on between gateway and control, and can hold them back."""

    def __init__(self, address):
        host, port = address.rsplit(":", 1)
        self.to = (host, int(port))
        self.held = [threading.Event(), threading.Event()]
        self.free()
        self.listener = socket.create_server(("127.0.0.1", 0))
        self.address = "127.0.0.1:%d" % self.listener.getsockname()[1]
        threading.Thread(target=self.accept, daemon=True).start()

    def free(self):
        for way in self.held:
            way.set()

    def accept(self):
        while True:
            near, _ = self.listener.accept()
            far = socket.create_connection(self.to)
            for a, b, way in ((near, far, 0), (far, near, 1)):
                a.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                segments = queue.Queue()
                threading.Thread(target=self.take, args=(a, segments), daemon=True).start()
                threading.Thread(target=self.give, args=(b, segments, way), daemon=True).start()

    @staticmethod
    def take(end, segments):
        """Takes what comes at once, so that a connection that is given up does not take it back."""
        try:
            while data := end.recv(65536):
                segments.put(data)
        except OSError:
            pass
        segments.put(b"")

    def give(self, end, segments, way):
        try:
            while data := segments.get():
                self.held[way].wait()
                end.sendall(data)
            end.shutdown(socket.SHUT_WR)
        except OSError:
            pass

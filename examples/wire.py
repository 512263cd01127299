"""A machine over the wire: its simulated FANUC control, its gateway, and what the control tells of its diagonals."""

import json
import os
import pathlib
import re
import signal
import socket
import subprocess
import time
import urllib.request

ROOT = pathlib.Path(__file__).resolve().parent.parent
ACCELERATION_MM_S2 = 5000
PATIENCE_S = 180


def free_port():
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def built(profile):
    """Builds the programs; the folder in which they are."""
    packages = [word for name in ("volcomp", "volcomp-gateway", "focas-sim") for word in ("-p", name)]
    command = ["cargo", "build", "--quiet", "--locked", "--profile", profile, *packages]
    command += ["--features", "volcomp-gateway/sinumerik"]
    subprocess.run(command, cwd=ROOT, check=True)
    target = pathlib.Path(os.environ.get("CARGO_TARGET_DIR", ROOT / "target"))
    return ROOT / target / ("debug" if profile == "dev" else profile)


class Wired:
    """One machine: its files, its simulated control and its gateway. Its folder has `truth.toml` and `diagonals.csv`, which the control is
    started with, and `machine.toml` for the gateway, whose configuration is in `home`."""

    def __init__(self, home, folder, programs):
        self.name, self.home, self.programs = home.name, home, programs
        self.folder = folder / self.name
        self.folder.mkdir(parents=True)
        self.control = self.gateway = None

    def volcomp(self, *arguments):
        command = [self.programs / "volcomp", *arguments]
        done = subprocess.run(command, cwd=self.folder, capture_output=True, text=True)
        if done.returncode != 0:
            raise RuntimeError(f"{self.name}: volcomp {' '.join(arguments)}: {done.stderr}")
        return done.stdout

    def start_control(self):
        gateway = (self.home / "gateway.toml").read_text()
        number = re.search(r"machine = (\d+)", gateway).group(1)
        command = [
            self.programs / "focas-sim", "--listen", "127.0.0.1:0", "--machine-number", number,
            "--truth", "truth.toml", "--program", "diagonals.csv", "--acceleration-mm-s2", str(ACCELERATION_MM_S2),
            "--report", "targets.csv", "--wait", "--report-s", "0", "--json",
            # The barrier moves the linear axes alone; scans as long as those of a FANUC are kept on a busy computer.
            "--barrier-axes", "X,Y,Z", "--scan-ms", "8",
        ]
        self.control = subprocess.Popen(
            command, cwd=self.folder, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        )
        line = self.control.stdout.readline()
        if not line.startswith("listening on "):
            raise RuntimeError(f"{self.name}: focas-sim does not start")
        self.address = line.split()[-1]

    def start_gateway(self):
        self.port = free_port()
        text = (self.home / "gateway.toml").read_text()
        text = re.sub(r"focas://[0-9.:]+", f"focas://{self.address}", text)
        text = re.sub(r'listen = "[0-9.:]+"', f'listen = "127.0.0.1:{self.port}"', text)
        (self.folder / "gateway.toml").write_text(text)
        log = (self.folder / "gateway.log").open("w")
        command = [self.programs / "volcomp-gateway", "--config", "gateway.toml"]
        self.gateway = subprocess.Popen(command, cwd=self.folder, stdout=log, stderr=log)

    def wait_for_correction(self):
        end, state = time.monotonic() + PATIENCE_S, "no answer"
        while state != "compensating":
            if time.monotonic() > end or self.gateway.poll() is not None:
                log = self.folder / "gateway.log"
                raise RuntimeError(f"{self.name}: the gateway does not compensate ({state}): see {log}")
            time.sleep(0.1)
            try:
                with urllib.request.urlopen(f"http://127.0.0.1:{self.port}/api/state", timeout=5) as answer:
                    state = json.load(answer)["state"]
            except OSError:
                pass

    def begin_pass(self):
        self.control.stdin.write("run\n")
        self.control.stdin.flush()

    def end_pass(self):
        """The ranges of the diagonals by name, as the control tells them, µm."""
        line = self.control.stdout.readline()
        if not line:
            raise RuntimeError(f"{self.name}: focas-sim ended")
        found = json.loads(line)
        if found["not_settled"]:
            raise RuntimeError(f"{self.name}: the correction did not settle at {found['not_settled']} targets")
        return {line["line"]: line["range_um"] for line in found["lines"]}

    def stop(self):
        for program in (self.gateway, self.control):
            if program and program.poll() is None:
                program.send_signal(signal.SIGTERM)
                program.wait(timeout=PATIENCE_S)

#!/usr/bin/env python3
"""A simulated SINUMERIK: an OPC UA server with the node ids of a SINUMERIK 840D sl, and a machine behind it.

It is built on the library asyncua and shares no code with the driver that it tests. Real controls were not at hand:
node ids are those of the published manuals where these name them, otherwise formed by analogy.

    sinumerik-sim.py --listen 127.0.0.1:4840 --axes X,Y,Z --at X=100,Y=50
    sinumerik-sim.py --listen 127.0.0.1:0 --axes X,Y,Z --program moves.csv --truth machine.toml \\
                     --temperature bed=20,24,600 --report-s 1 --json

It prints `listening on opc.tcp://ADDRESS` when it is ready and runs until SIGINT, SIGTERM or the typed command `quit`.
Exit status: 0 it was ended, 2 the call or a file is wrong.

The machine
  --axes LETTERS          letters of the axes in the control's order [X,Y,Z]
  --at X=100,C=30         where they stand, mm and deg; others at 0
  --program FILE          moves to go through again and again, CSV: axis letters (mm, deg), optionally feed (mm/min,
                          deg/min where only rotary axes move; default 2000) and dwell_s: the format of focas-sim
  --stroke-mm MM          instead: move every axis to and fro by so much ...
  --period-s S            ... once in this time [10]
  --temperature NAME=DEGC            a sensor that stays at this temperature
  --temperature NAME=START,END,TAU_S a sensor that goes from START to END with this time constant; repeat for more
                          sensors. They stand in /Plc/DB5.DBD0:REAL, /Plc/DB5.DBD4:REAL, ... in the order given.
  --truth FILE            a volcomp machine file: its [thermal] terms on positioning errors (EXX, EYY, EZZ, ...) move the
                          true axes, by the temperatures above. Its other errors are not those of axes but of the tool;
                          whoever wants those computes them from the report's true_mm and true_deg.
  --drift X=30,Y=-20,TAU_S  instead of a machine file: true axes drift by so many um with this time constant from the start
  --sign +1|-1            the setting data SD43900 moves an axis by so many times its value [+1]
  --in-positions          reported positions contain SD43900
  --targets FILE          go through --program once whenever `run` is typed: stand at each row whose column `line` is not
                          empty until the correction has settled, write what the axes then have into this CSV file (line,
                          commanded X,Y,Z mm, correction dX,dY,dZ mm), and print a JSON line with targets and not_settled
  --settle-s S --settle-at-most-s S   a correction has settled that has not changed for so long [0.3]; longest wait [10]

The control
  --user NAME:PASSWORD    who may log in; without it nobody need
  --namespace URI         of the nodes [SinumerikVarProvider]
  --md32750 N             machine data TEMP_COMP_TYPE of all axes; with bit 0 clear SD43900 moves nothing [1]
  --md32760 F --md32000 MM_MIN  the axis takes a new SD43900 at this speed at the most [0.01, 10000]
  --map KEY=N,...         the PLC looks corrections up in a map (docs/src/map-mode.md; map_control.py beside this file) and
                          moves the axes by them: machine, capacity (words), limit, rate (um, each step), turned (um),
                          step_scans, hold, time_out (scans), scan_ms. Mailbox: /Plc/DB100.DBW0:WORD[72], report:
                          /Plc/DB100.DBW144:WORD[24], buffers: /Plc/DB101.DBWn:WORD[m] in pieces of 64 words
  --node ID=VALUE         a further node that may be read and written: "/Plc/DB100.DBD0:REAL=0"; an array: "...=0,0,0"

Reported
  --report-s S            seconds between two lines of report; 0: only when one is asked for [0]
  --json                  lines as JSON documents: time_s, positions_mm, positions_deg (commanded), setting_um (SD43900 as it
                          stands), correction_um (what the axis has of it), drift_um, map (state of the look-up), map_um (what the axis has of it), true_mm, true_deg, residual_um
                          (drift and correction together), temperatures_degc, written (writes to SD43900 so far)

Faults, on the command line or typed on standard input while it runs (one command a line)
  --stall      stall on|off        the sampler stands: old values with old source timestamps
  --stick      stick on|off        it stands, and lies: old values with new timestamps
  --frozen-timestamps  frozen-timestamps on|off   new values with old source timestamps
  --frozen-positions   frozen-positions on|off    the same, of the positions alone
  --no-timestamps      no-timestamps on|off       values without source timestamps
  --drop-writes        drop-writes on|off         writes are answered as good and forgotten
  --refuse-writes      refuse-writes on|off       writes are refused (BadUserAccessDenied)
  --read-back X=UM     read-back X=UM|off         SD43900 of an axis reads as this, whatever was written
  --latency-ms MS      latency-ms MS              time until an answer is sent
               pause SECONDS       nothing is answered for this time
               disconnect          cut all connections
               alarm on|off, estop on|off, unreferenced on|off
               md32750 N           change the machine data
               temperature NAME=DEGC   the sensor has this temperature from now on
               set X=UM            set SD43900 by hand, as a person at the control does
               plc stop|run|start  the PLC does not scan any more, scans again, starts anew
               run                 go through the program (--targets)
               clear               SD43900 of all axes zero
               report, quit

Nodes (namespace index by --namespace; N: number of the axis from 1, NN: 30 + N)
  /Channel/MachineAxis/actToolBasePos[u1,N], .../measPos1[u1,N]             Double, mm or deg
  /Channel/GeometricAxis/actToolBasePos[u1,N]                               in workpiece coordinates: 100 less
  /Channel/MachineAxis/name[u1,N], /Channel/GeometricAxis/name[u1,N]        String
  /NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_ABS_VALUE[uN]                             Double, mm or deg, writable (SD43900)
  /NC/_N_AX_TEA_ACX/$MA_TEMP_COMP_TYPE[uN]                                  UInt32 (MD32750)
  /NC/_N_AX_TEA_ACX/$MA_COMP_ADD_VELO_FACTOR[uN], .../$MA_MAX_AX_VELO[uN]   Double (MD32760, MD32000 in mm/min)
  /Plc/DB10.DBX106.1 Boolean: emergency stop; /Plc/DB10.DBX109.0 Boolean: alarm; /Plc/DBNN.DBX60.4 Boolean: referenced
"""

import argparse
import asyncio
import csv
import datetime
import json
import logging
import math
import signal
import socket
import sys
import threading
import time
import tomllib

from map_control import KEYS as MAP_KEYS, MapControl
from walk import Walk

from asyncua import Server, ua
from asyncua.server.uaprocessor import UaProcessor
from asyncua.server.user_managers import UserManager
from asyncua.crypto.permission_rules import User, UserRole

ROTARY = "ABC"
# Of each geometry axis, mm.
WORK_OFFSET = 100.0


class WrongCall(Exception):
    """The call or a file is wrong."""


def number(text, what):
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise WrongCall(f"{what}: found {text!r}, expected a number")
    return value


def by_letter(text, axes, what):
    """`X=1,Y=2` to a dictionary; the letters are those of axes."""
    values = {}
    for part in text.split(","):
        letter, equals, value = part.partition("=")
        if not equals or letter not in axes:
            raise WrongCall(f"{what}: found {part!r}, expected AXIS=NUMBER with an axis of {','.join(axes)}")
        values[letter] = number(value, what)
    return values


class Program:
    """Where the axes are commanded to be, mm and deg, at a time in s."""

    def __init__(self, arguments, axes):
        self.axes = axes
        self.at = dict.fromkeys(axes, 0.0)
        if arguments.at:
            self.at |= by_letter(arguments.at, axes, "--at")
        self.rows = []
        self.stroke, self.period = arguments.stroke_mm, arguments.period_s
        self.legs, self.total = [], 0.0
        if arguments.program:
            self.read(arguments.program)

    def read(self, path):
        with open(path, encoding="utf-8", newline="") as file:
            rows = list(csv.DictReader(file))
        if not rows:
            raise WrongCall(f"{path}: found no moves, expected at least one")
        targets = []
        for line, row in enumerate(rows, 2):
            for key in row:
                if key not in [*self.axes, "feed", "dwell_s", "line"]:
                    raise WrongCall(f"{path}: found the column {key!r}, expected letters of axes, feed, dwell_s or line")
            place = {a: number(row[a], f"{path}:{line}: {a}") for a in self.axes if row.get(a)}
            feed = number(row.get("feed") or "2000", f"{path}:{line}: feed")
            if feed <= 0:
                raise WrongCall(f"{path}:{line}: feed: found {feed}, expected more than 0")
            targets.append((place, feed, number(row.get("dwell_s") or "0", f"{path}:{line}: dwell_s")))
            self.rows.append((*targets[-1], row.get("line") or ""))
        start = {**self.at, **targets[-1][0]}
        here, now = start, 0.0
        for place, feed, dwell in targets:
            there = {**here, **place}
            way = [abs(there[a] - here[a]) for a in self.axes if a not in ROTARY]
            way = math.hypot(*way) or math.hypot(*(there[a] - here[a] for a in self.axes if a in ROTARY))
            moves = way / feed * 60.0
            self.legs.append((now, moves, dwell, here, there))
            now += moves + dwell
            here = there
        self.total = now

    def position(self, t):
        if self.legs and self.total > 0:
            t %= self.total
            begin, moves, _, here, there = [leg for leg in self.legs if leg[0] <= t][-1]
            part = 1.0 if moves == 0 else min(1.0, (t - begin) / moves)
            return {a: here[a] + part * (there[a] - here[a]) for a in self.axes}
        sway = 0.5 * self.stroke * math.sin(2 * math.pi * t / self.period) if self.stroke else 0.0
        return {a: self.at[a] + sway for a in self.axes}


class Machine:
    """Temperatures, drift, and what the axes have of SD43900. Lengths in mm, angles in deg."""

    def __init__(self, arguments, axes):
        self.axes, self.arguments = axes, arguments
        self.start = time.monotonic()
        self.program = Program(arguments, axes)
        self.sensors = {}
        for text in arguments.temperature:
            name, _, values = text.partition("=")
            numbers = [number(v, f"--temperature {name}") for v in values.split(",")]
            if len(numbers) == 1:
                numbers = [numbers[0], numbers[0], 1.0]
            if not name or len(numbers) != 3 or numbers[2] <= 0:
                raise WrongCall(f"--temperature: found {text!r}, expected NAME=DEGC or NAME=START,END,TAU_S")
            self.sensors[name] = numbers
        self.overridden = {}
        self.reference, self.terms = 20.0, []
        if arguments.truth:
            self.read_truth(arguments.truth)
        self.drifts, self.drift_tau = {}, 1.0
        if arguments.drift:
            values, _, tau = arguments.drift.rpartition(",")
            self.drifts = by_letter(values, axes, "--drift")
            self.drift_tau = number(tau, "--drift")
            if self.drift_tau <= 0:
                raise WrongCall(f"--drift: found a time constant of {tau} s, expected more than 0")
        self.setting = dict.fromkeys(axes, 0.0)
        self.applied = dict.fromkeys(axes, 0.0)
        self.lags = [None] * len(self.terms)
        self.stepped = 0.0
        self.written = 0
        self.md32750 = arguments.md32750
        self.map, self.scans, self.plc_stands = None, 0, False
        if arguments.map:
            settings = {}
            for text in arguments.map.split(","):
                key, _, value = text.partition("=")
                if key not in MAP_KEYS:
                    raise WrongCall(f"--map: found {key!r}, expected one of {', '.join(MAP_KEYS)}")
                settings[key] = int(number(value, f"--map {key}"))
            self.map = MapControl(axes, settings)
        if arguments.targets:
            rows = self.program.rows
            if not rows:
                raise WrongCall("--targets: found no --program, expected one")
            self.program = Walk(rows, self.program.at, arguments.settle_s, arguments.settle_at_most_s)
        self.alarm = self.estop = self.unreferenced = False

    def read_truth(self, path):
        with open(path, "rb") as file:
            thermal = tomllib.load(file).get("thermal", {})
        self.reference = thermal.get("reference", 20.0)
        for kind in ("expansion", "drift"):
            for term in thermal.get(kind, []):
                error = term["error"]
                axis = error[2]
                if error[1] != axis or axis not in self.axes:
                    continue
                sensors = {term["sensor"]: 1.0} if kind == "expansion" else term["sensors"]
                missing = [name for name in sensors if name not in self.sensors]
                if missing:
                    raise WrongCall(f"{path}: {error}: found no --temperature {missing[0]}, expected one")
                self.terms.append((kind, axis, sensors, term))

    def now(self):
        return time.monotonic() - self.start

    def temperatures(self, t):
        def of(name):
            if name in self.overridden:
                return self.overridden[name]
            begin, end, tau = self.sensors[name]
            return end + (begin - end) * math.exp(-t / tau)

        return {name: of(name) for name in self.sensors}

    def step(self):
        """Moves on to this moment: lags of the drift, and the axes towards SD43900."""
        t = self.now()
        dt, self.stepped = t - self.stepped, t
        degc = self.temperatures(t)
        for index, (kind, _, sensors, term) in enumerate(self.terms):
            goal = sum(w * (degc[name] - self.reference) for name, w in sensors.items())
            lag, last = term.get("lag_s", 0.0), self.lags[index]
            if lag == 0.0 or last is None:
                self.lags[index] = goal
            else:
                self.lags[index] = goal + (last - goal) * math.exp(-dt / lag)
        most = self.arguments.md32760 * self.arguments.md32000 / 60.0 * dt
        for axis in self.axes:
            goal = self.setting[axis] if self.md32750 & 1 else 0.0
            way = goal - self.applied[axis]
            self.applied[axis] += max(-most, min(most, way))
        self.scan(t)
        if self.arguments.targets:
            self.walk(t)

    def scan(self, t):
        """As many scans of the PLC as are due."""
        if self.map is None:
            return
        due = int(t * 1e3 / self.map.s["scan_ms"])
        position = self.program.position(t)
        while self.scans < due:
            self.scans += 1
            if not self.plc_stands:
                self.map.scan(position, self.alarm or self.estop or self.unreferenced)

    def walk(self, t):
        correction = self.moved()
        found = self.program.step(t, correction)
        if found is None:
            return
        with open(self.arguments.targets, "w", encoding="utf-8", newline="") as file:
            rows = csv.writer(file)
            rows.writerow(["line", *self.axes, *(f"d{a}" for a in self.axes)])
            for line, at, has in found:
                rows.writerow([line, *(f"{at[a]:.6f}" for a in self.axes), *(f"{has[a]:.6f}" for a in self.axes)])
        print(json.dumps({"targets": len(found), "not_settled": self.program.missed}), flush=True)

    def moved(self):
        """What the axes have of SD43900 and of the map, mm."""
        of_map = self.map.applied if self.map else {}
        return {a: self.arguments.sign * self.applied[a] + 1e-3 * of_map.get(a, 0) for a in self.axes}

    def drift(self, t, commanded):
        drift = {a: 1e-3 * self.drifts.get(a, 0.0) * (1 - math.exp(-t / self.drift_tau)) for a in self.axes}
        for lag, (kind, axis, _, term) in zip(self.lags, self.terms):
            if lag is None:
                continue
            if kind == "expansion":
                drift[axis] += 1e-6 * term["um_per_m_k"] * lag * (commanded[axis] - term.get("fixed_mm", 0.0))
            else:
                drift[axis] += 1e-3 * term["um_per_k"] * lag
        return drift

    def report(self):
        self.step()
        t = self.stepped
        commanded = self.program.position(t)
        drift = self.drift(t, commanded)
        moved = self.moved()
        true = {a: commanded[a] + drift[a] + moved[a] for a in self.axes}
        linear = [a for a in self.axes if a not in ROTARY]
        rotary = [a for a in self.axes if a in ROTARY]

        def um(values):
            return {a: round(1e3 * values[a], 4) for a in linear}

        return {
            "time_s": round(t, 3),
            "positions_mm": {a: round(commanded[a], 6) for a in linear},
            "positions_deg": {a: round(commanded[a], 6) for a in rotary},
            "setting_um": um(self.setting),
            "correction_um": um(moved),
            "drift_um": um(drift),
            "residual_um": um({a: drift[a] + moved[a] for a in self.axes}),
            "true_mm": {a: round(true[a], 7) for a in linear},
            "true_deg": {a: round(true[a], 7) for a in rotary},
            "temperatures_degc": {n: round(v, 4) for n, v in self.temperatures(t).items()},
            "written": self.written,
            **({"map": self.map.told(), "map_um": dict(self.map.applied)} if self.map else {}),
        }


class Faults:
    """What the control does wrong."""

    def __init__(self, arguments, axes):
        self.stall = arguments.stall
        self.stick = arguments.stick
        self.frozen_timestamps = arguments.frozen_timestamps
        self.frozen_positions = arguments.frozen_positions
        self.no_timestamps = arguments.no_timestamps
        self.drop_writes = arguments.drop_writes
        self.refuse_writes = arguments.refuse_writes
        self.read_back = by_letter(arguments.read_back, axes, "--read-back") if arguments.read_back else {}
        self.latency = arguments.latency_ms * 1e-3
        self.paused_until = 0.0
        # What the sampler had seen when it began to stand.
        self.seen, self.since = {}, None

    def stands(self):
        return self.stall or self.stick

    def mark(self):
        """The sampler stands from now on."""
        self.seen, self.since = {}, datetime.datetime.now(datetime.timezone.utc)


class Users(UserManager):
    def __init__(self, pair):
        self.pair = pair

    def get_user(self, iserver, username=None, password=None, certificate=None):
        if isinstance(password, bytes):
            password = password.decode(errors="replace")
        if self.pair and [username, password] != self.pair:
            return None
        return User(role=UserRole.User)


class Control:
    def __init__(self, arguments, machine, faults):
        self.arguments, self.machine, self.faults = arguments, machine, faults
        self.server = None

    def now(self):
        return datetime.datetime.now(datetime.timezone.utc)

    def data_value(self, variant, key, sampled):
        """A value with its timestamps; `sampled`: it comes from the sampler, which may stand."""
        faults, source = self.faults, self.now()
        if sampled:
            if faults.stands():
                variant = faults.seen.setdefault(key, variant)
            if faults.stall or faults.frozen_timestamps or faults.frozen_positions and sampled == "position":
                source = faults.since
        return ua.DataValue(
            Value=variant,
            StatusCode=ua.StatusCode(ua.StatusCodes.Good),
            SourceTimestamp=None if faults.no_timestamps else source,
            ServerTimestamp=self.now(),
        )

    async def add(self, identifier, variant_type, read, write=None, sampled=False, array=False):
        first = read()
        node = await self.objects.add_variable(
            ua.NodeId(identifier, self.index), ua.QualifiedName(identifier, self.index), first, variant_type
        )
        if write:
            await node.set_writable()
        aspace = self.server.iserver.aspace

        def value(_node, _attribute):
            return self.data_value(ua.Variant(read(), variant_type, is_array=array), identifier, sampled)

        def setter(_node, _attribute, data_value):
            if self.faults.refuse_writes:
                raise ua.UaStatusCodeError(ua.StatusCodes.BadUserAccessDenied)
            if not self.faults.drop_writes:
                write(data_value.Value.Value)

        aspace.set_attribute_value_callback(node.nodeid, ua.AttributeIds.Value, value)
        if write:
            aspace.set_attribute_value_setter(node.nodeid, ua.AttributeIds.Value, setter)

    async def add_nodes(self):
        machine = self.machine
        double, boolean = ua.VariantType.Double, ua.VariantType.Boolean
        for place, axis in enumerate(machine.axes, 1):

            def position(axis=axis):
                machine.step()
                at = machine.program.position(machine.stepped)[axis]
                if self.arguments.in_positions:
                    at += self.arguments.sign * machine.applied[axis]
                return at

            def setting(axis=axis):
                if axis in self.faults.read_back:
                    return 1e-3 * self.faults.read_back[axis]
                return machine.setting[axis]

            def set_it(value, axis=axis):
                machine.step()
                machine.setting[axis] = float(value)
                machine.written += 1

            for name in ("actToolBasePos", "measPos1"):
                await self.add(f"/Channel/MachineAxis/{name}[u1,{place}]", double, position, sampled="position")
            in_workpiece = f"/Channel/GeometricAxis/actToolBasePos[u1,{place}]"
            await self.add(in_workpiece, double, lambda position=position: position() - WORK_OFFSET, sampled="position")
            for branch in ("GeometricAxis", "MachineAxis"):
                await self.add(f"/Channel/{branch}/name[u1,{place}]", ua.VariantType.String, lambda axis=axis: axis)
            await self.add(f"/NC/_N_AX_SEA_ACX/$SA_TEMP_COMP_ABS_VALUE[u{place}]", double, setting, set_it)
            tea = "/NC/_N_AX_TEA_ACX/$MA_"
            await self.add(f"{tea}TEMP_COMP_TYPE[u{place}]", ua.VariantType.UInt32, lambda: machine.md32750)
            await self.add(f"{tea}COMP_ADD_VELO_FACTOR[u{place}]", double, lambda: self.arguments.md32760)
            await self.add(f"{tea}MAX_AX_VELO[u{place}]", double, lambda: self.arguments.md32000)
            await self.add(f"/Plc/DB{30 + place}.DBX60.4", boolean, lambda: not machine.unreferenced, sampled=True)
        await self.add("/Plc/DB10.DBX106.1", boolean, lambda: machine.estop, sampled=True)
        await self.add("/Plc/DB10.DBX109.0", boolean, lambda: machine.alarm, sampled=True)
        for place, name in enumerate(machine.sensors):

            def degc(name=name):
                return machine.temperatures(machine.now())[name]

            await self.add(f"/Plc/DB5.DBD{4 * place}:REAL", ua.VariantType.Float, degc, sampled=True)
        if machine.map:
            await self.add_map(machine.map)
        for text in self.arguments.node:
            identifier, _, value = text.rpartition("=")
            numbers = [number(v, f"--node {identifier}") for v in value.split(",")]
            is_array = len(numbers) > 1
            cell = [numbers if is_array else numbers[0]]
            kind = ua.VariantType.Float if ":REAL" in identifier or ".DBD" in identifier else double
            if ".DBW" in identifier:
                kind, cell[0] = ua.VariantType.Int16, [int(n) for n in numbers] if is_array else int(numbers[0])
            await self.add(identifier, kind, lambda cell=cell: cell[0], lambda v, cell=cell: cell.__setitem__(0, v),
                           array=is_array)

    async def add_map(self, plc):
        word = ua.VariantType.UInt16

        def write(words):
            plc.mailbox = [int(w) for w in words][:72]

        await self.add("/Plc/DB100.DBW0:WORD[72]", word, lambda: plc.mailbox, write, array=True)
        await self.add("/Plc/DB100.DBW144:WORD[24]", word, lambda: plc.report, array=True)
        capacity = plc.s["capacity"]
        for first in (0, capacity):
            for place in range(0, capacity, 64):
                count = min(64, capacity - place)

                def piece(begin=first + place, count=count):
                    return plc.memory[begin : begin + count]

                await self.add(f"/Plc/DB101.DBW{2 * (first + place)}:WORD[{count}]", word, piece, array=True)

    async def start(self):
        host, _, port = self.arguments.listen.rpartition(":")
        if port == "0":
            # Clients are told the port by the server's endpoints, so it must be known before.
            with socket.create_server((host, 0)) as free:
                port = free.getsockname()[1]
        pair = self.arguments.user.split(":", 1) if self.arguments.user else None
        self.server = Server(user_manager=Users(pair))
        await self.server.init()
        self.server.set_server_name("simulated SINUMERIK")
        self.server.set_endpoint(f"opc.tcp://{host}:{port}")
        self.server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
        kinds = [ua.UserNameIdentityToken] if pair else [ua.AnonymousIdentityToken, ua.UserNameIdentityToken]
        self.server.set_identity_tokens(kinds)
        self.index = await self.server.register_namespace(self.arguments.namespace)
        self.objects = await self.server.nodes.objects.add_folder(self.index, "Sinumerik")
        await self.add_nodes()
        await self.server.start()
        return f"opc.tcp://{host}:{port}"

    def slow(self):
        """Lets every answer wait for --latency-ms and the end of a pause."""
        faults, process = self.faults, UaProcessor.process_message

        async def later(processor, header, body):
            while time.monotonic() < faults.paused_until:
                await asyncio.sleep(0.01)
            if faults.latency > 0:
                await asyncio.sleep(faults.latency)
            return await process(processor, header, body)

        UaProcessor.process_message = later

    def disconnect(self):
        for client in list(self.server.bserver.clients):
            if client.transport is not None:
                client.transport.abort()

    def command(self, line):
        """Does what is typed; whether to go on."""
        machine, faults = self.machine, self.faults
        word, _, rest = line.strip().partition(" ")
        switches = ("stall", "stick", "frozen-timestamps", "frozen-positions", "no-timestamps", "drop-writes", "refuse-writes")
        if word in switches and rest in ("on", "off"):
            if rest == "on":
                faults.mark()
            setattr(faults, word.replace("-", "_"), rest == "on")
        elif word in ("alarm", "estop", "unreferenced") and rest in ("on", "off"):
            setattr(machine, word, rest == "on")
        elif word == "read-back":
            faults.read_back = {} if rest == "off" else by_letter(rest, machine.axes, word)
        elif word == "latency-ms":
            faults.latency = number(rest, word) * 1e-3
        elif word == "pause":
            faults.paused_until = time.monotonic() + number(rest, word)
        elif word == "disconnect":
            self.disconnect()
        elif word == "plc" and machine.map and rest in ("stop", "run", "start"):
            machine.plc_stands = rest == "stop"
            if rest == "start":
                machine.map.start()
        elif word == "run" and self.arguments.targets:
            machine.program.run(machine.now())
        elif word == "md32750":
            machine.md32750 = int(number(rest, word))
        elif word == "temperature":
            machine.overridden |= by_letter(rest, list(machine.sensors), word)
        elif word == "set":
            machine.step()
            machine.setting |= {a: 1e-3 * um for a, um in by_letter(rest, machine.axes, word).items()}
        elif word == "clear":
            machine.step()
            machine.setting = dict.fromkeys(machine.axes, 0.0)
        elif word == "report":
            self.print_report()
        elif word == "quit":
            return False
        elif word:
            raise WrongCall(f"found {line.strip()!r}, expected a command of the list in this file's header")
        return True

    def print_report(self):
        report = self.machine.report()
        if self.arguments.json:
            print(json.dumps(report), flush=True)
            return
        parts = [f"{a} {at:.4f}" for a, at in report["positions_mm"].items()]
        parts += [f"{a} {report['drift_um'][a]:+.1f} -> {report['residual_um'][a]:+.1f} um" for a in report["drift_um"]]
        print(f"{report['time_s']:.1f} s  " + "  ".join(parts), flush=True)


async def run(arguments):
    axes = arguments.axes.split(",")
    if any(len(a) != 1 or not a.isupper() for a in axes) or len(set(axes)) != len(axes):
        raise WrongCall(f"--axes: found {arguments.axes}, expected different letters with commas between")
    machine, faults = Machine(arguments, axes), Faults(arguments, axes)
    faults.mark()
    control = Control(arguments, machine, faults)
    control.slow()
    address = await control.start()
    # The drift and the program begin when it can be asked.
    machine.start, machine.stepped, machine.scans = time.monotonic(), 0.0, 0
    loop, end = asyncio.get_running_loop(), asyncio.Event()
    for which in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(which, end.set)

    def act(line):
        try:
            if not control.command(line):
                end.set()
        except WrongCall as wrong:
            print(f"error: {wrong}", file=sys.stderr, flush=True)

    def typed():
        for line in sys.stdin:
            loop.call_soon_threadsafe(act, line)

    threading.Thread(target=typed, daemon=True).start()
    print(f"listening on {address}", flush=True)

    async def steps():
        while True:
            machine.step()
            await asyncio.sleep(0.005 if machine.map else 0.01)

    async def reports():
        while arguments.report_s > 0:
            await asyncio.sleep(arguments.report_s)
            control.print_report()

    tasks = [asyncio.create_task(steps()), asyncio.create_task(reports())]
    await end.wait()
    for task in tasks:
        task.cancel()
    control.disconnect()
    await control.server.stop()


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter, add_help=True
    )
    add = parser.add_argument
    add("--listen", default="127.0.0.1:4840", help="address and port; port 0 takes a free one")
    add("--axes", default="X,Y,Z")
    add("--at")
    add("--program")
    add("--stroke-mm", type=float, default=0.0)
    add("--period-s", type=float, default=10.0)
    add("--temperature", action="append", default=[])
    add("--truth")
    add("--drift")
    add("--sign", type=int, choices=[1, -1], default=1)
    add("--in-positions", action="store_true")
    add("--user")
    add("--namespace", default="SinumerikVarProvider")
    add("--md32750", type=int, default=1)
    add("--md32760", type=float, default=0.01)
    add("--md32000", type=float, default=10000.0)
    add("--map")
    add("--targets")
    add("--settle-s", type=float, default=0.3)
    add("--settle-at-most-s", type=float, default=10.0)
    add("--node", action="append", default=[])
    add("--report-s", type=float, default=0.0)
    add("--json", action="store_true")
    for switch in ("stall", "stick", "frozen-timestamps", "frozen-positions", "no-timestamps", "drop-writes", "refuse-writes"):
        add(f"--{switch}", action="store_true")
    add("--read-back")
    add("--latency-ms", type=float, default=0.0)
    logging.basicConfig(level=logging.CRITICAL)
    try:
        asyncio.run(run(parser.parse_args()))
    except (WrongCall, OSError, tomllib.TOMLDecodeError, KeyError) as wrong:
        print(f"error: {wrong}", file=sys.stderr)
        sys.exit(2)


if __name__ == "__main__":
    main()

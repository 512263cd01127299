#!/usr/bin/python3
# SPDX-License-Identifier: GPL-2.0-or-later
"""The user interface of a LinuxCNC without a display: does what a test asks over a socket. LinuxCNC lives as long as it.

It imports LinuxCNC's Python module, so it is under LinuxCNC's licence."""

import inspect
import json
import os
import signal
import socket
import subprocess
import sys
import time

import hal
import linuxcnc

stat, command = linuxcnc.stat(), linuxcnc.command()
errors = linuxcnc.error_channel()
said = []
# Values of HAL are read only from within a component.
component = hal.component("volcomp-test")
component.ready()


def halcmd(*arguments):
    return subprocess.run(["halcmd", *arguments], capture_output=True, text=True, check=True).stdout.strip()


def listen():
    """What LinuxCNC has said to its operator."""
    global errors
    try:
        while message := errors.poll():
            said.append(message[1])
    except linuxcnc.error:
        errors = linuxcnc.error_channel()


class Stands(Exception):
    """LinuxCNC does not do what it was asked for, and nothing moves: without a real-time kernel that happens on a busy computer, where
    its log has `USRMOT: ERROR: command timeout`: the servo thread stood for longer than [EMCMOT]COMM_TIMEOUT, and what it was asked for is
    lost. The test knows it by the words LinuxCNC stands."""

    def __init__(self, what):
        super().__init__(f"LinuxCNC stands: {what}; {shown()}")


def servo_thread():
    """Whether the servo thread goes on: the time from one of its cycles to the next is hardly twice the same."""
    try:
        periods = set()
        for _ in range(20):
            periods.add(hal.get_value("motion.servo.last-period"))
            time.sleep(0.003)
        return "goes on" if len(periods) > 1 else "stands"
    except RuntimeError as error:
        return f"is not known: {error}"


def shown():
    """What LinuxCNC tells of itself, for a test that fails."""
    return (f"state {stat.task_state} mode {stat.task_mode} homed {stat.homed[:stat.joints]} interpreter {stat.interp_state} "
            f"in position {stat.inpos} queue {stat.queue} execution {stat.state} heard {stat.echo_serial_number} of {command.serial} "
            f"motion {stat.motion_mode} paused {stat.paused} line {stat.motion_line} to go {stat.distance_to_go} "
            f"servo thread {servo_thread()}; {said}")


def until(send, done, patience=3.0, tries=8):
    """Commands can get lost where the computer is busy: sent again until the effect is seen. How often it was sent."""
    global command
    for tried in range(1, tries + 1):
        if tried > 1:
            # A channel on which nothing arrives is opened anew.
            command = linuxcnc.command()
        send()
        end = time.monotonic() + patience
        while time.monotonic() < end:
            stat.poll()
            if done():
                if tried > 1:
                    print(f"user interface: {inspect.stack()[1].function} was asked for {tried} times", file=sys.stderr, flush=True)
                return tried
            time.sleep(0.002)
        listen()
    raise Stands("no effect")


def state(wanted):
    return until(lambda: command.state(wanted), lambda: stat.task_state == wanted)


# In what the motion controller has to be where the task is in a mode. It goes there only while nothing moves, forgets at once what it
# was asked for otherwise (set_operating_mode in src/emc/motion/control.c), and tells the task nothing of it. A task that is in MDI while the
# motion controller is not in coordinated mode takes commands, and nothing moves.
MOTION_MODES = {
    linuxcnc.MODE_MANUAL: (linuxcnc.TRAJ_MODE_FREE, linuxcnc.TRAJ_MODE_TELEOP),
    linuxcnc.MODE_MDI: (linuxcnc.TRAJ_MODE_COORD,),
    linuxcnc.MODE_AUTO: (linuxcnc.TRAJ_MODE_COORD,),
}


def mode(wanted):
    return until(lambda: command.mode(wanted), lambda: stat.task_mode == wanted and stat.motion_mode in MOTION_MODES[wanted],
                 patience=1.0, tries=24)


def on():
    # What is told first may be from before LinuxCNC has looked at its emergency stop: so each time what is told now counts.
    if stat.task_state == linuxcnc.STATE_ESTOP:
        state(linuxcnc.STATE_ESTOP_RESET)
    until(lambda: command.state(linuxcnc.STATE_ESTOP_RESET if stat.task_state == linuxcnc.STATE_ESTOP else linuxcnc.STATE_ON),
          lambda: stat.task_state == linuxcnc.STATE_ON, patience=1.0, tries=24)


def home():
    mode(linuxcnc.MODE_MANUAL)
    if not all(stat.homed[:stat.joints]):
        until(lambda: command.teleop_enable(0), lambda: stat.motion_mode == linuxcnc.TRAJ_MODE_FREE)
        until(lambda: command.home(-1), lambda: all(stat.homed[:stat.joints]), patience=10)


def idle(patience=30):
    """Waits until nothing moves and nothing is to be done, several looks long; for as long as something goes on."""
    end, quiet, before = time.monotonic() + patience, 0, None
    while quiet < 10:
        time.sleep(0.004)
        stat.poll()
        is_idle = (stat.interp_state == linuxcnc.INTERP_IDLE and stat.inpos and stat.queue == 0
                   and stat.state != linuxcnc.RCS_EXEC and stat.echo_serial_number >= command.serial)
        quiet = quiet + 1 if is_idle else 0
        now = (stat.distance_to_go, stat.motion_line, stat.actual_position)
        if now != before:
            end, before = time.monotonic() + patience, now
        if time.monotonic() > end:
            raise Stands("it is not idle")
    listen()


def begin_mdi(text):
    """A command whose effect is a motion, which may be over before anybody looks: it was taken when its number is told."""
    global command
    # The change of the mode ends what the task was doing, and reads the position anew: both are over before the command comes.
    mode(linuxcnc.MODE_MDI)
    idle()
    for _ in range(8):
        before = command.serial
        command.mdi(text)
        end = time.monotonic() + 3
        while command.serial != before and time.monotonic() < end:
            stat.poll()
            if stat.echo_serial_number >= command.serial:
                return
            time.sleep(0.002)
        command = linuxcnc.command()
    raise Stands(f"{text} is not taken")


def mdi(text):
    begin_mdi(text)
    idle()
    # The task tells its operator nothing of a command that the servo thread did not answer in time: it ends there, and nothing moves.
    if stat.state == linuxcnc.RCS_ERROR:
        raise Stands(f"{text} ended in an error")


def begin(path):
    mode(linuxcnc.MODE_AUTO)
    idle()
    until(lambda: command.program_open(path), lambda: stat.file == path)
    until(lambda: command.auto(linuxcnc.AUTO_RUN, 0), lambda: stat.interp_state != linuxcnc.INTERP_IDLE)


def pause():
    until(lambda: command.auto(linuxcnc.AUTO_PAUSE), lambda: stat.paused)


def resume():
    until(lambda: command.auto(linuxcnc.AUTO_RESUME), lambda: not stat.paused)


recorder = None


def record(path):
    global recorder
    file = open(path, "w", encoding="ascii")
    recorder = (subprocess.Popen(["halsampler"], stdout=file), file)
    time.sleep(0.2)
    halcmd("setp", "sampler.0.enable", "1")


def recorded():
    halcmd("setp", "sampler.0.enable", "0")
    time.sleep(0.3)
    process, file = recorder
    process.terminate()
    process.wait()
    file.close()
    return halcmd("getp", "sampler.0.overruns")


def realtime():
    """As much real time as this computer gives: without it the servo thread waits for everybody."""
    listed = subprocess.run(["ps", "-eLo", "pid,tid,comm,args"], capture_output=True, text=True, check=True).stdout
    mine = os.environ["VOLCOMP_HERE"]
    done = 0
    for line in listed.splitlines()[1:]:
        pid, tid, comm, arguments = line.split(None, 3)
        try:
            with open(f"/proc/{pid}/environ", "rb") as file:
                if mine.encode() not in file.read():
                    continue
        except OSError:
            continue
        if comm.startswith("rtapi_app:T") or comm.startswith("milltask"):
            level = "80" if comm.startswith("rtapi") else "40"
            done += subprocess.run(["chrt", "-f", "-p", level, tid], capture_output=True).returncode == 0
    return done


def answer(asked):
    do = asked.pop("do")
    if do == "up":
        stat.poll()
        on()
        home()
        mode(linuxcnc.MODE_MDI)
    elif do == "on":
        stat.poll()
        on()
    elif do == "off":
        # What is off without an emergency stop is told as one that was reset.
        until(lambda: command.state(linuxcnc.STATE_OFF), lambda: stat.task_state != linuxcnc.STATE_ON)
    elif do == "estop":
        state(linuxcnc.STATE_ESTOP)
    elif do == "mdi":
        mdi(asked["text"])
    elif do == "begin_mdi":
        begin_mdi(asked["text"])
    elif do == "begin":
        begin(asked["path"])
    elif do in ("idle", "pause", "resume"):
        globals()[do]()
    elif do == "joint_mode":
        mode(linuxcnc.MODE_MANUAL)
        until(lambda: command.teleop_enable(0), lambda: stat.motion_mode == linuxcnc.TRAJ_MODE_FREE)
    elif do == "hal":
        return halcmd(*asked["arguments"])
    elif do == "get":
        return [float(hal.get_value(pin)) for pin in asked["pins"]]
    elif do == "probed":
        stat.poll()
        return [bool(stat.probe_tripped), *stat.probed_position]
    elif do == "said":
        listen()
        return said
    elif do == "record":
        record(asked["path"])
    elif do == "recorded":
        return recorded()
    elif do == "realtime":
        return realtime()
    elif do == "spawn":
        subprocess.Popen(asked["arguments"])
    else:
        raise RuntimeError(f"unknown action {do}")
    return None


def main():
    signal.signal(signal.SIGTERM, lambda *_: os._exit(0))
    peer = socket.socket(socket.AF_UNIX)
    # What is asked while the other parts of LinuxCNC are still starting is lost for good.
    time.sleep(1)
    peer.connect(os.environ["VOLCOMP_UI"])
    for line in peer.makefile("r"):
        try:
            told = {"ok": answer(json.loads(line))}
        except Exception as error:  # told to the test, which fails with it
            told = {"error": f"{type(error).__name__}: {error} {getattr(error, 'stderr', '')}"}
        peer.sendall((json.dumps(told) + "\n").encode())


main()

# SPDX-License-Identifier: GPL-2.0-or-later
"""The datagrams of the protocol, version 1."""

import struct
import zlib

VERSION = 1
EMERGENCY_STOP, ENABLED, HOMED, LIMITED, PROBING, LOST = (1 << bit for bit in range(6))
LISTEN, FRAME = 0, 1
HEAD = struct.Struct("<4sBBHIIHHQII")
AXIS = struct.Struct("<B3xIddq")
COMMAND = struct.Struct("<4sBxHIHH")
MOST_WORDS = 40


def state(machine, run, sequence, flags, time_ns, scan_ns, axes, report):
    """`axes`: letter, size of a count, position, velocity, offset of each."""
    body = HEAD.pack(b"VCLS", VERSION, len(axes), machine, run, sequence & 0xFFFFFFFF, flags, len(report), time_ns, scan_ns, 0)
    for letter, step, position, velocity, offset in axes:
        body += AXIS.pack(ord(letter), step, position, velocity, offset)
    body += struct.pack(f"<{len(report)}H", *report)
    return body + struct.pack("<I", zlib.crc32(body))


def command(data):
    """Machine, kind and words of a command; `None` for everything else."""
    if len(data) < COMMAND.size + 4:
        return None
    body, check = data[:-4], data[-4:]
    magic, version, machine, _, kind, count = COMMAND.unpack_from(body)
    if magic != b"VCLF" or version != VERSION or struct.unpack("<I", check)[0] != zlib.crc32(body):
        return None
    if count > MOST_WORDS or len(body) != COMMAND.size + 2 * count:
        return None
    if kind == LISTEN and count == 0 or kind == FRAME:
        return machine, kind, list(struct.unpack_from(f"<{count}H", body, COMMAND.size))
    return None

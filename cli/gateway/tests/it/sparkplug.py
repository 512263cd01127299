"""A host application of Sparkplug B, as far as a test needs it.

Prints one JSON line for each message: topic, numbers, metrics. The payload is read by the wire format of protocol buffers and
the field numbers of the specification, by no other library. Each line on standard input is a command: `rebirth TOPIC` asks
for a birth there, `write TOPIC NAME` sends a metric that is true, `garbage TOPIC` sends what is no payload.
"""

import json
import struct
import sys

import paho.mqtt.client as mqtt


def fields(data):
    """Number, and content: a number of a varint, 4 or 8 bytes, or bytes."""
    place = 0

    def varint():
        nonlocal place
        value = shift = 0
        while True:
            byte = data[place]
            place += 1
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    while place < len(data):
        tag = varint()
        number, kind = tag >> 3, tag & 7
        if kind == 0:
            yield number, varint()
        elif kind == 2:
            length = varint()
            yield number, data[place:place + length]
            assert place + length <= len(data)
            place += length
        else:
            size = {1: 8, 5: 4}[kind]
            yield number, data[place:place + size]
            place += size


# Fields of a value: of a metric from 10 on, of a property from 3 on.
VALUES = ["int", "long", "float", "double", "boolean", "string"]


def value_of(kind, content):
    if kind == "double":
        return struct.unpack("<d", content)[0]
    if kind == "float":
        return struct.unpack("<f", content)[0]
    if kind == "boolean":
        return bool(content)
    if kind == "string":
        return content.decode()
    return content


def properties(data):
    keys, values = [], []
    for number, content in fields(data):
        if number == 1:
            keys.append(content.decode())
        elif number == 2:
            found = {n: c for n, c in fields(content)}
            (own,) = [n for n in found if n >= 3]
            values.append(value_of(VALUES[own - 3], found[own]))
    assert len(keys) == len(values)
    return dict(zip(keys, values))


def metric(data):
    found = {"null": False, "value": None, "properties": {}}
    for number, content in fields(data):
        if number == 1:
            found["name"] = content.decode()
        elif number == 3:
            found["timestamp"] = content
        elif number == 4:
            found["datatype"] = content
        elif number == 7:
            found["null"] = bool(content)
        elif number == 9:
            found["properties"] = properties(content)
        elif 10 <= number <= 15:
            found["value"] = value_of(VALUES[number - 10], content)
        else:
            raise AssertionError(f"a field {number}")
    assert found["null"] == (found["value"] is None), found
    return found


def payload(data):
    told = {"timestamp": None, "seq": None, "metrics": {}}
    for number, content in fields(data):
        if number == 1:
            told["timestamp"] = content
        elif number == 2:
            own = metric(content)
            assert own["name"] not in told["metrics"], own
            told["metrics"][own.pop("name")] = own
        elif number == 3:
            told["seq"] = content
        else:
            raise AssertionError(f"a field {number}")
    return told


def varint(value):
    data = b""
    while value > 0x7F:
        data += bytes([value & 0x7F | 0x80])
        value >>= 7
    return data + bytes([value])


def command(name):
    """A payload with one metric that is true."""
    name = name.encode()
    own = b"\x0a" + varint(len(name)) + name + b"\x20\x0b" + b"\x70\x01"
    return b"\x08\x01\x12" + varint(len(own)) + own


def on_connect(client, _data, _flags, reason, _properties=None):
    assert not reason.is_failure, reason
    client.subscribe("spBv1.0/#", qos=1)


def on_message(_client, _data, message):
    if "/NCMD/" in message.topic or "/DCMD/" in message.topic:
        return
    told = {"topic": message.topic, "qos": message.qos, "retain": message.retain}
    print(json.dumps(told | payload(message.payload)), flush=True)


def on_subscribe(*_):
    print(json.dumps({"topic": "ready"}), flush=True)


port, *more = sys.argv[1:]
client = mqtt.Client(mqtt.CallbackAPIVersion.VERSION2, client_id=f"host-{port}")
client.on_connect, client.on_message, client.on_subscribe = on_connect, on_message, on_subscribe
if more:
    user, password, authority = more
    client.username_pw_set(user, password)
    client.tls_set(ca_certs=authority)
client.reconnect_delay_set(min_delay=1, max_delay=1)
client.connect("localhost" if more else "127.0.0.1", int(port), keepalive=60)
client.loop_start()
for line in sys.stdin:
    what, topic, *rest = line.split(" ", 2)
    data = {
        "rebirth": lambda: command("Node Control/Rebirth"),
        "write": lambda: command(rest[0].strip()),
        "garbage": lambda: b"\xff" * 100,
    }[what]()
    client.publish(topic.strip(), data, qos=1)

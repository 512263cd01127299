"""A CANopen node of PyPI's canopen on vcan1: canopen_node.py. Node 5: temperatures 21.5 and -3.2 degC in process data 1
as numbers of two bytes with one decimal, a status byte 0, heartbeat every 50 ms; object 6132h sub 1 holds 1, 1017h may
be written. Waits to be started."""

import time

import canopen
from canopen.objectdictionary import ODArray, ODVariable, ObjectDictionary
from canopen.objectdictionary.datatypes import UNSIGNED8, UNSIGNED16


def variable(name, index, sub, kind, value):
    var = ODVariable(name, index, sub)
    var.data_type = kind
    var.access_type = "rw"
    var.default = value
    return var


def dictionary():
    od = ObjectDictionary()
    od.add_object(variable("Producer heartbeat time", 0x1017, 0, UNSIGNED16, 50))
    decimals = ODArray("AI decimal digits PV", 0x6132)
    decimals.add_member(variable("Highest sub-index", 0x6132, 0, UNSIGNED8, 1))
    decimals.add_member(variable("Channel 1", 0x6132, 1, UNSIGNED8, 1))
    od.add_object(decimals)
    return od


network = canopen.Network()
network.connect(interface="socketcan", channel="vcan1")
node = network.create_node(5, dictionary())
node.nmt.state = "PRE-OPERATIONAL"
node.nmt.start_heartbeat(50)
print("ready", flush=True)
while True:
    if node.nmt.state == "OPERATIONAL":
        data = (215).to_bytes(2, "little") + (-32).to_bytes(2, "little", signed=True) + bytes(4)
        network.send_message(0x185, data)
    time.sleep(0.02)

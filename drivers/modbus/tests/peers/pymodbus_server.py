"""A Modbus server of PyPI's pymodbus: pymodbus_server.py tcp PORT | rtu DEVICE. Units 1 to 3 with the same data."""

import asyncio
import sys

from pymodbus.datastore import ModbusDeviceContext, ModbusSequentialDataBlock, ModbusServerContext
from pymodbus.framer import FramerType
from pymodbus.server import StartAsyncSerialServer, StartAsyncTcpServer


def device(unit):
    """Registers 0 to 3: 20.1 to 20.4 degC and ten times the unit; input n is on where n is odd."""
    words = [200 + i + 1 + 100 * unit for i in range(4)] + [0] * 196
    # A block's first address is 1 for register 0 on the wire.
    return ModbusDeviceContext(
        hr=ModbusSequentialDataBlock(1, words),
        ir=ModbusSequentialDataBlock(1, words),
        di=ModbusSequentialDataBlock(1, [i % 2 == 1 for i in range(200)]),
        co=ModbusSequentialDataBlock(1, [False] * 200),
    )


async def main():
    context = ModbusServerContext(devices={unit: device(unit) for unit in (1, 2, 3)}, single=False)
    print("ready", flush=True)
    if sys.argv[1] == "tcp":
        await StartAsyncTcpServer(context, address=("127.0.0.1", int(sys.argv[2])))
    else:
        await StartAsyncSerialServer(context, framer=FramerType.RTU, port=sys.argv[2], baudrate=19200)


asyncio.run(main())

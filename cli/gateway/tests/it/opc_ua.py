"""A client of OPC UA, on the library asyncua: reads a gateway, and tries to change it.

    opc_ua.py URL

Reads orders from standard input, one a line, and prints one line of JSON for each:

    all                 every node below the folder of the gateway, found by browsing
    wait KEY STATUS     waits until the status of a variable begins with this word, and prints its value and times
    change              tries to write, to call and to add and delete nodes: what was not refused
    watch KEY           subscribes to a variable, and prints two of its values that differ
"""

import asyncio
import json
import sys
from datetime import timezone

from asyncua import Client, ua
from asyncua.ua.status_codes import get_name_and_doc

NAMESPACE = "urn:volcomp:gateway"
PATIENCE = 90


def told(value):
    time = value.SourceTimestamp
    return {
        "value": value.Value.Value,
        "type": value.Value.VariantType.name,
        "status": get_name_and_doc(value.StatusCode.value)[0],
        "source": time.replace(tzinfo=timezone.utc).timestamp() if time else None,
    }


async def read(node):
    return await node.read_data_value(raise_on_bad_status=False)


async def below(node, path):
    for child in await node.get_children():
        name = (await child.read_browse_name()).Name
        here = path + [name]
        if await child.read_node_class() == ua.NodeClass.Variable:
            own = told(await read(child))
            own["id"] = child.nodeid.Identifier
            own["path"] = "/".join(here)
            own["help"] = (await child.read_description()).Text
            own["data_type"] = (await child.read_data_type()).Identifier
            masks = [await child.get_access_level(), await child.get_user_access_level()]
            own["access"] = [sorted(level.name for level in mask) for mask in masks]
            yield own
        else:
            async for found in below(child, here):
                yield found


class Changes:
    def __init__(self):
        self.values = asyncio.Queue()

    def datachange_notification(self, node, value, data):
        self.values.put_nowait(value)


async def change(client, space, variables):
    """What was not refused."""
    done = []

    async def refused(what, attempt):
        try:
            await attempt
        except (ua.UaError, ua.UaStatusCodeError):
            return
        done.append(what)

    for own in variables:
        node = client.get_node(ua.NodeId(own["id"], space))
        value = {"Double": 1.5, "UInt64": 1, "Boolean": True, "String": "armed"}[
            {11: "Double", 9: "UInt64", 1: "Boolean", 12: "String"}[own["data_type"]]
        ]
        kind = {float: ua.VariantType.Double, bool: ua.VariantType.Boolean, int: ua.VariantType.UInt64}
        variant = ua.Variant(value, kind.get(type(value), ua.VariantType.String))
        await refused(own["id"], node.write_value(ua.DataValue(variant)))
        level = ua.DataValue(ua.Variant(3, ua.VariantType.Byte))
        await refused(own["id"] + " level", node.write_attribute(ua.AttributeIds.AccessLevel, level))
        await refused(own["id"] + " user level", node.write_attribute(ua.AttributeIds.UserAccessLevel, level))
    folder = client.get_node(ua.NodeId("volcomp", space))
    await refused("a folder", folder.add_folder(space, "more"))
    await refused("a variable", folder.add_variable(space, "more", 1.0))
    await refused("a method", folder.call_method(ua.NodeId("arm", space)))

    async def delete():
        _, codes = await client.delete_nodes([client.get_node(ua.NodeId("state", space))])
        if not any(code.is_good() for code in codes):
            raise ua.UaError("refused")

    await refused("delete", delete())
    return done


async def main():
    url = sys.argv[1]
    endpoints = await Client(url, timeout=60).connect_and_get_server_endpoints()
    async with Client(url, timeout=60) as client:
        # Printed once the session is open, so that no flood of connections comes before it.
        print(json.dumps([[end.EndpointUrl, end.SecurityMode.name] for end in endpoints]), flush=True)
        space = await client.get_namespace_index(NAMESPACE)
        root = client.get_node(ua.NodeId("volcomp", space))
        loop = asyncio.get_running_loop()
        while line := await loop.run_in_executor(None, sys.stdin.readline):
            match line.split():
                case ["all"]:
                    answer = [own async for own in below(root, [])]
                case ["wait", key, status]:
                    node = client.get_node(ua.NodeId(key, space))
                    async with asyncio.timeout(PATIENCE):
                        while not (answer := told(await read(node)))["status"].startswith(status):
                            await asyncio.sleep(0.05)
                case ["change"]:
                    answer = await change(client, space, [own async for own in below(root, [])])
                case ["watch", key]:
                    changes = Changes()
                    subscription = await client.create_subscription(100, changes)
                    await subscription.subscribe_data_change(client.get_node(ua.NodeId(key, space)))
                    async with asyncio.timeout(PATIENCE):
                        answer = [await changes.values.get()]
                        while len(answer) < 2:
                            value = await changes.values.get()
                            if value != answer[0]:
                                answer.append(value)
                    await subscription.delete()
            print(json.dumps(answer), flush=True)


asyncio.run(main())

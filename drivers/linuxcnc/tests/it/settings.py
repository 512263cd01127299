# SPDX-License-Identifier: GPL-2.0-or-later
"""What the bridge in user space says of an INI file, without LinuxCNC. It imports the bridge, and is under its licence.
Arguments: the folder of the bridge, and the INI file."""

import sys
import types

sys.dont_write_bytecode = True


class Ini:
    """As LinuxCNC's module reads one: the first value of a key, with what stands behind it."""

    def __init__(self, path):
        self.values, section = {}, ""
        with open(path, encoding="ascii") as file:
            for line in map(str.strip, file):
                if line.startswith("["):
                    section = line.strip("[]")
                elif "=" in line and not line.startswith(("#", ";")):
                    key, value = line.split("=", 1)
                    self.values.setdefault((section, key.strip()), value.strip())

    def find(self, section, key):
        return self.values.get((section, key))


for name in ("hal", "linuxcnc"):
    sys.modules[name] = types.ModuleType(name)
    sys.modules[name].error = RuntimeError
sys.modules["linuxcnc"].ini = Ini
sys.path.insert(0, sys.argv[1])
import volcomp_bridge as bridge  # noqa: E402

sys.argv[1:] = sys.argv[2:]
# It stops where it would open its port.
bridge.Senders = lambda configuration: sys.exit(0)
sys.exit(bridge.main())

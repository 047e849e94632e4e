"""What the rig says about outages, held against what a driver can do."""

from __future__ import annotations

from thermacq.devices import Adopting, Device
from thermacq.errors import DeviceFault
from thermacq.rig.model import ReconnectTable


def check_policy(device: Device, name: str, driver: str, table: ReconnectTable) -> None:
    """Refuse a policy that the driver of a device cannot follow.

    Raises
    ------
    DeviceFault
        Policy ``device_wins`` needs a driver with the verb `adopt`.
    """
    if table.policy == "device_wins" and not isinstance(device, Adopting):
        raise DeviceFault(
            name,
            "open",
            f"driver '{driver}' cannot ask the device for its settings, as policy 'device_wins' needs",
            remedy="Choose 'host_wins' or 'fail' in [reconnect], or in this device's own table.",
        )

"""Emulated devices: device logic without transport, and the far ends through which drivers meet it.

An emulator plays a device behind the driver's own library: a pseudo-terminal under pyserial (`pty`), a
backend of pyusb (`usb`), a source of pictures at the boundary of OpenCV (`video`). How the parts fit and how
to write one stands in ``docs/explanation/emulation.md``. Nothing is imported here: listing plugins is quick.
"""

"""Devices behind the interface of `thermacq.devices`: one module per device, and the simulated flume."""

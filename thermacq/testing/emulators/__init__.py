"""Emulators of the devices that the built-in drivers drive, one module for each."""

"""Pure numerics of calibration: arrays in, frozen records out. Imports nothing of the framework."""

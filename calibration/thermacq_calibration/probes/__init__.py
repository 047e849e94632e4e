"""Static calibration of wave probes: immersion steps, a straight line, and its record."""

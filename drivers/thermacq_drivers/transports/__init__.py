"""What drivers share: reading framed bytes from a serial port and finding and asking USB devices."""

"""What is not a device: matchers and exporters."""

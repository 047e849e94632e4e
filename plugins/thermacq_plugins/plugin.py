"""Entry point of the built-in matchers and exporters; imports nothing heavy."""

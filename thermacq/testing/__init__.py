"""The conformance kit: checks that any driver author can run on a driver.

From the command line, as ordinary pytest::

    pytest --pyargs thermacq.testing.conformance --driver NAME [--driver-settings FILE.toml]

From tests of one's own, through `thermacq.testing.kit`. Nothing is imported here, because pytest loads the
options in `thermacq.testing.pytest_plugin` wherever thermacq is installed.
"""

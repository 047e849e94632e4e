"""What may be imported when: the command line must answer before heavy libraries are read."""

from __future__ import annotations

import subprocess
import sys

import pytest

HEAVY = ("cv2", "h5py", "hdf5plugin", "matplotlib", "numpy", "scipy", "torch", "xarray", "zmq")

RUN = """
import sys
sys.argv = ["thermacq", *{arguments!r}]
from thermacq.cli import main
try:
    main()
except SystemExit as end:
    assert end.code in (0, None), end.code
print("HEAVY", *(name for name in {heavy!r} if name in sys.modules))
"""


def heavy_after(*arguments: str) -> list[str]:
    """Heavy libraries that running a command in a fresh interpreter brought in."""
    code = RUN.format(arguments=arguments, heavy=HEAVY)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    return done.stdout.rpartition("HEAVY")[2].split()


@pytest.mark.parametrize("arguments", [["--help"], ["rig", "--help"], ["rig", "schema", "--help"]])
def test_help_imports_nothing_heavy(arguments):
    assert heavy_after(*arguments) == []


def test_the_check_itself_sees_heavy_imports():
    assert "numpy" in heavy_after("devices")


def test_drivers_are_listed_without_device_libraries():
    assert not {"cv2", "h5py", "matplotlib", "scipy", "torch", "xarray"} & set(heavy_after("devices"))

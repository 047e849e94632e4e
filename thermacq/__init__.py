"""thermacq measures water waves with two thermal cameras.

The way of a frame: driver -> device process -> ring -> writer -> run file -> rectification ->
matching -> triangulation -> still-water frame -> elevation grid -> comparison -> report.
Each package of this framework is one of those stages; `docs/explanation/architecture.md` draws the map.
"""

from importlib.metadata import version

__version__ = version("thermacq")

__all__ = ["__version__"]

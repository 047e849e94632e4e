"""The command line. Data goes to stdout, progress and messages to stderr.

Exit status: 0 done; 1 it failed and said why; 2 wrong usage; 3 a check found something wrong;
130 interrupted.
"""

from thermacq.cli.app import main

__all__ = ["main"]

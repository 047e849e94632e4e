"""``python -m thermacq`` is the ``thermacq`` command."""

from thermacq.cli import main

main()

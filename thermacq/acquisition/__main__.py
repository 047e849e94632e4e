"""``python -m thermacq.acquisition FOLDER``: be the recorder of the job in that folder."""

from __future__ import annotations

import signal
import sys
import traceback
from pathlib import Path
from typing import Any

from thermacq.acquisition.control import JOB, RESULT, Desk, hold_lock, read_json, write_json
from thermacq.acquisition.job import Job, error_to_dict
from thermacq.acquisition.recorder import Recorder
from thermacq.errors import AcquisitionError, ThermacqError


def main(folder: Path) -> None:
    """Make the recording and leave its result, or the error, in the folder."""
    lock = hold_lock(folder)
    desk = Desk(folder)
    try:
        write_json(folder / RESULT, _record(folder, desk))
    finally:
        desk.close()
    # The lock is held to here, and let go by the end of the process.
    del lock


def _record(folder: Path, desk: Desk) -> dict[str, Any]:
    try:
        recorder = Recorder(Job.from_dict(read_json(folder / JOB)), folder, desk)

        def stop(*_: object) -> None:
            recorder.stop_wanted = True

        signal.signal(signal.SIGTERM, stop)
        signal.signal(signal.SIGINT, stop)
        return {"error": None, **recorder.run().to_dict()}
    except ThermacqError as error:
        return {"error": error_to_dict(error)}
    # The client is another process: it must hear of a bug, too.
    except Exception as error:
        traceback.print_exc()
        what = f"the recorder failed: {type(error).__name__}: {error}"
        return {"error": error_to_dict(AcquisitionError(what, remedy="This is a bug; please report it."))}


if __name__ == "__main__":
    main(Path(sys.argv[1]))

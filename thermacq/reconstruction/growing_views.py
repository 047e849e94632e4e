"""Views of a board in a run that is still being written, for guidance while calibrating."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from thermacq.errors import ReconstructionError, StoreError
from thermacq.imaging.corrections import corrections_of
from thermacq.reconstruction.pairs import RunPairs, run_pairs
from thermacq.reconstruction.views import mean_picture, middle_of
from thermacq.store import RunFile, open_run
from thermacq_calibration import FRAMES_TO_AVERAGE, Board, View, detect_board
from thermacq_calibration.targets.poses import changes, still_stretches


class GrowingViews:
    """Looks at each pose once: when the board has moved on, or as soon as there are frames enough.

    Parameters
    ----------
    path
        The run file; it need not exist yet.
    board
        Which board to look for.
    pair
        Which pair of cameras; see `camera_sides`.
    """

    def __init__(self, path: Path, board: Board, pair: str | None = None) -> None:
        self.views: list[View] = []
        self.image_size = (0, 0)
        self.trouble = ""
        self._path, self._board, self._pair = path, board, pair
        self._changes = np.empty(0)
        self._noise = 0.0
        self._last: NDArray[Any] | None = None
        self._pairs_seen = 0
        self._looked_until = -1

    def look(self) -> bool:
        """Read what was written since, and look for the board in at most one new pose.

        Returns
        -------
        bool
            Whether there was a new pose.
        """
        try:
            with open_run(self._path) as run:
                pairs = run_pairs(run, self._pair)
                self._read(run, pairs)
                return self._look_at_next(run, pairs)
        except (StoreError, ReconstructionError) as error:
            # Most often nothing is written yet.
            self.trouble = error.what
            return False

    def _read(self, run: RunFile, pairs: RunPairs) -> None:
        stream = run.camera(pairs.left_camera)
        self.image_size = (stream.columns, stream.rows)
        for index in pairs.left[self._pairs_seen :]:
            picture = run.counts(pairs.left_camera, int(index))
            if self._last is None:
                _, self._noise = changes([picture])
            else:
                change, _ = changes([self._last, picture])
                self._changes = np.append(self._changes, change)
            self._last = picture
            self._pairs_seen += 1

    def _look_at_next(self, run: RunFile, pairs: RunPairs) -> bool:
        for stretch in still_stretches(self._changes, self._noise):
            moved_on = stretch[-1] < self._pairs_seen - 1
            if stretch[0] > self._looked_until and (moved_on or len(stretch) >= FRAMES_TO_AVERAGE):
                self._looked_until = stretch[-1] if moved_on else stretch[0]
                frames = middle_of(stretch)
                corrections = corrections_of(run, stages=())
                sides = [
                    detect_board(
                        mean_picture(run, camera, indices[frames], corrections),
                        self._board,
                    )
                    for camera, indices in (
                        (pairs.left_camera, pairs.left),
                        (pairs.right_camera, pairs.right),
                    )
                ]
                self.views.append(View(f"{stretch[0]}-{stretch[-1]}", *sides))
                return True
        return False

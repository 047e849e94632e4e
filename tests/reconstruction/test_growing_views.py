"""Views of a run while it is being written."""

from __future__ import annotations

import numpy as np
import pytest

from thermacq.reconstruction.growing_views import GrowingViews
from thermacq.store import CameraStream, FrameRow, RunHeader, RunWriter


@pytest.fixture
def growing_run(tmp_path, small_pair):
    """A writer of poses, each held for some frames, and the views of what it has written."""
    path = tmp_path / "board.h5"
    columns, rows = small_pair.truth.image_size
    rig = {"cameras": {name: {"driver": "x"} for name in ("left", "right")}}
    header = RunHeader("1", "board", "2026-01-01T00:00:00+00:00", 0, 0, "virtual", True, rig)
    views = GrowingViews(path, small_pair.board)
    assert not views.look()
    writer = RunWriter.create(path, header, [CameraStream(name, rows, columns) for name in ("left", "right")])
    random = np.random.default_rng(2)
    poses = iter(small_pair.poses(5, seed=1))
    count = 0

    def hold(frames, pose=None):
        nonlocal count
        pose = pose or next(poses)
        for _ in range(frames):
            for name, clean in zip(("left", "right"), small_pair.pictures(pose, noise=0.0), strict=True):
                counts = np.rint(clean + random.normal(0, 6, clean.shape)).astype(np.uint16)
                writer.append_frame(name, counts, FrameRow(count, -1, count * 10**7, count, count * 10**7))
            count += 1
        writer.flush()
        return pose

    yield hold, views
    writer.finish({}, "done")


def test_a_pose_is_looked_at_once_when_it_is_over(growing_run, small_pair):
    hold, views = growing_run
    hold(6)
    assert not views.look()
    hold(6)
    assert views.look()
    assert not views.look()
    assert [view.name for view in views.views] == ["0-5"]
    assert views.views[0].problem == ""
    assert views.image_size == small_pair.truth.image_size


def test_a_pose_held_long_is_looked_at_while_it_is_held(growing_run):
    hold, views = growing_run
    pose = hold(18)
    assert views.look()
    hold(8, pose)
    assert not views.look()
    hold(5)
    assert not views.look()
    hold(5)
    assert views.look()
    assert [view.name for view in views.views] == ["0-17", "26-30"]

from __future__ import annotations

import numpy as np
import pytest

from thermacq.plugins import plugins
from thermacq_plugins.destriping import Destriping, DestripingSettings, guided_filter

ROWS, COLUMNS = 128, 160


def pictures(count, *, moves_px, stripes, seed=0, noise=3.5):
    """A smooth texture of 30 counts that moves to the right, with columns of its own on top."""
    random = np.random.default_rng(seed)
    wide = COLUMNS + int(abs(moves_px) * count) + 1
    x, y = np.arange(wide), np.arange(ROWS)[:, None]
    waves = random.uniform(0.1, 0.8, (12, 2))
    texture = sum(np.sin(k * x + m * y + 6 * random.random()) for k, m in waves) * 30 / 6**0.5
    for index in range(count):
        start = round(moves_px * index)
        shown = (
            texture[:, start : start + COLUMNS] + stripes + noise * random.standard_normal((ROWS, COLUMNS))
        )
        yield shown.astype(np.float32), texture[:, start : start + COLUMNS]


def left_of(stripes, count=17, **settings):
    """Column pattern of the last picture after the stage, less that of the scene: what is left of the stripes."""
    stage = Destriping(DestripingSettings(**settings))
    left = [stage(picture.copy()) - scene for picture, scene in pictures(count, moves_px=3, stripes=stripes)]
    return left[-1].mean(axis=0)


def test_it_is_found_by_name_and_off_unless_named():
    stage = plugins().correction_stage("destriping")
    settings = stage.settings()()
    assert stage.memory(settings) == settings.memory_pictures
    picture = np.full((8, 8), 5.0, np.float32)
    assert np.allclose(stage.make(settings)(picture), 5.0)


def test_stripes_are_reduced_while_the_scene_moves():
    stripes = np.random.default_rng(1).normal(0, 2, COLUMNS)
    inside = slice(8, -8)
    narrow = stripes - guided_filter(stripes, 6, 1e12)
    left = left_of(stripes)
    narrow_left = left - guided_filter(left, 6, 1e12)
    assert narrow_left[inside].std() < 0.5 * narrow[inside].std()


def test_while_nothing_moves_nothing_is_taken_away():
    stripes = np.random.default_rng(1).normal(0, 2, COLUMNS)
    stage = Destriping(DestripingSettings())
    for picture, _ in pictures(17, moves_px=0, stripes=stripes):
        assert np.array_equal(stage(picture.copy()), picture)


def test_without_gate_and_memory_the_scene_itself_is_taken_for_stripes():
    """Why the gate is there: columns of the scene that stand still look like stripes."""
    columns = 2 * np.sin(0.9 * np.arange(COLUMNS))
    picture = (100 + columns + np.zeros((ROWS, 1))).astype(np.float32)
    eager = Destriping(DestripingSettings(memory_pictures=0, min_motion=0.0))
    assert eager(picture.copy()).mean(axis=0)[8:-8].std() < 0.5 * columns.std()


def test_rows_are_columns_of_the_other_direction():
    stripes = np.random.default_rng(2).normal(0, 2, COLUMNS)
    one = Destriping(DestripingSettings(memory_pictures=4))
    other = Destriping(DestripingSettings(memory_pictures=4, direction="rows"))
    for picture, _ in pictures(6, moves_px=4, stripes=stripes):
        assert np.allclose(one(picture.copy()), other(picture.T.copy()).T, atol=1e-3)


def test_the_filter_keeps_a_line_and_a_step_and_smooths_the_small():
    length = 100
    line = np.linspace(0, 100, length)
    inside = slice(15, -15)
    assert np.allclose(guided_filter(line, 6, 9.0)[inside], line[inside], atol=1e-6)
    step = np.where(np.arange(length) < 50, 0.0, 100.0)
    assert np.abs(guided_filter(step, 6, 9.0) - step).max() < 0.5
    small = 0.3 * np.random.default_rng(4).standard_normal(length)
    assert guided_filter(small, 6, 9.0)[inside].std() < 0.5 * small[inside].std()


@pytest.mark.parametrize(
    "wrong", [{"radius_px": 0}, {"direction": "up"}, {"strength_counts": -1}, {"reach": 3}]
)
def test_impossible_settings_are_refused(wrong):
    with pytest.raises(ValueError, match=next(iter(wrong))):
        DestripingSettings(**wrong)

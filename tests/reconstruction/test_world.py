from __future__ import annotations

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from thermacq.errors import ReconstructionError
from thermacq.reconstruction import WorldFrame, load_world_frame, world_frame
from thermacq.reconstruction.plane import Plane
from thermacq.rig import WorldTable


def frame_on(normal, distance=0.6, rotation_left=None, **table):
    return world_frame(
        Plane(np.asarray(normal, float), distance, 0.0003, 1000),
        WorldTable(**table),
        rotation_left=np.eye(3) if rotation_left is None else rotation_left,
        points=np.full((4, 4, 3), np.nan),
        sigma_m=0.0004,
        frames=7,
        source={"from": "still water"},
    )


unit = st.tuples(st.floats(-1, 1), st.floats(-1, 1), st.floats(0.3, 1)).map(
    lambda v: -np.array(v) / np.linalg.norm(v)
)


@settings(deadline=None)
@given(
    normal=unit,
    turn=st.floats(-360, 360),
    axis=st.sampled_from(["right", "left", "up", "down"]),
    foot=st.tuples(st.floats(-9, 9), st.floats(-9, 9)),
)
def test_every_world_frame_is_right_handed_with_z_up_and_the_camera_at_its_place(normal, turn, axis, foot):
    try:
        frame = frame_on(
            normal, x_axis=axis, x_axis_rotation_deg=turn, left_camera_x_m=foot[0], left_camera_y_m=foot[1]
        )
    except ReconstructionError:
        direction = {"right": [1, 0, 0], "left": [-1, 0, 0], "up": [0, -1, 0], "down": [0, 1, 0]}[axis]
        assert abs(normal @ np.array(direction, float)) > 0.99
        return
    np.testing.assert_allclose(frame.rotation @ frame.rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(frame.rotation) > 0
    np.testing.assert_allclose(frame.rotation @ normal, [0, 0, 1], atol=1e-12)
    np.testing.assert_allclose(frame.to_world(np.zeros(3)), [*foot, 0.6], atol=1e-12)
    on_water = -0.6 * normal
    np.testing.assert_allclose(frame.to_world(on_water), [*foot, 0.0], atol=1e-12)


def test_x_is_where_the_picture_points_up_to():
    tilt = np.radians(22.8)
    up = np.array([0.0, -np.sin(tilt), -np.cos(tilt)])
    frame = frame_on(up)
    np.testing.assert_allclose(frame.rotation[0], [0.0, -np.cos(tilt), np.sin(tilt)], atol=1e-12)
    np.testing.assert_allclose(frame.rotation[1], [-1.0, 0.0, 0.0], atol=1e-12)
    assert frame.tilt_deg == pytest.approx(22.8)


def test_x_turns_counter_clockwise_seen_from_above():
    plain, turned = frame_on([0, 0, -1.0]), frame_on([0, 0, -1.0], x_axis_rotation_deg=90)
    np.testing.assert_allclose(turned.rotation[0], plain.rotation[1], atol=1e-12)


def test_directions_are_those_of_the_picture_as_recorded():
    """A left camera rolled by 10 degrees: its rectified picture is level again, X follows the camera."""
    roll = np.radians(10)
    rotation = np.array([[np.cos(roll), -np.sin(roll), 0], [np.sin(roll), np.cos(roll), 0], [0, 0, 1]])
    frame = frame_on([0, 0, -1.0], rotation_left=rotation, x_axis="right")
    np.testing.assert_allclose(frame.rotation[0], [np.cos(roll), np.sin(roll), 0], atol=1e-12)


def test_a_direction_that_points_at_the_water_is_refused():
    with pytest.raises(ReconstructionError, match="straight at the water"):
        frame_on([0.0, 1.0, 0.0], x_axis="up")


def test_a_saved_frame_comes_back(tmp_path):
    frame = frame_on([0.1, -0.2, -np.sqrt(0.95)], left_camera_x_m=1.5)
    frame.save(tmp_path / "world.json")
    back = load_world_frame(tmp_path / "world.json")
    np.testing.assert_array_equal(back.rotation, frame.rotation)
    np.testing.assert_array_equal(back.translation_m, frame.translation_m)
    assert (back.sigma_m, back.points, back.frames, back.source) == (0.0004, 1000, 7, {"from": "still water"})
    with pytest.raises(ReconstructionError, match="exists"):
        frame.save(tmp_path / "world.json")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "cannot be read as a world frame"),
        ("[1, 2]", "holds a list"),
        ("{}", "no world frame"),
        ('{"kind": "thermacq world frame"}', "no world frame"),
        ("\x00\xff", "cannot be read"),
    ],
)
def test_foreign_files_are_refused(tmp_path, text, message):
    path = tmp_path / "world.json"
    path.write_text(text, encoding="latin-1")
    with pytest.raises(ReconstructionError, match=message):
        load_world_frame(path)


def test_a_missing_file_and_an_altered_rotation_are_refused(tmp_path):
    with pytest.raises(ReconstructionError, match="there is no file"):
        load_world_frame(tmp_path / "none.json")
    values = frame_on([0, 0, -1.0]).to_dict()
    values["rotation"][0][0] = 2.0
    (tmp_path / "world.json").write_text(json.dumps(values))
    with pytest.raises(ReconstructionError, match="not a rotation"):
        load_world_frame(tmp_path / "world.json")
    assert WorldFrame.from_dict(frame_on([0, 0, -1.0]).to_dict()).camera_height_m == 0.6

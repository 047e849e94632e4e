from __future__ import annotations

import cv2
import numpy as np

from thermacq_drivers.simflume.camera import CameraSettings
from thermacq_drivers.simflume.camera_truth import corners_seen
from thermacq_drivers.simflume.scene import build_view
from thermacq_drivers.simflume.sensor_settings import BolometerSettings
from thermacq_drivers.simflume.settings import parse_scene


def test_corners_of_a_moving_board_are_those_of_its_picture() -> None:
    scene = parse_scene({"view": "chessboard", "chessboard": {"shake_m": 0.04, "shake_hz": 3.0}})
    camera = CameraSettings(bolometer=BolometerSettings(line_time_s=1e-4))
    seen = build_view(scene, camera, 1e-4).temperature(0.1, 0)
    picture = np.clip((seen - seen.min()) / np.ptp(seen) * 255, 0, 255).astype(np.uint8)
    found, corners = cv2.findChessboardCornersSB(picture, (9, 6), flags=0)
    assert found
    errors = corners.reshape(-1, 2) - corners_seen(scene, camera, 0, 0.1)
    assert np.median(np.linalg.norm(errors, axis=-1)) < 0.1
    together = camera.model_copy(update={"bolometer": BolometerSettings()})
    assert np.abs(corners_seen(scene, together, 0, 0.1) - corners_seen(scene, camera, 0, 0.1)).max() > 1

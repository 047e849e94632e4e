from __future__ import annotations

from thermacq_drivers.simflume.validation_cameras import camera_checks
from thermacq_drivers.simflume.validation_water import failed


def test_cameras_agree_with_settings_and_formulas() -> None:
    checks = camera_checks()
    assert len(checks) == 18
    assert failed(checks) == []

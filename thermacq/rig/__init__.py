"""The rig file: which devices there are, how they are triggered, where they stand, what is stored.

TOML, checked by pydantic; a wrong key is an error that names the line and the nearest right name. The
resolved rig (every default filled in) is stored in each recording. `thermacq.rig.inspection` opens the
devices of a rig and `thermacq.rig.fit` says what does not fit.
"""

from thermacq.rig.load import load_rig, parse_rig, parse_toml, read_toml_text
from thermacq.rig.model import (
    BoardTable,
    CameraTable,
    ClockTable,
    CorrectionTable,
    PairTable,
    ProbeTable,
    ReconnectTable,
    ReconstructionTable,
    Rig,
    StageTable,
    StoreTable,
    TriggerSourceTable,
    TriggerTable,
    WorldTable,
)
from thermacq.settings import explain

__all__ = [
    "BoardTable",
    "CameraTable",
    "ClockTable",
    "CorrectionTable",
    "PairTable",
    "ProbeTable",
    "ReconnectTable",
    "ReconstructionTable",
    "Rig",
    "StageTable",
    "StoreTable",
    "TriggerSourceTable",
    "TriggerTable",
    "WorldTable",
    "explain",
    "load_rig",
    "parse_rig",
    "parse_toml",
    "read_toml_text",
]

"""Random numbers that depend on nothing but their name: scene seed, device, purpose and index."""

from __future__ import annotations

import zlib

import numpy as np


def generator(seed: int, *key: str | int) -> np.random.Generator:
    """Random generator for one purpose, the same in every process; `key` holds names and whole numbers."""
    words = [zlib.crc32(part.encode()) if isinstance(part, str) else part for part in key]
    return np.random.Generator(np.random.SFC64(np.random.SeedSequence([seed, *words])))

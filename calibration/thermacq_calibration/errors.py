"""The error of this package: what happened, what was kept, what to do next."""

from __future__ import annotations


class CalibrationError(ValueError):
    """A calibration cannot be made, read or used.

    Parameters
    ----------
    what
        What happened, and to which file, picture or quantity.
    kept
        What was kept in spite of it (empty when nothing was at stake).
    remedy
        What to do next.
    """

    def __init__(self, what: str, *, kept: str = "", remedy: str = "") -> None:
        super().__init__(what, kept, remedy)
        self.what = what
        self.kept = kept
        self.remedy = remedy

    def __str__(self) -> str:
        return "\n".join(part for part in (self.what, self.kept, self.remedy) if part)

    def __reduce__(self) -> tuple[object, ...]:
        """Errors cross process borders, so they must survive pickling."""
        return _rebuild, (type(self), self.what, self.kept, self.remedy)


def _rebuild(kind: type[CalibrationError], what: str, kept: str, remedy: str) -> CalibrationError:
    return kind(what, kept=kept, remedy=remedy)

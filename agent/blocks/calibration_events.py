"""What is known of a rig's disturbances, in words: an event when it is found, taken over or replaced."""

from collections.abc import Sequence

import numpy as np

from agent.text import number
from agent.types import Calibrated, HealthEvent

SOURCE = "calibration"
ALIKE = 0.2
"""Levels that moved by less than this share are not worth an event."""

Names = Sequence[tuple[str, str]]


def adopted(rig: str, t_ns: int, known: Calibrated, outputs: Names, pushed: Names) -> HealthEvent:
    """Return the event that a run begins with what an earlier one knew of outputs and forces (name, unit)."""
    words = f"{_words(known, outputs, pushed)}; found by an earlier run of this configuration"
    return HealthEvent(rig, SOURCE, t_ns, "adopted", words)


def learnt(
    rig: str, t_ns: int, before: Calibrated | None, now: Calibrated, outputs: Names, pushed: Names
) -> HealthEvent | None:
    """Return the event that forces were found or levels replaced; None where they are what they were, or no news."""
    if before is None and not any(now.process):
        return None
    if before is None:
        return HealthEvent(rig, SOURCE, t_ns, "found", _words(now, outputs, pushed))
    if _alike(before.sigma, now.sigma) and _alike(before.process, now.process):
        return None
    words = f"{_words(now, outputs, pushed)}; before: {_words(before, outputs, pushed)}"
    return HealthEvent(rig, SOURCE, t_ns, "replaced", words)


def _alike(before: Sequence[float], now: Sequence[float]) -> bool:
    return len(before) == len(now) and bool(np.allclose(before, now, rtol=ALIKE, atol=0.0))


def _words(known: Calibrated, outputs: Names, pushed: Names) -> str:
    noise = ", ".join(f"{name} {number(sd, 3)} {unit}" for sd, (name, unit) in zip(known.sigma, outputs, strict=False))
    forces = [
        f"{name} {number(sd, 3)} {unit}".strip() for sd, (name, unit) in zip(known.process, pushed, strict=False) if sd
    ]
    return f"noise of the sensors: {noise}; unknown forces: {', '.join(forces) or 'none'}"

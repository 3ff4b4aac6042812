"""What a faulty device puts into its numbers: wrong values, counters that stand still, leap or begin anew."""

from collections.abc import Callable, Sequence

import numpy as np

from sim_bus.arrays import FloatArray, IntArray
from sim_bus.errors import SimUsageError
from sim_bus.rig.fault_names import COUNTERS, NUMBERS
from sim_bus.rig.faults import Strike
from sim_bus.tuning import FAR_VALUE, LEAP_SAMPLES

NumberArray = IntArray | FloatArray
_NOT_FINITE = {"nan": float("nan"), "inf": float("inf")}
Damage = Callable[[NumberArray], NumberArray]


class NumberFaults:
    """The faults of one source's numbers.

    Args:
        strikes: the source's faults; those of lines and replies are passed over.
        tops: for each mapped field in order the largest raw number that it holds; None for a float.
    """

    def __init__(self, strikes: Sequence[Strike], tops: Sequence[tuple[str, int | None]]) -> None:
        self._counters = [strike for strike in strikes if strike.name in COUNTERS]
        self._values = [(strike, *_victim(strike.name, tops)) for strike in strikes if strike.name in NUMBERS]

    def counted(self, index: IntArray) -> IntArray:
        """Return sample numbers as the device counts them."""
        for strike in self._counters:
            index = self._miscounted(strike, index)
        return index

    def _miscounted(self, strike: Strike, index: IntArray) -> IntArray:
        if strike.name == "stuck-counter":
            return np.where((index >= strike.first) & (index < strike.end), strike.first - 1, index)
        if strike.name == "counter-jump":
            return np.where(index >= strike.first, index + LEAP_SAMPLES, index)
        begins = strike.end if strike.name == "restart" else strike.first
        return np.where(index >= begins, index - begins, index)

    def spoil(self, index: IntArray, raw: dict[str, NumberArray]) -> None:
        """Put wrong values into raw numbers."""
        for strike, field, damage in self._values:
            struck = (index >= strike.first) & (index < strike.end)
            if struck.any():
                raw[field] = np.where(struck, damage(raw[field]), raw[field])


def _victim(name: str, tops: Sequence[tuple[str, int | None]]) -> tuple[str, Damage]:
    """Return the field that a fault strikes, and what becomes of its numbers."""
    if name in _NOT_FINITE:
        field = next((field for field, top in tops if top is None), None)
        if field is None:
            raise SimUsageError(f"--fault: {name}: no mapped field is a float; integers hold numbers only")
        return field, lambda numbers: np.full_like(numbers, _NOT_FINITE[name])
    field, top = tops[-1]
    if name == "swapped":
        return field, lambda numbers: _swapped(numbers, top)
    return field, lambda numbers: np.full_like(numbers, FAR_VALUE if top is None else top)


def _swapped(numbers: NumberArray, top: int | None) -> NumberArray:
    """Return numbers with their bytes the other way round; a field of one byte has nothing to swap."""
    if top is None:
        return numbers.astype(np.float32).byteswap().astype(np.float64)
    size = 1 << max(0, (top.bit_length() + 7) // 8 - 1).bit_length()
    swapped = numbers.astype(f"i{size}").byteswap().astype(np.int64)
    return np.clip(swapped, -top - 1, top)

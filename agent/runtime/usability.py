"""Why a recording is of no use, or of little, in words that say what to do about it."""

import re
from collections import Counter
from collections.abc import Iterable, Iterator, Sequence

import numpy as np

from agent.config import RigConfig
from agent.errors import Fault, RecordingError
from agent.records import Record
from agent.runtime.tuning import LITTLE, MOST_REFUSED, NEAR, WATCHED
from agent.types import EstimateBatch, IntArray, Status
from drivers.port import Counts, SampleBlock

UNITS = {1e3: "milliseconds", 1e6: "microseconds", 1e9: "nanoseconds"}
LATEST_S = 9.2e9
"""Fixed by 64 bits of nanoseconds: seconds that nanoseconds in 64 bits can count."""
_CELL = re.compile(r'"([^"]*)" is no number')
_UNUSABLE = re.compile(r"(.*?): (none of its \d+ frames fits: .*)")
_DAMAGED = re.compile(r"(.*?): (is damaged, its end is not read): .*")
_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?")


class Evidence:
    """What is seen of a recording while it is read.

    Attributes:
        notes: what its driver remarked.
        estimates: whether some window was whole.
    """

    def __init__(self, rate_hz: float) -> None:
        self.notes: list[str] = []
        self.estimates = False
        self._rate_hz = rate_hz
        self._steps: list[IntArray] = []
        self._rows = 0
        self._last: IntArray = np.zeros(0, dtype=np.int64)

    def see(self, records: Iterable[Record]) -> None:
        """Note what the recording leads to."""
        batches = (record for record in records if isinstance(record, EstimateBatch))
        self.estimates = self.estimates or any(
            bool((batch.status != Status.WARMING).any()) for batch in batches
        )

    def watch(self, block: SampleBlock) -> None:
        """Note the time stamps of a block, as they stand in the recording."""
        if block.t_ns is None or not len(block) or block.counter is not None or self._rows >= WATCHED:
            return
        self._steps.append(np.diff(np.concatenate([self._last, block.t_ns])))
        self._last, self._rows = block.t_ns[-1:], self._rows + len(block)

    def faults(self, name: str, received: int, rejected: Counter[str]) -> list[Fault]:
        """Return what is wrong with a recording as a whole, of whose rows some were refused, by reason."""
        unread = rejected["time"] + rejected["missing value"] > MOST_REFUSED * received
        found = list(_texts(self.notes)) if unread else []
        if rejected["backwards"] > MOST_REFUSED * received:
            found.append(
                ("its times run backwards from row to row", "sort the rows by time, the oldest first")
            )
        elif not unread:
            found += self._pace()
        return [Fault(name, what, advice) for what, advice in found]

    def unusable(self) -> list[Fault]:
        """Return the CAN logs that hold nothing of what is looked for."""
        advice = "see that the log is of this bus, and what the DBC file, source_address and j1939 ask for"
        return [Fault(match[1], match[2], advice) for match in map(_UNUSABLE.fullmatch, self.notes) if match]

    def damaged(self) -> list[Fault]:
        """Return the CAN logs that could be read up to some place only."""
        found = [_DAMAGED.fullmatch(note) for note in self.notes]
        return [Fault(match[1], match[2], "what stands before that is used") for match in found if match]

    def _pace(self) -> Iterator[tuple[str, str]]:
        steps = np.concatenate(self._steps) if self._steps else np.zeros(0, dtype=np.int64)
        steps = steps[steps > 0]
        if not len(steps):
            return
        step_s = float(np.median(steps)) / 1e9
        ratio = step_s * self._rate_hz
        if 1 / NEAR < ratio < NEAR:
            return
        what = f"its rows are {step_s:.6g} s apart by their t, the rig's samples {1 / self._rate_hz:.6g} s"
        for factor, unit in UNITS.items():
            if 1 / NEAR < ratio / factor < NEAR:
                yield what, f"t seems to be in {unit}: it must be in seconds"
                return
        yield what, f"set rig.sample_rate_hz = {1 / step_s:.6g}, or give a recording at {self._rate_hz:g} Hz"


def _texts(notes: Sequence[str]) -> Iterator[tuple[str, str]]:
    """Say why most cells could not be read, by the first that could not."""
    text = next((match[1].strip() for match in map(_CELL.search, notes) if match), None)
    if text is None:
        return
    if _COMMA.fullmatch(text):
        yield (
            f'its numbers have decimal commas ("{text}")',
            "export it with points; where semicolons or tabs divide columns: sed 's/,/./g' OLD.csv > NEW.csv",
        )
        return
    try:
        late = abs(float(text)) > LATEST_S
    except ValueError:
        late = False
    if late:
        yield f'its times are no seconds ("{text}")', "t is in seconds since 1970, or since any start"
    else:
        yield f'most of its rows cannot be read: "{text}" is no number', "see that columns and delimiter fit"


def assess(
    config: RigConfig, name: str, evidence: Evidence, counts: Counts, refused: Counter[str]
) -> list[Fault]:
    """Return what to tell the user of a recording read; raise RecordingError where nothing of it is of use.

    counts: of its drivers. refused: samples that acquisition refused, by reason.
    """
    rejected = counts.rejected + refused
    faults = [] if config.rig.clock == "uniform" else evidence.faults(name, counts.received, rejected)
    if not counts.received:
        raise RecordingError(_why_empty(name, evidence))
    is_almost_all_refused = counts.received - rejected.total() <= LITTLE * counts.received
    if is_almost_all_refused and not faults:
        faults = [Fault(name, _counted(counts.received, rejected), "see what it holds")]
    is_of_no_use = is_almost_all_refused or not evidence.estimates
    if faults and is_of_no_use:
        raise RecordingError(faults)
    return [*faults, *evidence.unusable(), *evidence.damaged()]


def _why_empty(name: str, evidence: Evidence) -> list[Fault]:
    return evidence.unusable() or [Fault(name, "holds no sample", "see what it holds")]


def _counted(received: int, rejected: Counter[str]) -> str:
    words = ", ".join(f"{reason} {count}" for reason, count in rejected.most_common() if count)
    return f"nothing of it can be used: {received} samples, rejected {words}"

"""The bank at its operating point over a record: moved, run again, fed."""

import numpy as np

from agent.numerics.estimator.operating_point import OperatingPoint, operating_point, taps_of
from agent.numerics.estimator.record import Record
from agent.numerics.estimator.settings import EstimatorSettings
from agent.numerics.estimator.tuning import DULLED, UNITS_GROWTH, UNITS_LEAST, UNITS_MOST, UNITS_WAIT
from agent.numerics.inference.posterior import Knowledge, Posterior
from agent.numerics.inference.spectral.sources import Source
from agent.numerics.model.riccati import NoSteadyStateError
from agent.numerics.window.lost import Lost
from agent.numerics.window.rows import BankRows
from agent.numerics.window.stream import Stream


class Bank:
    """Rows of a record's windows from the stream of `agent.numerics.window`, one operating point at a time.

    Args:
        settings: what is modelled, hops and windows.
        sources: of noise, as the learner numbers them.
    """

    def __init__(self, settings: EstimatorSettings, sources: tuple[Source, ...]) -> None:
        self.point: OperatingPoint | None = None
        self._settings, self._sources = settings, sources
        self._stream: Stream | None = None
        self._units = UNITS_LEAST
        self._fed = 0
        self._lost_fed = 0
        self._sharpest = np.full(settings.rig.q, np.inf)

    @property
    def is_running(self) -> bool:
        """Whether there is a stream that rows come from."""
        return self._stream is not None

    def stop(self) -> None:
        """Let go of the stream: its segment ended."""
        self._stream = None

    def move(self, record: Record, known: Knowledge, posterior: Posterior, newest: int) -> None:
        """Work from now on at what is known; rows from sample `newest` on are computed again.

        Where no predictor is steady there, the bank stays where it was.
        """
        before, self.point = self.point, self._placed(known, posterior)
        try:
            self._start(record, newest)
        except NoSteadyStateError:
            if before is None:
                raise
            self.point = before
            self._start(record, newest)

    def _placed(self, known: Knowledge, posterior: Posterior) -> OperatingPoint:
        self._sharpest = np.minimum(DULLED * self._sharpest, posterior.sd_repeat)
        window = self._settings.plan.window
        rig, sources = self._settings.rig, self._sources
        return operating_point(rig, known, posterior, sources, window, self._sharpest)

    def _start(self, record: Record, newest: int) -> None:
        """Run a new stream at the point, over the windows that end with sample `newest` and after it."""
        point, plan, rig = self.point, self._settings.plan, self._settings.rig
        assert point is not None  # noqa: S101 - placed before
        longer = [(samples - plan.head) // plan.hop for samples in self._settings.longer]
        taps = taps_of(rig, self._settings.outputs, point.inputs, point.slopes)
        self._stream = Stream(point.model, point.push, point.noise, plan, longer, rig.q, taps)
        self.run_again(record, newest)

    def run_again(self, record: Record, newest: int) -> None:
        """Run over the record as it is now; rows from sample `newest` on are computed again."""
        assert self._stream is not None  # noqa: S101 - only called with a stream
        hop = self._settings.plan.hop
        oldest = -(-record.first // hop) * hop
        first = max(oldest, newest + 1 - max(self._settings.windows))
        self._stream.start_segment(first, given=newest - 1)
        self._fed = self._lost_fed = first
        self._units = UNITS_LEAST

    def next(self, record: Record, due: int) -> BankRows | None:
        """Feed some hops and return the rows they end; None where no sample waits.

        due: sample whose row is learnt from next, which may move the point: many hops behind it wait.
        """
        if self._stream is None:
            return None
        while (batch := self._stream.next()) is None:
            if not self._feed(self._stream, record, due):
                return None
            self._units = min(UNITS_GROWTH * self._units, UNITS_MOST)
        return batch

    def _feed(self, stream: Stream, record: Record, due: int) -> bool:
        """Give the stream some hops of samples; return whether any waited."""
        plan, point = self._settings.plan, self.point
        assert point is not None  # noqa: S101 - where there is a stream there is a point
        stop = min(record.stop, self._fed + self._units * plan.hop + plan.window)
        if self._fed <= due < stop - UNITS_WAIT * plan.hop:
            stop = -(-(due + 1) // plan.hop) * plan.hop
        if stop <= self._fed:
            return False
        samples = record.samples_with_slopes if point.slopes else record.samples
        # further readings for a polynomial hold stand behind the measured inputs: nothing is left out then
        straight = point.inputs < len(self._settings.rig.measured)
        fed = samples(self._fed, stop, point.inputs if straight else None)
        stream.append(self._fed, fed, self._lost_until(record, stop))
        self._fed = stop
        return True

    def _lost_until(self, record: Record, stop: int) -> Lost:
        """Return the lost readings of the heads and the rests of hops that are whole by sample `stop`."""
        plan = self._settings.plan
        lost = Lost.none()
        if not record.loses(self._lost_fed, stop):
            into = stop % plan.hop
            self._lost_fed = max(self._lost_fed, stop - into + (plan.head if into >= plan.head else 0))
            return lost
        while True:
            into = self._lost_fed % plan.hop
            end = self._lost_fed - into + (plan.head if into < plan.head else plan.hop)
            if end > stop:
                return lost
            lost = lost.followed(record.lost_between(self._lost_fed, end, plan.window))
            self._lost_fed = end

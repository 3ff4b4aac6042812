"""Work, counted in samples: what fits and searches cost beside the rows, the same on every machine."""

from dataclasses import dataclass

from agent.numerics.fitting.tuning import EVALUATION


@dataclass(slots=True)
class Work:
    """Work done so far in this process, in samples of normal work; its growth is what was done meanwhile."""

    done: int = 0

    def evaluate(self, samples: int) -> None:
        """Count an evaluation of observer and sensitivities over a window of so many samples."""
        self.done += EVALUATION + samples


WORK = Work()


class Budget:
    """A token bucket: work that may be begun now, counted in samples, so that live and replay stay equal.

    What is begun is finished, and may leave a debt that the samples to come pay first; so what N samples
    spend is at most capital + once + rate N and what was begun last, whatever a rig asks for.

    Args:
        capital: what there is at first, and what may be saved up at most.
        rate: what each sample adds.
        once: what there is at first beyond the capital.
    """

    def __init__(self, capital: float, rate: float, once: float = 0.0) -> None:
        self._capital, self._rate = capital, rate
        self._left = capital + once
        self._index = 0
        self._closed = False

    @property
    def closed(self) -> bool:
        """Whether nothing is allowed any more."""
        return self._closed

    def allows(self, index: int) -> bool:
        """Tell whether work may begin at sample number `index`."""
        if index > self._index:
            saved = min(self._left + self._rate * (index - self._index), self._capital)
            self._left = max(self._left, saved)
            self._index = index
        return self._left > 0 and not self._closed

    def spend(self, work: float) -> None:
        """Take out what was done."""
        self._left -= work

    def close(self) -> None:
        """Allow nothing any more: there is no time for anything but rows."""
        self._closed = True

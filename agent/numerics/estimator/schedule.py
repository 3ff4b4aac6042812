"""When a window is learnt from, when a broken one is retried, and how much may be computed beside the rows.

All is counted in samples and in evaluations of the model on a window, so replay agrees. One evaluation is one
linearisation or one trial of a step; learning the noise counts as two. Solves that converge take three to ten
of them, those that do not up to a hundred and fifty: what is bounded is the work and not the number of tries.
N samples pay for BURST + FIRST + N / `samples_an_evaluation` evaluations, and what was begun last for at most
LONGEST beyond that.
"""

from dataclasses import dataclass

from agent.numerics.estimator import tuning


def eager_windows(window: int, period_s: float) -> int:
    """Return from how many windows in a row, of so many samples, to learn before learning becomes seldom.

    Fewer short ones: each costs the processor the same ten milliseconds.
    """
    least, short, most = tuning.EAGER
    in_time = max(short, int(tuning.EAGER_A_SECOND * window * period_s))
    return max(least, min(tuning.EAGER_SAMPLES // window, in_time, most))


@dataclass(slots=True)
class Schedule:
    """When to learn: from every window at first, then ever more seldom, and poor ones may be passed over.

    Args:
        window: its samples.
        eager: windows learnt from in a row at first.
    """

    window: int
    eager: int
    learnt: int = 0
    due: int = 0
    patience: int = 0
    tried: int = 0
    failed: int = 0

    def done(self, index: int) -> None:
        """Note that the window ending at sample `index` was learnt from."""
        self.learnt, self.tried, self.failed = self.learnt + 1, index, 0
        most = max(tuning.SELDOM, tuning.SELDOM_SAMPLES // self.window)
        stretch = min(tuning.GROWTH ** max(0, self.learnt - self.eager), most)
        self.due = index + self.window * int(stretch)
        self.patience = self.due - index if stretch > 1 else 0

    def later(self, index: int, *, failed: bool = False) -> None:
        """Try again a quarter of a window on; where windows cannot be solved, twice as long after each."""
        self.failed = self.failed + 1 if failed else 0
        self.tried = index
        self.due = index + max(1, self.window // 4) * 2 ** min(max(self.failed - 1, 0), tuning.LATEST)
        self.patience = 0

    def skip(self, index: int) -> None:
        """Learn from no window that reaches back to sample `index`: parameters moved there."""
        self.tried = index
        self.due = max(self.due, index + self.window)

    def follow(self, index: int) -> None:
        """Learn soon: something changed."""
        self.learnt = min(self.learnt, max(self.eager - tuning.FOLLOWED, 0))
        self.due = index + self.window
        self.patience = 0

    @property
    def overdue(self) -> int:
        """The sample from which a window is learnt from even if it tells little: it is one of very few."""
        return self.due + self.patience


@dataclass(slots=True)
class Disturbance:
    """A stretch of broken rows: since which sample, None outside one; `again`: the sample of the next try.

    switches: samples after the onset from which on it is asked whether constants switched.
    """

    onset: int | None = None
    again: int = -(1 << 60)
    switches: int = 0
    ended: int = -(1 << 60)
    changed: int = -(1 << 60)

    def at(self, index: int) -> None:
        """Note a broken row."""
        if self.onset is None:
            self.onset, self.switches = index, 0

    def may_switch(self, index: int, window: int) -> bool:
        """Return whether it is time to ask whether constants switched: each time after as long again.

        So a stretch of any length costs few of such tries, which take more than others.
        """
        lasts = 0 if self.onset is None else index - self.onset
        if lasts < max(window, self.switches):
            return False
        self.switches = 2 * lasts
        return True

    def changes_again(self, index: int, window: int) -> bool:
        """Note that parameters changed; return whether they do soon after another change."""
        before, self.changed = self.changed, index
        return index - before < tuning.AGAIN * window

    def tried(self, index: int, window: int) -> None:
        """Note a try at sample `index`."""
        self.again = index + max(1, window // tuning.TRIES)

    def missed(self, index: int, window: int, share: float, *, converged: bool) -> None:
        """Note a try that explained nothing and took a share of what there was to spend.

        Windows that do not converge hold too much of a change, as all do until a window after its onset. What
        lasts longer is tried again after as large a share of the time that it has lasted, several times: so
        something is left when it is over at last.
        """
        onset = index if self.onset is None else self.onset
        lasts = index - onset
        if lasts >= window:
            self.wait(index + int(tuning.PATIENCE * share * lasts))
        elif not converged:
            self.wait(onset + int(tuning.WHOLE * window))

    def wait(self, until: int) -> None:
        """Let sample `until` pass before the next try."""
        self.again = max(self.again, until)

    def since(self, index: int) -> bool:
        """Whether rows after sample `index` were broken."""
        return self.onset is not None or self.ended > index

    def over(self, index: int) -> None:
        """Note a row that holds."""
        if self.onset is not None:
            self.onset, self.ended = None, index


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
    def left(self) -> float:
        """What there is to spend, less than 0 while it is owed."""
        return self._left

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


def samples_an_evaluation(window: int, period_s: float) -> float:
    """Return the samples, period_s apart, that pay for one evaluation of a window of so many samples."""
    return max(
        window / tuning.EVALUATIONS_A_WINDOW,
        min(tuning.SAMPLES_AN_EVALUATION, tuning.SECONDS_AN_EVALUATION / period_s),
    )


def budget_of(window: int, period_s: float) -> Budget:
    """Return the budget of an estimator whose windows have so many samples, period_s apart."""
    each = samples_an_evaluation(window, period_s)
    return Budget(tuning.BURST * each, 1.0, once=tuning.FIRST * each)

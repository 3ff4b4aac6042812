"""Sample ledger of a rig: received = used + rejected by reason + dropped by reason, per source, at any time.

Driver, acquisition, quality and estimation each give their own count; they are added up here and nowhere
else.
"""

from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

from agent.blocks.acquisition.interface import Acquisition, Ends, Through
from agent.blocks.acquisition.source_clocks import SourceClocks
from agent.records import Health
from drivers.port import Counts


@dataclass(slots=True)
class Conservation:
    """Where the samples of one source went before the pipeline.

    Attributes:
        driver: what the driver met.
        dropped: lost between driver and pipeline, by reason.
    """

    driver: Counts
    dropped: Counter[str]


@dataclass(slots=True)
class Ledger:
    """The ledger of one rig.

    Args:
        rig: its name.
        acquisition: counts what it refuses and hands on.
        through: counts the rows that acquisition handed on since the numerics began.
        clocks: the clocks of its sources.
    """

    rig: str
    acquisition: Acquisition
    through: Callable[[], Through]
    clocks: SourceClocks
    _lost: dict[str, Counter[str]] = field(default_factory=dict)

    def settle(self, source: str, taken: int, reason: str) -> None:
        """Refuse for a reason those of the samples taken from a source that ended nowhere else."""
        used, rejected = self.ends(source)
        ended = used + rejected.total() + self.acquisition.sources[source].refusals().total()
        self._lost.setdefault(source, Counter())[reason] += max(0, taken - ended)

    def ends(self, source: str, prepared: int = 0) -> Ends:
        """Return counts of a source's samples: used or waiting, and refused after acquisition, by reason.

        prepared: samples that wait for the estimation alone.
        """
        through = self.through()
        through = replace(through, waiting=through.waiting + prepared)
        used, rejected = self.acquisition.ends(source, through)
        return used, rejected + self._lost.get(source, Counter())

    def rejected(self, source: str, driver: Counts) -> Counter[str]:
        """Return a source's samples that were refused by its driver, or after it, by reason."""
        return driver.rejected + self.acquisition.sources[source].refusals() + self.ends(source)[1]

    def health(
        self, conservation: Mapping[str, Conservation], t_ns: int, lag_s: float | None, prepared: int = 0
    ) -> list[Health]:
        """Return the ledger of every source.

        Samples that were taken and not computed yet are in no count but the driver's, but for those prepared:
        they wait.
        """
        return [self._health_of(name, before, t_ns, lag_s, prepared) for name, before in conservation.items()]

    def _health_of(
        self, name: str, before: Conservation, t_ns: int, lag_s: float | None, prepared: int
    ) -> Health:
        driver = before.driver
        state = self.acquisition.sources.get(name)
        if state is None:
            return self._beside(name, before, t_ns)
        used, _ = self.ends(name, prepared)
        return Health(
            rig=self.rig, source=name, t_ns=t_ns, received=driver.received + driver.dropped.total(),
            used=used, rejected=dict(self.rejected(name, driver)),
            dropped=dict(driver.dropped + before.dropped), gaps=state.gaps, lag_s=lag_s,
            faults=dict(driver.faults), clock=self.clocks.report(name, *self.skew(name)),
        )  # fmt: skip

    def _beside(self, name: str, before: Conservation, t_ns: int) -> Health:
        """Return the ledger of a source of covariates only: what is neither refused nor lost is used."""
        driver = before.driver
        dropped = driver.dropped + before.dropped
        received = driver.received + driver.dropped.total()
        used = received - driver.rejected.total() - dropped.total()
        return Health(
            self.rig, name, t_ns, received, max(used, 0), dict(driver.rejected), dict(dropped), 0, None,
            dict(driver.faults),
        )  # fmt: skip

    def skew(self, source: str) -> tuple[float | None, float | None]:
        """Return what is compensated of a source's skew, and its sd, s; None where it is not known."""
        return self.acquisition.skews().get(source, (None, None))

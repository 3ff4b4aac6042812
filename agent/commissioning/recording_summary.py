"""What a recording holds, channel by channel, as far as commissioning wants to know it."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from agent.commissioning.probe import listen
from agent.commissioning.progress import Progress
from agent.commissioning.readings import Gathering, Recorded
from agent.config import RigConfig
from agent.errors import RecordingError
from agent.runtime.replay import SOURCE, opened
from agent.runtime.usability import Evidence, assess
from drivers.port import Driver, DriverError

log = logging.getLogger(__name__)


@dataclass
class Material:
    """What a rig is identified from: recordings, and what its sources deliver in some seconds, heard once."""

    paths: Sequence[Path]
    probe_s: float | None = None
    gathered: Gathering | None = None

    def read(self, config: RigConfig, progress: Progress) -> list[tuple[str, Recorded]]:
        """Return each with its name, the signs of dry friction by the configuration's nominals.

        Raises RecordingError, UsageError, BusError.
        """
        found = []
        for path in self.paths:
            progress(f"reading {path.name}")
            found.append((str(path), read_recording(config, path)))
        return found + ([("--probe", self._probed(config, progress))] if self.probe_s is not None else [])

    def _probed(self, config: RigConfig, progress: Progress) -> Recorded:
        if self.gathered is None:
            self.gathered = listen(config, progress, self.probe_s or 0.0)
        recorded = self.gathered.recorded("the probe", config)
        if recorded is None:
            advice = "deltak listen shows what comes and why it is refused"
            raise RecordingError.at("--probe", "no sample with every channel came", advice)
        return recorded


def read_recording(config: RigConfig, path: Path) -> Recorded:
    """Read a recording as `replay` would. Raises RecordingError where nothing in it can be used."""
    driver = opened(config, path)
    names = {channel.name: channel.name for channel in (*config.inputs, *config.outputs)}
    gathering = Gathering(config, {SOURCE: names})
    evidence = Evidence(config.rig.sample_rate_hz)
    try:
        _read_all(gathering, driver, evidence)
    finally:
        driver.close()
    recorded = gathering.recorded(path.name)
    evidence.notes = driver.take_notes()
    evidence.estimates = recorded is not None
    for fault in assess(
        config, str(path), evidence, driver.counts, gathering.acquisition.sources[SOURCE].refusals()
    ):
        log.warning("%s", fault)
    if recorded is None:
        raise RecordingError.at(
            path, "holds no sample with every channel", "see that channels and columns fit"
        )
    return recorded


def _read_all(gathering: Gathering, driver: Driver, evidence: Evidence) -> None:
    gathering.counts[SOURCE] = driver.counts
    while True:
        try:
            block = driver.read(1.0)
            evidence.watch(block)
            gathering.take(SOURCE, block, driver.counter_modulus)
        except EOFError:
            return gathering.finish()
        except DriverError as error:
            raise RecordingError.of(str(error), "mend or cut the recording") from error

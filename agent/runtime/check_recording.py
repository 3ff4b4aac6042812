"""What a recording holds, channel by channel, as far as commissioning wants to know it."""

from pathlib import Path

from agent.config import RigConfig
from agent.errors import RecordingError
from agent.runtime.readings import Gathering, Recorded
from agent.runtime.replay import SOURCE, opened
from drivers.port import Driver, DriverError


def read_recording(config: RigConfig, path: Path) -> Recorded:
    """Read a recording as `replay` would. Raises RecordingError where nothing in it can be used."""
    driver = opened(config, path)
    names = {channel.name: channel.name for channel in (*config.inputs, *config.outputs)}
    gathering = Gathering(config, {SOURCE: names})
    try:
        _read_all(gathering, driver)
    finally:
        driver.close()
    recorded = gathering.recorded(path.name)
    if recorded is None:
        raise RecordingError.at(str(path), "holds no sample with every channel", "see that channels and columns fit")
    return recorded


def _read_all(gathering: Gathering, driver: Driver) -> None:
    gathering.counts[SOURCE] = driver.counts
    while True:
        try:
            gathering.take(SOURCE, driver.read(1.0), driver.counter_modulus)
        except EOFError:
            return gathering.finish()
        except DriverError as error:
            raise RecordingError.at("", str(error), "mend or cut the recording") from error

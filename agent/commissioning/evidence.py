"""What a check goes by beside the configuration: a recording, or what the sources deliver now."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from agent.commissioning.misassignment import findings, warnings_of
from agent.commissioning.probe import listen
from agent.commissioning.progress import Progress, silent
from agent.commissioning.readings import Recorded
from agent.commissioning.recording_summary import read_recording
from agent.commissioning.tuning import DRIFTS_PPM, LISTEN_S, OFF_RATE
from agent.config import RigConfig
from agent.errors import Fault


@dataclass(frozen=True, slots=True)
class Gathered:
    """Readings, the facts of them for the document, and what they warn of."""

    recorded: Recorded | None = None
    recording: dict[str, Any] | None = None
    probe: dict[str, Any] | None = None
    warnings: list[Fault] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Evidence:
    """Where readings are to come from."""

    recording: Path | None = None
    probe: bool = False
    progress: Progress = silent

    def gather(self, config: RigConfig) -> Gathered:
        """Return the readings. Raises RecordingError, UsageError, BusError."""
        recorded = self._recorded(config) if self.recording is not None else Gathered()
        if not self.probe:
            return recorded
        probed = self._probed(config)
        # a recording was chosen for its excitation; a probe hears whatever there is
        assessed = recorded.recorded or probed.recorded
        return Gathered(assessed, recorded.recording, probed.probe, [*recorded.warnings, *probed.warnings])

    def _recorded(self, config: RigConfig) -> Gathered:
        recorded = read_recording(config, self.recording or Path())
        found = self._examined(config, recorded)
        return Gathered(recorded, recorded.facts | {"suspicions": found}, None, warnings_of(config, found))

    def _probed(self, config: RigConfig) -> Gathered:
        gathering = listen(config, self.progress)
        recorded = gathering.recorded("the probe")
        sources = gathering.sources()
        warned = list(_sources(config, sources))
        if recorded is None:
            came = any(source["received"] for source in sources)
            advice = "see why samples are refused or lack channels" if came else "see that the devices send"
            silence = Fault("source", "no sample with every channel came", advice)
            facts: dict[str, Any] = {"sources": sources, "channels": [], "suspicions": []}
            return Gathered(None, None, {"listened_s": LISTEN_S} | facts, [*warned, silence])
        found = self._examined(config, recorded)
        facts = recorded.facts | {"listened_s": LISTEN_S, "suspicions": found}
        return Gathered(recorded, None, facts, [*warned, *warnings_of(config, found)])

    def _examined(self, config: RigConfig, recorded: Recorded) -> list[dict[str, Any]]:
        self.progress("examining channels")
        return findings(config, recorded.measured, recorded.pieces, self.progress)


def _sources(config: RigConfig, sources: Sequence[dict[str, Any]]) -> Iterator[Fault]:
    """Warn of sources that are silent, faster or slower than configured, or whose clock drifts."""
    places = {source.name: number for number, source in enumerate(config.source)}
    for source in sources:
        place = f"source[{places[source['name']]}]"
        rate = source["rate_hz"]
        nominal = source["nominal_hz"]
        if rate is None and source["rejected"]:
            yield _refused(place, source)
        elif rate is None:
            yield Fault(place, f"{source['name']}: no samples came", "see that the device sends")
        elif abs(rate / nominal - 1) > OFF_RATE:
            what = f"{source['name']}: {rate:.4g} samples a second come, {nominal:.4g} are configured"
            yield Fault(
                place, what, "correct rig.sample_rate_hz, or rate_hz of the source; or mend what is lost"
            )
        elif (
            source["drift_ppm"] is not None
            and abs(source["drift_ppm"]) - 2 * source["drift_sd_ppm"] > DRIFTS_PPM
        ):
            what = f"{source['name']}: the device's clock runs {source['drift_ppm']:+.0f} ± "
            what += f"{2 * source['drift_sd_ppm']:.0f} millionths off the gateway's"
            yield Fault(place, what, "stiffness is off by twice that share; correct rig.sample_rate_hz")


def _refused(place: str, source: dict[str, Any]) -> Fault:
    """Return that something came of which nothing could be read, with the first of it and why."""
    reasons = ", ".join(f"{reason} {count}" for reason, count in source["rejected"].items())
    shown = source["first_rejected"]
    first = next((f"; the first: {shown[reason]}" for reason in source["rejected"] if reason in shown), "")
    what = f"{source['name']}: all of {source['received']} that came were rejected ({reasons})"
    return Fault(place, what + first, "make the keys of the source fit what it sends")

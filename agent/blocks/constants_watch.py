"""Health assessment of rig constants: verdicts, events when one is sure, alarms when a sensor stays off."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from agent.blocks.tuning import ALARM, ALARM_WINDOWS, DROPPED, SURE, TIED, WORTH_A_ROW
from agent.numerics.inference.verdicts import Belief
from agent.records import HealthEvent
from agent.text import number
from agent.types import Output, Reason, SensorEvent, SensorFault, Verdict

SOURCE = "model"


@dataclass(slots=True)
class ConstantsWatch:
    """Follows the beliefs about one rig's constants.

    Args:
        rig: its name.
        period_s: sampling period: delays are said in seconds.
        window: samples of a window.
        channels: channel of each output that may raise a sensor alarm.
        commanded: whether the inputs are held from sample to sample by the configuration.
    """

    rig: str
    period_s: float
    window: int
    channels: frozenset[str]
    commanded: bool = False
    _stored: dict[str, float] = field(default_factory=dict)
    _said: set[str] = field(default_factory=set)
    _tie: tuple[str, ...] = ()
    _since: dict[str, int] = field(default_factory=dict)
    _alarmed: set[str] = field(default_factory=set)

    def step(
        self, learnt: Sequence[tuple[int, tuple[Belief, ...]]], times: Mapping[int, int]
    ) -> Output[Verdict | HealthEvent, SensorEvent]:
        """Take (sample, beliefs) of windows learnt from, and the samples' times; return what follows."""
        verdicts: list[Verdict] = []
        events: list[HealthEvent] = []
        alarms: list[SensorEvent] = []
        for sample, beliefs in learnt:
            t_ns = times[sample]
            verdicts += [self._verdict(belief, t_ns) for belief in beliefs if self._is_news(belief)]
            events += [event for belief in beliefs if (event := self._said_now(belief, t_ns)) is not None]
            events += self._ties(beliefs, t_ns)
            alarms += self._alarms(beliefs, sample, t_ns)
        return Output([*verdicts, *events], alarms)

    def _is_news(self, belief: Belief) -> bool:
        before = self._stored.get(belief.label, 0.0)
        crossed = any((before >= level) != (belief.probability >= level) for level in (DROPPED, SURE, ALARM))
        if not crossed and abs(belief.probability - before) < WORTH_A_ROW:
            return False
        self._stored[belief.label] = belief.probability
        return True

    def _verdict(self, belief: Belief, t_ns: int) -> Verdict:
        factor, unit = (self.period_s, "s") if belief.kind == "delay" else (100.0, "%")
        return Verdict(
            self.rig, t_ns, belief.label, factor * belief.size, factor * belief.sd, unit, belief.probability
        )  # fmt: skip

    def _said_now(self, belief: Belief, t_ns: int) -> HealthEvent | None:
        """An event when a hypothesis becomes sure, or is not believed any more."""
        if belief.probability >= SURE and belief.label not in self._said:
            self._said.add(belief.label)
            return HealthEvent(self.rig, SOURCE, t_ns, _cause(belief), self._words(belief))
        if belief.probability < DROPPED and belief.label in self._said:
            self._said.discard(belief.label)
            message = f"{belief.label}: no longer believed to be off (probability {belief.probability:.2f})"
            return HealthEvent(self.rig, SOURCE, t_ns, "withdrawn", message)
        return None

    def _words(self, belief: Belief) -> str:
        kind = belief.kind if belief.kind in _HINTS else "gain"
        hint = _HINTS[kind]
        if kind == "delay" and belief.name != "delay":
            hint = "state its delay_s"
        elif kind == "delay" and self.commanded:
            hint = _COMMANDED_EARLY if belief.size < 0 else _COMMANDED_LATE
        return f"{words(belief, self.period_s)}; {hint}"

    def _ties(self, beliefs: Sequence[Belief], t_ns: int) -> list[HealthEvent]:
        """An event when several explanations share what is off between them."""
        # what is sure is off beside them, not in their place
        tied = tuple(b.label for b in beliefs if TIED <= b.probability < SURE)
        together = sum(b.probability for b in beliefs if b.label in tied)
        tied = tied if len(tied) > 1 and together >= SURE else ()
        news, self._tie = tied != self._tie and bool(tied), tied
        if not news:
            return []
        sizes = "; or ".join(words(b, self.period_s) for b in beliefs if b.label in tied)
        advice = "weigh a mass or calibrate a channel, and state how well it is known"
        message = f"{sizes}: these data do not tell which; {advice}"
        return [HealthEvent(self.rig, SOURCE, t_ns, "inseparable", message)]

    def _alarms(self, beliefs: Sequence[Belief], sample: int, t_ns: int) -> list[SensorEvent]:
        """A sensor whose gain stays off raises an alarm; it clears when that is no longer believed."""
        off: dict[str, float] = defaultdict(float)
        for belief in beliefs:
            if belief.name in self.channels:
                off[belief.name] += belief.probability
        changes = {channel: self._change(channel, p, sample) for channel, p in off.items()}
        return [
            SensorEvent(SensorFault(channel, Reason.SENSOR), standing, sample, t_ns)
            for channel, standing in changes.items()
            if standing is not None
        ]

    def _change(self, channel: str, probability: float, sample: int) -> bool | None:
        """Return whether a channel's alarm begins or ends with a window; None where it stays as it is."""
        since = self._since.setdefault(channel, sample)
        if probability < ALARM:
            self._since.pop(channel)
            since = sample
        raised = channel in self._alarmed
        if not raised and sample - since >= (ALARM_WINDOWS - 1) * self.window:
            self._alarmed.add(channel)
            return True
        if raised and probability < DROPPED:
            self._alarmed.discard(channel)
            return False
        return None


def _cause(belief: Belief) -> str:
    if belief.kind in ("mass", "delay", "cubic"):
        return belief.kind
    return "drift" if belief.drifts else "gain"


def words(belief: Belief, period_s: float) -> str:
    """Return a belief as a sentence for people."""
    says = {"delay": _delay_words, "mass": _mass_words, "cubic": _cubic_words}.get(belief.kind, _gain_words)
    return f"{says(belief, period_s)} (probability {belief.probability:.2f})"


_HINTS = {
    "delay": 'state delay_s, or hold = "zero" where the command is held',
    "mass": "correct model.mass",
    "gain": "calibrate the channel, or correct its scale",
    "cubic": "estimates are of its stiffness where it is hardly extended",
}
_COMMANDED_LATE = "state as much as delay_s of the outputs"
_COMMANDED_EARLY = 'set hold = "first" where the force is measured and runs on between samples'


def _delay_words(belief: Belief, period_s: float) -> str:
    late_ms, sd_ms = 1e3 * period_s * belief.size, 1e3 * period_s * belief.sd
    how = f"{number(late_ms, 3)} ± {number(sd_ms, 2)} ms late"
    if belief.name != "delay":
        return f"{belief.name.removesuffix(' late')} is read {how}"
    return f"the inputs act {how}"


def _mass_words(belief: Belief, _: float) -> str:
    verb = "are" if belief.name.startswith("all") else "is"
    return f"{belief.name} {verb} {_amount(belief)} than configured"


def _gain_words(belief: Belief, _: float) -> str:
    verb = "read" if belief.name.startswith("all") else "reads"
    return f"{belief.name} {verb} {_amount(belief)} than it should{' and drifts' if belief.drifts else ''}"


def _cubic_words(belief: Belief, _: float) -> str:
    name = belief.name.removesuffix(" cubic")
    how, stiffer = ("hardens", "stiffer") if belief.size > 0 else ("softens", "less stiff")
    share = f"{number(abs(100 * belief.size), 3)} ± {number(100 * belief.sd, 2)} % {stiffer}"
    return f"{name} {how}: {share} at an extension of {number(1e3 * belief.extension, 3)} mm than at none"


def _amount(belief: Belief) -> str:
    larger = "larger" if belief.size > 0 else "smaller"
    return f"{number(abs(100 * belief.size), 3)} ± {number(100 * belief.sd, 2)} % {larger}"

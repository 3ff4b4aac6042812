"""Whether a rig's computing keeps up with its samples, said once when it does not and once when it does again."""

from agent.runtime.limits import CLEAR_NS, RAISE_NS
from agent.types import AlarmTransition, HealthEvent, Record

COMPUTING, BEHIND = "computing", "behind"
"""What the alarm and the event are called."""


class Lateness:
    """How long the samples of one rig wait to be computed.

    standing: the alarm that says so stands.
    """

    def __init__(self, rig: str) -> None:
        self._rig = rig
        self._least_ns: int | None = None
        self.standing = False

    def step(self, waited_ns: int, t_ns: int) -> list[Record]:
        """Take how long the oldest sample has waited; return what is to be told at t_ns.

        The least that any waited is no backlog: it is what handing over takes, or clocks that do not agree.
        """
        self._least_ns = waited_ns if self._least_ns is None else min(self._least_ns, waited_ns)
        late_ns = waited_ns - self._least_ns
        if self.standing == (late_ns > (CLEAR_NS if self.standing else RAISE_NS)):
            return []
        self.standing = not self.standing
        state = (
            f"computing is {late_ns / 1e9:.1f} s behind its samples" if self.standing else "computing keeps up again"
        )
        words = f"{self._rig}: {state}"
        cause = BEHIND if self.standing else "recovered"
        return [HealthEvent(self._rig, COMPUTING, t_ns, cause, words), self._alarm(words, t_ns)]

    def _alarm(self, words: str, t_ns: int) -> AlarmTransition:
        raised = self.standing
        return AlarmTransition(
            rig=self._rig, kind="source", parameter=COMPUTING, priority="high", t_ns=t_ns,
            from_state="NORM" if raised else "UNACK", to_state="UNACK" if raised else "RTNUN",
            cause="raise" if raised else "clear", message=words,
        )  # fmt: skip

"""`deltak identify --graph`: which springs and dampers a machine has, and then their values.

recordings -> a graph fitted, first the file's -> every element that could be, weighed about that fit ->
dropped and proposed one by one, until a graph comes again -> identified as any other. Equations and limits:
docs/identify.md.
"""

import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from agent.blocks.rig_model import rig_model
from agent.commissioning.explained import Explained
from agent.commissioning.graphs.saturated import KINDS, elective, saturated, stretched, without
from agent.commissioning.identification.document import document_of
from agent.commissioning.identification.doubts import LOOK_FOR
from agent.commissioning.identification.found import Found
from agent.commissioning.identification.graph import elements_of, require_motion_sensors, with_blanks
from agent.commissioning.identification.join import joined
from agent.commissioning.identification.material import material_of, noise_of_sensors, pieces_of, read_records
from agent.commissioning.identification.start import started, started_in_response
from agent.commissioning.identification.windows import pool, window_length, windowed
from agent.commissioning.nominals import with_nominals, write_nominals
from agent.commissioning.numerics.motion.pooled import costs_of
from agent.commissioning.numerics.motion.selection import Choice, Selector
from agent.commissioning.progress import Progress, on_terminal
from agent.commissioning.readings import Recorded
from agent.commissioning.recording_summary import Material
from agent.commissioning.tuning import (
    GRAPH_ROUNDS,
    LEAST_WINDOWS,
    LISTED_GRAPHS,
    SHORTEST_PIECE,
    SMALL,
    TIE,
    TINY,
)
from agent.config import MechanicsModel, RigConfig, load
from agent.errors import Fault, ModelError, RecordingError, UsageError
from agent.runtime.assembly.model_check import model_faults

Begin = Callable[[RigConfig, Sequence[Recorded]], RigConfig]
"""Returns a configuration with a start for its nominals."""


def choose(
    *, config: Path, recordings: Sequence[Path], probe_s: float | None = None, write: bool = False,
    progress: Progress | None = None,
) -> tuple[dict[str, Any], Explained]:  # fmt: skip
    """Choose a graph and identify it; return the document of `identify` with "graph" filled in.

    Raises ConfigError, RecordingError, ModelError, UsageError.
    """
    began = time.monotonic()
    said = progress or on_terminal()
    rig = load(config, identified=True)
    try:
        material = material_of(recordings, probe_s)
        search = _Search.of(rig, material, said)
        answer = search.explained(material)
    except np.linalg.LinAlgError as error:
        raise ModelError.at(
            "model", "no values of any graph's elements give this motion", LOOK_FOR
        ) from error
    finally:
        said("")
    document = document_of(answer.chosen, answer.found)
    document["graph"] = _graphs(rig, answer.selector, answer.best, search.names)
    document["graph_changed"] = set(_elements(answer.chosen)) != set(_elements(rig))
    document["toml"] = _toml(answer.found.config) if document["graph_changed"] else []
    spans = sum(record.facts["span_s"] for record in search.records)
    if write and document["ok"]:
        _write(rig, document)
    return document | {"span_s": spans, "seconds": time.monotonic() - began}, answer.found.seen


def _write(rig: RigConfig, document: dict[str, Any]) -> None:
    """Write values into a file that has the graph chosen; elements are not put into it. Raises UsageError."""
    if document["graph_changed"]:
        lines = " ".join(line.strip() for line in document["toml"])
        advice = f"put these under [model] in place of what it has, then identify it with --write: {lines}"
        raise UsageError.at("--write", "the graph chosen is not the file's; nothing was written", advice)
    write_nominals(rig, {change["parameter"]: change["to"] for change in document["changes"]})
    document["written"] = str(rig.file)


@dataclass
class _Search:
    """The way from the file's graph to the one that explains the recordings.

    A graph is fitted, its noise learnt; about that fit every element that could be is weighed, dropped and
    proposed; the graph that comes of it is fitted in its turn, until one comes again.

    Attributes:
        rig: as the file has it;  full: with every element that could be;  names: of its parameters.
        window: samples of a window.
    """

    rig: RigConfig
    full: RigConfig
    names: tuple[str, ...]
    records: list[Recorded]
    window: int
    progress: Progress
    errors: list[Exception] = field(default_factory=list)

    @classmethod
    def of(cls, rig: RigConfig, recordings: Material, progress: Progress) -> "_Search":
        if not isinstance(rig.model, MechanicsModel):
            what = f'"{rig.model.kind}" has no graph to choose'
            raise UsageError.at("--graph", what, "leave --graph out: its elements are identified as they are")
        blank = with_blanks(rig)
        require_motion_sensors(blank)
        records = read_records(blank, recordings, progress)
        progress("solving the weak form")
        pieces = pieces_of(records)
        noise = noise_of_sensors(blank, records)
        full = stretched(saturated(rig), list(_elements(rig)), pieces, noise)
        names = tuple(p.name for p in rig_model(with_blanks(full)).parameters)
        window = _window([blank, with_blanks(full)], records)
        return cls(rig, full, names, records, window, progress)

    def graph(self, choice: Choice) -> RigConfig:
        """Return the configuration of a choice."""
        return without(self.full, _absent(self.names, choice))

    def explained(self, recordings: Material) -> "_Explained":
        """Return the graph found from the file's; if that explains too little, from all elements at once.

        All of them are begun by frequency response: of so many the weak form makes values that lead nowhere.
        """
        first = self._found(self.rig, recordings, started)
        if first is not None and first.is_good:
            return first
        second = self._found(self.full, recordings, started_in_response)
        if second is not None and (first is None or second.is_good):
            return second
        if first is None:
            raise self.errors[0]
        return first

    def _found(self, graph: RigConfig, recordings: Material, begin: Begin) -> "_Explained | None":
        try:
            selector, best = self._run(graph, begin)
            chosen = self.graph(best)
            return _Explained(
                selector, best, chosen, _identified(chosen, self.records, recordings, self.progress)
            )
        except (np.linalg.LinAlgError, ModelError) as error:
            # a start so far off that its model runs away, or a graph that leaves a mass to itself
            self.errors.append(error)
            return None

    def _run(self, graph: RigConfig, begin: Begin) -> tuple[Selector, Choice]:
        """Return what chose last, and its choice."""
        seen = set[frozenset[str]]()
        while True:
            seen.add(frozenset(_elements(graph)))
            selector = self._selector(graph, begin)
            best = selector.best()
            graph = self.graph(best)
            if not _elements(graph):
                what = "the recordings make no spring and no damper certain"
                raise ModelError.at("model", what, "record longer, or with more motion")
            if frozenset(_elements(graph)) in seen or len(seen) >= GRAPH_ROUNDS:
                return selector, best

    def _selector(self, graph: RigConfig, begin: Begin) -> Selector:
        """Fit a graph, and return what weighs every element about that fit."""
        begun = self._zeroed(begin(with_blanks(graph), self.records))
        said, config, _ = pool(begun, self.records, self.window, self.progress)
        here = dict(zip((p.name for p in rig_model(config).parameters), said.theta.tolist(), strict=True))
        self.progress("weighing every element that could be")
        values = dict.fromkeys(_elements(self.full), 0.0) | here
        point = with_nominals(
            self.full, {name: values[name] for name in _elements(self.full) if name in self.names}
        )
        _, settings, windows = windowed(point, self.records, self.window)
        theta = np.array([here.get(name, 0.0) for name in self.names])
        # open is what was open in the fit: whether smooth forces are followed hangs on a graph's fastest mode
        fitted = windowed(config, self.records, self.window)[1].rig
        rig = replace(settings.rig, constants=fitted.constants)
        costs, scatter = costs_of(rig, windows, said, theta, settings.floor)
        return Selector(costs, elective(self.names, self.full), scatter)

    def _zeroed(self, begun: RigConfig) -> RigConfig:
        """Return a configuration with 0 for elements that the weak form hardly sees: they may be negative."""
        zeros: dict[str, float] = {}
        for kind in KINDS:
            rows = getattr(begun.model, kind)
            largest = max((e.nominal for e in rows), default=0.0)
            small = [
                e.name
                for e in rows
                if e.nominal < (TINY if e.name in _elements(self.rig) else SMALL) * largest
            ]
            zeros |= dict.fromkeys(small, 0.0)
        return with_nominals(begun, zeros)


@dataclass(frozen=True)
class _Explained:
    """A graph with what chose it, and what came of identifying it."""

    selector: Selector
    best: Choice
    chosen: RigConfig
    found: Found

    @property
    def is_good(self) -> bool:
        return bool(document_of(self.chosen, self.found)["ok"])


def _window(configs: Sequence[RigConfig], records: Sequence[Recorded]) -> int:
    """Return samples of a window of the first graph that the weak form can begin. Raises RecordingError."""
    lengths = [b - a for record in records for a, b in record.pieces]
    window = max(lengths)
    for config in configs:
        with suppress(np.linalg.LinAlgError):
            window = window_length(started(config, records), records)
            break
    while sum(length // window for length in lengths) < LEAST_WINDOWS and window >= SHORTEST_PIECE:
        window = int(0.9 * window)
    if window < SHORTEST_PIECE:
        what = f"they hold fewer than {LEAST_WINDOWS} windows of {SHORTEST_PIECE} samples"
        raise RecordingError.at("", what, "record longer: a graph is chosen by how much windows agree")
    return window


def _identified(
    chosen: RigConfig, records: Sequence[Recorded], recordings: Material, progress: Progress
) -> Found:
    progress("identifying the chosen graph")
    begun = started(with_blanks(chosen), records)
    if getattr(chosen.model, "friction", ()):
        records = read_records(begun, recordings, progress)
        begun = started(begun, records)
    if faults := model_faults(begun, rig_model(begun)):
        raise ModelError([Fault(f.path, f"the graph chosen: {f.message}", f.advice) for f in faults])
    return joined(begun, records, progress)


def _elements(config: RigConfig) -> dict[str, Any]:
    return {element.name: element for element in elements_of(config.model)}


def _absent(names: Sequence[str], choice: Choice) -> list[str]:
    return [name for name, kept in zip(names, choice.kept.tolist(), strict=True) if not kept]


def _graphs(rig: RigConfig, selector: Selector, best: Choice, names: Sequence[str]) -> list[dict[str, Any]]:
    """Return the chosen graph, those near it, and the file's own, the best first."""
    configured = _elements(rig)
    own = best.kept.copy()
    for i, name in enumerate(names):
        own[i] = name in configured if selector.elective[i] else own[i]
    choices = [*selector.neighbours(best)[:LISTED_GRAPHS], selector.choice(own)]
    rows = {choice.kept.tobytes(): choice for choice in [best, *choices]}
    ranked = sorted(rows.values(), key=lambda choice: (choice is not best, -choice.score))
    return [
        {
            "elements": [
                n for n, kept, e in zip(names, c.kept, selector.elective, strict=True) if kept and e
            ],
            "score": c.score - best.score, "chosen": c is best,
            "tie": c is not best and c.score > best.score - TIE and _is_physical(c, selector),
            "configured": bool(np.array_equal(c.kept, own)),
        }
        for c in ranked
    ]  # fmt: skip


def _is_physical(choice: Choice, selector: Selector) -> bool:
    return bool(np.all(choice.theta[choice.kept & selector.elective] > 0))


def _toml(config: RigConfig) -> list[str]:
    """Return the lines of the chosen graph's springs and dampers as a configuration has them."""
    lines = []
    for kind in KINDS:
        rows = [
            f'    {{ name = "{e.name}", between = ["{e.between[0]}", "{e.between[1]}"], '
            f"nominal = {e.nominal:.6g} }},"
            for e in getattr(config.model, kind)
        ]
        lines += [f"{kind} = [", *rows, "]"]
    return lines

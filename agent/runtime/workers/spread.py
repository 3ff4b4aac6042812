"""Which worker runs which rig: rigs that share a source stay together, the rest is spread by sample rate."""

import os
from collections import Counter
from collections.abc import Mapping, Sequence

from agent.config import RigConfig
from agent.config.sections.process import agreed

Places = Mapping[str, int]
"""The number of each rig's worker, from 1, by the rig's name."""


def wanted_workers(configs: Sequence[RigConfig]) -> int:
    """Return how many processes compute: as asked for, or one a core, as many as can be used at most."""
    asked = agreed([(config.file, config.agent) for config in configs])[0].workers
    most = len(os.sched_getaffinity(0)) if asked is None else asked
    return min(most, len(_groups(configs)))


def spread(configs: Sequence[RigConfig], most: int, before: Places) -> dict[str, int]:
    """Return each rig's worker, of `most`; before: where rigs run now; as few as possible are moved."""
    load: Counter[int] = Counter(dict.fromkeys(range(1, most + 1), 0))
    places: dict[str, int] = {}
    groups = sorted(_groups(configs), key=lambda group: (not _homes(group, before), -_load(group)))
    for group in groups:
        homes = _homes(group, before)
        place = homes.most_common(1)[0][0] if homes else min(load, key=lambda number: (load[number], number))
        load[place] += _load(group)
        places |= {config.rig.name: place for config in group}
    return places


def _homes(group: Sequence[RigConfig], before: Places) -> Counter[int]:
    """Return how many rigs of a group each worker runs."""
    return Counter(before[config.rig.name] for config in group if config.rig.name in before)


def _load(group: Sequence[RigConfig]) -> int:
    """Return the readings a second of a group."""
    return sum(round(config.rig.sample_rate_hz * len(config.channel)) for config in group)


def _groups(configs: Sequence[RigConfig]) -> list[list[RigConfig]]:
    """Part rigs into those that share sources with one another, directly or by others."""
    found: list[tuple[set[str], list[RigConfig]]] = []
    for config in configs:
        keys = {source.connection(config.folder) for source in config.source}
        members = [config]
        for shared in [one for one in found if one[0] & keys]:
            keys |= shared[0]
            members = shared[1] + members
            found.remove(shared)
        found.append((keys, members))
    return [members for _, members in found]

"""Random machines whose configured graph is right, lacks an element, or has one too many; what is chosen."""

from dataclasses import dataclass
from itertools import combinations
from pathlib import Path

import numpy as np

from agent.commissioning.graphs.choose import choose
from tests.statistical.unknown_machines import Machine, machine, name, recorded

CASES = ("right", "one more", "one less")
"""What the machine is beside the configuration: the same, with one element more, with one less."""
Elements = dict[str, tuple[int, int]]


@dataclass(frozen=True)
class Chosen:
    """What became of one machine: what was chosen beside the truth, and how long it took."""

    false: tuple[str, ...]
    missed: tuple[str, ...]
    tied: bool
    refused: str
    seconds: float
    masses: int

    @property
    def right(self) -> bool:
        return not (self.false or self.missed)

    def __str__(self) -> str:
        more, less = ", ".join(self.false), ", ".join(self.missed)
        words = (
            "right"
            if self.right
            else f"false {more or '-'}; missed {less or '-'}{' (tie)' if self.tied else ''}"
        )
        return (
            f"{self.masses} masses, {words}{'; ' + self.refused if self.refused else ''}, "
            f"{self.seconds:.1f} s"
        )


def true_elements(one: Machine) -> Elements:
    """Return springs and dampers of a machine by a name that says kind and ends."""
    return {f"{kind}{a}{b}": (a, b) for kind in "kB" for a, b in one.ends}


def configured(one: Machine, case: str, rng: np.random.Generator) -> Elements:
    """Return the elements that the file has."""
    found = true_elements(one)
    if case == "one more":
        names = [n for n in found if n.startswith("k") or len(one.ends) > 1]
        found.pop(names[int(rng.integers(len(names)))])
    if case == "one less":
        pairs = [pair for pair in combinations(range(len(one.masses) + 1), 2) if pair not in one.ends]
        if pairs:
            a, b = pairs[int(rng.integers(len(pairs)))]
            found["kB"[int(rng.integers(2))] + f"{a}{b}"] = (a, b)
    return found


def text_of(one: Machine, elements: Elements, rate: float, masses: np.ndarray) -> str:
    rows = {kind: [(n, ends) for n, ends in elements.items() if n[0] == letter] for kind, letter in
            (("spring", "k"), ("damper", "B"))}  # fmt: skip
    lines = [f'[rig]\nname = "unknown"\nsample_rate_hz = {rate!r}\nclock = "uniform"\n\n[model]']
    weights = ", ".join(f'{{ name = "m{i}", value = {m!r} }}' for i, m in enumerate(masses.tolist(), 1))
    lines.append(f"mass = [{weights}]")
    for kind, found in rows.items():
        text = ", ".join(f'{{ name = "{n}", between = ["{name(a)}", "{name(b)}"] }}' for n, (a, b) in found)
        lines.append(f"{kind} = [{text}]")
    channels = [(f"f{n}", "force", n, "N") for n in one.forces]
    channels += [(f"x{i}", "displacement", i, "m") for i in range(1, len(masses) + 1)]
    lines += [
        f'\n[[channel]]\nname = "{c}"\nquantity = "{q}"\nat = "m{n}"\nunit = "{u}"' for c, q, n, u in channels
    ]  # fmt: skip
    return "\n".join([*lines, ""])


def chosen(folder: Path, seed: int, case: str, masses: int | None = None, span_s: float = 60.0) -> Chosen:
    """Play a machine, write what is known of it and choose a graph."""
    rng = np.random.default_rng([23, seed, CASES.index(case)])
    one = machine(rng, masses or (int(rng.integers(2, 5)) if case == "one less" else None))
    columns = recorded(one, rng, float(10.0 ** rng.uniform(-4.0, -1.5)), span_s)
    stated = one.masses * (1.0 + np.clip(0.02 * rng.normal(size=len(one.masses)), -0.04, 0.04))
    config, record = folder / f"{seed}.toml", folder / f"{seed}.npz"
    text = text_of(one, configured(one, case, rng), float(1.0 / columns["t"][1]), stated)
    config.write_text(text, encoding="utf-8")
    np.savez(record, **columns)
    document, _ = choose(config=config, recordings=[record])
    record.unlink()
    ends = {frozenset(pair) for pair in true_elements(one).values()}
    truth = {(kind, pair) for kind in "kB" for pair in ends}
    best = document["graph"][0]
    found = {(n[0], _ends(n)) for n in best["elements"]}
    words = {key: key[0] + "".join(map(str, sorted(key[1]))) for key in truth | found}
    tied = any(
        row["tie"] and {(n[0], _ends(n)) for n in row["elements"]} == truth for row in document["graph"]
    )  # fmt: skip
    refused = "; ".join(error["message"] for error in document["errors"])
    return Chosen(
        tuple(sorted(words[e] for e in found - truth)), tuple(sorted(words[e] for e in truth - found)), tied,
        refused,
        document["seconds"], len(one.masses),
    )  # fmt: skip


def _ends(text: str) -> frozenset[int]:
    """The nodes of an element, by the names of this file's configurations or of proposed elements."""
    if "_" in text:
        return frozenset(0 if node == "ground" else int(node[1:]) for node in text.split("_")[1:])
    return frozenset(int(digit) for digit in text[1:])

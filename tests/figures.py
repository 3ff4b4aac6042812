"""Figures that a run of the tests measured, printed in its last lines."""

FIGURES: list[str] = []


def figure(text: str) -> None:
    """Keep one line for the end of the run."""
    FIGURES.append(text)

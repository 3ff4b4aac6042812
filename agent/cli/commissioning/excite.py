"""`deltak excite`: what the designed motion teaches, beside what the recording at hand does."""

from collections.abc import Mapping
from typing import Any

from agent.cli.terminal.output import print_table, show
from agent.text import number

Document = Mapping[str, Any]


def print_excitation(document: Document) -> None:
    """Print the sd of each parameter, the peaks and the advice."""
    past = document["recording_sd"]
    columns = ("parameter", "sd to expect", "of the recording", "masses and gains known", "unit")
    rows = [
        (
            name,
            number(sd, 3),
            "" if past is None else number(past[name], 3),
            number(document["sd_repeat"][name], 3),
            document["units"][name],
        )
        for name, sd in document["predicted_sd"].items()
    ]
    print_table(f"{document['rig']}: {number(document['seconds'])} s", columns, rows, right=columns[1:4])
    force = f"{number(document['peak_force'], 4)} {document['force_unit']}"
    stroke = f"{number(document['peak_stroke'], 4)} {document['stroke_unit']}"
    show(f"peaks: force {force}, stroke {stroke}; {document['assumes']}")
    for words in document["advice"]:
        show(words)
    show("from one such run to the next, masses and gains learnt in each; what is common to all is not in it")
    show(f"written to {document['to']}; play it with your own shaker: deltak never transmits")

"""`deltak excite`: what the designed motion teaches, beside what the recording at hand does."""

from collections.abc import Mapping
from typing import Any

from agent.cli.terminal.output import print_table, show
from agent.text import number

Document = Mapping[str, Any]


def print_excitation(document: Document) -> None:
    """Print the sd of each parameter, the peaks and the advice."""
    past = document["recording_sd"]
    columns = ("parameter", "sd to expect", "sd of the recording", "unit")
    rows = [
        (name, number(sd, 3), "" if past is None else number(past[name], 3), document["units"][name])
        for name, sd in document["predicted_sd"].items()
    ]
    print_table(f"{document['rig']}: {number(document['seconds'])} s", columns, rows, right=columns[1:3])
    force = f"{number(document['peak_force'], 4)} {document['force_unit']}"
    stroke = f"{number(document['peak_stroke'], 4)} {document['stroke_unit']}"
    show(f"peaks: force {force}, stroke {stroke}; {document['assumes']}")
    for words in document["advice"]:
        show(words)
    show("masses and gains as they are; what their data sheets leave open no motion tells")
    show(f"written to {document['to']}; play it with your own shaker: deltak never transmits")

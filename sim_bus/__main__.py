"""`python -m sim_bus CONFIG`: the command `sim` without the rest of `deltak`."""

import typer

from sim_bus.commands import sim

typer.run(sim)

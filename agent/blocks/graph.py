"""The graph of a model in words: what a baseline is of, whatever values its elements have."""

from agent.config import MechanicsModel, RigConfig
from agent.config.domains.plant import Domain


def graph_of(config: RigConfig) -> str:
    """Return what joins what, in one order whatever the file's; for a linear model order and parameters."""
    model = config.model
    if isinstance(model, Domain):
        return f"{model.kind}: {', '.join(sorted(part.name for part in model.parts))}"
    if not isinstance(model, MechanicsModel):
        names = ", ".join(sorted(parameter.name for parameter in model.parameter))
        return f"linear of {len(model.A)} states: {names}"
    kinds = (("spring", model.spring), ("damper", model.damper), ("friction", model.friction))
    return "; ".join(
        f"{kind} {row.name} {'-'.join(sorted(row.between))}"
        for kind, rows in kinds
        for row in sorted(rows, key=lambda row: row.name)
    )

"""All windows joined by the estimator's likelihood, and the result run free through them."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from agent.blocks.rig_model import rig_model
from agent.blocks.statistical_rig import statistical_rig
from agent.commissioning.explained import explained
from agent.commissioning.identification.doubts import why_unknown
from agent.commissioning.identification.found import Found
from agent.commissioning.identification.material import noise_of_sensors
from agent.commissioning.identification.rivals import rival_of
from agent.commissioning.identification.windows import pool, window_length
from agent.commissioning.nominals import with_nominals
from agent.commissioning.numerics.motion.pooled import Pooled
from agent.commissioning.progress import Progress
from agent.commissioning.readings import Recorded
from agent.commissioning.recorded_windows import helping
from agent.commissioning.tuning import VAGUE
from agent.config import MechanicsModel, RigConfig
from agent.numerics.model.uncertain import Constant
from agent.types import FloatArray


def joined(
    begun: RigConfig, records: Sequence[Recorded], progress: Progress, others: Sequence[RigConfig] = ()
) -> Found:
    """Estimate by all windows together, and run the result free through them.

    others: starts that explain nearly as much; one that comes to as good an end elsewhere is kept as a rival.
    """
    window = window_length(begun, records)
    said, config, count = pool(begun, records, window, progress)
    rival = rival_of(config, records, window, said, others, progress)
    progress("running the model free")
    rig = rig_model(config)
    names = [parameter.name for parameter in rig.parameters]
    found = with_nominals(config, dict(zip(names, said.theta.tolist(), strict=True)))
    constants = statistical_rig(config).constants
    noise = noise_of_sensors(config, records)
    seen = explained(_weighed(found, said, constants), said.theta, records, window, noise)
    whole = Found(found, rig, said, window, count, seen, constants, rival=rival)
    return replace(whole, helpful=_helpful(whole, records[0], noise))


def _helpful(found: Found, record: Recorded, noise: FloatArray) -> dict[int, str]:
    """Return the displacement that would show each parameter that is not known, where there is one."""
    if not isinstance(found.config.model, MechanicsModel):
        return {}
    restless = found.pooled.restless
    unknown = [i for i in range(len(found.rig.parameters)) if restless[i] or why_unknown(found, i)]
    ways = helping(found.config, record, found.window, found.windows, noise) if unknown else []
    size = VAGUE * np.abs(found.pooled.theta)
    shown = {i: [place for place, sd in ways if sd[i] < size[i]] for i in unknown}
    return {i: places[0] for i, places in shown.items() if places}


def _weighed(config: RigConfig, said: Pooled, constants: Sequence[Constant]) -> RigConfig:
    """Return the configuration with masses as the data have them: the values were found with these."""
    pairs = [(c.name, eta) for c, eta in zip(constants, said.eta.tolist(), strict=True) if c.kind == "mass"]
    known = config.parameters
    return with_nominals(config, {name: float(known[name].nominal * np.exp(eta)) for name, eta in pairs})

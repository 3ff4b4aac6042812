"""What a rig's learnt knowledge is kept under: a hash of what it depends on."""

import hashlib
import json

from agent.config.tables import RigConfig


def learnt_key(config: RigConfig) -> str:
    """Return the SHA-256, in hexadecimal, of the model, the channels, the rate, window, hop, hold and estimate.

    An edit of alarms, store or sources leaves it as it is, so does a default that is written out; a key that a later
    version brings changes it only where it is used.
    """
    estimator = config.estimator
    parts = [
        config.rig.sample_rate_hz,
        config.model.model_dump(mode="json", exclude_defaults=True),
        [channel.model_dump(mode="json", exclude_defaults=True) for channel in config.channel],
        [estimator.windows_s or "auto", estimator.hop_s, estimator.hold, estimator.estimate],
    ]
    text = json.dumps(parts, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode("utf-8")).hexdigest()

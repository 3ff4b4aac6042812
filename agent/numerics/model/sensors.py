"""A model seen through imperfect sensors: constant input and output offsets and gains as further parameters.

    y_r = gain_r (C_r x + D_r u) + bias_r            u_j true = gain_j (u_j measured - bias_j)

Offsets act through one more input that is always 1 (the last one). All of it stays an exact parametric state
space, so discretisation, observer and sensitivities need not know.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from agent.numerics.model.statespace import Model, StateSpace
from agent.types import FloatArray

Side = Literal["input", "output"]


@dataclass(frozen=True, slots=True)
class Nuisance:
    """One sensor constant that is estimated beside the physical parameters.

    Attributes:
        name: such as "x1.bias".
        kind: "bias" (nominal 0) or "gain" (nominal 1).
        side: whether it belongs to an input or an output.
        number: of that input or output.
    """

    name: str
    kind: Literal["bias", "gain"]
    side: Side
    number: int

    @property
    def nominal(self) -> float:
        """What a perfect sensor has."""
        return 1.0 if self.kind == "gain" else 0.0


@dataclass(frozen=True)
class SensedModel:
    """A model with sensor constants; theta is the model's own, then the constants in order.

    Its inputs are the model's and a last one that is always 1.
    """

    model: Model
    nuisances: tuple[Nuisance, ...]

    @property
    def parameters(self) -> tuple[str, ...]:
        """The model's own parameters, then the sensor constants."""
        return self.model.parameters + tuple(n.name for n in self.nuisances)

    @property
    def nominal(self) -> FloatArray:
        """(q,) nominal values."""
        return np.concatenate([self.model.nominal, [n.nominal for n in self.nuisances]])

    @property
    def state_names(self) -> tuple[str, ...]:
        """The model's states."""
        return self.model.state_names

    def continuous(self, theta: FloatArray) -> StateSpace:
        """Return the continuous-time model at theta (q,)."""
        count = len(self.model.parameters)
        inner = self.model.continuous(theta[:count])
        constants = _Constants(self.nuisances, np.asarray(theta[count:], dtype=float), inner)
        B, D = constants.inputs(inner.B, inner.D)
        dB, dD = constants.inputs(inner.dB, inner.dD)
        C, D = constants.outputs(inner.C, D, constant=1.0)
        dC, dD = constants.outputs(inner.dC, dD, constant=0.0)
        extra = [constants.derivative(nuisance, inner) for nuisance in self.nuisances]
        shape = (len(extra), *inner.A.shape)
        return StateSpace(
            inner.A, B, C, D,
            np.concatenate([inner.dA, np.zeros(shape)]),
            np.concatenate([dB, [e[0] for e in extra]]) if extra else dB,
            np.concatenate([dC, [e[1] for e in extra]]) if extra else dC,
            np.concatenate([dD, [e[2] for e in extra]]) if extra else dD,
            inner.is_sampled,
        )  # fmt: skip


class _Constants:
    """The sensor constants' values, and what they make of matrices (any leading axes)."""

    def __init__(self, nuisances: Sequence[Nuisance], values: FloatArray, inner: StateSpace) -> None:
        self.input_gain = np.ones(inner.m)
        self.input_bias = np.zeros(inner.m)
        self.output_gain = np.ones(inner.p)
        self.output_bias = np.zeros(inner.p)
        for nuisance, value in zip(nuisances, values, strict=True):
            getattr(self, f"{nuisance.side}_{nuisance.kind}")[nuisance.number] = value

    def inputs(self, B: FloatArray, D: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Let u true = gain (u - bias): columns of measured inputs, then the column of the constant 1."""
        return tuple(  # type: ignore[return-value]
            np.concatenate(
                [M * self.input_gain, -(M @ (self.input_gain * self.input_bias))[..., None]], axis=-1
            )
            for M in (B, D)
        )

    def outputs(self, C: FloatArray, D: FloatArray, constant: float) -> tuple[FloatArray, FloatArray]:
        """Let y = gain (C x + D u) + bias; derivatives by other parameters have no constant part."""
        D = D * self.output_gain[:, None]
        D[..., -1] += constant * self.output_bias
        return C * self.output_gain[:, None], D

    def derivative(self, nuisance: Nuisance, inner: StateSpace) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Return dB (n, m+1), dC (p, n), dD (p, m+1) by one constant."""
        dB, dC = np.zeros((inner.n, inner.m + 1)), np.zeros((inner.p, inner.n))
        dD = np.zeros((inner.p, inner.m + 1))
        j = nuisance.number
        if nuisance.side == "output":
            self._by_output(nuisance, inner, dC, dD)
            return dB, dC, dD
        scale = self.output_gain
        if nuisance.kind == "bias":
            dB[:, -1] = -inner.B[:, j] * self.input_gain[j]
            dD[:, -1] = -scale * inner.D[:, j] * self.input_gain[j]
        else:
            dB[:, j] = inner.B[:, j]
            dB[:, -1] = -inner.B[:, j] * self.input_bias[j]
            dD[:, j], dD[:, -1] = scale * inner.D[:, j], -scale * inner.D[:, j] * self.input_bias[j]
        return dB, dC, dD

    def _by_output(self, nuisance: Nuisance, inner: StateSpace, dC: FloatArray, dD: FloatArray) -> None:
        r = nuisance.number
        if nuisance.kind == "bias":
            dD[r, -1] = 1.0
            return
        dC[r] = inner.C[r]
        dD[r, :-1] = inner.D[r] * self.input_gain
        dD[r, -1] = -inner.D[r] @ (self.input_gain * self.input_bias)


def with_constant(u: FloatArray, inputs: int) -> FloatArray:
    """Append the input that is always 1 to inputs (N, m) where the model has `inputs` = m + 1 of them."""
    return u if u.shape[1] == inputs else np.hstack([u, np.ones((len(u), 1))])

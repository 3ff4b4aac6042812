"""Multisines: sums of cosines of given powers, their phases chosen so that the peak is small.

Phases begin as Schroeder's (1970, IEEE Trans. Information Theory 16:85), which spread the energy evenly over
time; then the signal is clipped and its lines' amplitudes are put back by turns (Van der Ouderaa, Schoukens
and Renneboog 1988, IEEE Trans. Instrumentation and Measurement 37:145).
"""

import numpy as np

from agent.commissioning.tuning import CLIPPED, PASSES
from agent.types import FloatArray, IntArray


def multisine(power: FloatArray, line: IntArray, count: int) -> FloatArray:
    """Return a period (count,) of cosines of powers (L,) at line (L,) whole periods each, of small peak."""
    amplitude = np.sqrt(2.0 * power)
    phase = schroeder(power)
    best = signal(amplitude, phase, line, count)
    current = best
    for share in np.linspace(*CLIPPED, PASSES):
        top = share * float(np.abs(current).max())
        found = np.fft.rfft(np.clip(current, -top, top))[line]
        current = signal(amplitude, np.angle(found), line, count)
        if np.abs(current).max() < np.abs(best).max():
            best = current
    return best


def schroeder(power: FloatArray) -> FloatArray:
    """Return phases (L,) that spread the energy of lines of these powers over the period."""
    share = power / power.sum()
    return -2.0 * np.pi * np.cumsum(np.r_[0.0, np.cumsum(share)[:-1]])


def signal(amplitude: FloatArray, phase: FloatArray, line: IntArray, count: int) -> FloatArray:
    """Return the sum (count,) of cosines."""
    spectrum = np.zeros(count // 2 + 1, dtype=np.complex128)
    spectrum[line] = 0.5 * count * amplitude * np.exp(1j * phase)
    return np.asarray(np.fft.irfft(spectrum, count))


def crest(u: FloatArray) -> float:
    """Return the crest factor, peak over rms, of a signal (N,)."""
    return float(np.abs(u).max() / np.sqrt(np.mean(u**2)))

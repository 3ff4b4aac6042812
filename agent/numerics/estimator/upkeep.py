"""What is looked at now and then while nothing happens: the residual's colour, and what the model may lack."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from agent.numerics.estimator.lacking import Lacking
from agent.numerics.estimator.working_point import WorkingPoint
from agent.numerics.faults.frozen import Frozen, standing
from agent.numerics.faults.masses import LEAST
from agent.numerics.faults.suspects import NOBODY, Accusation, ChannelSuspect, Suspects, mass_suspect
from agent.numerics.fitting.colour import Colour, colour_of
from agent.numerics.fitting.fit import linearise
from agent.numerics.window.hops import Segment
from agent.numerics.window.rows import Rows

FloatArray = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]
NEVER = -(10**18)
LONG = 4096
"""Newest samples of a window from which its colour is learnt."""
ACCUSED = 32_768
"""Newest samples of a window in which a suspect is looked for."""
RECOLOUR = 262_144
"""Samples between two looks at the colour of a residual that was white; one that was not is looked at every window."""


class Upkeep:
    """When each look was taken and what it found.

    Attributes:
        coloured_at: newest sample of the window whose colour is in use.
        accused: the Reason that was found for what the model lacks, 0 for none; accused_at its newest sample.
        channel: the channel (outputs, then inputs) that is at fault for it, -1 for none.
        distressed: it was found in a window that no parameters explain; where they do again, it is looked at anew.
        proven: it was found by a calibration of a long record, and stands until then.
        frozen: what is known of channels that stand still; None where channels are believed.
        findings: (sample, accusation) of every look that found something, until they are taken away.
    """

    def __init__(self, frozen: Frozen | None = None) -> None:
        self.frozen = frozen
        self.coloured_at = self.accused_at = NEVER
        self.accused, self.channel = 0, NOBODY
        self.distressed = self.proven = False
        self._suspected: Accusation | None = None
        self.findings: list[tuple[int, Accusation]] = []

    def due(self, point: WorkingPoint, rows: Rows) -> BoolArray:
        """(N,) rows from which on the residual's colour is due for a look."""
        every = point.settings.plan.window if self.distressed else self._every(point)
        return np.asarray(rows.index - self.coloured_at >= every)

    def _every(self, point: WorkingPoint) -> int:
        white = point.colour.share == 1.0 and bool(np.all(point.colour.inflation < 1.2))
        window = point.settings.plan.window
        return max(RECOLOUR, window) if white else window

    def recolour(self, point: WorkingPoint, segment: Segment, lacking: Lacking, rows: Rows, row: int) -> None:
        """Look at the colour of a healthy row's residual; widen this row's and later intervals."""
        index = int(rows.index[row])
        before, window = point.colour, min(point.settings.plan.window, LONG)
        v = segment.samples(index + 1 - window, index + 1)
        bridge = lacking.bridge(v, index + 1)
        here = linearise(point.discrete.model, point.gain, v, np.zeros(point.n), bridge)
        covariance = np.linalg.pinv(here.psi.T @ here.psi, hermitian=True)
        delta = covariance @ (here.psi.T @ here.e)
        residual = (here.e - here.psi @ delta).reshape(-1, point.outputs)
        inputs = point.input_noise(point.discrete, point.gain, window)
        varying = None if bridge is not None else point.varying(residual, v)
        point.colour = colour_of(here.psi, residual, np.asarray(covariance), point.unknowns, inputs, varying)
        self.coloured_at = index
        _widen(rows, row, before, point.colour)
        self.review(point, segment, lacking, rows, row)

    def review(self, point: WorkingPoint, segment: Segment, lacking: Lacking, rows: Rows, row: int) -> None:
        """Accuse where the residual is coloured; what a model lacks colours it, so a white one clears all suspects."""
        self.distressed, self.proven, self._suspected = False, False, None
        if (point.colour.share < 1.0 or point.wrong is not None) and not point.exact:
            self.accuse(point, segment, lacking, rows, row)
        else:
            self.accused_at = int(rows.index[row])
            self._blame(None, rows, row)

    def accuse_in_distress(
        self, point: WorkingPoint, segment: Segment, lacking: Lacking, rows: Rows, row: int
    ) -> None:  # fmt: skip
        """Look for what the model lacks in a window that no parameters explain: it may be what it lacks for good.

        An unknown force may look like anything in one window; of a rig that was understood before, a suspect is
        accused only where the look before found the same.
        """
        self.accused_at = int(rows.index[row])
        if point.settings.suspects is None:
            return
        found, before = self._look(point.settings.suspects, point, segment, lacking, self.accused_at), self._suspected
        alike = found is not None and before is not None and found.suspect == before.suspect
        self._suspected = found
        self._blame(found if alike or not point.settled else None, rows, row)
        self.distressed = bool(self.accused)

    def note(self, segment: Segment, window: int, index: IntArray) -> None:
        """Take how channels stand still in healthy windows, one or more, whose newest samples are index (N,)."""
        if self.frozen is not None:
            start = int(index[0]) + 1 - window
            self.frozen.note(segment.samples(start, int(index[-1]) + 1), index + 1 - start, window)

    def finds_standing(self, point: WorkingPoint, segment: Segment, rows: Rows, row: int) -> bool:
        """Tell whether nothing can be fitted to a row's window, as outputs never change in it; say what they are.

        Where none of them moves the rig stands still; one that does not while others do is stuck, unless it is known
        how fine it reads: then it may well move less than it shows.
        """
        index, settings = int(rows.index[row]), point.settings
        y = segment.samples(index + 1 - settings.plan.window, index + 1)[:, : point.outputs]
        still = standing(y)
        if still.all():
            rows.sd[row] = np.inf  # before the first fit it would be that of parameters nobody has seen
            return True
        stuck = np.flatnonzero(still & ~np.isfinite(settings.sigma) & (settings.floor == 0))
        if not len(stuck):
            return False
        self.accused_at, self.distressed = index, True
        suspect = ChannelSuspect("stuck", tuple(stuck.tolist()))
        self._blame(Accusation(suspect, 1.0, sizes=tuple(y[-1, stuck])), rows, row)
        return True

    def finds_frozen(self, segment: Segment, window: int, rows: Rows, row: int) -> bool:
        """Tell whether a channel froze for the whole of a row's window, which no parameters explain; accuse it."""
        index = int(rows.index[row])
        found = None if self.frozen is None else self.frozen.find(segment.samples(index + 1 - window, index + 1))
        if found is None:
            return False
        self.accused_at, self.distressed = index, True
        self._blame(found, rows, row)
        return True

    def accuse(self, point: WorkingPoint, segment: Segment, lacking: Lacking, rows: Rows, row: int) -> None:
        """Look for what the model lacks in the window of a row; the finding stands until the next look."""
        self.accused_at = int(rows.index[row])
        if point.settings.suspects is not None:
            self._blame(self._look(point.settings.suspects, point, segment, lacking, self.accused_at), rows, row)

    @staticmethod
    def _look(
        suspects: Suspects, point: WorkingPoint, segment: Segment, lacking: Lacking, index: int
    ) -> Accusation | None:  # fmt: skip
        """Return the suspect that explains the window which ends with sample `index`; None where none does."""
        v = segment.samples(index + 1 - min(point.settings.plan.window, ACCUSED), index + 1)
        if not np.isfinite(v).all():
            return None
        bridge, wrong = lacking.bridge(v, index + 1), point.wrong
        if wrong is not None:
            # what a calibration found is small in a residual that it learnt or that unknown forces explain, and
            # colours it: it stands as long as it explains more than others do
            found = suspects.accuse(point.theta, point.gain, v, point.dof, bridge, least=0.0)
            if found is not None and found.suspect == mass_suspect(wrong.name) and abs(found.change) >= LEAST:
                return replace(found, change=wrong.change)
            point.wrong = None
        return suspects.accuse(point.theta, point.gain, v, point.dof * point.colour.share, bridge)

    def believe(self, point: WorkingPoint, v: FloatArray, rows: Rows, row: int) -> None:
        """Take what a calibration of a window v (W, c) that did not stand said of channels, or of a mass."""
        unmoved = None if self.frozen is None else self.frozen.find_unmoved(v)
        found = _told(point) if unmoved is None else unmoved
        if found is None and self.frozen is not None:
            found = self.frozen.resting(v)
        if found is not None:
            self.accused_at = int(rows.index[row])
            self._blame(found, rows, row)

    def believe_in_distress(self, point: WorkingPoint, rows: Rows, row: int) -> None:
        """Take what a calibration of a long record, which no parameters explain, said of channels, or of a mass."""
        found = _told(point)
        self.proven = found is not None
        if found is not None:
            self.accused_at, self.distressed = int(rows.index[row]), True
            self._blame(found, rows, row)

    def _blame(self, found: Accusation | None, rows: Rows, row: int) -> None:
        self.accused = 0 if found is None else int(found.suspect.reason)
        self.channel = NOBODY if found is None else found.suspect.at_fault
        rows.suspect[row:], rows.channel[row:] = self.accused, self.channel
        if found is not None:
            self.findings.append((int(rows.index[row]), found))


def _told(point: WorkingPoint) -> Accusation | None:
    """Return what a calibration that did not stand found wrong with channels, or with a mass; None for nothing."""
    mistake, wrong = point.mistake, point.wrong
    if mistake is not None:
        return Accusation(mistake.suspect, mistake.share, sizes=mistake.sizes)
    return None if wrong is None else Accusation(mass_suspect(wrong.name), 1.0, wrong.change)


def _widen(rows: Rows, row: int, before: Colour, now: Colour) -> None:
    """Give a row and those after it the intervals of another colour."""
    rows.sd[row:] *= now.inflation / before.inflation
    rows.dof[row:] *= now.share / before.share

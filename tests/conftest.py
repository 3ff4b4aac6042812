"""Seeds, profiles and the closing words of every test run."""

import gc
import os
import signal
import zlib
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from agent.kernels import settled

os.environ.update(settled())

import hypothesis
import numpy as np
import pytest

from tests import figures, lanes, peers
from tests.tracing import run as tracing

SEED = int(os.environ.get("DELTAK_SEED", "0"))

hypothesis.settings.register_profile(
    "quick", derandomize=True, database=None, deadline=None, max_examples=100
)
hypothesis.settings.register_profile(
    "soak", parent=hypothesis.settings.get_profile("quick"), max_examples=5000
)
hypothesis.settings.load_profile(os.environ.get("DELTAK_HYPOTHESIS", "quick"))


@pytest.fixture
def rng(request: pytest.FixtureRequest) -> np.random.Generator:
    """Numbers that are each test's own and the same in every run; DELTAK_SEED turns to others."""
    return np.random.default_rng([SEED, zlib.crc32(request.node.nodeid.encode())])


_WRITES = pytest.StashKey[tuple[int, list[str]]]()
_REPORT = pytest.StashKey[Path]()


def pytest_configure(config: pytest.Config) -> None:
    # a run in a script's background ignores SIGINT, and so would every process that tests start and interrupt
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        signal.signal(signal.SIGINT, signal.default_int_handler)
    config.stash[_REPORT] = tracing.begin()


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """Keep the garbage collector from what is collected, which lives to the end: to look through it took half
    the time."""
    gc.disable()
    result = yield
    gc.freeze()
    gc.enable()
    return result


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave files unread of which nothing is run by lanes where just that is asked for: importing all takes
    seconds."""
    return lanes.has_no_lane(collection_path, config.rootpath) if _by_lanes(config) else None


def _by_lanes(config: pytest.Config) -> bool:
    return bool(config.getvalue("markexpr").startswith("(realtime"))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    items[:] = lanes.in_order(items)
    for item in items:
        if lanes.computes(item.nodeid):
            item.add_marker("background")


def pytest_runtest_setup(item: pytest.Item) -> None:
    if _by_lanes(item.config):
        lanes.give_way(item.nodeid)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> lanes.Lanes | None:
    """Divide a run by lanes where --dist asks for scopes; Makefile does so for its second part."""
    return lanes.Lanes(config, log) if config.getvalue("dist") == "loadscope" else None


def pytest_sessionfinish(session: pytest.Session) -> None:
    """A run in which a driver wrote what a listener must not is red, whatever its tests say."""
    seen, forbidden = tracing.end(session.config.stash[_REPORT])
    others_seen, others_forbidden = session.config.stash.get(_WRITES, (0, []))
    writes = session.config.stash[_WRITES] = (seen + others_seen, forbidden + others_forbidden)
    reported = getattr(session.config, "workeroutput", None)
    if reported is not None:
        reported["deltak"] = {"writes": writes, "figures": figures.FIGURES, "not tested": peers.NOT_TESTED}
    elif writes[1]:
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any, error: object) -> None:
    """Take over what one of several processes that share a run has to say at its end."""
    reported = getattr(node, "workeroutput", {}).get("deltak")
    if reported is None:
        return
    seen, forbidden = reported["writes"]
    before_seen, before_forbidden = node.config.stash.get(_WRITES, (0, []))
    node.config.stash[_WRITES] = (before_seen + seen, before_forbidden + list(forbidden))
    figures.FIGURES.extend(reported["figures"])
    peers.NOT_TESTED.extend(reported["not tested"])


def pytest_report_header() -> list[str]:
    there = "" if peers.data_folder().is_dir() else " (not there)"
    return [f"DELTAK_SEED={SEED}", f"measured data: {peers.data_folder()}{there}"]


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter) -> None:
    """List forbidden writes, figures, and, as the last thing before the closing line, what was not tested."""
    permitted, forbidden = terminalreporter.config.stash[_WRITES]
    terminalreporter.line(
        f"writes of drivers: {permitted} read requests and handshakes, {len(forbidden)} others"
    )
    for text in forbidden:
        terminalreporter.line(f"FORBIDDEN WRITE in {text}", red=True)
    if figures.FIGURES:
        terminalreporter.section("figures measured")
        for text in figures.FIGURES:
            terminalreporter.line(text)
    if not peers.NOT_TESTED:
        return
    terminalreporter.section("NOT TESTED", sep="!", red=True, bold=True)
    for text in sorted(set(peers.NOT_TESTED)):
        count = peers.NOT_TESTED.count(text)
        terminalreporter.line(f"NOT TESTED: {text}" + (f" ({count} tests)" if count > 1 else ""), red=True)

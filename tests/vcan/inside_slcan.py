"""The kernel's slcan and ours, both ways, and what a controller's states look like from the driver."""

import os
import random
import shutil
import signal
import subprocess
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from agent.config import load
from agent.runtime.sources import source_hints
from drivers.can.bus import netlink as can_link
from drivers.can.bus.bus import BusKeys
from drivers.can.bus.kernel import KernelBus
from drivers.can.bus.slcan import SlcanBus
from drivers.can.codec.frames import FRAME, FrameTable, candump_frames
from drivers.can.driver import CanDriver, CanSettings
from drivers.port import Counts, SourceRequest
from sim_bus.devices.can.packing import FrameKind
from sim_bus.devices.can.slcan import SlcanText
from tests.links import NotedLink
from tests.peers import ROOT
from tests.vcan.adapter import DEADLINE_S, KernelAdapter, kernel_adapter
from tests.vcan.inside import FOLDER

ALL = ((0, 0),)


@pytest.fixture(scope="module")
def quiet() -> Iterator[KernelAdapter]:
    with kernel_adapter("listen-only", "on") as adapter:
        yield adapter


@pytest.fixture(scope="module")
def talking() -> Iterator[KernelAdapter]:
    with kernel_adapter() as adapter:
        yield adapter


def test_script_for_adapters_makes_an_interface_that_listens_only(tmp_path: Path) -> None:
    (tmp_path / "modprobe").write_text("#!/bin/sh\n")  # the guest has loaded its modules
    (tmp_path / "modprobe").chmod(0o755)
    adapter = KernelAdapter(attach=False)
    path = f"{tmp_path}:{os.environ['PATH']}:/usr/sbin:/sbin"
    try:
        command = ["sh", str(ROOT / "deploy/can/slcan.sh"), os.ttyname(adapter.slave), "250000"]
        subprocess.run(command, check=True, env=os.environ | {"PATH": path}, timeout=DEADLINE_S)
        assert adapter.asked == b"C\rS5\rL\r"
        assert can_link.look("can0") == can_link.Link("can", False, True, "error-active", 0, 250_000)
        assert driver("can0").hints() == ()
    finally:
        end_daemon_of(os.ttyname(adapter.slave))
        adapter.close()


def end_daemon_of(port: str) -> None:
    """End the slcand that holds a port; it has gone into the background."""
    for folder in Path("/proc").glob("[0-9]*"):
        if (
            port.encode() in (words := (folder / "cmdline").read_bytes().split(b"\0"))
            and words[0] == b"slcand"
        ):
            os.kill(int(folder.name), signal.SIGTERM)


@contextmanager
def relayed(adapter: KernelAdapter) -> Iterator[SlcanBus]:
    """Carry what the kernel writes on to a second line, at whose end our reader is."""
    master, slave = os.openpty()
    tty.setraw(slave)
    keys = BusKeys(interface="slcan", channel=os.ttyname(slave))
    bus = SlcanBus(keys, FOLDER, Counts())
    adapter.to = lambda data: os.write(master, data)
    try:
        yield bus
    finally:
        adapter.to = len
        bus.close()
        os.close(slave)
        os.close(master)


def collect(bus: SlcanBus | KernelBus, count: int) -> FrameTable:
    """Read until so many frames have come."""
    deadline = time.monotonic() + DEADLINE_S
    tables = [np.empty(0, FRAME)]
    while sum(map(len, tables)) < count and time.monotonic() < deadline:
        tables.append(bus.frames(time.monotonic() + 0.1).table)
    return np.concatenate(tables)


def test_what_the_kernels_slcan_writes_is_read_as_candump_sees_it(talking: KernelAdapter) -> None:
    name = talking.name
    assert talking.asked.endswith(b"O\r")  # set up to take part in the bus: only then does the kernel send
    watching = ["candump", "-L", "-n", "63", name]
    with relayed(talking) as bus, subprocess.Popen(watching, stdout=subprocess.PIPE, text=True) as watcher:
        subprocess.run(["cangen", name, "-g", "2", "-n", "40"], check=True)
        subprocess.run(["cangen", name, "-e", "-g", "2", "-n", "20"], check=True)
        for frame in ("123#R", "1ABCDEF0#R5", "7FF#"):
            subprocess.run(["cansend", name, frame], check=True)
        mine = collect(bus, 63)
        lines, _ = watcher.communicate(timeout=DEADLINE_S)
    seen, bad = candump_frames(lines.splitlines())
    assert not bad
    assert [row.tobytes() for row in mine] == [row.tobytes() for row in seen.table]


def test_what_our_adapter_writes_is_read_by_the_kernels_slcan(quiet: KernelAdapter) -> None:
    rng = np.random.default_rng(5)
    kinds = [
        FrameKind("M", int(number), bool(extended), False, int(size))
        for extended in (0, 1)
        for number in rng.integers(0, 1 << (29 if extended else 11), 20)
        for size in [rng.integers(0, 9)]
    ]
    row = rng.bytes(sum(kind.size for kind in kinds))
    text = SlcanText(kinds, 1000.0)(0, row)
    assert quiet.asked == b"C\rS6\rL\r"  # the kernel's own way to open an adapter that must not disturb
    bus = KernelBus(BusKeys(interface="socketcan", channel=quiet.name), ALL, Counts())
    for line in text.splitlines(keepends=True):
        quiet.send(line)
    got = collect(bus, len(kinds))
    bus.close()
    data = b"".join(bytes(frame["data"][: frame["length"]]) for frame in got)
    assert data == row
    assert got["id"].tolist() == [kind.identifier | (0x80000000 if kind.extended else 0) for kind in kinds]


def test_both_read_the_same_stream_of_an_adapter_that_is_noisy(quiet: KernelAdapter) -> None:
    """Lines cut and spoilt: what both take for frames is the same.

    Lines with digits missing or too many are left out: the kernel fills them up from the line before, or
    reads them.
    """
    stream = b"\r" + b"".join(b"t%03X4%08X\r" % (number, number * 7919) for number in range(0x100, 0x140))
    noisy = stream.replace(b"t10A4", b"t10A9").replace(b"t1114", b"\xff\xfe").replace(b"t1204", b"t12\rt1204")
    counts = Counts()
    kernel = KernelBus(BusKeys(interface="socketcan", channel=quiet.name), ALL, Counts())
    master, slave = os.openpty()
    tty.setraw(slave)
    ours = SlcanBus(BusKeys(interface="slcan", channel=os.ttyname(slave)), FOLDER, counts)
    for start in range(0, len(noisy), 50):
        quiet.send(noisy[start : start + 50])
    os.write(master, noisy)
    mine, theirs = collect(ours, 62), collect(kernel, 62)
    for end in (kernel, ours):
        end.close()
    os.close(slave)
    os.close(master)
    assert [row.tobytes() for row in mine] == [row.tobytes() for row in theirs]
    assert counts.rejected == {"text": 3}


def driver(channel: str, **keys: object) -> CanDriver:
    settings = CanSettings.model_validate(
        {"interface": "socketcan", "channel": channel, "dbc": "rig.dbc", **keys}
    )
    return CanDriver(SourceRequest("line", settings, ("RIG_SAMPLE.X1",), "RIG_SAMPLE.Counter", FOLDER))


SAMPLE = b"t10080100000405000000\r"


def test_states_of_the_controller_are_reported_and_bus_off_ends_with_the_next_sample(
    quiet: KernelAdapter,
) -> None:
    reader = NotedLink(driver(quiet.name), 30.0, rng=random.Random(0))
    until(reader, lambda: reader.is_open)
    quiet.send(SAMPLE)
    until(reader, lambda: reader.driver.counts.received == 1)
    for text in (b"sw100000\r", b"sp128000\r", b"e1a\r", b"sb000256\r"):
        quiet.send(text)
    until(reader, lambda: reader._fault is not None)
    assert can_link.look(quiet.name) == can_link.Link("can", False, True, "bus-off", 0, 500_000)
    quiet.send(b"sa000000\r" + SAMPLE)
    until(reader, lambda: reader._fault is None)
    events = reader.take_events()
    counts = reader.driver.counts
    reader.close()
    assert [event.cause for event in events] == [
        "error-warning", "error-passive", "protocol error", "no acknowledgement", "bus error", "bus-off",
        "recovered", "error-active",
    ]  # fmt: skip
    assert [event.away for event in events].count(True) == 1
    assert events[1].message.endswith("(transmit errors 0, receive errors 128)")
    assert counts.faults == {event.cause: 1 for event in events if event.cause != "recovered"}
    assert counts.received == 2
    assert not counts.rejected


def until(reader: NotedLink, condition: Callable[[], bool]) -> None:
    deadline = time.monotonic() + DEADLINE_S
    while not condition():
        reader.read(0.05)
        assert time.monotonic() < deadline


def test_interface_that_is_not_listen_only_is_minded_and_told_once_when_it_is_opened(
    talking: KernelAdapter,
) -> None:
    opened = driver(talking.name, bitrate=250_000, fd=True)
    hints = opened.hints()
    for _ in range(2):
        opened.open()
    reports = opened.take_reports()
    opened.close()
    assert [hint.partition(";")[0] for hint in hints] == [
        f"{talking.name} is set up for classic frames, FD frames do not come",
        f"{talking.name} is not listen-only: its controller acknowledges frames and can disturb the bus",
        f"{talking.name} stays off the bus after bus-off",
        f"{talking.name} runs at 500000 bit/s, not at the 250000 of the configuration",
    ]
    assert sorted(reports) == sorted(("bus setup", f"line: {hint}") for hint in hints)


def test_check_warns_of_an_interface_that_is_not_listen_only(
    talking: KernelAdapter, quiet: KernelAdapter, tmp_path: Path
) -> None:
    text = (ROOT / "deploy/examples/can.toml").read_text().replace('"socketcand"', '"socketcan"')
    for adapter, warned in ((talking, True), (quiet, False)):
        config = tmp_path / f"{adapter.name}.toml"
        config.write_text(text.replace('channel = "vcan0"', f'channel = "{adapter.name}"'))
        shutil.copy(ROOT / "deploy/examples/two-mass-rig.dbc", tmp_path)
        words = [f"{path}: {hint}" for path, hint in source_hints(load(config))]
        assert any("is not listen-only" in hint for hint in words) == warned


def test_interface_that_is_listen_only_or_virtual_is_not_minded(quiet: KernelAdapter) -> None:
    assert driver(quiet.name, bitrate=500_000).hints() == ()
    assert driver("vcan0", fd=True).hints() == ()


@pytest.mark.parametrize("name", ["lo", "nosuch", "x" * 40])
def test_interface_without_a_controller_is_not_minded(name: str) -> None:
    assert driver(name).hints() == ()

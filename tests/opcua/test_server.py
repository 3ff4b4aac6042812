"""The OPC UA server asked by asyncua's own client: values with quality, alarms as conditions, who may act."""

import asyncio
import io
import logging
import re
import sys
import threading
import time
from collections.abc import Awaitable, Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from asyncua import Client, ua

from agent.cli.app import app
from agent.cli.glance.files import several
from agent.cli.opcua import quality
from agent.cli.opcua.access import Options, UserDirectory, read_users
from agent.cli.opcua.server import running
from agent.cli.web.secret import Secret
from agent.errors import UsageError
from agent.storage.operations import command_alarms
from agent.storage.read import queries
from agent.storage.write.alarm_commands import Request
from agent.storage.write.store import Store
from agent.storage.write.writer import StoreWriter
from tests.storage.rows import select
from tests.web import files

PASSWORD = "correct horse"
K1 = "ns=2;s=rig/press-7/k1"
OF_TYPE = {
    "Acknowledge": ua.ObjectIds.AcknowledgeableConditionType_Acknowledge,
    "TimedShelve": ua.ObjectIds.ShelvedStateMachineType_TimedShelve,
    "Refresh": ua.ObjectIds.ConditionType_ConditionRefresh,
}


class Listener:
    """Keeps the events of a subscription."""

    def __init__(self) -> None:
        self.events: list[Any] = []

    def event_notification(self, event: Any) -> None:
        self.events.append(event)

    async def wait(self, wanted: Callable[[Any], bool]) -> Any:
        end = time.monotonic() + 15.0
        while not (found := [event for event in self.events if wanted(event)]):
            assert time.monotonic() < end, [str(event.Message.Text) for event in self.events]
            await asyncio.sleep(0.02)
        return found[-1]


class Scene:
    """A database with its agent's writer, served in a thread of its own."""

    def __init__(self, folder: Path) -> None:
        self.path = files.make(folder, hops=20)
        self.writer = StoreWriter(lambda: Store.open(self.path), [], served={})
        self.address = ""
        self._ready, self._loop, self._stop = threading.Event(), asyncio.new_event_loop(), asyncio.Event()
        self._thread = threading.Thread(target=self._loop.run_until_complete, args=(self._serve(),))

    async def _serve(self) -> None:
        watched = several([self.path], [self.path.with_suffix(".toml")])
        users = {"anna": Secret.of_password(PASSWORD)}
        try:
            async with running(watched, Options(port=0), users) as self.address:
                self._ready.set()
                await self._stop.wait()
        finally:
            self._ready.set()

    def start(self) -> None:
        self.writer.start()
        self._thread.start()
        assert self._ready.wait(60)
        assert self.address

    def stop(self) -> None:
        self._loop.call_soon_threadsafe(self._stop.set)
        self._thread.join(30)
        self._loop.close()
        self.writer.stop()


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Scene]:
    logging.getLogger("asyncua").setLevel(logging.CRITICAL)
    found = Scene(tmp_path_factory.mktemp("opcua"))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(quality, "STALE_S", 3600.0)  # no row comes while the tests run
        found.start()
        yield found
        found.stop()


def signed_in(address: str, name: str = "anna", password: str = PASSWORD) -> Client:
    client = Client(address)
    client.set_user(name)
    client.set_password(password)
    return client


async def listening(client: Client, listener: Listener, node: Any = ua.ObjectIds.Server) -> Any:
    subscription = await client.create_subscription(50, listener)
    await subscription.subscribe_alarms_and_conditions(node, ua.ObjectIds.AlarmConditionType)
    return subscription


async def refused(call: Awaitable[Any]) -> str:
    with pytest.raises(ua.UaStatusCodeError) as error:
        await call
    return str(ua.status_codes.get_name_and_doc(error.value.code)[0])


def test_values_have_the_numbers_of_sql_and_the_quality_of_their_status(scene: Scene) -> None:
    rows = {row["parameter"]: row for row in queries.latest(scene.path, "press-7")}

    async def client() -> None:
        async with Client(scene.address) as reader:
            k1 = reader.get_node(K1)
            value = await k1.read_data_value()
            assert (value.Value.Value, value.StatusCode.name) == (rows["k1"]["value"], "Good")
            assert abs(value.SourceTimestamp.timestamp() - rows["k1"]["t_ns"] / 1e9) < 1e-5
            shown = {(await node.read_browse_name()).Name: node for node in await k1.get_children()}
            for name in ("lower", "upper", "sd", "delta", "reference"):
                assert await shown[name.capitalize()].read_value() == rows["k1"][name]
            assert await shown["Limit"].read_value() == 15.0
            assert (await shown["EngineeringUnits"].read_value()).DisplayName.Text == "N/m"
            standing = await reader.get_node("ns=2;s=rig/press-7/B2").read_data_value(
                raise_on_bad_status=False
            )
            assert standing.StatusCode.name == "UncertainSubNormal"
            assert await reader.get_node("ns=2;s=rig/press-7/B2/Reason").read_value() == "standstill"
            assert await refused(k1.write_value(1.0)) == "BadUserAccessDenied"

    asyncio.run(client())


def test_alarms_are_acknowledged_and_shelved_by_who_signed_in_and_nobody_else(scene: Scene) -> None:
    async def client() -> None:
        async with Client(scene.address) as reader, signed_in(scene.address) as anna:
            await acted_on(reader, anna, scene.path)

    asyncio.run(client())


async def acted_on(reader: Client, anna: Client, path: Path) -> None:
    """Be told of alarms by a refresh, acknowledge and shelve them, and be told what came of it."""
    listener = Listener()
    subscription = await listening(anna, listener)
    server = anna.get_node(ua.ObjectIds.ConditionType)
    number = ua.Variant(subscription.subscription_id, ua.VariantType.UInt32)
    await server.call_method(ua.NodeId(OF_TYPE["Refresh"]), number)
    event = await listener.wait(lambda event: event.ConditionName == "level k1")
    assert (event.Severity, event.Retain, event.SourceName) == (750, True, "press-7 k1")
    assert event.Message.Text.startswith("k1 fell by 16 N/m <img")
    states = [getattr(event, f"{name}State/Id") for name in ("Active", "Acked", "Confirmed", "Suppressed")]
    assert states == [True, False, False, False]

    condition, said = anna.get_node(event.NodeId), ua.LocalizedText("looked at it")
    acknowledge = ua.NodeId(OF_TYPE["Acknowledge"])
    other = reader.get_node(event.NodeId).call_method(acknowledge, event.EventId, said)
    assert await refused(other) == "BadUserAccessDenied"
    assert await refused(condition.call_method(acknowledge, b"rig/99/1", said)) == "BadEventIdUnknown"
    await condition.call_method(acknowledge, event.EventId, said)
    event = await listener.wait(lambda event: getattr(event, "AckedState/Id"))
    assert (event.ClientUserId, event.Comment.Text) == ("anna", "looked at it")
    said_so = "SELECT \"by\", comment FROM v_alarm_events WHERE to_state = 'ACKED'"
    assert select(path, said_so) == [("anna", "looked at it")]
    assert (
        await refused(condition.call_method(acknowledge, event.EventId, said))
        == "BadConditionBranchAlreadyAcked"
    )
    asked = condition.call_method("0:Confirm", event.EventId, said)
    assert await refused(asked) == "BadConditionBranchAlreadyConfirmed"

    shelving = await condition.get_child("0:ShelvingState")
    too_long = ua.Variant(8 * 86_400_000.0, ua.VariantType.Double)
    assert await refused(shelving.call_method("0:TimedShelve", too_long)) == "BadShelvingTimeOutOfRange"
    assert await refused(shelving.call_method("0:Unshelve")) == "BadConditionNotShelved"
    assert await refused(shelving.call_method("0:OneShotShelve")) == "BadNotSupported"
    hour = ua.Variant(3_600_000.0, ua.VariantType.Double)
    await condition.call_method(
        ua.NodeId(OF_TYPE["TimedShelve"]), hour
    )  # as Part 9 has it: on the condition itself
    await listener.wait(
        lambda event: getattr(event, "ShelvingState/CurrentState", None).Text == "TimedShelved"
    )
    assert [row["state"] for row in queries.alarms(path)] == ["SHLVD"]
    await shelving.call_method("0:Unshelve")
    await condition.call_method("0:RemoveFromService")
    await listener.wait(lambda event: getattr(event, "OutOfServiceState/Id"))
    assert await (await condition.get_child(["0:OutOfServiceState", "0:Id"])).read_value() is True
    await condition.call_method("0:PlaceInService")
    await asyncio.to_thread(command_alarms, path, Request("acknowledge", (1,), "eva"))  # elsewhere, meanwhile
    event = await listener.wait(lambda event: event.ClientUserId == "eva")
    assert event.Retain is True


def test_alarm_that_comes_while_clients_listen_is_an_event_of_its_rig_and_of_the_server(scene: Scene) -> None:
    async def client() -> None:
        async with Client(scene.address) as reader:
            of_server, of_rig = Listener(), Listener()
            await listening(reader, of_server)
            await listening(reader, of_rig, "ns=2;s=rig/press-7")
            scene.writer.stop()
            await asyncio.to_thread(files.plant, scene.path)
            for listener in (of_server, of_rig):
                event = await listener.wait(lambda event: event.ConditionName == "level k2")
                assert (event.Message.Text, event.SourceNode.Identifier) == ("k2 planted", "rig/press-7/k2")
            async with signed_in(scene.address) as anna:
                asked = anna.get_node(event.NodeId).call_method(
                    "0:Acknowledge", event.EventId, ua.LocalizedText("")
                )
                assert await refused(asked) == "BadServerNotConnected"  # no agent runs any more

    asyncio.run(client())


def test_wrong_password_is_refused_and_five_of_them_make_the_name_wait(tmp_path: Path) -> None:
    users = UserDirectory({"anna": Secret.of_password(PASSWORD)})
    assert users.get_user(None, "anna", PASSWORD).name == "anna"
    assert users.get_user(None, "tom", PASSWORD) is None
    assert [users.get_user(None, "anna", "wrong") for _ in range(5)] == [None] * 5
    assert users.get_user(None, "anna", PASSWORD) is None
    assert users.get_user(None).name is None


def test_only_clients_with_a_trusted_certificate_come_in_where_some_are_named() -> None:
    users = UserDirectory({}, {b"der": 2_000_000_000, b"old": 1_000_000_000})
    assert users.get_user(None, certificate=b"der") is not None
    assert [users.get_user(None, certificate=one) for one in (None, b"old", b"other")] == [None] * 3


def test_users_are_added_to_a_file_that_nobody_else_reads(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "users"
    for name in ("anna", "tom", "anna"):
        monkeypatch.setattr("sys.stdin", io.StringIO(f"{PASSWORD} of {name}\n"))
        app(["opcua", "--users", str(path), "--new-user", name], standalone_mode=False)
    assert path.stat().st_mode & 0o777 == 0o600
    users = read_users(path)
    assert {name: secret.is_known_by(f"{PASSWORD} of {name}") for name, secret in users.items()} == {
        "anna": True, "tom": True,
    }  # fmt: skip
    assert PASSWORD not in path.read_text()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--host", "0.0.0.0"], "others can reach 0.0.0.0, and there are no users or no certificate"),
        (["--private"], "needs users"),
        (["--certificate", "c.pem"], "needs --key"),
        (["--certificate", "c.pem", "--key", "open"], "may be used by others (mode 0644)"),
        (["--trusted", "."], "needs --certificate"),
        (["--users", "nothing"], "cannot be read"),
        (["--users", "rubbish"], "is no user with the hash of a password; write it with"),
        (["--new-user", "anna"], "needs --users"),
        (["--users", "u", "--new-user", "a:b"], "is no name"),
    ],
)
def test_server_refuses_to_be_open_to_others(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], words: str
) -> None:
    with Store.open(tmp_path / "rig.db"):
        pass
    for name, mode in (("open", 0o644), ("rubbish", 0o600)):
        (tmp_path / name).write_text("anna:secret\n")
        (tmp_path / name).chmod(mode)
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=re.escape(words)):
        app(["opcua", "rig.db", *arguments], standalone_mode=False)


def test_server_without_its_extra_says_how_to_install_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "asyncua", None)
    with pytest.raises(UsageError, match=r"needs the extra opcua .*; pip install 'deltak\[opcua\]'"):
        app(["opcua", str(tmp_path / "rig.db")], standalone_mode=False)

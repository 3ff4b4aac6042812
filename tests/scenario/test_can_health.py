"""What a CAN controller says of itself, from the wire to the database."""

from pathlib import Path

from tests.conformance.socketcand_device import Socketcand
from tests.scenario import live


def sample(number: int) -> bytes:
    data = (number % 65536).to_bytes(2, "little") + bytes(6)
    return b"< frame 100 %d.%03d000 %s >" % (*divmod(number, 1000), data.hex().encode())


def test_bus_off_is_an_alarm_of_its_source_and_other_states_are_events(tmp_path: Path) -> None:
    daemon, db = Socketcand("vcan0"), tmp_path / "rig.db"
    daemon.start()
    config = tmp_path / "rig.toml"
    text = (live.EXAMPLES / "can.toml").read_text().replace("port = 29536", f"port = {daemon.port}")
    config.write_text(text.replace("two-mass-rig.dbc", str(live.EXAMPLES / "two-mass-rig.dbc")))
    causes = "SELECT cause FROM v_events WHERE source = 'can' ORDER BY id"
    with live.agent(config, options=["--db", str(db)]) as agent:
        daemon.wait_for_clients(1)
        daemon.send(b"".join(map(sample, range(300))))
        daemon.send(b"< error 020 1.5 >< error 020 1.6 >< error 040 1.7 >")
        live.wait_until(lambda: ("bus-off",) in live.rows(db, causes), "bus-off in the database")
        assert live.rows(db, "SELECT kind, parameter, state FROM v_alarms") == [("source", "can", "UNACK")]
        daemon.send(b"< error 100 1.9 >" + b"".join(map(sample, range(400, 700))))
        live.wait_until(lambda: ("recovered",) in live.rows(db, causes), "recovered in the database")
        document = agent.document()
    daemon.stop()
    assert [cause for (cause,) in live.rows(db, causes)] == [
        "no acknowledgement",
        "bus-off",
        "recovered",
        "restarted",
    ]
    (message,) = live.rows(db, "SELECT message FROM v_alarms")[0]
    assert message.startswith("can: bus-off: the controller has left the bus")
    assert live.rows(db, "SELECT state FROM v_alarms") == [("RTNUN",)]
    faults = "SELECT DISTINCT reason, count FROM v_health_reasons WHERE kind = 'faults' ORDER BY reason"
    assert live.rows(db, faults) == [("bus-off", 1), ("no acknowledgement", 2), ("restarted", 1)]
    assert document["samples"] == {"received": 600, "used": 600, "rejected": {}, "dropped": {}, "gaps": 1}

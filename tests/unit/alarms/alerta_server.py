"""Prints what alerta-server's model of ANSI/ISA-18.2 does, as JSON: run by an environment that has
alerta-server.

Rows of state, severity before, severity now, what is done (None: an event comes), state after.
"""

import itertools
import json
import logging
import sys
from importlib.metadata import version
from types import SimpleNamespace

from alerta.models.alarms.isa_18_2 import StateMachine
from flask import Flask

STATES = ("NORM", "UNACK", "ACKED", "RTNUN", "SHLVD", "DSUPR", "OOSRV")
SEVERITIES = ("OK", "Medium", "High")
ACTIONS = (None, "ack", "shelve", "unshelve", "timeout")
SETTINGS = ("SEVERITY_MAP", "COLOR_MAP", "DEFAULT_NORMAL_SEVERITY", "DEFAULT_PREVIOUS_SEVERITY")


def main() -> None:
    app = Flask("states")
    app.config.update(dict.fromkeys(SETTINGS))
    app.logger.setLevel(logging.CRITICAL)
    model = StateMachine()
    with app.app_context():
        model.register(app)
        rows = []
        for state, before, now, action in itertools.product(STATES, SEVERITIES, SEVERITIES, ACTIONS):
            alert = SimpleNamespace(severity=now, previous_severity=before, status="NORM")
            _, after = model.transition(alert, current_status=state, action=action)
            rows.append([state, before, now, action, after])
    json.dump({"version": version("alerta-server"), "rows": rows}, sys.stdout)


if __name__ == "__main__":
    main()

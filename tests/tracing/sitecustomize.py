"""Python imports a module of this name at its start when it finds one: so agents that tests start are watched
too."""

import importlib.util
import os
import sys
from pathlib import Path

NAME = "tests.tracing.watch"


def load() -> None:
    spec = importlib.util.spec_from_file_location(NAME, Path(__file__).with_name("watch.py"))
    if spec is not None and spec.loader is not None:
        module = importlib.util.module_from_spec(spec)
        sys.modules[NAME] = module
        spec.loader.exec_module(module)
        module.install()


if os.environ.get("DELTAK_WRITES"):
    load()

"""deltak(1) and the shells' completion leave out no command and no option."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from deploy.package import manual

PAGE = manual.page(0)
SECTIONS = {
    title.replace("\\", ""): text
    for title, text in re.findall(r"^\.SS (.+)\n((?:(?!\.S[SH] ).*\n)*)", PAGE, re.MULTILINE)
}
COMMANDS = list(manual.commands())


def terms(text: str) -> str:
    return " ".join(re.findall(r"^\.TP\n\\fB(.*)\\fR$", text, re.MULTILINE)).replace("\\", "")


@pytest.mark.parametrize(("name", "command"), [item[:2] for item in COMMANDS[1:]], ids=str)
def test_every_command_option_and_argument_is_in_the_man_page(name: str, command: Any) -> None:
    shown = terms(SECTIONS[name])
    options = [p for p in command.params if p.param_type_name == "option" and not p.hidden]
    missing = [word for option in options for word in option.opts if not re.search(rf"{word}\b", shown)]
    assert missing == []
    assert "--help" in shown
    arguments = [p.metavar for p in command.params if p.param_type_name == "argument"]
    assert [metavar for metavar in arguments if metavar not in shown] == []


def test_man_page_holds_no_command_that_is_none() -> None:
    assert list(SECTIONS) == [name for name, _, _ in COMMANDS[1:]]
    assert {"deltak sim", "deltak db check"} <= set(SECTIONS)  # a plug-in, and one of a group


def test_man_page_is_dated_and_nothing_in_it_is_taken_for_an_order() -> None:
    assert PAGE.startswith('.TH DELTAK 1 "1970-01-01" "deltak ')
    orders = {line.split()[0] for line in PAGE.splitlines() if line.startswith((".", "'"))}
    assert orders == {".TH", ".SH", ".SS", ".TP", ".PP"}
    assert re.findall(r"\\[^-&fe]", PAGE) == []


def test_bash_completes_options_of_a_plug_in(tmp_path: Path) -> None:
    bash = shutil.which("bash")
    assert bash is not None
    (tmp_path / "complete").write_text(manual.completion("bash"))
    script = f"""
        source {tmp_path}/complete
        COMP_WORDS=(deltak sim --tr); COMP_CWORD=2
        env() {{ command env "${{@:1:3}}" {sys.executable} -m agent; }}
        _deltak_completion deltak
        printf '%s\\n' "${{COMPREPLY[@]}}"
    """
    done = subprocess.run(
        [bash, "-c", script], env=os.environ, capture_output=True, text=True, check=True, timeout=60
    )
    assert done.stdout.split() == ["--truth"]


@pytest.mark.parametrize("shell", manual.COMPLETION)
def test_completion_of_every_shell_asks_the_command(shell: str) -> None:
    assert f"_DELTAK_COMPLETE=complete_{shell}" in manual.completion(shell)

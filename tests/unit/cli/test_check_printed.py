"""What `deltak check` prints of what windows can tell."""

import pytest

from agent.cli.commissioning.check import print_check

ROW = {"parameter": "k1", "window_s": 0.9, "sd": 0.2, "unit": "N/m", "assumes": "white force of 1 N rms"}


def printed(rows: list[dict[str, object]], capsys: pytest.CaptureFixture[str]) -> str:
    print_check({"ok": True, "warnings": [], "predicted_sd": rows})
    return capsys.readouterr().out


def test_what_all_rows_rest_on_is_said_once_below_them(capsys: pytest.CaptureFixture[str]) -> None:
    out = printed([ROW, ROW | {"parameter": "k2"}], capsys)
    assert out.count("white force") == 1
    assert out.rstrip().endswith("with white force of 1 N rms")


def test_what_rows_rest_on_stands_in_each_where_they_differ(capsys: pytest.CaptureFixture[str]) -> None:
    out = printed([ROW, ROW | {"parameter": "k2", "assumes": "sweep"}], capsys)
    assert "white force" in out
    assert "sweep" in out

"""Widths of columns on terminals of any width: no word is cut, figures stay whole."""

from agent.cli.terminal.output import widths

ALARMS = [
    ["id", "12"],
    ["raised", "2026-11-23 15:23:54.073Z"],
    ["sd", "0.1 of 0.2"],
    ["what", "k1 is 50.1 above nominal 25 (limit 15)"],
]


def test_widths_with_room_are_those_of_the_longest_texts() -> None:
    assert widths(ALARMS, {2}, 200) == ([2, 24, 10, 38], 1)


def test_widths_of_a_narrow_terminal_wrap_the_widest_and_leave_words_and_figures_whole() -> None:
    found, padding = widths(ALARMS, {2}, 60)
    assert (sum(found), padding) == (60, 0)
    assert found[:3] == [2, 24, 10]
    assert widths(ALARMS, {2}, 20) == ([2, 13, 10, 7], 0)


def test_widths_of_a_table_without_rows_are_those_of_its_headings() -> None:
    assert widths([["id"], [""]], set(), 80) == ([2, 0], 1)
